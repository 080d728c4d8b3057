// SPDX-License-Identifier: Apache-2.0
/** The one scale of colours that tell numbers: cividis, for colour-blind eyes too; dark is worse or later. */

/** Its ends are left out: the page is light or dark. */
const RAMP = [
  [214, 195, 93],
  [170, 159, 113],
  [125, 124, 120],
  [83, 91, 109],
  [36, 60, 110],
];

/** @param {number[]} parts */
const rgb = (parts) => `rgb(${parts.join(',')})`;

export const SCALE = RAMP.map(rgb);

/**
 * Return the colour of a share from 0 to 1.
 * @param {number} share
 */
export function ramp(share) {
  const place = Math.min(1, Math.max(0, share)) * (RAMP.length - 1);
  const low = Math.min(RAMP.length - 2, Math.floor(place));
  return rgb(RAMP[low].map((value, at) => Math.round(value + (RAMP[low + 1][at] - value) * (place - low))));
}
