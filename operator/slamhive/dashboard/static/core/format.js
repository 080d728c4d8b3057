// SPDX-License-Identifier: Apache-2.0
/** Values as people read them. */
import DEFAULTS from './defaults.json' with { type: 'json' };

const STATUS_CLASS = new Map(
  Object.entries({
    Tracked: 'good',
    Succeeded: 'good',
    Partial: 'fair',
    Running: 'live',
    Pending: 'live',
    Queued: 'live',
    NotEvaluated: 'plain',
  }),
);

/**
 * Return a number with four significant digits; '–' where there is none.
 * @param {number|null|undefined} value
 * @param {number} [digits]
 */
export function number(value, digits = 4) {
  if (value === null || value === undefined || Number.isNaN(value)) return '–';
  if (value === 0) return '0';
  const size = Math.abs(value);
  if (size >= 1e7 || size < 1e-4) return value.toExponential(digits - 1).replace('e+', 'e');
  if (Number.isInteger(value)) return size < 1e4 ? String(value) : value.toLocaleString('en');
  return String(Number(value.toPrecision(Math.max(digits, Math.ceil(Math.log10(size))))));
}

/**
 * Return a count with its noun: "1 run", "3 runs".
 * @param {number} count
 * @param {string} noun
 */
export const plural = (count, noun) => `${number(count)} ${noun}${count === 1 ? '' : 's'}`;

/**
 * Return an ISO time or seconds since 1970 in the reader's zone.
 * @param {string|number|null|undefined} value
 */
export function time(value) {
  if (value === null || value === undefined) return '–';
  const date = new Date(typeof value === 'number' ? value * 1000 : value);
  return Number.isNaN(date.getTime()) ? String(value) : date.toLocaleString('sv');
}

/**
 * Return a stored value of a column as it is shown.
 * @param {any} value
 * @param {{kind?: string, factor?: number}} [heading] the column's
 * @returns {string}
 */
export function cell(value, heading) {
  if (value === null || value === undefined) return '–';
  if (typeof value === 'boolean') return value ? 'yes' : 'no';
  if (heading?.kind === 'time') return time(value);
  if (typeof value === 'number') return number(value * (heading?.factor ?? 1));
  if (typeof value === 'object') return JSON.stringify(value);
  return String(value);
}

/**
 * Return blanks as wide as the digits that numbers of a column lack behind their point, so that points stand
 * below one another: a zero there would say more than is known.
 * @param {string[]} texts
 */
export function blanks(texts) {
  const digits = texts.map((text) => (/^-?[\d,]+\.?(\d*)$/.exec(text) ?? [])[1]?.length ?? null);
  const most = digits.reduce((long, one) => Math.max(long ?? 0, one ?? 0), 0) ?? 0;
  return digits.map((one) =>
    most && one !== null ? (one ? '' : '\u2008') + '\u2007'.repeat(most - one) : '',
  );
}

/**
 * Cut a long text at its end, between two characters.
 * @param {unknown} text
 * @param {number} [length]
 */
export const clip = (text, length = 60) => {
  const whole = String(text);
  if (whole.length <= length) return whole;
  const kept = whole.slice(0, length - 1);
  return `${/[\ud800-\udbff]$/.test(kept) ? kept.slice(0, -1) : kept}…`;
};

/**
 * Cut a text of several parts in the middle of the longest ones, so that what comes last is still read.
 * @param {string} text
 * @param {number} length
 */
export function shorten(text, length) {
  const parts = text.split(', ');
  for (let rest = text.length - length; rest > 0; ) {
    const at = parts.reduce((long, one, place) => (one.length > parts[long].length ? place : long), 0);
    const kept = Math.max(7, parts[at].length - rest - 1);
    if (kept >= parts[at].length - 1) break;
    const [characters, head] = [[...parts[at]], Math.ceil(kept / 2)];
    rest -= parts[at].length - kept - 1;
    parts[at] = `${characters.slice(0, head).join('')}…${characters.slice(head - kept).join('')}`;
  }
  return clip(parts.join(', '), Math.max(length, 8));
}

/**
 * Return the class of a status' colour.
 * @param {string} status
 */
export const statusClass = (status) => STATUS_CLASS.get(status) ?? 'bad';

/**
 * Return bytes as KiB, MiB or GiB.
 * @param {number|null|undefined} value
 */
export function bytes(value) {
  if (value === null || value === undefined) return '–';
  const steps = ['B', 'KiB', 'MiB', 'GiB', 'TiB'];
  const step = Math.min(steps.length - 1, Math.max(0, Math.floor(Math.log2(Math.max(1, value)) / 10)));
  return `${number(value / 1024 ** step, 3)} ${steps[step]}`;
}

/**
 * Return the column that says what runs cost the processor: cores tell it where the clock alone set the
 * pace (Realtime); where a program takes the time it needs (Lockstep, Stepped), seconds per second of the
 * recording do.
 * @param {Api.Column[]} columns
 */
export function cpuColumn(columns) {
  const named = (/** @type {string} */ name) => columns.find((one) => one.name === name);
  const realtime = named('input.pace')?.values?.some((one) => one.value === 'Realtime');
  const { unpaced, paced } = DEFAULTS.cpu;
  return !realtime && named(unpaced) ? unpaced : paced;
}

/** Columns whose values say by themselves what they are. */
export const SUBJECT = DEFAULTS.subject;
const TITLES = new Map(
  Object.entries({
    'input.frameRate': 'frame rate [Hz]',
    'provenance.cpuModel': 'processor',
    'provenance.machine.exclusiveCores': 'exclusive cores',
    'provenance.machine.smt': 'SMT',
    'usage.includesReader': 'reader included',
  }),
);
const PREFIX = /^(parameters|input|resources|dataset\.attributes|label|provenance\.machine|provenance)\./;

/**
 * Return the name of a column for people, with its unit.
 * @param {string} name
 */
export const columnTitle = (name) => TITLES.get(name) ?? name.replace(PREFIX, '');

/**
 * Return a heading's title; a setting is called as its author called it, with its unit.
 * @param {Api.Heading} heading
 */
export const ownTitle = ({ name, title }) =>
  title === name || title.startsWith(`${name} [`) ? columnTitle(name) + title.slice(name.length) : title;

/**
 * Return headings in which settings are called as their author called them, where that is clear.
 * @template {Api.Heading} T
 * @param {T[]} headings
 * @returns {T[]}
 */
export function shortTitles(headings) {
  const short = headings.map(ownTitle);
  return headings.map((one, at) =>
    short.filter((title) => title === short[at]).length > 1 ? one : { ...one, title: short[at] },
  );
}

/**
 * Return the heading of a column; one that the answer doesn't have is called by its name.
 * @template {Api.Heading} T
 * @param {T[]} headings
 * @param {string} name
 * @returns {T | Api.Heading}
 */
export const headingOf = (headings, name) =>
  headings.find((one) => one.name === name) ?? { name, title: name };

/**
 * Return the title at an axis of a column: its name where there is room, with its unit.
 * @param {Api.Heading} heading
 */
export const axisName = (heading) => heading.label ?? heading.title;

/**
 * Return a value of a column with its name, unless it says by itself what it is: "mono", "frame rate 7.5 Hz",
 * "reader not included".
 * @param {string|Api.Heading} column its name, or its heading, which knows units that manifests declare
 * @param {Api.Value|undefined} value
 */
export function namedValue(column, value) {
  const heading = typeof column === 'string' ? { name: column, title: column } : column;
  if (heading.name === 'usage.includesReader')
    return value === true ? 'reader included' : value === false ? 'reader not included' : 'reader unknown';
  return namedText(heading, value === null || value === undefined ? null : cell(value, heading));
}

/**
 * Return the text of a column's value with its name and unit, as `namedValue` does.
 * @param {Api.Heading} heading
 * @param {string|null} text null: there is no value
 */
export function namedText(heading, text) {
  if (SUBJECT.includes(heading.name)) return text ?? '–';
  const [, title, unit] = /^(.*?)(?: \[([^[\]]*)\])?$/s.exec(ownTitle(heading)) ?? [];
  return `${title} ${text ?? '–'}${unit && text !== null ? ` ${unit}` : ''}`;
}

/**
 * Return keys of a group as one text: "orb-slam3, mono, evaluation sim3".
 * @param {Api.Keys|null|undefined} keys
 * @param {Api.Heading[]} [headings] of keys, where the answer has them: they know the units of parameters
 */
export const keysText = (keys, headings = []) =>
  Object.entries(keys ?? {})
    .map(([name, value]) => namedValue(headingOf(headings, name), value))
    .join(', ');

/**
 * Return the keys by which some groups differ, and those that say what a group is about: what all share needs
 * no telling.
 * @param {Api.Keys[]} all keys of each group
 */
export const tellingKeys = (all) =>
  Object.keys(all[0] ?? {}).filter(
    (name) => SUBJECT.includes(name) || new Set(all.map((keys) => String(keys[name]))).size > 1,
  );

/**
 * Return what makes costs of a column's numbers, of which small is good: -1 where large is good, else 1.
 * @param {Api.Heading} heading
 */
export const signOf = (heading) => (heading.better === 'higher' ? -1 : 1);
