// SPDX-License-Identifier: Apache-2.0
/** Paths that leave the picture: one that diverges by kilometres must not press all others into a point. */

const AXES = /** @type {const} */ (['x', 'y', 'z']);
/** How many times its size the picture may grow for a path beyond the ground truth. */
const ROOM = 1;

/**
 * Return the box around a track.
 * @param {Api.Track} track
 */
function boxOf(track) {
  return AXES.map((axis) => [
    track[axis].reduce((least, value) => Math.min(least, value), Infinity),
    track[axis].reduce((most, value) => Math.max(most, value), -Infinity),
  ]);
}

/** @param {number[][]} box */
const sizeOf = (box) => Math.hypot(...box.map(([low, high]) => high - low));

/**
 * Return tracks without the poses that are far from the ground truth (or, without one, from the path of
 * middling size), and how many poses of each were left out.
 * @param {Api.Track[]} tracks
 * @param {Api.Track|null} reference
 * @returns {{tracks: Api.Track[], cut: number[], room: number}} room: metres around it that are kept
 */
export function cropped(tracks, reference) {
  const boxes = tracks.filter((track) => track.t.length).map(boxOf);
  const sorted = [...boxes].sort((a, b) => sizeOf(a) - sizeOf(b));
  const around = reference?.t.length ? boxOf(reference) : sorted[sorted.length >> 1];
  if (!around) return { tracks, cut: tracks.map(() => 0), room: 0 };
  const room = ROOM * sizeOf(around);
  if (!(room > 0)) return { tracks, cut: tracks.map(() => 0), room };
  /** @param {Api.Track} track */
  const inside = (track) =>
    track.t.flatMap((_, at) =>
      AXES.every(
        (axis, k) => track[axis][at] >= around[k][0] - room && track[axis][at] <= around[k][1] + room,
      )
        ? [at]
        : [],
    );
  const kept = tracks.map(inside);
  return {
    room,
    cut: tracks.map((track, number) => track.t.length - kept[number].length),
    tracks: tracks.map((track, number) =>
      kept[number].length === track.t.length ? track : taken(track, kept[number]),
    ),
  };
}

/**
 * @param {Api.Track} track
 * @param {number[]} places
 * @returns {Api.Track}
 */
const taken = (track, places) => ({
  t: places.map((at) => track.t[at]),
  x: places.map((at) => track.x[at]),
  y: places.map((at) => track.y[at]),
  z: places.map((at) => track.z[at]),
  error: track.error ? places.map((at) => track.error?.[at] ?? null) : track.error,
});
