// SPDX-License-Identifier: Apache-2.0
/** What a search tried: the best so far, the settings, which of them matter, and why some were dropped. */
import { importanceCharts } from '../charts/importance.js';
import { bestSoFar, growingFront, settingLines } from '../charts/search.js';
import { csvOf, useData } from '../core/api.js';
import { Chart } from '../core/chart.js';
import { cell, clip, number, plural } from '../core/format.js';
import { useNarrow } from '../core/narrow.js';
import { Fault, Table, Waiting } from '../core/parts.js';
import { html, useMemo, useState } from '../core/ui.js';

const MOST_ROWS = 100;
/** States of settings that have all their runs. */
const COMPLETE = ['best', 'all runs'];
const RANKS = ['best', 'all runs', 'under way', 'dropped'];

/**
 * The section of a search on the page of its sweep.
 * @param {{url: string}} props url: of the answer
 */
export function SearchSection({ url }) {
  /** @type {Loading<Api.SweepSearch>} */
  const { data, error } = useData(url);
  return html`
    <section aria-label="Search">
      <h2>Search</h2>
      <${Fault} error=${error} />
      ${data ? html`<${Told} data=${data} url=${url} />` : !error && html`<${Waiting} />`}
    </section>
  `;
}

/** @param {{data: Api.SweepSearch, url: string}} props */
function Told({ data, url }) {
  const narrow = useNarrow();
  const csv = csvOf(url);
  const table = useMemo(() => ({ columns: columnsOf(data), rows: rowsOf(data) }), [data]);
  const curve = useMemo(() => data.objectives.length === 1 && bestSoFar(data), [data]);
  const front = useMemo(() => data.objectives.length === 2 && growingFront(data), [data]);
  const lines = useMemo(
    () =>
      data.trials.some((trial) => trial.runs > 0) &&
      data.objectives.length > 0 &&
      settingLines(data, 0, narrow),
    [data, narrow],
  );
  const many = data.contexts.length > 1;
  return html`
    <p>${sentence(data)}</p>
    ${!data.over && html`<p>${toCome(data)}</p>`}
    ${
      curve &&
      html`
        <${Chart} title="Best so far" option=${curve} height=${340} csv=${csv} table=${table} />
        <p class="quiet">
          Each circle is a setting with all of its runs, ${data.block} each: ${data.averaged}, of runs that
          did not fail; a setting of which fewer runs failed is always better. What was dropped had fewer
          runs${many ? ' and not on all datasets, so its figure has no place on this axis' : ''}. Results that
          were taken over from equal runs cost none.
        </p>
      `
    }
    ${
      front &&
      html`
        <${Chart} title="Front" option=${front} height=${380} csv=${csv} table=${table} />
        <p class="quiet">
          Settings with all of their runs, ${data.block} each: ${data.averaged}, of runs that did not fail. On
          a line none is better than another in both.
        </p>
      `
    }
    ${
      lines &&
      html`
        <${Chart}
          title="Settings tried"
          option=${lines}
          height=${narrow ? 90 * (data.axes.length + data.metrics.length) : 380}
          csv=${csv}
          table=${table}
        />
        <p class="quiet">
          A line is a setting; the lighter, the better its ${clip(data.metrics[0].title, 40)} among those with
          all runs; bold: the best. Faint: dropped, failed, or under way.
        </p>
      `
    }
    ${data.objectives.length > 0 && html`<${Matters} data=${data} csv=${csv} />`}
    <${Trials} data=${data} table=${table} />
  `;
}

/** @param {Api.SweepSearch} data */
function sentence(data) {
  const goals = data.objectives
    .map(({ goal }, at) => `${clip(data.metrics[at].title, 60)} ${goal === 'Maximize' ? 'large' : 'small'}`)
    .join(' and ');
  const taken = data.ended - data.computed;
  return html`
    <b>${data.method}</b>${goals && ` to make ${goals}`}: ${clip(data.message, 400)}.
    ${` Computed: ${plural(data.computed, 'run')}`}${
      taken > 0 && `, ${number(taken)} took the result of an equal one`
    }.
  `;
}

/** @param {Api.SweepSearch} data */
const toCome = (data) =>
  `To come: about ${plural(data.expected, 'run')} by what a setting took so far, ` +
  `at most ${number(data.toCome)}` +
  `${data.secondsLeft === null ? '' : `; about ${duration(data.secondsLeft)} at the pace so far`}.`;

/** @param {number} seconds */
const duration = (seconds) =>
  seconds < 90
    ? `${Math.round(seconds)} s`
    : seconds < 5400
      ? `${Math.round(seconds / 60)} min`
      : `${number(seconds / 3600, 2)} h`;

/** @param {{data: Api.SweepSearch, csv: string}} props */
function Matters({ data, csv }) {
  if (!data.influences.length)
    return html`
      <p class="quiet">
        Which settings matter is said of ${data.leastCompared} settings with figures or more;
        ${` ${data.compared}`} have some so far.
      </p>
    `;
  return html`
    <div class=${data.objectives.length > 1 ? 'facets' : ''}>
      ${data.metrics.map((metric, at) => {
        const { option, height, rows } = importanceCharts(
          {
            parameters: data.influences.map((one) => ({ name: one.axis, variance: one.shares[at] })),
            interactions: [],
          },
          'order',
        );
        return html`
          <${Chart}
            key=${metric.name}
            title=${`What matters to ${clip(metric.title, 40)}`}
            option=${option}
            height=${height}
            csv=${csv}
            table=${{
              columns: [
                { name: 'name', title: 'setting' },
                { name: 'variance', title: 'share of the order', kind: 'number' },
              ],
              rows,
            }}
          />
        `;
      })}
    </div>
    <p class="quiet">
      How much of the order of ${data.compared} settings after their first runs each one explains by itself,
      failed ones last. The search looks closer where it is good, so what little matters there may matter
      elsewhere.
    </p>
  `;
}

/** @param {{data: Api.SweepSearch, table: TableData}} props */
function Trials({ data, table }) {
  const [sort, setSort] = useState('');
  const rows = useMemo(() => sorted(table.rows, sort), [table, sort]);
  return html`
    <h3>Settings <span class="quiet">${number(data.trials.length)}</span></h3>
    <p class="quiet">
      In brackets: of fewer runs than all, and so not to be held against others.
    </p>
    <${Table}
      columns=${table.columns}
      rows=${rows.slice(0, MOST_ROWS)}
      caption="Settings that the search tried"
      sort=${sort}
      onSort=${setSort}
      rowKey="number"
    />
    ${
      rows.length > MOST_ROWS &&
      html`
        <p class="quiet">
          The first ${MOST_ROWS} of ${number(rows.length)} are shown; the chart's CSV has all.
        </p>
      `
    }
  `;
}

/** @param {Api.SweepSearch} data */
function columnsOf(data) {
  /** @type {TableColumn[]} */
  const columns = [
    { name: 'number', title: 'setting', show: (value) => String(value) },
    {
      name: 'state',
      title: 'stands',
      show: (value) => html`<span class=${`status ${kindOf(value)}`}>${value}</span>`,
    },
    ...data.metrics.map((metric, at) => ({
      ...metric,
      name: `figure${at}`,
      show: (/** @type {any} */ value, /** @type {any} */ row) =>
        value === null || COMPLETE.includes(row.state) ? cell(value, metric) : `(${cell(value, metric)})`,
    })),
    ...data.axes.map((_, at) => ({
      name: `value${at}`,
      title: data.titles[at],
      show: (/** @type {any} */ value) => (typeof value === 'number' ? number(value) : clip(cell(value), 40)),
    })),
    { name: 'runs', title: 'runs', kind: 'integer' },
    { name: 'failures', title: 'failed' },
    { name: 'told', title: 'told of', kind: 'integer' },
    { name: 'origin', title: 'origin' },
    {
      name: 'dropped',
      title: 'why it was dropped',
      show: (value) => html`<span class="wrapped">${clip(value ?? '', 300)}</span>`,
    },
  ];
  return columns;
}

/** @param {string} state */
const kindOf = (state) => ({ best: 'good', 'all runs': 'plain', 'under way': 'live' })[state] ?? 'fair';

/** @param {Api.SweepSearch} data */
function rowsOf(data) {
  const sign = data.objectives[0]?.goal === 'Maximize' ? -1 : 1;
  const rows = data.trials.map((trial) => ({
    ...trial,
    failures: trial.failed === null ? null : `${Math.round(trial.failed * trial.judged)} of ${trial.judged}`,
    ...Object.fromEntries(data.axes.map(({ label }, at) => [`value${at}`, trial.values[label]])),
    ...Object.fromEntries(trial.figures.map((value, at) => [`figure${at}`, value])),
  }));
  return rows.sort(
    (a, b) =>
      RANKS.indexOf(a.state) - RANKS.indexOf(b.state) ||
      sign * (Number(a.figures[0] ?? sign * Infinity) - Number(b.figures[0] ?? sign * Infinity)) ||
      a.number - b.number,
  );
}

/** @param {Array<Record<string, any>>} rows @param {string} sort */
function sorted(rows, sort) {
  if (!sort) return rows;
  const [name, sign] = sort.startsWith('-') ? [sort.slice(1), -1] : [sort, 1];
  const known = rows.filter((row) => row[name] !== null);
  const missing = rows.filter((row) => row[name] === null);
  known.sort((a, b) => sign * (a[name] < b[name] ? -1 : a[name] > b[name] ? 1 : 0));
  return [...known, ...missing];
}
