// SPDX-License-Identifier: Apache-2.0
/** Who is best on which datasets, with how sure that is and how often each failed. */
import { address, useAddress } from '../core/address.js';
import { csvOf, useData } from '../core/api.js';
import { Chart } from '../core/chart.js';
import { columnOptions, Filters, isNumeric, shownByFilters, useColumns } from '../core/filters.js';
import { axisName, cell, clip, columnTitle, keysText, number } from '../core/format.js';
import { Choice, Fault, Link, NothingFits, Notes, Table, useTitle, Waiting } from '../core/parts.js';
import { published } from '../core/questions.js';
import { foremost, useNarrow } from '../core/narrow.js';
import { Mark, suspectOf, useSuspects } from '../core/suspects.js';
import { html } from '../core/ui.js';
import { failureText } from './groups.js';
import { HOLLOW, publishedText } from '../charts/scatter.js';
import { PublishedRows, usePublished } from './published.js';

/** What tells competitors apart. */
export const COMPETITORS = [
  ['algorithm,sensors', 'algorithm and sensors'],
  ['algorithm', 'algorithm'],
  ['algorithm,sensors,algorithm.version', 'algorithm, sensors, version'],
];

/**
 * Return the columns that tell competitors apart unless the address says it: with earlier versions too,
 * each version competes.
 * @param {import('../core/address.js').Query} query
 */
export const usualCompetitors = (query) => COMPETITORS[query.get('superseded') === '1' ? 2 : 0][0];

export default function Leaderboard() {
  const { query, change } = useAddress();
  useTitle('Leaderboard');
  const columns = useColumns();
  const set = {
    metric: query.get('metric', 'ate.rmse'),
    by: query.get('by', usualCompetitors(query)),
    outcomes: query.get('outcomes', 'tracked'),
  };
  const url = address('/api/v1/analysis/leaderboard', query.filters().with(set));
  const state = useData(url);
  const suspects = useSuspects();
  const all = columns.data?.items ?? [];
  /** @param {string} name */
  const wrong = (name) => (state.error?.field === name ? state.error : null);
  const elsewhere =
    state.error && !shownByFilters(state.error, query) && !['metric', 'by'].includes(state.error.field ?? '');
  const tables = published(all);
  const beside = usePublished(query.filters(), true);
  return html`
    <h1>Leaderboard</h1>
    ${
      query.get('embed') !== '1' &&
      html`
        <section class="controls" aria-label="What is ranked">
          <div class="row">
            <${Choice}
              label="Measured by"
              value=${set.metric}
              options=${columnOptions(all, isNumeric)}
              error=${wrong('metric')}
              onChange=${(metric) => change({ metric })}
            />
            <${Choice}
              label="Competitors"
              value=${set.by}
              options=${COMPETITORS}
              error=${wrong('by')}
              onChange=${(by) => change({ by })}
            />
            <${Choice}
              label="Runs"
              value=${set.outcomes}
              options=${[['tracked', 'tracked'], ['all', 'all evaluated']]}
              onChange=${(outcomes) => change({ outcomes })}
            />
          </div>
          <p class="row">
            <${Link} href=${address('/studies', query.with({ kind: 'pairs' }))}>
              Tests of pairs
            </${Link}>
            ${tables.map(
              ({ title, page, settings }) => html`
                <${Link} href=${address(page, { ...settings, title })}>${title}</${Link}>
              `,
            )}
          </p>
        </section>
        <${Filters} columns=${all} error=${state.error} />
      `
    }
    ${elsewhere && html`<${Fault} error=${state.error} />`}
    ${
      state.data
        ? html`
          <p class="quiet">
            Ranks are by the median of each dataset; runs that failed count as worse than any that
            did not.${' '}
            <a href=${csvOf(url)} download>
              CSV
            </a>
          </p>
          ${state.data.boards.map(
            (/** @type {Api.Board} */ board) => html`
              <${Board}
                board=${board}
                metric=${state.data.metric}
                by=${state.data.by}
                csv=${csvOf(url)}
                suspects=${suspects}
                beside=${beside}
              />
            `,
          )}
          <${PublishedRows} filters=${query.filters()} metrics=${[state.data.metric]} />
          ${state.data.boards.length === 0 && html`<${NothingFits} />`}
          <${Notes} notes=${state.data.notes} />
        `
        : !state.error && html`<${Waiting} />`
    }
  `;
}

/**
 * @param {{board: Api.Board, metric: Api.Heading, by: string[], csv: string, suspects: Api.Suspect[],
 *   beside: Api.PublishedRow[]}} props beside: published numbers
 */
function Board({ board, metric, by, csv, suspects, beside }) {
  const narrow = useNarrow();
  const facets = keysText(board.facets);
  const factor = metric.factor ?? 1;
  const first = metric.better ? 'best' : 'smallest';
  // What is suspect on one dataset is marked there, what is so on all beside the competitor.
  const told = suspects.filter((one) => one.keys.dataset !== undefined);
  const always = suspects.filter((one) => one.keys.dataset === undefined);
  /** @type {TableColumn[]} */
  const columns = [
    { name: 'rank', kind: 'number', title: 'rank' },
    { name: 'between', title: 'between' },
    ...by.map((name, at) => ({
      name,
      title: columnTitle(name),
      show: (/** @type {Api.Value} */ value, /** @type {Api.Ranked} */ entry) => html`
        ${clip(cell(value), 48)}
        ${
          at === by.length - 1 &&
          html`
            <${Mark} suspect=${suspectOf(always, { ...board.facets, ...entry.keys })} />
          `
        }
      `,
    })),
    { name: 'score', kind: 'number', title: `score (0 ${first})` },
    { name: 'ratio', title: metric.better === 'higher' ? 'the best over it' : `over the ${first}` },
    { name: 'n', kind: 'integer', title: 'n' },
    { name: 'runs', kind: 'integer', title: 'runs' },
    { name: 'failed', kind: 'integer', title: 'failed' },
    ...board.datasets.map((dataset) => ({
      name: `dataset ${dataset}`,
      title: dataset,
      show: (/** @type {Api.Score|undefined} */ one, /** @type {Api.Ranked} */ entry) =>
        one &&
        html`
          <${Result}
            one=${one}
            metric=${metric}
            suspect=${suspectOf(told, { ...board.facets, ...entry.keys, dataset })}
          />
        `,
    })),
  ];
  const rows = board.entries.map((entry) => ({
    ...entry.keys,
    keys: entry.keys,
    rank: entry.rank,
    between: interval(entry.rankInterval),
    score: entry.score,
    n: entry.n,
    runs: entry.runs,
    failed: entry.failed,
    ratio: entry.ratioFailed
      ? 'the median run failed'
      : `${number(entry.ratio, 3)}× ${entry.ratioInterval ? `(${interval(entry.ratioInterval)})` : ''}`,
    ...Object.fromEntries(entry.datasets.map((one) => [`dataset ${one.dataset}`, one])),
  }));
  /** @type {ChartOption} */
  const option = {
    grid: { left: 72, right: 24, top: 44, bottom: 34 },
    legend: {},
    tooltip: {
      trigger: 'item',
      formatter: ({ seriesName, name, data, value }) =>
        data?.published
          ? publishedText(data.published)
          : `${seriesName}\n${name}: ${data?.label ? 'the median run failed' : number(value)}`,
    },
    xAxis: { type: 'category', data: board.datasets.map((name) => clip(name, 28)), name: '' },
    yAxis: { type: 'value', name: `${clip(axisName(metric), 40)}, median`, nameGap: 52 },
    series: [
      ...board.entries.map((entry) => ({
        type: 'bar',
        barMaxWidth: 36,
        name: clip(keysText(entry.keys), 50),
        data: board.datasets.map((name) => {
          const found = entry.datasets.find((one) => one.dataset === name);
          if (found?.medianFailed) return { value: 0, label: FAILED };
          return found?.median === null || found?.median === undefined ? null : found.median * factor;
        }),
      })),
      ...publishedMarks(board, metric, beside),
    ],
  };
  return html`
    <section>
      <h2>
        ${clip(board.datasets.join(', '), 200)}${' '}
        ${facets && html`<span class="quiet">${clip(facets, 200)}</span>`}
      </h2>
      <${Table}
        columns=${narrow ? foremost(columns, ['rank', 'score', ...by]) : columns}
        rows=${rows}
        caption=${`Leaderboard on ${clip(board.datasets.join(', '), 100)}`}
      />
      ${
        board.entries.length > 1 &&
        html`
          <p></p>
          <${Chart}
            option=${option}
            height=${300}
            csv=${csv}
            table=${{ columns, rows }}
            title=${`${metric.title} on ${clip(board.datasets.join(', '), 80)}`}
          />
        `
      }
    </section>
  `;
}

/**
 * Return hollow marks of published numbers over the bars, as a series; [] for none.
 * @param {Api.Board} board
 * @param {Api.Heading} metric
 * @param {Api.PublishedRow[]} rows
 */
const publishedMarks = (board, metric, rows) => {
  const data = rows
    .filter((row) => row.values[metric.name] !== undefined && board.datasets.includes(row.dataset))
    .map((row) => ({
      published: row,
      value: [board.datasets.indexOf(row.dataset), row.values[metric.name] * (metric.factor ?? 1)],
    }));
  const dress = { type: 'scatter', name: 'published', symbol: 'diamond', symbolSize: 11, itemStyle: HOLLOW };
  return data.length ? [{ ...dress, data }] : [];
};

/** A median run that failed has no bar: a cross stands in its place. */
const FAILED = { show: true, position: 'top', formatter: '×', fontSize: 15, color: 'inherit' };

/** @param {Api.Interval|null|undefined} range */
const interval = (range) => (range ? `${number(range.low, 3)} to ${number(range.high, 3)}` : '–');

/** @param {{one: Api.Score, metric: Api.Heading, suspect?: Api.Suspect}} props */
const Result = ({ one, metric, suspect }) => {
  /** @param {number|null} value */
  const scaled = (value) => number(value === null ? null : value * (metric.factor ?? 1), 3);
  const told = [
    `n ${one.n}/${one.runs}`,
    ...(one.n > 1 && one.summary ? [`${scaled(one.summary.min)}–${scaled(one.summary.max)}`] : []),
    `cov. ${number(one.coverage, 3)}`,
  ];
  return html`
    <b>
      ${one.medianFailed ? 'failed' : number(one.median === null ? null : one.median * (metric.factor ?? 1))}
    </b>
    <${Mark} suspect=${suspect} />
    <br />
    <small>
      ${told.join(', ')}
      ${
        one.runs > one.n
          ? html`
            <br />
            ${failureText(one.failures)}
          `
          : ''
      }
    </small>
  `;
};
