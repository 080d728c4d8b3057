// SPDX-License-Identifier: Apache-2.0
/** Addresses: what is read of one and written to it. */
import assert from 'node:assert/strict';
import test from 'node:test';
import { address, Query } from '../../operator/slamhive/dashboard/static/core/address.js';
import { csvOf, fetchJson } from '../../operator/slamhive/dashboard/static/core/api.js';
import { readView, writeView } from '../../operator/slamhive/dashboard/static/core/space.js';
import { HOSTILE } from './helpers.js';

const PARSED = [
  ['', []],
  ['?', []],
  ['a=1', [['a', '1']]],
  [
    '?a=1&a=2',
    [
      ['a', '1'],
      ['a', '2'],
    ],
  ],
  ['a=b=c', [['a', 'b=c']]],
  ['a=', [['a', '']]],
  ['a', [['a', null]]],
  ['&&a=1&', [['a', '1']]],
  ['a+b=c+d', [['a b', 'c d']]],
  ['a%2Bb=%2B', [['a+b', '+']]],
  ['a=%', [['a', '%']]],
  ['%E0%A4%A=x', [['%E0%A4%A', 'x']]],
  ['coverage>=0.9', [['coverage>', '0.9']]],
  ['x=%F0%9F%98%80', [['x', '😀']]],
];
for (const [search, pairs] of PARSED)
  test(`the query ${search || '(none)'} is read`, () => assert.deepEqual(Query.parse(search).pairs, pairs));

for (const text of HOSTILE)
  test(`${JSON.stringify(text).slice(0, 40)} comes back from an address, as name and as value`, () => {
    const query = new Query([
      [text, 'x'],
      ['where', text],
      [text, text],
    ]);
    assert.deepEqual(Query.parse(`?${query}`).pairs, query.pairs);
    assert.deepEqual(new URL(address('/runs', query), 'http://x').searchParams.getAll('where'), [text]);
  });

test('half a character does not break the page', () => {
  assert.equal(String(new Query([['where', 'a\ud83d']])), 'where=a%EF%BF%BD');
});

test('a parameter without an equals sign stays without one', () => {
  assert.equal(String(Query.parse('?a&b=1')), 'a&b=1');
});

test('the first value of a name is read, or another where there is none', () => {
  const query = Query.parse('a=1&a=2&b&c=');
  assert.deepEqual(
    [query.get('a'), query.get('b', 'x'), query.get('c', 'x'), query.get('d', 'x')],
    ['1', 'x', '', 'x'],
  );
  assert.deepEqual([query.all('a'), query.all('b'), query.all('d')], [['1', '2'], [''], []]);
});

test('what is set anew replaces all of its name; nothing leaves it out', () => {
  const query = Query.parse('a=1&b=2&a=3');
  assert.equal(String(query.with({ a: 4 })), 'b=2&a=4');
  assert.equal(String(query.with({ a: ['x', '', null, 0] })), 'b=2&a=x&a=0');
  for (const none of [null, undefined, '', []]) assert.equal(String(query.with({ a: none })), 'b=2');
  assert.equal(String(query), 'a=1&b=2&a=3');
});

test('names that every object has are names like others', () => {
  const query = Query.parse('constructor=1&toString=2&__proto__=3');
  assert.equal(String(query.with({ sort: 'x' })), 'constructor=1&toString=2&__proto__=3&sort=x');
});

test('filters are added and taken away by their place', () => {
  const query = Query.parse('a=1&a=1').and('b', '2');
  assert.equal(String(query), 'a=1&a=1&b=2');
  assert.equal(String(query.without(query.pairs[0])), 'a=1&b=2');
});

test('settings of pages are no filters', () => {
  const query = Query.parse('x=1&y=2&algorithm=a&where=b&embed=1&coverage%3E=1&superseded=1');
  assert.equal(String(query.filters()), 'algorithm=a&where=b&coverage%3E=1&superseded=1');
});

test('addresses are made of a path and settings', () => {
  assert.equal(address('/runs'), '/runs');
  assert.equal(address('/runs', {}), '/runs');
  assert.equal(address('/runs', { a: null, b: 'x y', c: [1, 2] }), '/runs?b=x%20y&c=1&c=2');
  assert.equal(address('/runs', new Query([['a', '1']])), '/runs?a=1');
});

test('the table behind an address is its CSV', () => {
  assert.equal(csvOf('/api/v1/runs'), '/api/v1/runs?format=csv');
  assert.equal(csvOf('/api/v1/runs?a=1'), '/api/v1/runs?a=1&format=csv');
});

const VIEWS = ['', null, 'x', '1,2', '1,2,', 'NaN,0,1', '1,2,Infinity', '1e999,0,1'];
for (const told of VIEWS)
  test(`the view ${told} of an address is the one at the start or within bounds`, () => {
    const { azimuth, elevation, zoom } = readView(told);
    assert.ok(azimuth >= -180 && azimuth < 180 && Math.abs(elevation) <= 90 && zoom >= 0.3 && zoom <= 20);
  });

test('views are kept in the address, turned into bounds', () => {
  assert.equal(writeView(readView('190,100,99')), '-170,90,20');
  assert.equal(writeView(readView('-60.004,30,1')), null);
  assert.equal(writeView(readView('-541,-91,0')), '179,-90,0.3');
});

test('answers of the API that are refused say why and about which parameter', async (context) => {
  const answers = [
    new Response('{"error": "there is no column x", "field": "x"}', { status: 400 }),
    new Response('<html>', { status: 502 }),
    new Response('{"a": 1}'),
  ];
  context.mock.method(globalThis, 'fetch', async () => answers.shift());
  await assert.rejects(fetchJson('/x'), { message: 'there is no column x', status: 400, field: 'x' });
  await assert.rejects(fetchJson('/x'), { message: 'The dashboard answered 502.', status: 502, field: null });
  assert.deepEqual(await fetchJson('/x'), { a: 1 });
});

test('a dashboard that is away is told, a question taken back is not', async (context) => {
  const aborted = new DOMException('aborted', 'AbortError');
  const errors = [new TypeError('fetch failed'), aborted];
  context.mock.method(globalThis, 'fetch', async () => {
    throw errors.shift();
  });
  await assert.rejects(fetchJson('/x'), { status: 0 });
  await assert.rejects(fetchJson('/x'), (error) => error === aborted);
});
