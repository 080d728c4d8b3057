// SPDX-License-Identifier: Apache-2.0
/** Error against cost, or any two figures: who is beaten by nobody in both. */
import { paretoChart } from '../charts/pareto.js';
import { address } from '../core/address.js';
import { csvOf, useData } from '../core/api.js';
import { Chart } from '../core/chart.js';
import { clip, columnTitle, keysText } from '../core/format.js';
import { NothingFits, Notes, Waiting } from '../core/parts.js';
import { html, useEffect, useMemo } from '../core/ui.js';

/**
 * @param {{set: Settings, filters: import('../core/address.js').Query, title: string, onError: (error:
 *   Error|null) => void}} props of explore
 */
export function Pareto({ set, filters, title, onError }) {
  const by = [...new Set(['algorithm', 'sensors', set.colour].filter(Boolean))].join(',');
  const url = address('/api/v1/analysis/pareto', filters.with({ x: set.x, y: set.y, by }));
  const { current: data, error } = useData(url);
  useEffect(() => onError(error), [error]);
  const drawn = useMemo(
    () =>
      data?.fronts
        .slice(0, 24)
        .map(
          (/** @type {Api.ParetoFront} */ front) =>
            front.points.some((point) => point.x !== null) && {
              name: keysText(front.facets),
              table: tableOf(data, front),
              option: paretoChart(data, front, set),
            },
        )
        .filter(Boolean),
    [data, set.xlog, set.ylog, set.own],
  );
  if (!data) return !error && html`<${Waiting} />`;
  if (drawn.length === 0) return html`<${NothingFits} notes=${data.notes} />`;
  const absent = data.fronts.flatMap((/** @type {Api.ParetoFront} */ { facets, points }) =>
    points.flatMap(({ x, keys }) => (x === null ? keysText({ ...keys, ...facets }) : [])),
  );
  return html`
    <div class=${drawn.length > 1 ? 'facets' : ''}>
      ${drawn.map(
        (/** @type {{name: string, table: any, option: any}} */ one) => html`
          <${Chart}
            key=${one.name}
            title=${one.name ? `${title}: ${clip(one.name, 100)}` : title}
            option=${one.option}
            height=${360}
            csv=${csvOf(url)}
            table=${one.table}
          />
        `,
      )}
    </div>
    <p class="quiet">
      Filled: nobody is better in both. Crosses, in the field above: the median run failed.
      ${absent.length > 0 && ` No mark, as no run that counts has a cost: ${clip(absent.join('; '), 600)}.`}
    </p>
    <${Notes} notes=${data.notes} />
  `;
}

/**
 * @param {Api.Pareto} data
 * @param {Api.ParetoFront} front
 */
const tableOf = (data, { points }) => ({
  columns: [
    ...Object.keys(points[0]?.keys ?? {}).map((name) => ({ name, title: columnTitle(name) })),
    { ...data.x, name: 'x' },
    { ...data.y, name: 'y' },
    { name: 'front', title: 'on the front' },
    ...['n', 'runs', 'failed'].map((name) => ({ name, title: name, kind: 'integer' })),
    { name: 'coverage', title: 'coverage', kind: 'number' },
  ],
  rows: points.map((point) => ({ ...point.keys, ...point })),
});
