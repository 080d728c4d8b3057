// SPDX-License-Identifier: Apache-2.0
/** All sweeps in short, and the single runs as a table. */
import { address, useAddress } from '../core/address.js';
import { useData } from '../core/api.js';
import { clip } from '../core/format.js';
import { foremost, useNarrow } from '../core/narrow.js';
import { Empty, Fault, Link, Status, Table, useTitle, Waiting } from '../core/parts.js';
import { html } from '../core/ui.js';
import { placeOf, severalOf, SweepCards, sweepAddress } from './sweepcards.js';

export default function Sweeps() {
  const { query } = useAddress();
  const single = query.get('single') === '1';
  useTitle(single ? 'Single runs' : 'Sweeps');
  /** @type {Loading<Api.Sweeps>} */
  const { data, error } = useData('/api/v1/sweeps');
  if (data?.items.length === 0 && data.single.runs === 0)
    return html`
      <h1>Sweeps</h1>
      <${Empty} />
    `;
  if (data && single) return html`<${Single} data=${data} />`;
  return html`
    <h1>Sweeps</h1>
    <${Fault} error=${error} />
    ${data ? html`<${SweepCards} data=${data} level="h2" />` : !error && html`<${Waiting} />`}
  `;
}

/**
 * The runs that were asked for one by one, the latest first.
 * @param {{data: Api.Sweeps}} props
 */
function Single({ data }) {
  const { items } = data;
  const narrow = useNarrow();
  const rows = items
    .filter((sweep) => sweep.single)
    .map((sweep) => ({
      ...sweep,
      status: Object.keys(sweep.statuses)[0] ?? Object.keys(sweep.phases)[0] ?? null,
      algorithm: sweep.algorithms[0] ?? null,
      dataset: sweep.datasets[0] ?? null,
      ate: sweep.best[0]?.ate ?? null,
    }));
  /** @type {TableColumn[]} */
  const columns = [
    {
      name: 'name',
      title: 'run',
      show: (name, sweep) => html`
        <${Link} href=${sweepAddress(name, placeOf(sweep, items))}>${clip(name, 63)}</${Link}>
      `,
    },
    { name: 'status', title: 'status', show: (value) => value && html`<${Status} value=${value} />` },
    { name: 'ate', title: 'ATE [m]', kind: 'number' },
    { name: 'algorithm', title: 'algorithm' },
    { name: 'dataset', title: 'dataset' },
    { name: 'finished', title: 'finished', kind: 'time' },
  ];
  return html`
    <h1>Single runs <span class="quiet">${data.single.runs}</span></h1>
    <${Table}
      columns=${foremost(columns, narrow ? ['algorithm', 'ate', 'status'] : [])}
      rows=${rows}
      caption="Single runs"
    />
    ${
      data.single.without > 0 &&
      html`
        <p>
          <${Link} href=${address('/runs', { sweep: 'null' })}>
            ${data.single.without} that belong to no sweep
          </${Link}>
        </p>
      `
    }
    <p>
      <${Link} href="/sweeps">To all ${severalOf(data).length || ''} sweeps</${Link}>
    </p>
  `;
}
