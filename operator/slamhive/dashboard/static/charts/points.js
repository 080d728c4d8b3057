// SPDX-License-Identifier: Apache-2.0
/** Reading the columnar answer of /api/v1/analysis/points. */
import { cell, clip, columnTitle, SUBJECT } from '../core/format.js';

/** An axis of points: numbers (shown unit) or categories.
 * @param {object} axis of the answer
 * @returns {{heading: object, categories: string[]|null, at: (index: number) => number|null, text: (index: number) => string}} */
export function readAxis(axis) {
  if (axis.codes) {
    const at = (index) => (axis.codes[index] < 0 ? null : axis.codes[index]);
    return { heading: axis, categories: axis.categories.map(String), at, text: (index) => (at(index) === null ? '–' : String(axis.categories[at(index)])) };
  }
  const scale = axis.kind === 'time' ? 1000 : axis.factor ?? 1;
  const at = (index) => (axis.values[index] === null ? null : axis.values[index] * scale);
  return { heading: axis, categories: null, at, text: (index) => cell(axis.values[index], axis) };
}

/** Make an axis categorical: few numbers become categories in their order.
 * @returns {{categories: string[], at: (index: number) => number|null}|null} null where there are more than `most` values */
export function asCategories(axis, count, most = 40) {
  if (axis.categories) return axis.categories.length <= most ? axis : null;
  const found = new Set();
  for (let index = 0; index < count; index += 1) {
    const value = axis.at(index);
    if (value !== null) found.add(value);
    if (found.size > most) return null;
  }
  const values = [...found].sort((a, b) => a - b);
  const place = new Map(values.map((value, index) => [value, index]));
  const texts = values.map((value) => cell(value / (axis.heading.factor ?? 1), axis.heading));
  return { heading: axis.heading, categories: texts, at: (index) => place.get(axis.at(index)) ?? null, text: axis.text };
}

/** Return the part of each facet: [{name, indices}]. */
export function facets(data) {
  const count = data.count;
  const all = Array.from({ length: count }, (_, index) => index);
  if (!data.axes.facet) return [{ name: null, indices: all }];
  const axis = asCategories(readAxis(data.axes.facet), count, 24);
  if (!axis) return null;
  const { name: column, title } = axis.heading;
  const said = title === column ? columnTitle(column) : title;
  const named = (value) => (SUBJECT.includes(column) ? value : `${said} ${value}`);
  const parts = axis.categories.map((value) => ({ name: named(value), indices: [] }));
  const rest = { name: `without ${said}`, indices: [] };
  for (const index of all) (parts[axis.at(index)] ?? rest).indices.push(index);
  return [...parts, rest].filter((part) => part.indices.length);
}

/** Return an ECharts axis for a read axis. */
export function axisOption(axis, { log = false, vertical = false } = {}) {
  const name = clip(axis.heading.title, 50);
  const turned = axis.categories?.length > 4 && !vertical;
  const gap = vertical ? 52 : turned ? 52 : 28;
  if (axis.categories) return { type: 'category', data: axis.categories.map((text) => clip(text, 28)), name, nameGap: gap, axisLabel: { rotate: turned ? 25 : 0, interval: axis.categories.length > 20 ? 'auto' : 0 } };
  if (axis.heading.kind === 'time') return { type: 'time', name, nameGap: gap };
  return { type: log ? 'log' : 'value', scale: true, name, nameGap: gap };
}

/** Return how wide names left of a chart may be, in pixels: a phone keeps most of its width for the chart. */
export const labelRoom = (width, most) => Math.min(most, Math.round(width * 0.36));

/** The share of a sorted list: linear between its values. */
export function quantile(sorted, share) {
  const place = (sorted.length - 1) * share;
  const low = Math.floor(place);
  return sorted[low] + (sorted[Math.ceil(place)] - sorted[low]) * (place - low);
}
