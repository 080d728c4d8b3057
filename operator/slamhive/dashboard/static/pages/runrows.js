// SPDX-License-Identifier: Apache-2.0
/** The runs behind a chart. */
import { address } from '../core/address.js';
import { csvOf, useData } from '../core/api.js';
import { number, shortTitles } from '../core/format.js';
import { foremost, useNarrow } from '../core/narrow.js';
import { Fault, Link, runLink, Status, Table } from '../core/parts.js';
import { html } from '../core/ui.js';

const SHOWN = ['uid', 'run', 'algorithm', 'sensors', 'dataset', 'status', 'coverage'];

/**
 * The first runs that some filters leave.
 * @param {{filters: import('../core/address.js').Query, extra: string[], selected?: boolean, title?: string,
 *   sort?: string}} props
 */
export function RunRows({ filters, extra, selected = false, title = 'Runs', sort = '' }) {
  const narrow = useNarrow();
  const columns = [...new Set([...SHOWN, ...extra.filter(Boolean)])];
  const url = address('/api/v1/runs', filters.with({ columns: columns.join(','), sort, limit: 25 }));
  const state = useData(url);
  return html`
    <section>
      <h2>
        ${selected ? 'Selected runs' : title}${' '}
        ${state.data && html`<span class="quiet">${number(state.data.total)}</span>`}
        <a
          class="small"
          href=${csvOf(address('/api/v1/runs', filters.with({ columns: columns.join(',') })))}
          download
        >
          CSV
        </a>
        <${Link} class="small" href=${address('/runs', filters.with({ sort }))}>
          All as a table
        </${Link}>
      </h2>
      <${Fault} error=${state.error} />
      ${
        state.data &&
        html`
          <${Table}
            columns=${foremost(dressed(state.data.columns), narrow ? ['run', 'status', ...extra] : [])}
            rows=${state.data.items} caption="Runs" />
        `
      }
    </section>
  `;
}

/**
 * Give headings of the runs table their links and colours; `uid` becomes the link of `run`.
 * @param {Api.Heading[]} headings
 * @returns {TableColumn[]}
 */
export const dressed = (headings) =>
  shortTitles(headings)
    .filter((one) => one.name !== 'uid' && one.name !== 'id')
    .map((one) => {
      if (one.name === 'run' || one.name === 'name')
        return {
          ...one,
          show: (value, row) => (row.uid ? runLink(row.uid, value ?? row.uid) : value),
        };
      if (one.name === 'status' || one.name === 'outcome' || one.name === 'phase')
        return { ...one, show: (value) => (value === null ? '–' : html`<${Status} value=${value} />`) };
      return one;
    });
