// SPDX-License-Identifier: Apache-2.0
/** The start page: what there is, what is running, and what one may ask. */
import { address, SITE } from '../core/address.js';
import { useData } from '../core/api.js';
import { number } from '../core/format.js';
import { Empty, Fault, Link, Notes, useTitle, Waiting } from '../core/parts.js';
import { questions } from '../core/questions.js';
import { html } from '../core/ui.js';
import { severalOf, Statuses, SweepCards } from './sweepcards.js';

/** @type {Array<[string, string, string|null]>} */
const COUNTED = [
  ['runs', 'runs', '/runs'],
  ['sweeps', 'sweeps', '/sweeps'],
  ['algorithms', 'algorithms', '/algorithms'],
  ['datasets', 'datasets', '/datasets'],
  ['live', 'running now', null],
];
/** What is shown of them: a site has what had ended when it was built. */
const SHOWN = COUNTED.filter(([name]) => !SITE || name !== 'live');
const MOST_SWEEPS = 12;

export default function Overview() {
  useTitle('Overview');
  const index = useData('/api/v1');
  const columns = useData('/api/v1/columns');
  /** @type {Loading<Api.Sweeps>} */
  const sweeps = useData('/api/v1/sweeps');
  const several = sweeps.data ? severalOf(sweeps.data) : [];
  // A single run is stored as a sweep of one, and is none to its reader.
  const counts = index.data && { ...index.data.counts, sweeps: sweeps.data && several.length };
  const empty = index.data
    ? index.data.counts.runs === 0 && index.data.counts.sweeps === 0
    : columns.data?.rows === 0;
  if (empty)
    return html`
      <h1 class="hidden">Overview</h1>
      <${Empty} />
    `;
  return html`
    <h1>Overview</h1>
    <${Fault} error=${index.error} />
    ${
      counts &&
      html`
        <dl class="counts">
          ${SHOWN.filter(([name]) => counts[name] !== undefined).map(
            ([name, text, href]) => html`
              <div>
                <dt>${text}</dt>
                <dd>
                  ${
                    href
                      ? html`<${Link} href=${href}>${number(counts[name])}</${Link}>`
                      : number(counts[name])
                  }
                </dd>
              </div>
            `,
          )}
        </dl>
      `
    }
    ${index.data?.statuses && html`<${Statuses} statuses=${index.data.statuses} label="Runs by status" />`}
    <${Superseded} count=${counts?.superseded ?? 0} />
    <h2>Questions</h2>
    <${Questions} columns=${columns} />
    <h2>Sweeps</h2>
    <${Fault} error=${sweeps.error} />
    ${
      sweeps.data
        ? html`
          <${SweepCards} data=${sweeps.data} most=${MOST_SWEEPS} />
          ${
            several.length > MOST_SWEEPS &&
            html`
              <p>
                <${Link} href="/sweeps">All ${number(several.length)} sweeps</${Link}>
              </p>
            `
          }
          ${
            several.length + sweeps.data.single.runs === 0 &&
            html`<p class="quiet">No sweep is known here.</p>`
          }
        `
        : !sweeps.error && html`<${Waiting} />`
    }
    <${Notes} notes=${index.data?.notes} />
  `;
}

/**
 * How many runs are left out as they are of earlier versions, and where they are.
 * @param {{count: number}} props
 */
function Superseded({ count }) {
  if (count === 0) return null;
  const said =
    count === 1
      ? '1 run of an earlier version is left out here'
      : `${number(count)} runs of earlier versions are left out here`;
  return html`
    <p class="quiet">
      ${said}.${' '}
      <${Link} href=${address('/runs', { superseded: 1, where: 'superseded is not null' })}>
        Show them
      </${Link}>${' '}
      <${Link} href=${address('/studies', { kind: 'versions' })}>What changed since</${Link}>
    </p>
  `;
}

/** @param {{columns: Loading<Api.Columns>}} props */
function Questions({ columns }) {
  if (columns.error) return html`<${Fault} error=${columns.error} />`;
  if (!columns.data) return html`<${Waiting} />`;
  return html`
    <ul class="questions">
      ${questions(columns.data.items).map(
        ({ title, page, settings, needs }) => html`
          <li>
            ${
              settings
                ? html`
                  <${Link} href=${address(page, { ...settings, title })}>${title}</${Link}>
                `
                : html`
                  <span class="quiet">
                    ${title}
                    <small>needs ${needs}</small>
                  </span>
                `
            }
          </li>
        `,
      )}
    </ul>
  `;
}
