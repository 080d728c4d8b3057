// SPDX-License-Identifier: Apache-2.0
/** Sweeps in short: how far each is, what became of its runs, and how their errors lie. */
import { address, Query } from '../core/address.js';
import { clip, number, plural, statusClass, time } from '../core/format.js';
import { Link, Status } from '../core/parts.js';
import { html } from '../core/ui.js';

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
  // A search ends before all the runs that it might have had: its bar tells outcomes, not how far it is.
  const of = sweep.search ? '' : ` of ${total}`;
  const title = `${finished}${of} runs of ${clip(sweep.name, 80)} are finished`;
  const share = sweep.search ? 1 : finished / (total || 1);
  return html`
    <${Bar} statuses=${sweep.statuses} share=${share} title=${title} />
    <p>
      <b>${number(finished)}</b>${sweep.search ? '' : ` of ${number(total)}`} runs finished
      ${finished < total && !sweep.search ? ` (${number((100 * finished) / total, 3)} %)` : ''}
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
 * A bar of what became of runs: failures are as seen in it as what tracked.
 * @param {{statuses: Api.Counts, share?: number, title: string}} props share: of the runs, that is finished
 */
export function Bar({ statuses, share = 1, title }) {
  const ended = Object.entries(statuses ?? {}).flatMap(([status, count]) =>
    count && statusClass(status) !== 'live' ? [{ status, count }] : [],
  );
  const all = ended.reduce((sum, { count }) => sum + count, 0) || 1;
  const told = ended.map(({ status, count }) => `${count} ${status}`).join(', ');
  return html`
    <div class="bar" role="img" aria-label=${told ? `${title}: ${told}` : title}>
      ${['good', 'plain', 'fair', 'bad'].flatMap((kind) =>
        ended
          .filter(({ status }) => statusClass(status) === kind)
          .map(
            ({ status, count }) => html`
              <span
                class=${kind}
                style=${{ width: `${(100 * share * count) / all}%` }}
                title=${`${count} ${status}`}
              ></span>
            `,
          ),
      )}
    </div>
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
export const axesText = (axes) =>
  axes.map((axis) => `${axis.name ?? 'points'}${axis.count ? ` (${axis.count})` : ''}`).join(', ');

/**
 * Return the place of a sweep as the API takes it: empty for a workstation, null where its name says enough.
 * @param {Api.Sweep} sweep
 * @param {Api.Sweep[]} [sweeps] all of them: two may have one name in different places
 */
export const placeOf = (sweep, sweeps = []) =>
  sweep.namespace ?? (sweeps.some((one) => one.name === sweep.name && one.namespace) ? '' : null);

/**
 * Return the filters that mean the runs of a sweep.
 * @param {string} name
 * @param {string|null} namespace as of placeOf
 */
export const runsOf = (name, namespace) =>
  new Query([['sweep', name]]).with(namespace === null ? {} : { namespace: namespace || 'null' });

/**
 * Return the address of a sweep, of a page or of the API.
 * @param {string} name
 * @param {string|null} namespace
 * @param {string} [prefix]
 * @param {string} [part] of what is told of it
 */
export const sweepAddress = (name, namespace, prefix = '', part = '') =>
  address(
    `${prefix}/sweeps/${encodeURIComponent(name)}${part}`,
    new Query(namespace === null ? [] : [['namespace', namespace]]),
  );

/**
 * Sweeps in short, and all single runs together.
 * @param {{data: Api.Sweeps, most?: number, level?: string}} props most: sweeps that have a card; level: of
 *   their headings
 */
export const SweepCards = ({ data, most = Infinity, level = 'h3' }) => html`
  <div class="cards">
    ${severalOf(data)
      .slice(0, most)
      .map(
        (sweep) => html`
        <${SweepCard}
          key=${`${sweep.namespace ?? ''} ${sweep.name}`}
          sweep=${sweep}
          namespace=${placeOf(sweep, data.items)}
          level=${level}
        />
      `,
      )}
    ${data.single.runs > 0 && html`<${SingleCard} single=${data.single} level=${level} />`}
  </div>
`;

/**
 * Return the sweeps of several runs.
 * @param {Api.Sweeps} data
 */
export const severalOf = (data) => data.items.filter((sweep) => !sweep.single);

/** @param {{single: Api.Sweeps['single'], level: string}} props */
const SingleCard = ({ single, level }) => html`
  <article class="card">
    <${level}>
      <${Link} href=${address('/sweeps', { single: 1 })}>
        ${plural(single.runs, 'single run')}
      </${Link}>
      ${single.live && html`<span class="status live">live</span>`}
    </${level}>
    <${Bar} statuses=${single.statuses} title="Single runs" />
    <${Statuses} statuses=${single.statuses} />
    ${single.finished && html`<p class="quiet">the last ended ${time(single.finished)}</p>`}
  </article>
`;

/** Share of the picture's width that the axis begins with, so that a lone value at 1 is seen. */
const LEFT = 2;

/**
 * How the errors of a sweep lie: of each algorithm the smallest, the median and the largest over the smallest
 * of all on the same dataset, on a logarithmic axis; what failed has a column of its own.
 * @param {{sweep: Api.Sweep}} props
 */
export function Spread({ sweep }) {
  const rows = sweep.spread ?? [];
  if (!rows.length) return null;
  const most = rows.reduce((found, one) => Math.max(found, one.high ?? 1), 1);
  /** @param {number|null} ratio */
  const place = (ratio) => LEFT + ((96 - LEFT) * Math.log(ratio ?? 1)) / Math.log(Math.max(most, 1.1));
  const left = (sweep.algorithms?.length ?? 0) - rows.length;
  return html`
    <ul class="spread">
      ${rows.map(
        ({ algorithm, low, median, high, failed }) => html`
          <li key=${algorithm}>
            <span>${clip(algorithm, 40)}</span>
            <span
              role="img"
              aria-label=${
                low === null
                  ? 'no run tracked'
                  : `ATE ${number(low, 3)} to ${number(high, 3)} times the smallest, ` +
                    `median ${number(median, 3)}`
              }
            >
              ${
                low !== null &&
                html`
                  <i style=${{ left: `${place(low)}%`, width: `${place(high) - place(low)}%` }}></i>
                  <b style=${{ left: `${place(median)}%` }}></b>
                `
              }
            </span>
            <span class=${failed ? 'bad' : 'quiet'}>${failed ? `${number(failed)} failed` : ''}</span>
          </li>
        `,
      )}
    </ul>
    ${
      rows[0].low !== null &&
      html`
        <p class="quiet small">
          ATE over the smallest on the same dataset, 1 to ${number(most, 3)} times, logarithmic${
            left > 0 ? `; left out: ${plural(left, 'more algorithm')}` : ''
          }
        </p>
      `
    }
  `;
}

/**
 * Where a sweep is, on a cluster.
 * @param {{sweep: Api.Sweep}} props
 */
export const Place = ({ sweep }) =>
  sweep.namespace !== null && html`<small>in ${clip(sweep.namespace, 80)}</small>`;

/**
 * How often a sweep was edited, and what that superseded: "2 versions, 24 superseded runs".
 * @param {{sweep: Api.Sweep, namespace: string|null}} props
 */
export function Versions({ sweep, namespace }) {
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
        ${plural(sweep.superseded, 'superseded run')}
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
      <${Spread} sweep=${sweep} />
      <${Versions} sweep=${sweep} namespace=${namespace} />
      <p class="quiet">
        ${
          (sweep.algorithms?.length ?? 0) > (sweep.spread?.length ?? 0) &&
          html`${clip(sweep.algorithms.join(', '), 120)}<br />`
        }
        ${clip((sweep.datasets ?? []).join(', '), 120)}
      </p>
      ${sweep.axes?.length > 0 && html`<p class="quiet">over ${clip(axesText(sweep.axes), 200)}</p>`}
      ${
        sweep.best?.length > 0 &&
        html`
          <p>
            smallest ATE${
              sweep.best.length < (sweep.datasets?.length ?? 0) &&
              ` (on ${sweep.best.length} of ${sweep.datasets.length} datasets)`
            }:${' '}
            ${sweep.best.map(
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
