// SPDX-License-Identifier: Apache-2.0
/** Runs side by side: trajectories over the ground truth, error, CPU and memory with one cursor. */
import { overTime, plane, PLANES, since } from '../charts/trajectory.js';
import { Query, useAddress } from '../core/address.js';
import { useAll } from '../core/api.js';
import { Chart } from '../core/chart.js';
import { bytes, cell, clip, number } from '../core/format.js';
import { Fault, Link, Notes, runLink, Status, Table, useTitle, Waiting } from '../core/parts.js';
import { html, useMemo, useState } from '../core/ui.js';

const MOST = 8;

export default function Compare() {
  const { query, change } = useAddress();
  const [draft, setDraft] = useState('');
  useTitle('Compare');
  const uids = [...new Set(query.all('uid').filter(Boolean))].slice(0, MOST);
  const base = uids.map((uid) => `/api/v1/runs/${encodeURIComponent(uid)}`);
  const runs = useAll(base);
  const tracks = useAll(base.map((one, at) => (runs?.[at].data?.files ? `${one}/trajectory?points=1500` : null)));
  const usage = useAll(base.map((one, at) => (runs?.[at].data?.files ? `${one}/usage` : null)));
  const add = async (event) => {
    event.preventDefault();
    if (draft.trim()) change({ uid: [...uids, draft.trim()] });
    setDraft('');
  };
  return html`<h1>Compare runs</h1>
    <form class="controls" onSubmit=${add}><div class="row">${uids.map((uid, at) => html`<span class="chip">${clip(runs?.[at].data?.name ?? uid, 60)}
        <button type="button" aria-label=${`Remove ${clip(uid, 80)}`} onClick=${() => change({ uid: uids.filter((one) => one !== uid) })}>×</button></span>`)}
      <label class="field wide"><span>Add a run by its uid</span><input type="text" value=${draft} onInput=${(event) => setDraft(event.target.value)} /></label>
      <${Link} class="tick" href="/runs">Choose in the table</${Link}></div></form>
    ${uids.length === 0 && html`<p class="empty">Tick runs in <${Link} href="/runs">the table of runs</${Link}> to lay them side by side here.</p>`}
    ${runs?.map((one) => html`<${Fault} error=${one.error} />`)}
    ${uids.length > 0 && (runs && tracks && usage ? html`<${Compared} runs=${runs} tracks=${tracks} usage=${usage} />` : html`<${Waiting} />`)}`;
}

const nameOf = (run) => `${cell(run.run ?? '')} ${run.name ?? run.uid}`.replace(/^– /, '');

function Compared({ runs, tracks, usage }) {
  const drawn = useMemo(() => pictures(runs, tracks, usage), [runs, tracks, usage]);
  const columns = [
    { name: 'run', title: 'run', show: (_, run) => runLink(run.uid, nameOf(run)) }, { name: 'dataset', title: 'dataset', show: (_, run) => clip(run.configuration?.dataset ?? '–', 40) },
    { name: 'outcome', title: 'outcome', show: (_, run) => html`<${Status} value=${run.results?.[0]?.outcome ?? run.reason ?? run.phase} />` },
    { name: 'coverage', title: 'coverage', kind: 'number', show: (_, run) => number(run.results?.[0]?.coverage) }, { name: 'alignment', title: 'alignment', show: (_, run) => run.results?.[0]?.alignment ?? '–' },
    { name: 'ate', title: 'ATE [m]', kind: 'number', show: (_, run) => number(run.results?.[0]?.ate?.rmse) },
    { name: 'cpu', title: 'CPU [cores]', kind: 'number', show: (_, run) => number(run.usage?.cpu?.meanCores) }, { name: 'memory', title: 'peak memory', kind: 'number', show: (_, run) => bytes(run.usage?.memory?.peakBytes) },
    { name: 'csv', title: 'CSV', show: (_, run) => (run.files ? html`<a href=${`/api/v1/runs/${encodeURIComponent(run.uid)}/trajectory?format=csv`} download>trajectory</a> <a href=${`/api/v1/runs/${encodeURIComponent(run.uid)}/usage?format=csv`} download>load</a>` : '–') },
  ];
  return html`<${Table} columns=${columns} rows=${runs.filter((one) => one.data).map((one) => one.data)} caption="The runs compared" />
    <${Notes} notes=${drawn.notes} /><div class="facets">${drawn.charts.map(({ title, option, group }) => html`<${Chart} key=${title} title=${title} option=${option} group=${group} height=${340} />`)}</div>`;
}

function pictures(runs, tracks, usage) {
  const present = runs.map((run, at) => ({ name: run.data ? nameOf(run.data) : '', run: run.data, track: tracks[at].data, usage: usage[at].data })).filter((one) => one.run);
  const moved = present.filter((one) => one.track);
  const measured = moved.filter((one) => one.track.estimate.error?.some((value) => value !== null));
  const loaded = present.filter((one) => one.usage);
  const datasets = new Set(present.map((one) => one.run.configuration?.dataset));
  const notes = datasets.size > 1 ? ['These runs are of several datasets: the ground truth drawn is that of the first.'] : [];
  for (const one of present) if (!one.track) notes.push(`${one.name} has no trajectory here.`);
  const estimates = moved.map((one) => ({ name: one.name, track: one.track.estimate }));
  const lines = (of, values) => of.map((one) => ({ name: one.name, ...values(one) }));
  return {
    notes,
    charts: [
      ...(moved.length ? PLANES.map(([plain, a, b]) => ({ title: `Trajectories ${plain}`, option: plane(estimates, moved[0].track.reference, a, b) })) : []),
      ...(measured.length ? [{ title: 'Error over time', option: overTime(lines(measured, (one) => ({ t: since(one.track.estimate.t), values: one.track.estimate.error })), 'error [m]'), group: 'compared' }] : []),
      ...(loaded.length ? [
        { title: 'CPU over time', option: overTime(lines(loaded, (one) => ({ t: one.usage.t, values: one.usage.cpu })), 'CPU [cores]'), group: 'compared' },
        { title: 'Memory over time', option: overTime(lines(loaded, (one) => ({ t: one.usage.t, values: one.usage.memory.map((value) => (value === null ? null : value / 2 ** 20)) })), 'memory [MiB]'), group: 'compared' },
      ] : []),
    ],
  };
}
