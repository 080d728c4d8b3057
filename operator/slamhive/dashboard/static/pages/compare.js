// SPDX-License-Identifier: Apache-2.0
/** Runs side by side: trajectories over the ground truth, error, CPU and memory with one cursor. */
import { overTime, shared, since, spanOf, truthsOf } from '../charts/trajectory.js';
import { address, SITE, useAddress } from '../core/address.js';
import { useAll, useData } from '../core/api.js';
import { Chart, COLOURS } from '../core/chart.js';
import { cell, clip, keysText, number, plural, SUBJECT } from '../core/format.js';
import {
  Choice,
  Download,
  Fault,
  Link,
  Notes,
  runLink,
  Status,
  Table,
  useTitle,
  Waiting,
} from '../core/parts.js';
import { differing, labelsOf, settingOf, sharedBy } from '../core/labels.js';
import { foremost, useNarrow } from '../core/narrow.js';
import { Mark, suspectOf, useSuspects } from '../core/suspects.js';
import { html, useEffect, useMemo, useState } from '../core/ui.js';
import { CommonLink } from './common.js';
import { costColumns, loads } from './loads.js';
import { Tracks, trackTable } from './tracks.js';

const MOST = 8;
const OFFERED = 8;
const PAUSE_MS = 200;

export default function Compare() {
  const { query, change } = useAddress();
  useTitle('Compare');
  const given = [...new Set(query.all('uid').filter(Boolean))];
  const uids = given.slice(0, MOST);
  const base = uids.map((uid) => `/api/v1/runs/${encodeURIComponent(uid)}`);
  const runs = useAll(base);
  const tracks = useAll(
    base.map((one, at) => (runs?.[at].data?.files ? `${one}/trajectory?points=1500` : null)),
  );
  const usage = useAll(base.map((one, at) => (runs?.[at].data?.files ? `${one}/usage` : null)));
  const labels = useMemo(() => {
    const known = (runs ?? []).flatMap((one) => (one.data ? [one.data] : []));
    const texts = labelsOf(known);
    return new Map(known.map((run, at) => [run.uid, texts[at]]));
  }, [runs]);
  /** @param {string} uid */
  const add = (uid) => change({ uid: [...uids, uid] });
  const embedded = query.get('embed') === '1';
  return html`
    <h1>Compare runs</h1>
    ${
      !embedded &&
      html`
        <section class="controls" aria-label="What is compared">
          <div class="row middle">
            ${uids.map(
              (uid, at) => html`
                <span class=${`chip ${runs?.[at].error ? 'wrong' : ''}`}>
                  ${clip(labels.get(uid) ?? uid, 90)}
                  <button
                    type="button"
                    aria-label=${`Remove ${clip(labels.get(uid) ?? uid, 90)}`}
                    onClick=${() => change({ uid: uids.filter((one) => one !== uid) })}
                  >
                    ×
                  </button>
                </span>
              `,
            )}
            <${Link} href="/runs">Choose in the table</${Link}>
            ${runs && html`<${CommonLink} runs=${runs.filter((one) => one.data).map((one) => one.data)} />`}
          </div>
          <div class="row">
            ${!SITE && html`<${Finder} taken=${uids} onAdd=${add} full=${uids.length >= MOST} />`}
            <${Choice}
              label="Colours tell"
              value=${query.get('colour', 'run')}
              options=${[['run', 'the run'], ['error', 'the error']]}
              onChange=${(colour) => change({ colour: colour === 'run' ? null : colour })}
            />
          </div>
          ${runs?.map(
            (one) => html`
              <${Fault} error=${one.error} />
            `,
          )}
        </section>
      `
    }
    ${
      uids.length === 0 &&
      html`
        <p class="empty">
          Tick runs in <${Link} href="/runs">the table of runs</${Link}> to lay them side by side here.
        </p>
      `
    }
    ${
      given.length > MOST &&
      html`
        <p class="fault" role="alert">
          ${MOST} runs at most are compared; the others of this address are left out.
        </p>
      `
    }
    ${embedded && runs?.map((one) => html`<${Fault} error=${one.error} />`)}
    ${
      uids.length > 0 &&
      (runs && tracks && usage
        ? html`
          <${Compared}
            runs=${runs}
            tracks=${tracks}
            usage=${usage}
            byError=${query.get('colour') === 'error'}
          />
        `
        : html`
          <${Waiting} />
        `)
    }
  `;
}

/**
 * A field that finds runs by words of their names and settings.
 * @param {{taken: string[], onAdd: (uid: string) => void, full: boolean}} props
 */
function Finder({ taken, onAdd, full }) {
  const [draft, setDraft] = useState('');
  const [asked, setAsked] = useState('');
  useEffect(() => {
    const timer = setTimeout(() => setAsked(draft.trim()), PAUSE_MS);
    return () => clearTimeout(timer);
  }, [draft]);
  const { data, error } = useData(
    asked && !full ? address('/api/v1/search', { words: asked, limit: OFFERED + MOST }) : null,
  );
  const offered = /** @type {Api.Search} */ (data)?.items
    .filter((one) => !taken.includes(one.uid))
    .slice(0, OFFERED);
  // What all share needs no telling.
  const told = Object.keys(offered?.[0]?.keys ?? {}).filter(
    (name) => name === 'algorithm' || new Set((offered ?? []).map((one) => String(one.keys[name]))).size > 1,
  );
  /** @param {Api.Keys} keys */
  const text = (keys) =>
    keysText(
      Object.fromEntries(told.filter((name) => keys[name] !== null).map((name) => [name, keys[name]])),
    );
  /** @param {string} uid */
  const take = (uid) => {
    onAdd(uid);
    setDraft('');
  };
  /** @param {Event} event */
  const submit = (event) => {
    event.preventDefault();
    if (offered?.length && asked === draft.trim()) take(offered[0].uid);
  };
  return html`
    <form class="field wide finder" onSubmit=${submit}>
      <label class="field">
        <span>Add a run: words of its algorithm, dataset, settings</span>
        <input
          type="text"
          spellcheck="false"
          maxlength="300"
          disabled=${full}
          placeholder=${full ? `${MOST} runs at most` : 'mono nFeatures=1000 resolution=0.5'}
          value=${draft}
          onInput=${(event) => setDraft(event.target.value)}
        />
      </label>
      <${Fault} error=${error} />
      ${
        asked &&
        offered &&
        html`
          <ul class="offers" aria-label="Runs that fit">
            ${offered.map(
              (one) => html`
                <li key=${one.uid}>
                  <button type="button" onClick=${() => take(one.uid)}>
                    ${clip(text(one.keys), 90)} <${Status} value=${one.status} />
                    <small>run ${clip(cell(one.run ?? one.uid), 40)}</small>
                  </button>
                </li>
              `,
            )}
            <li class="quiet">
              ${
                data.total
                  ? [
                      `found: ${plural(data.total, 'run')}`,
                      data.total > offered.length ? 'more words leave fewer' : '',
                    ]
                      .filter(Boolean)
                      .join('; ')
                  : 'No run fits all these words.'
              }
            </li>
          </ul>
        `
      }
    </form>
  `;
}

/**
 * @param {{runs: Answer<Api.Run>[], tracks: Answer<Api.Trajectory>[], usage: Answer<Api.Usage>[], byError:
 *   boolean}} props
 */
function Compared({ runs, tracks, usage, byError }) {
  const suspects = useSuspects();
  const narrow = useNarrow();
  const drawn = useMemo(() => pictures(runs, tracks, usage), [runs, tracks, usage]);
  const present = runs.flatMap((one) => (one.data ? [one.data] : []));
  const labels = labelsOf(present);
  /** @param {Api.Run} run */
  const keys = (run) => ({
    algorithm: run.configuration?.algorithm,
    sensors: run.configuration?.sensors,
    dataset: run.configuration?.dataset,
    evaluation: run.results?.[0]?.evaluation,
  });
  /** @type {TableColumn[]} */
  const columns = [
    {
      name: 'run',
      title: 'run',
      show: (_, run) => runLink(run.uid, labels[present.indexOf(run)] ?? cell(run.run ?? run.uid)),
    },
    ...SUBJECT.filter((name) => new Set(present.map((run) => settingOf(run, name))).size > 1).map((name) => ({
      name,
      title: name,
      show: (/** @type {unknown} */ _, /** @type {Api.Run} */ run) => clip(cell(settingOf(run, name)), 40),
    })),
    {
      name: 'outcome',
      title: 'outcome',
      show: (_, run) => html`
        <${Status} value=${run.results?.[0]?.outcome ?? run.reason ?? run.phase} />
        <${Mark} suspect=${suspectOf(suspects, keys(run))} />
      `,
    },
    {
      name: 'coverage',
      title: 'coverage',
      kind: 'number',
      show: (_, run) => number(run.results?.[0]?.coverage),
    },
    {
      name: 'alignment',
      title: 'alignment',
      show: (_, run) => cell(run.results?.[0]?.alignment),
    },
    {
      name: 'ate',
      title: 'ATE [m]',
      kind: 'number',
      show: (_, run) => number(run.results?.[0]?.ate?.rmse),
    },
    ...costColumns(present, (run) => run),
    {
      name: 'csv',
      title: 'CSV',
      show: (_, run) =>
        run.files
          ? html`
            <${Download} href=${`/api/v1/runs/${encodeURIComponent(run.uid)}/trajectory?format=csv`}>
              trajectory
            </${Download}>${' '}
            <${Download} href=${`/api/v1/runs/${encodeURIComponent(run.uid)}/usage?format=csv`}>
              load
            </${Download}>
          `
          : '–',
    },
  ];
  if (present.length === 0) return null;
  const told = present.length > 1 ? sharedBy(present, labels) : { common: '', some: [] };
  return html`
    <${Table}
      columns=${narrow ? foremost(columns, ['run', 'ate', 'cpu', 'outcome']) : columns}
      rows=${present}
      caption="The runs compared"
    />
    ${
      told.common &&
      html`
        <details class="quiet spaced">
          <summary>The same in all: ${clip(told.common, 110)}</summary>
          ${told.common}
        </details>
      `
    }
    <${Notes} notes=${drawn.notes} />
    <div class="facets spaced">
      ${
        drawn.estimates.length > 0 &&
        html`
          <${Tracks}
            estimates=${drawn.estimates}
            truths=${drawn.truths}
            byError=${byError}
            title="Trajectories"
          />
        `
      }
    </div>
    ${drawn.error && html`<${Chart} ...${drawn.error} csv=${true} height=${300} />`}
    <div class="facets">
      ${drawn.charts.map(
        ({ title, option, table, ofDataset }) => html`
          <${Chart}
            key=${title}
            title=${title}
            option=${option}
            group=${ofDataset ? 'dataset' : 'program'}
            table=${table}
            csv=${true}
            height=${320}
          />
        `,
      )}
    </div>
    <${Notes} notes=${drawn.loadNotes} />
    <${Different} runs=${present} />
    <${Notes} notes=${told.some.map(({ who, what }) => `Only ${clip(who, 200)}: ${clip(what, 390)}`)} />
  `;
}

/**
 * In which settings the runs differ that have them.
 * @param {{runs: Api.Run[]}} props
 */
function Different({ runs }) {
  const told = differing(runs);
  if (told.length === 0) return null;
  const labels = labelsOf(runs);
  /** @type {TableColumn[]} */
  const columns = [
    { name: 'setting', title: 'differs', show: (name) => clip(name, 60) },
    ...runs.map((run, at) => ({ name: run.uid, title: labels[at] })),
  ];
  return html`
    <p></p>
    <${Table}
      columns=${columns}
      rows=${told.map((name) => ({
        setting: name,
        ...Object.fromEntries(runs.map((run) => [run.uid, settingOf(run, name)])),
      }))}
      caption="Settings in which the runs differ"
    />
  `;
}

/**
 * @param {Answer<Api.Run>[]} runs
 * @param {Answer<Api.Trajectory>[]} tracks
 * @param {Answer<Api.Usage>[]} usage
 */
function pictures(runs, tracks, usage) {
  const found = runs.flatMap(({ data: run }, at) =>
    run ? [{ run, track: tracks[at].data, usage: usage[at].data, why: tracks[at].error?.message }] : [],
  );
  const names = labelsOf(found.map((one) => one.run));
  const present = found.map((one, at) => ({
    ...one,
    name: names[at],
    colour: COLOURS[at % COLOURS.length],
  }));
  const moved = present.flatMap((one) => (one.track ? [{ ...one, track: one.track }] : []));
  const measured = moved.filter((one) => one.track.estimate.error?.some((value) => value !== null));
  const loaded = present.flatMap((one) => (one.usage ? [{ ...one, usage: one.usage }] : []));
  const datasets = new Set(present.map((one) => one.run.configuration?.dataset));
  const notes =
    datasets.size > 1
      ? [
          'These runs are of several datasets, each drawn with its own ground truth: ' +
            'how far those are from each other says nothing.',
        ]
      : [];
  for (const one of present)
    if (!one.track) notes.push(`${one.name} has no trajectory here${one.why ? `: ${one.why}` : ''}.`);
  const estimates = moved.map((one) => ({ name: one.name, track: one.track.estimate }));
  /**
   * @param {{run: Api.Run}} one
   * @returns {string}
   */
  const dataset = (one) => one.run.configuration?.dataset;
  const truths = truthsOf(
    moved.map(({ run, track }) => ({
      of: `${cell(settingOf(run, 'algorithm'))} (${cell(settingOf(run, 'sensors'))})`,
      dataset: cell(settingOf(run, 'dataset')),
      reference: track.reference,
    })),
  );
  if (truths.length > Math.max(datasets.size, 1))
    notes.push('Poses of different frames, as of the LiDAR and the IMU, have a ground truth each.');
  const { zeros, title: axis } = shared(
    present.flatMap((one) =>
      [one.track?.clock, one.usage?.clock].flatMap((clock) =>
        clock ? [{ dataset: dataset(one), clock }] : [],
      ),
    ),
  );
  /**
   * @param {{run: Api.Run}} one
   * @param {number[]} stamps
   */
  const placed = (one, stamps) => since(stamps, zeros.get(dataset(one)) ?? 0);
  const errors = measured.map((one) => ({
    name: one.name,
    colour: one.colour,
    t: placed(one, one.track.estimate.t),
    values: one.track.estimate.error ?? [],
  }));
  const load = loaded.map((one) => ({ ...one, t: one.usage.stamp && placed(one, one.usage.stamp) }));
  const span = spanOf([...errors, ...load].flatMap((one) => (one.t ? [one.t] : [])));
  const error = measured.length > 0 && {
    title: 'Error over time',
    group: 'dataset',
    table: trackTable(measured.map((one) => ({ name: one.name, track: one.track.estimate }))),
    option: overTime(errors, 'error [m]', axis, { span }),
  };
  return {
    notes,
    estimates,
    loadNotes: loaded.flatMap((one) => one.usage.notes.map((note) => `${one.name}: ${note}`)),
    truths,
    error,
    charts: loads(load, { title: axis, span }),
  };
}
