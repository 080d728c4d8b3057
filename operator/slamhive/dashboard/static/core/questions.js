// SPDX-License-Identifier: Apache-2.0
/** The questions that SLAM Hive's paper asks, as saved analyses. */

const named = (columns, name) => columns.find((one) => one.name === name);
const varies = (columns, name) => (named(columns, name)?.distinct ?? 0) > 1;
const has = (columns, name, values) => values.every((value) => named(columns, name)?.values?.some((one) => one.value === value));
const first = (columns, pattern, groups) => columns.find((one) => pattern.test(one.name) && groups.includes(one.group) && one.distinct > 1)?.name;

/** Return what can be asked. Those without `settings` say in `needs` which runs they need.
 * @param {object[]} columns headings of /api/v1/columns
 * @returns {Array<{title: string, settings: object|null, needs: string}>} */
export function questions(columns) {
  const ask = (title, needs, settings) => ({ title, needs, settings });
  const when = (holds, settings) => (holds ? settings : null);
  const features = first(columns, /^parameters\..*(n|num|max)_?features?$/i, ['parameters']) ?? 'parameters.nFeatures';
  const onFeatures = (y) => when(varies(columns, features), { kind: 'line', x: features, y, ...(varies(columns, 'dataset') ? { facet: 'dataset' } : {}), where: `${quoted(features)} is not null` });
  const loops = first(columns, /loop/i, ['metrics', 'parameters']);
  const camera = first(columns, /camera(position|side|name)?$/i, ['labels', 'dataset']);
  return [
    ask('Image resolution vs ATE', 'runs at several input.resolution', when(varies(columns, 'input.resolution'), { kind: 'line', x: 'input.resolution', y: 'ate.rmse' })),
    ask('Frame rate vs CPU', 'runs at several input.frameRate', when(varies(columns, 'input.frameRate'), { kind: 'line', x: 'input.frameRate', y: 'usage.cpu.meanCores' })),
    ask('Features vs ATE', 'runs with several nFeatures', onFeatures('ate.rmse')),
    ask('Features vs CPU', 'runs with several nFeatures', onFeatures('usage.cpu.meanCores')),
    ask('Features vs RAM', 'runs with several nFeatures', onFeatures('usage.memory.peakBytes')),
    ask('Loop closures vs ATE', 'a parameter or an own metric of the algorithm that counts loops', loops ? { kind: 'scatter', x: loops, y: 'ate.rmse', colour: 'algorithm' } : null),
    ask('Sensor mode against sensor mode', 'runs in several sensor modes', when(varies(columns, 'sensors'), { kind: 'box', x: 'sensors', y: 'ate.rmse', facet: 'dataset' })),
    ask('Front against back camera', 'a label camera on the runs: front or back', camera ? { kind: 'box', x: camera, y: 'ate.rmse', colour: 'algorithm' } : null),
    ask('LiDAR against RGB-D', 'runs with lidar and with rgbd', when(
      has(columns, 'sensors', ['lidar', 'rgbd']), { kind: 'box', x: 'sensors', y: 'ate.rmse', sensors: ['lidar', 'rgbd'] })),
  ];
}

/** Return a column's name as it stands in a condition. */
export const quoted = (name) => (/^[A-Za-z_][\w.]*$/.test(name) ? name : `\`${name}\``);
