// SPDX-License-Identifier: Apache-2.0
/** Limits of axes: a few values far away don't flatten all others, and the ends are round numbers. */
/** Quartile distances beyond the quartiles from which on a value is far out; as in `analysis/limits.py`. */
const FAR = 3;
/** Values below which none is left outside: of a few, none is the exception. */
const LEAST = 8;
/** Share of the values that may be left outside; more of them are a second group, not exceptions. */
const MOST = 0.2;
/** How many times as long the axis must be with them as without. */
const GAIN = 2;

/**
 * Return the limits of an axis over some values, and the number of those beyond.
 * @param {Array<number|null|undefined>} values
 * @param {{log?: boolean}} [how] log: distances are those of an axis of logarithms, which has no place for 0
 * @returns {Limits|null} null where there is no value
 */
export function robustLimits(values, { log = false } = {}) {
  const known = /** @type {number[]} */ (
    values.filter((value) => typeof value === 'number' && Number.isFinite(value) && (!log || value > 0))
  ).sort((a, b) => a - b);
  if (!known.length) return null;
  const places = log ? known.map(Math.log10) : known;
  const [low, high] = fences(places);
  const first = places.findIndex((place) => place >= low);
  const last = places.findLastIndex((place) => place <= high);
  const outside = places.length - (last - first + 1);
  const [whole, kept] = [places[places.length - 1] - places[0], places[last] - places[first]];
  const cut = places.length >= LEAST && outside <= MOST * places.length && whole >= GAIN * kept && kept > 0;
  const [from, to] = cut ? [first, last] : [0, places.length - 1];
  return { low: known[from], high: known[to], below: from, above: places.length - 1 - to };
}

/**
 * Return between what sorted values are not far out.
 * @param {number[]} sorted
 */
function fences(sorted) {
  let [first, third] = [quantile(sorted, 0.25), quantile(sorted, 0.75)];
  // Half of them are equal: the middle four fifths tell.
  if (first === third) [first, third] = [quantile(sorted, 0.1), quantile(sorted, 0.9)];
  const distance = third - first || Infinity;
  return [first - FAR * distance, third + FAR * distance];
}

/**
 * Return ends of an axis that hold some limits and are round, with the step between its labels.
 * @param {{low: number, high: number}|null} limits
 * @param {{log?: boolean, steps?: number}} [how] steps: about how many there are to be
 * @returns {{min?: number, max?: number, interval?: number}} {} where nothing is known
 */
export function roundEnds(limits, { log = false, steps = 4 } = {}) {
  if (!limits) return {};
  if (log) {
    const [low, high] = [Math.floor(Math.log10(limits.low)), Math.ceil(Math.log10(limits.high))];
    return { min: 10 ** low, max: 10 ** Math.max(high, low + 1) };
  }
  const low = limits.low > 0 && limits.low < 0.4 * limits.high ? 0 : limits.low;
  const span = limits.high - low || Math.abs(low) || 1;
  const rough = span / steps;
  const power = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 2.5, 5, 10].find((one) => one * power >= rough) ?? 10;
  const interval = step * power;
  // A value at the very end would be half hidden.
  const min = low === 0 ? 0 : Math.floor(low / interval) * interval;
  const max = Math.ceil((limits.high + span * 0.02) / interval) * interval;
  return { min: clean(min), max: clean(max), interval };
}

/**
 * Return the ends of an axis of settings, a little beyond its values so that no point lies on the frame, with
 * a tick at each value where they are few.
 * @param {number[]} values
 * @param {boolean} log
 * @param {number} [few] values up to which each has a tick
 * @returns {{min?: number, max?: number, axisTick?: any, axisLabel?: any}}
 */
export function triedEnds(values, log, few = 10) {
  const known = [...new Set(values)].filter((value) => !log || value > 0).sort((a, b) => a - b);
  if (!known.length) return {};
  const [low, high] = [known[0], known[known.length - 1]];
  const room = (high - low) * 0.06 || Math.abs(high) * 0.1 || 1;
  const ends = log ? { min: low / 1.15, max: high * 1.15 } : { min: low - room, max: high + room };
  if (known.length > few) return { ...ends, axisLabel: { showMinLabel: false, showMaxLabel: false } };
  const customValues = known.map(clean);
  return { ...ends, axisTick: { customValues }, axisLabel: { customValues } };
}

/**
 * Return round ticks of a logarithmic axis, with their labels: at most a handful.
 * @param {number} low above 0
 * @param {number} high
 */
export function logTicks(low, high) {
  const [first, last] = [Math.floor(Math.log10(low)), Math.ceil(Math.log10(high))];
  const span = Math.log10(high / low);
  const step = Math.max(1, Math.ceil(span / 6));
  const parts =
    span > 2
      ? [1]
      : span > 0.8
        ? [1, 2, 5]
        : span > 0.35
          ? [1, 1.5, 2, 3, 5, 7]
          : [1, 1.2, 1.4, 1.7, 2, 2.5, 3, 4, 5, 6, 7, 8, 9];
  const customValues = Array.from(
    { length: Math.floor((last - first) / step) + 1 },
    (_, at) => first + at * step,
  )
    .flatMap((power) => parts.map((part) => clean(part * 10 ** power)))
    .filter((value) => value >= low * 0.999 && value <= high * 1.001);
  return { axisTick: { customValues }, axisLabel: { customValues } };
}

/** Take off what floating point adds in the last digits. @param {number} value */
const clean = (value) => Number(value.toPrecision(12));

/**
 * Say what lies beyond some limits, in words; '' where nothing does.
 * @param {Limits|null} limits
 * @param {string} what of them there are: "median", "run"
 */
export function outsideText(limits, what) {
  const count = limits ? limits.below + limits.above : 0;
  if (!count) return '';
  return count === 1
    ? `1 ${what} lies outside the limits of the axis: a triangle at its end marks it`
    : `${count} ${what}s lie outside the limits of the axis: triangles at its ends mark them`;
}

/**
 * The share of a sorted list: linear between its values.
 * @param {number[]} sorted
 * @param {number} share
 */
export function quantile(sorted, share) {
  const place = (sorted.length - 1) * share;
  const low = Math.floor(place);
  return sorted[low] + (sorted[Math.ceil(place)] - sorted[low]) * (place - low);
}
