// SPDX-License-Identifier: Apache-2.0
/** Published numbers beside own ones: a table apart, and why own numbers may differ. */
import { address } from '../core/address.js';
import { csvOf, useData } from '../core/api.js';
import { clip, columnTitle, number } from '../core/format.js';
import { Download, Table } from '../core/parts.js';
import { countText } from '../charts/scatter.js';
import { html, useMemo } from '../core/ui.js';

/** @type {Api.PublishedRow[]} */
const NONE = [];

/**
 * Return the published numbers that charts show.
 * @param {import('../core/address.js').Query} filters
 * @param {boolean} wanted
 * @returns {Api.PublishedRow[]}
 */
export const usePublished = (filters, wanted) => {
  const { data } = useData(wanted ? address('/api/v1/analysis/published', filters) : null);
  const drawn = (/** @type {Api.PublishedRow} */ row) => row.isDrawn;
  return useMemo(() => data?.items?.filter(drawn) ?? NONE, [data]);
};

/**
 * @param {{filters: import('../core/address.js').Query, metrics: Api.Heading[]}} props metrics: what is
 *   shown of them
 */
export function PublishedRows({ filters, metrics }) {
  const url = address('/api/v1/analysis/published', filters);
  const { data } = useData(url);
  /** @type {Api.PublishedRow[]} */
  const items = (data?.items ?? []).filter((/** @type {Api.PublishedRow} */ row) =>
    metrics.some((metric) => row.values[metric.name] !== undefined),
  );
  if (!items.length) return null;
  const columns = [
    { name: 'dataset', title: 'dataset' },
    { name: 'system', title: 'system' },
    ...metrics.map((metric) => ({ name: metric.name, title: metric.title ?? columnTitle(metric.name) })),
    { name: 'verdict', title: 'own runs' },
    { name: 'of', title: 'of' },
    { name: 'alignment', title: 'alignment' },
    {
      name: 'where',
      title: 'published in',
      show: (/** @type {unknown} */ value, /** @type {any} */ row) =>
        row.url ? html`<a href=${row.url} rel="noreferrer">${clip(value, 80)}</a>` : clip(value, 80),
    },
    { name: 'notes', title: 'notes' },
  ];
  const rows = items.map((row) => ({
    ...row,
    alignment: row.alignment ?? 'not said',
    of: countText(row),
    notes: row.notes ?? '',
    verdict: metrics.flatMap((metric) => row.verdicts[metric.name] ?? []).join('; ') || '–',
    ...Object.fromEntries(
      metrics.map((metric) => {
        const value = row.values[metric.name];
        return [metric.name, value === undefined ? '–' : number(value * (metric.factor ?? 1))];
      }),
    ),
  }));
  return html`
    <section>
      <h2>Published</h2>
      <p class="quiet">
        Numbers of papers and leaderboards on these datasets. They are in no average, rank, count
        or test.${' '}
        <${Download} href=${csvOf(url)}>CSV</${Download}>
      </p>
      <${Table} columns=${columns} rows=${rows} caption="Published numbers" />
      <details>
        <summary>Why may mine differ?</summary>
        <p>${data?.rule}.</p>
        <ul>
          ${(data?.why ?? []).map((/** @type {string} */ one) => html`<li>${clip(one, 300)}</li>`)}
        </ul>
      </details>
    </section>
  `;
}
