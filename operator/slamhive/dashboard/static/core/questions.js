// SPDX-License-Identifier: Apache-2.0
/** The questions that SLAM Hive's paper asks, as saved analyses. */
import DEFAULTS from './defaults.json' with { type: 'json' };
import { cpuColumn } from './format.js';

const FEATURES = new RegExp(DEFAULTS.features, 'i');

/**
 * @param {Api.Column[]} columns
 * @param {string} name
 */
const named = (columns, name) => columns.find((one) => one.name === name);
/**
 * @param {Api.Column[]} columns
 * @param {string} name
 */
const varies = (columns, name) => (named(columns, name)?.distinct ?? 0) > 1;
/**
 * @param {Api.Column[]} columns
 * @param {string} name
 * @param {Api.Value[]} values
 */
const has = (columns, name, values) =>
  values.every((value) => named(columns, name)?.values?.some((one) => one.value === value));
/**
 * @param {Api.Column[]} columns
 * @param {RegExp} pattern
 * @param {string[]} groups
 */
const first = (columns, pattern, groups) =>
  columns.find((one) => pattern.test(one.name) && groups.includes(one.group) && one.distinct > 1)?.name;

/**
 * Return the setting with most values, of several the first; undefined where none varies.
 * @param {Api.Column[]} columns
 * @returns {Api.Column|undefined}
 */
export const mostVaried = (columns) =>
  columns
    .filter(({ group, distinct }) => (group === 'parameters' || group === 'input') && distinct > 1)
    .sort((one, other) => other.distinct - one.distinct)[0];

/**
 * Return the value of a property that all runs share and a question needs to vary, as "loops 0.5"; ''
 * where it isn't known of any.
 * @param {Api.Column[]} columns
 * @param {RegExp} pattern
 * @param {string[]} groups
 */
const shared = (columns, pattern, groups) => {
  const one = columns.find((found) => pattern.test(found.name) && groups.includes(found.group));
  const [only] = one?.distinct === 1 ? (one.values ?? []) : [];
  return one && only ? `${one.name.split('.').at(-1)} ${only.value}` : '';
};

/**
 * Return the presets that draw the paper's own tables; [] where its runs are not here.
 * @param {Api.Column[]} columns
 */
export const published = (columns) =>
  named(columns, 'label.source')?.values?.some((one) => one.value === 'slam-hive')
    ? DEFAULTS.papersTables
    : [];

/**
 * Return the column that tells a front from a back camera.
 * @param {Api.Column[]} columns
 */
const cameras = (columns) =>
  columns.find(
    (one) =>
      ['labels', 'dataset', 'input'].includes(one.group) &&
      one.distinct > 1 &&
      [/front/i, /back|rear/i].every((side) => one.values?.some((found) => side.test(String(found.value)))),
  )?.name;

/**
 * Return the questions. Those without `settings` say in `needs` which runs they need.
 * @param {Api.Column[]} columns of /api/v1/columns
 * @returns {Question[]}
 */
export function questions(columns) {
  /**
   * @param {string} title
   * @param {string} needs
   * @param {Question['settings']} settings
   */
  const ask = (title, needs, settings) => ({ title, page: '/explore', needs, settings });
  /**
   * @param {boolean} holds
   * @param {Record<string, string|string[]>} settings
   */
  const when = (holds, settings) => (holds ? settings : null);
  /** @type {{facet?: string}} */
  const apart = varies(columns, 'dataset') ? { facet: 'dataset' } : {};
  const features = first(columns, FEATURES, ['parameters']) ?? 'parameters.nFeatures';
  const loops =
    first(columns, /loop/i, ['dataset']) ??
    first(columns, /loop/i, ['metrics']) ??
    first(columns, /loop/i, ['parameters']);
  const equal = shared(columns, /loop/i, ['dataset', 'metrics', 'parameters']);
  const camera = cameras(columns);
  // Of who reads the recording by itself nobody knows when it knew what, unless it says so.
  const isPlayed = ['Realtime', 'Stepped'].some((pace) => has(columns, 'input.pace', [pace]));
  const byPace = {
    ...(varies(columns, 'input.pace') ? { facet: 'input.pace' } : apart),
    where: DEFAULTS.played[isPlayed ? 0 : 1] ?? '',
  };
  return [
    ask(
      'Image resolution vs ATE',
      'runs at several input.resolution',
      when(varies(columns, 'input.resolution'), {
        kind: 'line',
        x: 'input.resolution',
        y: 'ate.rmse',
        ...apart,
      }),
    ),
    ask(
      'Frame rate vs CPU',
      'runs at several input.frameRate',
      when(varies(columns, 'input.frameRate'), {
        kind: 'line',
        x: 'input.frameRate',
        y: cpuColumn(columns),
        ...apart,
      }),
    ),
    ask(
      'Features vs ATE, CPU and RAM',
      'runs with several nFeatures',
      when(varies(columns, features), {
        kind: 'line',
        x: features,
        y: `ate.rmse,${cpuColumn(columns)},usage.memory.peakBytes`,
        ...apart,
        where: `${quoted(features)} is not null`,
      }),
    ),
    ask(
      'Loops vs ATE',
      'datasets that differ in an attribute loops, or runs in a metric or parameter of that name' +
        (equal ? `; the runs here have ${equal} alone` : ''),
      loops ? { kind: 'scatter', x: loops, y: 'ate.rmse', colour: 'algorithm' } : null,
    ),
    ask(
      'Sensor mode against sensor mode',
      'runs in several sensor modes',
      when(varies(columns, 'sensors'), { kind: 'box', x: 'sensors', y: 'ate.rmse', ...apart }),
    ),
    ask(
      'Front against back camera',
      'runs with input.remap.camera, a label or an attribute that says front and back',
      camera ? { kind: 'box', x: camera, y: 'ate.rmse', colour: 'algorithm', ...apart } : null,
    ),
    ask(
      'LiDAR against RGB-D',
      'runs with lidar and with rgbd',
      when(has(columns, 'sensors', ['lidar', 'rgbd']), {
        kind: 'box',
        x: 'sensors',
        y: 'ate.rmse',
        sensors: ['lidar', 'rgbd'],
        ...apart,
      }),
    ),
    ask(
      'Causal against final: what a robot knew at the time',
      'runs of nodes in the paces Realtime or Stepped, which a player played to',
      when((named(columns, 'beside.online.ate.rmse')?.count ?? 0) > 0, {
        kind: 'scatter',
        x: 'ate.rmse',
        y: 'beside.online.ate.rmse',
        colour: 'algorithm',
        ...byPace,
      }),
    ),
    ask(
      'Latency vs causal ATE',
      'runs of nodes in the paces Realtime or Stepped, which a player played to',
      when((named(columns, 'metrics.latencySeconds.p95')?.count ?? 0) > 0, {
        kind: 'scatter',
        x: 'metrics.latencySeconds.p95',
        y: 'beside.online.ate.rmse',
        colour: 'algorithm',
        ...byPace,
      }),
    ),
    ...published(columns),
  ];
}

/**
 * Return a column's name as it stands in a condition.
 * @param {string} name
 */
export const quoted = (name) => (/^[A-Za-z_][\w.]*$/.test(name) ? name : `\`${name}\``);
