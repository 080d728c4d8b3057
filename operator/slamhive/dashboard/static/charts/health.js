// SPDX-License-Identifier: Apache-2.0
/** When a run was lost, and when it said so, behind its error over time. */
import { COLOURS, legendOfLines } from '../core/chart.js';

const LOST = 'rgba(213, 94, 0, 0.22)';
const WARNED = 'rgba(230, 159, 0, 0.8)';
/** @typedef {{begin: number, end: number}} Span in s */

/** Bottom and top of the strip of warnings, px. */
const STRIP = [32, 40];

/**
 * Return the option of an error over time with the run's losses as a band and its warnings as a strip above.
 * @param {any} option of one line
 * @param {{healthLosses?: Span[], healthWarnings?: Span[]}|undefined} result
 * @param {number} start time that is 0 in the picture, s
 * @returns {ChartOption}
 */
export function withHealth(option, result, start) {
  const [losses, warnings] = [result?.healthLosses ?? [], result?.healthWarnings ?? []];
  if (losses.length + warnings.length === 0) return option;
  /**
   * @param {string} name
   * @param {string} colour
   * @param {Span[]} spans
   * @param {number[]} [strip]
   */
  const area = (name, colour, spans, strip) => ({
    type: 'line',
    name,
    color: colour,
    showSymbol: false,
    data: [],
    markArea: {
      silent: true,
      itemStyle: { color: colour },
      data: spans.map(({ begin, end }) =>
        [begin, end].map((at, side) => ({ xAxis: at - start, ...(strip ? { y: strip[side] } : {}) })),
      ),
    },
  });
  return {
    ...option,
    grid: { ...option.grid, top: 44 },
    legend: legendOfLines(),
    series: [
      ...option.series.map((/** @type {any} */ line) => ({ ...line, color: line.color ?? COLOURS[0] })),
      ...(losses.length ? [area('lost', LOST, losses)] : []),
      ...(warnings.length ? [area('warned', WARNED, warnings, STRIP)] : []),
    ],
  };
}
