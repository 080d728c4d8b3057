// SPDX-License-Identifier: Apache-2.0
/** A picture of a dataset's recording, once `slamhive dataset show --html` made it. */
import { above, coverage, envelopes, path, rate } from '../charts/recording.js';
import { SITE } from '../core/address.js';
import { useData } from '../core/api.js';
import { Chart } from '../core/chart.js';
import { clip, number } from '../core/format.js';
import { Notes, Waiting } from '../core/parts.js';
import { html } from '../core/ui.js';

const UNPICTURED = 'This site has no picture of the recording.';
const UNITS = { gyro: 'rad/s', accel: 'm/s²' };
const IMU = { gyro: 'rates of turn', accel: 'specific force' };

/** @param {{name: string}} props */
export function Recording({ name }) {
  const { data, error } = useData(`/api/v1/datasets/${encodeURIComponent(name)}/overview`);
  return html`
    <section>
      <h2>Recording</h2>
      ${error && html`<p class="quiet">${SITE ? UNPICTURED : clip(error.message, 400)}</p>`}
      ${!data && !error && html`<${Waiting} />`}
      ${data && html`<${Drawn} data=${data} />`}
    </section>
  `;
}

/** @param {{data: Api.Overview}} props */
function Drawn({ data }) {
  const { truth } = data;
  const rows = data.sensors.filter((one) => one.first !== null).length + (truth ? 1 : 0);
  return html`
    <p class="quiet">${number(data.seconds, 5)} s. Times are seconds since the start.</p>
    ${
      rows > 0 &&
      html`<${Chart} option=${coverage(data)} height=${70 + 28 * rows} title="What covers which time" />`
    }
    ${
      truth &&
      html`
        <div class="facets">
          <${Chart} option=${path(truth, 'x', 'y')} height=${360} title="Ground truth from above" />
          <${Chart} option=${path(truth, 'x', 'z')} height=${360} title="Ground truth from the side" />
        </div>
      `
    }
    ${data.sensors.map((sensor) => html`<${Sensor} key=${sensor.name} data=${data} sensor=${sensor} />`)}
    <${Notes} notes=${data.notes} />
  `;
}

/** @param {{data: Api.Overview, sensor: Api.SensorView}} props */
function Sensor({ data, sensor }) {
  const name = clip(sensor.name, 60);
  return html`
    <h3>${name} <small>${clip(sensor.topic, 80)}, ${number(sensor.messages)} messages</small></h3>
    ${
      sensor.pictures.length > 0 &&
      html`
        <div class="sheet">
          ${sensor.pictures.map(
            ({ t, data: image }) => html`
              <figure key=${t}>
                <img
                  class="seen"
                  src=${`data:image/jpeg;base64,${image}`}
                  alt=${`${name} at ${number(t, 5)} s`}
                />
                <figcaption>${number(t, 5)} s</figcaption>
              </figure>
            `,
          )}
        </div>
      `
    }
    ${
      sensor.clouds.length > 0 &&
      html`
        <div class="facets">
          ${sensor.clouds.map(
            (cloud) => html`
              <${Chart}
                key=${cloud.t}
                option=${above(cloud)}
                height=${300}
                title=${`${name} from above at ${number(cloud.t, 5)} s`}
              />
            `,
          )}
        </div>
      `
    }
    ${
      sensor.rates.length > 0 &&
      html`<${Chart} option=${rate(data, sensor)} height=${170} title=${`${name}: messages a second`} />`
    }
    ${Object.entries(sensor.imu).map(
      ([what, axes]) => html`
        <${Chart}
          key=${what}
          option=${envelopes(data, axes, UNITS[/** @type {'gyro'|'accel'} */ (what)])}
          height=${220}
          title=${`${name}: ${IMU[/** @type {'gyro'|'accel'} */ (what)]}, least and greatest`}
        />
      `,
    )}
  `;
}
