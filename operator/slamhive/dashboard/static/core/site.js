// SPDX-License-Identifier: Apache-2.0
/**
 * The API of a site without a server: answers that were made when it was built are files beside it, runs and
 * points are taken of its table (sitetable.js). No figure is computed here.
 */
import { Query } from './address.js';
import { ApiError } from './api.js';
import { saveText, toCsv } from './figure.js';
import { NOT_HERE } from './parts.js';
import { pointsOf, runsOf } from './sitetable.js';

/**
 * @typedef {{answers: Record<string, string>, csv: Record<string, string>,
 *   refused: Record<string, {status: number, error: string, field?: string|null}>, measures: string[],
 *   table: import('./sitetable.js').SiteTable, runs: string}} SiteIndex
 * @typedef {{uids: string[], at: number[], files: string[]}} SiteRuns
 */

const API = '/api/v1';
const UNASKED =
  'This site has no figures for that choice: figures over groups were computed when it was made, for the ' +
  'choices that its pages begin with. Points and tables of runs take any choice; where the runs are, ' +
  'slamhive dashboard takes all.';
const CONDITIONS =
  'This site has no server to read that condition: choose runs by columns and their values here.';

/** @type {Map<string, Promise<any>>} */
const kept = new Map();
const MOST_KEPT = 400;

/**
 * Return what a file of the site holds.
 * @param {string} name its content's hash
 * @param {(answer: Response) => Promise<any>} [read]
 */
function fileOf(name, read = (answer) => answer.json()) {
  const known = kept.get(name);
  if (known) return known;
  const found = unpacked(`data/${name.slice(0, 2)}/${name}.json.gz`).then(read);
  found.catch(() => kept.delete(name));
  kept.set(name, found);
  if (kept.size > MOST_KEPT) kept.delete(String(kept.keys().next().value));
  return found;
}

/** @param {string} address */
async function unpacked(address) {
  const answer = await got(address);
  if (!answer.body) throw new ApiError(`The file ${address} of this site is empty.`, 0);
  return new Response(answer.body.pipeThrough(new DecompressionStream('gzip')));
}

/**
 * @param {string} address
 * @param {RequestInit} [how]
 */
async function got(address, how) {
  const answer = await fetch(new URL(address, document.baseURI), how).catch(() => null);
  if (!answer?.ok) throw new ApiError(`The file ${address} of this site could not be read.`, 0);
  return answer;
}

/** @type {Promise<SiteIndex>|undefined} */
let beginning;

/** Return what tells where all is. */
const index = () =>
  (beginning ??= got('site.json', { cache: 'no-cache' })
    .then((answer) => answer.json())
    .then((mark) => fileOf(mark.index)));

/**
 * Return the key of an address: its pairs in one order.
 * @param {string} path
 * @param {Query} query
 */
const keyOf = (path, query) => {
  const pairs = query
    .toString()
    .split('&')
    .filter((pair) => pair && !pair.endsWith('='))
    .sort();
  return pairs.length ? `${path}?${pairs.join('&')}` : path;
};

/** @param {any} value */
const resolved = async (value) => {
  const found = value?.file && Object.keys(value).length === 1 ? await fileOf(value.file) : value;
  return found?.reference?.file ? { ...found, reference: await fileOf(found.reference.file) } : found;
};

/**
 * Return an answer on one run.
 * @param {SiteIndex} known
 * @param {string} uid
 * @param {string} part of its address: '', trajectory, usage
 * @param {Query} query
 */
async function ofRun(known, uid, part, query) {
  /** @type {SiteRuns} */
  const runs = await fileOf(known.runs);
  const place = runs.uids.indexOf(uid);
  if (place < 0) throw new ApiError(`there is no run with the UID '${uid}'`, 404, 'uid');
  const page = (await fileOf(runs.files[runs.at[place] ?? 0] ?? ''))[uid];
  let found = page[part];
  if (part === 'trajectory' && found) found = found[query.get('evaluation')] ?? Object.values(found)[0];
  if (!found) throw new ApiError('The files of runs are not part of this site.', NOT_HERE);
  found = await resolved(found);
  if (found.refused) throw new ApiError(found.error, found.refused, found.field);
  return found;
}

/**
 * Return columns that say whether figures over groups were computed for them.
 * @param {Api.Columns} columns
 * @param {string[]} measures
 */
const withAsked = (columns, measures) => ({
  ...columns,
  items: columns.items.map((one) => ({ ...one, isAsked: measures.includes(one.name) })),
});

/**
 * Return the answer at an address of the API.
 * @param {string} url
 * @returns {Promise<any>}
 */
export async function answer(url) {
  const known = await index();
  const [path = '', search = ''] = url.split('?');
  const query = Query.parse(search);
  const key = keyOf(path, query);
  const file = Object.hasOwn(known.answers, key) ? known.answers[key] : undefined;
  if (file) return path === `${API}/columns` ? withAsked(await fileOf(file), known.measures) : fileOf(file);
  const refused = Object.hasOwn(known.refused, key) ? known.refused[key] : undefined;
  if (refused) throw new ApiError(refused.error, refused.status, refused.field);
  const [, uid, part] = /^\/api\/v1\/runs\/([^/]+)\/?(.*)$/.exec(path) ?? [];
  if (uid !== undefined) return ofRun(known, decodeURIComponent(uid), part ?? '', query);
  if (query.get('where') && !Object.hasOwn(known.table.conditions, query.get('where')))
    throw new ApiError(CONDITIONS, NOT_HERE);
  if (path === `${API}/runs`) return runsOf(known.table, query, fileOf);
  const [, kind, name] = /^\/api\/v1\/(sweep|algorithm|dataset)s\/([^/]+)/.exec(path) ?? [];
  if (kind !== undefined && name !== undefined && !Object.hasOwn(known.answers, `${API}/${kind}s/${name}`)) {
    const said = `This site has no page of the ${kind} '${decodeURIComponent(name)}'.`;
    throw new ApiError(said, 404, 'name');
  }
  if (path === `${API}/analysis/points`) return pointsOf(known.table, query, fileOf);
  throw new ApiError(UNASKED, NOT_HERE);
}

/**
 * Return those of some addresses of the API that figures were computed for.
 * @param {string[]} urls
 */
export async function computed(urls) {
  const { answers } = await index();
  return urls.filter((url) => {
    const [path = '', search = ''] = url.split('?');
    return Object.hasOwn(answers, keyOf(path, Query.parse(search)));
  });
}

/**
 * Let the browser keep what an address of the API gives as a file.
 * @param {string} href
 */
export async function keep(href) {
  const [path = '', search = ''] = href.split('?');
  const query = Query.parse(search).with({ format: null });
  const name = `${path.split('/').filter(Boolean).slice(2).map(decodeURIComponent).join('-')}`;
  if (path.endsWith('/manifest')) {
    const run = await answer(path.replace(/\/manifest$/, ''));
    return saveText(run.manifest, `${run.name}.yaml`, 'application/yaml');
  }
  const known = await index();
  const file = known.csv[keyOf(path, query)];
  return saveText(
    file ? await fileOf(file, (one) => one.text()) : await csvOf(path, query),
    `${name}.csv`,
    'text/csv',
  );
}

/**
 * @param {string} path
 * @param {Query} query
 */
async function csvOf(path, query) {
  const known = await index();
  if (path === `${API}/runs`) {
    const all = await runsOf(known.table, query.with({ limit: known.table.rows, after: null }), fileOf);
    return toCsv(all.columns, all.items);
  }
  const found = await answer(`${path}?${query}`);
  const lists = Object.values(found).filter(
    (value) => Array.isArray(value) && value[0] && typeof value[0] === 'object',
  );
  const columns = path.endsWith('/points')
    ? Object.fromEntries(Object.values(found.axes).map((axis) => [axis.name, axis.values ?? texts(axis)]))
    : path.endsWith('/trajectory')
      ? found.estimate
      : Object.fromEntries(
          Object.entries(found).filter(
            ([, value]) => Array.isArray(value) && value.length === found.t?.length,
          ),
        );
  const longest = lists.sort((a, b) => b.length - a.length)[0];
  const rows =
    longest && !path.endsWith('/points')
      ? longest.map((/** @type {object} */ row) => flat(row))
      : Array.from({ length: Object.values(columns)[0]?.length ?? 0 }, (_, row) =>
          Object.fromEntries(Object.entries(columns).map(([name, values]) => [name, values[row]])),
        );
  const names = [...new Set(rows.flatMap((/** @type {object} */ row) => Object.keys(row)))];
  return toCsv(
    names.map((name) => ({ name })),
    rows,
  );
}

/**
 * Lay an item out as one row; lists in it are no table's.
 * @param {object} item
 * @param {string} [prefix]
 * @returns {Record<string, any>}
 */
const flat = (item, prefix = '') =>
  Object.fromEntries(
    Object.entries(item).flatMap(([name, value]) =>
      Array.isArray(value)
        ? []
        : value !== null && typeof value === 'object'
          ? Object.entries(flat(value, `${prefix}${name}.`))
          : [[`${prefix}${name}`, value]],
    ),
  );

/** @param {Api.Axis} axis */
const texts = ({ codes = [], categories = [] }) => codes.map((code) => categories[code] ?? null);
