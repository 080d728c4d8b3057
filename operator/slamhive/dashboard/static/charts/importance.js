// SPDX-License-Identifier: Apache-2.0
/** How much of the variation settings explain. */
import { COLOURS } from '../core/chart.js';
import { clip, columnTitle, number } from '../core/format.js';
import { labelRoom, rowAxis } from './rows.js';

const MOST = 20;

/**
 * Return the chart of one subject, its height, and the rows of its table.
 * @param {Pick<Api.Subject, 'parameters'|'interactions'>} subject of /api/v1/analysis/importance
 * @param {string} [share] what is shared
 * @returns {Drawn & {rows: Array<{name: string, variance: number|null, together?: boolean}>}}
 */
export function importanceCharts(subject, share = 'variance') {
  /** @type {Array<{name: string, variance: number|null, together?: boolean}>} */
  const rows = [
    ...subject.parameters,
    ...subject.interactions.map((one) => ({
      name: `${one.a} × ${one.b}`,
      variance: one.variance,
      together: true,
    })),
  ].sort((a, b) => (b.variance ?? -1) - (a.variance ?? -1));
  const shown = rows.filter((row) => row.variance !== null && row.variance !== undefined).slice(0, MOST);
  return {
    rows,
    height: 96 + Math.max(shown.length, 1) * 30,
    option: ({ width }) => ({
      grid: { left: labelRoom(width, 190), right: 70, top: 10, bottom: 50 },
      tooltip: { trigger: 'item', formatter: (item) => `${clip(item.name, 80)}: ${number(item.value, 3)} %` },
      xAxis: {
        type: 'value',
        min: 0,
        max: ({ max }) => Math.min(100, 10 * Math.max(1, Math.ceil(max * 0.13))),
        name: `share of the ${share} [%]`,
        nameGap: 26,
      },
      yAxis: rowAxis(
        shown.map((row) => clip(row.name.split(' × ').map(columnTitle).join(' × '), 40)),
        width,
        190,
      ),
      series: [
        {
          type: 'bar',
          barMaxWidth: 20,
          data: shown.map((row) => ({
            value: Math.max(0, 100 * Number(row.variance)),
            itemStyle: { color: COLOURS[row.together ? 5 : 0] },
          })),
          label: { show: true, position: 'right', formatter: (item) => `${number(item.value, 3)} %` },
        },
      ],
    }),
  };
}
