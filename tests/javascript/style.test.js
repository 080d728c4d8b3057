// SPDX-License-Identifier: Apache-2.0
/** What neither formatter nor linter sees. */
import assert from 'node:assert/strict';
import { globSync, readFileSync } from 'node:fs';
import test from 'node:test';
import { fileURLToPath } from 'node:url';

const ROOT = fileURLToPath(new URL('../..', import.meta.url));
const OURS = [
  'operator/slamhive/dashboard/static/*.js',
  'operator/slamhive/dashboard/static/{core,charts,pages}/*.js',
  'evaluator/slamhive_eval/assets/*.js',
  'tests/javascript/*.js',
  'tests/javascript/types/*',
];

test('no line is longer than 110 characters', () => {
  const files = globSync(OURS, { cwd: ROOT });
  assert.ok(files.length > 40);
  const long = files.flatMap((file) =>
    readFileSync(`${ROOT}/${file}`, 'utf8')
      .split('\n')
      .flatMap((line, at) => (line.length > 110 ? [`${file}:${at + 1}`] : [])),
  );
  assert.deepEqual(long, []);
});
