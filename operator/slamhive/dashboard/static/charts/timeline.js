// SPDX-License-Identifier: Apache-2.0
/** What nodes and cores did when: bars of single runs, or shares of time where they are many. */
import { clip, keysText, number, statusClass, time } from '../core/format.js';

const PREPARING = '#8a929b';
/** By the class of a status: colours that the colour-blind can tell apart, failures the darkest. */
const INKS = /** @type {Record<string, string>} */ ({
  good: '#009e73',
  fair: '#e69f00',
  bad: '#c0392b',
  live: '#56b4e9',
  plain: '#7570b3',
});
export const KEY = [
  ['preparing', PREPARING],
  ['running, tracked', INKS.good],
  ['partial', INKS.fair],
  ['failed, lost or diverged', INKS.bad],
  ['under way', INKS.live],
  ['not evaluated', INKS.plain],
];
const ROW = 26;
const EDGE = { left: 130, right: 24, top: 12, bottom: 56 };

/** @param {number} seconds */
const duration = (seconds) =>
  seconds < 120
    ? `${number(seconds, 3)} s`
    : seconds < 7200
      ? `${number(seconds / 60, 3)} min`
      : `${number(seconds / 3600, 3)} h`;

/**
 * Return the drawing of a timeline.
 * @param {Api.Timeline} data answer of analysis/timeline
 * @returns {Drawn}
 */
export function timelineChart(data) {
  const height = EDGE.top + EDGE.bottom + Math.max(1, data.lanes.length) * ROW;
  const [low, high] = data.extent;
  return {
    height,
    option: ({ width }) => {
      const left = Math.min(EDGE.left, width * 0.3);
      return {
        grid: { ...EDGE, left },
        tooltip: {
          trigger: 'item',
          formatter: (/** @type {Item} */ item) =>
            data.bars ? barText(data, data.bars, item.dataIndex) : binText(data, item.value),
        },
        xAxis: {
          type: 'time',
          min: (low ?? 0) * 1000,
          max: (high ?? 1) * 1000,
          name: 'time',
          nameGap: 30,
        },
        yAxis: {
          type: 'category',
          inverse: true,
          data: data.lanes.map((name) => clip(name, 60)),
          axisLabel: { width: left - 14, overflow: 'truncate', interval: 0 },
          splitLine: { show: true },
        },
        series: [data.bars ? barSeries(data.bars) : binSeries(data, fullShare(data))],
      };
    },
  };
}

/**
 * Return the place of a rectangle between two times in its lane.
 * @param {any} api of ECharts
 * @param {number} lane
 * @param {number} from ms
 * @param {number} to ms
 * @param {number} base share of the lane's height at which it ends, from above
 * @param {number} share of the lane's height that it has
 */
function rectangle(api, lane, from, to, base, share) {
  const [begin, middle] = api.coord([from, lane]);
  const [end] = api.coord([to, lane]);
  const tall = api.size([0, 1])[1] * 0.84;
  const bottom = middle + tall * (base - 0.5);
  return { x: begin, y: bottom - tall * share, width: Math.max(1, end - begin), height: tall * share };
}

/** @param {NonNullable<Api.Timeline['bars']>} bars */
const barSeries = (bars) => ({
  type: 'custom',
  clip: true,
  encode: { x: [1, 3], y: 0 },
  data: bars.lane.map((lane, at) => [
    lane,
    bars.begin[at] * 1000,
    (bars.start[at] ?? bars.end[at]) * 1000,
    bars.end[at] * 1000,
  ]),
  renderItem: (/** @type {any} */ params, /** @type {any} */ api) => {
    const at = params.dataIndex;
    const [lane, begin, start, end] = [0, 1, 2, 3].map((dimension) => api.value(dimension));
    const ink = bars.live[at]
      ? INKS.live
      : bars.failed[at]
        ? INKS.bad
        : (INKS[statusClass(bars.status[at])] ?? INKS.bad);
    const running = rectangle(api, lane, start, end, 1, 1);
    return {
      type: 'group',
      children: [
        ...(start > begin
          ? [
              {
                type: 'rect',
                shape: rectangle(api, lane, begin, start, 0.75, 0.5),
                style: { fill: PREPARING },
              },
            ]
          : []),
        // A run that failed before its program began is all preparation: its end is marked all the same.
        {
          type: 'rect',
          shape: { ...running, r: 2 },
          style: { fill: ink, stroke: '#ffffff55', lineWidth: 1 },
        },
        ...(bars.failed[at]
          ? [
              {
                type: 'rect',
                shape: { ...running, x: running.x + running.width - 2, width: 3 },
                style: { fill: '#5c0f16' },
              },
            ]
          : []),
      ],
    };
  },
});

/**
 * Return the cells of a timeline of many runs in which something was done.
 * @param {Api.Timeline} data
 * @returns {number[][]} lane, begin and end in ms, shares of running and preparing, ended, failed
 */
export function binCells({ bins }) {
  if (!bins) return [];
  return bins.running.flatMap((row, lane) =>
    row.flatMap((running, at) => {
      const [preparing, ended, failed] = [
        bins.preparing[lane][at],
        bins.ended[lane][at],
        bins.failed[lane][at],
      ];
      if (!running && !preparing && !ended) return [];
      return [[lane, bins.edges[at] * 1000, bins.edges[at + 1] * 1000, running, preparing, ended, failed]];
    }),
  );
}

/**
 * Return the share of time that a column of full height stands for: little use must be seen too.
 * @param {Api.Timeline} data
 */
export function fullShare(data) {
  const most = binCells(data).reduce((top, cell) => Math.max(top, cell[3] + cell[4]), 0);
  return most > 0 ? Math.min(1, Math.ceil(most * 20) / 20) : 1;
}

/**
 * @param {Api.Timeline} data
 * @param {number} full
 */
const binSeries = (data, full) => ({
  type: 'custom',
  clip: true,
  encode: { x: [1, 2], y: 0 },
  data: binCells(data),
  renderItem: (/** @type {any} */ _, /** @type {any} */ api) => {
    const [lane, from, to, running, preparing, ended, failed] = [0, 1, 2, 3, 4, 5, 6].map((at) =>
      api.value(at),
    );
    const [run, prepared] = [Math.min(1, running / full), Math.min(1, preparing / full)];
    // The part of the ends that failed is the part of the column that is red.
    const bad = ended ? Math.max(failed / ended, failed ? 0.08 : 0) : 0;
    const base = 1;
    return {
      type: 'group',
      children: [
        {
          type: 'rect',
          shape: rectangle(api, lane, from, to, base, run * (1 - bad)),
          style: { fill: INKS.good },
        },
        {
          type: 'rect',
          shape: rectangle(api, lane, from, to, base - run * (1 - bad), run * bad),
          style: { fill: INKS.bad },
        },
        {
          type: 'rect',
          shape: rectangle(api, lane, from, to, base - run, Math.min(prepared, 1 - run)),
          style: { fill: PREPARING },
        },
      ],
    };
  },
});

/**
 * @param {Api.Timeline} data
 * @param {NonNullable<Api.Timeline['bars']>} bars
 * @param {number} at
 */
function barText(data, bars, at) {
  const start = bars.start[at];
  return [
    `run ${clip(bars.run[at] ?? bars.uid[at], 50)}`,
    bars.live[at] ? 'under way' : clip(bars.status[at], 40),
    clip(keysText(bars.settings[at]), 90),
    clip(data.lanes[bars.lane[at]], 60),
    `begun ${time(bars.begin[at])}`,
    start === null
      ? `${duration(bars.end[at] - bars.begin[at])}, and its program never started`
      : `prepared for ${duration(start - bars.begin[at])}, ran for ${duration(bars.end[at] - start)}`,
  ]
    .filter(Boolean)
    .join('\n');
}

/**
 * @param {Api.Timeline} data
 * @param {number[]} cell
 */
const binText = (data, [lane, from, to, running, preparing, ended, failed]) =>
  [
    clip(data.lanes[lane], 60),
    `${time(from / 1000)}, ${duration((to - from) / 1000)} long`,
    `${number(100 * running, 3)} % of it running, ${number(100 * preparing, 3)} % preparing`,
    `${number(ended)} runs ended, ${number(failed)} of them failed`,
  ].join('\n');

/**
 * Return the part of time that a step of the reader's leads to.
 * @param {[number, number]} shown begin and end, s
 * @param {'closer'|'wider'|'earlier'|'later'} step
 * @param {number} [middle] what stays in view
 * @returns {[number, number]}
 */
export function moved([low, high], step, middle = (low + high) / 2) {
  const span = high - low;
  if (step === 'earlier') return [low - span / 2, high - span / 2];
  if (step === 'later') return [low + span / 2, high + span / 2];
  const half = step === 'closer' ? span / 8 : span * 2;
  return [middle - half, middle + half];
}

/**
 * Say how much of the time that is shown was used, and of what that is the share.
 * @param {Api.Timeline} data
 */
export function usedText({ bars, bins, lanes, extent: [low, high] }) {
  if (low === null || high === null || !lanes.length || high <= low) return '';
  const all = (high - low) * lanes.length;
  /** @param {number[][]} shares */
  const sum = (shares) => shares.flat().reduce((a, b) => a + b, 0);
  let [running, preparing] = [0, 0];
  if (bins) {
    const each = (bins.edges[1] - bins.edges[0]) / all;
    [running, preparing] = [sum(bins.running) * each, sum(bins.preparing) * each];
  } else if (bars) {
    /** @param {number} from @param {number} to */
    const inside = (from, to) => Math.max(0, Math.min(to, high) - Math.max(from, low));
    for (const [at, end] of bars.end.entries()) {
      const start = bars.start[at] ?? end;
      running += inside(start, end) / all;
      preparing += inside(bars.begin[at], start) / all;
    }
  }
  const lane = lanes.length === 1 ? 'the lane' : `the ${lanes.length} lanes`;
  const other = number(100 * Math.max(0, 1 - running - preparing), 3);
  return [
    `Of the ${duration(high - low)} of ${lane}, ${number(100 * running, 3)} % were spent running`,
    `and ${number(100 * preparing, 3)} % preparing. Of the other ${other} %`,
    'nobody noted how much was evaluation, and how much nothing.',
  ].join(' ');
}
