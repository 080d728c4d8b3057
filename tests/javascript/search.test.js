// SPDX-License-Identifier: Apache-2.0
/** Searches drawn: where what was dropped may stand, and that ECharts draws them. */
import assert from 'node:assert/strict';
import test from 'node:test';
import * as echarts from '/vendor/echarts.mjs';
import {
  bestSoFar,
  growingFront,
  settingLines,
  trialText,
} from '../../operator/slamhive/dashboard/static/charts/search.js';
import { dressed } from '../../operator/slamhive/dashboard/static/core/chart.js';
import { HOSTILE } from './helpers.js';

const METRIC = { name: 'ate.rmse', title: 'ATE [m]', label: 'ATE RMSE [m]', kind: 'number', factor: 1 };
const COST = { name: 'cost', title: 'CPU [s/s]', label: 'CPU [s/s]', kind: 'number', factor: 1 };

/** A trial: figures of it, where it stands, and after how many runs its last one ended. */
const trial = (number, state, figures, at, more = {}) => ({
  number,
  state,
  figures,
  at,
  runs: state === 'under way' ? 0 : 2,
  judged: 2,
  failed: figures[0] === null ? 1 : 0,
  dropped: state === 'dropped' ? 'after 1 of 2 runs 3 of 4 were better' : null,
  values: { voxel: 0.1 * (number + 1), [HOSTILE]: number % 2 === 0 },
  ...more,
});

function search(trials, history, more = {}) {
  const metrics = trials[0].figures.length > 1 ? [METRIC, COST] : [METRIC];
  return {
    objectives: metrics.map(({ name }) => ({ metric: name, goal: 'Minimize' })),
    metrics,
    axes: [
      { label: 'voxel', log: true },
      { label: HOSTILE, log: false },
    ],
    titles: ['voxel', HOSTILE],
    contexts: [{}],
    computed: 9,
    trials,
    history,
    ...more,
  };
}

const ONE = search(
  [
    trial(0, 'all runs', [0.4], 2),
    trial(1, 'dropped', [0.9], 3),
    trial(2, 'dropped', [null], 4),
    trial(3, 'best', [0.2], 7),
    trial(4, 'under way', [null], 0),
  ],
  [
    { runs: 2, best: [0] },
    { runs: 7, best: [3] },
  ],
);

function drawn(option) {
  const paper = echarts.init(null, null, { renderer: 'svg', ssr: true, width: 800, height: 400 });
  paper.setOption(dressed(option, false));
  const svg = paper.renderToSVGString();
  paper.dispose();
  return svg;
}

const named = (option, name) => option.series.find((series) => series.name === name);

test('the curve goes on level to the last run', () => {
  assert.deepEqual(named(bestSoFar(ONE), 'best so far').data, [
    [2, 0.4],
    [7, 0.2],
    [9, 0.2],
  ]);
});

test('what failed stands in a field of its own', () => {
  const option = bestSoFar(ONE);
  const [failed, dropped] = option.series.slice(-2);
  assert.deepEqual(
    failed.data.map((point) => point.trial.number),
    [2],
  );
  assert.deepEqual(option.yAxis[1].data, ['failed']);
  assert.deepEqual(dropped.data, []);
  assert.equal(named(option, 'dropped').data.length, 1);
});

test('figures of fewer datasets have no place on the axis of all', () => {
  const option = bestSoFar({ ...ONE, contexts: [{ dataset: 'a' }, { dataset: 'b' }] });
  assert.equal(named(option, 'dropped').data.length, 0);
  assert.deepEqual(option.yAxis[1].data, ['dropped', 'failed']);
  assert.deepEqual(
    option.series.slice(-2).map((series) => series.data.map((point) => point.value)),
    [[[4, 1]], [[3, 0]]],
  );
});

test('before a setting has all its runs there is no curve, and before a run ended nothing', () => {
  assert.deepEqual(named(bestSoFar(search([trial(0, 'dropped', [0.4], 2)], [])), 'best so far').data, []);
  assert.equal(bestSoFar(search([trial(0, 'under way', [null], 0)], [])), null);
  assert.equal(growingFront(search([trial(0, 'dropped', [1, 1], 2)], [])), null);
});

test('fronts are drawn as they grew, the last one strongest', () => {
  const figures = [0, 1, 2].map((number) => [0.1 * (3 - number), 1 + number]);
  const trials = figures.map((both, number) => trial(number, 'best', both, number + 1));
  const option = growingFront(
    search(trials, [
      { runs: 1, best: [0] },
      { runs: 2, best: [1, 0] },
      { runs: 3, best: [2, 1, 0] },
    ]),
  );
  const lines = option.series.filter((series) => series.type === 'line');
  assert.deepEqual(
    lines.map((line) => line.data.length),
    [1, 2, 3],
  );
  const across = lines[2].data.map((point) => point.value[0]);
  assert.deepEqual(across, [...across].sort());
  assert.ok(lines[2].lineStyle.width > lines[0].lineStyle.width);
});

test('settings with fewer runs than all are faint and have no figure', () => {
  const [{ data }] = settingLines(ONE, 0).series;
  const of = (number) => data.find((line) => line.trial.number === number);
  assert.equal(of(1).value[2], '-');
  assert.equal(of(3).value[2], 0.2);
  assert.ok(of(1).lineStyle.opacity < of(0).lineStyle.opacity);
  assert.equal(of(4), undefined);
});

test('a setting says why it was dropped', () => {
  assert.match(trialText(ONE, ONE.trials[1]), /after 1 of 2 runs 3 of 4 were better/);
  assert.match(trialText(ONE, ONE.trials[2]), /2 of 2 runs failed/);
});

test('all are drawn, whatever the texts are', () => {
  for (const option of [bestSoFar(ONE), settingLines(ONE, 0), settingLines(ONE, 0, true)])
    assert.ok(drawn(option).startsWith('<svg'));
});
