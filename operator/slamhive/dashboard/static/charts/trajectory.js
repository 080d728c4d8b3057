// SPDX-License-Identifier: Apache-2.0
/** Trajectories from above and from the sides, and what happened over time. */
import { COLOURS } from '../core/chart.js';
import { clip, number } from '../core/format.js';

/** The three planes: name and the two axes. */
export const PLANES = [['xy', 'x', 'y'], ['xz', 'x', 'z'], ['yz', 'y', 'z']];

const MARGIN = { left: 64, right: 20, top: 40, bottom: 52 };

/** Return the option of a plane, metres equally long on both axes: a function of the chart's size.
 * @param {Array<{name: string, track: object}>} estimates tracks {x, y, z, error?} @param {object|null} reference ground truth
 * @param {string} a horizontal axis @param {string} b vertical axis */
export function plane(estimates, reference, a, b) {
  const single = estimates.length === 1;
  const coloured = single && estimates[0].track.error?.some((value) => value !== null);
  const errors = coloured ? estimates[0].track.error.filter((value) => value !== null) : [];
  return ({ width, height }) => {
    const right = coloured ? 92 : MARGIN.right;
    const [spanA, spanB] = equal([...estimates.map((one) => one.track), ...(reference ? [reference] : [])], a, b, (width - MARGIN.left - right) / (height - MARGIN.top - MARGIN.bottom));
    const pairs = (track) => track[a].map((value, index) => [value, track[b][index]]);
    return {
      grid: { ...MARGIN, right }, legend: {}, tooltip: { trigger: 'item', formatter: (item) => `${item.seriesName}\n${item.value.map((value) => number(value)).join(', ')} m` },
      xAxis: { type: 'value', name: `${a} [m]`, nameGap: 26, ...spanA, ...EDGES }, yAxis: { type: 'value', name: `${b} [m]`, nameGap: 44, ...spanB, ...EDGES },
      visualMap: coloured ? { type: 'continuous', seriesIndex: reference ? 1 : 0, dimension: 2, min: Math.min(...errors), max: Math.max(...errors), text: ['error [m]', ''], precision: 3, right: 0, top: 'middle', itemHeight: 110, inRange: { color: ['#2166ac', '#35b779', '#e6b800', '#d7301f'] } } : undefined,
      series: [
        ...(reference ? [{ type: 'line', name: 'ground truth', data: pairs(reference), showSymbol: false, color: '#8a929b', lineStyle: { width: 1.5 }, z: 1 }] : []),
        ...estimates.map((one, index) => (coloured
          ? { type: 'scatter', name: clip(one.name, 40), symbolSize: 4, data: one.track[a].map((value, at) => [value, one.track[b][at], one.track.error[at]]) }
          : { type: 'line', name: clip(one.name, 40), showSymbol: false, data: pairs(one.track), color: COLOURS[index % COLOURS.length], lineStyle: { width: 1.8 } })),
      ],
    };
  };
}

/** Axes stay at the edge, and their ends, which are where the data end, have no label. */
const EDGES = { axisLine: { onZero: false }, axisLabel: { formatter: (value) => short(value), showMinLabel: false, showMaxLabel: false } };

const short = (value) => String(Number(value.toPrecision(3)));

function equal(tracks, a, b, aspect) {
  const range = (axis) => {
    const values = tracks.flatMap((track) => track[axis]).filter((value) => value !== null);
    return [values.reduce((x, y) => Math.min(x, y), Infinity), values.reduce((x, y) => Math.max(x, y), -Infinity)];
  };
  const [[lowA, highA], [lowB, highB]] = [range(a), range(b)];
  if (!Number.isFinite(lowA) || !Number.isFinite(lowB)) return [{}, {}];
  const span = 1.06 * Math.max(highB - lowB, (highA - lowA) / aspect, 1e-6);
  const around = (low, high, size) => ({ min: (low + high - size) / 2, max: (low + high + size) / 2 });
  return [around(lowA, highA, span * aspect), around(lowB, highB, span)];
}

/** Return the option of something over time. @param {Array<{name: string, t: number[], values: Array<number|null>}>} lines @param {string} title of the vertical axis */
export function overTime(lines, title, from = 'time [s]') {
  return {
    grid: { left: 72, right: 20, top: lines.length > 1 ? 40 : 14, bottom: 48 }, legend: lines.length > 1 ? {} : undefined,
    tooltip: { trigger: 'axis', axisPointer: { type: 'line' }, formatter: (items) => [`${number(items[0].value[0])} s`, ...items.map((item) => `${item.seriesName}: ${number(item.value[1])}`)].join('\n') },
    xAxis: { type: 'value', name: from, nameGap: 26, min: 'dataMin', max: 'dataMax', axisLabel: { formatter: short } }, yAxis: { type: 'value', name: title, nameGap: 52 },
    series: lines.map((line, index) => ({ type: 'line', name: clip(line.name, 40), showSymbol: false, sampling: 'lttb', color: COLOURS[index % COLOURS.length], lineStyle: { width: 1.5 }, data: line.t.map((t, at) => [t, line.values[at]]) })),
  };
}

/** Return times since the first. */
export const since = (t) => t.map((value) => value - t[0]);
