// SPDX-License-Identifier: Apache-2.0
/** Contours over two settings, and slices over each: drawings of Explore. */
import { contourChart } from '../charts/contour.js';
import { bestOf, sharedLimits, sliceChart } from '../charts/slices.js';
import { address } from '../core/address.js';
import { csvOf, useData } from '../core/api.js';
import { Chart } from '../core/chart.js';
import { cell, clip, keysText } from '../core/format.js';
import { NothingFits, Notes, Waiting } from '../core/parts.js';
import { html, useEffect, useMemo } from '../core/ui.js';
import { failureText } from './groups.js';

/**
 * @typedef {{set: Settings, columns: Api.Column[], filters: import('../core/address.js').Query,
 *   title: string, onError: (error: Error|null) => void}} Props
 */

/** @param {Props} props */
export function Contours({ set, columns, filters, title, onError }) {
  // Two settings that vary are what a reader begins with.
  const other =
    set.colour ||
    columns.find((one) => one.distinct > 1 && one.name !== set.x && /^(parameters|input)\./.test(one.name))
      ?.name ||
    'algorithm';
  const url = address(
    '/api/v1/analysis/surface',
    filters.with({ x: set.x, y: other, metric: set.y, outcomes: set.outcomes }),
  );
  const { current: data, error } = useData(url);
  useEffect(() => onError(error), [error]);
  const drawn = useMemo(
    () =>
      data?.boards.map((/** @type {Api.SurfaceBoard} */ board) => ({
        name: keysText(board.keys),
        table: cellTable(board.cells, data.axes, data.metric),
        ...contourChart(data, board.cells),
      })),
    [data],
  );
  if (!data) return !error && html`<${Waiting} />`;
  if (!drawn.length) return html`<${NothingFits} notes=${data.notes} />`;
  return html`
    <div class=${drawn.length > 1 ? 'facets' : ''}>
      ${drawn.map(
        (/** @type {{name: string, option: ChartOption, table: TableData}} */ one) => html`
          <${Chart}
            key=${one.name}
            title=${[`${title} and ${clip(data.axes[1].title, 50)}`, clip(one.name, 90)]
              .filter(Boolean)
              .join(': ')}
            option=${one.option}
            height=${420}
            csv=${csvOf(url)}
            table=${one.table}
          />
        `,
      )}
    </div>
    <${Notes}
      notes=${[
        'Points are medians of runs, failed ones ranked last; colours and lines between them are made up ' +
          'of the nearest four.',
        ...new Set(drawn.flatMap((/** @type {{notes: string[]}} */ one) => one.notes)),
        ...data.notes,
      ]}
    />
  `;
}

/**
 * @typedef {{heading: Api.Heading, option: ChartOption, table: TableData}} SliceOfBoard
 * @typedef {{name: string, charts: SliceOfBoard[]}} SlicesOfBoard
 */

/** @param {Props} props */
export function Slices({ set, filters, title, onError }) {
  const url = address('/api/v1/analysis/slices', filters.with({ metric: set.y, outcomes: set.outcomes }));
  const { current: data, error } = useData(url);
  useEffect(() => onError(error), [error]);
  const drawn = useMemo(
    () =>
      data?.boards.map((/** @type {Api.SliceBoard} */ board) => {
        const limits = sharedLimits(board.slices, data.metric.factor ?? 1, set.ylog);
        return {
          name: keysText(board.keys),
          charts: data.settings
            // A setting that others have, or that has one value here, says nothing.
            .filter((/** @type {Api.Heading} */ one) => board.slices[one.name].length > 1)
            .map((/** @type {Api.Heading} */ one) => ({
              heading: one,
              option: sliceChart(data.metric, one, board.slices[one.name], limits, set.ylog),
              table: cellTable(board.slices[one.name], [one], data.metric),
            })),
        };
      }),
    [data, set.ylog],
  );
  if (!data) return !error && html`<${Waiting} />`;
  if (!drawn.length) return html`<${NothingFits} notes=${data.notes} />`;
  return html`
    ${drawn.map(
      (/** @type {SlicesOfBoard} */ board) => html`
        <section key=${board.name}>
          ${board.name && html`<h2>${clip(board.name, 120)}</h2>`}
          ${board.charts.length === 0 && html`<p class="empty">No setting varies among these runs.</p>`}
          <div class="facets">
            ${board.charts.map(
              ({ heading, option, table }) => html`
                <${Chart}
                  key=${heading.name}
                  title=${`${title}: ${clip(heading.title, 60)}`}
                  option=${option}
                  height=${260}
                  csv=${csvOf(url)}
                  table=${table}
                />
              `,
            )}
          </div>
        </section>
      `,
    )}
    <${Notes}
      notes=${[
        'Dots are medians, failed runs ranked last; boxes the middle half of the runs, diamonds the ' +
          `${bestOf(data.metric)} one. All charts of a group have the same vertical axis.`,
        ...data.notes,
      ]}
    />
  `;
}

/**
 * @param {Api.SurfaceCell[]} cells
 * @param {Api.Heading[]} axes
 * @param {Api.Heading} metric
 * @returns {TableData}
 */
function cellTable(cells, axes, metric) {
  const figures = ['best', 'low', 'median', 'high'];
  const titles = [bestOf(metric), 'first quartile', 'median', 'third quartile'];
  return {
    columns: [
      ...axes,
      { name: 'n', kind: 'integer', title: 'reach a value' },
      { name: 'total', kind: 'integer', title: 'of' },
      { name: 'failures', title: 'never reach one' },
      ...figures.map((name, at) => ({
        ...metric,
        name,
        kind: 'number',
        title: `${metric.title}, ${titles[at]}`,
        show: (/** @type {number|null} */ value) => (value === null ? 'failed' : cell(value, metric)),
      })),
    ],
    rows: cells.map((one) => ({
      ...Object.fromEntries(axes.map((axis, at) => [axis.name, one.at[at]])),
      n: one.n,
      total: one.total,
      failures: failureText(one.failures),
      ...Object.fromEntries(figures.map((name) => [name, /** @type {any} */ (one)[name]])),
    })),
  };
}
