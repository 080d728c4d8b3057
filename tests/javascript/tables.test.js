// SPDX-License-Identifier: Apache-2.0
/** Tables, their CSV, choices and filters, without a browser. */
import assert from 'node:assert/strict';
import test from 'node:test';
import { Query } from '../../operator/slamhive/dashboard/static/core/address.js';
import { fileName, toCsv } from '../../operator/slamhive/dashboard/static/core/figure.js';
import {
  columnOptions,
  isEmpty,
  isMeasure,
  isNumeric,
  shownByFilters,
} from '../../operator/slamhive/dashboard/static/core/filters.js';
import { Choice, Fault, Link, Notes, Table } from '../../operator/slamhive/dashboard/static/core/parts.js';
import {
  mostVaried,
  published,
  questions,
  quoted,
} from '../../operator/slamhive/dashboard/static/core/questions.js';
import { pointsOf } from '../../operator/slamhive/dashboard/static/core/sitetable.js';
import { suspectOf } from '../../operator/slamhive/dashboard/static/core/suspects.js';
import { settingsOf } from '../../operator/slamhive/dashboard/static/pages/explore.js';
import { failureText, groupTable, onPhone } from '../../operator/slamhive/dashboard/static/pages/groups.js';
import { cpuColumn } from '../../operator/slamhive/dashboard/static/core/format.js';
import { loads } from '../../operator/slamhive/dashboard/static/pages/loads.js';
import { folded } from '../../operator/slamhive/dashboard/static/core/runrows.js';
import { Bar, Spread } from '../../operator/slamhive/dashboard/static/pages/sweepcards.js';
import { trackTable } from '../../operator/slamhive/dashboard/static/pages/tracks.js';
import { answer, found, HOSTILE, text } from './helpers.js';

const FIELDS = [
  [null, ''],
  [undefined, ''],
  [Number.NaN, ''],
  [Number.NEGATIVE_INFINITY, ''],
  [0.1 + 0.2, '0.30000000000000004'],
  [-3, '-3'],
  [false, 'false'],
  ['a,b', '"a,b"'],
  ['say "x"', '"say ""x"""'],
  ['a\r\nb', '"a\r\nb"'],
  ['-3.5e2', '-3.5e2'],
  ['+1', '+1'],
  ['=1+1', "'=1+1"],
  ['-1+1', "'-1+1"],
  ['@SUM(A1)', "'@SUM(A1)"],
  ['\tx', "'\tx"],
  ['=a,b', '"\'=a,b"'],
  ["'=1", "''=1"],
  ["'quoted'", "'quoted'"],
];
for (const [value, expected] of FIELDS)
  test(`${JSON.stringify(value) ?? value} in CSV is ${JSON.stringify(expected)}`, () =>
    assert.equal(toCsv([{ name: 'a' }], [{ a: value }]), `a\n${expected}`));

test('CSV has the columns in their order, whatever rows have', () => {
  assert.equal(toCsv([{ name: 'b' }, { name: 'a' }], [{ a: 1, c: 3 }, { b: 2 }]), 'b,a\n,1\n2,');
});

const FILES = [
  ['Error over time', 'Error-over-time.png'],
  ['../../etc/passwd', 'etc-passwd.png'],
  ['日本', 'chart.png'],
  ['', 'chart.png'],
  ['...', 'chart.png'],
  ['a/b\\c:d', 'a-b-c-d.png'],
];
for (const [title, expected] of FILES)
  test(`a picture of ${title || 'nothing'} is called ${expected}`, () =>
    assert.equal(fileName(title, 'png'), expected));

test('files have names of a bearable length', () => assert.ok(fileName('x'.repeat(5000), 'csv').length < 90));

test('a table shows texts as texts, cut, with all of them at hand', () => {
  for (const hostile of HOSTILE) {
    const table = Table({ columns: [{ name: 'a' }], rows: [{ a: hostile }], caption: hostile });
    const [shown] = found(table, 'td');
    assert.equal(text(shown), hostile.length > 48 ? `${hostile.slice(0, 46)}…` : hostile);
    assert.equal(shown.props.title, hostile.length > 48 ? hostile : null);
    assert.equal(found(table, 'img').length + found(table, 'script').length + found(table, 'svg').length, 0);
  }
});

test('a table says by which column it is sorted, and sorts the other way round', () => {
  const asked = [];
  const columns = [{ name: 'a' }, { name: 'b' }, { name: 'c', sortable: false }];
  const sorted = (sort) => Table({ columns, rows: [], caption: '', sort, onSort: (by) => asked.push(by) });
  for (const sort of ['a', '-a', 'b']) found(sorted(sort), 'button')[0].props.onClick();
  assert.deepEqual(asked, ['-a', 'a', 'a']);
  assert.deepEqual(
    found(sorted('-a'), 'th').map((one) => one.props['aria-sort']),
    ['descending', null, null],
  );
  assert.equal(found(sorted('a'), 'button').length, 2);
});

test('numbers of a table stand to the right, in the shown unit', () => {
  const columns = [
    { name: 'a', kind: 'integer', factor: 0.5 },
    { name: 'b', show: (value, row) => `${value} of ${row.a}` },
  ];
  const cells = found(Table({ columns, rows: [{ a: 3, b: 'x' }], caption: '' }), 'td');
  assert.deepEqual(cells.map(text), ['1.5', 'x of 3']);
  assert.deepEqual(
    cells.map((one) => one.props.class),
    ['number stays stays0', ''],
  );
});

test('points of a column stand below one another, with no digit that nobody measured', () => {
  const rows = [0.0132, 0.02053, 3, null, 1e-9].map((a) => ({ of: 'x', a }));
  const cells = found(
    Table({ columns: [{ name: 'of' }, { name: 'a', kind: 'number' }], rows, caption: '' }),
    'td',
  );
  assert.deepEqual(
    cells.filter((_, at) => at % 2).map((one) => [text(one), one.props['data-blank']]),
    [
      ['0.0132', '\u2007'],
      ['0.02053', null],
      ['3', `\u2008${'\u2007'.repeat(5)}`],
      ['–', null],
      ['1.000e-9', null],
    ],
  );
});

test('a choice keeps what the address says though it is not offered', () => {
  const options = [['a', 'A'], { label: 'more', options: ['b'] }];
  const values = (value) =>
    found(Choice({ label: 'x', value, options, onChange: () => {} }), 'option').map((one) => one.props.value);
  assert.deepEqual(values('b'), ['a', 'b']);
  assert.deepEqual(values('gone'), ['gone', 'a', 'b']);
});

test('a menu of very many is searched: 200 metrics are no list to scroll', () => {
  const metrics = Array.from({ length: 200 }, (_, at) => [`metrics.m${at}`, `m${at}`]);
  const options = [
    { label: 'errors', options: [['ate.rmse', 'ATE [m]']] },
    { label: 'metrics', options: metrics },
  ];
  const chosen = [];
  const choice = (value) =>
    Choice({ label: 'Measured by', value, options, onChange: (one) => chosen.push(one) });
  const offered = (value) => found(found(choice(value), 'select'), 'option').map((one) => one.props.value);
  assert.deepEqual(offered('ate.rmse'), ['ate.rmse']);
  assert.deepEqual(offered('metrics.m7'), ['metrics.m7', 'ate.rmse']);
  assert.equal(found(found(choice('ate.rmse'), 'datalist'), 'option').length, 200);
  found(choice('ate.rmse'), 'input')[0].props.onChange({ target: { value: 'metrics.m9' } });
  assert.deepEqual(chosen, ['metrics.m9']);
});

test('runs are measured by what came of them, not by seed, repetition or setting', () => {
  const column = (name, group, kind = 'number') => ({ name, group, kind });
  const all = [
    column('seed', 'run', 'integer'),
    column('repetition', 'run', 'integer'),
    column('parameters.n', 'parameters'),
    column('finished', 'run', 'time'),
    column('ate.rmse', 'errors'),
    column('metrics.loops', 'metrics', 'integer'),
    column('status', 'result', 'text'),
  ];
  assert.deepEqual(
    all.filter(isMeasure).map((one) => one.name),
    ['ate.rmse', 'metrics.loops'],
  );
});

test('a link with a modifier key is left to the browser', () => {
  const [link] = found(Link({ href: '/runs', children: 'x' }), 'a');
  for (const key of ['ctrlKey', 'metaKey', 'shiftKey', 'button'])
    link.props.onClick({ [key]: 1, preventDefault: () => assert.fail('taken from the browser') });
});

test('faults and notes are shown only where there are some', () => {
  assert.equal(text(Fault({ error: { message: '<b>' } })), '<b>');
  assert.ok(!Fault({ error: null }));
  assert.ok(!Notes({ notes: [] }) && !Notes({ notes: undefined }));
  assert.equal(text(Notes({ notes: ['a', 'b'] })), 'ab');
});

test('columns are offered in groups, those that never vary are not', () => {
  const { items } = answer('/columns');
  const offered = columnOptions(items).flatMap((group) => group.options.map(([name]) => name));
  for (const column of items)
    assert.equal(
      offered.includes(column.name),
      column.kind !== 'other' && column.distinct !== 1,
      column.name,
    );
  assert.deepEqual(columnOptions(undefined), []);
  assert.ok(columnOptions(items, isNumeric).every((group) => group.options.length > 0));
});

test('an error is shown by the filters if it is about one of them', () => {
  const query = Query.parse('algorithm=a&coverage%3E=1&x=y');
  const shown = (field) => shownByFilters(field === undefined ? null : { message: '', field }, query);
  assert.deepEqual(['where', 'algorithm', 'coverage', 'x', null, undefined].map(shown), [
    true,
    true,
    true,
    false,
    false,
    false,
  ]);
});

test('nothing is known only where nothing is left out either', () => {
  assert.ok(isEmpty({ data: { rows: 0, items: [], notes: [] } }));
  assert.ok(!isEmpty({ data: { rows: 0, items: [], notes: ['2 are left out'] } }));
  assert.ok(!isEmpty({ data: null }));
});

const QUOTED = [
  ['ate.rmse', 'ate.rmse'],
  ['rpe[0].rmse', '`rpe[0].rmse`'],
  ['label.a b', '`label.a b`'],
  ['1x', '`1x`'],
];
for (const [name, expected] of QUOTED)
  test(`${name} stands in a condition as ${expected}`, () => assert.equal(quoted(name), expected));

const column = (name, group, ...values) => ({
  name,
  title: name,
  kind: 'text',
  group,
  count: 9,
  distinct: values.length,
  values: values.map((value) => ({ value, count: 1 })),
});

test('questions that the runs cannot answer say what they need', () => {
  const asked = questions([]);
  assert.ok(asked.every((one) => one.settings === null && one.needs));
  const loops = questions([column('metrics.loops', 'metrics', 1, 2)]).find(
    (one) => one.title === 'Loops vs ATE',
  );
  assert.equal(loops.settings.x, 'metrics.loops');
});

test('a question about loops says that datasets with one value of them do not answer it', () => {
  const needs = (columns) => questions(columns).find((one) => one.title === 'Loops vs ATE').needs;
  const all = 'datasets that differ in an attribute loops, or runs in a metric or parameter of that name';
  assert.equal(needs([]), all);
  const alike = [column('dataset.attributes.loops', 'dataset', 0.5)];
  assert.equal(needs(alike), `${all}; the runs here have loops 0.5 alone`);
});

test('questions are asked apart for each dataset where there are several', () => {
  const rates = column('input.frameRate', 'input', 5, 10);
  const of = (columns) => questions(columns).find((one) => one.title === 'Frame rate vs CPU').settings;
  assert.deepEqual(
    [of([rates]).facet, of([rates, column('dataset', 'dataset', 'a', 'b')]).facet],
    [undefined, 'dataset'],
  );
});

test("the paper's tables are offered where its runs are", () => {
  assert.equal(published([column('label.source', 'labels', 'slam-hive')]).length, 2);
  assert.equal(published([column('label.source', 'labels', 'other')]).length, 0);
  assert.equal(published([]).length, 0);
});

test('a suspect belongs to what has its keys, as far as they are known', () => {
  const suspects = [{ keys: { algorithm: 'a', sensors: 'rgbd', dataset: 'hall' } }];
  assert.ok(suspectOf(suspects, { algorithm: 'a', sensors: 'rgbd' }));
  assert.ok(suspectOf(suspects, { algorithm: 'a', sensors: 'rgbd', dataset: 'hall' }));
  assert.ok(!suspectOf(suspects, { algorithm: 'a', sensors: 'rgbd', dataset: 'yard' }));
  assert.ok(!suspectOf(suspects, { dataset: 'hall' }));
});

test('failures are said in words', () => {
  assert.equal(failureText({ Partial: 4, Lost: 12000 }), '4 Partial, 12,000 Lost');
  assert.equal(failureText({}), 'none');
  assert.equal(failureText(null), 'none');
});

test('a table of groups has the keys that differ, n, failures and the figures', () => {
  const data = answer('/analysis/aggregate');
  const { columns, rows } = groupTable(data, ['median']);
  const names = columns.map((one) => one.name);
  assert.deepEqual(
    names.filter((name) => name.startsWith('ate')),
    ['ate.rmse median'],
  );
  assert.ok(names.includes('parameters.nFeatures') && names.includes('failures'));
  assert.equal(rows.length, data.groups.length);
  assert.equal(rows[0]['ate.rmse median'], data.groups[0].figures['ate.rmse'].median);
});

test('a phone tells algorithm, setting and ATE of groups before their counts and their only sensors', () => {
  const titled = (names) => names.map((name) => ({ name }));
  const columns = titled([
    'algorithm',
    'sensors',
    'maxRange',
    'n',
    'runs',
    'ate.rmse mean',
    'ate.rmse median',
  ]);
  const row = (algorithm, sensors, maxRange) => ({ algorithm, sensors, maxRange });
  const first = (rows) => onPhone({ columns, rows }).map((one) => one.name);
  const rows = [row('kiss-icp', 'lidar', 30), row('kiss-icp', 'lidar', 100), row('rko-lio', 'inertial', 30)];
  assert.deepEqual(first(rows).slice(0, 3), ['algorithm', 'maxRange', 'ate.rmse median']);
  assert.equal(first(rows).length, columns.length);
  assert.equal(first([...rows, row('kiss-icp', 'rgbd', 30)])[1], 'sensors');
});

test('groups on recordings with open findings are marked', () => {
  const data = answer('/analysis/aggregate');
  const has = () => groupTable(data).columns.some((one) => one.name === 'findings');
  assert.ok(!has());
  data.groups[0].findings = ['stamps.gap', 'truth.jump'];
  assert.ok(has());
  assert.equal(groupTable(data).rows[0].findings, 'stamps.gap, truth.jump');
});

test('poses without an error have none in their table', () => {
  const track = { t: [0, 1], x: [1, 2], y: [3, 4], z: [5, 6] };
  assert.deepEqual(trackTable([{ name: 'r', track }]).rows[1], {
    run: 'r',
    t: 1,
    x: 2,
    y: 4,
    z: 6,
    error: null,
  });
});

test('load is drawn on the clock of the dataset where it is known, on its own otherwise', () => {
  const [on, off] = [answer('/runs/run-002/usage'), answer('/runs/run-000/usage')];
  const runs = [
    { name: 'a', usage: on, t: on.stamp },
    { name: 'b', usage: off, t: off.stamp },
  ];
  const charts = loads(runs, { title: 'time since', span: [0, 9] });
  assert.equal(charts[0].option.yAxis.name, 'CPU [cores]');
  const read = loads([{ ...runs[0], usage: { ...on, readerShare: 0.4 } }], null);
  assert.equal(read[0].option.yAxis.name, 'CPU with the reader [cores]');
  assert.deepEqual(
    charts.map((one) => one.ofDataset),
    [true, true, false, false],
  );
  assert.equal(charts[1].table.rows[0].memory, on.memory[0] / 2 ** 20);
  const first = charts.map((one) => one.option.series[0].data[0][1]);
  assert.deepEqual(first, [on.cpu[0], on.memory[0] / 2 ** 20, off.cpu[0], off.memory[0] / 2 ** 20]);
});

test('memory that was not measured is no 0', () => {
  const usage = { ...answer('/runs/run-000/usage'), t: [0], cpu: [1], memory: [null], anonymous: null };
  assert.equal(loads([{ name: 'a', usage, t: null }], null)[1].table.rows[0].memory, null);
});

test('the first look at charts is over the setting with most values', () => {
  const column = (name, group, distinct) => ({ name, group, distinct });
  const criterion = column('parameters.criterion', 'parameters', 2);
  const voxel = column('parameters.voxelSize', 'parameters', 5);
  const rate = column('input.frameRate', 'input', 5);
  assert.equal(mostVaried([column('ate.rmse', 'errors', 90), criterion, voxel, rate]), voxel);
  assert.equal(mostVaried([column('parameters.k', 'parameters', 1)]), undefined);
});

test('Explore opens with what was swept, by algorithm, not with what algorithms have by default', () => {
  const items = [
    column('algorithm', 'run', 'kiss-icp', 'genz-icp', 'rko-lio'),
    { ...column('parameters.minRange', 'parameters', 0, 0.3, 1), kind: 'number' },
    { ...column('parameters.maxRange', 'parameters', 30, 100), kind: 'number' },
    { ...column('usage.cpu.meanCores', 'usage', 1, 2), kind: 'number' },
  ];
  const opened = (search, varied = ['parameters.maxRange']) => {
    const { x, colour } = settingsOf(Query.parse(search), { items, varied, rows: 9 });
    return [x, colour];
  };
  assert.deepEqual(opened(''), ['parameters.maxRange', 'algorithm']);
  assert.deepEqual(opened('x=parameters.minRange'), ['parameters.minRange', ''], 'as the address says');
  assert.deepEqual(opened('kind=contour'), ['parameters.maxRange', '']);
  assert.equal(opened('', [])[0], 'usage.cpu.meanCores', 'nothing was swept');
  const partly = { ...column('parameters.voxelSize', 'parameters', 1, 2, 3, 4), kind: 'number', count: 2 };
  items.push(partly);
  const both = ['parameters.voxelSize', 'parameters.maxRange'];
  assert.equal(opened('', both)[0], 'parameters.maxRange', 'what all runs have comes first');
  assert.equal(opened('', [partly.name])[0], 'usage.cpu.meanCores', 'others would be missing');
  assert.equal(opened('kind=line', [partly.name])[0], partly.name, 'loads make no groups');
});

test('the bar of a sweep is as red as its runs failed, and as long as it is finished', () => {
  const parts = (statuses, share) =>
    found(Bar({ statuses, share, title: 'x' }), 'span').map(({ props }) => [props.class, props.style.width]);
  assert.deepEqual(parts({ AlgorithmFailed: 3 }), [['bad', '100%']]);
  assert.deepEqual(parts({ OutOfMemory: 1, Running: 4, Tracked: 3 }, 0.5), [
    ['good', '37.5%'],
    ['bad', '12.5%'],
  ]);
  assert.deepEqual(parts({}), []);
  assert.match(found(Bar({ statuses: { Lost: 2 }, title: 'x' }), 'div')[0].props['aria-label'], /2 Lost/);
});

test('the picture of a sweep says in words too how errors spread, and who never tracked', () => {
  const some = { algorithm: 'a'.repeat(63), low: 1, median: 2, high: 1e9, failed: 0 };
  const none = { algorithm: 'b', low: null, median: null, high: null, failed: 7 };
  const drawn = Spread({ sweep: { algorithms: ['a', 'b', 'c'], spread: [some, none] } });
  const [, ratios, , , silent, failed] = found(drawn, 'span').map(
    ({ props }) => props['aria-label'] ?? text(props.children),
  );
  assert.equal(ratios, 'ATE 1 to 1.00e9 times the smallest, median 2');
  assert.deepEqual([silent, failed], ['no run tracked', '7 failed']);
  assert.ok(found(drawn, 'i').every(({ props }) => Number.parseFloat(props.style.left) >= 0));
  assert.match(text(drawn), /left out: 1 more algorithm/);
  assert.ok(!Spread({ sweep: { algorithms: [], spread: [] } }));
});

test('what all runs share stands once above their table, but how they ended and when', () => {
  const columns = ['uid', 'run', 'finished', 'status', 'dataset', 'usage.gpu'].map((name) => ({
    name,
    title: name,
  }));
  const items = [{ uid: '1', run: 'a', status: 'Lost', dataset: 'hall', finished: 1, 'usage.gpu': null }];
  const same = ['status', 'dataset', 'usage.gpu'];
  const all = columns.map((one) => one.name);
  const { columns: left, said } = folded({ columns, items, same }, all, ['run', 'finished', 'status']);
  assert.deepEqual([left.map((one) => one.name), said], [['run', 'finished', 'status'], 'hall']);
  assert.equal(folded({ columns, items, same: [] }, all, []).said, '');
});

test('what runs cost is told by cores where the clock set the pace alone', () => {
  const pace = (value) => ({ name: 'input.pace', values: [{ value, count: 1 }] });
  const seconds = { name: 'usage.cpu.secondsPerDataSecond' };
  for (const other of ['Lockstep', 'Stepped']) assert.equal(cpuColumn([pace(other), seconds]), seconds.name);
  assert.equal(cpuColumn([pace('Realtime'), seconds]), 'usage.cpu.meanCores');
  assert.equal(cpuColumn([]), 'usage.cpu.meanCores');
});

test('a site says that readers are mixed where CPU is drawn, by runs that succeeded', async () => {
  const cpu = 'usage.cpu.seconds';
  const stored = {
    'usage.includesReader': [true, true, false],
    phase: ['Succeeded', 'Succeeded', 'Failed'],
    'ate.rmse': [0.1, 0.2, null],
    [cpu]: [1, 2, 3],
    ...Object.fromEntries(['status', 'id', 'uid', 'run'].map((name) => [name, ['a', 'b', 'c']])),
  };
  const drawn = async (y, phase) => {
    const columns = Object.fromEntries(
      Object.entries({ ...stored, phase }).map(([name, values]) => [name, { name, blocks: [{ values }] }]),
    );
    const mixed = [{ column: 'usage.includesReader', owner: null }];
    const table = { rows: 3, columns, notes: [], mixed, conditions: {} };
    const points = await pointsOf(table, new Query().with({ x: 'id', y }), assert.fail);
    return points.mixed.map((one) => one.column);
  };
  const succeeded = Array(3).fill('Succeeded');
  assert.deepEqual(await drawn(cpu, succeeded), ['usage.includesReader']);
  assert.deepEqual(await drawn(cpu, stored.phase), []);
  assert.deepEqual(await drawn('ate.rmse', succeeded), []);
});
