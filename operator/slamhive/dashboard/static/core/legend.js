// SPDX-License-Identifier: Apache-2.0
/** Legends that show every name in full: the drawing grows by the rows that they take. */

/** Pixels of a letter, of the sign before a name with the gaps around it, and of a row. */
const LETTER = 7;
const SIGN = 40;
const ROW = 22;
/** More rows than these would be longer than the drawing: the reader turns their pages. */
const MOST = 10;

/**
 * Return an option whose legend has all names, and the pixels by which the drawing is higher for it.
 * @param {any} option of ECharts
 * @param {number} width of the drawing, in pixels
 * @returns {{option: any, more: number}}
 */
export function fitted(option, width) {
  const { legend, grid, graphic } = option;
  // Where texts have places of their own, nothing can be moved.
  if (!legend || !grid || graphic || legend.type) return { option, more: 0 };
  /** @type {string[]} */
  const names = [
    ...new Set(
      (legend.data ?? option.series).map((/** @type {any} */ one) =>
        typeof one === 'string' ? one : one.name,
      ),
    ),
  ].filter(Boolean);
  const room = width - 10;
  const long = names.some((name) => name.length * LETTER + SIGN > room);
  let rows = long ? 0 : 1;
  let used = 0;
  for (const name of names) {
    const needs = name.length * LETTER + SIGN;
    // Texts that may break have all the same width: each name begins a row.
    if (long) rows += Math.max(1, Math.ceil((needs - SIGN) / Math.max(room - SIGN, LETTER)));
    else if (used && used + needs > room) {
      rows += 1;
      used = 0;
    }
    used += needs;
  }
  if (rows > MOST) return { option, more: 0 };
  const more = Math.max(0, rows - 1) * ROW;
  const textStyle = long ? { textStyle: { width: room - SIGN, lineHeight: 14, overflow: 'break' } } : {};
  /** @param {any} one */
  const lower = (one) => ({ ...one, top: one.top + more });
  return {
    option: {
      ...option,
      legend: { ...legend, type: 'plain', itemGap: 8, ...textStyle },
      grid: Array.isArray(grid) ? grid.map(lower) : lower(grid),
    },
    more,
  };
}
