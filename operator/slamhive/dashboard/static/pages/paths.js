// SPDX-License-Identifier: Apache-2.0
/** Paths of several runs in one picture: all repetitions of a setting, or whatever the filters leave. */
import { cropped } from '../charts/cropping.js';
import { truthsOf } from '../charts/trajectory.js';
import { address, useAddress } from '../core/address.js';
import { csvOf, useData } from '../core/api.js';
import { COLOURS } from '../core/chart.js';
import { Filters, shownByFilters, useColumns } from '../core/filters.js';
import { cell, clip, keysText, number, plural } from '../core/format.js';
import { Choice, Fault, Link, NothingFits, Notes, Status, Table, useTitle, Waiting } from '../core/parts.js';
import { html, useMemo } from '../core/ui.js';
import { Tracks } from './tracks.js';

/** Colours by what became of a run; others failed. @type {Record<string, string>} */
const OUTCOMES = { Tracked: '#0072b2', Partial: '#e69f00', Lost: '#d55e00', Diverged: '#cc79a7' };
/** @param {string} status */
const rank = (status) => Object.keys(OUTCOMES).indexOf(status);
/** Paths that can be told apart by a colour each. */
const FEW = 8;

export default function Paths() {
  const { query, change } = useAddress();
  const of = query.get('of');
  const columns = useColumns();
  useTitle('Paths');
  const url = address('/api/v1/analysis/paths', query.filters().with({ of }));
  const { data, error } = useData(url);
  const many = (data?.rows ?? 0) > FEW;
  const colour = query.get('colour', many ? 'outcome' : 'run');
  return html`
    <h1>${of ? 'All repetitions of a run' : 'Paths'}</h1>
    ${
      query.get('embed') !== '1' &&
      html`
        <section class="controls" aria-label="What is drawn">
          <div class="row">
            <${Choice}
              label="Colours tell"
              value=${colour}
              options=${[['run', 'the run'], ['outcome', 'the outcome'], ['error', 'the error']]}
              onChange=${(chosen) => change({ colour: chosen })}
            />
          </div>
        </section>
        <${Filters} columns=${columns.data?.items} error=${error} />
      `
    }
    ${!shownByFilters(error, query) && html`<${Fault} error=${error} />`}
    ${
      data
        ? data.groups.length
          ? data.groups.map(
              (/** @type {Api.PathGroup} */ group) => html`
                <${Together}
                  key=${JSON.stringify(group.facets)}
                  group=${group}
                  alone=${data.groups.length === 1}
                  colour=${colour}
                  csv=${csvOf(url)}
                />
              `,
            )
          : html`<${NothingFits} notes=${data.notes} />`
        : !error && html`<${Waiting} />`
    }
    <${Notes} notes=${data?.notes} />
  `;
}

/**
 * @param {{group: Api.PathGroup, alone: boolean, colour: string, csv: string}} props
 */
function Together({ group, alone, colour, csv }) {
  const drawn = useMemo(() => picture(group, colour), [group, colour]);
  const truths = useMemo(() => truthsOf([{ of: 'all', reference: group.reference }]), [group]);
  const { facets, runs } = group;
  const without = runs.filter((one) => !one.track);
  const title = ['Paths on', facets.dataset, alone ? '' : `(${cell(facets.evaluation)})`]
    .filter(Boolean)
    .join(' ');
  /** @type {TableColumn[]} */
  const columns = [
    {
      name: 'run',
      title: 'run',
      show: (_, one) => html`
        <${Link} href=${address(`/runs/${encodeURIComponent(one.uid)}`)}>
          ${clip(keysText(one.keys) || cell(one.run), 120)}
        </${Link}>
      `,
    },
    {
      name: 'status',
      title: 'outcome',
      show: (value) => html`<${Status} value=${value} />`,
    },
    { name: 'coverage', title: 'coverage', kind: 'number' },
    { name: 'error', title: 'ATE [m]', kind: 'number' },
    { name: 'problem', title: 'path', show: (value) => clip(value ?? 'drawn', 80) },
  ];
  return html`
    <section>
      <h2>${clip(title, 120)} <span class="quiet">${plural(runs.length, 'run')}</span></h2>
      ${
        drawn.estimates.length > 0 &&
        html`
          <div class="facets spaced">
            <${Tracks}
              estimates=${drawn.estimates}
              truths=${truths}
              byError=${colour === 'error'}
              title=${title}
              csv=${csv}
            />
          </div>
        `
      }
      <${Notes}
        notes=${[
          without.length
            ? `${without.length} of ${runs.length} runs have no path here: ` +
              clip(without[0].problem ?? '', 200)
            : '',
          ...drawn.notes,
          ...group.notes,
        ].filter(Boolean)}
      />
      <${Table} columns=${columns} rows=${runs} caption=${`Runs of ${clip(title, 100)}`} rowKey="uid" />
    </section>
  `;
}

/**
 * @param {Api.PathGroup} group
 * @param {string} colour
 */
function picture({ runs, reference }, colour) {
  const present = runs.flatMap((one) => (one.track ? [{ ...one, track: one.track }] : []));
  const { tracks, cut, room } = cropped(
    present.map((one) => one.track),
    reference,
  );
  const names = present.map((one) => keysText(one.keys) || `run ${cell(one.run)}`);
  const byOutcome = colour === 'outcome';
  const estimates = present
    .map((one, at) => ({
      // Paths of one outcome have one entry in the legend.
      name: byOutcome ? one.status : clip(names[at], 60),
      track: tracks[at],
      colour: byOutcome ? (OUTCOMES[one.status] ?? '#7f7f7f') : COLOURS[at % COLOURS.length],
    }))
    .filter((one) => one.track.t.length);
  // What failed is drawn above what did not.
  if (byOutcome) estimates.sort((a, b) => rank(a.name) - rank(b.name));
  const leaving = cut.flatMap((count, at) => (count ? [names[at]] : []));
  return {
    estimates,
    notes: leaving.length
      ? [
          `${leaving.length} of ${present.length} paths leave the picture and are cut ${number(room, 3)} m ` +
            `around the ground truth: ${clip(leaving.join('; '), 200)}`,
        ]
      : [],
  };
}
