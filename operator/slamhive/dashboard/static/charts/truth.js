// SPDX-License-Identifier: Apache-2.0
/** Distance of different algorithms' mean from the ground truth over time, suspect stretches shaded. */
import { COLOURS } from '../core/chart.js';
import { number } from '../core/format.js';
import { band } from './line.js';

const SUSPECT = 'rgba(213, 94, 0, 0.22)';

/**
 * Return the option of the chart: the distance with its standard error, and the limit.
 * @param {Api.Suspicion} found
 * @returns {ChartOption}
 */
export function truthChart(found) {
  const begin = found.profile[0][0];
  const points = found.profile.map(([stamp, metres, error]) => ({
    // Seconds of today have few digits behind the point, and differences of them more.
    x: Math.round((stamp - begin) * 1000) / 1000,
    middle: metres,
    low: Math.max(0, metres - error),
    high: metres + error,
    interval: null,
  }));
  return {
    grid: { left: 72, right: 24, top: 30, bottom: 46 },
    tooltip: {
      trigger: 'axis',
      formatter: (items) => {
        const point = points[items[0]?.dataIndex];
        if (!point) return '';
        const error = number(point.high - point.middle, 2);
        return `${number(point.x, 5)} s\n${number(point.middle)} m from the truth ± ${error}`;
      },
    },
    xAxis: { type: 'value', name: 'time [s]', nameGap: 28, max: points[points.length - 1].x },
    yAxis: { type: 'value', name: 'from the truth [m]', nameGap: 52, min: 0 },
    series: [
      band('standard error', points, COLOURS[0]),
      {
        type: 'line',
        name: 'distance',
        symbol: 'none',
        color: COLOURS[0],
        data: points.map((point) => [point.x, point.middle]),
        markLine: {
          silent: true,
          symbol: 'none',
          data: [{ yAxis: found.limit }],
          label: { formatter: 'suspect from here on', position: 'insideEndTop', color: COLOURS[0] },
          lineStyle: { type: 'dashed', color: COLOURS[0] },
        },
        markArea: {
          silent: true,
          itemStyle: { color: SUSPECT },
          data: found.stretches.map((part) => [{ xAxis: part.begin - begin }, { xAxis: part.end - begin }]),
        },
      },
    ],
  };
}
