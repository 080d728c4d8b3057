// SPDX-License-Identifier: Apache-2.0
/** A heat map: one figure over two columns. */
import { labelRoom } from '../charts/rows.js';
import { address, useAddress } from '../core/address.js';
import { csvOf, useData } from '../core/api.js';
import { Chart } from '../core/chart.js';
import { axisName, cell, clip, headingOf, number } from '../core/format.js';
import { NothingFits, Notes, Waiting } from '../core/parts.js';
import { SCALE } from '../core/scale.js';
import { html, useEffect, useMemo } from '../core/ui.js';
import { failureText, groupTable } from './groups.js';

const MOST = 40;
const NARROW = 400;

/**
 * @param {{set: Settings, filters: import('../core/address.js').Query, title: string, onError: (error:
 *   Error|null) => void}} props of explore
 */
export function Heat({ set, filters, title, onError }) {
  const { query } = useAddress();
  const rows = set.colour || 'algorithm';
  const url = address(
    '/api/v1/analysis/aggregate',
    filters.with({
      by: [...new Set([set.x, rows])].join(','),
      metrics: set.y,
      outcomes: set.outcomes,
    }),
  );
  const { current: data, error } = useData(url);
  useEffect(() => onError(error), [error]);
  const drawn = useMemo(() => data && parts(data, set, rows), [data, set.figure, rows]);
  if (!data) return !error && html`<${Waiting} />`;
  if (data.groups.length === 0) return html`<${NothingFits} notes=${data.notes} />`;
  return html`
    <div class=${drawn.length > 1 ? 'facets' : ''}>
      ${drawn.map(
        (/** @type {Drawn & {name: string, table: TableData}} */ part) => html`
          <${Chart}
            key=${part.name}
            title=${part.name ? `${title}: ${clip(part.name, 100)}` : title}
            option=${part.option}
            height=${part.height}
            csv=${csvOf(url)}
            table=${part.table}
          />
        `,
      )}
    </div>
    <${Notes}
      notes=${[
        ...(data.notes ?? []),
        ...(drawn.length > 24 ? ['More than 24 charts: filter the runs.'] : []),
      ]}
    />
    ${
      query.get('embed') !== '1' &&
      html`
        <p class="quiet">A cell without runs is empty; one whose runs all failed says so.</p>
      `
    }
  `;
}

/**
 * @param {Api.Aggregate} data
 * @param {Settings} set
 * @param {string} rows
 */
function parts(data, set, rows) {
  const rest = data.keys.map((key) => key.name).filter((name) => name !== set.x && name !== rows);
  const found = new Map();
  for (const group of data.groups) {
    const name = rest.map((key) => cell(group.keys[key])).join(', ');
    if (!found.has(name)) found.set(name, []);
    found.get(name).push(group);
  }
  return [...found].slice(0, 24).map(([name, groups]) => ({
    name: found.size > 1 ? name : '',
    ...heat(data, groups, set, rows),
  }));
}

/**
 * @param {Api.Aggregate} data
 * @param {Api.Group[]} groups
 * @param {Settings} set
 * @param {string} rows
 * @returns {Drawn & {table: TableData}}
 */
function heat(data, groups, set, rows) {
  /** @param {string} name */
  const heading = (name) => headingOf(data.keys, name);
  const metric = data.metrics[0];
  /** @param {string} name */
  const values = (name) =>
    [...new Set(groups.map((group) => group.keys[name]))]
      .sort((a, b) =>
        typeof a === 'number' && typeof b === 'number' ? a - b : String(a).localeCompare(String(b)),
      )
      .slice(0, MOST);
  const [across, down] = [values(set.x), values(rows)];
  const cells = groups
    .map((group) => {
      const figure = group.figures[set.y]?.[set.figure];
      return {
        at: [across.indexOf(group.keys[set.x]), down.indexOf(group.keys[rows])],
        figure: figure === null || figure === undefined ? null : figure * (metric.factor ?? 1),
        group,
      };
    })
    .filter((one) => one.at.every((place) => place >= 0))
    .map(({ at, figure, group }) => ({ value: [...at, figure ?? '-'], figure, group }));
  const numbers = cells.map((one) => one.figure).filter((figure) => figure !== null);
  /** @param {{figure: number|null, group: Api.Group}} one */
  const text = (one) => (one.figure === null ? (one.group.failed ? 'failed' : '') : number(one.figure, 3));
  const known = across.length <= 12;
  /** @param {number} width */
  const room = (width) => (width - labelRoom(width, 130) - (width < NARROW ? 14 : 90)) / across.length;
  const [least, most] = [Math.min(...numbers, Infinity), Math.max(...numbers, -Infinity)];
  // What is bad is dark: the upper half of the colours.
  const larger = metric.better === 'higher';
  const inked = cells.map((one) => ({
    ...one,
    label: {
      color:
        one.figure !== null &&
        most > least &&
        (larger ? most - one.figure : one.figure - least) > 0.5 * (most - least)
          ? '#fff'
          : '#16191d',
    },
  }));
  return {
    height: Math.max(220, 120 + down.length * 34),
    table: groupTable({ ...data, groups }),
    option: ({ width }) => ({
      grid: { left: labelRoom(width, 130), right: width < NARROW ? 14 : 90, top: 12, bottom: 76 },
      tooltip: {
        trigger: 'item',
        formatter: ({ data: one }) =>
          one?.group
            ? [
                `${clip(metric.title, 40)} (${set.figure}): ${text(one) || '–'}`,
                `n = ${one.group.n} of ${one.group.runs}; ${failureText(one.group.failures)}`,
              ].join('\n')
            : '',
      },
      xAxis: {
        type: 'category',
        data: across.map((value) => clip(cell(value, heading(set.x)), 24)),
        name: clip(axisName(heading(set.x)), 40),
        nameGap: 46,
        axisLabel: {
          interval: 0,
          hideOverlap: !known,
          rotate: across.length > 6 || width < NARROW ? 25 : 0,
        },
      },
      yAxis: {
        type: 'category',
        data: down.map((value) => clip(cell(value, heading(rows)), 20)),
        name: '',
        axisLabel: { width: labelRoom(width, 130) - 12, overflow: 'truncate' },
      },
      visualMap: {
        seriesIndex: 0,
        show: width >= NARROW && most > least,
        min: least,
        max: most,
        precision: 3,
        right: 0,
        top: 'middle',
        itemHeight: 100,
        inRange: { color: larger ? [...SCALE].reverse() : SCALE },
      },
      series: [
        {
          type: 'heatmap',
          data: inked,
          label: {
            show: known && room(width) >= 34,
            fontSize: room(width) < 52 ? 10 : 12,
            formatter: (item) => text(item.data),
          },
        },
        // A cell without a number gets no label of its own.
        {
          type: 'scatter',
          silent: true,
          symbolSize: 0.1,
          data: cells
            .filter((one) => one.figure === null && one.group.failed)
            .map((one) => one.value.slice(0, 2)),
          itemStyle: { opacity: 0 },
          label: {
            show: known && room(width) >= 34,
            position: 'inside',
            formatter: 'failed',
            color: '#d7301f',
            fontSize: room(width) < 52 ? 10 : 12,
            opacity: 1,
          },
        },
      ],
    }),
  };
}
