// SPDX-License-Identifier: Apache-2.0
/** Charts: their options, and that ECharts draws them, whatever the archive's texts are. */
import assert from 'node:assert/strict';
import test from 'node:test';
import * as echarts from '/vendor/echarts.mjs';
import { box } from '../../operator/slamhive/dashboard/static/charts/box.js';
import { causal } from '../../operator/slamhive/dashboard/static/charts/causal.js';
import { dumbbells } from '../../operator/slamhive/dashboard/static/charts/dumbbells.js';
import { importanceCharts } from '../../operator/slamhive/dashboard/static/charts/importance.js';
import { quantile } from '../../operator/slamhive/dashboard/static/charts/limits.js';
import { line, lines, linesOf } from '../../operator/slamhive/dashboard/static/charts/line.js';
import { pairsChart } from '../../operator/slamhive/dashboard/static/charts/pairs.js';
import { paretoChart } from '../../operator/slamhive/dashboard/static/charts/pareto.js';
import {
  asCategories,
  axisOption,
  facets,
  readAxis,
} from '../../operator/slamhive/dashboard/static/charts/points.js';
import {
  ratioChart,
  settingText,
  toldApart,
} from '../../operator/slamhive/dashboard/static/charts/ratios.js';
import {
  coverage,
  envelopes,
  path,
  rate,
  spans,
} from '../../operator/slamhive/dashboard/static/charts/recording.js';
import { labelRoom } from '../../operator/slamhive/dashboard/static/charts/rows.js';
import {
  publishedSeries,
  publishedText,
  scatter,
} from '../../operator/slamhive/dashboard/static/charts/scatter.js';
import { scores, standings } from '../../operator/slamhive/dashboard/static/charts/standings.js';
import { truthChart } from '../../operator/slamhive/dashboard/static/charts/truth.js';
import { reachChart } from '../../operator/slamhive/dashboard/static/charts/reach.js';
import {
  nodesChart,
  spreadChart,
  suspectChart,
} from '../../operator/slamhive/dashboard/static/charts/spread.js';
import { overTime, plane } from '../../operator/slamhive/dashboard/static/charts/trajectory.js';
import { dressed } from '../../operator/slamhive/dashboard/static/core/chart.js';
import { answer, HOSTILE } from './helpers.js';

const ERROR = { better: 'lower' };
const ACCURACY = { better: 'higher' };
const SIZE = { width: 800, height: 400 };
const every = (data) => Array.from({ length: data.count }, (_, index) => index);

/** Points: numbers of x and y, categories of status and, if given, colour and facet. */
function points(x, y, { status, colour, facet } = {}) {
  const coded = (values) => {
    const categories = [...new Set(values)].filter((value) => value !== null);
    return {
      name: 'c',
      title: 'c',
      kind: 'text',
      categories,
      codes: values.map((value) => categories.indexOf(value)),
    };
  };
  return {
    count: x.length,
    axes: {
      x: typeof x[0] === 'string' ? coded(x) : { name: 'x', title: 'x', kind: 'number', values: x },
      y: { name: 'y', title: 'y', kind: 'number', values: y },
      ...(colour && { colour: coded(colour) }),
      ...(facet && { facet: { ...coded(facet), name: 'dataset', title: 'dataset' } }),
    },
    status: coded(status ?? x.map(() => 'Tracked')),
    run: x.map((_, index) => index + 1),
    id: x.map((_, index) => index),
  };
}

/** Draw an option as the page does; return the SVG. */
function drawn(option) {
  const paper = echarts.init(null, null, { renderer: 'svg', ssr: true, ...SIZE });
  paper.setOption(dressed(typeof option === 'function' ? option(SIZE) : option, false));
  const svg = paper.renderToSVGString();
  paper.dispose();
  return svg;
}

const track = (name, error) => ({
  name,
  track: { t: [0, 1, 2, 30], x: [0, 1, 2, 3], y: [0, 1, 0, 1], z: [0, 0, 1, 1], error },
});
const side = (median) => ({
  runs: 3,
  n: 3,
  failures: {},
  median,
  medianFailed: median === null,
  points: [],
  deterministic: false,
});
const setting = (n, before, after) => ({
  keys: { dataset: 'hall', 'parameters.n': n },
  before: side(before),
  after: side(after),
  ratio: before && after && after / before,
});
const entry = (name, own, ownRank, common, rank) => ({
  keys: { algorithm: name, sensors: 'mono' },
  runs: 3,
  n: 3,
  own,
  ownRank,
  common,
  rank,
});
const group = (name, x, median) => ({
  keys: { name, 'parameters.n': x },
  runs: 3,
  n: 2,
  failures: { Lost: 1 },
  coverage: { mean: 0.9 },
  figures: { 'ate.rmse': { n: 2, median, min: median - 1, max: median + 1, medianInterval: null } },
});
const aggregate = (groups) => ({
  keys: [
    { name: 'name', title: 'name', kind: 'text' },
    { name: 'parameters.n', title: 'n', kind: 'integer' },
  ],
  metrics: [{ name: 'ate.rmse', title: 'ATE', kind: 'number', factor: 1 }],
  groups,
});
/** Groups of runs that were played to: name, final and causal error of each. */
const played = (...rows) => ({
  keys: [{ name: 'algorithm', title: 'algorithm', kind: 'text' }],
  metrics: [
    { name: 'ate.rmse', title: 'ATE, final [m]', label: 'ATE RMSE, final [m]', factor: 1 },
    { name: 'beside.online.ate.rmse', title: 'ATE, causal [m]', label: 'ATE RMSE, causal [m]', factor: 1 },
  ],
  groups: rows.map(([algorithm, final, first]) => ({
    keys: { algorithm },
    figures: { 'ate.rmse': { median: final }, 'beside.online.ate.rmse': { median: first } },
  })),
});
const AXIS = { name: 'input.rate', title: 'rate', label: 'rate', factor: 1 };
/** A system that passes up to 2, or as is said. */
const reached = (name, more = {}) => ({
  name,
  cell: {
    status: 'found',
    falls: false,
    passing: 2,
    failing: 3,
    sure: [1, null],
    sentence: name,
    runs: 12,
    values: [1, 2, 3, 4].map((value) => ({
      value,
      failed: value > 2 ? 3 : 0,
      known: 3,
      share: Number(value > 2),
    })),
    ...more,
  },
});
const LINE = { x: 'parameters.n', y: 'ate.rmse', figure: 'median', xlog: false, ylog: false };
const SCATTER = { xlog: false, ylog: false };

/** Each kind of chart, made with a text of the archive. */
const CHARTS = {
  scatter: (text) =>
    scatter(points([1, 2, 3], [1, null, 3], { colour: [text, text, 'b'] }), [0, 1, 2], SCATTER),
  box: (text) =>
    box(points([text, text, text, text, text, 'b'], [1, 2, 3, 4, 5, 6]), [0, 1, 2, 3, 4, 5], {
      ylog: false,
      tracked: true,
    }),
  line: (text) => line(aggregate([group(text, 1, 5), group(text, 2, 6), group('b', 1, 7)]), LINE),
  dumbbells: (text) => dumbbells([entry(text, 0.1, 2, 0.2, 1), entry('b', 0.2, 1, null, 2)]).option,
  causal: (text) => causal(played([text, 0.1, 0.2], ['b', 0.2, 0.2], ['c', 0.3, null])).option,
  importance: (text) =>
    importanceCharts({
      parameters: [{ name: `parameters.${text}`, variance: 0.4 }],
      interactions: [{ a: text, b: 'b', variance: 0.1 }],
    }).option,
  pairs: (text) =>
    pairsChart(
      [{ a: { algorithm: text }, b: { algorithm: 'b' }, n: 2, wins: { a: 2, b: 0 }, effect: 1, pHolm: 0.01 }],
      ERROR,
    ).option,
  ratios: (text) => ratioChart({ settings: [setting(text, 1, 2), setting('b', 1, null)] }, ERROR).option,
  spread: (text) =>
    spreadChart({
      metric: {},
      groups: [{ keys: { algorithm: text }, n: 2, verdict: text, figure: { median: 1, min: 0.5, max: 2 } }],
    }).option,
  reach: (text) => reachChart(AXIS, [reached(text), { name: 'never run', cell: null }]).option,
  suspects: (text) => suspectChart([{ keys: { algorithm: text }, scale: 1.04, spread: 0.01, n: 3 }]).option,
  nodes: (text) => nodesChart([{ node: text, ratio: 1.1, low: 1, high: null, sentence: text }]).option,
  plane: (text) => plane([track(text), track('b', [0, 1, null, 3])], [track(text)], 'x', 'y', null),
  'plane by error': (text) => plane([track(text, [0, 1, null, 3])], [], 'x', 'z', { low: 0, high: 3 }),
  'over time': (text) => overTime([{ name: text, t: [0, 1, 90], values: [1, null, 2] }], text, 'time [s]'),
};

for (const [name, make] of Object.entries(CHARTS))
  test(`${name}: texts of the archive are drawn as texts`, () => {
    for (const text of HOSTILE) {
      const svg = drawn(make(text));
      assert.match(svg, /<(path|text)/);
      assert.doesNotMatch(svg, /<(img|script)|<svg onload/);
    }
  });

for (const [name, make] of Object.entries(CHARTS))
  test(`${name}: what is pointed at is told in lines of bearable length`, () => {
    const made = make('x'.repeat(5000));
    const option = typeof made === 'function' ? made(SIZE) : made;
    const tell = option.tooltip.formatter;
    for (const series of option.series.filter((one) => one.type !== 'custom' && !one.silent))
      for (const data of series.data) {
        if (data[0] === '-') continue; // a break in a line, at which nobody can point
        const item = {
          data,
          value: data?.value ?? data,
          name: 'n',
          seriesName: series.name,
          seriesType: series.type,
        };
        const told = tell(option.tooltip.trigger === 'axis' ? [item] : item);
        assert.equal(typeof told, 'string');
        assert.ok(
          told.split('\n').every((one) => one.length <= 200),
          told,
        );
        assert.doesNotMatch(told, /undefined|NaN|\[object/);
      }
  });

test('a bar ends where it last passes, and goes on where nothing fails', () => {
  const rows = [
    reached('breaks'),
    reached('never', { status: 'never fails', passing: 4, failing: null }),
    reached('always', { status: 'always fails', passing: null, failing: 1 }),
    reached('falls', { falls: true, passing: 3, failing: 2, sure: [null, 4] }),
    reached('odd', { status: 'not monotone' }),
    reached('still', { status: 'no effect seen', passing: 4, failing: null }),
  ];
  const [bars, sure, passes, fails, open, still] = reachChart(AXIS, rows)
    .option(SIZE)
    .series.map(({ data }) => data);
  assert.deepEqual(bars, [
    [1, 2, 0],
    [1, 4, 1],
    [4, 3, 3],
    [1, 4, 5],
  ]);
  assert.deepEqual(sure, [
    [1, 4, 0],
    [1, 4, 3],
  ]);
  /** @param {any[]} marks */
  const places = (marks) => marks.map(({ value }) => value);
  assert.deepEqual(places(open), [[4, 1]]);
  assert.deepEqual(places(still), [[4, 5]]);
  assert.deepEqual(places(fails), [
    [3, 0],
    [1, 2],
    [2, 3],
    [3, 4],
    [4, 4],
  ]);
  assert.deepEqual(places(passes), [
    [2, 0],
    [3, 3],
    [1, 4],
    [2, 4],
  ]);
});

test('kept answers of a dashboard are drawn', () => {
  const data = answer('/analysis/points');
  for (const part of facets(data)) {
    const indices = part.indices.filter((index) => index < 6);
    assert.ok(drawn(scatter(data, indices, SCATTER)).length > 1000);
    assert.ok(drawn(box(data, indices, { ylog: false, tracked: false })).length > 1000);
  }
  assert.ok(drawn(line(answer('/analysis/aggregate'), { ...LINE, x: 'parameters.nFeatures' })).length > 1000);
  assert.ok(drawn(pairsChart(answer('/analysis/compare').boards[0].pairs, ERROR).option).length > 1000);
  assert.ok(drawn(spreadChart(answer('/analysis/repeatability')).option).length > 1000);
  assert.ok(drawn(suspectChart(answer('/analysis/suspects').items).option).length > 1000);
  assert.ok(drawn(nodesChart(answer('/analysis/suspects/nodes').items).option).length > 1000);
  assert.ok(drawn(importanceCharts(answer('/analysis/importance').subjects[0]).option).length > 1000);
  assert.ok(drawn(dumbbells(answer('/analysis/common').groups[0].entries).option).length > 1000);
});

test('suspect stretches of ground truth are shaded in time since its begin, with the limit', () => {
  const { series, xAxis } = truthChart({
    limit: 0.1,
    stretches: [{ begin: 105, end: 107 }],
    profile: [
      [100, 0.02, 0.01],
      [106, 0.3, 0.02],
      [110, 0.02, 0.01],
    ],
  });
  assert.deepEqual(series[1].markArea.data, [[{ xAxis: 5 }, { xAxis: 7 }]]);
  assert.deepEqual(series[1].markLine.data, [{ yAxis: 0.1 }]);
  assert.equal(xAxis.max, 10);
});

test('causal and final errors lie in one row for each competitor that has both', () => {
  const option = causal(played(['a', 0.1, 0.2], ['b', 0.2, 0.2], ['c', 0.3, null])).option(SIZE);
  assert.deepEqual(option.yAxis.data, ['a', 'b']);
  const [, first, final] = option.series;
  assert.deepEqual([first.name, final.name], ['causal: as first published', 'final: as corrected later']);
  assert.deepEqual(
    [first, final].map((one) => one.data.map(({ value }) => value)),
    [
      [
        [0.2, 0],
        [0.2, 1],
      ],
      [
        [0.1, 0],
        [0.2, 1],
      ],
    ],
  );
  assert.equal(option.xAxis.name, 'ATE RMSE [m]');
});

test('where nothing can be drawn there is no chart', () => {
  assert.equal(causal(played(['a', 0.1, null])), null);
  assert.equal(causal(aggregate([group('a', 1, 5)])), null);
  assert.equal(dumbbells([]), null);
  assert.equal(dumbbells([entry('a', 0.1, 1, null, 1)]), null);
  assert.equal(ratioChart({ settings: [] }, ERROR), null);
  assert.equal(spreadChart({ metric: {}, groups: [] }), null);
  assert.equal(
    spreadChart({
      metric: {},
      groups: [
        { keys: {}, n: 3, figure: { median: 0 } },
        { keys: {}, n: 2, figure: null },
      ],
    }),
    null,
  );
  assert.equal(
    box(points([...'abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQ'], Array(43).fill(1)), [], {}),
    null,
  );
});

test('numbers of an axis are in the shown unit, unknown ones are none', () => {
  const axis = readAxis({ name: 'm', title: 'memory', kind: 'number', factor: 0.5, values: [4, null, 0] });
  assert.deepEqual([axis.at(0), axis.at(1), axis.at(2)], [2, null, 0]);
  assert.deepEqual([axis.text(0), axis.text(1)], ['2', '–']);
  assert.equal(readAxis({ name: 't', title: 't', kind: 'time', values: [1.5] }).at(0), 1500);
});

test('categories of an axis are read by their codes', () => {
  const axis = readAxis({ name: 'a', title: 'a', codes: [1, -1, 0], categories: [true, '–'] });
  assert.deepEqual([0, 1, 2].map(axis.at), [1, null, 0]);
  assert.deepEqual([0, 1, 2].map(axis.text), ['–', '–', 'true']);
});

test('few numbers become categories in their order, many do not', () => {
  const axis = readAxis({ name: 'n', title: 'n', kind: 'integer', values: [10, 9, null, 10] });
  const made = asCategories(axis, 4);
  assert.deepEqual(made.categories, ['9', '10']);
  assert.deepEqual([0, 1, 2, 3].map(made.at), [1, 0, null, 1]);
  assert.equal(asCategories(axis, 4, 1), null);
  assert.equal(asCategories(readAxis({ codes: [0], categories: ['a', 'b'] }), 1, 1), null);
});

test('facets share out all points, those without a value too', () => {
  const data = points([1, 2, 3], [1, 2, 3], { facet: ['hall', null, 'yard'] });
  assert.deepEqual(facets(data), [
    { name: 'hall', indices: [0] },
    { name: 'yard', indices: [2] },
    { name: 'without dataset', indices: [1] },
  ]);
  assert.deepEqual(facets(points([1, 2], [1, 2])), [{ name: null, indices: [0, 1] }]);
  const many = Array.from({ length: 30 }, (_, index) => `d${index}`);
  assert.equal(
    facets(
      points(
        many.map(() => 1),
        many.map(() => 1),
        { facet: many },
      ),
    ),
    null,
  );
});

test('names of many categories are turned below the axis, not beside it', () => {
  const axis = readAxis({ name: 'a', title: 'a', codes: [], categories: [...'abcdef'] });
  assert.equal(axisOption(axis).axisLabel.rotate, 25);
  assert.equal(axisOption(axis, { vertical: true }).axisLabel.rotate, 0);
  assert.equal(
    axisOption(readAxis({ name: 'x', title: 'x', kind: 'number', values: [] }), { log: true }).type,
    'log',
  );
  assert.equal(
    axisOption(readAxis({ name: 'x', title: 'x', kind: 'time', values: [] }), { log: true }).type,
    'time',
  );
});

test('names leave most of a phone to the chart', () =>
  assert.deepEqual([labelRoom(360, 250), labelRoom(1280, 250)], [130, 250]));

const SHARES = [
  [[1], 0.25, 1],
  [[1, 2], 0.5, 1.5],
  [[1, 2, 3, 4, 5], 0.25, 2],
  [[1, 2, 4], 0.75, 3],
];
for (const [values, share, expected] of SHARES)
  test(`the quantile ${share} of ${values} is ${expected}`, () =>
    assert.equal(quantile(values, share), expected));

test('points without a value are crosses in a field above the axes, not among values', () => {
  const data = points([1, 2, 3], [1, null, 3], { status: ['Tracked', 'Lost', 'Lost'] });
  const { series, grid, yAxis } = scatter(data, [0, 1, 2], SCATTER);
  const [{ data: made }, crosses] = series;
  assert.deepEqual(
    made.map((one) => one.value[1]),
    [1, 3],
  );
  assert.deepEqual([made[0].symbol, made[1].symbol], ['circle', 'triangle']);
  assert.equal(made[1].itemStyle.color, 'transparent');
  assert.deepEqual([crosses.data[0].value, crosses.yAxisIndex], [[2, 0, 1], 1]);
  assert.ok(grid[1].top + grid[1].height < grid[0].top && yAxis[1].data[0] === 'failed');
});

test('who has crosses alone is in the legend, and ticks are numbers as people write them', () => {
  const data = points(
    [1, 2, 3].map((one) => one * 0.1),
    [1, null, 3],
    { colour: ['a', 'b', 'a'] },
  );
  const { legend, xAxis } = scatter(data, [0, 1, 2], SCATTER);
  assert.equal(legend.data.length, 2);
  assert.deepEqual(xAxis[0].axisLabel.customValues, [0.1, 0.2, 0.3]);
});

test('points without x are left out', () => {
  const { series } = scatter(points([1, null, 3], [1, 2, 3]), [0, 1, 2], SCATTER);
  assert.equal(series[0].data.length, 2);
});

test('charts of several datasets have the same axes unless they are to have their own', () => {
  const data = points([1, 2, 30], [1, 2, 900], { facet: ['a', 'a', 'b'] });
  const ends = (indices, own) => {
    const { xAxis, yAxis } = scatter(data, indices, { ...SCATTER, own });
    return [xAxis.min, xAxis.max, yAxis.min, yAxis.max];
  };
  assert.deepEqual(ends([0, 1], false), ends([2], false));
  assert.notDeepEqual(ends([0, 1], true), ends([2], true));
  const groups = aggregate([group('a', 1, 5), group('a', 2, 6), group('b', 90, 700), group('b', 100, 800)]);
  const set = { ...LINE, facet: 'name', among: ['a', 'b'] };
  const axes = (facetValue, own) => {
    const { xAxis, yAxis } = line(groups, { ...set, facetValue, own });
    return [xAxis.min, xAxis.max, yAxis.min, yAxis.max, xAxis.axisLabel.customValues];
  };
  assert.deepEqual(axes('a', false), axes('b', false));
  assert.deepEqual(axes('a', true)[4], [1, 2], 'ticks are the values that were tried');
});

test('a setting of a line whose runs all failed is a cross above, not a gap that nobody sees', () => {
  const data = aggregate([group('a', 1, 5), group('a', 2, 6), group('a', 3, 7)]);
  data.groups[1].figures['ate.rmse'] = { n: 0, median: null, min: null, max: null };
  const { series, yAxis } = line(data, LINE);
  const crosses = series.at(-1);
  assert.deepEqual([crosses.data[0].value, crosses.yAxisIndex, yAxis.length], [[2, 0], 1, 2]);
  assert.ok(drawn(line(data, LINE)).length > 1000);
});

test('the legend names the setting whose values it tells, with its unit', () => {
  const data = points([1, 2, 3], [1, 2, 3]);
  data.axes.colour = {
    name: 'parameters.range',
    title: 'parameters.range [m]',
    kind: 'number',
    values: [30, 60, null],
  };
  const names = ['range 30 m', 'range 60 m', 'range –'];
  assert.deepEqual(scatter(data, [0, 1, 2], SCATTER).legend?.data, names);
});

test('values that read the same keep a colour each', () => {
  const data = points([1, 2, 3], [1, 2, 3]);
  data.axes.colour = { name: 'c', title: 'c', kind: 'number', values: [1.00001, 1.00002, null] };
  assert.deepEqual(
    scatter(data, [0, 1, 2], SCATTER).series.map((one) => one.data.length),
    [1, 1, 1],
  );
});

test('a colour of many numbers is a scale', () => {
  const x = Array.from({ length: 30 }, (_, index) => index);
  const data = points(x, x);
  data.axes.colour = { name: 'c', title: 'c', kind: 'number', values: x };
  const { visualMap, series } = scatter(data, x, SCATTER);
  assert.deepEqual([visualMap.min, visualMap.max, series[0].data[7].value[3]], [0, 29, 7]);
});

test('many points are drawn plainly', () => {
  const x = Array.from({ length: 3001 }, (_, index) => index);
  const [series] = scatter(points(x, x), x, SCATTER).series;
  assert.ok(series.large && Array.isArray(series.data[0]));
});

test('fewer than five runs get no box, and how many count is said below', () => {
  const data = points([...'aaaaab'], [1, 2, 3, 4, 5, 6], {
    status: ['Tracked', 'Tracked', 'Tracked', 'Tracked', 'Tracked', 'Lost'],
  });
  const all = box(data, every(data), { ylog: false, tracked: false })(SIZE);
  assert.deepEqual(all.series[0].data, [[1, 2, 3, 4, 5], ['-']]);
  const four = box(points([...'aaaa'], [1, 2, 3, 4]), [0, 1, 2, 3], { ylog: false, tracked: true })(SIZE);
  assert.deepEqual(four.series[0].data, [['-']]);
  const tracked = box(data, every(data), { ylog: false, tracked: true })(SIZE);
  assert.deepEqual(tracked.xAxis.data, ['a\nn 5/5', 'b\nn 0/1']);
  assert.equal(tracked.series[1].data.length, 5);
});

test('names of lines keep what differs, how long they are', () => {
  const group = (end) => ({
    keys: { dataset: 'd'.repeat(63), algorithm: `${'a'.repeat(62)}${end}`, n: 1 },
    figures: { y: {} },
  });
  const keys = [{ name: 'dataset' }, { name: 'algorithm' }];
  const names = linesOf([group('x'), group('y')], 'n', 'y', keys).map((one) => one.name);
  assert.deepEqual([new Set(names).size, names[0].length <= 90, names[0].at(-1)], [2, true, 'x']);
});

test('a line is one combination of all keys but x and the facet', () => {
  const data = aggregate([group('a', 2, 6), group('a', 1, 5), group('b', null, 7), group('b', 1, 7)]);
  assert.deepEqual(
    lines(data, 'parameters.n', 'ate.rmse').map((one) => [one.name, one.points.length]),
    [
      ['name a', 2],
      ['name b', 1],
    ],
  );
  assert.deepEqual(
    lines(data, 'parameters.n', 'ate.rmse', 'name', 'b').map((one) => one.name),
    ['runs'],
  );
});

test('points of a line stand in the order of x, those without a figure are left out', () => {
  const data = aggregate([group('a', 3, 7), group('a', 1, 5), group('a', 2, 6)]);
  data.groups[2].figures['ate.rmse'] = { n: 0, median: null, min: null, max: null };
  const made = line(data, LINE).series.find((one) => one.type === 'line');
  assert.deepEqual(
    made.data.map((one) => one.value),
    [
      [1, 5],
      [3, 7],
    ],
  );
});

test('a line has its interval around it where there is one, else what it spans', () => {
  const data = aggregate([group('a', 1, 5)]);
  const reach = () => line(data, LINE).series[0].data[0].slice(1);
  assert.deepEqual(reach(), [4, 6]);
  data.groups[0].figures['ate.rmse'].medianInterval = { low: 4.5, high: null, method: 'order' };
  assert.deepEqual(reach(), [4.5, 5]);
});

test('a line over a column that the answer does not describe is drawn by its name', () => {
  const data = { ...aggregate([group('a', 1, 5)]), metrics: [] };
  assert.match(line(data, LINE).yAxis.name, /^ate.rmse/);
});

const ranked = (name, ratio, datasets, rank = 1) => ({
  keys: { algorithm: name },
  rank,
  ratio,
  ratioInterval: ratio === null ? null : { low: 1, high: 2 * ratio },
  runs: 3,
  n: 3,
  failed: ratio === null ? 3 : 0,
  datasets: datasets.map((dataset) => ({
    dataset,
    median: ratio === null ? null : 0.1 * ratio,
    medianFailed: ratio === null,
  })),
});
const BOARD = {
  facets: {},
  datasets: ['hall', 'yard', 'street'],
  entries: [
    ranked('never', null, ['hall'], null),
    ranked('one dataset', 1, ['hall'], 1),
    ranked('failed', null, ['hall', 'yard', 'street'], 4),
    ranked('third', 3, ['hall', 'yard', 'street'], 3),
    ranked('second', 2, ['hall', 'yard', 'street'], 2),
  ],
};

test('dots of the leaderboard say of how many results they are, within the axis', () => {
  const { series } = standings(BOARD, ERROR).option(SIZE);
  const labels = series[1].data.map(({ label }) => [label.formatter, label.align]);
  assert.deepEqual(labels.at(-1), [`1×, n ${BOARD.entries[1].n}`, 'left']);
});

test('an interval that failures leave open has an arrow at the edge, and no other has one', () => {
  const open = { ...ranked('open', 2, ['hall'], 2), ratioInterval: { low: 1.2, high: null } };
  const { series, xAxis } = standings({ ...BOARD, entries: [BOARD.entries[1], open] }, ERROR).option(SIZE);
  assert.deepEqual(series[2].data, [[(Array.isArray(xAxis) ? xAxis[0] : xAxis).max, 1]]);
});

test('the leaderboard is sorted by the ratio to the best, and one dataset leads nobody on three', () => {
  const { yAxis, series } = standings(BOARD, { ...ERROR, title: 'ATE' }).option(SIZE);
  assert.deepEqual(yAxis[0].data, [
    'second\nrank 2 on 3 of 3 datasets',
    'third\nrank 3 on 3 of 3 datasets',
    'one dataset\nrank 1 on 1 of 3 datasets',
    'failed\nrank 4 on 3 of 3 datasets',
    'never\nno rank on 1 of 3 datasets',
  ]);
  assert.deepEqual(
    series[1].data.map((one) => [one.value[0], one.itemStyle?.color]),
    [
      [2, undefined],
      [3, undefined],
      [1, 'transparent'],
    ],
  );
});

test('what a dot is stands within the axes: right of the best at their left end, left of the worst', () => {
  const metric = { ...ERROR, name: 'ate.rmse', title: 'ATE' };
  const entries = [1, 2, 3].map((ratio) => ranked(`a${ratio}`, ratio, ['hall'], ratio));
  for (const one of entries) one.ratioInterval = null;
  for (const width of [1280, 360]) {
    const { series } = standings({ ...BOARD, datasets: ['hall'], entries }, metric).option({ width });
    assert.deepEqual(
      series[1].data.map((one) => one.label.align),
      ['left', undefined, 'right'],
    );
  }
});

test('who failed has a cross in a field of its own, none at the place of the best', () => {
  const metric = { ...ERROR, name: 'ate.rmse', title: 'ATE' };
  for (const { option } of [standings(BOARD, metric), scores(BOARD, metric, [])]) {
    const made = option(SIZE);
    const crosses = made.series.filter((one) => String(one.symbol).startsWith('path'));
    assert.deepEqual([crosses.length, crosses[0].xAxisIndex, made.xAxis[1].data], [1, 1, ['failed']]);
    const [axes, field] = made.grid;
    assert.ok(SIZE.width - axes.right < field.left, 'the field lies beside the axes');
    const values = made.series.filter((one) => one.type === 'scatter' && !one.xAxisIndex);
    for (const one of values) for (const { value } of one.data) assert.ok(value[0] > 0);
    assert.ok(drawn(option).length > 1000);
  }
  const fine = { ...BOARD, entries: BOARD.entries.slice(3) };
  assert.ok(!Array.isArray(standings(fine, metric).option(SIZE).grid), 'nobody failed: no field');
});

test('a board of which all failed, or whose values span 18 decades, is drawn', () => {
  const metric = { ...ERROR, name: 'ate.rmse', title: 'ATE' };
  const failed = { ...BOARD, entries: BOARD.entries.filter((one) => one.ratio === null) };
  const wide = { ...BOARD, entries: [1e-9, 1, 1e9].map((one) => ranked(`a${one}`, one, ['hall', 'yard'])) };
  for (const board of [failed, wide])
    for (const { option } of [standings(board, metric), scores(board, metric, [])])
      assert.ok(drawn(option).length > 500);
});

test('who changed its rank says so at the larger of its errors', () => {
  const option = dumbbells([
    entry('a', 0.3, 2, 0.1, 1),
    entry('b', 0.2, 1, 0.25, 2),
    entry('c', 0.5, 3, 0.5, 3),
  ]).option(SIZE);
  const [, own, common] = option.series.map((one) => one.data.map((point) => point.label?.show));
  assert.deepEqual(
    [own, common],
    [
      [true, false, false],
      [false, true, false],
    ],
  );
  assert.equal(option.series[1].data[0].label.formatter, '2 → 1');
});

test('errors of very different size are drawn over a logarithm, of which 0 has none', () => {
  const type = (least) =>
    dumbbells([entry('a', least, 1, least, 1), entry('b', 5, 2, 5, 2)]).option(SIZE).xAxis.type;
  assert.deepEqual([type(0.01), type(4), type(0)], ['log', 'value', 'value']);
});

test('what matters most stands first, noise below 0 is drawn as nothing', () => {
  const subject = {
    parameters: [
      { name: 'parameters.a', variance: -0.01 },
      { name: 'parameters.b', variance: 0.5 },
      { name: 'c', variance: null },
    ],
    interactions: [{ a: 'parameters.a', b: 'parameters.b', variance: 0.2 }],
  };
  const { rows, option } = importanceCharts(subject);
  assert.equal(rows.length, 4);
  assert.deepEqual(option(SIZE).yAxis.data, ['b', 'a × b', 'a']);
  assert.deepEqual(
    option(SIZE).series[0].data.map((one) => one.value),
    [50, 20, 0],
  );
});

test('of a pair both directions are shown, the better competitor first', () => {
  const pair = {
    a: { algorithm: 'worse' },
    b: { algorithm: 'better' },
    n: 5,
    wins: { a: 1, b: 4 },
    effect: -0.6,
    pHolm: 0.01,
  };
  const { yAxis, series } = pairsChart([pair], ERROR).option(SIZE);
  assert.deepEqual(yAxis.data, ['1\u00a0\u00a0better', '2\u00a0\u00a0worse']);
  assert.deepEqual(
    series[0].data.map((one) => [...one.value, one.told]),
    [
      [0, 1, -0.6, '1:4 *'],
      [1, 0, 0.6, '4:1 *'],
    ],
  );
});

test('of a pair what may be chance is pale, however large its effect', () => {
  const pair = { a: { algorithm: 'a' }, b: { algorithm: 'b' }, n: 1, wins: { a: 1, b: 0 }, effect: 1 };
  const option = (pHolm) => pairsChart([{ ...pair, pHolm }], ERROR).option(SIZE);
  const pale = (pHolm) => option(pHolm).series[0].data.map((one) => (one.itemStyle?.opacity ?? 1) < 0.5);
  assert.deepEqual([1, null, 0.01].map(pale), [
    [true, true],
    [true, true],
    [false, false],
  ]);
});

test('a pair without an effect or a test is drawn without a colour and a star', () => {
  const pair = {
    a: { algorithm: 'a' },
    b: { algorithm: 'b' },
    n: 0,
    wins: { a: 0, b: 0 },
    effect: null,
    pHolm: null,
  };
  assert.deepEqual(
    pairsChart([pair], ERROR)
      .option(SIZE)
      .series[0].data.map((one) => [Math.abs(one.value[2]), one.told]),
    [
      [0, '0:0'],
      [0, '0:0'],
    ],
  );
});

test('settings that failed before or after are crosses in a field of their own', () => {
  const change = {
    settings: [
      setting(1, 1, 2),
      setting(2, 1, null),
      setting(3, null, 1),
      setting(4, null, null),
      setting(5, 1, 0.5),
    ],
  };
  /** @param {object} metric */
  const made = (metric) => ratioChart(change, metric).option(SIZE);
  const drawnBy = (metric) => made(metric).series[0].data;
  assert.deepEqual(
    drawnBy(ERROR).map((one) => one.value),
    [
      [2, 0],
      [0.5, 4],
    ],
  );
  const crosses = made(ERROR).series.at(-1);
  assert.deepEqual([crosses.xAxisIndex, ...crosses.data.map((one) => one.value[1])], [1, 1, 2, 3]);
  assert.equal(new Set(crosses.data.map((one) => one.itemStyle.color)).size, 3); // worse, better, the same
  const colours = (metric) => drawnBy(metric).map((one) => one.itemStyle.color);
  assert.deepEqual(colours(ERROR), colours(ACCURACY).reverse());
  // Where nobody has said which way is good, nothing looks better.
  assert.equal(new Set(colours({ better: null })).size, 1);
});

test('pairs are better or worse where it is known which way is good', () => {
  const words = (metric) => pairsChart([], metric).option(SIZE).visualMap.text;
  assert.deepEqual([ERROR, ACCURACY].map(words), [
    ['better', 'worse'],
    ['better', 'worse'],
  ]);
  assert.deepEqual(words({ better: null }), ['lower', 'higher']);
});

test('settings are told by what differs, by the dataset where nothing does', () => {
  assert.deepEqual(toldApart([setting(1, 1, 1), setting(2, 1, 1)]), ['parameters.n']);
  assert.deepEqual(toldApart([setting(1, 1, 1)]), ['dataset']);
  assert.deepEqual(toldApart([]), []);
  assert.equal(settingText({ dataset: 'hall', 'parameters.n': 5 }, ['dataset', 'parameters.n']), 'hall, n 5');
  assert.equal(settingText({ dataset: 'hall', 'parameters.n': 5 }, ['parameters.n'], true), '5');
});

test('repetitions are drawn over the median of their configuration', () => {
  const groups = [
    { keys: { algorithm: 'a' }, n: 3, verdict: '', figure: { median: 2, min: 1, max: 4, points: [1, 2, 4] } },
    { keys: { algorithm: 'b' }, n: 1, verdict: '', figure: { median: 2, min: 2, max: 2 } },
  ];
  const { series } = spreadChart({ metric: {}, groups }).option(SIZE);
  assert.deepEqual(
    series[1].data.map((one) => one.value),
    [
      [0.5, 0],
      [1, 0],
      [2, 0],
    ],
  );
});

test('published numbers are hollow marks where they have both numbers', () => {
  const axes = {
    x: { name: 'usage.memory.peakBytes', title: 'memory', factor: 2 ** -20, values: [2 ** 20] },
    y: { name: 'ate.rmse', title: 'ATE', values: [0.1] },
  };
  const row = { system: 's', dataset: 'd', where: 'w', runs: 5, statistic: 'Mean', differences: ['why'] };
  const both = { ...row, values: { 'usage.memory.peakBytes': 2 ** 21, 'ate.rmse': 0.2 } };
  const one = { ...row, values: { 'ate.rmse': 0.2 } };
  const [series] = publishedSeries(/** @type {any} */ ({ axes }), /** @type {any} */ ([both, one]));
  assert.deepEqual(
    series.data.map((/** @type {any} */ point) => point.value),
    [[2, 0.2]],
  );
  assert.equal(series.itemStyle.color, 'transparent');
  assert.match(publishedText(/** @type {any} */ (both)), /Mean of 5 runs\nwhy/);
});

const SENSOR = {
  name: 'cam',
  type: 'Camera',
  topic: '/cam',
  messages: 3,
  first: 0,
  last: 10,
  rates: [1, 0],
  gaps: [
    [4, 6],
    [1, 2],
  ],
  pictures: [],
  clouds: [],
  imu: {
    gyro: {
      x: [
        [-1, null],
        [1, null],
      ],
    },
  },
};
const TRACK = { count: 2, first: 0, last: 1, t: [0, 1], x: [0, 2], y: [0, 1], z: [0, 0] };
const RECORDING = { name: 'd', start: 5, seconds: 10, sensors: [SENSOR], truth: TRACK, notes: [] };

test('what a sensor covers is interrupted by its gaps', () => {
  assert.deepEqual(spans(SENSOR), [
    [0, 1],
    [2, 4],
    [6, 10],
  ]);
});

test('a recording is drawn', () => {
  assert.match(drawn(coverage(RECORDING)), /ground truth/);
  assert.match(drawn(path(TRACK, 'x', 'y')), /x \[m\]/);
  assert.match(drawn(rate(RECORDING, SENSOR)), />Hz</);
  assert.match(drawn(envelopes(RECORDING, SENSOR.imu.gyro, 'rad/s')), /rad/);
});

test('fronts share their axes, failures have a field, labels say what differs', () => {
  const point = (x, y, k) => ({ keys: { algorithm: 'a', pace: 'Lockstep', k }, x, y, front: y === 1 });
  const fronts = [[point(1, 1, 1), point(2, null, 2)], [point(8, 90, 1)]].map((points, number) => ({
    facets: { alignment: number },
    points,
  }));
  const data = { x: { name: 'x', title: 'x', factor: 10 }, y: { name: 'y', title: 'y' }, fronts };
  const [one, two] = fronts.map((front) => paretoChart(data, front, { xlog: false, ylog: false }));
  const ends = ({ min, max }) => [min, max];
  assert.deepEqual(ends(one.xAxis[0]), ends(two.xAxis));
  assert.deepEqual(ends(one.yAxis[0]), ends(two.yAxis));
  const [, marks, failed] = one.series;
  assert.deepEqual(
    marks.data.map(({ value }) => value),
    [[10, 1]],
  );
  assert.deepEqual(
    failed.data.map(({ value }) => value),
    [[20, 0]],
  );
  assert.deepEqual(one.yAxis[1].data, ['failed']);
  assert.equal(marks.label.formatter({ data: marks.data[0] }), 'k 1');
  const alone = paretoChart(data, fronts[1], { xlog: false, ylog: false, own: true });
  assert.notDeepEqual(ends(alone.yAxis), ends(two.yAxis));
});
