// SPDX-License-Identifier: Apache-2.0
/** The runs behind a chart. */
import { address } from './address.js';
import { csvOf, useData } from './api.js';
import { clip, namedValue, number, shortTitles } from './format.js';
import { foremost, useNarrow } from './narrow.js';
import { Download, Fault, Link, runLink, Status, Table } from './parts.js';
import { TruthLink } from './truth.js';
import { html } from './ui.js';

const SHOWN = ['uid', 'run', 'algorithm', 'sensors', 'dataset', 'status', 'coverage'];

/**
 * The first runs that some filters leave.
 * @param {{filters: import('./address.js').Query, extra: string[], selected?: boolean, title?: string,
 *   sort?: string}} props
 */
export function RunRows({ filters, extra, selected = false, title = 'Runs', sort = '-finished' }) {
  const narrow = useNarrow();
  const columns = [...new Set([...SHOWN, ...extra.filter(Boolean)])];
  const url = address('/api/v1/runs', filters.with({ columns: columns.join(','), sort, limit: 25 }));
  const state = useData(url);
  const shown = state.data && folded(state.data, columns, [...KEPT, ...extra]);
  return html`
    <section>
      <h2>
        ${selected ? 'Selected runs' : title}${' '}
        ${state.data && html`<span class="quiet">${number(state.data.total)}</span>`}
        <${Download} class="small"
          href=${csvOf(address('/api/v1/runs', filters.with({ columns: columns.join(',') })))}>
          CSV
        </${Download}>
        <${Link} class="small" href=${address('/runs', filters.with({ sort }))}>
          All as a table
        </${Link}>
      </h2>
      <${Fault} error=${state.error} />
      ${
        state.data &&
        html`
          <${Same} said=${shown?.said} />
          <${Table}
            columns=${foremost(shown?.columns ?? [], narrow ? onPhone(extra) : [])}
            rows=${state.data.items}
            caption="Runs"
          />
        `
      }
    </section>
  `;
}

/**
 * Return the columns of runs that come first where little is seen: of whom they are, then what is told.
 * @param {string[]} told the setting that varies, errors and costs
 */
export const onPhone = (told) => [...new Set(['algorithm', ...told, 'status', 'run'])];

/** Column of what was found to be wrong with the recording of a run. */
export const FINDINGS = 'prepared.findings';

/** Column of the method by whose results a search chose a run. */
export const SEARCHED = 'search';

/** Columns that are worth their room even where all runs have one value in them. */
export const KEPT = ['run', 'finished', 'status', 'ate.rmse'];

/**
 * Return the columns of a table of runs, and what all of its runs share in a sentence, which then need no
 * column.
 * @param {Api.Runs} data
 * @param {string[]} chosen columns that are meant to be shown
 * @param {string[]} kept those that are shown in any case
 */
export function folded(data, chosen, kept) {
  const same = (data.same ?? []).filter((name) => chosen.includes(name) && !kept.includes(name));
  const [first] = data.items;
  const headings = shortTitles(data.columns);
  const said = headings
    .filter((one) => same.includes(one.name) && first?.[one.name] !== null)
    .map((one) => clip(namedValue(one, first?.[one.name]), 80));
  return {
    columns: dressed(data.columns).filter((one) => chosen.includes(one.name) && !same.includes(one.name)),
    said: first ? said.join(', ') : '',
  };
}

/**
 * What all runs of a table share.
 * @param {{said: string|null|undefined}} props
 */
export const Same = ({ said }) => said && html`<p class="quiet">All of them: ${said}</p>`;

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
          show: (value, row) => html`
            ${row.uid ? runLink(row.uid, value ?? row.uid) : value}
            ${
              row[SEARCHED] &&
              html`${' '}<abbr title=${`chosen by a search (${clip(row[SEARCHED], 40)})`}>¶</abbr>`
            }
          `,
        };
      if (one.name === 'status' || one.name === 'outcome' || one.name === 'phase')
        return { ...one, show: (value) => (value === null ? '–' : html`<${Status} value=${value} />`) };
      if (one.name === 'dataset')
        return {
          ...one,
          show: (value, row) =>
            value === null
              ? '–'
              : html`
                ${clip(value, 48)}
                ${
                  row[FINDINGS] &&
                  html`
                    ${' '}
                    <${TruthLink} dataset=${value}>
                      <abbr title=${`open findings: ${clip(row[FINDINGS], 200)}`}>†</abbr>
                    </${TruthLink}>
                  `
                }
              `,
        };
      return one;
    });
