// SPDX-License-Identifier: Apache-2.0
/** The causal and the final error of each competitor on each dataset, joined by a line. */
import { COLOURS } from '../core/chart.js';
import { clip, keysText, number } from '../core/format.js';
import { NARROW, rounded, twoLines } from './dumbbells.js';
import { labelRoom, rowAxis, rowLines } from './rows.js';

/** Beginning of the names of errors of poses as they were first published. */
const CAUSAL = 'beside.online.';
const WIDE_RANGE = 5;
const MOST_ROWS = 40;
const NAMES = 300;

/**
 * Return the chart and its height; null where no run has both errors.
 * @param {Api.Aggregate} data groups with the final error first, causal ones behind it
 * @returns {Drawn|null}
 */
export function causal(data) {
  const [final] = data.metrics;
  const other = data.metrics.find(({ name }) => name.startsWith(CAUSAL));
  if (!final || !other) return null;
  /** @param {Api.Group} group @param {Api.Heading} metric */
  const median = (group, metric) => {
    const value = group.figures[metric.name]?.median ?? null;
    return value === null ? null : value * (metric.factor ?? 1);
  };
  const rows = data.groups
    .map((group) => ({
      keys: group.keys,
      final: median(group, final),
      causal: median(group, other),
    }))
    .filter((row) => row.final !== null && row.causal !== null)
    .slice(0, MOST_ROWS);
  if (rows.length === 0) return null;
  const values = rows.flatMap((row) => [Number(row.final), Number(row.causal)]);
  const [least, most] = [Math.min(...values), Math.max(...values)];
  const log = least > 0 && most / least > WIDE_RANGE;
  /**
   * @param {'final'|'causal'} key
   * @param {string} name
   * @param {Record<string, any>} look
   */
  const series = (key, name, look) => ({
    name,
    type: 'scatter',
    data: rows.map((row, at) => ({ value: [row[key], at], row })),
    ...look,
  });
  return {
    height: 110 + rows.length * 28,
    option: ({ width }) => ({
      grid: { left: labelRoom(width, NAMES), right: 30, top: 34, bottom: 50 },
      legend: {},
      tooltip: { trigger: 'item', formatter: (item) => (item.data?.row ? told(item.data.row) : '') },
      xAxis: {
        type: log ? 'log' : 'value',
        scale: true,
        ...(log && { min: rounded(least, Math.floor), max: rounded(most, Math.ceil) }),
        minorTick: { show: log, splitNumber: 9 },
        name: (other.label ?? '').replace(', causal', ''),
        nameGap: 28,
        axisLabel: { formatter: (value) => number(value, 2) },
      },
      yAxis: rowAxis(
        rows.map(({ keys }) => (width < NARROW ? twoLines(keys) : keysText(keys))),
        width,
        NAMES,
        width < NARROW ? { fontSize: 11, lineHeight: 12 } : {},
      ),
      series: [
        rowLines(
          rows.map((row, at) => [row.final, row.causal, at]),
          { stroke: COLOURS[8], lineWidth: 3, opacity: 0.6 },
        ),
        series('causal', 'causal: as first published', {
          symbol: 'circle',
          symbolSize: 12,
          color: COLOURS[1],
          itemStyle: { color: 'transparent', borderColor: COLOURS[1], borderWidth: 2 },
        }),
        series('final', 'final: as corrected later', {
          symbol: 'diamond',
          symbolSize: 11,
          color: COLOURS[0],
        }),
      ],
    }),
  };
}

/** @param {{keys: Api.Keys, final: number|null, causal: number|null}} row */
const told = (row) =>
  [clip(keysText(row.keys), 100), `causal ${number(row.causal)}`, `final ${number(row.final)}`].join('\n');
