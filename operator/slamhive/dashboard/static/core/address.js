// SPDX-License-Identifier: Apache-2.0
/** The address of a page is the saved analysis: what is shown follows from it, and changes go through it. */
import { createContext, useContext } from './ui.js';

/** Names that are settings of a page; every other one is a filter and goes to the API as it is. */
const OWN = new Set([
  'kind',
  'x',
  'y',
  'colour',
  'size',
  'facet',
  'down',
  'across',
  'over',
  'of',
  'from',
  'to',
  'outcomes',
  'figure',
  'xlog',
  'ylog',
  'scales',
  'embed',
  'sort',
  'columns',
  'limit',
  'after',
  'by',
  'metric',
  'metrics',
  'plane',
  'title',
  'axes',
  'view',
  'figures',
  'most',
  'first',
]);

/**
 * True on a site without a server: its pages are behind the # of its one address, answers are files.
 */
export const SITE = Boolean(globalThis.document?.querySelector('meta[name="slamhive-site"]'));

/**
 * Return a page's address as the browser is to have it.
 * @param {string} page path and query
 */
export const hrefOf = (page) => (SITE ? `#${page}` : page);

/** Return path and query of the page that is shown. @returns {[string, string]} */
const whereabouts = () => {
  if (!SITE) return [location.pathname, location.search];
  const [, path, search] = /^#?([^?]*)(.*)$/s.exec(location.hash) ?? ['', '', ''];
  return [path || '/', search];
};

/** @param {string} text */
const decode = (text) => {
  try {
    return decodeURIComponent(text.replaceAll('+', ' '));
  } catch {
    return text;
  }
};

/** Half a character, which a field may hold, has no encoding. @param {string} text */
const encode = (text) => encodeURIComponent(text.toWellFormed?.() ?? text);

/** A query string that keeps the order, the repetitions and the signs of its parameters. */
export class Query {
  /** @param {Array<[string, string|null]>} pairs names and values; null where there was no equals sign */
  constructor(pairs = []) {
    /** @type {Array<[string, string|null]>} */
    this.pairs = pairs;
  }

  /**
   * @param {string} search with or without its question mark
   * @returns {Query}
   */
  static parse(search) {
    const parts = search.replace(/^\?/, '').split('&').filter(Boolean);
    return new Query(
      parts.map((part) => {
        const at = part.indexOf('=');
        return at < 0 ? [decode(part), null] : [decode(part.slice(0, at)), decode(part.slice(at + 1))];
      }),
    );
  }

  /**
   * Return the first value of a name.
   * @param {string} name
   * @param {string} [otherwise]
   * @returns {string}
   */
  get(name, otherwise = '') {
    return this.pairs.find(([key]) => key === name)?.[1] ?? otherwise;
  }

  /**
   * Return all values of a name.
   * @param {string} name
   * @returns {string[]}
   */
  all(name) {
    return this.pairs.filter(([key]) => key === name).map(([, value]) => value ?? '');
  }

  /**
   * Return a query with some names set anew; null, '' and [] leave a name out.
   * @param {Changes} changes
   */
  with(changes) {
    const kept = this.pairs.filter(([key]) => !Object.hasOwn(changes, key));
    const added = Object.entries(changes).flatMap(([key, value]) =>
      (Array.isArray(value) ? value : [value])
        .filter((one) => one !== null && one !== undefined && one !== '')
        .map((one) => /** @type {[string, string]} */ ([key, String(one)])),
    );
    return new Query([...kept, ...added]);
  }

  /**
   * Return a query with one more filter.
   * @param {string} name
   * @param {string} value
   */
  and(name, value) {
    return new Query([...this.pairs, [name, value]]);
  }

  /**
   * Return a query without the pair at a position.
   * @param {[string, string|null]} pair
   */
  without(pair) {
    return new Query(this.pairs.filter((one) => one !== pair));
  }

  /** Return only what filters rows. */
  filters() {
    return new Query(this.pairs.filter(([key]) => !OWN.has(key)));
  }

  toString() {
    return this.pairs
      .map(([key, value]) => encode(key) + (value === null ? '' : `=${encode(value)}`))
      .join('&');
  }
}

/**
 * Return an address of a path and a query.
 * @param {string} path
 * @param {Query | Changes} [query]
 */
export const address = (path, query) => {
  const text = query instanceof Query ? query.toString() : new Query().with(query ?? {}).toString();
  return text ? `${path}?${text}` : path;
};

/**
 * Go to an address of these pages.
 * @param {string} href
 * @param {{replace?: boolean}} [how]
 */
export const go = (href, { replace = false } = {}) => {
  history[replace ? 'replaceState' : 'pushState'](null, '', hrefOf(href));
  dispatchEvent(new Event('addresschange'));
};

/**
 * What the pages know of the address: path (decoded parts), query. @type {import('./ui.js').Context<{path:
 * string[], query: Query}>}
 */
export const Address = createContext(null);

/** Return the address and a function that changes settings in it. */
export const useAddress = () => {
  const here = useContext(Address);
  return {
    ...here,
    /** @param {Changes} changes @param {boolean} [replace] */
    change: (changes, replace = false) =>
      go(address(whereabouts()[0], here.query.with(changes)), { replace }),
    /** @param {Query} query */
    follow: (query) => go(address(whereabouts()[0], query)),
  };
};

/** Read the browser's address. */
export const readAddress = () => {
  const [path, search] = whereabouts();
  return { path: path.split('/').filter(Boolean).map(decode), query: Query.parse(search) };
};
