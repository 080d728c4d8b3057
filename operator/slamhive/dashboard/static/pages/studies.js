// SPDX-License-Identifier: Apache-2.0
/** What the runs prove: competitors two by two, settings that matter, what repeats, what is suspect. */
import { importanceCharts } from '../charts/importance.js';
import { pairsChart, sure } from '../charts/pairs.js';
import { spreadChart } from '../charts/spread.js';
import { address, useAddress } from '../core/address.js';
import { csvOf, useData } from '../core/api.js';
import { Chart } from '../core/chart.js';
import { columnOptions, Filters, isMeasure, isSetting, shownByFilters, useColumns } from '../core/filters.js';
import { cell, clip, columnTitle, keysText, number, signOf, SUBJECT, tellingKeys } from '../core/format.js';
import {
  Choice,
  Download,
  Fault,
  Link,
  Notes,
  Outcomes,
  Places,
  Table,
  useTitle,
  Waiting,
} from '../core/parts.js';
import { foremost, useNarrow } from '../core/narrow.js';
import { html, useMemo } from '../core/ui.js';
import { Common, EACH_RUN, Narrowing } from './common.js';
import { failureText } from './groups.js';
import { COMPETITORS, usualCompetitors } from './leaderboard.js';
import { Robustness } from './robustness.js';
import { Suspects } from './suspects.js';
import { Versions } from './versions.js';

/**
 * Each study: what it is called, its address, what it shows, which settings it has.
 * @type {Record<string, Study>}
 */
const STUDIES = {
  pairs: {
    text: 'Pairs',
    path: 'compare',
    Shown: Pairs,
    settings: ['metric', 'by', 'outcomes', 'most', 'first'],
    says:
      'Competitors two by two over the datasets that both have: medians are paired, a failed median ' +
      'loses, p is of an exact test by flipping signs and corrected after Holm.',
  },
  importance: {
    text: 'What matters',
    path: 'importance',
    Shown: Importance,
    settings: ['metric'],
    says:
      'How much of the variation each setting explains. Points that a search chose by their results are ' +
      'left out.',
  },
  repeatability: {
    text: 'Repeatability',
    path: 'repeatability',
    Shown: Repeatability,
    settings: ['metric'],
    says: 'Runs of the very same configuration. Equal trajectories count once.',
  },
  robustness: {
    text: 'Robustness',
    path: 'robustness',
    Shown: Robustness,
    settings: ['axes'],
    says:
      'Up to where on each axis each system still works, from searches for thresholds and from grids. Bars ' +
      'end at the last value that passes, crosses are the first that fails, lines span where the threshold ' +
      'lies in 95 of 100 cases.',
  },
  versions: {
    text: 'Before and after',
    path: 'versions',
    Shown: Versions,
    settings: ['metric', 'outcomes'],
    says:
      'The latest version of each algorithm and dataset against the ones before it, setting by setting: ' +
      'medians are paired, failed runs last. From 6 settings on signs are flipped, in fewer the ' +
      'repetitions are permuted; p is corrected for the number of earlier versions.',
  },
  common: {
    text: 'Common support',
    path: 'common',
    Shown: Common,
    settings: ['by', 'outcomes'],
    says:
      'Runs of a dataset are measured again, each aligned anew, over the time in which all of them have ' +
      'poses: who gave up before the hard part gains nothing by it.',
  },
  suspects: {
    text: 'Suspects',
    path: 'suspects',
    Shown: Suspects,
    settings: [],
    says:
      'Where what runs are measured by is the likelier one to be wrong: scales that are off 1 by the same ' +
      'factor in all runs, nodes that need more CPU time than others of their kind, and stretches of ' +
      'ground truth that different algorithms contradict together.',
  },
};
const MOST_SUBJECTS = 12;
const MOST_ROWS = 200;
/** @type {Record<string, string>} */
const EVALUATED = { common: 'all' };
/** @type {Record<string, string>} */
const WITHOUT = {
  pairs: 'No two competitors have a dataset in common.',
  importance: 'No setting varies over enough runs.',
  repeatability: 'No configuration that fits these filters ran more than once.',
  common: 'No evaluated run fits these filters. Remove one of them.',
  robustness: 'No number was varied over runs that fit these filters.',
  versions: 'No algorithm or dataset that fits these filters ran in more than one version.',
  suspects:
    'No scale is suspect: of sensors that know the scale, none is off 1 by the same factor in all runs ' +
    '(it takes three tracked runs and an alignment with scale, sim3).',
};

export default function Studies() {
  const { query, change } = useAddress();
  const kind = Object.hasOwn(STUDIES, query.get('kind')) ? query.get('kind') : 'pairs';
  const study = STUDIES[kind];
  useTitle(query.get('title') || study.text);
  const columns = useColumns();
  const all = columns.data?.items ?? [];
  /** @type {Record<string, string>} */
  const set = {
    metric: query.get('metric', 'ate.rmse'),
    by: query.get('by', usualCompetitors(query)),
    outcomes: query.get('outcomes', EVALUATED[kind] ?? 'tracked'),
    most: query.get('most'),
    first: query.get('first'),
    axes: query.get('axes'),
  };
  const asked = Object.fromEntries(study.settings.map((name) => [name, set[name] || null]));
  const url = address(`/api/v1/analysis/${study.path}`, query.filters().with(asked));
  const state = useData(url);
  /** @param {string} name */
  const wrong = (name) => (state.error?.field === name ? state.error : null);
  const elsewhere =
    state.error && !shownByFilters(state.error, query) && !study.settings.includes(state.error.field ?? '');
  /** @param {[string, Study]} entry */
  const tab = ([name, one]) => html`
    <${Link}
      href=${address('/studies', query.with({ kind: name, title: null }))}
      aria-current=${name === kind ? 'page' : null}
    >
      ${one.text}
    </${Link}>
  `;
  return html`
    <h1>${clip(query.get('title') || study.text, 120)}</h1>
    ${
      query.get('embed') !== '1' &&
      html`
        <nav class="tabs" aria-label="Studies">
          ${Object.entries(STUDIES).map(tab)}
        </nav>
        ${
          study.settings.length > 0 &&
          html`
            <section class="controls" aria-label="What is studied">
              <div class="row">
                ${
                  study.settings.includes('metric') &&
                  html`
                    <${Choice}
                      label="Measured by"
                      value=${set.metric}
                      options=${columnOptions(all, isMeasure)}
                      error=${wrong('metric')}
                      onChange=${(metric) => change({ metric })}
                    />
                  `
                }
                ${
                  study.settings.includes('axes') &&
                  html`
                    <${Choice}
                      label="Axis"
                      value=${set.axes ?? ''}
                      options=${columnOptions(all, isSetting)}
                      none="those that were sought"
                      error=${wrong('axes')}
                      onChange=${(/** @type {string} */ axes) => change({ axes: axes || null })}
                    />
                  `
                }
                ${
                  study.settings.includes('by') &&
                  html`
                    <${Choice}
                      label="Competitors"
                      value=${set.by}
                      options=${kind === 'common' ? [...COMPETITORS, [EACH_RUN, 'each run']] : COMPETITORS}
                      error=${wrong('by')}
                      onChange=${(by) => change({ by })}
                    />
                  `
                }
                ${
                  study.settings.includes('outcomes') &&
                  html`
                    <${Outcomes}
                      value=${set.outcomes}
                      error=${wrong('outcomes')}
                      onChange=${(outcomes) => change({ outcomes })}
                    />
                  `
                }
              </div>
            </section>
          `
        }
        <${Filters}
          columns=${all}
          error=${state.error}
          hint=${html`<${Narrowing} columns=${all} error=${state.error} />`}
          versions=${kind !== 'versions'}
        />
      `
    }
    ${elsewhere && html`<${Fault} error=${state.error} />`}
    <p class="quiet">
      ${study.says}${' '}
      ${
        state.current &&
        html`
          <${Download} href=${csvOf(url)}>
            CSV
          </${Download}>
        `
      }
    </p>
    ${
      state.current
        ? html`
          <${study.Shown}
            key=${kind}
            data=${state.current}
            csv=${csvOf(url)}
            without=${html`<p class="empty">${WITHOUT[kind]}</p>`}
          />
          <${Notes} notes=${state.current.notes} />
        `
        : !state.error && html`<${Waiting} />`
    }
  `;
}

/**
 * @param {Api.Interval|null} interval
 * @param {string} [otherwise]
 */
const range = (interval, otherwise = '–') =>
  interval
    ? `${number(interval.low, 3)} to ${interval.high === null ? '∞' : number(interval.high, 3)}`
    : otherwise;
/** @param {number|null} p */
const small = (p) =>
  p === null || p === undefined ? '–' : p < 0.05 ? html`<b>${number(p, 3)}</b>` : number(p, 3);

const PALE = ' (pale: may be chance)';

/** @param {{data: Api.Compare, csv: string, without: Shown}} props */
function Pairs({ data, csv, without }) {
  const drawn = useMemo(
    () =>
      data.boards
        .filter((board) => board.pairs.length)
        .map((board) => ({ board, option: pairsChart(board.pairs, data.metric) })),
    [data],
  );
  const narrow = useNarrow();
  const { query, change } = useAddress();
  const largest = [...data.boards].sort((a, b) => b.competitors - a.competitors)[0];
  const places = html`
    <${Places}
      ...${largest ?? { competitors: 0, shown: 0 }}
      first=${Number(query.get('first', '1'))}
      onChange=${(first) => change({ first })}
    />
  `;
  if (drawn.length === 0) return [places, without];
  /** @type {TableColumn[]} */
  const columns = [
    { name: 'a', title: 'a', show: (keys) => clip(keysText(keys), 60) },
    { name: 'b', title: 'b', show: (keys) => clip(keysText(keys), 60) },
    {
      name: 'sentence',
      title: 'in words',
      show: (text) => html`<span class="wrapped">${clip(text, 400)}</span>`,
    },
    {
      name: 'ratio',
      title: 'b over a',
      kind: 'number',
      show: (ratio) => (ratio === null ? 'failed' : number(ratio, 3)),
    },
    { name: 'ratioInterval', title: 'between', show: (interval) => range(interval) },
    { name: 'effect', title: 'effect size', kind: 'number', show: (value) => number(value, 2) },
    { name: 'p', title: 'p', kind: 'number', show: (p) => number(p, 3) },
    { name: 'pHolm', title: 'p after Holm', kind: 'number', show: small },
  ];
  const question = data.metric.better ? 'Who is better than whom' : 'Who has less than whom';
  const [green, purple] = signOf(data.metric) > 0 ? ['smaller', 'larger'] : ['larger', 'smaller'];
  const sections = drawn.map(
    ({ board, option }) => html`
      <section>
        ${keysText(board.facets) && html`<h2>${clip(keysText(board.facets), 200)}</h2>`}
        <${Chart}
          option=${option.option}
          height=${option.height}
          csv=${csv}
          table=${{ columns, rows: board.pairs }}
          title=${`${question}: ${clip(data.metric.title, 60)}${board.pairs.every(sure) ? '' : PALE}`}
        />
        <p class="quiet">
          Green: the row's figures are ${green} than the column's, on more datasets and by more;
          purple: ${purple}. The size of the effect is the matched-pairs rank-biserial correlation,
          from −1 to 1; the numbers are datasets won and lost; a star marks p after Holm below 0.05,
          and what is pale may be chance, or is on too few datasets to tell.
        </p>
        <${Table}
          columns=${narrow ? foremost(columns, ['sentence']) : columns}
          rows=${board.pairs}
          caption="Competitors two by two"
          fixed=${narrow ? 0 : 2}
        />
      </section>
    `,
  );
  return [places, ...sections];
}

/** @param {{data: Api.Importance, csv: string, without: Shown}} props */
function Importance({ data, csv, without }) {
  const drawn = useMemo(() => {
    const shown = data.subjects.filter((one) => one.parameters.length);
    const told = tellingKeys(shown.map((one) => one.keys));
    return shown.slice(0, MOST_SUBJECTS).map((subject) => ({
      subject,
      name: keysText(Object.fromEntries(told.map((key) => [key, subject.keys[key]]))),
      ...importanceCharts(subject),
    }));
  }, [data]);
  if (drawn.length === 0) return without;
  /** @type {TableColumn[]} */
  const columns = [
    { name: 'name', title: 'setting', show: (name) => clip(name, 80) },
    { name: 'distinct', title: 'values', kind: 'integer' },
    {
      name: 'variance',
      title: 'variance explained',
      kind: 'number',
      show: (value) => share(value),
    },
    {
      name: 'rankCorrelation',
      title: 'rank correlation',
      kind: 'number',
      show: (value) => number(value, 2),
    },
    {
      name: 'failures',
      title: 'of failing explained',
      kind: 'number',
      show: (value) => share(value),
    },
  ];
  return html`
    <div class=${drawn.length > 1 ? 'facets' : ''}>
      ${drawn.map(
        ({ subject, name, option, height, rows }) => html`
          <section>
            <${Chart}
              option=${option}
              height=${height}
              csv=${csv}
              table=${{ columns, rows }}
              title=${clip(name, 120)}
            />
            <${Table} columns=${columns} rows=${rows} caption=${`Settings of ${clip(name, 100)}`} />
            <p class="quiet">
              ${number(subject.n)} tracked runs of ${number(subject.runs)};${' '}
              ${share(subject.unexplained)} of the variance stays unexplained.
            </p>
          </section>
        `,
      )}
    </div>
    ${
      data.subjects.length > MOST_SUBJECTS &&
      html`
        <p class="quiet">
          ${MOST_SUBJECTS} of ${data.subjects.length} are drawn: filter by algorithm or dataset; the
          CSV has all.
        </p>
      `
    }
  `;
}

/** @param {number|null|undefined} value */
const share = (value) => (value === null || value === undefined ? '–' : `${number(100 * value, 3)} %`);

/** @param {{data: Api.Repeatability, csv: string, without: Shown}} props */
function Repeatability({ data, csv, without }) {
  const drawn = useMemo(() => spreadChart(data), [data]);
  const narrow = useNarrow();
  if (data.groups.length === 0) return without;
  const names = Object.keys(data.groups[0].keys);
  const told = names.filter((name) => new Set(data.groups.map((group) => String(group.keys[name]))).size > 1);
  const factor = data.metric.factor ?? 1;
  /** @param {number|null|undefined} value */
  const scaled = (value) => (value === null || value === undefined ? null : value * factor);
  /**
   * @param {string[]} wanted
   * @returns {TableColumn[]}
   */
  const keyed = (wanted) =>
    wanted.map((name) => ({
      name: `key ${name}`,
      title: columnTitle(name),
      show: (_, group) => clip(cell(group.keys[name]), 90),
    }));
  const [subject, settings] = [true, false].map((is) => told.filter((name) => SUBJECT.includes(name) === is));
  const whom = subject.filter((name) => name !== 'sensors').map((name) => `key ${name}`);
  const few = settings.length <= 3;
  /** @type {TableColumn[]} */
  const columns = [
    ...keyed([...subject, ...(few ? settings : [])]),
    {
      name: 'verdict',
      title: 'in words',
      show: (text) => html`<span class="wrapped">${clip(text, 300)}</span>`,
    },
    { name: 'runs', title: 'runs', kind: 'integer' },
    { name: 'n', title: 'tracked', kind: 'integer', show: (n, { copies }) => number(n + copies) },
    { name: 'distinct', title: 'different results', kind: 'integer' },
    { name: 'failures', title: 'failures', show: failureText },
    {
      name: 'figure',
      title: `${data.metric.title} median`,
      kind: 'number',
      show: (figure) => number(scaled(figure?.median)),
    },
    {
      name: 'least',
      title: 'least',
      kind: 'number',
      show: (_, group) => number(scaled(group.figure?.min)),
    },
    {
      name: 'most',
      title: 'largest',
      kind: 'number',
      show: (_, group) => number(scaled(group.figure?.max)),
    },
    { name: 'relativeSpread', title: 'spread', kind: 'number', show: share },
    ...(few ? [] : keyed(settings)),
  ];
  return html`
    ${
      drawn &&
      html`
        <${Chart}
          option=${drawn.option}
          height=${drawn.height}
          csv=${csv}
          table=${{ columns, rows: data.groups }}
          title=${`Repetitions over their median: ${clip(data.metric.title, 60)}`}
        />
      `
    }
    <${Table}
      columns=${narrow ? foremost(columns, [...whom, 'relativeSpread', 'figure']) : columns}
      rows=${data.groups.slice(0, MOST_ROWS)}
      caption="Configurations and their repetitions"
      fixed=${subject.length}
    />
    ${
      data.groups.length > MOST_ROWS &&
      html`
        <p class="quiet">The ${MOST_ROWS} with most runs are shown; the CSV has all.</p>
      `
    }
  `;
}
