// SPDX-License-Identifier: Apache-2.0
/** Cumulative shares as a drawing of Explore: a chart a dataset, a curve an algorithm. */
import { beyondText, curveCharts, ecdfChart } from '../charts/ecdf.js';
import { address, useAddress } from '../core/address.js';
import { csvOf, useData } from '../core/api.js';
import { Chart } from '../core/chart.js';
import { cell } from '../core/format.js';
import { NothingFits, Notes, Places, Table, Tick, Waiting } from '../core/parts.js';
import { html, useEffect, useMemo } from '../core/ui.js';
import { failureText } from './groups.js';

const MOST_CHARTS = 24;

/**
 * @param {{set: Settings, filters: import('../core/address.js').Query, title: string, onError: (error:
 *   Error|null) => void}} props of explore
 */
export function Ecdf({ set, filters, title, onError }) {
  const { query, change } = useAddress();
  const together = query.get('over') === 'dataset';
  const url = address(
    '/api/v1/analysis/ecdf',
    filters.with({
      by: [...new Set([set.colour || 'algorithm', set.facet].filter(Boolean))].join(','),
      over: together ? 'dataset' : null,
      metric: set.y,
      outcomes: set.outcomes,
      most: query.get('most') || null,
      first: query.get('first') || null,
    }),
  );
  const { current: data, error } = useData(url);
  useEffect(() => onError(error), [error]);
  const { charts, limits } = useMemo(
    () => (data ? curveCharts(data, set) : { charts: [], limits: null }),
    [data, set.facet, set.xlog],
  );
  const options = useMemo(
    () => charts.slice(0, MOST_CHARTS).map((one) => ecdfChart(data.metric, one.curves, limits, set.xlog)),
    [charts, limits],
  );
  if (!data) return !error && html`<${Waiting} />`;
  const places = html`
    <${Places}
      competitors=${data.competitors}
      shown=${data.shown}
      first=${Number(query.get('first', '1'))}
      onChange=${(first) => change({ first })}
    />
  `;
  if (data.curves.length === 0) return html`${places}<${NothingFits} notes=${data.notes} />`;
  const table = curveTable(data);
  return html`
    <p class="row">
      <${Tick}
        label="Datasets in one curve"
        checked=${together}
        onChange=${(on) => change({ over: on ? 'dataset' : null })}
      />
      <span class="quiet">
        The share is of all runs that say something of the algorithm: those that failed never
        reach a value, and their curve ends below 1.
      </span>
    </p>
    ${places}
    <div class=${charts.length > 1 ? 'facets' : ''}>
      ${options.map(
        (option, at) => html`
          <${Chart}
            key=${charts[at].name}
            title=${charts[at].name ? `${title}: ${charts[at].name}` : title}
            option=${option}
            height=${charts.length > 1 ? 320 : 420}
            csv=${csvOf(url)}
            table=${table}
            group="ecdf"
          />
        `,
      )}
    </div>
    <${Notes}
      notes=${[
        beyondText(limits),
        charts.length > MOST_CHARTS
          ? `${charts.length} charts are too many: the first ${MOST_CHARTS} are drawn; filter the runs.`
          : '',
        ...data.notes,
      ].filter(Boolean)}
    />
    <h2>The curves</h2>
    <${Table} columns=${table.columns} rows=${table.rows} caption="The curves and what they are of" />
  `;
}

/**
 * Return the words beside the curves: of how many runs each is, and what became of the others.
 * @param {Api.Ecdf} data
 * @returns {TableData}
 */
function curveTable(data) {
  const keys = data.keys.filter(
    (key) => data.curves.length < 2 || new Set(data.curves.map((one) => String(one.keys[key.name]))).size > 1,
  );
  return {
    columns: [
      ...keys,
      { name: 'n', kind: 'integer', title: 'reach a value' },
      { name: 'total', kind: 'integer', title: 'of' },
      { name: 'failures', title: 'never reach one' },
      { name: 'leftOut', title: 'left out' },
      {
        ...data.metric,
        name: 'median',
        kind: 'number',
        title: `${data.metric.title}, median of all`,
        show: (/** @type {number|null} */ value, /** @type {Api.Curve} */ one) =>
          value === null && one.total ? 'failed' : cell(value, data.metric),
      },
    ],
    rows: data.curves.map((one) => ({
      ...one.keys,
      n: one.n,
      total: one.total,
      median: one.median,
      failures: failureText(one.failures),
      leftOut: failureText(one.leftOut),
    })),
  };
}
