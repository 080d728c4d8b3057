// SPDX-License-Identifier: Apache-2.0
/** Values as people read them. */
import assert from 'node:assert/strict';
import test from 'node:test';
import {
  bytes,
  cell,
  clip,
  columnTitle,
  shorten,
  shortTitles,
  headingOf,
  keysText,
  namedValue,
  number,
  plural,
  statusClass,
  tellingKeys,
  time,
} from '../../operator/slamhive/dashboard/static/core/format.js';
import { HOSTILE } from './helpers.js';

process.env.TZ = 'UTC';

const NUMBERS = [
  [null, '–'],
  [undefined, '–'],
  [Number.NaN, '–'],
  [0, '0'],
  [-0, '0'],
  [0.12345678, '0.1235'],
  [-0.12345678, '-0.1235'],
  [1, '1'],
  [9999, '9999'],
  [10000, '10,000'],
  [-1234567, '-1,234,567'],
  [12345.678, '12346'],
  [1234.5678, '1235'],
  [0.0001, '0.0001'],
  [0.00009999, '9.999e-5'],
  [1e7, '1.000e7'],
  [1.5e300, '1.500e300'],
  [5e-324, '4.941e-324'],
  [Number.POSITIVE_INFINITY, 'Infinity'],
];
for (const [value, expected] of NUMBERS)
  test(`the number ${value} is read ${expected}`, () => assert.equal(number(value), expected));

test('numbers have as many digits as asked for', () => {
  assert.deepEqual(
    [number(Math.PI, 2), number(Math.PI, 6), number(1 / 3e9, 2)],
    ['3.1', '3.14159', '3.3e-10'],
  );
});

const SIZES = [
  [null, '–'],
  [0, '0 B'],
  [1023, '1023 B'],
  [1024, '1 KiB'],
  [1536, '1.5 KiB'],
  [2 ** 20 * 268, '268 MiB'],
  [2 ** 40 * 3, '3 TiB'],
  [2 ** 50, '1024 TiB'],
];
for (const [value, expected] of SIZES)
  test(`${value} bytes are read ${expected}`, () => assert.equal(bytes(value), expected));

const TIMES = [
  [null, '–'],
  [0, '1970-01-01 00:00:00'],
  [1767225600.5, '2026-01-01 00:00:00'],
  ['2026-01-01T12:30:00Z', '2026-01-01 12:30:00'],
  ['2026-01-01T12:30:00+02:00', '2026-01-01 10:30:00'],
  ['no time at all', 'no time at all'],
];
for (const [value, expected] of TIMES)
  test(`the time ${value} is read ${expected}`, () => assert.equal(time(value), expected));

const CELLS = [
  [[null], '–'],
  [[true], 'yes'],
  [[false], 'no'],
  [[''], ''],
  [[2 ** 28, { factor: 2 ** -20 }], '256'],
  [[0, { kind: 'time' }], '1970-01-01 00:00:00'],
  [[{ a: [1, null] }], '{"a":[1,null]}'],
  [['<b>'], '<b>'],
];
for (const [given, expected] of CELLS)
  test(`a cell of ${JSON.stringify(given)} shows ${expected}`, () => assert.equal(cell(...given), expected));

test('texts are cut at their end, to a length', () => {
  assert.equal(clip('abcdef', 6), 'abcdef');
  assert.equal(clip('abcdefg', 6), 'abcde…');
  assert.equal(clip(null), 'null');
  for (const text of HOSTILE) assert.ok(clip(text, 48).length <= 48);
});

test('of a long name the part that comes last is read', () => {
  assert.equal(shorten(`${'a'.repeat(63)}, street-05`, 24), 'aaaaaa…aaaaaa, street-05');
  assert.equal(shorten('orb, hall', 24), 'orb, hall');
  assert.ok(shorten('x, '.repeat(40), 12).length <= 12);
});

test('a text is cut between two characters, not within one', () => {
  for (const length of [3, 4, 5]) assert.ok(clip('a😀😀😀', length).isWellFormed(), String(length));
});

test('statuses have a colour, unknown ones that of failures', () => {
  assert.deepEqual(['Tracked', 'Partial', 'Running', 'OutOfMemory'].map(statusClass), [
    'good',
    'fair',
    'live',
    'bad',
  ]);
  for (const text of HOSTILE) assert.equal(statusClass(text), 'bad');
});

test('columns lose the prefix that people do not say', () => {
  assert.equal(columnTitle('parameters.nFeatures'), 'nFeatures');
  assert.equal(columnTitle('dataset.attributes.loops'), 'loops');
  assert.equal(columnTitle('input.frameRate'), 'frame rate [Hz]');
  assert.equal(columnTitle('usage.cpu.meanCores'), 'usage.cpu.meanCores');
  for (const text of HOSTILE) assert.equal(columnTitle(`label.${text}`), text);
  for (const text of HOSTILE) assert.equal(columnTitle(text), text);
});

const NAMED = [
  [['algorithm', 'orb'], 'orb'],
  [['input.frameRate', 7.5], 'frame rate 7.5 Hz'],
  [['input.frameRate', null], 'frame rate –'],
  [['usage.includesReader', true], 'reader included'],
  [['usage.includesReader', null], 'reader unknown'],
  [['parameters.gain [dB] x', 3], 'gain [dB] x 3'],
  [['parameters.a [m] [s]', 3], 'a [m] 3 s'],
  [['parameters.a [', 3], 'a [ 3'],
];
for (const [given, expected] of NAMED)
  test(`${given.join(' = ')} is said ${expected}`, () => assert.equal(namedValue(...given), expected));

const RANGE = { name: 'parameters.maxRange', title: 'parameters.maxRange [m]' };
test('a heading knows the unit that a manifest declares', () => {
  assert.equal(namedValue(RANGE, 30), 'maxRange 30 m');
  assert.equal(namedValue(RANGE, null), 'maxRange –');
  const keys = { algorithm: 'icp', 'parameters.maxRange': 30 };
  assert.equal(keysText(keys, [RANGE]), 'icp, maxRange 30 m');
});

test('keys of a group are one text, of none an empty one', () => {
  assert.equal(keysText({ algorithm: 'a', 'parameters.n': 500, evaluation: null }), 'a, n 500, evaluation –');
  assert.equal(keysText(null), '');
  assert.equal(keysText({}), '');
});

test('keys that all share are told only where they are the subject', () => {
  const all = [
    { dataset: 'hall', evaluation: 'sim3', 'parameters.n': 1 },
    { dataset: 'hall', evaluation: 'sim3', 'parameters.n': 2 },
  ];
  assert.deepEqual(tellingKeys(all), ['dataset', 'parameters.n']);
  assert.deepEqual(tellingKeys([]), []);
});

test('a column that an answer does not have is called by its name', () => {
  assert.equal(headingOf([{ name: 'a', title: 'A' }], 'a').title, 'A');
  assert.equal(headingOf([], 'a').title, 'a');
});

test('settings are called as their author called them where that is clear', () => {
  const titled = (...names) =>
    shortTitles(names.map((name) => ({ name, title: name }))).map(({ title }) => title);
  assert.deepEqual(titled('run', 'parameters.k', 'input.rate'), ['run', 'k', 'rate']);
  assert.deepEqual(titled('parameters.k', 'input.k', 'k'), ['parameters.k', 'input.k', 'k']);
  assert.deepEqual(shortTitles([{ name: 'parameters.k', title: 'K [m]' }])[0].title, 'K [m]');
  const [k, rate] = shortTitles([
    { name: 'parameters.k', title: 'parameters.k [m]' },
    { name: 'input.frameRate', title: 'frame rate [Hz]' },
  ]);
  assert.deepEqual([k.title, rate.title], ['k [m]', 'frame rate [Hz]']);
});

test('a count has its noun in the singular where it is one', () => {
  assert.deepEqual(
    [0, 1, 2, 12000].map((count) => plural(count, 'run')),
    ['0 runs', '1 run', '2 runs', '12,000 runs'],
  );
});
