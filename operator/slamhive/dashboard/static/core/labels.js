// SPDX-License-Identifier: Apache-2.0
/** What runs are called beside each other: by the settings in which they differ. */
import { cell, clip, keysText, namedValue, SUBJECT } from './format.js';

const PARTS = ['parameters', 'input', 'resources'];

/**
 * Return a setting of a run by its column's name.
 * @param {Api.Run} run
 * @param {string} name
 * @returns {Api.Value}
 */
export function settingOf(run, name) {
  const dot = name.indexOf('.');
  return dot < 0
    ? (run.configuration?.[name] ?? null)
    : (run.configuration?.[name.slice(0, dot)]?.[name.slice(dot + 1)] ?? null);
}

/**
 * Return the names of the settings that runs have.
 * @param {Api.Run[]} runs
 */
const settingNames = (runs) => [
  ...new Set(
    runs.flatMap((run) =>
      PARTS.flatMap((part) => Object.keys(run.configuration?.[part] ?? {}).map((name) => `${part}.${name}`)),
    ),
  ),
];

/**
 * Tell whether a run has a setting, be it that it is null.
 * @param {Api.Run} run
 * @param {string} name
 */
const has = (run, name) => {
  const [part, ...rest] = name.split('.');
  return rest.join('.') in (run.configuration?.[part] ?? {});
};

/**
 * @param {Api.Run[]} runs
 * @param {string} name
 */
const valuesOf = (runs, name) => new Set(runs.map((run) => JSON.stringify(settingOf(run, name))));

/**
 * Return the names of the settings in which some runs differ, of those that have them.
 * @param {Api.Run[]} runs
 */
export const differing = (runs) =>
  settingNames(runs).filter(
    (name) =>
      valuesOf(
        runs.filter((run) => has(run, name)),
        name,
      ).size > 1,
  );

/**
 * Return the settings that all of several runs share, as one text, and those that only some have, with who.
 * @param {Api.Run[]} runs
 * @param {string[]} labels of the runs
 * @returns {{common: string, some: Array<{who: string, what: string}>}}
 */
export function sharedBy(runs, labels) {
  const names = settingNames(runs);
  const common = [...SUBJECT, ...names.filter((name) => runs.every((run) => has(run, name)))].filter(
    (name) =>
      !['null', '{}'].includes(JSON.stringify(settingOf(runs[0], name))) && valuesOf(runs, name).size === 1,
  );
  /** @type {Map<string, string[]>} */
  const some = new Map();
  for (const name of names) {
    const having = runs.filter((run) => has(run, name));
    if (having.length === runs.length || valuesOf(having, name).size > 1) continue;
    const algorithms = new Set(having.map((run) => settingOf(run, 'algorithm')));
    const whole = runs.every((run) => algorithms.has(settingOf(run, 'algorithm')) === having.includes(run));
    const who = (
      whole ? [...algorithms].map((one) => cell(one)) : having.map((run) => labels[runs.indexOf(run)])
    ).join(', ');
    some.set(who, [...(some.get(who) ?? []), namedValue(name, settingOf(having[0], name))]);
  }
  return {
    common: keysText(Object.fromEntries(common.map((name) => [name, settingOf(runs[0], name)]))),
    some: [...some].map(([who, what]) => ({ who, what: what.join(', ') })),
  };
}

/**
 * Tell whether runs with one value of a setting have one value of another.
 * @param {Api.Run[]} runs
 * @param {string} name
 * @param {string} from
 */
const follows = (runs, name, from) =>
  [...valuesOf(runs, from)].every(
    (value) =>
      valuesOf(
        runs.filter((run) => JSON.stringify(settingOf(run, from)) === value),
        name,
      ).size === 1,
  );

/**
 * Return the label of each run: what tells it apart from the others, and its number where nothing does.
 * Settings that only runs of other algorithms have say nothing.
 * @param {Api.Run[]} runs
 * @returns {string[]}
 */
export function labelsOf(runs) {
  // A sensor mode that follows from the algorithm says nothing more.
  const subjects = SUBJECT.filter((name) => valuesOf(runs, name).size > 1).filter(
    (name) => name !== 'sensors' || !follows(runs, name, 'algorithm'),
  );
  /** @type {Map<string, Api.Run[]>} */
  const algorithms = new Map();
  for (const run of runs) {
    const name = cell(settingOf(run, 'algorithm'));
    algorithms.set(name, [...(algorithms.get(name) ?? []), run]);
  }
  const settings = new Set([...algorithms.values()].flatMap(differing));
  const told = [...subjects, ...settings];
  /** @param {Api.Run} run */
  const text = (run) =>
    keysText(
      Object.fromEntries(
        told
          .map((name) => [name, settingOf(run, name)])
          .filter(([name, value]) => value !== null || subjects.includes(String(name))),
      ),
    );
  const first = runs.map(text);
  const second = apart(first, (at) => {
    const repetition = settingOf(runs[at], 'repetition');
    return repetition === null ? '' : `repetition ${cell(repetition)}`;
  });
  return apart(second, (at) => `run ${cell(runs[at].run ?? runs[at].uid)}`).map((label) => clip(label, 90));
}

/**
 * Add something to those texts that others share.
 * @param {string[]} texts
 * @param {(at: number) => string} more
 */
const apart = (texts, more) =>
  texts.map((one, at) =>
    one === '' || texts.indexOf(one) !== texts.lastIndexOf(one)
      ? [one, more(at)].filter(Boolean).join(', ')
      : one,
  );
