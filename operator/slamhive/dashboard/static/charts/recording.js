// SPDX-License-Identifier: Apache-2.0
/** A recording: what covers which time, how often messages come, the path, the IMU. */
import { COLOURS } from '../core/chart.js';
import { clip, number } from '../core/format.js';
import { SCALE } from '../core/scale.js';
import { plane } from './trajectory.js';

const GAP = 'rgba(192, 57, 43, 0.25)';

/**
 * A bar for each sensor and the ground truth, interrupted by gaps.
 * @param {Api.Overview} data
 * @returns {ChartOption}
 */
export function coverage(data) {
  /** @type {Array<{name: string, first: number|null, last: number|null, gaps: number[][]}>} */
  const all = [...data.sensors, ...(data.truth ? [{ ...data.truth, name: 'ground truth', gaps: [] }] : [])];
  const rows = all.filter((one) => one.first !== null).reverse();
  return {
    grid: { left: 110, right: 24, top: 8, bottom: 46 },
    xAxis: { type: 'value', scale: true, name: 's since the start', nameGap: 28 },
    yAxis: { type: 'category', data: rows.map((one) => clip(one.name, 16)) },
    tooltip: { trigger: 'item', formatter: (/** @type {Item} */ item) => item.seriesName },
    series: rows.map((one, at) => ({
      type: 'line',
      name: `${clip(one.name, 40)}: ${number(one.first, 5)} s to ${number(one.last, 5)} s`,
      symbol: 'none',
      lineStyle: { width: 14, cap: 'butt' },
      color: COLOURS[at % COLOURS.length],
      data: spans(/** @type {any} */ (one)).flatMap(([from, to]) => [
        [from, at],
        [to, at],
        ['-', '-'],
      ]),
    })),
  };
}

/**
 * Return the spans between gaps, by time.
 * @param {{first: number, last: number, gaps: number[][]}} one
 */
export function spans({ first, last, gaps }) {
  const holes = [...gaps].sort((a, b) => a[0] - b[0]);
  const begins = [first, ...holes.map(([, end]) => end)];
  const ends = [...holes.map(([begin]) => begin), last];
  return begins.map((from, at) => [from, ends[at]]);
}

/**
 * The path of the ground truth in a plane, coloured by time, with its start.
 * @param {NonNullable<Api.Overview['truth']>} truth
 * @param {'x'|'y'|'z'} a
 * @param {'x'|'y'|'z'} b
 * @returns {(size: Size) => ChartOption}
 */
export const path = (truth, a, b) => (size) => {
  const option = plane([], [{ name: 'ground truth', track: /** @type {any} */ (truth) }], a, b, null)(size);
  const step = Math.max(1, Math.ceil(truth.t.length / SCALE.length));
  return {
    ...option,
    legend: undefined,
    tooltip: undefined,
    series: [
      ...SCALE.map((color, at) => ({
        type: 'line',
        symbol: 'none',
        color,
        lineStyle: { width: 2 },
        data: truth[a]
          .slice(at * step, (at + 1) * step + 1)
          .map((value, index) => [value, truth[b][at * step + index]]),
      })),
      {
        type: 'scatter',
        name: 'start',
        symbol: 'emptyCircle',
        symbolSize: 12,
        color: SCALE[0],
        data: [[truth[a][0], truth[b][0]]],
      },
    ],
  };
};

/**
 * Messages a second over time, gaps shaded.
 * @param {Api.Overview} data
 * @param {Api.SensorView} sensor
 * @returns {ChartOption}
 */
export function rate(data, sensor) {
  return {
    ...overTime(data, 'Hz'),
    series: [
      {
        type: 'line',
        name: sensor.name,
        symbol: 'none',
        color: COLOURS[0],
        data: sensor.rates.map((value, at) => [middle(data, sensor.rates.length, at), value]),
        markArea: {
          silent: true,
          itemStyle: { color: GAP },
          data: sensor.gaps.map(([from, to]) => [{ xAxis: from }, { xAxis: to }]),
        },
      },
    ],
  };
}

/**
 * Least and greatest numbers of an IMU's axes over time.
 * @param {Api.Overview} data
 * @param {Record<string, Api.Numbers[]>} axes
 * @param {string} unit
 * @returns {ChartOption}
 */
export function envelopes(data, axes, unit) {
  return {
    ...overTime(data, unit),
    legend: { data: Object.keys(axes) },
    series: Object.entries(axes).flatMap(([axis, ends], at) =>
      ends.map((values) => ({
        type: 'line',
        name: axis,
        symbol: 'none',
        color: COLOURS[at],
        lineStyle: { width: 1 },
        data: values.map((value, index) => [middle(data, values.length, index), value]),
      })),
    ),
  };
}

/**
 * @param {Api.Overview} data
 * @param {string} unit
 * @returns {ChartOption}
 */
const overTime = (data, unit) => ({
  grid: { left: 72, right: 24, top: 30, bottom: 46 },
  xAxis: {
    type: 'value',
    min: 0,
    max: data.seconds,
    name: 's since the start',
    nameGap: 28,
    axisLabel: { showMaxLabel: false },
  },
  yAxis: { type: 'value', name: unit, nameGap: 46 },
  tooltip: { trigger: 'axis' },
});

/**
 * @param {Api.Overview} data
 * @param {number} count
 * @param {number} at
 */
const middle = (data, count, at) => ((at + 0.5) * data.seconds) / count;

/**
 * Points of a cloud from above, in the sensor's frame.
 * @param {{x: number[], y: number[]}} cloud
 * @returns {ChartOption}
 */
export function above({ x, y }) {
  const far = x.map((value, at) => Math.max(Math.abs(value), Math.abs(y[at]))).sort((a, b) => a - b);
  const reach = Math.max(0.1, far[Math.floor(0.98 * (far.length - 1))] ?? 1);
  return {
    grid: { left: 56, right: 16, top: 12, bottom: 46 },
    xAxis: { type: 'value', min: -reach, max: reach, name: 'x [m]', nameGap: 28 },
    yAxis: { type: 'value', min: -reach, max: reach, name: 'y [m]', nameGap: 40 },
    series: [
      { type: 'scatter', symbolSize: 2, color: COLOURS[0], data: x.map((value, at) => [value, y[at]]) },
      { type: 'scatter', name: 'sensor', symbolSize: 8, color: COLOURS[1], data: [[0, 0]] },
    ],
  };
}
