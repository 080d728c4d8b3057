// SPDX-License-Identifier: Apache-2.0
/** Moments of a run at which it was lost: where its poses begin late, break off, end early or are worst. */
import { number } from '../core/format.js';
import { pieces } from './trajectory.js';

/** Seconds without a pose that are worth a look. */
const LONG = 1;
const MOST_GAPS = 4;

/**
 * Return the moments of a path that are worth a look, in their order.
 * @param {Api.Track} estimate
 * @param {Api.Track|null} reference ground truth
 * @returns {Array<{t: number, text: string}>} t: sensor time, s
 */
export function momentsOf(estimate, reference) {
  const { t } = estimate;
  if (!t.length) return [];
  /** @param {number} seconds */
  const long = (seconds) => `${number(seconds, 3)} s`;
  const [first, last] = [t[0], t[t.length - 1]];
  const truth = reference?.t.length ? [reference.t[0], reference.t[reference.t.length - 1]] : [first, last];
  const gaps = pieces(estimate)
    .slice(1)
    .map(([from]) => ({ t: t[from - 1], seconds: t[from] - t[from - 1] }))
    .filter((gap) => gap.seconds > LONG)
    .sort((a, b) => b.seconds - a.seconds)
    .slice(0, MOST_GAPS);
  const errors = estimate.error ?? [];
  const worst = errors.reduce(
    (/** @type {number} */ best, error, at) => (error !== null && error > (errors[best] ?? -1) ? at : best),
    -1,
  );
  return [
    ...(first - truth[0] > LONG ? [{ t: first, text: `first pose, ${long(first - truth[0])} late` }] : []),
    ...gaps.map((gap) => ({ t: gap.t, text: `lost for ${long(gap.seconds)}` })),
    ...(worst >= 0 ? [{ t: t[worst], text: `largest error, ${number(errors[worst], 3)} m` }] : []),
    ...(truth[1] - last > LONG ? [{ t: last, text: `last pose, ${long(truth[1] - last)} early` }] : []),
  ].sort((a, b) => a.t - b.t);
}
