// SPDX-License-Identifier: Apache-2.0
/** Contours: a figure over two settings, between the places where runs are, and nothing beyond them. */
import { axisName, cell, clip, number } from '../core/format.js';
import { ramp, SCALE } from '../core/scale.js';
import { robustLimits } from './limits.js';
import { valuesOf } from './multiples.js';
import { CROSS } from './failures.js';

/** Parts of each side of a field between four places: enough for lines to look smooth. */
const PARTS = 12;
const LEVELS = 8;
const FEW = 8;

/**
 * Return the figures of a board as a grid.
 * @param {Api.SurfaceCell[]} cells
 * @param {number} factor
 * @returns {{xs: Api.Value[], ys: Api.Value[], values: Api.Numbers[]}} values by y, then x; null for none
 */
export function gridOf(cells, factor) {
  const groups = /** @type {any} */ (cells.map(({ at }) => ({ keys: { x: at[0], y: at[1] } })));
  /** @param {string} name @returns {Api.Value[]} */
  const along = (name) => valuesOf(groups, name).filter((one) => one !== null);
  const [xs, ys] = [along('x'), along('y')];
  const values = ys.map(() => xs.map(() => /** @type {number|null} */ (null)));
  for (const { at, median } of cells) {
    const [column, row] = [xs, ys].map((all, axis) => all.indexOf(at[axis]));
    if (column >= 0 && row >= 0 && median !== null) values[row][column] = median * factor;
  }
  return { xs, ys, values };
}

/**
 * Return small fields between four places each, with a value between theirs at their corners: left below,
 * right below, left above, right above.
 * @param {number[]} xs
 * @param {number[]} ys
 * @param {Api.Numbers[]} values
 * @returns {Array<{x: [number, number], y: [number, number], corners: number[]}>}
 */
export function fields(xs, ys, values) {
  const found = [];
  for (let row = 0; row + 1 < ys.length; row += 1)
    for (let column = 0; column + 1 < xs.length; column += 1) {
      const four = [
        values[row][column],
        values[row][column + 1],
        values[row + 1][column],
        values[row + 1][column + 1],
      ];
      // Where one of them failed nothing is made up.
      if (four.some((value) => value === null)) continue;
      const [a, b, c, d] = /** @type {number[]} */ (four);
      /** @param {number} u @param {number} v */
      const between = (u, v) => (a * (1 - u) + b * u) * (1 - v) + (c * (1 - u) + d * u) * v;
      /** @param {number[]} ends @param {number} at @param {number} share */
      const place = (ends, at, share) => ends[at] + (ends[at + 1] - ends[at]) * share;
      for (let v = 0; v < PARTS; v += 1)
        for (let u = 0; u < PARTS; u += 1) {
          const [left, right, low, high] = [u / PARTS, (u + 1) / PARTS, v / PARTS, (v + 1) / PARTS];
          found.push({
            x: /** @type {[number, number]} */ ([place(xs, column, left), place(xs, column, right)]),
            y: /** @type {[number, number]} */ ([place(ys, row, low), place(ys, row, high)]),
            corners: [between(left, low), between(right, low), between(left, high), between(right, high)],
          });
        }
    }
  return found;
}

/**
 * Return the pieces of the line of a level within a field (marching squares): none, one or two.
 * @param {{x: [number, number], y: [number, number], corners: number[]}} field
 * @param {number} level
 * @returns {Array<[number[], number[]]>}
 */
export function pieces({ x, y, corners: [a, b, c, d] }, level) {
  /** @param {number} from @param {number} to */
  const share = (from, to) => (level - from) / (to - from);
  /** @param {number} from @param {number} to */
  const crossed = (from, to) => from < level !== to < level;
  const places = [];
  if (crossed(a, b)) places.push([x[0] + (x[1] - x[0]) * share(a, b), y[0]]);
  if (crossed(b, d)) places.push([x[1], y[0] + (y[1] - y[0]) * share(b, d)]);
  if (crossed(c, d)) places.push([x[0] + (x[1] - x[0]) * share(c, d), y[1]]);
  if (crossed(a, c)) places.push([x[0], y[0] + (y[1] - y[0]) * share(a, c)]);
  if (places.length < 2) return [];
  return places.length === 2
    ? [[places[0], places[1]]]
    : [
        [places[0], places[1]],
        [places[2], places[3]],
      ];
}

/**
 * Return the levels between two values at which lines are drawn.
 * @param {number} low
 * @param {number} high
 */
export const levelsOf = (low, high) =>
  high > low ? Array.from({ length: LEVELS - 1 }, (_, at) => low + ((high - low) * (at + 1)) / LEVELS) : [];

/**
 * Return the option of the contours of a board.
 * @param {{metric: Api.Heading, axes: Api.Heading[]}} data
 * @param {Api.SurfaceCell[]} cells
 * @returns {{option: ChartOption, notes: string[]}}
 */
export function contourChart({ metric, axes }, cells) {
  const factor = metric.factor ?? 1;
  const { xs, ys, values } = gridOf(cells, factor);
  const limits = robustLimits(values.flat());
  const [low, high] = limits ? [limits.low, limits.high] : [0, 1];
  const [x, y] = [placed(axes[0], xs), placed(axes[1], ys)];
  const all = fields(x.places, y.places, values);
  const levels = levelsOf(low, high);
  /** The middle of the band between two levels. @param {number} value */
  const banded = (value) =>
    high > low
      ? Math.min(LEVELS - 0.5, Math.max(0.5, Math.floor(((value - low) / (high - low)) * LEVELS) + 0.5)) /
        LEVELS
      : 0.5;
  /** @param {any} api @param {number[]} from @param {number[]} to */
  const line = (api, from, to) => {
    const [x1, y1] = api.coord(from);
    const [x2, y2] = api.coord(to);
    return { x1, y1, x2, y2 };
  };
  const lines = all.flatMap((field) => levels.flatMap((level) => pieces(field, level)));
  const failed = cells.filter((one) => one.median === null && one.total);
  /** @param {Api.SurfaceCell} one */
  const where = ({ at }) => [x.places[xs.indexOf(at[0])], y.places[ys.indexOf(at[1])]];
  return {
    notes: [
      limits && limits.above + limits.below
        ? `${limits.above + limits.below} medians lie beyond the colours: their points have the last one`
        : '',
      failed.length ? 'A cross: the median run failed there, and no colour is made up beside it.' : '',
    ].filter(Boolean),
    option: {
      grid: { left: 90, right: 96, top: 16, bottom: 54 },
      tooltip: {
        trigger: 'item',
        formatter: (/** @type {Item} */ item) => (item.data?.cell ? told(item.data.cell, metric, axes) : ''),
      },
      xAxis: { ...x.axis, name: clip(axisName(axes[0]), 50), nameGap: 28 },
      yAxis: { ...y.axis, name: clip(axisName(axes[1]), 40), nameGap: 62 },
      visualMap: {
        type: 'continuous',
        seriesIndex: 2,
        dimension: 2,
        min: low,
        max: high,
        right: 0,
        top: 'middle',
        itemHeight: 130,
        text: [number(high, 3), number(low, 3)],
        inRange: { color: SCALE },
      },
      series: [
        {
          type: 'custom',
          silent: true,
          data: all.map(({ x: [left], y: [below] }) => [left, below]),
          renderItem: (/** @type {any} */ params, /** @type {any} */ api) => {
            const field = all[params.dataIndex];
            const [left, top] = api.coord([field.x[0], field.y[1]]);
            const [right, bottom] = api.coord([field.x[1], field.y[0]]);
            const middle = field.corners.reduce((sum, value) => sum + value, 0) / 4;
            // A pixel more, or the fields show seams.
            const shape = { x: left, y: top, width: right - left + 1, height: bottom - top + 1 };
            return { type: 'rect', shape, style: { fill: ramp(banded(middle)) } };
          },
        },
        {
          type: 'custom',
          silent: true,
          data: lines.map(([from]) => from),
          renderItem: (/** @type {any} */ params, /** @type {any} */ api) => ({
            type: 'line',
            shape: line(api, lines[params.dataIndex][0], lines[params.dataIndex][1]),
            style: { stroke: '#ffffffb0', lineWidth: 1 },
          }),
        },
        {
          type: 'scatter',
          symbolSize: 11,
          itemStyle: { borderColor: '#16191d', borderWidth: 1 },
          data: cells
            .filter((one) => one.median !== null && where(one).every((place) => place !== undefined))
            .map((one) => ({ value: [...where(one), (one.median ?? 0) * factor], cell: one })),
        },
        {
          type: 'scatter',
          symbol: CROSS,
          symbolSize: 11,
          data: failed
            .filter((one) => where(one).every((place) => place !== undefined))
            .map((one) => ({
              value: where(one),
              cell: one,
              itemStyle: { borderColor: '#c0392b', borderWidth: 2 },
            })),
        },
      ],
    },
  };
}

/**
 * Return the places of values along an axis: numbers lie where they are, others one after the other.
 * @param {Api.Heading} heading
 * @param {Api.Value[]} values
 */
function placed(heading, values) {
  const numeric = values.every((value) => typeof value === 'number');
  const places = numeric
    ? values.map((value) => Number(value) * (heading.factor ?? 1))
    : values.map((_, at) => at);
  const [low, high] = [Math.min(...places), Math.max(...places)];
  const room = (high - low) * 0.06 || 0.5;
  return {
    places,
    axis: {
      type: 'value',
      min: low - room,
      max: high + room,
      axisTick: places.length <= FEW ? { customValues: places } : {},
      splitLine: { show: false },
      axisLabel: {
        ...(places.length <= FEW ? { customValues: places } : { showMinLabel: false, showMaxLabel: false }),
        ...(numeric ? {} : { formatter: (/** @type {number} */ at) => clip(cell(values[at] ?? ''), 18) }),
      },
    },
  };
}

/**
 * @param {Api.SurfaceCell} one
 * @param {Api.Heading} metric
 * @param {Api.Heading[]} axes
 */
const told = (one, metric, axes) =>
  [
    ...axes.map((axis, at) => `${clip(axisName(axis), 40)}: ${clip(cell(one.at[at], axis), 40)}`),
    `${clip(axisName(metric), 40)}, median: ${one.median === null ? 'failed' : cell(one.median, metric)}`,
    `${one.n} of ${one.total} runs reach a value`,
  ].join('\n');
