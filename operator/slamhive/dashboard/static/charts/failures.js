// SPDX-License-Identifier: Apache-2.0
/** What failed has no value: it is a cross in a grey field of its own, beside the axes or above them. */

export const CROSS = 'path://M0 0L10 10M10 0L0 10';
const [ACROSS, DOWN, GAP] = [54, 20, 8];

/**
 * Return the option of a chart with a field for what failed; the same option where nothing did.
 * @param {any} option with one grid and one axis each way
 * @param {'beside'|'above'} where beside the axes of a chart of rows, which share their places with the
 *   field, or above those of a chart over x
 * @param {any[]} series of what failed: their values are places along the shared axis, numbers of the field
 *   (0) and what else they have
 * @param {number} [width] of the chart, in pixels; what a field beside it needs
 * @param {string[]} [names] what stands in the field: a field above the axes may have several rows
 */
export function withField(option, where, series, width = 0, names = ['failed']) {
  if (!series.some((one) => one.data.length)) return option;
  const { grid, xAxis, yAxis } = option;
  const bare = { gridIndex: 1, axisLine: { show: false }, axisTick: { show: false }, name: '' };
  const field = { ...bare, type: 'category', data: names, splitLine: { show: false } };
  const back = { show: true, borderWidth: 0, backgroundColor: 'rgba(128, 136, 146, 0.18)' };
  const above = where === 'above';
  const down = DOWN * names.length;
  return {
    ...option,
    grid: above
      ? [
          { ...grid, top: grid.top + down + GAP },
          { ...back, left: grid.left, right: grid.right, top: grid.top, height: down },
        ]
      : [
          { ...grid, right: grid.right + ACROSS + GAP },
          { ...back, left: width - grid.right - ACROSS, width: ACROSS, top: grid.top, bottom: grid.bottom },
        ],
    xAxis: [xAxis, above ? { ...xAxis, ...bare, show: false } : field],
    yAxis: [yAxis, above ? field : { ...yAxis, ...bare, show: false }],
    series: [
      ...option.series,
      ...series.map((one) => ({
        type: 'scatter',
        symbol: CROSS,
        symbolSize: 9,
        ...one,
        xAxisIndex: 1,
        yAxisIndex: 1,
      })),
    ],
  };
}

/**
 * Return the look of a cross of a colour.
 * @param {string} [color]
 */
export const crossed = (color = '#c0392b') => ({ color, borderColor: color, borderWidth: 2 });
