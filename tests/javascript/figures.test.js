// SPDX-License-Identifier: Apache-2.0
/** Small multiples, cumulative shares, timelines, contours: what is computed, and that it draws. */
import assert from 'node:assert/strict';
import test from 'node:test';
import * as echarts from '/vendor/echarts.mjs';
import {
  outsideText,
  robustLimits,
  roundEnds,
} from '../../operator/slamhive/dashboard/static/charts/limits.js';
import {
  contourChart,
  fields,
  gridOf,
  levelsOf,
  pieces,
} from '../../operator/slamhive/dashboard/static/charts/contour.js';
import { cropped } from '../../operator/slamhive/dashboard/static/charts/cropping.js';
import { curveCharts, ecdfChart, steps } from '../../operator/slamhive/dashboard/static/charts/ecdf.js';
import { arranged, multiples, tooMany } from '../../operator/slamhive/dashboard/static/charts/multiples.js';
import { fitted } from '../../operator/slamhive/dashboard/static/core/legend.js';
import { differing, labelsOf, sharedBy } from '../../operator/slamhive/dashboard/static/core/labels.js';
import {
  binCells,
  fullShare,
  moved,
  timelineChart,
  usedText,
} from '../../operator/slamhive/dashboard/static/charts/timeline.js';
import { sharedLimits, sliceChart } from '../../operator/slamhive/dashboard/static/charts/slices.js';
import { momentsOf } from '../../operator/slamhive/dashboard/static/charts/moments.js';
import { foremost } from '../../operator/slamhive/dashboard/static/core/narrow.js';
import { dressed } from '../../operator/slamhive/dashboard/static/core/chart.js';
import { HOSTILE } from './helpers.js';

/** Draw an option as the page does; return the SVG. */
function drawn({ option, height = 400 }, width = 800) {
  const paper = echarts.init(null, null, { renderer: 'svg', ssr: true, width, height });
  paper.setOption(dressed(typeof option === 'function' ? option({ width, height }) : option, false));
  const svg = paper.renderToSVGString();
  paper.dispose();
  return svg;
}

const forty = Array.from({ length: 40 }, (_, at) => 0.008 + (0.008 * at) / 39);

// The cases of tests/analysis/test_limits.py: pages and figures have the same limits.
test('two diverged runs stay outside of the limits, and are counted', () => {
  assert.deepEqual(robustLimits([...forty, 3.9, 4.2, null]), { low: 0.008, high: 0.016, below: 0, above: 2 });
  assert.deepEqual(robustLimits([...forty, -4.2]), { low: 0.008, high: 0.016, below: 1, above: 0 });
  assert.deepEqual(robustLimits([...Array(20).fill(1), ...Array(6).fill(1.1), ...Array(6).fill(1.2), 90]), {
    low: 1,
    high: 1.2,
    below: 0,
    above: 1,
  });
});

for (const [what, values] of Object.entries({
  'a few': [1, 1.1, 1.2, 50],
  'a second group': [...forty, ...Array.from({ length: 15 }, (_, at) => 4 + at / 14)],
  'one not far': [...forty, 0.02],
  'equal ones': Array(20).fill(1),
  'one beside equal ones': [...Array(20).fill(1), 9],
}))
  test(`limits hold all of ${what}`, () => {
    assert.deepEqual(robustLimits(values), {
      low: Math.min(...values),
      high: Math.max(...values),
      below: 0,
      above: 0,
    });
  });

test('limits of logarithms leave out what has none', () => {
  assert.deepEqual(robustLimits([0, 2, -1], { log: true }), { low: 2, high: 2, below: 0, above: 0 });
  assert.equal(robustLimits([NaN, null, Infinity]), null);
});

test('axes end at round numbers around their limits', () => {
  assert.deepEqual(roundEnds({ low: 0.0182, high: 0.0321 }), { min: 0.015, max: 0.035, interval: 0.005 });
  assert.deepEqual(roundEnds({ low: 0.003, high: 0.9 }, { log: true }), { min: 0.001, max: 1 });
  assert.deepEqual(roundEnds(null), {});
  const { min, max } = roundEnds({ low: 5, high: 5 });
  assert.ok(min < 5 && max > 5);
});

test('what lies outside is said', () => {
  assert.equal(outsideText({ low: 0, high: 1, below: 0, above: 0 }, 'run'), '');
  assert.match(outsideText({ low: 0, high: 1, below: 1, above: 1 }, 'run'), /^2 runs lie outside/);
});

const figure = (median) => ({ n: 2, median, mean: median, min: median, max: median, std: 0 });
const group = (keys, median) => ({
  keys,
  runs: 3,
  n: median === null ? 0 : 2,
  copies: 0,
  reader: false,
  failed: median === null ? 3 : 1,
  failures: {},
  deterministic: false,
  coverage: null,
  figures: { 'ate.rmse': figure(median) },
});
const grid = (medians) => ({
  keys: ['parameters.p', 'input.resolution', 'sensors'].map((name) => ({
    name,
    title: name,
    kind: 'number',
  })),
  metrics: [{ name: 'ate.rmse', title: 'ATE [m]', label: 'ATE RMSE [m]', factor: 1 }],
  groups: medians.map((median, at) =>
    group(
      {
        'parameters.p': 100 * (1 + (at % 4)),
        'input.resolution': at % 8 < 4 ? 1 : 0.5,
        sensors: at < 8 ? 'mono' : HOSTILE,
      },
      median,
    ),
  ),
  notes: [],
});
const SET = {
  x: 'parameters.p',
  y: 'ate.rmse',
  down: 'sensors',
  across: 'input.resolution',
  figure: 'median',
  xlog: false,
  ylog: false,
};

test('small multiples have a chart for each pair of values, with one pair of axes', () => {
  const data = grid([...Array(15).keys()].map((at) => 0.01 + at / 1000).concat([4]));
  const found = arranged(data, SET);
  assert.deepEqual([found.down.length, found.across], [2, [0.5, 1]]);
  assert.equal(found.cells.length, 4);
  assert.ok(found.cells.every((one) => one.lines[0].points.length === 4));
  assert.equal(found.limits.above, 1);
  assert.ok(found.ends.max < 0.1);
  const all = multiples(data, SET, found);
  assert.match(all.notes[0], /^1 median lies outside/);
  const option = all.option({ width: 800, height: all.height });
  assert.equal(new Set(option.yAxis.map((axis) => `${axis.min} ${axis.max}`)).size, 1);
  assert.equal(new Set(option.xAxis.map((axis) => `${axis.min} ${axis.max}`)).size, 1);
  const marks = option.series.filter((one) => one.type === 'scatter').flatMap((one) => one.data);
  assert.deepEqual(
    marks.map((one) => [one.value, one.symbol]),
    [[[400, found.ends.max], 'triangle']],
  );
  const svg = drawn(all);
  assert.match(svg, /ATE RMSE \[m\], median/);
  assert.match(svg, /resolution 0\.5/);
});

test('settings whose runs all failed are marked, not passed over', () => {
  const data = grid(Array(16).fill(0.02).fill(null, 3, 4));
  const found = arranged(data, SET);
  const all = multiples(data, SET, found);
  const marks = all
    .option({ width: 800, height: 400 })
    .series.filter((one) => one.type === 'scatter')
    .flatMap((one) => one.data);
  assert.equal(marks.length, 1);
  assert.match(all.notes.join(), /none of them counts/);
});

test('too many charts are refused in a sentence', () => {
  const data = grid([0.1]);
  data.groups = Array.from({ length: 200 }, (_, at) =>
    group({ 'parameters.p': 1, 'input.resolution': at, sensors: 'mono' }, 0.1),
  );
  assert.match(
    tooMany(arranged(data, SET), SET),
    /^input\.resolution has 200 values, and there are at most 12 columns/,
  );
});

const curve = (keys, x, total) => ({
  keys,
  runs: total,
  total,
  n: x.length,
  failures: {},
  leftOut: {},
  median: x[0] ?? null,
  x,
  share: x.map((_, at) => (at + 1) / total),
});
const ECDF = {
  metric: { name: 'ate.rmse', title: 'ATE [cm]', factor: 100 },
  keys: ['dataset', 'algorithm'].map((name) => ({ name, title: name })),
  curves: [
    curve({ dataset: 'hall', algorithm: 'a' }, [0.01, 0.02], 4),
    curve({ dataset: 'hall', algorithm: HOSTILE[0] }, [0.03, 0.04], 2),
    curve({ dataset: 'yard', algorithm: HOSTILE[0] }, [], 3),
  ],
  notes: [],
};

test('cumulative shares have a chart a dataset, and a name looks the same in all', () => {
  const { charts, limits } = curveCharts(ECDF, { facet: '', xlog: false });
  assert.deepEqual(
    charts.map(({ name, curves }) => [name, curves.map((one) => one.place)]),
    [
      ['hall', [0, 1]],
      ['yard', [1]],
    ],
  );
  assert.deepEqual([limits.low, limits.high], [1, 4]);
  for (const one of charts) assert.ok(drawn({ option: ecdfChart(ECDF.metric, one.curves, limits, false) }));
});

test('a curve ends below 1 by the share of the runs that failed', () => {
  const ended = steps({ x: [1, 2], share: [0.25, 0.5] }, 0, 10);
  assert.deepEqual(ended, [
    [0, 0],
    [1, 0.25],
    [2, 0.5],
    [10, 0.5],
  ]);
  assert.deepEqual(steps({ x: [], share: [] }, 0, 10), [
    [0, 0],
    [10, 0],
  ]);
  // What lies beyond the axes is not drawn at their ends.
  assert.deepEqual(steps({ x: [1, 2, 30], share: [0.2, 0.4, 0.6] }, 1.5, 10), [
    [1.5, 0.2],
    [2, 0.4],
    [10, 0.4],
  ]);
});

test('where large is good a curve comes from the right, and its end is where failed runs are', () => {
  assert.deepEqual(steps({ x: [0.9, 0.5], share: [0.25, 0.5] }, 1, 0), [
    [1, 0],
    [0.9, 0.25],
    [0.5, 0.5],
    [0, 0.5],
  ]);
  const accuracy = { ...ECDF.metric, better: 'higher' };
  const { series, tooltip, xAxis } = ecdfChart(
    accuracy,
    [{ ...CURVE, x: [4, 1] }],
    { low: 0, high: 6 },
    false,
  );
  assert.deepEqual(series[0].data, [
    [xAxis.max, 0],
    [4, 0.25],
    [1, 0.5],
    [0, 0.5],
  ]);
  assert.match(tooltip.formatter([{ axisValue: 2 }]), /≥ 2\n.*25 %/);
});

const CURVE = { name: 'a', place: 0, total: 4, share: [0.25, 0.5] };

const made = (uid, algorithm, parameters, more = {}) => ({
  uid,
  run: uid,
  configuration: { algorithm, sensors: 'mono', dataset: 'hall', parameters, repetition: 0, ...more },
});

test('runs are called by the settings in which they differ', () => {
  assert.deepEqual(labelsOf([made('1', 'orb', { n: 500, k: 8 }), made('2', 'orb', { n: 1000, k: 8 })]), [
    'n 500',
    'n 1000',
  ]);
  // What only another algorithm has tells nothing of this one.
  assert.deepEqual(labelsOf([made('1', 'orb', { n: 500 }), made('2', 'icp', { voxel: 0.5 })]), [
    'orb',
    'icp',
  ]);
});

test('settings that runs have differ, those of all are said once, those of some with their names', () => {
  const runs = [
    made('1', 'orb', { n: 500, k: 8, loops: true }),
    made('2', 'orb', { n: 1000, k: 8, loops: true }),
    made('3', 'icp', { k: 8, voxel: null }),
  ];
  assert.deepEqual(differing(runs), ['parameters.n']);
  assert.deepEqual(sharedBy(runs, labelsOf(runs)), {
    common: 'mono, hall, k 8',
    some: [
      { who: 'orb', what: 'loops yes' },
      { who: 'icp', what: 'voxel –' },
    ],
  });
});

test('a sensor mode that follows from the algorithm is in no label', () => {
  const runs = [made('1', 'orb', {}), made('2', 'icp', {}, { sensors: 'lidar' })];
  assert.deepEqual(labelsOf(runs), ['orb', 'icp']);
  assert.deepEqual(labelsOf([...runs, made('3', 'orb', {}, { sensors: 'stereo' })]), [
    'orb, mono',
    'icp, lidar',
    'orb, stereo',
  ]);
});

test('a legend has all names, of 63 letters too, and the drawing is higher by its rows', () => {
  const series = ['a', 'b', 'c'].map((letter) => ({ name: letter.repeat(63) }));
  const option = { legend: {}, grid: { top: 40 }, series };
  const desk = fitted(option, 1200);
  assert.deepEqual([desk.more, desk.option.grid.top, desk.option.legend.type], [22, 62, 'plain']);
  const phone = fitted(option, 340);
  assert.equal(phone.more, 5 * 22); // each name has two rows
  assert.equal(phone.option.legend.textStyle.overflow, 'break');
  // One that breaks gives all others a row of their own.
  const short = ['d', 'e'].map((name) => ({ name }));
  assert.equal(fitted({ ...option, series: [series[0], ...short] }, 340).more, 3 * 22);
  const many = Array.from({ length: 200 }, (_, at) => ({ name: `series ${at}` }));
  assert.deepEqual(fitted({ ...option, series: many }, 340).more, 0); // pages are turned
  assert.deepEqual(fitted({ grid: {}, series }, 340).more, 0);
});

test('equal settings are told apart by repetition, then by the number of the run', () => {
  assert.deepEqual(
    labelsOf([
      made('1', 'orb', { n: 5 }),
      made('2', 'orb', { n: 5 }, { repetition: 1 }),
      made('3', 'orb', { n: 5 }),
    ]),
    ['repetition 0, run 1', 'repetition 1', 'repetition 0, run 3'],
  );
  assert.deepEqual(labelsOf([made('1', 'orb', {})]), ['repetition 0']);
  assert.deepEqual(labelsOf([]), []);
});

const path = (length) => ({
  t: [0, 1, 2],
  x: [0, length / 2, length],
  y: [0, 1, 0],
  z: [0, 0, 0],
  error: [0, null, 1],
});

test('a path that diverges is cut, and the others stay whole', () => {
  const found = cropped([path(10), path(5000)], path(10));
  assert.deepEqual(found.cut, [0, 2]);
  assert.equal(found.tracks[0].t.length, 3);
  assert.deepEqual([found.tracks[1].t, found.tracks[1].error], [[0], [0]]);
  // Without a ground truth the path of middling size says what is far.
  assert.deepEqual(cropped([path(10), path(9), path(11), path(5000)], null).cut, [0, 0, 0, 2]);
  assert.deepEqual(cropped([], null).tracks, []);
});

const timed = (more) => ({
  runs: 2,
  failed: 1,
  live: 0,
  whole: [0, 100],
  extent: [0, 100],
  lanes: ['one', HOSTILE[0]],
  bars: null,
  bins: null,
  notes: [],
  ...more,
});
const BARS = {
  keys: [],
  settings: [{ 'parameters.n': 1 }, { 'parameters.n': HOSTILE[1] }],
  uid: ['a', 'b'],
  run: ['a', 'b'],
  status: ['Tracked', 'OutOfMemory'],
  lane: [0, 1],
  begin: [0, 50],
  start: [20, null],
  end: [100, 70],
  failed: [false, true],
  live: [false, false],
};
const BINS = {
  edges: [0, 50, 100],
  running: [
    [0.1, 0],
    [0, 0.05],
  ],
  preparing: [
    [0, 0],
    [0, 0],
  ],
  ended: [
    [2, 0],
    [0, 1],
  ],
  failed: [
    [1, 0],
    [0, 0],
  ],
};

test('a timeline says of what the used share is', () => {
  // Running 80 of 200, preparing 20 + 20: a program that never started was prepared all the time.
  assert.match(
    usedText(timed({ bars: BARS })),
    /^Of the 100 s of the 2 lanes, 40 % were spent running and 20 % preparing\. Of the other 40 % nobody/,
  );
  assert.match(usedText(timed({ bins: BINS })), / 3\.75 % were spent running/);
  // Of what is only partly in view, that part counts.
  assert.match(usedText(timed({ bars: BARS, extent: [90, 110] })), / 25 % were spent running/);
});

test('columns of a timeline of many runs are where something was done, and are seen', () => {
  const cells = binCells(timed({ bins: BINS }));
  assert.deepEqual(cells, [
    [0, 0, 50_000, 0.1, 0, 2, 1],
    [1, 50_000, 100_000, 0.05, 0, 1, 0],
  ]);
  assert.equal(fullShare(timed({ bins: BINS })), 0.1);
});

for (const [what, more] of Object.entries({ bars: { bars: BARS }, columns: { bins: BINS } }))
  test(`a timeline of ${what} is drawn`, () => {
    const svg = drawn(timelineChart(timed(more)));
    assert.match(svg, /#c0392b/);
    assert.match(svg, /#009e73/);
  });

test('steps lead through time', () => {
  assert.deepEqual(moved([0, 80], 'later'), [40, 120]);
  assert.deepEqual(moved([0, 80], 'closer', 60), [50, 70]);
  assert.deepEqual(moved([50, 70], 'wider'), [20, 100]);
});

const cell = (at, median, more = {}) => ({
  at,
  runs: 3,
  total: 3,
  n: median === null ? 1 : 3,
  failures: {},
  best: 0.01,
  low: 0.01,
  median,
  high: median,
  ...more,
});
const METRIC = { name: 'ate.rmse', title: 'ATE [cm]', factor: 100 };
const AXES = ['parameters.n', 'input.resolution'].map((name) => ({ name, title: name, kind: 'number' }));

test('contours lie where the figure has their level', () => {
  // A plane that rises by 1 a step of x: the line of 0.5 goes straight up its middle.
  const all = fields(
    [0, 1],
    [0, 2],
    [
      [0, 1],
      [0, 1],
    ],
  );
  const ends = all.flatMap((field) => pieces(field, 0.501)).flat();
  assert.ok(ends.length >= 2 * 12);
  assert.ok(ends.every(([x]) => Math.abs(x - 0.501) < 1e-9));
  assert.deepEqual([Math.min(...ends.map(([, y]) => y)), Math.max(...ends.map(([, y]) => y))], [0, 2]);
  // A saddle has two lines in one field.
  assert.equal(pieces({ x: [0, 1], y: [0, 1], corners: [0, 1, 1, 0] }, 0.5).length, 2);
  assert.deepEqual(levelsOf(1, 1), []);
});

test('nothing is made up beside a place where runs failed', () => {
  assert.equal(
    fields(
      [0, 1, 2],
      [0, 1],
      [
        [0, 1, null],
        [1, 2, 3],
      ],
    ).length,
    144,
  );
  const cells = [cell([500, 1], 0.02), cell([500, 0.5], null), cell([900, 1], 0.03), cell([900, 0.5], 0.04)];
  assert.deepEqual(gridOf(cells, 100).values, [
    [null, 4],
    [2, 3],
  ]);
  const { option, notes } = contourChart({ metric: METRIC, axes: AXES }, cells);
  assert.match(notes.join(), /A cross: the median run failed there/);
  assert.equal(option.series[3].data.length, 1);
  assert.ok(drawn({ option }));
});

test('contours of texts and of a single value are drawn', () => {
  const cells = [cell(['a', true], 0.02), cell([HOSTILE[0], true], 0.03), cell([null, false], 0.03)];
  assert.ok(drawn(contourChart({ metric: METRIC, axes: AXES }, cells)));
});

test('slices share their limits, and what failed stands at the top', () => {
  const slices = {
    a: [cell([1], 0.02), cell([2], null, { low: null, best: null, high: null })],
    b: [cell([HOSTILE[0]], 0.05)],
  };
  const limits = sharedLimits(slices, 100, false);
  assert.equal(limits.high, 5);
  const option = sliceChart(METRIC, AXES[0], slices.a, limits, false);
  const [dot, cross] = option.series[1].data;
  assert.deepEqual(dot.value, [0, 2]);
  assert.deepEqual(cross.value, [1, option.yAxis.max]);
  assert.match(cross.symbol, /^path/);
  assert.ok(drawn({ option: sliceChart(METRIC, AXES[1], slices.b, limits, true) }));
});

test('where large is good what failed stands at the bottom', () => {
  const cells = [cell([1], 0.9), cell([2], null, { low: null, best: null, high: null })];
  const accuracy = { ...METRIC, factor: 1, better: 'higher' };
  const option = sliceChart(accuracy, AXES[0], cells, sharedLimits({ a: cells }, 1, false), false);
  assert.deepEqual(option.series[1].data[1].value, [1, option.yAxis.min]);
  assert.match(option.tooltip.formatter({ dataIndex: 0 }), /best/);
});

test('what matters comes first on a phone, and nothing is lost', () => {
  const all = ['rank', 'name', 'score', 'n'].map((name) => ({ name }));
  assert.deepEqual(
    foremost(all, ['rank', 'score', 'unknown']).map((one) => one.name),
    ['rank', 'score', 'name', 'n'],
  );
});

test('moments at which a run was lost are those where its poses begin late, break off or end', () => {
  const t = [5, 5.1, 5.2, 5.3, 9, 9.1, 9.2];
  const still = t.map(() => 0);
  const estimate = { t, x: still, y: still, z: still, error: [0.1, null, 0.3, 0.1, 0.1, 0.9, 0.1] };
  const reference = { t: [0, 20], x: [0, 0], y: [0, 0], z: [0, 0] };
  assert.deepEqual(momentsOf(estimate, reference), [
    { t: 5, text: 'first pose, 5 s late' },
    { t: 5.3, text: 'lost for 3.7 s' },
    { t: 9.1, text: 'largest error, 0.9 m' },
    { t: 9.2, text: 'last pose, 10.8 s early' },
  ]);
  assert.deepEqual(momentsOf({ ...estimate, t: [], error: null }, null), []);
});
