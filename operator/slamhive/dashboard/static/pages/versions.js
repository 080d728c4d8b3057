// SPDX-License-Identifier: Apache-2.0
/** Before and after: what an edited algorithm or dataset changed, with its test. */
import { ratioChart, settingText, toldApart } from '../charts/ratios.js';
import { Chart } from '../core/chart.js';
import { cell, clip, number, plural, time } from '../core/format.js';
import { Table } from '../core/parts.js';
import { html, useMemo } from '../core/ui.js';
import { failureText } from './groups.js';

const MOST_DRAWN = 12;
const SUBJECT = ['algorithm', 'sensors', 'dataset'];

/** @param {Api.Change} change */
const subject = (change) =>
  Object.entries(change.keys)
    .map(([name, value]) => (SUBJECT.includes(name) ? cell(value) : `${name} ${cell(value)}`))
    .join(', ');
/** @param {Api.Change} change */
const named = (change) => `${subject(change)}${change.changed === 'dataset' ? ' (dataset edited)' : ''}`;
/** @param {string} text */
const wrapped = (text) => html`<span class="wrapped">${clip(text, 400)}</span>`;

/** @param {{one: Api.Version}} props */
const Version = ({ one }) => html`
  <code>${one.version}</code>
  <br />
  <small>
    ${plural(one.runs, 'run')}
    ${one.last ? `, last ${time(one.last)}` : ''}
  </small>
`;

/**
 * The study of all changes.
 * @param {{data: Api.Versions, csv: string, without: Shown}} props data: answer of /api/v1/analysis/versions
 */
export function Versions({ data, csv, without }) {
  if (data.changes.length === 0) return without;
  /** @type {TableColumn[]} */
  const columns = [
    { name: 'keys', title: 'of', show: (_, change) => clip(named(change), 80) },
    { name: 'before', title: 'before', show: (one) => html`<${Version} one=${one} />` },
    {
      name: 'after',
      title: 'after',
      show: (one, change) => html`
        <${Version} one=${one} />
        ${
          !change.current &&
          html`
            <br />
            <small>not the current one</small>
          `
        }
      `,
    },
    { name: 'sentence', title: 'in words', show: wrapped },
    {
      name: 'ratio',
      title: 'after over before',
      kind: 'number',
      show: (ratio, change) => (ratio === null ? (change.n ? 'failed' : '–') : number(ratio, 3)),
    },
    {
      name: 'n',
      title: 'settings',
      kind: 'integer',
      show: (n, change) => html`
        ${number(n)}
        ${
          change.unpaired > 0 &&
          html`
            <br />
            <small>${number(change.unpaired)} not in both</small>
          `
        }
      `,
    },
    {
      name: 'pHolm',
      title: 'p',
      kind: 'number',
      show: (p) => (p === null ? '–' : p <= 0.05 ? html`<b>${number(p, 3)}</b>` : number(p, 3)),
    },
  ];
  const drawn = data.changes.filter((change) => change.n > 0).slice(0, MOST_DRAWN);
  return html`
    <div>
      <${Table} columns=${columns} rows=${data.changes} caption="Versions before and after" />
      ${drawn.map(
        (change) => html`
          <${Change}
            key=${`${subject(change)} ${change.before.version}`}
            change=${change}
            metric=${data.metric}
            csv=${csv}
          />
        `,
      )}
      ${
        data.changes.length > drawn.length &&
        html`
          <p class="quiet">
            ${drawn.length} of ${data.changes.length} changes are drawn: filter by algorithm or
            dataset; the CSV has all.
          </p>
        `
      }
    </div>
  `;
}

/** @param {{change: Api.Change, metric: Api.Heading, csv: string}} props */
function Change({ change, metric, csv }) {
  const drawn = useMemo(() => ratioChart(change, metric), [change, metric]);
  const told = toldApart(change.settings);
  /** @type {TableColumn[]} */
  const columns = [
    { name: 'keys', title: 'setting', show: (keys) => wrapped(settingText(keys, told)) },
    {
      name: 'before',
      title: `${metric.title} before`,
      show: (side) => html`<${Median} side=${side} metric=${metric} />`,
    },
    { name: 'after', title: 'after', show: (side) => html`<${Median} side=${side} metric=${metric} />` },
    {
      name: 'ratio',
      title: 'after over before',
      kind: 'number',
      show: (ratio, one) =>
        one.after.medianFailed
          ? one.before.medianFailed
            ? 'both failed'
            : 'fails now'
          : one.before.medianFailed
            ? 'failed before'
            : number(ratio, 3),
    },
  ];
  return html`
    <section>
      <h2>
        ${clip(named(change), 160)}${' '}
        <span class="quiet">
          ${change.before.version} → ${change.after.version}
        </span>
      </h2>
      <p>
        ${clip(change.sentence, 400)}
        ${change.test && html`<span class="quiet">Tested by ${change.test}.</span>`}
      </p>
      ${
        drawn &&
        html`
          <${Chart}
            option=${drawn.option}
            height=${drawn.height}
            csv=${csv}
            table=${{ columns, rows: change.settings }}
            title=${`${clip(metric.title, 60)} after over before: ${clip(subject(change), 80)}`}
          />
        `
      }
      <${Table}
        columns=${columns}
        rows=${change.settings}
        caption=${`Settings of ${clip(named(change), 100)}`}
      />
      <${Differences} differences=${change.differences} />
    </section>
  `;
}

/**
 * A median with what it stands on.
 * @param {{side: Api.Side, metric: Api.Heading}} props
 */
const Median = ({ side, metric }) => html`
  <b>
    ${side.medianFailed ? 'failed' : number(side.median === null ? null : side.median * (metric.factor ?? 1))}
  </b>
  <br />
  <small>
    n ${side.n}/${side.runs}
    ${side.deterministic ? ', all equal' : ''}
    ${Object.keys(side.failures).length ? `; ${failureText(side.failures)}` : ''}
  </small>
`;

/**
 * The other differences: the change itself, and what might be taken for it.
 * @param {{differences: Api.Change['differences']}} props
 */
function Differences({ differences }) {
  if (differences.length === 0) return null;
  /** @param {Api.Value[]} list */
  const values = (list) => clip(list.map((value) => clip(cell(value), 24)).join(', '), 100);
  return html`
    <details>
      <summary>Other differences (${differences.length})</summary>
      <dl class="facts">
        ${differences.map(
          (one) => html`
            <dt>${clip(one.column, 80)}</dt>
            <dd>
              ${values(one.before)} → ${values(one.after)}
            </dd>
          `,
        )}
      </dl>
    </details>
  `;
}
