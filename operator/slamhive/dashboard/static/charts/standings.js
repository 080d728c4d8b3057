// SPDX-License-Identifier: Apache-2.0
/** A leaderboard as dots: how far everyone is from the best, and what everyone reached on each dataset. */
import { COLOURS } from '../core/chart.js';
import { axisName, clip, keysText, number } from '../core/format.js';
import { crossed, withField } from './failures.js';
import { logTicks } from './limits.js';
import { labelRoom, rowAxis, rowLines } from './rows.js';
import { HOLLOW, publishedText } from './scatter.js';

/** Rows of a picture; the table has all. */
export const MOST = 40;
const WIDE_RANGE = 5;
const NARROW = 560;
const SYMBOLS = ['circle', 'diamond', 'triangle', 'rect'];

/**
 * Tell whether a competitor ran on too few of a board's datasets to be ranked beside one that ran on most.
 * @param {Api.Board} board
 * @param {Api.Ranked} entry
 */
export const onFew = (board, entry) =>
  2 * entry.datasets.length < Math.max(...board.entries.map((one) => one.datasets.length));

/**
 * Return the competitors by their distance to the best: who ran on few datasets after the others, then those
 * whose median run failed, and last who never succeeded.
 * @param {Api.Board} board
 */
export function sorted(board) {
  /** @param {Api.Ranked} one */
  const group = (one) => (one.rank === null ? 3 : one.ratio === null ? 2 : onFew(board, one) ? 1 : 0);
  return [...board.entries].sort(
    (a, b) => group(a) - group(b) || (a.ratio ?? 0) - (b.ratio ?? 0) || (a.rank ?? 0) - (b.rank ?? 0),
  );
}

/** @param {Api.Board} board @param {Api.Ranked} entry */
const datasets = (board, { datasets }) =>
  `${datasets.length} of ${board.datasets.length} dataset${board.datasets.length > 1 ? 's' : ''}`;

/**
 * @param {Api.Board} board
 * @param {Api.Ranked} entry
 * @param {boolean} short whether there is no room for the last word
 */
const place = (board, entry, short) => {
  const on = datasets(board, entry);
  const rank = entry.rank === null ? 'no rank' : `rank ${number(entry.rank)}`;
  return `${rank} on ${short ? on.replace(/ datasets?$/, '') : on}`;
};

/**
 * Return where the text above a dot stands: within the axes, not over the names beside them.
 * @param {number} share of the axis' length, left of the dot
 */
const aside = (share) =>
  share < 0.3 ? { align: 'left', offset: [3, 0] } : share > 0.7 ? { align: 'right', offset: [6, 0] } : {};

/** @param {Api.Interval|null|undefined} range */
export const interval = (range) =>
  range ? `${number(range.low, 3)} to ${range.high === null ? '∞' : number(range.high, 3)}` : '–';

/**
 * Return the dot plot of ratios to the best, with their intervals; who failed is in a field of its own.
 * @param {Api.Board} board
 * @param {Api.Heading} metric
 * @returns {Drawn}
 */
export function standings(board, metric) {
  const shown = sorted(board).slice(0, MOST);
  const known = shown.map((entry, at) => ({ entry, at })).filter(({ entry }) => entry.ratio !== null);
  const most = known.flatMap(({ entry }) => [entry.ratio, entry.ratioInterval?.high ?? 1]).map(Number);
  const end = Math.max(1.5, ...most) * 1.06;
  const single = board.datasets.length === 1;
  /** @param {Api.Ranked} entry */
  const label = (entry) =>
    [
      `${number(entry.ratio, 3)}×`,
      ...(single
        ? [`${number(Number(entry.datasets[0].median) * (metric.factor ?? 1), 3)} ${metric.unit ?? ''}`]
        : []),
      `n ${entry.n}`,
    ].join(', ');
  // On a phone the name of somebody else's algorithm has three lines, and its rank the fourth.
  const lines = Math.max(...shown.map(({ keys }) => keysText(keys).split(' ').length)) > 2 ? 4 : 3;
  return {
    height: 66 + shown.length * 14 * lines,
    option: ({ width }) =>
      withField(
        {
          grid: { left: labelRoom(width, 300), right: 20, top: 10, bottom: 50 },
          tooltip: {
            trigger: 'item',
            formatter: (/** @type {Item} */ item) => (item.data?.entry ? told(board, item.data.entry) : ''),
          },
          xAxis: {
            type: 'log',
            min: 0.96,
            max: end,
            name: `${metric.better === 'higher' ? 'the best over it' : 'times the best'}, over datasets`,
            nameGap: 28,
            ...logTicks(1, end),
            axisLabel: {
              ...logTicks(1, end).axisLabel,
              formatter: (/** @type {number} */ value) => `${number(value, 3)}×`,
            },
          },
          yAxis: {
            ...rowAxis(
              shown.map((entry) => `${keysText(entry.keys)}\n${place(board, entry, width < NARROW)}`),
              width,
              300,
              { lines: width < NARROW ? 2 : 1, lineHeight: 13 },
            ),
            splitLine: { show: true },
          },
          series: [
            rowLines(
              known
                .filter(({ entry }) => entry.ratioInterval)
                .map(({ entry, at }) => [entry.ratioInterval?.low, entry.ratioInterval?.high ?? end, at]),
              { stroke: COLOURS[5], lineWidth: 3, opacity: 0.8 },
            ),
            {
              type: 'scatter',
              color: COLOURS[0],
              symbolSize: 12,
              data: known.map(({ entry, at }) => ({
                value: [entry.ratio, at],
                entry,
                ...(onFew(board, entry) && { itemStyle: { ...HOLLOW, borderColor: COLOURS[0] } }),
                label: {
                  show: true,
                  position: 'top',
                  distance: 3,
                  fontSize: 11,
                  ...aside(Math.log(Number(entry.ratio) / 0.96) / Math.log(end / 0.96)),
                  formatter: label(entry),
                },
              })),
            },
            {
              type: 'scatter',
              symbol: 'triangle',
              symbolRotate: -90,
              symbolSize: 9,
              color: COLOURS[5],
              silent: true,
              data: known
                .filter(({ entry }) => entry.ratioInterval?.high === null)
                .map(({ at }) => [end, at]),
            },
          ],
        },
        'beside',
        [
          {
            data: shown.flatMap((entry, at) =>
              entry.ratio === null ? [{ value: [0, at], entry, itemStyle: crossed() }] : [],
            ),
          },
        ],
        width,
      ),
  };
}

/** @param {Api.Interval|null} range */
const between = (range) => (range ? `, between ${interval(range)}` : '');

/** @param {Api.Board} board @param {Api.Ranked} entry */
const told = (board, entry) =>
  [
    clip(keysText(entry.keys), 100),
    entry.rank === null ? 'no run succeeded' : `rank ${number(entry.rank)}${between(entry.rankInterval)}`,
    entry.ratio === null
      ? 'the median run failed'
      : `${number(entry.ratio, 3)} times the best${between(entry.ratioInterval)}`,
    `on ${datasets(board, entry)}; ${entry.failed} of ${entry.runs} runs failed`,
  ].join('\n');

/**
 * Return the dot plot of what everyone reached on each dataset, with published numbers hollow beside it.
 * @param {Api.Board} board
 * @param {Api.Heading} metric
 * @param {Api.PublishedRow[]} beside
 * @returns {Drawn}
 */
export function scores(board, metric, beside) {
  const rows = board.datasets.slice(0, MOST);
  const factor = metric.factor ?? 1;
  const published = beside
    .filter((row) => row.values[metric.name] !== undefined && rows.includes(row.dataset))
    .map((row) => ({ published: row, value: [row.values[metric.name] * factor, rows.indexOf(row.dataset)] }));
  /** @type {Array<{at: number, color: string, told: string}>} */
  const failed = [];
  const series = sorted(board).map((entry, place) => {
    const color = COLOURS[place % COLOURS.length];
    const name = clip(keysText(entry.keys), 90);
    const data = entry.datasets.flatMap((one) => {
      const at = rows.indexOf(one.dataset);
      if (at >= 0 && one.medianFailed)
        failed.push({ at, color, told: `${name}\n${one.dataset}: the median run failed` });
      return at < 0 || one.median === null ? [] : [{ value: [one.median * factor, at] }];
    });
    const symbol = SYMBOLS[Math.floor(place / COLOURS.length) % SYMBOLS.length];
    return { type: 'scatter', name, color, symbol, symbolSize: 10, data };
  });
  const values = [...series.flatMap((one) => one.data), ...published].map((one) => one.value[0]);
  const [low, high] = [Math.min(...values), Math.max(...values)];
  const log = low > 0 && high / low > WIDE_RANGE;
  const ticks = logTicks(low, high);
  /** Crosses of a row stand side by side. @param {typeof failed[number]} one */
  const shift = (one) => {
    const all = failed.filter((other) => other.at === one.at);
    return (all.indexOf(one) - (all.length - 1) / 2) * Math.min(12, 44 / all.length);
  };
  return {
    height: 100 + rows.length * 26,
    option: ({ width }) =>
      withField(
        {
          grid: { left: labelRoom(width, 240), right: 24, top: 34, bottom: 50 },
          legend: { data: [...series.map(({ name }) => name), ...(published.length ? ['published'] : [])] },
          tooltip: {
            trigger: 'item',
            formatter: (/** @type {Item} */ { seriesName, data }) =>
              data?.published
                ? publishedText(data.published)
                : (data?.told ?? `${seriesName}\n${clip(rows[data.value[1]], 60)}: ${number(data.value[0])}`),
          },
          xAxis: {
            type: log ? 'log' : 'value',
            ...(log ? { min: low / 1.15, max: high * 1.15, ...ticks } : { min: low < 0 ? undefined : 0 }),
            name: `${clip(axisName(metric), 40)}, median`,
            nameGap: 28,
            axisLabel: {
              ...(log && ticks.axisLabel),
              formatter: (/** @type {number} */ value) => number(value, 3),
            },
          },
          yAxis: { ...rowAxis(rows.map(String), width, 240), splitLine: { show: true } },
          series: [
            ...series,
            ...(published.length
              ? [
                  {
                    type: 'scatter',
                    name: 'published',
                    symbol: 'diamond',
                    symbolSize: 11,
                    itemStyle: HOLLOW,
                    data: published,
                  },
                ]
              : []),
          ],
        },
        'beside',
        [
          {
            data: failed.map((one) => ({
              value: [0, one.at],
              told: one.told,
              symbolOffset: [shift(one), 0],
              itemStyle: crossed(one.color),
            })),
          },
        ],
        width,
      ),
  };
}
