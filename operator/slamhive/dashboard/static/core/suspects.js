// SPDX-License-Identifier: Apache-2.0
/** Marks on what a wrong calibration may have falsified: scales that are off by one factor in all runs. */
import { address } from './address.js';
import { useData } from './api.js';
import { clip, keysText, number } from './format.js';
import { Link } from './parts.js';
import { html } from './ui.js';

const ADDRESS = '/api/v1/analysis/suspects';

/**
 * Return all suspects; [] until they are known.
 * @returns {Api.Suspect[]}
 */
export const useSuspects = () => useData(ADDRESS).data?.items ?? [];

/**
 * Return sentences on nodes that measure another load than others of their kind, where load is shown; []
 * until they are known.
 * @param {string[]} columns that are shown
 * @returns {string[]}
 */
export function useUnlikeNodes(columns) {
  const isLoad = columns.some((name) => name.startsWith('usage.'));
  /** @type {Api.NodeStanding[]} */
  const nodes = useData(isLoad ? `${ADDRESS}/nodes` : null).data?.items ?? [];
  /** @param {string} verdict */
  const named = (verdict) => nodes.filter((one) => one.verdict === verdict).map((one) => one.sentence);
  const slower = named('slower');
  return slower.length > 0 ? slower : named('faster');
}

/**
 * Return the suspect that something belongs to; undefined where there is none.
 * @param {Api.Suspect[]} suspects
 * @param {Record<string, Api.Value|undefined>} keys algorithm, sensors, dataset, evaluation as far as they
 *   are known
 */
export const suspectOf = (suspects, keys) =>
  suspects.find(
    (one) =>
      Object.entries(one.keys).every(([name, value]) => keys[name] === undefined || keys[name] === value) &&
      ['algorithm', 'sensors'].every((name) => keys[name] !== undefined),
  );

/**
 * A mark beside a figure.
 * @param {{suspect: Api.Suspect|undefined}} props
 */
export const Mark = ({ suspect }) =>
  suspect &&
  html`
    <${Link}
      class="status fair"
      href=${address('/studies', { kind: 'suspects' })}
      title=${clip(suspect.sentence, 400)}
    >
      calibration suspect
    </${Link}>
  `;

/**
 * What is suspect of one run's kind, in sentences.
 * @param {{keys: Api.Keys, evaluations: string[]}} props
 */
export function SuspectNotes({ keys, evaluations }) {
  const suspects = useSuspects();
  const found = suspects.filter((one) =>
    (evaluations.length ? evaluations : [undefined]).some((evaluation) =>
      suspectOf([one], { ...keys, evaluation }),
    ),
  );
  return found.map(
    (one) => html`
      <p class="suspect">
        <${Mark} suspect=${one} /> ${clip(keysText(one.keys), 120)}: in ${one.n} runs the scale is${' '}
        ${number(one.scale)} ± ${number(one.spread, 2)}; an algorithm's own error would vary, a wrong
        calibration or depth factor doesn't.
      </p>
    `,
  );
}
