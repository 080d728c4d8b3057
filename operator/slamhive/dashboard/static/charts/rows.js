// SPDX-License-Identifier: Apache-2.0
/** Charts of one row for each competitor or setting: names at the left, lines between two values. */

/**
 * Return the width for names left of a chart, in pixels: a phone keeps most of its width for the chart.
 * @param {number} width
 * @param {number} most
 */
export const labelRoom = (width, most) => Math.min(most, Math.round(width * 0.36));

/**
 * Return the axis that names the rows, the first one on top.
 * @param {string[]} names
 * @param {number} width of the chart, in pixels
 * @param {number} most width of the names, in pixels
 * @param {Record<string, any>} [label] more of how the names look
 */
export const rowAxis = (names, width, most, label = {}) => ({
  type: 'category',
  inverse: true,
  data: names,
  name: '',
  axisLabel: { interval: 0, width: labelRoom(width, most) - 14, overflow: 'truncate', ...label },
});

/**
 * Return the series of a line in each row, from one value to another.
 * @param {any[]} data from, to, number of the row
 * @param {Record<string, any>} style
 */
export const rowLines = (data, style) => ({
  type: 'custom',
  silent: true,
  tooltip: { show: false },
  encode: { x: [0, 1], y: 2 },
  data,
  /**
   * @param {unknown} _
   * @param {any} api
   */
  renderItem: (_, api) => {
    const [from, to] = [api.coord([api.value(0), api.value(2)]), api.coord([api.value(1), api.value(2)])];
    return { type: 'line', shape: { x1: from[0], y1: from[1], x2: to[0], y2: to[1] }, style };
  },
});
