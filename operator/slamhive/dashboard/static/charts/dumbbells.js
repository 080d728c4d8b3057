// SPDX-License-Identifier: Apache-2.0
/** Each competitor's own error and its error over the common support, joined by a line. */
import { COLOURS } from '../core/chart.js';
import { clip, keysText, namedValue, number } from '../core/format.js';
import { labelRoom, rowAxis, rowLines } from './rows.js';

const WIDE_RANGE = 5;
export const NARROW = 560;
/** @type {Array<{key: 'own'|'common'} & Record<string, any>>} */
const SERIES = [
  {
    key: 'own',
    name: 'own poses',
    symbol: 'circle',
    symbolSize: 10,
    color: COLOURS[1],
    itemStyle: { color: 'transparent', borderColor: COLOURS[1], borderWidth: 2 },
  },
  { key: 'common', name: 'common support', symbol: 'diamond', symbolSize: 13, color: COLOURS[0] },
];

/**
 * Return the chart of one group and its height; null where nobody was measured over the common support.
 * @param {Api.CommonEntry[]} entries of a group of /api/v1/analysis/common, the best first
 * @returns {Drawn|null}
 */
export function dumbbells(entries) {
  const measured = entries.map((entry, at) => ({ entry, at })).filter(({ entry }) => entry.common !== null);
  const errors = measured.flatMap(({ entry }) => [entry.own, entry.common]).filter((value) => value !== null);
  if (errors.length === 0) return null;
  const [least, most] = [Math.min(...errors), Math.max(...errors)];
  const log = least > 0 && most / least > WIDE_RANGE;
  /**
   * @param {Api.CommonEntry} entry
   * @param {number} width
   */
  const name = (entry, width) => {
    const said = width < NARROW ? twoLines(entry.keys) : keysText(entry.keys);
    return entry.common === null ? `× ${said}` : said;
  };
  /**
   * @param {{entry: Api.CommonEntry}} one
   * @param {'own'|'common'} key
   */
  const moved = ({ entry }, key) =>
    entry.rank !== entry.ownRank && (Number(entry.own) > Number(entry.common) ? 'own' : 'common') === key;
  return {
    height: 110 + entries.length * 28,
    option: ({ width }) => ({
      grid: { left: labelRoom(width, 250), right: 62, top: 34, bottom: 50 },
      legend: {},
      tooltip: { trigger: 'item', formatter: (item) => (item.data?.entry ? told(item.data.entry) : '') },
      xAxis: {
        type: log ? 'log' : 'value',
        scale: true,
        name: 'ATE [m]',
        nameGap: 28,
        ...(log && { min: rounded(least, Math.floor), max: rounded(most, Math.ceil) }),
        axisLabel: { formatter: (value) => number(value, 2) },
        minorTick: { show: log, splitNumber: 9 },
      },
      yAxis: rowAxis(
        entries.map((entry) => name(entry, width)),
        width,
        250,
        width < NARROW ? { fontSize: 11, lineHeight: 12 } : {},
      ),
      series: [
        rowLines(
          measured
            .filter(({ entry }) => entry.own !== null)
            .map(({ entry, at }) => [entry.own, entry.common, at]),
          { stroke: COLOURS[8], lineWidth: 3, opacity: 0.6 },
        ),
        ...SERIES.map(({ key, ...series }) => ({
          ...series,
          type: 'scatter',
          data: measured.map((one) => ({
            value: [one.entry[key], one.at],
            entry: one.entry,
            label: {
              show: moved(one, key),
              position: 'right',
              distance: 8,
              formatter: `${number(one.entry.ownRank)} → ${number(one.entry.rank)}`,
            },
          })),
        })),
      ],
    }),
  };
}

/** @param {Api.Keys} keys */
export const twoLines = (keys) => {
  const [first, ...rest] = Object.entries(keys).map(([name, value]) => namedValue(name, value));
  return rest.length ? `${first}\n${rest.join(', ')}` : first;
};

/** @param {Api.CommonEntry} entry */
const told = (entry) =>
  [
    clip(keysText(entry.keys), 100),
    `own ${number(entry.own)} m, rank ${number(entry.ownRank)}`,
    `in common ${number(entry.common)} m, rank ${number(entry.rank)}`,
  ].join('\n');

/**
 * Return the end of a logarithmic axis: one digit and zeros.
 * @param {number} value
 * @param {(value: number) => number} towards
 */
export function rounded(value, towards) {
  const size = 10 ** Math.floor(Math.log10(value));
  return Number((towards(value / size) * size).toPrecision(1));
}
