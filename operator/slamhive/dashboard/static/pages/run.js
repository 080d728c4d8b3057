// SPDX-License-Identifier: Apache-2.0
/** One run: how it was set, what it cost, what was measured, and how to run it again. */
import { withHealth } from '../charts/health.js';
import { overTime, shared, since, truthsOf } from '../charts/trajectory.js';
import { address, SITE, useAddress } from '../core/address.js';
import { csvOf, useData } from '../core/api.js';
import { Chart } from '../core/chart.js';
import { bytes, cell, clip, namedValue, number, time } from '../core/format.js';
import { foremost, useNarrow } from '../core/narrow.js';
import { Choice, Download, Fault, Link, Notes, Status, Table, useTitle, Waiting } from '../core/parts.js';
import { SuspectNotes } from '../core/suspects.js';
import { TruthLink } from '../core/truth.js';
import { html, useMemo } from '../core/ui.js';
import { costColumns, loads } from './loads.js';
import { Seen } from '../core/seen.js';
import { Tracks, trackTable } from './tracks.js';

const LONGEST = 4000;
/** Longer values than this scroll, so keys must reach them. */
const LONG = 100;

/** The page of the run that the address names. */
export default function RunPage() {
  const [, uid] = useAddress().path;
  return html`<${One} key=${uid} uid=${uid} />`;
}

/** @param {{uid: string}} props */
function One({ uid }) {
  const base = `/api/v1/runs/${encodeURIComponent(uid)}`;
  const state = useData(base);
  const run = state.data;
  useTitle(run ? titleOf(run, uid) : 'Run');
  const narrow = useNarrow();
  if (!run)
    return html`
      <h1>Run</h1>
      ${
        state.error
          ? html`
            <${Fault} error=${state.error} />
            <p>
              <${Link} href="/runs">To all runs</${Link}>
            </p>
          `
          : html`
            <${Waiting} />
          `
      }
    `;
  const results = run.results ?? [];
  const { algorithm, dataset, sensors } = run.configuration ?? {};
  const settings = settingsOf(run);
  const named = [algorithm ?? `run ${run.run ?? ''}`, ...settings].join(', ');
  const findings = run.provenance?.prepared?.findings ?? [];
  return html`
    <h1>${titleOf(run, uid)}</h1>
    <p class="settings">${clip([sensors, ...settings].filter(Boolean).join(', '), 400)}</p>
    <p class="row">
      <${Status} value=${results[0]?.outcome ?? run.reason ?? run.phase} />
      <span class="quiet">
        run ${clip(run.name ?? uid, 160)}
        ${
          run.run !== null &&
          run.run !== undefined &&
          run.run !== run.name &&
          html`, ${clip(cell(run.run), 80)}`
        }
      </span>
      ${
        run.sweep &&
        html`
          <span>
            of${' '}
            <${Link} href=${`/sweeps/${encodeURIComponent(run.sweep)}`}>${clip(run.sweep, 80)}</${Link}>
          </span>
        `
      }
      <${Link} href=${`/compare?uid=${encodeURIComponent(uid)}`}>Compare</${Link}>
      ${
        !SITE &&
        html`
          ${' · '}
          <${Link} href=${address('/paths', { of: uid })}>All its repetitions</${Link}>
        `
      }
      <${Download} href=${`${base}/manifest`}>
        YAML to run it again
      </${Download}>
      ${dataset && html`<${TruthLink} dataset=${dataset} />`}
    </p>
    ${run.message && html`<p class="quiet">${clip(run.message, LONGEST)}</p>`}
    <${Said} note=${run.note} tags=${run.tags ?? []} />
    ${
      findings.length > 0 &&
      html`
        <p class="quiet">
          † <${Link} href=${`/datasets/${encodeURIComponent(dataset ?? '')}`}>Its recording</${Link}> has open
          findings: ${clip(findings.join(', '), 200)}.
        </p>
      `
    }
    <${Results} run=${run} results=${results} />
    <${Notes} notes=${run.notes} />
    <${SuspectNotes}
      keys=${{
        algorithm: run.configuration?.algorithm,
        sensors: run.configuration?.sensors,
        dataset: run.configuration?.dataset,
        'input.pace': run.configuration?.input?.pace,
      }}
      evaluations=${results.map((/** @type {{evaluation: string}} */ one) => one.evaluation)}
    />
    ${
      results.length === 0 &&
      run.phase !== 'Succeeded' &&
      html`
        <p class="quiet">
          Nothing was measured: ${clip(run.reason ?? run.phase ?? 'no result', 200)}.
        </p>
      `
    }
    ${
      run.files
        ? html`
          <${Trajectory} base=${base} results=${results} name=${clip(named, 80)} cameras=${run.cameras} />
          <${Usage} base=${base} />
        `
        : html`
          <p class="quiet">
            Nothing to draw, as ${clip(run.absence ?? 'the files of this run are not on this machine', 200)}.
          </p>
        `
    }
    <div class="cards facts">
      <${Facts} title="Configuration" value=${run.configuration} keep=${/^parameters\./} folded=${narrow} />
      <${Facts}
        title="How it went"
        value=${{
          phase: run.phase,
          reason: run.reason,
          attempts: run.attempts,
          created: time(run.created),
          started: time(run.started),
          finished: time(run.finished),
        }}
      />
      <${Facts} title="Cost" value=${run.usage} labels=${run.labelled} of="usage" />
      <${Facts} title="Frames" value=${run.frames} labels=${run.labelled} of="frames" folded=${narrow} />
      <${Facts}
        title="Own metrics"
        value=${run.metrics}
        keep=${/./}
        labels=${run.labelled}
        of="metrics"
        folded=${narrow}
      />
      <${Facts} title="Labels" value=${run.labels} />
      <${Facts} title="Trajectory" value=${run.trajectory} folded />
      <${Facts} title="Provenance" value=${run.provenance} folded />
    </div>
    <${Settings} base=${base} known=${run.files} />
    <${Files} base=${base} known=${run.files} />
    ${
      run.logTail &&
      html`
        <h2>End of the log</h2>
        <pre class="text" tabindex="0">
          ${run.logTail}
        </pre>
      `
    }
    ${
      run.manifest &&
      html`
        <details>
          <summary>YAML to run it again</summary>
          <p class="quiet">Saved as <code>run.yaml</code>, this repeats it:${' '}
            <code>slamhive run run.yaml</code></p>
          <pre class="text" tabindex="0">
            ${run.manifest}
          </pre>
        </details>
      `
    }
    <${Facts} title="Attributes of the dataset" value=${run.attributes} folded />
  `;
}

/**
 * What somebody wrote of the run; each tag leads to the runs that have it.
 * @param {{note: string|null, tags: string[]}} props
 */
function Said({ note, tags }) {
  if (!note && tags.length === 0) return null;
  return html`
    <p class="row">
      ${note && html`<span>“${clip(note, LONGEST)}”</span>`}
      ${tags.map(
        (tag) => html`
          <${Link} class="chip" href=${address('/runs', { where: `tags contains '${tag}'` })}>${tag}</${Link}>
        `,
      )}
    </p>
  `;
}

/**
 * Return the title of a run: its algorithm and dataset; one of which they are not known has its name.
 * @param {Api.Run} run
 * @param {string} uid
 */
function titleOf({ configuration, name }, uid) {
  const { algorithm, dataset } = configuration ?? {};
  return clip(algorithm && dataset ? `${algorithm} on ${dataset}` : (name ?? uid), 160);
}

/** Settings that are named where none is known to vary. */
const MOST_SETTINGS = 6;

/**
 * Return the settings of a run in words: those that tell it from others like it, or its first parameters.
 * @param {Api.Run} run
 */
function settingsOf({ configuration, attributes, varied }) {
  const pairs = flat(configuration, null);
  const known = new Map([...pairs, ...flat(attributes, null, 'dataset.attributes')]);
  const told = varied.length
    ? varied.map((one) => namedValue(one, known.get(one.name)))
    : pairs
        .filter(([name]) => name.startsWith('parameters.'))
        .slice(0, MOST_SETTINGS)
        .map(([name, value]) => namedValue(name, value));
  return [...told, ...(known.has('repetition') ? [`repetition ${known.get('repetition')}`] : [])].map((one) =>
    clip(one, 100),
  );
}

/**
 * Lay nested values out as "a.b: value"; what is null is left out unless its name is to be kept: NaN and
 * infinity come as null.
 * @param {any} value
 * @param {RegExp|null} keep
 * @param {string} [prefix]
 * @returns {Array<[string, any]>}
 */
function flat(value, keep, prefix = '') {
  if (value === null || value === undefined) return [];
  return Object.entries(value).flatMap(([key, inner]) => {
    const name = prefix ? `${prefix}.${key}` : key;
    if (inner === undefined || inner === '–' || (inner === null && !keep?.test(name))) return [];
    return inner !== null && typeof inner === 'object' && !Array.isArray(inner)
      ? flat(inner, keep, name)
      : [[name, inner]];
  });
}

/**
 * @param {string} name
 * @param {any} value
 */
const shown = (name, value) =>
  clip(/bytes$/i.test(name) && typeof value === 'number' ? bytes(value) : cell(value), LONGEST);

/**
 * @param {{title: string, value: object|null|undefined, keep?: RegExp|null, folded?: boolean, labels?:
 *   Record<string, string>, of?: string}} props labels: what columns are called; of: the part they are of
 */
function Facts({ title, value, keep = null, folded = false, labels = {}, of = '' }) {
  const pairs = flat(value, keep);
  if (pairs.length === 0) return null;
  const list = html`
    <dl class="facts">
      ${pairs.map(
        ([name, one]) => html`
          <dt>${clip(labels[`${of}.${name}`] ?? name, 120)}</dt>
          <dd tabindex=${String(one).length > LONG ? 0 : null}>${shown(name, one)}</dd>
        `,
      )}
    </dl>
  `;
  return folded
    ? html`
      <details class="card">
        <summary>
          ${title} (${pairs.length})
        </summary>
        ${list}
      </details>
    `
    : html`
      <section class="card">
        <h2>${title}</h2>
        ${list}
      </section>
    `;
}

/** What a trajectory beside a run's own is called. @type {Record<string, string>} */
const BESIDE = { keyframes: 'keyframes', online: 'causal' };

const CAUSAL =
  'Causal: each pose as it was first published, which knew nothing of later frames. Final: the last pose ' +
  'of each stamp, as loops and later frames corrected it.';

/**
 * Return when poses came, in words: '' where no player noted it.
 * @param {any} metrics of the run
 */
function timeliness({ latencySeconds: latency, realTimeFactor: factor }) {
  const places = [
    ['p50', latency?.median],
    ['p95', latency?.p95],
    ['p99', latency?.p99],
    ['max', latency?.max],
  ].flatMap(([name, value]) => (typeof value === 'number' ? [`${name} ${number(value, 3)} s`] : []));
  const behind = factor > 1.05 ? 'the node was behind' : 'the node kept up';
  return [
    places.length ? `Latency, from a frame to its first pose: ${places.join(', ')}.` : '',
    typeof factor === 'number' ? `Real-time factor ${number(factor, 3)}: ${behind}.` : '',
  ]
    .filter(Boolean)
    .join(' ');
}

/** What a run's own trajectory is called. */
const OWN = ['trajectory', 'final'];

/**
 * The rows of a result: its own, and one for each trajectory that was measured beside it.
 * @param {any} result
 * @returns {any[]}
 */
const withOthers = ({ beside, ...own }) => [
  { ...own, of: beside?.online ? 'final' : 'trajectory' },
  ...Object.entries(beside ?? {}).map(([word, found]) => ({
    evaluation: own.evaluation,
    alignment: own.alignment,
    ...found,
    of: BESIDE[word] ?? word,
  })),
];

/** @param {{run: Api.Run, results: Api.Run['results']}} props */
function Results({ run, results }) {
  const narrow = useNarrow();
  if (results.length === 0) return null;
  const rows = results.flatMap(withOthers);
  const others = rows.length > results.length;
  const timely = timeliness(run.metrics);
  /**
   * @param {string} name
   * @param {string} title
   * @param {(row: any) => number|null|undefined} of
   */
  const metre = (name, title, of) => ({
    name,
    title,
    kind: 'number',
    show: (/** @type {unknown} */ _, /** @type {any} */ row) => number(of(row)),
  });
  /** @type {TableColumn[]} */
  const columns = [
    { name: 'evaluation', title: 'evaluation' },
    ...(others ? [{ name: 'of', title: 'poses' }] : []),
    { name: 'alignment', title: 'alignment' },
    { name: 'outcome', title: 'outcome', show: (value) => html`<${Status} value=${value} />` },
    { name: 'coverage', title: 'coverage', kind: 'number' },
    { name: 'scale', title: 'scale', kind: 'number' },
    ...['rmse', 'mean', 'median', 'std', 'max'].flatMap((which) => [
      metre(`ate.${which}`, `ATE ${which} [m]`, (row) => row.ate?.[which]),
      ...(which === 'rmse' ? costColumns([run], () => run) : []),
    ]),
    metre('rpe', 'RPE rmse [m]', (row) => row.rpe?.[0]?.rmse ?? row.rpe?.[0]?.translation?.rmse),
    ...(rows.some((row) => !OWN.includes(row.of) && row.message)
      ? [{ name: 'message', title: 'remark', show: (/** @type {unknown} */ text) => clip(cell(text), 200) }]
      : []),
  ];
  return html`
    <h2>Measured</h2>
    <${Table}
      columns=${foremost(columns, narrow ? ['ate.rmse', 'cpu', 'memory', 'outcome'] : [])}
      rows=${rows}
      caption="Results by evaluation"
    />
    ${rows.some((row) => row.of === BESIDE.online) && html`<p class="quiet">${CAUSAL}</p>`}
    ${timely && html`<p>${timely}</p>`}
  `;
}

/**
 * @param {{base: string, results: Api.Run['results'], name: string, cameras: boolean}} props cameras: whether
 *   the run was given images
 */
function Trajectory({ base, results, name, cameras }) {
  const { query, change } = useAddress();
  const evaluation = query.get('evaluation', results[0]?.evaluation ?? '');
  const url = address(`${base}/trajectory`, { points: 2000, evaluation });
  const { data, error } = useData(url);
  const truths = useMemo(() => data && truthsOf([{ of: '', reference: data.reference }]), [data]);
  const estimates = useMemo(() => data && [{ name, track: data.estimate }], [data, name]);
  const errors = useMemo(
    () =>
      data &&
      withHealth(
        overTime(
          [
            {
              name: 'error',
              t: since(data.estimate.t, data.clock.start),
              values: data.estimate.error,
            },
          ],
          'error [m]',
          shared([data]).title,
        ),
        results.find((one) => one.evaluation === data.evaluation),
        data.clock.start,
      ),
    [data, results],
  );
  const choice = results.length > 1 || error?.field === 'evaluation';
  return html`
    <h2>Trajectory</h2>
    ${
      choice &&
      html`
        <p>
          <${Choice}
            label="Evaluation"
            value=${evaluation}
            options=${results.map((one) => one.evaluation)}
            error=${error?.field === 'evaluation' ? error : null}
            onChange=${(value) => change({ evaluation: value })}
          />
        </p>
      `
    }
    ${error && error.field !== 'evaluation' && html`<p class="quiet">${clip(error.message, 500)}</p>`}
    ${
      data &&
      html`
        <div class="facets">
          <${Tracks}
            estimates=${estimates}
            truths=${truths}
            surveyed=${data.points}
            byError=${true}
            csv=${csvOf(url)}
            title="Trajectory"
          />
        </div>
        ${
          data.estimate.error?.some((/** @type {number|null} */ value) => value !== null) &&
          html`
            <${Chart}
              option=${errors}
              group=${base}
              height=${260}
              csv=${csvOf(url)}
              table=${trackTable(estimates)}
              title="Error over time"
            />
          `
        }
        <p class="quiet">
          ${number(data.shown)} of ${number(data.poses)} poses are drawn, aligned by${' '}
          ${clip(data.alignment ?? 'nothing', 40)}.
        </p>
        <${Notes} notes=${data.notes} />
        ${cameras && !SITE && html`<${Seen} key=${base} base=${base} data=${data} />`}
      `
    }
  `;
}

/** @param {{base: string}} props */
function Usage({ base }) {
  const { data, error } = useData(`${base}/usage`);
  const drawn = useMemo(
    () =>
      data &&
      loads(
        [{ name: 'run', usage: data, t: data.stamp && since(data.stamp, data.clock.start) }],
        data.clock && shared([data]),
      ),
    [data],
  );
  const csv = csvOf(`${base}/usage`);
  return html`
    <h2>Load</h2>
    ${error && html`<p class="quiet">${clip(error.message, 500)}</p>`}
    ${
      data &&
      html`
        <div class="facets">
          ${drawn.map(
            (/** @type {LoadChart} */ { title, option, table, ofDataset }) => html`
              <${Chart}
                key=${title}
                option=${option}
                height=${260}
                csv=${csv}
                table=${table}
                title=${title}
                group=${`${base}${ofDataset ? '' : ' program'}`}
              />
            `,
          )}
        </div>
        <${Notes} notes=${data.notes} />
      `
    }
  `;
}

/** @param {{base: string, known: boolean}} props */
function Settings({ base, known }) {
  const { data } = useData(known === false ? null : `${base}/settings-files`);
  if (!data?.items?.length) return null;
  return html`
    <h2>Settings files</h2>
    ${data.items.map(
      /** @param {{path: string, file: string, size: number, text: string|null}} item */
      (item) => html`
        <details key=${item.path}>
          <summary>${clip(item.path, 100)}</summary>
          ${
            item.text === null
              ? html`
                <p class="quiet">It has ${bytes(item.size)}: download it below.</p>
              `
              : html`
                <pre class="text" tabindex="0">${item.text}</pre>
              `
          }
        </details>
      `,
    )}
  `;
}

/** @param {{base: string, known: boolean}} props */
function Files({ base, known }) {
  const { data } = useData(known === false ? null : `${base}/files`);
  if (!data?.items?.length) return null;
  /** @type {TableColumn[]} */
  const columns = [
    {
      name: 'path',
      title: 'file',
      show: (path) => html`
        <${Download} href=${`${base}/files/${path.split('/').map(encodeURIComponent).join('/')}`}>
          ${clip(path, 100)}
        </${Download}>
      `,
    },
    { name: 'size', title: 'size', kind: 'number', show: (size) => bytes(size) },
    { name: 'modified', title: 'modified', show: (value) => time(value) },
  ];
  return html`
    <h2>Files</h2>
    <${Table} columns=${columns} rows=${data.items} caption="Files of the run" />
  `;
}
