// SPDX-License-Identifier: Apache-2.0
/**
 * The table of a site without a server: rows are selected and put in order here, as /api/v1/runs and
 * /api/v1/analysis/points do it. Columns are files as the API writes those of charts, block by block.
 */
import { ApiError } from './api.js';

/**
 * @typedef {{kind: string, values?: Array<number|null>, codes?: number[], categories?: Api.Value[]}} Block
 * @typedef {Api.Heading & {blocks: Array<string|Block>}} StoredColumn
 * @typedef {{rows: number, columns: Record<string, StoredColumn>, notes: string[],
 *   mixed: Array<{column: string, owner: string|null}>, conditions: Record<string, string>}} SiteTable
 * @typedef {{kind: string, length: number, at: (row: number) => Api.Value}} ReadColumn at: numbers as stored
 * @typedef {(name: string) => Promise<any>} Files
 * @typedef {import('./address.js').Query} Query
 */

const OWN = [
  'sort',
  'columns',
  'limit',
  'after',
  'format',
  'x',
  'y',
  'colour',
  'size',
  'facet',
  'digits',
  'where',
];
const SUPERSEDED = 'superseded';
const DEFAULT = [
  'uid',
  'run',
  'algorithm',
  'sensors',
  'dataset',
  'status',
  'coverage',
  'ate.rmse',
  'finished',
];
const UNIQUE = 'id';
/** Points up to which a chart gets the UIDs of the runs, as from the API. */
const EXACT = 5000;
const MOST_TOLD = 6;
const READER = 'usage.includesReader';
const OPERATOR = /^(.+?)(<=|>=|!=|<|>)(.*)$/s;
/** @type {Record<string, Api.Value>} */
const WORDS = { true: true, false: false, null: null };

/** @type {Map<StoredColumn, Promise<ReadColumn>>} */
const read = new Map();

/**
 * Return a column with all its blocks.
 * @param {SiteTable} table
 * @param {string} name
 * @param {string} field parameter that named it
 * @param {Files} files
 */
function column(table, name, field, files) {
  const stored = Object.hasOwn(table.columns, name) ? table.columns[name] : undefined;
  if (!stored) throw new ApiError(`unknown column '${name.slice(0, 200)}'`, 400, field);
  const known = read.get(stored);
  if (known) return known;
  const found = Promise.all(
    stored.blocks.map((one) => (typeof one === 'string' ? /** @type {Promise<Block>} */ (files(one)) : one)),
  ).then((blocks) => {
    const kind = blocks[0]?.kind ?? stored.kind ?? 'other';
    const values = blocks.flatMap((one) =>
      one.codes ? one.codes.map((code) => one.categories?.[code] ?? null) : (one.values ?? []),
    );
    return { kind, length: values.length, at: (/** @type {number} */ row) => values[row] ?? null };
  });
  found.catch(() => read.delete(stored));
  read.set(stored, found);
  return found;
}

/** @param {string} text */
const asNumber = (text) => (text.trim() === '' ? Number.NaN : Number(text));

/**
 * Tell whether a value is equal to one of some texts of an address.
 * @param {string[]} texts
 */
function equals(texts) {
  const words = texts.flatMap((text) => (Object.hasOwn(WORDS, text) ? [WORDS[text]] : []));
  const numbers = new Set(texts.map(asNumber));
  const exact = new Set(texts);
  return (/** @type {Api.Value} */ value) =>
    value === null
      ? words.includes(null)
      : typeof value === 'number'
        ? numbers.has(value)
        : typeof value === 'boolean'
          ? words.includes(value) || numbers.has(Number(value))
          : exact.has(String(value));
}

/**
 * Tell whether a value stands in an order to a text; nothing that is missing does.
 * @param {string} symbol
 * @param {string} text
 * @param {string} kind of the column
 */
function ordered(symbol, text, kind) {
  const limit = kind === 'time' && Number.isNaN(asNumber(text)) ? Date.parse(text) / 1000 : asNumber(text);
  return (/** @type {Api.Value} */ value) => {
    if (value === null) return false;
    const [one, other] = typeof value === 'string' ? [value, text] : [Number(value), limit];
    if (symbol === '<') return one < other;
    if (symbol === '<=') return one <= other;
    return symbol === '>' ? one > other : one >= other;
  };
}

/**
 * Return the rows that the filters of an address mean.
 * @param {SiteTable} table
 * @param {Query} query
 * @param {Files} files
 * @param {boolean} each whether runs are meant one by one, those of equal content too
 */
async function chosen(table, query, files, each) {
  /** @type {Map<string, string[]>} */
  const equal = new Map();
  /** @type {Array<{read: ReadColumn, fits: (value: Api.Value) => boolean}>} */
  const tests = [];
  for (const [name, value] of query.pairs) {
    if (OWN.includes(name) || name === SUPERSEDED) continue;
    const text = /[<>!]$/.test(name) || value === null ? `${name}${value === null ? '' : `=${value}`}` : name;
    const [, of, symbol, right] = OPERATOR.exec(text) ?? [];
    if (of === undefined || symbol === undefined || right === undefined) {
      equal.set(name, [...(equal.get(name) ?? []), value ?? '']);
      continue;
    }
    const found = await column(table, of, of, files);
    const same = equals([right]);
    const fits =
      symbol === '!=' ? (/** @type {Api.Value} */ one) => !same(one) : ordered(symbol, right, found.kind);
    tests.push({ read: found, fits });
  }
  for (const [name, texts] of equal)
    tests.push({ read: await column(table, name, name, files), fits: equals(texts) });
  if (query.get(SUPERSEDED) !== '1' && Object.hasOwn(table.columns, SUPERSEDED))
    tests.push({ read: await column(table, SUPERSEDED, SUPERSEDED, files), fits: (value) => value === null });
  const meeting = query.get('where')
    ? new Set(await files(table.conditions[query.get('where')] ?? ''))
    : null;
  /** @type {number[]} */
  const rows = [];
  for (let row = 0; row < table.rows; row += 1)
    if ((meeting === null || meeting.has(row)) && tests.every((one) => one.fits(one.read.at(row))))
      rows.push(row);
  return each ? rows : once(table, rows, files);
}

/**
 * Return rows with equal content once, the one that the table prefers.
 * @param {SiteTable} table
 * @param {number[]} rows
 * @param {Files} files
 */
async function once(table, rows, files) {
  if (!Object.hasOwn(table.columns, ':content')) return rows;
  const content = await column(table, ':content', '', files);
  const preference = await column(table, ':preference', '', files);
  /** @type {Map<Api.Value, number>} */
  const best = new Map();
  for (const row of rows) {
    const group = content.at(row);
    const held = best.get(group);
    if (held === undefined || Number(preference.at(row)) < Number(preference.at(held))) best.set(group, row);
  }
  return rows.filter((row) => Number(content.at(row)) < 0 || best.get(content.at(row)) === row);
}

/**
 * Tell whether a value comes before another one, as from the API: numbers, then texts.
 * @param {NonNullable<Api.Value>} one
 * @param {NonNullable<Api.Value>} other
 */
const isBefore = (one, other) => (typeof one === typeof other ? one < other : typeof one === 'number');

/**
 * Put rows in an order; what is missing comes last either way.
 * @param {SiteTable} table
 * @param {number[]} rows
 * @param {string} sort
 * @param {Files} files
 */
async function inOrder(table, rows, sort, files) {
  const names = [...sort.split(',').filter(Boolean), UNIQUE];
  const keys = await Promise.all(
    names.map(async (name) => ({
      turned: name.startsWith('-') ? -1 : 1,
      read: await column(table, name.replace(/^-/, ''), 'sort', files),
    })),
  );
  return [...rows].sort((a, b) => {
    for (const {
      turned,
      read: { at },
    } of keys) {
      const [one, other] = [at(a), at(b)];
      if (one === other) continue;
      if (one === null) return 1;
      if (other === null) return -1;
      return isBefore(one, other) ? -turned : turned;
    }
    return a - b;
  });
}

/** As the API writes a moment. @param {number} seconds */
function iso(seconds) {
  const whole = Math.floor(seconds);
  const micros = Math.round((seconds - whole) * 1e6);
  const text = new Date((whole + (micros === 1e6 ? 1 : 0)) * 1000).toISOString().slice(0, 19);
  return `${text}${micros % 1e6 ? `.${String(micros).padStart(6, '0')}` : ''}+00:00`;
}

/**
 * Return a page of the table of runs.
 * @param {SiteTable} table
 * @param {Query} query
 * @param {Files} files
 * @returns {Promise<Api.Runs>}
 */
export async function runsOf(table, query, files) {
  const names = (query.get('columns') || DEFAULT.join(',')).split(',').filter(Boolean);
  const shown = [...new Set(names)].filter(
    (name) => query.get('columns') || Object.hasOwn(table.columns, name),
  );
  const columns = await Promise.all(shown.map((name) => column(table, name, 'columns', files)));
  const rows = await inOrder(table, await chosen(table, query, files, true), query.get('sort'), files);
  const start = Number(query.get('after')) || 0;
  const limit = Number(query.get('limit')) || 100;
  const page = rows.slice(start, start + limit);
  const next = start + limit < rows.length ? `/api/v1/runs?${query.with({ after: start + limit })}` : null;
  const [first = 0] = rows;
  return /** @type {Api.Runs} */ ({
    revision: 'site',
    total: rows.length,
    next,
    same: shown.filter((_, at) => {
      const one = columns[at];
      return rows.length > 1 && one && rows.every((row) => one.at(row) === one.at(first));
    }),
    notes: query.get(SUPERSEDED) === '1' ? [] : table.notes,
    columns: shown.map((name) => headingOf(table, name)),
    items: page.map((row) =>
      Object.fromEntries(
        shown.map((name, at) => {
          const value = columns[at]?.at(row) ?? null;
          return [name, columns[at]?.kind === 'time' && typeof value === 'number' ? iso(value) : value];
        }),
      ),
    ),
  });
}

/**
 * @param {SiteTable} table
 * @param {string} name
 */
function headingOf(table, name) {
  const { blocks: _, ...heading } = /** @type {StoredColumn} */ (table.columns[name]);
  return heading;
}

/**
 * Return rows of a column as the API codes them.
 * @param {ReadColumn} found
 * @param {number[]} rows
 */
function coded({ kind, at }, rows) {
  if (['number', 'integer', 'time'].includes(kind)) return { kind, values: rows.map(at) };
  const categories = [...new Set(rows.map(at).filter((value) => value !== null))].sort((a, b) =>
    isBefore(a, b) ? -1 : 1,
  );
  /** @type {Map<Api.Value, number>} */
  const places = new Map(categories.map((value, place) => [value, place]));
  return { kind, codes: rows.map((row) => places.get(at(row)) ?? -1), categories };
}

/**
 * Return one point a run for a chart.
 * @param {SiteTable} table
 * @param {Query} query
 * @param {Files} files
 * @returns {Promise<Api.Points>}
 */
export async function pointsOf(table, query, files) {
  const axes = ['x', 'y', 'colour', 'size', 'facet'].filter((axis) => query.get(axis));
  const named = axes.map((axis) => query.get(axis));
  const columns = await Promise.all(axes.map((axis) => column(table, query.get(axis), axis, files)));
  const rows = await chosen(table, query, files, false);
  const [status, id, uid, run] = await Promise.all(
    ['status', 'id', 'uid', 'run'].map((name) => column(table, name, name, files)),
  );
  const exact = rows.length <= EXACT;
  return /** @type {any} */ ({
    revision: 'site',
    count: rows.length,
    digits: null,
    axes: Object.fromEntries(
      axes.map((axis, at) => [
        axis,
        { ...headingOf(table, named[at] ?? ''), ...coded(/** @type {ReadColumn} */ (columns[at]), rows) },
      ]),
    ),
    status: coded(/** @type {ReadColumn} */ (status), rows),
    id: rows.map((row) => id?.at(row)),
    uid: exact ? rows.map((row) => uid?.at(row)) : null,
    run: exact ? rows.map((row) => run?.at(row)) : null,
    notes: query.get(SUPERSEDED) === '1' ? [] : table.notes,
    mixed: await mixed(table, rows, named, files),
  });
}

/**
 * Say which columns that ought to be told apart are mixed in some rows.
 * @param {SiteTable} table
 * @param {number[]} rows
 * @param {string[]} told columns that a chart tells apart itself
 * @param {Files} files
 */
async function mixed(table, rows, told, files) {
  const found = [];
  for (const { column: name, owner } of table.mixed) {
    if (told.includes(name) || (owner && told.includes(owner))) continue;
    if (name === READER && !told.some((one) => one.startsWith('usage.cpu.'))) continue;
    const { at } = await column(table, name, name, files);
    let meant = rows;
    if (name === READER) {
      // Of a run that was ended no CPU is drawn.
      const phase = await column(table, 'phase', 'phase', files);
      meant = rows.filter((row) => phase.at(row) === 'Succeeded');
    }
    const values = [...new Set(meant.map(at))];
    if (values.length < 2) continue;
    const shown = values
      .slice(0, MOST_TOLD)
      .map((value) => (value === null ? 'unknown' : String(value)))
      .join(', ');
    found.push({
      column: name,
      values,
      sentence: `runs of different ${name} are mixed here (${shown}): choose one, or tell them apart by it`,
    });
  }
  return found;
}
