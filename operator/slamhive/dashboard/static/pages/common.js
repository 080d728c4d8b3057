// SPDX-License-Identifier: Apache-2.0
/** Runs measured again over what they have in common: own and common errors and ranks side by side. */
import { dumbbells } from '../charts/dumbbells.js';
import { address, SITE, useAddress } from '../core/address.js';
import { Chart } from '../core/chart.js';
import { cell, clip, columnTitle, keysText, number } from '../core/format.js';
import { Link, Notes, runLink, Status, Table } from '../core/parts.js';
import { html, useMemo } from '../core/ui.js';

/** What tells single runs apart. */
export const EACH_RUN = 'algorithm,sensors,run';
/** What choices are by; a site has figures for one choice of some of them. */
const NARROWING = SITE
  ? ['dataset', 'sweep', 'algorithm']
  : ['dataset', 'evaluation', 'sweep', 'algorithm', 'sensors'];
const MOST_OFFERED = 12;

/**
 * The study of all groups.
 * @param {{data: Api.Common, without: Shown}} props data: answer of /api/v1/analysis/common
 */
export function Common({ data, without }) {
  return html`
    <div>
      ${
        data.groups.length === 0
          ? without
          : data.groups.map(
              (group) => html`
                <${Group} key=${JSON.stringify(group.facets)} group=${group} by=${data.by} />
              `,
            )
      }
    </div>
  `;
}

/** @param {{group: Api.CommonGroup, by: string[]}} props */
function Group({ group, by }) {
  const drawn = useMemo(() => dumbbells(group.entries), [group]);
  const { dataset, ...facets } = group.facets;
  const others = keysText(facets);
  /** @type {TableColumn[]} */
  const keyed = by.map((name) => ({
    name,
    title: columnTitle(name),
    show: (value) => clip(cell(value), 48),
  }));
  /** @type {TableColumn[]} */
  const columns = [
    ...keyed,
    { name: 'rank', title: 'rank in common', kind: 'number' },
    {
      name: 'gained',
      title: 'change',
      show: (gained, entry) => (entry.common === null ? '–' : html`<${Change} gained=${gained} />`),
    },
    { name: 'ownRank', title: 'own rank', kind: 'number' },
    { name: 'common', title: 'ATE in common [m]', kind: 'number', show: error },
    { name: 'own', title: 'own ATE [m]', kind: 'number', show: error },
    { name: 'n', title: 'measured', kind: 'integer' },
    { name: 'runs', title: 'runs', kind: 'integer' },
  ];
  const rows = group.entries.map((entry) => ({
    ...entry.keys,
    ...entry,
    gained: entry.ownRank - entry.rank,
  }));
  return html`
    <section>
      <h2>
        ${clip(cell(dataset), 100)} <span class="quiet">${clip(others, 200)}</span>
      </h2>
      ${group.support && html`<${Support} support=${group.support} />`}
      <${Notes} notes=${group.notes} />
      ${
        group.support &&
        html`
          <${Table}
            columns=${columns}
            rows=${rows}
            caption=${`Competitors on ${clip(cell(dataset), 60)}, own and in common`}
          />
          <p class="quiet">
            Errors are medians of a competitor’s runs, with those that could not be measured
            ranked last; where the median is one of those, it has failed.
          </p>
        `
      }
      ${
        drawn &&
        html`
          <${Chart}
            option=${drawn.option}
            height=${drawn.height}
            csv=${true}
            table=${{ columns, rows }}
            title=${`Own and common error on ${clip(cell(dataset), 60)}, ${clip(others, 60)}`}
          />
          ${legend(group.entries)}
        `
      }
      <${Behind} runs=${group.runs} keyed=${keyed} dataset=${cell(dataset)} />
    </section>
  `;
}

/** @param {number|null} value */
const error = (value) => (value === null ? 'failed' : number(value));

/**
 * What the signs of the chart mean, as far as it has them.
 * @param {Api.CommonEntry[]} entries
 */
function legend(entries) {
  const signs = [
    entries.some((entry) => entry.rank !== entry.ownRank) &&
      'numbers are own ranks and what they become in common',
    entries.some((entry) => entry.common === null) && '× means failed',
  ].filter(Boolean);
  return signs.length > 0 && html`<p class="quiet">In the chart ${signs.join('; ')}.</p>`;
}

/**
 * How much is in common.
 * @param {{support: Api.Support}} props
 */
const Support = ({ support }) => html`
  <dl class="counts">
    ${[
      ['seconds in common', `${number(support.seconds)} s`],
      ['metres in common', `${number(support.metres)} m`],
      ['of the ground truth’s path', `${number(100 * support.share, 3)} %`],
      ['stretches of time', number(support.spans.length)],
    ].map(
      ([name, value]) => html`
        <div>
          <dt>${name}</dt>
          <dd>${value}</dd>
        </div>
      `,
    )}
  </dl>
`;

/**
 * A change of rank in an arrow and a word, not by colour alone.
 * @param {{gained: number}} props
 */
const Change = ({ gained }) =>
  gained === 0
    ? 'same'
    : html`
      <span class=${`status ${gained > 0 ? 'good' : 'fair'}`}>
        ${gained > 0 ? '↑ up' : '↓ down'} ${number(Math.abs(gained))}
      </span>
    `;

/** @param {{runs: Api.CommonRun[], keyed: TableColumn[], dataset: string}} props */
function Behind({ runs, keyed, dataset }) {
  const measured = runs.filter((run) => run.common !== null).length;
  /** @type {TableColumn[]} */
  const columns = [
    { name: 'run', title: 'run', show: (run, row) => runLink(row.uid, cell(run ?? row.uid)) },
    ...keyed.filter((one) => one.name !== 'run' && one.name !== 'status' && one.name !== 'coverage'),
    { name: 'status', title: 'status', show: (status) => html`<${Status} value=${status} />` },
    { name: 'coverage', title: 'coverage', kind: 'number' },
    { name: 'common', title: 'ATE in common [m]', kind: 'number' },
    { name: 'own', title: 'own ATE [m]', kind: 'number' },
    { name: 'poses', title: 'poses in common', kind: 'integer' },
    { name: 'scale', title: 'scale', kind: 'number' },
    {
      name: 'problem',
      title: 'problem',
      show: (problem) =>
        problem === null
          ? '–'
          : html`
            <span class="wrapped">${clip(problem, 400)}</span>
          `,
    },
  ];
  const rows = [...runs].sort((a, b) =>
    (a.common ?? Infinity) === (b.common ?? Infinity) ? 0 : (a.common ?? Infinity) - (b.common ?? Infinity),
  );
  return html`
    <div>
      <h3>
        Runs behind it${' '}
        <span class="quiet">
          ${measured} of ${runs.length} measured
        </span>
      </h3>
      <${Table}
        columns=${columns}
        rows=${rows}
        rowKey="uid"
        caption=${`Runs on ${clip(dataset, 60)} over their common support`}
      />
    </div>
  `;
}

/**
 * What to do where more results are meant than are measured at a time: the next choice that makes them fewer.
 * @param {{columns: Api.Column[], error: ApiFault|null}} props
 */
export function Narrowing({ columns, error: fault }) {
  const { query } = useAddress();
  if (!fault?.message.includes('are measured again at a time')) return null;
  if (SITE && query.filters().pairs.length > 0) return null;
  const column = NARROWING.map((name) => columns.find((one) => one.name === name)).find(
    (one) => one?.values && one.values.length > 1 && query.all(one.name).length !== 1,
  );
  if (!column?.values) return null;
  const offered = column.values.slice(0, MOST_OFFERED);
  return html`
    <p class="row">
      <span>Choose ${article(column.name)}:</span>
      ${offered.map(
        ({ value, count }) => html`
          <${Link} href=${address('/studies', query.with({ [column.name]: String(value) }))}>
            ${clip(cell(value, column), 60)} (${count})
          </${Link}>
        `,
      )}
      ${column.values.length > MOST_OFFERED && html`<span>or another, with “Filter by”</span>`}
    </p>
  `;
}

/** @param {string} noun */
const article = (noun) => `${/^[aeiou]/.test(noun) ? 'an' : 'a'} ${noun}`;

/**
 * A link from runs to their common support; nothing where no two are of one dataset.
 * @param {{runs: Api.Run[]}} props answers of /api/v1/runs/UID
 */
export function CommonLink({ runs }) {
  const datasets = runs.map((run) => run.configuration?.dataset);
  if (SITE || new Set(datasets).size === datasets.length) return null;
  const numbered = new Set(runs.map((run) => String(run.run))).size === runs.length;
  const settings = {
    kind: 'common',
    by: numbered ? EACH_RUN : `${EACH_RUN},uid`,
    uid: runs.map((run) => run.uid),
  };
  return html`
    <${Link} href=${address('/studies', settings)}>Measure these over their common support</${Link}>
  `;
}
