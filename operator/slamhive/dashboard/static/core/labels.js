// SPDX-License-Identifier: Apache-2.0
/** What runs are called beside each other: by the settings in which they differ. */
import { cell, clip, keysText, SUBJECT } from './format.js';

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
 * Return the names of the settings in which some runs differ.
 * @param {Api.Run[]} runs
 */
export const differing = (runs) =>
  settingNames(runs).filter(
    (name) => new Set(runs.map((run) => JSON.stringify(settingOf(run, name)))).size > 1,
  );

/**
 * Return the label of each run: what tells it apart from the others, and its number where nothing does.
 * Settings that only runs of other algorithms have say nothing.
 * @param {Api.Run[]} runs
 * @returns {string[]}
 */
export function labelsOf(runs) {
  const subjects = SUBJECT.filter((name) => new Set(runs.map((run) => cell(settingOf(run, name)))).size > 1);
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
