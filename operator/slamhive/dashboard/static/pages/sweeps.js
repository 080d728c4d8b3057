// SPDX-License-Identifier: Apache-2.0
/** Sweeps: how far each is, what its points are, what came out best. */
import { address, Query, useAddress } from '../core/address.js';
import { useAll, useData } from '../core/api.js';
import { isNumeric } from '../core/filters.js';
import { cell, clip, number, time } from '../core/format.js';
import { Empty, Fault, Link, runLink, Status, Table, useTitle, Waiting } from '../core/parts.js';
import { html } from '../core/ui.js';
import { RunRows } from './runrows.js';

const MOST_DATASETS = 12;
const MOST_SETTINGS = 6;
const MOST_DRAWN = 4;
const GROUPS = ['parameters', 'input', 'resources'];

export default function Sweeps() {
  const { path, query } = useAddress();
  const namespace = query.all('namespace')[0] ?? null;
  return path.length > 1
    ? html`
      <${One} key=${`${namespace} ${path[1]}`} name=${path[1]} namespace=${namespace} />
    `
    : html`
      <${All} />
    `;
}

function All() {
  useTitle('Sweeps');
  const { data, error } = useData('/api/v1/sweeps');
  if (data?.items.length === 0)
    return html`
      <h1>Sweeps</h1>
      <${Empty} />
    `;
  return html`
    <h1>Sweeps</h1>
    <${Fault} error=${error} />
    ${data ? html`<${SweepCards} sweeps=${data.items} level="h2" />` : !error && html`<${Waiting} />`}
  `;
}

/**
 * How far a sweep is: finished, running, yet to begin.
 * @param {{sweep: Api.Sweep}} props
 */
export function Progress({ sweep }) {
  const phases = sweep.phases ?? {};
  const finished = (phases.Succeeded ?? 0) + (phases.Failed ?? 0);
  const total =
    sweep.total ??
    Math.max(
      sweep.runs ?? 0,
      Object.values(phases).reduce((/** @type {number} */ sum, count) => sum + (count ?? 0), 0),
    );
  const rest = Object.entries(phases).filter(
    ([phase, count]) => count && !['Succeeded', 'Failed'].includes(phase),
  );
  return html`
    <progress
      max=${total || 1}
      value=${finished}
      aria-label=${`${finished} of ${total} runs of ${clip(sweep.name, 80)} are finished`}
    ></progress>
    <p>
      <b>${number(finished)}</b> of ${number(total)} runs finished
      ${finished < total ? ` (${number((100 * finished) / total, 3)} %)` : ''}
      ${rest.map(
        ([phase, count]) => html`
          ${' '}
          <${Status} value=${phase} /> ${number(count)}
        `,
      )}
    </p>
  `;
}

/**
 * What became of runs, with their numbers.
 * @param {{statuses: Api.Counts, label?: string}} props
 */
export const Statuses = ({ statuses, label }) => html`
  <p class="statuses" aria-label=${label}>
    ${Object.entries(statuses ?? {}).map(
      ([status, count]) => html`
        <span>
          <${Status} value=${status} /> ${number(count)}
        </span>
      `,
    )}
  </p>
`;

/** @param {Array<{name?: string|null, count?: number}>} axes */
const axesText = (axes) =>
  axes.map((axis) => `${axis.name ?? 'points'}${axis.count ? ` (${axis.count})` : ''}`).join(', ');

/**
 * Return the place of a sweep as the API takes it: empty for a workstation, null where its name says enough.
 * @param {Api.Sweep} sweep
 * @param {Api.Sweep[]} [sweeps] all of them: two may have one name in different places
 */
const placeOf = (sweep, sweeps = []) =>
  sweep.namespace ?? (sweeps.some((one) => one.name === sweep.name && one.namespace) ? '' : null);

/**
 * Return the filters that mean the runs of a sweep.
 * @param {string} name
 * @param {string|null} namespace as of placeOf
 */
const runsOf = (name, namespace) =>
  new Query([['sweep', name]]).with(namespace === null ? {} : { namespace: namespace || 'null' });

/**
 * Return the address of a sweep, of a page or of the API.
 * @param {string} name
 * @param {string|null} namespace
 * @param {string} [prefix]
 */
const sweepAddress = (name, namespace, prefix = '') =>
  address(
    `${prefix}/sweeps/${encodeURIComponent(name)}`,
    new Query(namespace === null ? [] : [['namespace', namespace]]),
  );

/**
 * Sweeps in short.
 * @param {{sweeps: Api.Sweep[], shown?: Api.Sweep[], level?: string}} props shown: those that have a card;
 *   level: of their headings
 */
export const SweepCards = ({ sweeps, shown = sweeps, level = 'h3' }) => html`
  <div class="cards">
    ${shown.map(
      (sweep) => html`
        <${SweepCard}
          key=${`${sweep.namespace ?? ''} ${sweep.name}`}
          sweep=${sweep}
          namespace=${placeOf(sweep, sweeps)}
          level=${level}
        />
      `,
    )}
  </div>
`;

/**
 * Where a sweep is, on a cluster.
 * @param {{sweep: Api.Sweep}} props
 */
const Place = ({ sweep }) => sweep.namespace !== null && html`<small>in ${clip(sweep.namespace, 80)}</small>`;

/**
 * How often a sweep was edited, and what that superseded: "2 versions, 24 superseded runs".
 * @param {{sweep: Api.Sweep, namespace: string|null}} props
 */
function Versions({ sweep, namespace }) {
  const parts = [];
  if (sweep.versions > 1) parts.push(`${number(sweep.versions)} versions`);
  if (sweep.superseded > 0)
    parts.push(
      html`<${Link}
        href=${address(
          '/runs',
          runsOf(sweep.name, namespace).with({ superseded: 1, where: 'superseded is not null' }),
        )}
      >
        ${number(sweep.superseded)} superseded ${sweep.superseded === 1 ? 'run' : 'runs'}
      </${Link}>`,
    );
  return (
    parts.length > 0 &&
    html`
      <p>
        ${parts.map(
          (part, at) => html`
            ${at > 0 && ', '}
            ${part}
          `,
        )}
      </p>
    `
  );
}

/** @param {{sweep: Api.Sweep, namespace: string|null, level: string}} props */
function SweepCard({ sweep, namespace, level }) {
  return html`
    <article class="card">
      <${level}>
        <${Link} href=${sweepAddress(sweep.name, namespace)}>${clip(sweep.name, 80)}</${Link}>
        <${Place} sweep=${sweep} />
        ${sweep.live && html`<span class="status live">live</span>`}
      </${level}>
      <${Progress} sweep=${sweep} />
      <${Statuses} statuses=${sweep.statuses} />
      <${Versions} sweep=${sweep} namespace=${namespace} />
      <p class="quiet">
        ${clip((sweep.algorithms ?? []).join(', '), 120)}
        <br />
        ${clip((sweep.datasets ?? []).join(', '), 120)}
      </p>
      ${sweep.axes?.length > 0 && html`<p class="quiet">over ${clip(axesText(sweep.axes), 200)}</p>`}
      ${
        sweep.best?.length > 0 &&
        html`
          <p>
            smallest ATE:${' '}
            ${sweep.best.slice(0, 3).map(
              (best, at) => html`
                ${at > 0 && ', '}
                <${Link}
                  href=${address('/runs', runsOf(sweep.name, namespace).with({ name: best.name }))}
                >
                  ${number(best.ate)} m
                </${Link}>${' '}
                ${clip(best.dataset ?? '', 60)}
              `,
            )}
          </p>
        `
      }
      ${sweep.started && html`<p class="quiet">since ${time(sweep.started)}</p>`}
    </article>
  `;
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
  const varied = (columns.data?.items ?? []).filter(
    (/** @type {Api.Column} */ one) => GROUPS.includes(one.group) && one.distinct > 1,
  );
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
    ['created', sweep.created && time(sweep.created)],
    ['first run began', sweep.started && time(sweep.started)],
    ['last run ended', sweep.finished && time(sweep.finished)],
    ['evaluation', sweep.evaluation && clip(cell(sweep.evaluation), 200)],
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
        </p>
      </section>
      <${Conditions} conditions=${sweep.conditions} />
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
                    ['usage.cpu.meanCores', 'CPU'],
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
          ...varied.slice(0, MOST_SETTINGS).map((one) => one.name),
          'ate.rmse',
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
 * @param {{sweep: Api.Sweep, only: Query, settings: Api.Column[]}} props
 */
function Best({ sweep, only, settings }) {
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
    ...answers[0].columns.filter(
      (/** @type {Api.Heading} */ one) => !['uid', 'run', 'dataset'].includes(one.name),
    ),
  ];
  return html`
    <section>
      <h2>Smallest ATE on each dataset</h2>
      <${Table}
        columns=${columns}
        rows=${answers.map((data) => data.items[0])}
        caption="The tracked run with the smallest ATE on each dataset"
      />
    </section>
  `;
}
