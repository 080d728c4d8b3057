// SPDX-License-Identifier: Apache-2.0
/** What stands beside a chart so that nobody is misled: n, failures, coverage of each group. */
import { address, SITE } from '../core/address.js';
import { csvOf, useData } from '../core/api.js';
import { clip, number, shortTitles } from '../core/format.js';
import { foremost, useNarrow } from '../core/narrow.js';
import { Download, Fault, Link, Notes, Table } from '../core/parts.js';
import { useUnlikeNodes } from '../core/suspects.js';
import { TruthLink } from '../core/truth.js';
import { html } from '../core/ui.js';

/** The figures of a group. @type {Array<'median'|'mean'|'std'|'min'|'max'>} */
export const FIGURES = ['median', 'mean', 'std', 'min', 'max'];

/**
 * Findings of a recording lead to what runs say of its ground truth.
 * @param {string} text
 * @param {Api.Row} row
 */
const toTruth = (text, row) =>
  text && typeof row.dataset === 'string'
    ? html`<${TruthLink} dataset=${row.dataset}>${clip(text, 80)}</${TruthLink}>`
    : text;

/**
 * Return the columns and rows of a table of groups.
 * @param {Api.Aggregate} data answer of analysis/aggregate
 * @param {Array<'median'|'mean'|'std'|'min'|'max'>} [which] of its figures
 * @returns {TableData}
 */
export function groupTable(data, which = FIGURES) {
  /** @param {{name: string}} key */
  const values = (key) => new Set(data.groups.map((group) => group.keys[key.name]));
  // A column that nobody asked for is worth its room where it has several values, not for being unknown of
  // some.
  /** @param {{name: string}} key */
  const known = (key) => [...values(key)].filter((value) => value !== null).length;
  const varied = data.keys.filter((key) =>
    key.facet ? known(key) > 1 : data.groups.length < 2 || values(key).size > 1,
  );
  // Equal trajectories are one result: their errors have no spread.
  const equal = data.groups.some((group) => group.copies > 0)
    ? [{ name: 'equal', title: 'equal results' }]
    : [];
  const findings = data.groups.some((group) => group.findings.length > 0)
    ? [{ name: 'findings', title: '† findings of the recording', show: toTruth }]
    : [];
  const reader = data.groups.some((group) => group.reader)
    ? [{ name: 'reader', title: '‡ CPU with the reader' }]
    : [];
  const late = data.groups.some((group) => group.late)
    ? [{ name: 'late', title: '§ memory with frames that waited' }]
    : [];
  const chosen = data.groups.some((group) => group.chosen)
    ? [{ name: 'chosen', title: '¶ chosen by a search' }]
    : [];
  const figures = data.metrics.flatMap((metric) =>
    which.map((one) => ({
      ...metric,
      kind: 'number',
      name: `${metric.name} ${one}`,
      title: `${metric.title} ${one}`,
    })),
  );
  return {
    columns: [
      ...shortTitles(varied),
      { name: 'n', kind: 'integer', title: 'n' },
      { name: 'runs', kind: 'integer', title: 'runs' },
      { name: 'failures', title: 'failures' },
      { name: 'coverage', kind: 'number', title: 'coverage' },
      ...equal,
      ...findings,
      ...reader,
      ...late,
      ...chosen,
      ...figures,
    ],
    rows: data.groups.map((group) => ({
      ...group.keys,
      n: group.n,
      runs: group.runs,
      coverage: group.coverage?.mean ?? null,
      failures: failureText(group.failures),
      findings: group.findings.join(', '),
      reader: group.reader ? 'in it, or not known' : '',
      late: group.late ? 'in it: poses came late' : '',
      chosen: group.chosen ? 'for its results' : '',
      equal: group.copies > 0 ? `${group.n} in ${group.n + group.copies} runs` : '',
      ...Object.fromEntries(
        data.metrics.flatMap((metric) =>
          which.map((one) => [`${metric.name} ${one}`, group.figures[metric.name]?.[one] ?? null]),
        ),
      ),
    })),
  };
}

/**
 * Return the columns of a table of groups with what tells them apart first, then the first figure of each
 * metric. Sensors of which each algorithm has one kind tell nothing more.
 * @param {TableData} table
 * @param {string} [figure]
 * @returns {TableColumn[]}
 */
export function onPhone({ columns, rows }, figure = 'median') {
  const names = columns.map(({ name }) => name);
  const keys = names.slice(0, names.indexOf('n'));
  /** @param {string[]} of */
  const count = (...of) => new Set(rows.map((row) => of.map((name) => row[name]).join('\n'))).size;
  const plain = count('algorithm') === count('algorithm', 'sensors');
  return foremost(columns, [
    'algorithm',
    ...keys.filter((name) => name !== 'algorithm' && (!plain || name !== 'sensors')),
    ...names.filter((name) => name.endsWith(` ${figure}`)),
  ]);
}

/**
 * Return failures as words: "4 Partial, 1 Lost".
 * @param {Api.Failures|null|undefined} failures
 */
export const failureText = (failures) =>
  Object.entries(failures ?? {})
    .map(([what, count]) => `${number(count)} ${what}`)
    .join(', ') || 'none';

/**
 * Return the address of the page that shows the paths of a group's runs.
 * @param {import('../core/address.js').Query} filters
 * @param {Api.Keys} keys
 */
export const pathsOf = (filters, keys) =>
  address(
    '/paths',
    filters.with(Object.fromEntries(Object.entries(keys).map(([name, value]) => [name, String(value)]))),
  );

/**
 * The groups of what a chart shows, with their n, failures and coverage.
 * @param {{columns: Api.Column[], set: Settings, filters: import('../core/address.js').Query}} props
 */
export function GroupTable({ columns, set, filters }) {
  /** @param {string} name */
  const few = (name) => name && (columns.find((one) => one.name === name)?.distinct ?? 1e9) <= 40;
  const by = [...new Set([set.x, set.colour, set.facet].filter(few))];
  const url = by.length
    ? address(
        '/api/v1/analysis/aggregate',
        filters.with({ by: by.join(','), metrics: set.y, outcomes: set.outcomes }),
      )
    : null;
  const state = useData(url);
  const unlike = useUnlikeNodes(set.y.split(','));
  const narrow = useNarrow();
  if (!url) return null;
  const shown = state.data && groupTable(state.data);
  const keys = shown?.columns.findIndex((/** @type {TableColumn} */ one) => one.name === 'n') ?? 0;
  return html`
    <section>
      <h2>
        Behind it${' '}
        <${Download} class="small" href=${csvOf(url)}>
          CSV
        </${Download}>
      </h2>
      <p class="quiet">
        Figures are over n ${set.outcomes === 'all' ? 'evaluated' : 'tracked'} runs; coverage over
        all evaluated ones.
      </p>
      <${Fault} error=${state.error} />
      ${
        shown &&
        html`
          <${Table}
            fixed=${Math.max(1, keys)}
            columns=${[
              ...(narrow ? onPhone(shown) : shown.columns),
              !SITE && {
                name: 'paths',
                title: 'paths',
                show: (/** @type {unknown} */ _, /** @type {{keys: Api.Keys}} */ row) =>
                  html`<${Link} href=${pathsOf(filters, row.keys)}>show</${Link}>`,
              },
            ].filter(Boolean)}
            rows=${shown.rows.slice(0, 200).map((/** @type {any} */ row, /** @type {number} */ at) => ({
              ...row,
              keys: state.data.groups[at].keys,
            }))}
            caption=${`Groups by ${clip(by.join(', '), 100)}`}
          />
        `
      }
      <${Notes} notes=${state.data && [...state.data.notes, ...unlike]} />
    </section>
  `;
}
