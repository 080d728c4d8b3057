// SPDX-License-Identifier: Apache-2.0
/** Trajectories from above and from the sides, and what happened over time. */
import { COLOURS, legendOfLines } from '../core/chart.js';
import { clip, number } from '../core/format.js';

/** The three planes: name and the two axes. */
/** @type {Array<[string, Axis, Axis]>} */
export const PLANES = [
  ['xy', 'x', 'y'],
  ['xz', 'x', 'z'],
  ['yz', 'y', 'z'],
];

/** Colour of the ground truth. */
export const TRUTH = '#8a929b';

/** Error colours, from none to the largest. */
export const RAMP = [
  [33, 102, 172],
  [53, 183, 121],
  [230, 184, 0],
  [215, 48, 31],
];

/**
 * Return the colour of a share from 0 to 1.
 * @param {number} share
 */
export function ramp(share) {
  const place = Math.min(1, Math.max(0, share)) * (RAMP.length - 1);
  const low = Math.min(RAMP.length - 2, Math.floor(place));
  const mixed = RAMP[low].map((value, at) => Math.round(value + (RAMP[low + 1][at] - value) * (place - low)));
  return `rgb(${mixed.join(',')})`;
}

const MARGIN = { left: 64, right: 20, top: 40, bottom: 52 };
const GAP = 8;

/**
 * Return the places [from, to) between which something was sampled without a gap: one that is 8 times the
 * usual step.
 * @param {{t: number[]}} track
 * @returns {Array<[number, number]>}
 */
export function pieces({ t }) {
  const steps = t
    .slice(1)
    .map((value, at) => value - t[at])
    .sort((a, b) => a - b);
  const most = GAP * (steps[steps.length >> 1] ?? 0) || Infinity;
  const begins = t.flatMap((value, at) => (at === 0 || value - t[at - 1] > most ? [at] : []));
  return begins.map((from, at) => [from, begins[at + 1] ?? t.length]);
}

/**
 * Return the least and the largest error of some tracks; null where none has one.
 * @param {Array<{error?: Api.Numbers|null}>} tracks
 * @returns {ErrorRange}
 */
export function errorRange(tracks) {
  const errors = tracks.flatMap((track) => track.error ?? []).filter((value) => value !== null);
  return errors.length
    ? { low: errors.reduce((a, b) => Math.min(a, b)), high: errors.reduce((a, b) => Math.max(a, b)) }
    : null;
}

/**
 * Points of a line with a break at each gap.
 * @param {{t: number[]}} track
 * @param {(index: number) => ChartPoint} point
 */
const broken = (track, point) =>
  pieces(track).flatMap(([from, to], at) => [
    ...(at ? [['-', '-']] : []),
    ...Array.from({ length: to - from }, (_, index) => point(from + index)),
  ]);

/**
 * Return the points of a track in a plane with their errors.
 * @param {Api.Track} track
 * @param {Axis} a
 * @param {Axis} b
 */
const withErrors = (track, a, b) =>
  track[a].map((value, at) => [value, track[b][at], track.error?.[at] ?? '-']);

/**
 * Return the option of a plane, metres equally long on both axes: a function of the chart's size.
 * @param {Array<{name: string, track: Api.Track, colour?: string}>} estimates
 * @param {Api.Track|null} reference ground truth
 * @param {Axis} a horizontal axis
 * @param {Axis} b vertical axis
 * @param {ErrorRange} range of the errors, which colour the paths; null: each path has a colour of its own
 * @param {Api.Track|null} [surveyed] control points, in the place of ground truth
 * @returns {(size: Size) => ChartOption}
 */
export function plane(estimates, reference, a, b, range, surveyed = null) {
  return ({ width, height }) => {
    const right = range ? 92 : MARGIN.right;
    const [spanA, spanB] = equal(
      [...estimates.map((one) => one.track), ...[reference, surveyed].flatMap((one) => one ?? [])],
      a,
      b,
      (width - MARGIN.left - right) / (height - MARGIN.top - MARGIN.bottom),
    );
    /** @param {Api.Track} track */
    const points = (track) => broken(track, (index) => [track[a][index], track[b][index]]);
    return {
      grid: { ...MARGIN, right },
      legend: legendOfLines(),
      tooltip: { trigger: 'item', formatter: (item) => `${item.seriesName}\n${tell(item.value, a, b)}` },
      xAxis: { type: 'value', name: `${a} [m]`, nameGap: 26, ...spanA, ...EDGES },
      yAxis: { type: 'value', name: `${b} [m]`, nameGap: 44, ...spanB, ...EDGES },
      visualMap: range
        ? {
            type: 'continuous',
            seriesIndex: [...estimates, ...(surveyed ? [surveyed] : [])].map(
              (_, at) => at + estimates.length + (reference ? 1 : 0),
            ),
            dimension: 2,
            min: range.low,
            max: range.high,
            right: 0,
            top: 'middle',
            itemHeight: 110,
            text: [`${number(range.high, 3)} m`, `${number(range.low, 3)} m`],
            inRange: { color: RAMP.map((one) => `rgb(${one.join(',')})`) },
          }
        : undefined,
      series: [
        ...(reference
          ? [
              {
                type: 'line',
                name: 'ground truth',
                data: points(reference),
                showSymbol: false,
                color: TRUTH,
                lineStyle: { width: 4, opacity: 0.45 },
                z: 1,
              },
            ]
          : []),
        // Poses without an error, which have no ground truth near them, are seen as a thin line.
        ...(range
          ? estimates.map((one, index) => ({
              type: 'line',
              name: clip(one.name, 40),
              showSymbol: false,
              silent: true,
              data: points(one.track),
              color: one.colour ?? COLOURS[index % COLOURS.length],
              lineStyle: { width: 1 },
              z: 2,
            }))
          : []),
        ...estimates.map((one, index) =>
          range
            ? {
                type: 'scatter',
                z: 3,
                name: clip(one.name, 40),
                symbolSize: 4,
                symbol: SYMBOLS[index % SYMBOLS.length],
                data: withErrors(one.track, a, b),
              }
            : {
                type: 'line',
                name: clip(one.name, 40),
                showSymbol: false,
                data: points(one.track),
                color: one.colour ?? COLOURS[index % COLOURS.length],
                lineStyle: { width: 1.8 },
              },
        ),
        ...(surveyed
          ? [
              {
                type: 'scatter',
                name: 'control points',
                data: withErrors(surveyed, a, b),
                symbol: 'diamond',
                symbolSize: 11,
                color: TRUTH,
                itemStyle: { borderColor: TRUTH, borderWidth: 1 },
                z: 4,
              },
            ]
          : []),
      ],
    };
  };
}

const SYMBOLS = ['circle', 'triangle', 'rect', 'diamond'];

/**
 * @param {any[]} point
 * @param {string} a
 * @param {string} b
 */
const tell = ([x, y, error], a, b) =>
  `${a} ${number(x)} m, ${b} ${number(y)} m${typeof error === 'number' ? `\nerror ${number(error)} m` : ''}`;

/** Axes stay at the edge, and their ends, which are where the data end, have no label. */
const EDGES = {
  axisLine: { onZero: false },
  axisLabel: {
    formatter: (/** @type {number} */ value) => short(value),
    showMinLabel: false,
    showMaxLabel: false,
  },
};

/** @param {number} value */
const short = (value) => String(Number(value.toPrecision(3)));

/**
 * The ends of both axes, a metre equally long on both.
 * @param {Api.Track[]} tracks
 * @param {Axis} a
 * @param {Axis} b
 * @param {number} aspect
 */
function equal(tracks, a, b, aspect) {
  /** @param {Axis} axis */
  const range = (axis) => {
    const values = tracks.flatMap((track) => track[axis]).filter((value) => value !== null);
    return [
      values.reduce((x, y) => Math.min(x, y), Infinity),
      values.reduce((x, y) => Math.max(x, y), -Infinity),
    ];
  };
  const [[lowA, highA], [lowB, highB]] = [range(a), range(b)];
  if (!Number.isFinite(lowA) || !Number.isFinite(lowB)) return [{}, {}];
  const span = 1.06 * Math.max(highB - lowB, (highA - lowA) / aspect, 1e-6);
  /**
   * @param {number} low
   * @param {number} high
   * @param {number} size
   */
  const around = (low, high, size) => ({ min: (low + high - size) / 2, max: (low + high + size) / 2 });
  return [around(lowA, highA, span * aspect), around(lowB, highB, span)];
}

/**
 * Return the option of something over time.
 * @param {Array<{name: string, t: number[], values: Api.Numbers, colour?: string}>} lines
 * @param {string} title of the vertical axis
 * @param {string} from of the horizontal one: when 0 is
 * @param {{legend?: boolean, span?: Array<number|string>}} [more] legend: also of one line; span: of the
 *   horizontal axis, where other charts have the same
 * @returns {ChartOption}
 */
export function overTime(
  lines,
  title,
  from,
  { legend = lines.length > 1, span = ['dataMin', 'dataMax'] } = {},
) {
  return {
    grid: { left: 72, right: 20, top: legend ? 40 : 14, bottom: 48 },
    legend: legend ? legendOfLines() : undefined,
    tooltip: {
      trigger: 'axis',
      axisPointer: { type: 'line' },
      formatter: (/** @type {Item[]} */ items) =>
        [
          `${number(items[0].value[0])} s`,
          ...items
            .filter((item) => typeof item.value[1] === 'number')
            .map((item) => `${item.seriesName}: ${number(item.value[1])}`),
        ].join('\n'),
    },
    xAxis: {
      type: 'value',
      name: from,
      nameGap: 26,
      min: span[0],
      max: span[1],
      axisLabel: { formatter: short, showMinLabel: false, showMaxLabel: false },
    },
    yAxis: { type: 'value', name: title, nameGap: 52, axisLine: { onZero: false } },
    series: lines.map((line, index) => ({
      type: 'line',
      name: clip(line.name, 40),
      showSymbol: false,
      color: line.colour ?? COLOURS[index % COLOURS.length],
      lineStyle: { width: 1.5 },
      data: broken(line, (at) => [line.t[at], line.values[at] ?? '-']),
    })),
  };
}

/**
 * What a dataset's time is counted from, the best known first.
 * @type {Record<string, string>}
 */
const ZEROS = {
  recording: 'the recording began',
  groundTruth: 'the ground truth began',
  estimate: 'the first pose',
};

/**
 * Return the clock that runs of a dataset share in one picture: when each run's time is 0, and what to call
 * the axis.
 * @param {Array<{dataset: string, clock: Api.Clock}>} runs
 */
export function shared(runs) {
  const kinds = Object.keys(ZEROS);
  /** @type {Map<string, Api.Clock>} */
  const clocks = new Map();
  for (const { dataset, clock } of runs) {
    const held = clocks.get(dataset);
    const [rank, best] = [kinds.indexOf(clock.of), held ? kinds.indexOf(held.of) : kinds.length];
    // Runs of other sensors or rates begin with other frames of the same recording: the earliest counts.
    if (rank < best || (rank === best && held && clock.start < held.start)) clocks.set(dataset, clock);
  }
  const used = kinds.filter((kind) => [...clocks.values()].some((clock) => clock.of === kind));
  return {
    zeros: new Map([...clocks].map(([dataset, clock]) => [dataset, clock.start])),
    title: `time since ${used.map((kind) => ZEROS[kind]).join(' or ')} [s]`,
  };
}

/**
 * Return the first and the last of some lines' times.
 * @param {number[][]} times
 */
export const spanOf = (times) => [
  times.reduce((least, t) => Math.min(least, t[0]), Infinity),
  times.reduce((most, t) => Math.max(most, t[t.length - 1]), -Infinity),
];

/**
 * Return sensor times as times since a zero.
 * @param {number[]} stamps
 * @param {number} zero
 */
export const since = (stamps, zero) => stamps.map((stamp) => stamp - zero);
