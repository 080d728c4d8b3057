// SPDX-License-Identifier: Apache-2.0
/** Paths of runs over their ground truth: from above, from two sides, and in space. */
import { errorRange, plane, PLANES, TRUTH } from '../charts/trajectory.js';
import { useAddress } from '../core/address.js';
import { Chart, COLOURS } from '../core/chart.js';
import { useNarrow } from '../core/narrow.js';
import { Space } from '../core/space.js';
import { html, useMemo } from '../core/ui.js';

/** The ground truth is a pale, broad line below the paths. */
const TRUTH_UNDER = `${TRUTH}73`;

const NUMBERS = ['t', 'x', 'y', 'z', 'error'].map((name) => ({
  name,
  title: name === 't' ? 'time stamp [s]' : `${name} [m]`,
  kind: 'number',
}));
const FIGURES = [
  { name: 'run', title: 'run' },
  ...NUMBERS.map((column) =>
    column.name === 't' ? { ...column, show: (/** @type {number} */ value) => value.toFixed(3) } : column,
  ),
];

/**
 * Return the poses of some tracks as a table.
 * @param {Array<{name: string, track: Api.Track}>} estimates
 * @param {TableColumn[]} [columns]
 * @returns {TableData}
 */
export const trackTable = (estimates, columns = FIGURES) => ({
  columns,
  rows: estimates.flatMap(({ name, track }) =>
    track.t.map((t, at) => ({
      run: name,
      t,
      x: track.x[at],
      y: track.y[at],
      z: track.z[at],
      error: track.error?.[at] ?? null,
    })),
  ),
});

/**
 * @param {{estimates: Array<{name: string, track: Api.Track, colour?: string}>, truths: Truth[],
 *   surveyed?: Api.Track|null, byError: boolean, csv?: string|true, title: string, aligned?: string}} props
 *   surveyed: control points; byError: colours tell the error instead of the run
 */
export function Tracks({ estimates, truths, surveyed = null, byError, csv, title }) {
  const { query, change } = useAddress();
  const drawn = useMemo(() => {
    const tracks = [...estimates.map((one) => one.track), ...(surveyed ? [surveyed] : [])];
    const range = byError ? errorRange(tracks) : null;
    return {
      range,
      table: trackTable([...estimates, ...(surveyed ? [{ name: 'control points', track: surveyed }] : [])]),
      planes: PLANES.map(([name, a, b]) => [name, plane(estimates, truths, a, b, range, surveyed)]),
      paths: [
        ...truths.map((one) => ({ ...one, colour: TRUTH_UNDER, width: 4, under: true })),
        ...estimates.map((one, at) => ({
          name: one.name,
          track: one.track,
          colour: one.colour ?? COLOURS[at % COLOURS.length],
          width: 2,
          ...(range ? { error: one.track.error } : {}),
        })),
      ],
    };
  }, [estimates, truths, surveyed, byError]);
  const narrow = useNarrow();
  const planes = drawn.planes.map(
    ([name, option]) => html`
      <${Chart}
        key=${name}
        option=${option}
        height=${narrow ? 280 : 360}
        csv=${csv ?? true}
        table=${drawn.table}
        title=${`${title} ${name}${drawn.range ? ', coloured by error' : ''}`}
      />
    `,
  );
  const space = html`
    <${Space}
      key="space"
      title=${`${title} in 3D`}
      paths=${drawn.paths}
      range=${drawn.range}
      height=${330}
      csv=${csv ?? true}
      table=${drawn.table}
      view=${query.get('view')}
      onView=${(view) => change({ view }, true)}
    />
  `;
  // On a phone, from above and in space come first: both views from the sides are thin bands.
  return narrow ? [planes[0], space, ...planes.slice(1)] : [...planes, space];
}
