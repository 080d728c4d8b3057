// SPDX-License-Identifier: Apache-2.0
/** Phones: of a wide table only the first columns are seen, so what matters comes first. */
import { useEffect, useState } from './ui.js';

/** As in app.css. */
const NARROW = '(max-width: 640px)';

/** Tell whether the window is a phone's, now and when it is turned. */
export function useNarrow() {
  const [narrow, setNarrow] = useState(() => matchMedia(NARROW).matches);
  useEffect(() => {
    const media = matchMedia(NARROW);
    const look = () => setNarrow(media.matches);
    media.addEventListener('change', look);
    return () => media.removeEventListener('change', look);
  }, []);
  return narrow;
}

/**
 * Return things with those of some names first, in the order of the names; the others as they were.
 * @template {{name: string}} T
 * @param {T[]} all
 * @param {string[]} names
 * @returns {T[]}
 */
export const foremost = (all, names) => [
  ...names.flatMap((name) => all.filter((one) => one.name === name)),
  ...all.filter((one) => !names.includes(one.name)),
];
