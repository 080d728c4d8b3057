// SPDX-License-Identifier: Apache-2.0
/** Points, one a run; what failed is drawn in a field above the others. */
import { COLOURS } from '../core/chart.js';
import { clip, namedText } from '../core/format.js';
import { SCALE } from '../core/scale.js';
import { crossed, withField } from './failures.js';
import { asCategories, axisOption, endsOf, readAxis } from './points.js';

/** @type {Record<string, string>} */
const SHAPES = { Tracked: 'circle', Partial: 'circle', Lost: 'triangle', Diverged: 'diamond' };
const MANY = 3000;

/**
 * Return the option of a scatter chart.
 * @param {Api.Points} data answer of analysis/points
 * @param {number[]} indices which of its points
 * @param {{xlog: boolean, ylog: boolean, own?: boolean}} settings own: its axes are for its own points alone,
 *   not for those of all
 * @param {Api.PublishedRow[]} [beside] published numbers, drawn hollow beside the runs
 * @returns {ChartOption}
 */
export function scatter(data, indices, { xlog, ylog, own = false }, beside = []) {
  const x = readAxis(data.axes.x);
  const y = readAxis(data.axes.y);
  const status = data.status ? readAxis(data.status) : null;
  const colour = data.axes.colour ? readAxis(data.axes.colour) : null;
  const groups = colour && asCategories(colour, data.count, 20);
  const continuous = colour && !groups;
  /** @param {number} index */
  const place = (index) => [x.at(index), y.at(index), index, ...(continuous ? [colour.at(index)] : [])];
  const large = indices.length > MANY;
  /**
   * @param {number} point
   * @param {string} ink
   */
  const dress = (point, ink) => {
    const value = place(point);
    if (large) return value;
    const state = status?.text(point) ?? 'Tracked';
    // What did not track to the end is hollow. Where colours tell a number, the drawing library gives them to
    // the fill alone.
    if (state === 'Tracked' || continuous) return { value, symbol: SHAPES[state] ?? 'rect' };
    return {
      value,
      symbol: SHAPES[state] ?? 'rect',
      itemStyle: { color: 'transparent', borderColor: ink, borderWidth: 1.8 },
    };
  };
  const known = indices.filter((index) => x.at(index) !== null);
  const kept = known.filter((index) => y.at(index) !== null);
  const shared = {
    type: 'scatter',
    symbolSize: large ? 3 : 9,
    large,
    largeThreshold: MANY,
    itemStyle: { opacity: large ? 0.5 : 0.85 },
    progressive: 0,
  };
  const named = groups
    ? [...groups.categories, null].map((text) => namedText(groups.heading, text))
    : ['runs'];
  // By place, not by name: two values may read the same.
  /** @type {number[][]} */
  const parts = named.map(() => []);
  for (const index of kept) parts[groups ? (groups.at(index) ?? named.length - 1) : 0].push(index);
  const series = parts.map((members, number) => ({
    ...shared,
    name: clip(named[number], 90),
    color: COLOURS[number % COLOURS.length],
    data: members.map((point) => dress(point, COLOURS[number % COLOURS.length])),
    id: String(number),
  }));
  series.push(...publishedSeries(data, beside));
  const crosses = named.map((_, number) => ({
    data: known
      .filter(
        (index) => y.at(index) === null && (groups ? (groups.at(index) ?? named.length - 1) : 0) === number,
      )
      .map((index) => ({
        value: [x.at(index), 0, index],
        itemStyle: crossed(continuous ? undefined : COLOURS[number % COLOURS.length]),
      })),
  }));
  /** The points for which axes have room: of all charts, or those of this one. @param {number[]} points */
  const among = (points) =>
    data.axes.facet && !own ? Array.from({ length: data.count }, (_, index) => index) : points;
  /** @param {Item} item */
  const tell = (item) => {
    if (item.data?.published) return publishedText(item.data.published);
    const index = item.value[2];
    return [
      `run ${data.run?.[index] ?? data.id?.[index] ?? ''}`,
      `${clip(x.heading.title, 40)}: ${clip(x.text(index), 40)}`,
      `${clip(y.heading.title, 40)}: ${clip(y.text(index), 40)}`,
      ...(colour ? [`${clip(colour.heading.title, 40)}: ${clip(colour.text(index), 40)}`] : []),
      status?.text(index) ?? '',
    ].join('\n');
  };
  const option = {
    grid: {
      left: 72,
      right: continuous ? 90 : 24,
      top: groups ? 40 : 16,
      bottom: x.categories && x.categories.length > 4 ? 76 : 46,
    },
    legend:
      groups || beside.length
        ? {
            data: series
              .filter((one, number) => one.data.length || crosses[number]?.data.length)
              .map((one) => one.name),
          }
        : undefined,
    tooltip: { trigger: 'item', formatter: tell },
    visualMap: continuous ? range(kept.map(colour.at), colour.heading.title) : undefined,
    xAxis: { ...axisOption(x, { log: xlog }), ...endsOf(x, among(known), { log: xlog }) },
    yAxis: {
      ...axisOption(y, { log: ylog, vertical: true }),
      ...(data.axes.facet && !own && endsOf(y, among(kept), { log: ylog, vertical: true })),
    },
    brush: {
      xAxisIndex: 0,
      yAxisIndex: 0,
      brushMode: 'single',
      outOfBrush: { colorAlpha: 0.25 },
      throttleType: 'debounce',
      throttleDelay: 150,
    },
    toolbox: { show: false },
    series,
  };
  return withField(option, 'above', crosses);
}

/**
 * @param {Api.Numbers} values
 * @param {string} title
 */
function range(values, title) {
  const known = values.filter((value) => value !== null);
  return {
    type: 'continuous',
    dimension: 3,
    min: known.reduce((a, b) => Math.min(a, b), Infinity),
    max: known.reduce((a, b) => Math.max(a, b), -Infinity),
    text: [clip(title, 16), ''],
    right: 0,
    top: 'middle',
    inRange: { color: SCALE },
  };
}

/** Published numbers are hollow and grey: what is below shows through. */
export const HOLLOW = { color: 'transparent', borderColor: '#8a929b', borderWidth: 2 };

/**
 * Return the published numbers that have a place on the axes, as a series of hollow marks; [] for none.
 * @param {Api.Points} data
 * @param {Api.PublishedRow[]} rows
 * @returns {any[]}
 */
export function publishedSeries(data, rows) {
  const { x, y } = data.axes;
  if (!y || y.codes) return [];
  /** @param {Api.Axis} axis @param {Api.PublishedRow} row */
  const along = (axis, row) => {
    if (axis.codes) {
      const at = axis.name === 'dataset' ? (axis.categories ?? []).map(String).indexOf(row.dataset) : -1;
      return at < 0 ? null : at;
    }
    const value = row.values[axis.name];
    return value === undefined ? null : value * (axis.factor ?? 1);
  };
  const points = rows
    .map((row) => ({ published: row, value: [along(x, row), along(y, row)] }))
    .filter((one) => one.value.every((number) => number !== null));
  if (!points.length) return [];
  return [
    {
      type: 'scatter',
      id: 'published',
      name: 'published',
      symbol: 'diamond',
      symbolSize: 12,
      itemStyle: HOLLOW,
      data: points,
    },
  ];
}

/**
 * Say what a published number stands for.
 * @param {Api.PublishedRow} row
 */
export const countText = ({ runs, statistic }) =>
  !runs ? 'runs not said' : runs === 1 ? '1 run' : `${statistic ? `${statistic} of ` : ''}${runs} runs`;

/**
 * Say what a published number is and why own ones may differ.
 * @param {Api.PublishedRow} row
 */
export const publishedText = (row) =>
  [
    `published: ${clip(row.system, 60)} on ${clip(row.dataset, 40)}`,
    `${clip(row.where, 80)}, ${countText(row)}`,
    ...row.differences.map((one) => clip(one, 110)),
  ].join('\n');
