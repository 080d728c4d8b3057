// SPDX-License-Identifier: Apache-2.0
/** What a run's cameras saw at the moments at which it was lost. */
import { momentsOf } from '../charts/moments.js';
import { address } from './address.js';
import { useData } from './api.js';
import { clip, number } from './format.js';
import { Waiting } from './parts.js';
import { html, useMemo, useState } from './ui.js';

/** @param {{base: string, data: Api.Trajectory}} props */
export function Seen({ base, data }) {
  const moments = useMemo(() => momentsOf(data.estimate, data.reference), [data]);
  const [chosen, setChosen] = useState(/** @type {number|null} */ (null));
  const { current, error } = useData(chosen === null ? null : address(`${base}/images`, { t: chosen }));
  if (!moments.length) return null;
  return html`
    <section>
      <h2>What the cameras saw</h2>
      <p class="row">
        ${moments.map(
          ({ t, text }) => html`
            <button type="button" aria-pressed=${String(t === chosen)} onClick=${() => setChosen(t)}>
              ${text} <small>at ${number(t - data.clock.start, 4)} s</small>
            </button>
          `,
        )}
      </p>
      ${error && html`<p class="quiet">${clip(error.message, 400)}</p>`}
      ${chosen !== null && !current && !error && html`<${Waiting} />`}
      ${
        current &&
        html`
          <div class="facets">
            ${current.images.map(
              (/** @type {Api.Images['images'][0]} */ one) => html`
                <figure class="chart" key=${one.topic}>
                  <figcaption>
                    ${clip(one.topic, 60)}, ${number(one.stamp - data.clock.start, 5)} s
                  </figcaption>
                  <img
                    class="seen"
                    src=${`data:image/jpeg;base64,${one.data}`}
                    alt=${`Image of ${clip(one.topic, 60)} at ${number(one.stamp - data.clock.start, 5)} s`}
                  />
                </figure>
              `,
            )}
          </div>
        `
      }
    </section>
  `;
}
