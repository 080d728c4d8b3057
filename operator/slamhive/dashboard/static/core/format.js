// SPDX-License-Identifier: Apache-2.0
/** Values as people read them. */

const STATUS_CLASS = {
  Tracked: 'good', Succeeded: 'good', Partial: 'fair', Running: 'live', Pending: 'live', Queued: 'live', NotEvaluated: 'plain',
};

/** Return a number with four significant digits; '–' where there is none. */
export function number(value, digits = 4) {
  if (value === null || value === undefined || Number.isNaN(value)) return '–';
  if (value === 0) return '0';
  const size = Math.abs(value);
  if (size >= 1e7 || size < 1e-4) return value.toExponential(digits - 1).replace('e+', 'e');
  if (Number.isInteger(value)) return size < 1e4 ? String(value) : value.toLocaleString('en');
  return String(Number(value.toPrecision(Math.max(digits, Math.ceil(Math.log10(size))))));
}

/** Return an ISO time or seconds since 1970 in the reader's zone. */
export function time(value) {
  if (value === null || value === undefined) return '–';
  const date = new Date(typeof value === 'number' ? value * 1000 : value);
  return Number.isNaN(date.getTime()) ? String(value) : date.toLocaleString('sv');
}

/** Return a stored value of a column as it is shown. @param heading the column's heading */
export function cell(value, heading) {
  if (value === null || value === undefined) return '–';
  if (typeof value === 'boolean') return value ? 'yes' : 'no';
  if (heading?.kind === 'time') return time(value);
  if (typeof value === 'number') return number(value * (heading?.factor ?? 1));
  if (typeof value === 'object') return JSON.stringify(value);
  return String(value);
}

/** Cut a long text in the middle of its length. */
export const clip = (text, length = 60) => {
  const whole = String(text);
  return whole.length > length ? `${whole.slice(0, length - 1)}…` : whole;
};

/** Return the class of a status' colour. */
export const statusClass = (status) => STATUS_CLASS[status] ?? 'bad';

/** Return bytes as KiB, MiB or GiB. */
export function bytes(value) {
  if (value === null || value === undefined) return '–';
  const steps = ['B', 'KiB', 'MiB', 'GiB', 'TiB'];
  const step = Math.min(steps.length - 1, Math.max(0, Math.floor(Math.log2(Math.max(1, value)) / 10)));
  return `${number(value / 1024 ** step, 3)} ${steps[step]}`;
}

/** Columns whose values say by themselves what they are. */
export const SUBJECT = ['algorithm', 'sensors', 'dataset'];
const TITLES = { 'input.frameRate': 'frame rate [Hz]', 'provenance.cpuModel': 'processor', 'usage.includesReader': 'reader included' };
const PREFIX = /^(parameters|input|resources|dataset\.attributes|label|provenance)\./;

/** Return what people call a column, with its unit. */
export const columnTitle = (name) => TITLES[name] ?? name.replace(PREFIX, '');

/** Return a value of a column with its name, unless it says by itself what it is: "mono", "frame rate 7.5 Hz", "reader not included". */
export function namedValue(name, value) {
  if (name === 'usage.includesReader') return { true: 'reader included', false: 'reader not included' }[value] ?? 'reader unknown';
  if (SUBJECT.includes(name)) return cell(value);
  const [title, unit] = columnTitle(name).split(' [');
  return `${title} ${cell(value)}${unit && value !== null && value !== undefined ? ` ${unit.slice(0, -1)}` : ''}`;
}

/** Return keys of a group as one text: "orb-slam3, mono, evaluation sim3". */
export const keysText = (keys) => Object.entries(keys ?? {}).map(([name, value]) => namedValue(name, value)).join(', ');

/** Return the keys by which some groups differ, and those that say what a group is about: what all share needs no telling.
 * @param {object[]} all keys of each group */
export const tellingKeys = (all) => Object.keys(all[0] ?? {}).filter((name) => SUBJECT.includes(name) || new Set(all.map((keys) => String(keys[name]))).size > 1);
