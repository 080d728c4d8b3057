// SPDX-License-Identifier: Apache-2.0
/** Algorithms and datasets: what they are and how their runs ended. */
import { address, useAddress } from '../core/address.js';
import { useData } from '../core/api.js';
import { cell, clip, plural } from '../core/format.js';
import { Fault, Link, Status, useTitle, Waiting } from '../core/parts.js';
import { TruthLink } from '../core/truth.js';
import { html } from '../core/ui.js';
import { Recording } from './recording.js';

const LONGEST = 2000;
const LONG = 100;
const ONE = { algorithms: 'algorithm', datasets: 'dataset' };

export default function Catalog() {
  const { path } = useAddress();
  const [kind, name] = path;
  return name === undefined
    ? html`<${All} kind=${kind} />`
    : html`<${One} key=${name} kind=${kind} name=${name} />`;
}

/** @param {{kind: 'algorithms'|'datasets'}} props */
function All({ kind }) {
  const title = kind === 'algorithms' ? 'Algorithms' : 'Datasets';
  useTitle(title);
  const { data, error } = useData(`/api/v1/${kind}`);
  return html`
    <h1>${title}</h1>
    <${Fault} error=${error} />
    ${
      data
        ? html`
          <div class="cards">
            ${data.items.map(
              (/** @type {Api.Entry} */ item) => html`
                <article key=${item.name} class="card">
                  <h2>
                    <${Link} href=${`/${kind}/${encodeURIComponent(item.name)}`}>
                      ${clip(item.name, 120)}
                    </${Link}>
                  </h2>
                  <${Short} item=${item} kind=${kind} />
                </article>
              `,
            )}
          </div>
          ${
            data.items.length === 0 &&
            html`
              <p class="empty">
                There are none yet. <code>slamhive ${kind} list</code> shows those that come with
                SLAM Hive.
              </p>
            `
          }
        `
        : !error && html`<${Waiting} />`
    }
  `;
}

/** @param {any} list names, or an object that has them as keys */
const plain = (list) =>
  (Array.isArray(list) ? list : Object.keys(list ?? {}))
    .map((one) => (typeof one === 'string' ? one : (one?.name ?? JSON.stringify(one))))
    .join(', ');

/** @param {{item: Api.Entry, kind: 'algorithms'|'datasets'}} props */
function Short({ item, kind }) {
  const what = plain(item.modes ?? item.sensors);
  return html`
    ${item.description && html`<p>${clip(item.description, 400)}</p>`}
    ${what && html`<p class="quiet">${clip(what, 200)}</p>`}
    <p>
      <${Link} href=${address('/runs', { [ONE[kind]]: item.name })}>${plural(item.runs, 'run')}</${Link}>
    </p>
    <p class="statuses">
      ${Object.entries(item.statuses ?? {}).map(
        ([status, count]) => html`
          <span>
            <${Status} value=${status} /> ${count}
          </span>
        `,
      )}
    </p>
  `;
}

/** @param {{kind: 'algorithms'|'datasets', name: string}} props */
function One({ kind, name }) {
  useTitle(name);
  const { data, error } = useData(`/api/v1/${kind}/${encodeURIComponent(name)}`);
  const pairs = Object.entries({ ...data?.labels, ...data?.attributes });
  return html`
    <h1>${clip(name, 160)}</h1>
    <${Fault} error=${error} />
    ${
      data
        ? html`
          <section class="card">
            <${Short} item=${data} kind=${kind} />
            <p class="row">
              <${Link} href=${address('/leaderboard', { [ONE[kind]]: name })}>Leaderboard</${Link}>
              <${Link} href=${address('/explore', { [ONE[kind]]: name })}>Explore</${Link}>
              ${kind === 'datasets' && html`<${TruthLink} dataset=${name} />`}
            </p>
          </section>
          ${
            pairs.length > 0 &&
            html`
              <h2>Attributes</h2>
              <section class="card">
                <dl class="facts">
                  ${pairs.map(
                    ([key, value]) => html`
                      <dt>${clip(key, 120)}</dt>
                      <dd tabindex=${String(value).length > LONG ? 0 : null}>
                        ${clip(cell(value), LONGEST)}
                      </dd>
                    `,
                  )}
                </dl>
              </section>
            `
          }
          ${
            data.manifest &&
            html`
              <h2>Definition</h2>
              <pre class="text" tabindex="0">
                ${data.manifest}
              </pre>
            `
          }
        `
        : !error && html`<${Waiting} />`
    }
    ${kind === 'datasets' && (data || error) && html`<${Recording} name=${name} />`}
    <p>
      <${Link} href=${`/${kind}`}>To all ${kind}</${Link}>
    </p>
  `;
}
