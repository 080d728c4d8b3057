// SPDX-License-Identifier: Apache-2.0
/** Trajectories from above and from the sides, and what happened over time. */
import { COLOURS, legendOfLines } from '../core/chart.js';
import { clip, number } from '../core/format.js';
import { SCALE } from '../core/scale.js';

/** The three planes: name and the two axes. */
/** @type {Array<[string, Axis, Axis]>} */
export const PLANES = [
  ['xy', 'x', 'y'],
  ['xz', 'x', 'z'],
  ['yz', 'y', 'z'],
];

/** Colour of the ground truth. */
export const TRUTH = '#8a929b';

const MARGIN = { left: 64, right: 20, top: 40, bottom: 52 };
const GAP = 8;
/** Characters of a name in a legend: a name of Kubernetes has 63 at most. */
const NAME = 90;
/** One colour of errors is grey, too. */
const DASHED = 'path://M0 0L0 0M0 5L7 5L7 9L0 9ZM11 5L18 5L18 9L11 9ZM18 14L18 14';
/** What a path coloured by its errors looks like in a legend. */
const GRADIENT = {
  type: 'linear',
  x: 0,
  x2: 1,
  y: 0,
  y2: 0,
  colorStops: SCALE.map((color, at) => ({ offset: at / (SCALE.length - 1), color })),
};

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
 * Return 0 and the largest error of some tracks; null where none has one.
 * @param {Array<{error?: Api.Numbers|null}>} tracks
 * @returns {ErrorRange}
 */
export function errorRange(tracks) {
  const errors = tracks.flatMap((track) => track.error ?? []).filter((value) => value !== null);
  return errors.length ? { low: 0, high: errors.reduce((a, b) => Math.max(a, b)) } : null;
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
 * Return the ground truths of runs, one for each dataset and each frame that poses are of, as the LiDAR's
 * and the IMU's.
 * @param {Array<{of: string, dataset?: string, reference: Api.Track|null}>} runs of: what has a frame
 * @returns {Truth[]}
 */
export function truthsOf(runs) {
  /** @type {Array<{track: Api.Track, dataset?: string, of: Set<string>}>} */
  const found = [];
  for (const { of, dataset, reference: track } of runs) {
    if (!track) continue;
    const same = found.find((one) => one.dataset === dataset && !apart(one.track, track));
    if (same) same.of.add(of);
    else found.push({ track, dataset, of: new Set([of]) });
  }
  const several = new Set(found.map((one) => one.dataset)).size > 1;
  return found.map(({ track, dataset, of }) => {
    const frames = found.filter((one) => one.dataset === dataset).length > 1;
    const whose = [frames && [...of].join(', '), several && dataset].filter(Boolean).join(' on ');
    return { track, name: whose ? `ground truth of ${whose}` : 'ground truth' };
  });
}

/**
 * Tell whether two tracks are a millimetre or more apart at the first time that both have.
 * @param {Api.Track} one
 * @param {Api.Track} other
 */
function apart(one, other) {
  const places = new Map(other.t.map((t, at) => [t, at]));
  const a = one.t.findIndex((t) => places.has(t));
  const b = places.get(one.t[a]) ?? -1;
  return a >= 0 && Math.hypot(one.x[a] - other.x[b], one.y[a] - other.y[b], one.z[a] - other.z[b]) > 1e-3;
}

/**
 * Return the option of a plane, metres equally long on both axes: a function of the chart's size.
 * @param {Array<{name: string, track: Api.Track, colour?: string}>} estimates
 * @param {Truth[]} truths of truthsOf
 * @param {Axis} a horizontal axis
 * @param {Axis} b vertical axis
 * @param {ErrorRange} range of the errors, which colour the paths; null: each path has a colour of its own
 * @param {Api.Track|null} [surveyed] control points, in the place of ground truth
 * @returns {(size: Size) => ChartOption}
 */
export function plane(estimates, truths, a, b, range, surveyed = null) {
  return ({ width, height }) => {
    const right = range ? 92 : MARGIN.right;
    const [spanA, spanB] = equal(
      [...[...estimates, ...truths].map((one) => one.track), ...(surveyed ? [surveyed] : [])],
      a,
      b,
      (width - MARGIN.left - right) / (height - MARGIN.top - MARGIN.bottom),
    );
    /** @param {Api.Track} track */
    const points = (track) => broken(track, (index) => [track[a][index], track[b][index]]);
    return {
      grid: { ...MARGIN, right },
      legend: range
        ? {
            ...legendOfLines(),
            data: [
              ...truths.map((one) => ({ name: clip(one.name, NAME), icon: DASHED })),
              ...estimates.map((one) => ({ name: clip(one.name, NAME), itemStyle: { color: GRADIENT } })),
              ...(surveyed ? ['control points'] : []),
            ],
          }
        : legendOfLines(),
      tooltip: {
        trigger: 'item',
        formatter: (item) => `${item.name || item.seriesName}\n${tell(item.value, a, b)}`,
      },
      xAxis: { type: 'value', name: `${a} [m]`, nameGap: 26, ...spanA, ...EDGES },
      yAxis: { type: 'value', name: `${b} [m]`, nameGap: 44, ...spanB, ...EDGES },
      visualMap: range
        ? {
            type: 'continuous',
            seriesIndex: [...estimates, ...(surveyed ? [surveyed] : [])].map(
              (_, at) => at + estimates.length + truths.length,
            ),
            dimension: 2,
            min: 0,
            max: range.high,
            right: 0,
            top: 'middle',
            itemHeight: 110,
            text: [`${number(range.high, 3)} m`, '0 m'],
            inRange: { color: SCALE },
          }
        : undefined,
      series: [
        ...truths.map((one, at) => ({
          type: 'line',
          name: clip(one.name, NAME),
          data: points(one.track),
          showSymbol: false,
          color: TRUTH,
          lineStyle: { width: 4, opacity: 0.45, type: range || at ? 'dashed' : 'solid' },
          z: 1,
        })),
        // Poses without an error, which have no ground truth near them, are seen as a thin line.
        ...(range
          ? estimates.map((one, index) => ({
              type: 'line',
              name: clip(one.name, NAME),
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
            ? coloured(one, a, b)
            : {
                type: 'line',
                name: clip(one.name, NAME),
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
        ...marks(estimates, a, b, range !== null),
      ],
    };
  };
}

/**
 * Return the series of a path whose colours tell its errors; where they aren't known it has no line.
 * @param {{name: string, track: Api.Track}} one
 * @param {Axis} a
 * @param {Axis} b
 */
function coloured({ name, track }, a, b) {
  const data = withErrors(track, a, b);
  // A pose alone is a dot.
  const next = new Map(
    pieces(track).flatMap(([from, to]) =>
      to - from === 1
        ? [[from, from]]
        : Array.from({ length: to - from - 1 }, (_, at) => [from + at, from + at + 1]),
    ),
  );
  return {
    type: 'custom',
    z: 3,
    name: clip(name, NAME),
    data,
    renderItem: (/** @type {any} */ { dataIndex: at }, /** @type {any} */ api) => {
      const to = next.get(at);
      if (data[at][2] === '-' || to === undefined) return null;
      const [[x1, y1], [x2, y2]] = [api.coord(data[at]), api.coord(data[to])];
      const style = { stroke: api.visual('color'), lineWidth: 3, lineCap: 'round' };
      return { type: 'line', shape: { x1, y1, x2, y2 }, style };
    },
  };
}

/** Colour of the ends of a path whose colours tell its errors: none of theirs. */
const ENDS = '#d55e00';

/**
 * Return the ends of a path: the places of its poses, what each is called, and the colour of their marks.
 * @param {{track: Api.Track, colour?: string}} path
 * @param {number} index of it among others
 * @param {boolean} byError
 */
export const endsOf = ({ track, colour }, index, byError) =>
  track.t.length
    ? {
        places: [0, track.t.length - 1],
        colour: byError ? ENDS : (colour ?? COLOURS[index % COLOURS.length]),
      }
    : null;

/**
 * The series that mark where paths begin, by a ring, and end, by a dot: both are seen where a path is closed.
 * They have no names, so no place in the legend.
 * @param {Array<{track: Api.Track, colour?: string}>} estimates
 * @param {Axis} a
 * @param {Axis} b
 * @param {boolean} byError
 */
const marks = (estimates, a, b, byError) =>
  ['start', 'end'].map((name, which) => ({
    type: 'scatter',
    symbol: which ? 'circle' : 'emptyCircle',
    symbolSize: which ? 8 : 15,
    z: 5,
    label: {
      show: estimates.length === 1,
      formatter: name,
      position: which ? 'bottom' : 'top',
      color: 'inherit',
    },
    data: estimates.flatMap((one, index) => {
      const found = endsOf(one, index, byError);
      if (!found) return [];
      const at = found.places[which];
      const itemStyle = { color: found.colour, borderWidth: which ? 0 : 2 };
      return [{ name, value: [one.track[a][at], one.track[b][at]], itemStyle }];
    }),
  }));

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
      name: clip(line.name, NAME),
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
