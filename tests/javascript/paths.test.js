// SPDX-License-Identifier: Apache-2.0
/** Paths in the plane, in space and over time. */
import assert from 'node:assert/strict';
import test from 'node:test';
import { withHealth } from '../../operator/slamhive/dashboard/static/charts/health.js';
import { drawing, projector, scene, toSvg } from '../../operator/slamhive/dashboard/static/charts/space.js';
import {
  errorRange,
  overTime,
  pieces,
  plane,
  shared,
  since,
  spanOf,
  truthsOf,
} from '../../operator/slamhive/dashboard/static/charts/trajectory.js';
import { inks } from '../../operator/slamhive/dashboard/static/core/figure.js';
import { ramp, SCALE } from '../../operator/slamhive/dashboard/static/core/scale.js';
import { HOSTILE } from './helpers.js';

const track = { t: [0, 1, 2, 3], x: [0, 4, 4, 0], y: [0, 0, 2, 2], z: [0, 0, 0, 1] };
const path = { name: 'run', track, colour: '#123456', width: 2 };
const VIEW = { azimuth: -90, elevation: 90, zoom: 1 };

const PIECES = [
  ['no pose', [], []],
  ['one pose', [5], [[0, 1]]],
  ['even steps', [0, 1, 2], [[0, 3]]],
  [
    'a gap',
    [0, 1, 2, 3, 60, 61],
    [
      [0, 4],
      [4, 6],
    ],
  ],
  ['two poses far apart', [0, 1000], [[0, 2]]],
  ['equal stamps', [0, 0, 0], [[0, 3]]],
];
for (const [what, t, expected] of PIECES)
  test(`a path of ${what} is in ${expected.length} pieces`, () => assert.deepEqual(pieces({ t }), expected));

test('a line is broken at each gap', () => {
  const [{ data }] = overTime(
    [{ name: 'a', t: [0, 1, 2, 3, 60], values: [1, 2, null, 4, 5] }],
    'y',
    'x',
  ).series;
  assert.deepEqual(data, [
    [0, 1],
    [1, 2],
    [2, '-'],
    [3, 4],
    ['-', '-'],
    [60, 5],
  ]);
});

test('losses and warnings stand behind an error, by its clock', () => {
  const option = overTime([{ name: 'error', t: [0, 9], values: [1, 2] }], 'y', 'x');
  assert.equal(withHealth(option, {}, 100), option);
  assert.equal(withHealth(option, undefined, 100), option);
  const result = { healthLosses: [{ begin: 103, end: 105 }], healthWarnings: [{ begin: 102, end: 104 }] };
  const { series, legend } = withHealth(option, result, 100);
  assert.deepEqual(
    series.map((/** @type {any} */ { name, markArea }) => [name, markArea?.data]),
    [
      ['error', undefined],
      ['lost', [[{ xAxis: 3 }, { xAxis: 5 }]]],
      [
        'warned',
        [
          [
            { xAxis: 2, y: 32 },
            { xAxis: 4, y: 40 },
          ],
        ],
      ],
    ],
  );
  assert.ok(legend);
});

test('one line has no legend unless it is asked for', () => {
  const lines = [{ name: 'a', t: [0], values: [1] }];
  assert.equal(overTime(lines, 'y', 'x').legend, undefined);
  assert.ok(overTime(lines, 'y', 'x', { legend: true }).legend);
  assert.ok(overTime([...lines, ...lines], 'y', 'x').legend);
});

test('colours of errors run from none to the largest and no further', () => {
  const ends = [SCALE[0], SCALE.at(-1)];
  assert.deepEqual([ramp(0), ramp(1)], ends);
  assert.deepEqual([ramp(-5), ramp(7)], ends);
  assert.match(ramp(0.5), /^rgb\(\d+,\d+,\d+\)$/);
});

test('errors of poses without ground truth do not count', () => {
  assert.deepEqual(errorRange([{ error: [null, 3, 1] }, { error: null }, {}]), { low: 0, high: 3 });
  assert.equal(errorRange([{ error: [null] }, {}]), null);
  assert.equal(errorRange([]), null);
});

test('errors of a long path are ranged without a limit of arguments', () => {
  const error = Array.from({ length: 300_000 }, (_, index) => index);
  assert.deepEqual(errorRange([{ error }]), { low: 0, high: 299_999 });
});

test('a metre of a plane is equally long on both axes', () => {
  for (const [width, height] of [
    [800, 400],
    [360, 400],
    [400, 1200],
  ]) {
    const { grid, xAxis, yAxis } = plane([path], [], 'x', 'y', null)({ width, height });
    const across = (width - grid.left - grid.right) / (xAxis.max - xAxis.min);
    const up = (height - grid.top - grid.bottom) / (yAxis.max - yAxis.min);
    assert.ok(Math.abs(across / up - 1) < 1e-9);
    assert.ok(xAxis.min <= 0 && xAxis.max >= 4 && yAxis.min <= 0 && yAxis.max >= 2);
  }
});

test('control points lie over the path, coloured by their errors, and within the axes', () => {
  const surveyed = { t: [0, 2, 9], x: [0, 4, 20], y: [0, 2, 2], z: [0, 0, 1], error: [0.5, 2, null] };
  const range = errorRange([track, surveyed]);
  assert.deepEqual(range, { low: 0, high: 2 });
  const size = { width: 800, height: 400 };
  const { series, visualMap, xAxis } = plane([path], [], 'x', 'z', range, surveyed)(size);
  const place = series.findIndex((one) => one.name === 'control points');
  assert.deepEqual(series[place].data, [
    [0, 0, 0.5],
    [4, 0, 2],
    [20, 1, '-'],
  ]);
  assert.ok(visualMap.seriesIndex.includes(place));
  assert.ok(xAxis.max >= 20);
  const bare = plane([path], [], 'x', 'y', null)(size);
  assert.ok(!bare.series.some((one) => one.name === 'control points'));
});

test('poses of the IMU and of the LiDAR have a ground truth each, which says whose it is', () => {
  const low = { ...track, t: [1, 2, 3], x: [4, 4, 0], y: [0, 2, 2], z: [-0.3, -0.3, 0.7] };
  const lidar = { of: 'kiss-icp', reference: track };
  const truths = truthsOf([lidar, { of: 'rko-lio', reference: low }, { ...lidar, of: 'genz-icp' }]);
  assert.deepEqual(
    truths.map((one) => [one.name, one.track]),
    [
      ['ground truth of kiss-icp, genz-icp', track],
      ['ground truth of rko-lio', low],
    ],
  );
  const { series } = plane([path], truths, 'x', 'z', null)({ width: 800, height: 400 });
  assert.deepEqual(series[1].data[0], [4, -0.3]);
  assert.deepEqual(
    truthsOf([lidar, { ...lidar, of: 'genz-icp' }, { of: 'x', reference: null }]).map((one) => one.name),
    ['ground truth'],
  );
});

test('each dataset has its own ground truth, however near they are', () => {
  const hall = { of: 'kiss-icp', dataset: 'hall', reference: track };
  const yard = { ...hall, dataset: 'yard' };
  const other = { of: 'rko-lio', dataset: 'yard', reference: { ...track, z: track.z.map((z) => z - 1) } };
  const names = (...runs) => truthsOf(runs).map((one) => one.name);
  assert.deepEqual(names(hall, hall), ['ground truth']);
  assert.deepEqual(names(hall, yard), ['ground truth of hall', 'ground truth of yard']);
  assert.deepEqual(names(hall, yard, other), [
    'ground truth of hall',
    'ground truth of kiss-icp on yard',
    'ground truth of rko-lio on yard',
  ]);
});

test('a ring says where a path begins and a dot where it ends, also where it is closed', () => {
  const named = (option) =>
    option({ width: 800, height: 400 })
      .series.flatMap((one) => one.data)
      .filter((one) => one?.name);
  const [start, end] = named(plane([path], [], 'x', 'z', null));
  assert.deepEqual([start.name, start.value, end.name, end.value], ['start', [0, 0], 'end', [0, 1]]);
  assert.equal(start.itemStyle.color, path.colour);
  assert.notEqual(named(plane([path], [], 'x', 'z', { low: 0, high: 1 }))[0].itemStyle.color, path.colour);
  assert.deepEqual(
    named(plane([{ name: 'a', track: { t: [], x: [], y: [], z: [] } }], [], 'x', 'y', null)),
    [],
  );
  const texts = drawing(scene([path], null), VIEW, 400, 300, inks(false)).texts.map((one) => one.text);
  assert.ok(texts.includes('start') && texts.includes('end'));
});

test('a plane without a pose has axes of its own, one of a single pose some extent', () => {
  const of = (t, x) =>
    plane([{ name: 'a', track: { t, x, y: x, z: x } }], [], 'x', 'y', null)({ width: 400, height: 400 });
  assert.equal(of([], []).xAxis.min, undefined);
  const { xAxis } = of([0], [7]);
  assert.ok(xAxis.min < 7 && xAxis.max > 7);
});

const clock = (dataset, start, of) => ({ dataset, clock: { start, of } });
test('runs of a dataset share the best known clock, of equal ones the earliest', () => {
  const { zeros, title } = shared([
    clock('a', 9, 'estimate'),
    clock('a', 5, 'groundTruth'),
    clock('a', 4, 'groundTruth'),
    clock('b', 1, 'recording'),
  ]);
  assert.deepEqual(
    [...zeros],
    [
      ['a', 4],
      ['b', 1],
    ],
  );
  assert.equal(title, 'time since the recording began or the ground truth began [s]');
});

test('datasets may be called anything', () => {
  for (const name of HOSTILE) assert.equal(shared([clock(name, 3, 'estimate')]).zeros.get(name), 3);
});

test('times are counted from a zero, lines span all of theirs', () => {
  assert.deepEqual(since([5, 6.5], 5), [0, 1.5]);
  assert.deepEqual(
    spanOf([
      [3, 9],
      [1, 4],
    ]),
    [1, 9],
  );
});

test('a scene holds all paths, in pieces of one colour', () => {
  const found = scene([path, { ...path, error: [0, 1, null, 3] }], { low: 0, high: 3 });
  assert.deepEqual(
    [found.low, found.high, found.middle],
    [
      [0, 0, 0],
      [4, 2, 1],
      [2, 1, 0.5],
    ],
  );
  assert.ok(found.chunks.length >= 3);
  assert.equal(scene([], null), null);
  assert.equal(scene([{ ...path, track: { t: [], x: [], y: [], z: [] } }], null), null);
});

test('a single pose is a dot', () => {
  const [dot] = scene([{ ...path, track: { t: [0], x: [1], y: [2], z: [3] } }], null).chunks;
  assert.deepEqual(
    [dot.points, dot.width],
    [
      [
        [1, 2, 3],
        [1, 2, 3],
      ],
      4,
    ],
  );
});

test('seen from above x goes right and y up, lengths stay true', () => {
  const project = projector(scene([path], null), VIEW, 400, 300);
  const [[ax, ay], [bx, by], [cx, cy]] = [
    [0, 0, 0],
    [4, 0, 0],
    [4, 2, 0],
  ].map(project);
  assert.ok(bx > ax && Math.abs(by - ay) < 1e-6 && cy < by && Math.abs(cx - bx) < 1e-6);
  assert.ok(Math.abs((bx - ax) / (by - cy) - 2) < 1e-6);
});

test('all of a scene is on the paper, from whatever side', () => {
  const found = scene([path], null);
  for (let azimuth = -180; azimuth < 180; azimuth += 45)
    for (const elevation of [-90, -30, 0, 30, 90])
      for (const { points } of drawing(found, { azimuth, elevation, zoom: 1 }, 400, 300, inks(false)).lines)
        for (const [x, y] of points)
          assert.ok(x >= 0 && x <= 400 && y >= 0 && y <= 300, `${azimuth} ${elevation}`);
});

test('what is under the others is drawn before them', () => {
  const found = scene([path, { ...path, colour: 'under', under: true }], null);
  const drawn = drawing(found, VIEW, 400, 300, inks(false)).lines.map((one) => one.colour);
  assert.ok(drawn.lastIndexOf('under') < drawn.indexOf('#123456'));
});

test('the picture of a scene is SVG, whatever its texts', () => {
  for (const text of HOSTILE) {
    const word = { text, at: [1, 2], colour: text };
    const svg = toSvg(
      {
        lines: [
          {
            points: [
              [0, 0],
              [1, 1],
            ],
            colour: text,
            width: 1,
          },
        ],
        texts: [word],
      },
      10,
      10,
      text,
    );
    assert.match(svg, /^<svg xmlns=/);
    assert.doesNotMatch(svg, /<(img|script|svg onload)/);
    assert.equal((svg.match(/"/g)?.length ?? 0) % 2, 0);
  }
});
