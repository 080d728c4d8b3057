// SPDX-License-Identifier: Apache-2.0
/** Who is best on which datasets, with how sure that is and how often each failed. */
import { causal } from '../charts/causal.js';
import { interval, MOST, onFew, scores, standings } from '../charts/standings.js';
import { address, useAddress } from '../core/address.js';
import { csvOf, useAnswered, useData } from '../core/api.js';
import { Chart } from '../core/chart.js';
import DEFAULTS from '../core/defaults.json' with { type: 'json' };
import { columnOptions, Filters, isMeasure, shownByFilters, useColumns } from '../core/filters.js';
import { clip, columnTitle, keysText, number } from '../core/format.js';
import {
  Choice,
  Download,
  Fault,
  Link,
  Notes,
  NothingFits,
  Table,
  useTitle,
  Waiting,
} from '../core/parts.js';
import { published } from '../core/questions.js';
import { foremost, useNarrow } from '../core/narrow.js';
import { Mark, suspectOf, useSuspects, useUnlikeNodes } from '../core/suspects.js';
import { TruthLink } from '../core/truth.js';
import { html, useMemo } from '../core/ui.js';
import { failureText, groupTable, onPhone } from './groups.js';
import { PublishedRows, usePublished } from './published.js';

/** What tells competitors apart. */
export const COMPETITORS = DEFAULTS.competitors;

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
  const unlike = useUnlikeNodes([set.metric]);
  const all = columns.data?.items ?? [];
  /** @param {string} name */
  const wrong = (name) => (state.error?.field === name ? state.error : null);
  const elsewhere =
    state.error && !shownByFilters(state.error, query) && !['metric', 'by'].includes(state.error.field ?? '');
  const tables = published(all);
  const beside = usePublished(query.filters(), true);
  const timely = state.data?.timely;
  const timelyCsv = csvOf(
    address(
      '/api/v1/analysis/aggregate',
      query.filters().with({
        by: timely?.keys.map((/** @type {Api.Heading} */ one) => one.name).join(',') ?? '',
        metrics: timely?.metrics.map((/** @type {Api.Heading} */ one) => one.name).join(',') ?? '',
        outcomes: set.outcomes,
      }),
    ),
  );
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
              options=${columnOptions(all, isMeasure)}
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
            <${Download} href=${csvOf(url)}>
              CSV
            </${Download}>${' '}
            <${TruthLink} filters=${query.filters()} />
          </p>
          <${Pooled} data=${state.data} asked=${query.filters().with(set)} />
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
          <${Timely} data=${state.data.timely} csv=${timelyCsv} />
          <${PublishedRows} filters=${query.filters()} metrics=${[state.data.metric]} />
          ${state.data.boards.length === 0 && html`<${NothingFits} />`}
          <${Notes} notes=${[...state.data.notes, ...unlike]} />
        `
        : !state.error && html`<${Waiting} />`
    }
  `;
}

/** Columns of groups that a table of timeliness has no room for; the leaderboard above has them. */
const BESIDE_FIGURES = ['coverage', 'failures', 'equal', 'findings', 'reader', 'late', 'chosen'];

/**
 * What was known when: causal beside final errors, latencies, and whether nodes kept up.
 * @param {{data: (Api.Aggregate & {words: string})|null, csv: string}} props
 */
function Timely({ data, csv }) {
  const narrow = useNarrow();
  const drawn = useMemo(() => data && causal(data), [data]);
  if (!data?.groups.length) return null;
  const table = groupTable(data, ['median']);
  const columns = (narrow ? onPhone(table) : table.columns)
    .filter(({ name }) => !BESIDE_FIGURES.includes(name))
    .map((one) => ({ ...one, title: one.title?.replace(/ median$/, '') }));
  const metric = data.metrics[0].title?.replace(', final', '');
  return html`
    <section>
      <h2>When poses came</h2>
      <p class="quiet">${data.words}</p>
      ${
        drawn &&
        html`
          <${Chart}
            option=${drawn.option}
            height=${drawn.height}
            csv=${csv}
            title=${`${metric}: causal and final`}
            summary="What a robot knew at the time, and at the end; the table has its numbers"
          />
        `
      }
      <${Table} columns=${columns} rows=${table.rows} caption="Causal and final errors, latency" fixed=${1} />
    </section>
  `;
}

/** Settings that rows are over and that are named. */
const MOST_TOLD = 3;

/**
 * The settings that rows are over, which no run has all of, whose, and where they are told apart.
 * @param {{data: Api.Leaderboard, asked: import('../core/address.js').Query}} props asked: for what
 */
function Pooled({ data: { pooled, whose, by }, asked }) {
  const { query } = useAddress();
  const names = Object.keys(pooled);
  const told = names.slice(0, MOST_TOLD).map((name) => {
    const apart = { by: [...by, name].join(',') };
    return { name, apart, url: address('/api/v1/analysis/leaderboard', asked.with(apart)) };
  });
  const answered = useAnswered(told.map(({ url }) => url));
  if (names.length === 0) return null;
  return html`
    <p>
      Rows are over
      ${told.map(({ name, apart, url }, at) => {
        const beside = [
          whose[name] && clip(whose[name].join(', '), 60),
          answered.includes(url) &&
            html`
              <${Link} href=${address('/leaderboard', query.with(apart))}>
                tell them apart
              </${Link}>
            `,
        ].filter(Boolean);
        return html`
          ${at ? ', ' : ' '}${number(pooled[name])} values of ${clip(columnTitle(name), 60)}${
            beside.length > 0 &&
            html`
              ${' ('}${beside[0]}${beside.length > 1 && html`${'; '}${beside[1]}`})
            `
          }
        `;
      })}
      ${names.length > MOST_TOLD && `, and ${names.length - MOST_TOLD} further settings`}.
    </p>
  `;
}

/**
 * @param {{board: Api.Board, metric: Api.Heading, by: string[], csv: string, suspects: Api.Suspect[],
 *   beside: Api.PublishedRow[]}} props beside: published numbers
 */
function Board({ board, metric, by, csv, suspects, beside }) {
  const narrow = useNarrow();
  const facets = keysText(board.facets);
  const first = metric.better ? 'best' : 'smallest';
  // What is suspect on one dataset is marked there, what is so on all beside the competitor.
  const told = suspects.filter((one) => one.keys.dataset !== undefined);
  const always = suspects.filter((one) => one.keys.dataset === undefined);
  const few = board.entries.filter((entry) => onFew(board, entry));
  const drawn = useMemo(() => {
    const own = beside.filter(
      (row) => row.values[metric.name] !== undefined && board.datasets.includes(row.dataset),
    );
    return {
      standings: standings(board, metric),
      scores: board.datasets.length > 1 || own.length ? scores(board, metric, own) : null,
    };
  }, [board, metric, beside]);
  /** @type {TableColumn[]} */
  const columns = [
    { name: 'rank', kind: 'number', title: 'rank' },
    {
      name: 'competitor',
      title: by.map(columnTitle).join(', '),
      show: (/** @type {string} */ name, /** @type {{keys: Api.Keys}} */ row) => html`
        ${clip(name, 130)}
        <${Mark} suspect=${suspectOf(always, { ...board.facets, ...row.keys })} />
      `,
    },
    {
      name: 'datasets',
      title: 'datasets',
      show: (/** @type {string} */ text, /** @type {{few: boolean}} */ row) =>
        row.few ? html`<span class="status fair">${text}</span>` : text,
    },
    { name: 'ratio', title: metric.better === 'higher' ? 'the best over it' : `over the ${first}` },
    { name: 'between', title: 'rank between' },
    { name: 'score', kind: 'number', title: `score (0 ${first})` },
    { name: 'n', kind: 'integer', title: 'n' },
    { name: 'runs', kind: 'integer', title: 'runs' },
    { name: 'failed', kind: 'integer', title: 'failed' },
    ...board.datasets.map((dataset) => ({
      name: `dataset ${dataset}`,
      title: dataset,
      show: (/** @type {Api.Score|undefined} */ one, /** @type {{keys: Api.Keys}} */ row) =>
        one &&
        html`
          <${Result}
            one=${one}
            metric=${metric}
            suspect=${suspectOf(told, { ...board.facets, ...row.keys, dataset })}
          />
        `,
    })),
  ];
  const rows = board.entries.map((entry) => ({
    keys: entry.keys,
    few: few.includes(entry),
    competitor: keysText(entry.keys),
    datasets: `${entry.datasets.length} of ${board.datasets.length}`,
    rank: entry.rank,
    between: interval(entry.rankInterval),
    score: entry.score,
    n: entry.n,
    runs: entry.runs,
    failed: entry.failed,
    ratio: ratioText(entry),
    ...Object.fromEntries(entry.datasets.map((one) => [`dataset ${one.dataset}`, one])),
  }));
  const many = board.datasets.length > 3;
  // The picture tells ratios: of one dataset, what they are of comes before them on a phone.
  const only = board.datasets.length === 1 ? [`dataset ${board.datasets[0]}`] : [];
  const over = metric.better === 'higher' ? 'the best over each' : `each over the ${first}`;
  const named = many ? `${board.datasets.length} datasets` : board.datasets.join(', ');
  const left = board.entries.length - MOST;
  return html`
    <section>
      <h2>
        ${clip(named, 200)}${' '}
        <span class="quiet">
          ${[
            many ? `${clip(board.datasets[0], 40)} to ${clip(board.datasets.at(-1), 40)}` : '',
            clip(facets, 200),
          ]
            .filter(Boolean)
            .join(', ')}
        </span>
      </h2>
      ${
        board.entries.length > 1 &&
        html`
          <${Chart}
            option=${drawn.standings.option}
            height=${drawn.standings.height}
            csv=${csv}
            title=${`${metric.title}: ${over}`}
            summary=${`${metric.title} over the ${first} of each dataset; the table has its numbers`}
          />
          <p class="quiet">
            Dots are geometric means over datasets of the ratio to the ${first} there, lines hold them with
            95 % as far as n different results can tell; a single one has no line, one without an end an
            arrow.
            ${few.length > 0 && ' Hollow: on fewer than half as many datasets as others.'}
          </p>
        `
      }
      ${
        few.length > 0 &&
        html`
          <p>
            ${clip(
              few.map((one) => `${keysText(one.keys)} ran on ${one.datasets.length}`).join(', '),
              400,
            )}${' '}
            of ${board.datasets.length} datasets: such a rank says nothing of the other datasets.
          </p>
        `
      }
      <${Table}
        columns=${narrow ? foremost(columns, ['rank', 'competitor', ...only, 'ratio']) : columns}
        rows=${rows}
        caption=${['Leaderboard on', clip(named, 100), clip(facets, 100)].filter(Boolean).join(' ')}
        fixed=${2}
      />
      ${
        board.entries.length > 1 &&
        drawn.scores &&
        html`
          <div class="spaced">
            <${Chart}
              option=${drawn.scores.option}
              height=${drawn.scores.height}
              csv=${csv}
              title=${`${metric.title} on each dataset`}
              summary=${`${metric.title} on each dataset; the table has its numbers`}
            />
          </div>
        `
      }
      ${
        (left > 0 || board.datasets.length > MOST) &&
        html`
          <p class="quiet">
            The pictures show the first ${MOST} competitors and datasets; the table has all.
          </p>
        `
      }
    </section>
  `;
}

/**
 * Return how far an entry is from the best, or why it has no rank.
 * @param {Api.Ranked} entry
 */
const ratioText = (entry) => {
  if (entry.unranked) return `no rank: ${entry.unranked}`;
  if (entry.ratioFailed) return 'the median run failed';
  return `${number(entry.ratio, 3)}× ${entry.ratioInterval ? `(${interval(entry.ratioInterval)})` : ''}`;
};

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
        one.runs > one.n + one.copies
          ? html`
            <br />
            ${failureText(one.failures)}
          `
          : ''
      }
    </small>
  `;
};
