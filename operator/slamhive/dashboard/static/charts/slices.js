// SPDX-License-Identifier: Apache-2.0
/** Slices: a figure over the values of one setting, whatever the others are; one vertical axis for all. */
import { COLOURS } from '../core/chart.js';
import { axisName, cell, clip, number, signOf } from '../core/format.js';
import { robustLimits, roundEnds } from './limits.js';
import { CROSS } from './failures.js';

/**
 * Return the limits that the slices of a board share.
 * @param {Record<string, Api.SurfaceCell[]>} slices
 * @param {number} factor
 * @param {boolean} log
 */
export const sharedLimits = (slices, factor, log) =>
  robustLimits(
    Object.values(slices).flatMap((cells) =>
      cells.flatMap((one) =>
        [one.best, one.low, one.median, one.high].map((value) => value && value * factor),
      ),
    ),
    { log },
  );

/**
 * Return the option of one slice.
 * @param {Api.Heading} metric
 * @param {Api.Heading} setting
 * @param {Api.SurfaceCell[]} cells one a value
 * @param {Limits|null} limits
 * @param {boolean} log
 * @returns {ChartOption}
 */
export function sliceChart(metric, setting, cells, limits, log) {
  const factor = metric.factor ?? 1;
  const ends = roundEnds(limits, { log });
  const [floor, ceiling] = [ends.min ?? 0, ends.max ?? 1];
  const larger = signOf(metric) < 0;
  const failed = larger ? floor : ceiling;
  const known = cells.filter((one) => one.at[0] !== null);
  const names = known.map((one) => clip(cell(one.at[0], setting), 18));
  /** @param {number|null} value what fails is beyond the end */
  const shown = (value) => (value === null ? failed : Math.max(floor, Math.min(ceiling, value * factor)));
  return {
    grid: { left: 66, right: 14, top: 12, bottom: 50 },
    tooltip: {
      trigger: 'item',
      formatter: (/** @type {Item} */ item) => {
        const one = known[item.dataIndex];
        return [
          `${clip(axisName(setting), 40)}: ${names[item.dataIndex]}`,
          `${bestOf(metric)} ${value(one.best, metric)}, median ${value(one.median, metric)}`,
          `middle half: ${value(one.low, metric)} to ${value(one.high, metric)}`,
          `${number(one.n)} of ${number(one.total)} runs reach a value`,
        ].join('\n');
      },
    },
    xAxis: {
      type: 'category',
      data: names,
      name: clip(axisName(setting), 40),
      nameGap: 30,
      axisLabel: { rotate: names.length > 8 ? 30 : 0 },
    },
    yAxis: { type: log ? 'log' : 'value', ...ends, name: `${clip(axisName(metric), 30)}`, nameGap: 48 },
    series: [
      {
        // The middle half of the runs; open where it reaches the failed ones.
        type: 'custom',
        data: known.map((one, at) => [at, shown(one.low), shown(one.high)]),
        renderItem: (/** @type {any} */ params, /** @type {any} */ api) => {
          const one = known[params.dataIndex];
          if (!one.total || (larger ? one.high : one.low) === null) return null;
          const [x, bottom] = api.coord([api.value(0), api.value(1)]);
          const [, top] = api.coord([api.value(0), api.value(2)]);
          const width = Math.min(26, api.size([1, 0])[0] * 0.5);
          return {
            type: 'rect',
            shape: { x: x - width / 2, y: top, width, height: Math.max(1, bottom - top) },
            style: { fill: COLOURS[0], opacity: 0.25 },
          };
        },
      },
      {
        type: 'line',
        symbol: 'circle',
        symbolSize: 8,
        color: COLOURS[0],
        lineStyle: { width: 1.5 },
        data: known.map((one, at) =>
          one.median === null
            ? {
                value: [at, one.total ? failed : '-'],
                symbol: CROSS,
                itemStyle: { color: 'transparent', borderColor: '#c0392b', borderWidth: 2 },
              }
            : {
                value: [at, shown(one.median)],
                ...(one.median * factor > ceiling ? { symbol: 'triangle' } : {}),
              },
        ),
      },
      {
        type: 'scatter',
        symbol: 'diamond',
        symbolSize: 7,
        color: COLOURS[1],
        data: known.map((one, at) => [at, one.best === null ? '-' : shown(one.best)]),
      },
    ],
  };
}

/** @param {number|null} figure @param {Api.Heading} metric */
const value = (figure, metric) => (figure === null ? 'failed' : cell(figure, metric));

/** What the first run by a figure is called. @param {Api.Heading} metric */
export const bestOf = (metric) => (metric.better ? 'best' : 'smallest');
