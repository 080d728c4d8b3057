// SPDX-License-Identifier: Apache-2.0
/** Reading the columnar answer of /api/v1/analysis/points. */
import { axisName, cell, clip, ownTitle, SUBJECT } from '../core/format.js';
import { roundEnds, triedEnds } from './limits.js';

/**
 * An axis of points: numbers (shown unit) or categories.
 * @param {Omit<Api.Axis, 'name'|'title'> & Partial<Api.Heading>} axis of the answer
 * @returns {ReadAxis}
 */
export function readAxis(axis) {
  const heading = { ...axis, name: axis.name ?? '', title: axis.title ?? '' };
  if (axis.codes) {
    const { codes } = axis;
    const categories = (axis.categories ?? []).map(String);
    return {
      heading,
      categories,
      at: (index) => (codes[index] < 0 ? null : codes[index]),
      text: (index) => categories[codes[index]] ?? '–',
    };
  }
  const values = axis.values ?? [];
  const scale = axis.kind === 'time' ? 1000 : (axis.factor ?? 1);
  return {
    heading,
    categories: null,
    at: (index) => {
      const value = values[index];
      return value === null ? null : value * scale;
    },
    text: (index) => cell(values[index], axis),
  };
}

/**
 * Make an axis categorical: few numbers become categories in their order.
 * @param {ReadAxis} axis
 * @param {number} count of points
 * @param {number} [most]
 * @returns {CategoryAxis|null} null where there are more than `most` values
 */
export function asCategories(axis, count, most = 40) {
  const { categories } = axis;
  if (categories) return categories.length <= most ? { ...axis, categories } : null;
  const found = new Set();
  for (let index = 0; index < count; index += 1) {
    const value = axis.at(index);
    if (value !== null) found.add(value);
    if (found.size > most) return null;
  }
  const values = [...found].sort((a, b) => a - b);
  /** @type {Map<number|null, number>} */
  const place = new Map(values.map((value, index) => [value, index]));
  const texts = values.map((value) => cell(value / (axis.heading.factor ?? 1), axis.heading));
  return {
    heading: axis.heading,
    categories: texts,
    at: (index) => place.get(axis.at(index)) ?? null,
    text: axis.text,
  };
}

/**
 * Return the part of each facet; null where there are too many.
 * @param {Api.Points} data
 * @returns {Array<{name: string|null, indices: number[]}>|null}
 */
export function facets(data) {
  const count = data.count;
  const all = Array.from({ length: count }, (_, index) => index);
  if (!data.axes.facet) return [{ name: null, indices: all }];
  const axis = asCategories(readAxis(data.axes.facet), count, 24);
  if (!axis) return null;
  const column = axis.heading.name;
  const said = ownTitle(axis.heading);
  /** @param {string} value */
  const named = (value) => (SUBJECT.includes(column) ? value : `${said} ${value}`);
  const parts = axis.categories.map((value) => ({
    name: named(value),
    indices: /** @type {number[]} */ ([]),
  }));
  const rest = { name: `without ${said}`, indices: [] };
  for (const index of all) (parts[axis.at(index) ?? -1] ?? rest).indices.push(index);
  return [...parts, rest].filter((part) => part.indices.length);
}

/**
 * Return an ECharts axis for a read axis.
 * @param {ReadAxis} axis
 * @param {{log?: boolean, vertical?: boolean}} [how]
 */
export function axisOption(axis, { log = false, vertical = false } = {}) {
  const name = clip(axisName(axis.heading), 50);
  const turned = axis.categories !== null && axis.categories.length > 4 && !vertical;
  const gap = vertical ? 52 : turned ? 52 : 28;
  if (axis.categories)
    return {
      type: 'category',
      data: axis.categories.map((text) => clip(text, 28)),
      name,
      nameGap: gap,
      axisLabel: { rotate: turned ? 25 : 0, interval: axis.categories.length > 20 ? 'auto' : 0 },
    };
  if (axis.heading.kind === 'time') return { type: 'time', name, nameGap: gap };
  return { type: log ? 'log' : 'value', scale: true, name, nameGap: gap };
}

/**
 * Return the ends of an axis for some points, so that charts can share them; {} for categories.
 * @param {ReadAxis} axis
 * @param {number[]} indices of the points
 * @param {{log?: boolean, vertical?: boolean}} [how]
 * @returns {Record<string, any>}
 */
export function endsOf(axis, indices, { log = false, vertical = false } = {}) {
  if (axis.categories) return {};
  let [low, high] = [Infinity, -Infinity];
  /** @type {Set<number>} */
  const values = new Set();
  for (const index of indices) {
    const value = axis.at(index);
    if (value === null || (log && value <= 0)) continue;
    [low, high] = [Math.min(low, value), Math.max(high, value)];
    values.add(value);
  }
  if (low > high) return {};
  if (axis.heading.kind === 'time') return { min: low, max: high > low ? high : low + 1000 };
  return vertical ? roundEnds({ low, high }, { log }) : triedEnds([...values], log);
}
