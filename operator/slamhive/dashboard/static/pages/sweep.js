// SPDX-License-Identifier: Apache-2.0
/** One sweep: how far it is, what its points are, what came out best. */
import { address, useAddress } from '../core/address.js';
import { useAll, useData } from '../core/api.js';
import { isNumeric } from '../core/filters.js';
import { cell, clip, cpuColumn, shortTitles, time } from '../core/format.js';
import { foremost, useNarrow } from '../core/narrow.js';
import { Fault, Link, runLink, Table, useTitle, Waiting } from '../core/parts.js';
import { TruthLink } from '../core/truth.js';
import { html } from '../core/ui.js';
import { RunRows } from '../core/runrows.js';
import { axesText, Place, Progress, runsOf, Spread, Statuses, sweepAddress, Versions } from './sweepcards.js';
import { SearchSection } from './sweepsearch.js';

const MOST_DATASETS = 12;
const MOST_SETTINGS = 6;
const MOST_DRAWN = 4;

export default function SweepPage() {
  const { path, query } = useAddress();
  const namespace = query.all('namespace')[0] ?? null;
  return html`<${One} key=${`${namespace} ${path[1]}`} name=${path[1]} namespace=${namespace} />`;
}

/** @param {{name: string, namespace: string}} props */
function One({ name, namespace }) {
  useTitle(name);
  const { data: sweep, error } = useData(sweepAddress(name, namespace, '/api/v1'));
  const place = sweep && namespace === null ? sweep.namespace : namespace;
  const only = runsOf(name, place);
  const columns = useData(address('/api/v1/columns', only));
  if (!sweep)
    return html`
      <div key="waiting">
        <h1>${clip(name, 160)}</h1>
        ${
          error
            ? html`
              <${Fault} error=${error} />
              <p>
                <${Link} href="/sweeps">To all sweeps</${Link}>
              </p>
            `
            : html`
              <${Waiting} />
            `
        }
      </div>
    `;
  /** @type {Api.Column[]} */
  const varied = (columns.data?.items ?? []).filter((/** @type {Api.Column} */ one) =>
    columns.data?.varied.includes(one.name),
  );
  const chosen = varied.slice(0, MOST_SETTINGS).map((one) => one.name);
  const cpu = cpuColumn(columns.data?.items ?? []);
  /**
   * @param {string[]} list
   * @param {string} kind
   */
  const links = (list, kind) =>
    list.map(
      (one, at) => html`
        ${at > 0 && ', '}
        <${Link} href=${`/${kind}/${encodeURIComponent(one)}`}>${clip(one, 60)}</${Link}>
      `,
    );
  const facts = [
    ['algorithms', sweep.algorithms?.length && links(sweep.algorithms, 'algorithms')],
    ['datasets', sweep.datasets?.length && links(sweep.datasets, 'datasets')],
    ['over', sweep.axes?.length && clip(axesText(sweep.axes), 400)],
    // A sweep that is asked for again keeps its runs: the time that is known is that of the last time.
    [
      sweep.created && sweep.started && sweep.created > sweep.started ? 'last asked for' : 'created',
      sweep.created && time(sweep.created),
    ],
    ['first run began', sweep.started && time(sweep.started)],
    ['last run ended', sweep.finished && time(sweep.finished)],
    ['evaluation', sweep.evaluation && clip(inWords(sweep.evaluation), 300)],
    ...shareFacts(sweep.share ?? {}),
  ].filter(([, value]) => value);
  const finished = (sweep.phases?.Succeeded ?? 0) + (sweep.phases?.Failed ?? 0);
  return html`
    <div key="there">
      <h1>
        ${clip(name, 160)}
        <${Place} sweep=${sweep} />
        ${sweep.live && html`<span class="status live">live</span>`}
      </h1>
      <section class="card" aria-label="Progress">
        <${Progress} sweep=${sweep} />
        <${Statuses} statuses=${sweep.statuses} label="Runs by status" />
        <${Spread} sweep=${sweep} />
        <${Versions} sweep=${sweep} namespace=${place} />
        <dl class="facts">
          ${facts.map(
            ([key, value]) => html`
              <dt>${key}</dt>
              <dd>${value}</dd>
            `,
          )}
        </dl>
        <p class="row">
          <${Link} href=${address('/leaderboard', only)}>Leaderboard</${Link}>
          <${Link} href=${address('/studies', only)}>Studies</${Link}>
          <${Link} href=${address('/studies', only.with({ kind: 'versions' }))}>
            Before and after
          </${Link}>
          <${Link} href=${address('/timeline', only)}>Timeline</${Link}>
          <${Link} href=${address('/explore', only)}>Explore</${Link}>
          <${TruthLink} filters=${only} />
        </p>
      </section>
      <${Conditions} conditions=${sweep.conditions} />
      ${sweep.search && html`<${SearchSection} url=${sweepAddress(name, namespace, '/api/v1', '/search')} />`}
      ${
        finished === 0 &&
        html`
          <p class="quiet">No run of it has finished yet; results appear here automatically.</p>
        `
      }
      ${
        varied.length > 0 &&
        html`
          <section>
            <h2>Drawn</h2>
            <ul class="questions">
              ${varied
                .filter(isNumeric)
                .slice(0, MOST_DRAWN)
                .flatMap((axis) =>
                  [
                    ['ate.rmse', 'ATE'],
                    [cpu, 'CPU'],
                    ['usage.memory.peakBytes', 'RAM'],
                  ].map(
                    ([y, text]) => html`
                      <li>
                        <${Link}
                          href=${address(
                            '/explore',
                            only.with({
                              kind: 'line',
                              x: axis.name,
                              y,
                              ...(sweep.datasets?.length > 1 ? { facet: 'dataset' } : {}),
                            }),
                          )}
                        >
                          ${clip(axis.title.replace(/^parameters\./, ''), 60)} vs ${text}
                        </${Link}>
                      </li>
                    `,
                  ),
                )}
            </ul>
          </section>
        `
      }
      <${Best} sweep=${sweep} only=${only} settings=${varied} />
      <${RunRows}
        title="Points"
        filters=${only}
        extra=${[
          ...chosen.slice(0, 1),
          'ate.rmse',
          ...(columns.data?.items.some((/** @type {Api.Column} */ one) => one.name === cpu) ? [cpu] : []),
          ...chosen.slice(1),
          ...(sweep.finished ? ['finished'] : []),
        ]}
        sort="-finished"
      />
      ${
        sweep.manifest &&
        html`
          <details>
            <summary>Definition</summary>
            <pre class="text" tabindex="0">
              ${sweep.manifest}
            </pre>
          </details>
        `
      }
      <p>
        <${Link} href="/sweeps">To all sweeps</${Link}>
      </p>
    </div>
  `;
}

/**
 * Return nested values in words: "alignment Auto, success (minCoverage 0.9)".
 * @param {any} value
 * @returns {string}
 */
const inWords = (value) =>
  Object.entries(value)
    .map(([name, one]) => {
      const parts = [one]
        .flat()
        .map((part) => (part && typeof part === 'object' ? `(${inWords(part)})` : cell(part)));
      return `${name} ${parts.join(', ')}`;
    })
    .join(', ');

/**
 * What it has of the cluster, as its status tells.
 * @param {Record<string, any>} share
 */
function shareFacts(share) {
  const slots = share.of ? ` of ${share.of}` : '';
  return [
    ['fair share', share.fair !== undefined && `${share.fair}${slots} runs at a time`],
    ['priority', share.priority && clip(share.priority, 400)],
    ['place in the line', share.place],
    ['begins', share.begin],
    ['ends', share.end],
    ['forecast', share.forecast],
    ['limited by', share.limit && clip(share.limit, 400)],
    ['sooner by', share.sooner && clip(share.sooner, 400)],
  ];
}

/** @param {{conditions: Api.Condition[]}} props */
function Conditions({ conditions }) {
  if (!conditions?.length) return null;
  /** @type {TableColumn[]} */
  const columns = [
    { name: 'type', title: 'condition' },
    {
      name: 'status',
      title: 'holds',
      show: (value) => (value === 'True' ? 'yes' : value === 'False' ? 'no' : cell(value)),
    },
    { name: 'reason', title: 'reason' },
    {
      name: 'message',
      title: 'what it says',
      show: (value) => html`<span class="wrapped">${clip(cell(value), 600)}</span>`,
    },
    { name: 'lastTransitionTime', title: 'since', show: (value) => time(value) },
  ];
  return html`
    <section>
      <h2>Conditions</h2>
      <${Table} columns=${columns} rows=${conditions} caption="Conditions of the sweep" />
    </section>
  `;
}

/**
 * The run with the smallest error on each dataset: metres of several datasets are not put in one order.
 * @param {{sweep: Api.Sweep, only: import('../core/address.js').Query, settings: Api.Column[]}} props
 */
function Best({ sweep, only, settings }) {
  const narrow = useNarrow();
  const datasets = (sweep.datasets ?? []).slice(0, MOST_DATASETS);
  const chosen = settings.slice(0, MOST_SETTINGS).map((one) => one.name);
  const asked = {
    columns: [
      'uid',
      'run',
      'algorithm',
      'sensors',
      'dataset',
      'evaluation',
      ...chosen,
      'coverage',
      'ate.rmse',
    ].join(','),
    sort: 'ate.rmse',
    limit: 1,
  };
  const found = useAll(
    datasets.map((dataset) => address('/api/v1/runs', only.with({ dataset, status: 'Tracked', ...asked }))),
  );
  const answers = (found ?? [])
    .map((one) => one.data)
    .filter((data) => data?.items.length && data.items[0]['ate.rmse'] !== null);
  if (answers.length === 0) return html`<section></section>`;
  /** @type {TableColumn[]} */
  const columns = [
    { name: 'dataset', title: 'dataset' },
    {
      name: 'run',
      title: 'run',
      show: (run, row) => (row.uid ? runLink(row.uid, cell(run ?? row.uid)) : cell(run)),
    },
    ...shortTitles(answers[0].columns).filter(
      (/** @type {Api.Heading} */ one) => !['uid', 'run', 'dataset'].includes(one.name),
    ),
  ];
  return html`
    <section>
      <h2>Smallest ATE on each dataset</h2>
      <${Table}
        columns=${foremost(
          columns,
          narrow
            ? [...(answers.length > 1 ? ['dataset'] : []), 'algorithm', ...chosen.slice(0, 1), 'ate.rmse']
            : [],
        )}
        rows=${answers.map((data) => data.items[0])}
        caption="The tracked run with the smallest ATE on each dataset"
      />
    </section>
  `;
}
