// SPDX-License-Identifier: Apache-2.0
/** How far each system goes along an axis until it fails: bars, and where the threshold surely lies. */
import { COLOURS } from '../core/chart.js';
import { clip, number } from '../core/format.js';
import { labelRoom, rowAxis, rowLines } from './rows.js';

/**
 * Return the chart of an axis, and its height.
 * @param {Api.Heading} axis
 * @param {Array<{name: string, cell: Api.ThresholdCell|null}>} rows
 * @returns {Drawn}
 */
export function reachChart(axis, rows) {
  const factor = axis.factor ?? 1;
  const tried = rows.flatMap(({ cell }) => (cell?.values ?? []).map((one) => one.value * factor));
  const [least, most] = [Math.min(...tried), Math.max(...tried)];
  const log = least > 0 && most > 30 * least;
  /** @type {any[]} */
  const [bars, sure, fails, open, passes, still] = [[], [], [], [], [], []];
  rows.forEach(({ name, cell }, at) => {
    if (!cell || cell.values.length === 0) return;
    const values = cell.values.map((one) => one.value * factor);
    const [start, end] = cell.falls
      ? [values[values.length - 1], values[0]]
      : [values[0], values[values.length - 1]];
    /** @param {number} value */
    const point = (value) => ({ value: [value, at], name, cell });
    if (cell.status === 'never fails') {
      bars.push([start, end, at]);
      open.push(point(end));
    } else if (cell.status === 'no effect seen') {
      bars.push([start, end, at]);
      still.push(point(end));
    } else if (cell.status === 'always fails') fails.push(point(start));
    else if (cell.status === 'found' && cell.passing !== null && cell.failing !== null) {
      bars.push([start, cell.passing * factor, at]);
      passes.push(point(cell.passing * factor));
      fails.push(point(cell.failing * factor));
      const [low, high] = cell.sure;
      sure.push([low === null ? least : low * factor, high === null ? most : high * factor, at]);
    } else {
      for (const one of cell.values)
        (one.share !== null && one.share >= 0.5 ? fails : passes).push(point(one.value * factor));
    }
  });
  /**
   * @param {string} name
   * @param {any[]} data
   * @param {Record<string, any>} look
   */
  const marks = (name, data, look) => ({ type: 'scatter', name, data, symbolSize: 10, z: 4, ...look });
  return {
    height: 96 + rows.length * 30,
    option: ({ width }) => ({
      grid: { left: labelRoom(width, 240), right: 30, top: 30, bottom: 50 },
      legend: { top: 0 },
      tooltip: {
        trigger: 'item',
        formatter: ({ data }) =>
          data?.cell
            ? `${clip(data.name, 80)}\n${clip(data.cell.sentence, 200)}\n${number(data.cell.runs)} runs`
            : '',
      },
      xAxis: { type: log ? 'log' : 'value', name: axis.label, nameGap: 26, min: least, max: most },
      yAxis: rowAxis(
        rows.map(({ name }) => name),
        width,
        240,
      ),
      series: [
        rowLines(bars, { stroke: COLOURS[5], lineWidth: 12 }),
        rowLines(sure, { stroke: COLOURS[0], lineWidth: 2 }),
        marks('passes', passes, { symbol: 'circle', symbolSize: 7, color: COLOURS[0] }),
        marks('fails', fails, { symbol: 'diamond', color: COLOURS[4] }),
        marks('never fails', open, { symbol: 'arrow', symbolRotate: -90, symbolSize: 13, color: COLOURS[2] }),
        marks('no effect seen', still, { symbol: 'emptyCircle', color: COLOURS[2] }),
      ],
    }),
  };
}
