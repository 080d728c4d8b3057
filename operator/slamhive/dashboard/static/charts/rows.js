// SPDX-License-Identifier: Apache-2.0
/** Charts of one row for each competitor or setting: names at the left, lines between two values. */
import { shorten } from '../core/format.js';

/**
 * Return the width for names left of a chart, in pixels: a phone keeps most of its width for the chart.
 * @param {number} width
 * @param {number} most
 */
export const labelRoom = (width, most) => Math.min(most, Math.round(width * 0.36));

/** Pixels of a letter of the names, at most. */
const LETTER = 6.6;

/**
 * Return the axis that names the rows, the first one on top. Names that are too long have several lines, and
 * are cut where they differ least: within their longest part.
 * @param {string[]} names
 * @param {number} width of the chart, in pixels
 * @param {number} most width of the names, in pixels
 * @param {{lines?: number} & Record<string, any>} [label] lines: how many there is room for; more of how the
 *   names look
 */
export const rowAxis = (names, width, most, { lines = 1, ...label } = {}) => {
  const room = labelRoom(width, most) - 14;
  const letters = Math.floor(room / (lines > 1 ? 0.9 * LETTER : LETTER));
  return {
    type: 'category',
    inverse: true,
    data: names.map((name) =>
      name
        .split('\n')
        .map((line) => shorten(line, letters * lines - (lines > 1 ? 6 : 0)))
        .join('\n'),
    ),
    name: '',
    axisLabel: {
      interval: 0,
      hideOverlap: false,
      width: room,
      overflow: lines > 1 ? 'break' : 'truncate',
      ...(lines > 1 && { lineHeight: 13, fontSize: 11 }),
      ...label,
    },
  };
};

/**
 * Return the series of a line in each row, from one value to another.
 * @param {any[]} data from, to, number of the row
 * @param {Record<string, any>} style
 */
export const rowLines = (data, style) => ({
  type: 'custom',
  silent: true,
  clip: true,
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

/**
 * Return the dashed line across the rows where two values are equal.
 * @param {string} name of it
 */
export const lineAtOne = (name) => ({
  silent: true,
  symbol: 'none',
  data: [{ xAxis: 1 }],
  label: { formatter: name, position: 'start', color: 'inherit' },
  lineStyle: { type: 'dashed' },
});
