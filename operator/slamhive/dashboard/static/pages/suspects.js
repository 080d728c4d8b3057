// SPDX-License-Identifier: Apache-2.0
/** What runs are measured by and is the likelier one to be wrong: calibrations, nodes, ground truth. */
import { nodesChart, suspectChart } from '../charts/spread.js';
import { truthChart } from '../charts/truth.js';
import { address, useAddress } from '../core/address.js';
import { csvOf, useData } from '../core/api.js';
import { Chart } from '../core/chart.js';
import { cell, clip, columnTitle, number, plural } from '../core/format.js';
import { Download, Fault, Link, Notes, Table, Waiting } from '../core/parts.js';
import { html, useMemo } from '../core/ui.js';

/** @param {{data: Api.Suspects, csv: string, without: Shown}} props */
export const Suspects = (props) => html`
  <h2>Scales</h2>
  <${Scales} ...${props} />
  <h2>Nodes</h2>
  <${Nodes} />
  <h2>Ground truth</h2>
  <${Truths} />
`;

/** What nodes measure of equal runs: those that need more CPU time than others of their kind first. */
function Nodes() {
  const { query } = useAddress();
  const url = address('/api/v1/analysis/suspects/nodes', query.filters());
  const state = useData(url);
  /** @type {Api.Nodes|null} */
  const data = state.current;
  const drawn = useMemo(() => data && nodesChart(data.items), [data]);
  if (state.error) return html`<${Fault} error=${state.error} />`;
  if (!data || !drawn) return html`<${Waiting} />`;
  /** @type {TableColumn[]} */
  const columns = [
    { name: 'node', title: 'node', show: (name) => clip(name, 60) },
    { name: 'kind', title: 'kind', show: (kind) => clip(kind, 120) },
    {
      name: 'sentence',
      title: 'in words',
      show: (text) => html`<span class="wrapped">${clip(text, 400)}</span>`,
    },
    { name: 'ratio', title: 'CPU time by the others’', kind: 'number' },
    { name: 'low', title: 'at least', kind: 'number' },
    { name: 'high', title: 'at most', kind: 'number' },
    { name: 'settings', title: 'settings', kind: 'integer' },
    { name: 'runs', title: 'runs', kind: 'integer' },
  ];
  return html`
    <p class="quiet">
      CPU time of a node’s runs by that of equal runs on other nodes with the same processor and clock. A
      node is named when its whole interval is beyond 5 %; 95 in 100 times all intervals hold together.
    </p>
    ${
      data.items.length > 0 &&
      html`
        <${Chart}
          option=${drawn.option}
          height=${drawn.height}
          csv=${csvOf(url)}
          table=${{ columns, rows: data.items }}
          title="Nodes against others of their kind"
        />
        <${Table} columns=${columns} rows=${data.items} caption="Nodes against others of their kind" />
      `
    }
    <${Notes} notes=${data.notes} />
  `;
}

/** @param {{data: Api.Suspects, csv: string, without: Shown}} props */
function Scales({ data, csv, without }) {
  const drawn = useMemo(() => suspectChart(data.items), [data]);
  if (data.items.length === 0) return without;
  const names = [...new Set(data.items.flatMap((item) => Object.keys(item.keys)))];
  /** @type {TableColumn[]} */
  const columns = [
    ...names.map((name) => ({
      name: `key ${name}`,
      title: columnTitle(name),
      show: (/** @type {unknown} */ _, /** @type {Api.Suspect} */ item) =>
        item.keys[name] === undefined ? 'all' : clip(cell(item.keys[name]), 48),
    })),
    { name: 'n', title: 'runs', kind: 'integer' },
    { name: 'scale', title: 'scale', kind: 'number' },
    { name: 'spread', title: 'spread', kind: 'number', show: (value) => number(value, 2) },
    {
      name: 'shown',
      title: 'drawn',
      sortable: false,
      show: (_, item) => html`
        <${Link}
          href=${address('/explore', {
            kind: 'scatter',
            x: 'run',
            y: 'scale',
            colour: 'dataset',
            ...item.keys,
          })}
        >
          its scales
        </${Link}>
      `,
    },
    {
      name: 'sentence',
      title: 'in words',
      show: (text) => html`<span class="wrapped">${clip(text, 400)}</span>`,
    },
  ];
  return html`
    <${Chart}
      option=${drawn.option}
      height=${drawn.height}
      csv=${csv}
      table=${{ columns, rows: data.items }}
      title="Scales that are off"
    />
    <${Table} columns=${columns} rows=${data.items} caption="Suspect calibrations" />
  `;
}

/** What the algorithms say of the ground truth, dataset by dataset: those with suspects first. */
function Truths() {
  const { query } = useAddress();
  const url = address('/api/v1/analysis/suspects/truth', query.filters());
  const state = useData(url);
  /** @type {Api.TruthSuspects|null} */
  const data = state.current;
  if (state.error) return html`<${Fault} error=${state.error} />`;
  if (!data) return html`<${Waiting} />`;
  /** @param {Api.TruthSuspect} one */
  const suspects = (one) => one.found?.stretches.length ?? -1;
  const items = [...data.items].sort((a, b) => suspects(b) - suspects(a));
  return html`
    <p class="quiet">
      Stretches in which runs of three algorithms or more agree with each other and not with the truth: it is
      the likelier one to be wrong there, or a sensor that all of them use. Whoever agrees leaves the
      stretch out by <code>groundTruth.holes</code>.${' '}
      <${Download} href=${csvOf(url)}>CSV</${Download}>
    </p>
    ${
      items.length === 0 &&
      html`
        <p class="empty">No ground truth can be compared: it takes three algorithms that tracked.</p>
      `
    }
    ${items.map((one) => html`<${Truth} key=${one.dataset} one=${one} />`)}
    <${Notes} notes=${data.notes} />
  `;
}

/** @param {{one: Api.TruthSuspect}} props */
function Truth({ one }) {
  const { found } = one;
  const option = useMemo(() => found && truthChart(found), [found]);
  const title = clip(one.dataset, 80);
  if (!found || !option) {
    return html`
      <h3>${title}</h3>
      <p class="empty">Not compared: ${clip(one.why ?? '', 300)}.</p>
      <${Notes} notes=${one.leftOut} />
    `;
  }
  const begin = found.profile[0][0];
  /** @type {TableColumn[]} */
  const columns = [
    { name: 'from', title: 'from [s]', kind: 'number' },
    { name: 'to', title: 'to [s]', kind: 'number' },
    { name: 'begin', title: 'sensor time [s]', show: (value) => value.toFixed(2) },
    { name: 'metres', title: 'off by [m]', kind: 'number' },
    { name: 'spread', title: 'algorithms differ by [m]', kind: 'number' },
    { name: 'ratio', title: 'standard errors', kind: 'number', show: (value) => number(value, 2) },
  ];
  const rows = found.stretches.map((part) => ({
    ...part,
    from: part.begin - begin,
    to: part.end - begin,
  }));
  /** @type {TableColumn[]} */
  const figures = [
    { name: 'system', title: 'algorithm' },
    { name: 'rmse', title: 'RMSE [m]', kind: 'number' },
    { name: 'without', title: 'RMSE without suspects [m]', kind: 'number' },
  ];
  const systems = found.systems.map((system) => ({
    system,
    rmse: found.rmse[system],
    without: found.rmseWithout[system],
  }));
  return html`
    <section>
      <h3>
        ${title}${' '}
        <span class="quiet">
          ${rows.length === 0 ? 'nothing suspect' : `${rows.length} suspect`} in${' '}
          ${number(found.seconds, 4)} s, by ${plural(one.runs, 'run')} of ${found.systems.length} algorithms
        </span>
      </h3>
      <${Chart}
        option=${option}
        height=${240}
        csv=${true}
        table=${{ columns: PROFILE, rows: profileRows(found) }}
        title=${`Algorithms against the ground truth of ${title}`}
      />
      ${
        rows.length > 0 &&
        html`
          <${Table} columns=${columns} rows=${rows} caption=${`Suspect stretches of ${title}`} />
          <${Table}
            columns=${figures}
            rows=${systems}
            caption=${`Errors on ${title} with and without the suspect stretches`}
          />
          <p class="quiet">
            RMSE is of the mean path of an algorithm’s runs, aligned to what fits of the truth.
          </p>
        `
      }
      <${Notes} notes=${one.leftOut} />
    </section>
  `;
}

/** @type {TableColumn[]} */
const PROFILE = [
  { name: 'time', title: 'time [s]', kind: 'number' },
  { name: 'metres', title: 'mean of the algorithms from the truth [m]', kind: 'number' },
  { name: 'error', title: 'standard error [m]', kind: 'number' },
];

/** @param {Api.Suspicion} found */
const profileRows = (found) =>
  found.profile.map(([stamp, metres, error]) => ({ time: stamp - found.profile[0][0], metres, error }));
