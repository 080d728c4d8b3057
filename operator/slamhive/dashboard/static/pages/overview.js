// SPDX-License-Identifier: Apache-2.0
/** The start page: what there is, what is running, and what one may ask. */
import { address } from '../core/address.js';
import { useData } from '../core/api.js';
import { clip, number, time } from '../core/format.js';
import { Empty, Fault, Link, Notes, Status, useTitle, Waiting } from '../core/parts.js';
import { questions } from '../core/questions.js';
import { html } from '../core/ui.js';

const COUNTED = [['runs', 'runs', '/runs'], ['sweeps', 'sweeps', null], ['algorithms', 'algorithms', '/algorithms'], ['datasets', 'datasets', '/datasets'], ['live', 'running now', null]];

export default function Overview() {
  useTitle('Overview');
  const index = useData('/api/v1');
  const columns = useData('/api/v1/columns');
  const sweeps = useData('/api/v1/sweeps');
  const counts = index.data?.counts;
  const empty = counts ? counts.runs === 0 && counts.sweeps === 0 : columns.data?.rows === 0;
  if (empty) return html`<h1 class="hidden">Overview</h1><${Empty} />`;
  return html`<h1>Overview</h1>
    <${Fault} error=${index.error} />
    ${counts && html`<dl class="counts">${COUNTED.filter(([name]) => counts[name] !== undefined).map(([name, text, href]) => html`<div><dt>${text}</dt>
      <dd>${href ? html`<${Link} href=${href}>${number(counts[name])}</${Link}>` : number(counts[name])}</dd></div>`)}</dl>`}
    ${index.data?.statuses && html`<p class="statuses" aria-label="Runs by status">${Object.entries(index.data.statuses).map(([status, count]) => html`<span><${Status} value=${status} /> ${count}</span> `)}</p>`}
    <h2>Questions</h2>
    <${Questions} columns=${columns} />
    <h2>Sweeps</h2>
    <${Fault} error=${sweeps.error} />
    ${sweeps.data ? html`<div class="cards">${sweeps.data.items.map((sweep) => html`<${Sweep} key=${sweep.name} sweep=${sweep} />`)}</div>
      ${sweeps.data.items.length === 0 && html`<p class="quiet">No sweep is known here.</p>`}` : !sweeps.error && html`<${Waiting} />`}
    <${Notes} notes=${index.data?.notes} />`;
}

function Questions({ columns }) {
  if (columns.error) return html`<${Fault} error=${columns.error} />`;
  if (!columns.data) return html`<${Waiting} />`;
  return html`<ul class="questions">${questions(columns.data.items).map(({ title, settings, needs }) => html`<li>${settings
    ? html`<${Link} href=${address('/explore', { ...settings, title })}>${title}</${Link}>`
    : html`<span class="quiet">${title}<small>needs ${needs}</small></span>`}</li>`)}</ul>`;
}

function Sweep({ sweep }) {
  const done = Object.values(sweep.statuses ?? {}).reduce((sum, count) => sum + count, 0);
  const finished = ['Succeeded', 'Failed'].reduce((sum, phase) => sum + (sweep.phases?.[phase] ?? 0), 0);
  const total = sweep.total ?? Math.max(done, sweep.runs);
  return html`<article class="card"><h3><${Link} href=${address('/runs', { sweep: sweep.name })}>${clip(sweep.name, 80)}</${Link}>
      ${sweep.live && html` <span class="status live">live</span>`}</h3>
    <progress max=${total || 1} value=${finished} aria-label=${`${finished} of ${total} runs of ${clip(sweep.name, 80)} are finished`}></progress>
    <p><b>${finished}</b> of ${total} runs finished</p>
    <p class="statuses">${Object.entries(sweep.statuses ?? {}).map(([status, count]) => html`<span><${Status} value=${status} /> ${count}</span> `)}</p>
    <p class="quiet">${clip((sweep.algorithms ?? []).join(', '), 120)}<br />${clip((sweep.datasets ?? []).join(', '), 120)}</p>
    ${sweep.axes?.length > 0 && html`<p class="quiet">over ${clip(sweep.axes.map((axis) => `${axis.name} (${axis.count})`).join(', '), 200)}</p>`}
    ${sweep.best?.length > 0 && html`<p>smallest ATE: ${sweep.best.slice(0, 3).map((best, at) => html`${at > 0 && ', '}<${Link} href=${`/runs/${encodeURIComponent(best.uid)}`}>${number(best['ate.rmse'])} m</${Link}>`)}</p>`}
    <p class="quiet">${sweep.started ? `since ${time(sweep.started)}` : ''}</p></article>`;
}
