// SPDX-License-Identifier: Apache-2.0
/** Lines over the groups of /api/v1/analysis/aggregate, with the interval or the range around them. */
import { COLOURS, legendOfLines } from '../core/chart.js';
import { axisName, cell, clip, headingOf, keysText, number, shorten } from '../core/format.js';
import { crossed, withField } from './failures.js';
import { roundEnds, triedEnds } from './limits.js';

/**
 * Return one line a combination of all keys but x and the facet.
 * @param {Api.Aggregate} data
 * @param {string} x
 * @param {string} y
 * @param {string|null|undefined} facet
 * @param {string|null|undefined} facetValue
 * @returns {Array<{name: string, points: LinePoint[]}>}
 */
export function lines(data, x, y, facet, facetValue) {
  const others = data.keys
    .filter(({ name }) => name !== x && name !== facet)
    .filter(({ name }) => new Set(data.groups.map((group) => String(group.keys[name]))).size > 1);
  const groups = data.groups.filter((group) => !facet || String(group.keys[facet]) === facetValue);
  return linesOf(groups, x, y, others);
}

/**
 * Return one line a combination of some keys.
 * @param {Api.Group[]} groups
 * @param {string} x
 * @param {string} y
 * @param {Api.Heading[]} others the keys
 * @returns {Array<{name: string, points: LinePoint[]}>}
 */
export function linesOf(groups, x, y, others) {
  /** @type {Map<string, LinePoint[]>} */
  const found = new Map();
  for (const group of groups) {
    const own = Object.fromEntries(others.map(({ name }) => [name, group.keys[name]]));
    const name = keysText(own, others) || 'runs';
    const points = found.get(name) ?? [];
    found.set(name, points);
    points.push({ x: group.keys[x], figure: group.figures[y], group });
  }
  return [...found]
    .map(([name, points]) => ({
      name: shorten(name, 90),
      points: points.filter((point) => point.x !== null),
    }))
    .filter((line) => line.points.length);
}

/**
 * Return the option of a line chart.
 * @param {Api.Aggregate} data answer of analysis/aggregate
 * @param {{x: string, y: string, facet?: string, facetValue?: string|null, among?: Array<string|null>,
 *   own?: boolean, figure: 'median'|'mean', xlog: boolean, ylog: boolean}} settings among: the charts with
 *   which this one shares its axes; own: it doesn't
 * @returns {ChartOption}
 */
export function line(data, settings) {
  const heading = headingOf(data.metrics, settings.y);
  const xHeading = headingOf(data.keys, settings.x);
  const all = lines(data, settings.x, settings.y, settings.facet, settings.facetValue);
  const category = !['number', 'integer', 'time'].includes(xHeading.kind ?? '');
  const factor = heading.factor ?? 1;
  /** @param {any} value */
  const scaleX = (value) =>
    category ? clip(cell(value), 28) : xHeading.kind === 'time' ? value : value * (xHeading.factor ?? 1);
  const { among = [], facet } = settings;
  const shared =
    !settings.own && facet
      ? data.groups.filter((group) => among.includes(String(group.keys[facet])))
      : all.flatMap((one) => one.points.map((point) => point.group));
  const tried = [
    ...new Set(
      shared
        .map((group) => group.keys[settings.x])
        .filter((value) => value !== null)
        .map(scaleX),
    ),
  ];
  const values = shared.flatMap((group) => {
    const { low, middle, high } = reach(group.figures[settings.y], settings.figure, factor);
    return [low, middle, high].flatMap((value) =>
      value === null || (settings.ylog && value <= 0) ? [] : [value],
    );
  });
  // A single chart has ends of its own anyway.
  const ends =
    facet && !settings.own && values.length
      ? roundEnds({ low: Math.min(...values), high: Math.max(...values) }, { log: settings.ylog })
      : { scale: true };
  /** @type {any[]} */
  const failed = [];
  const series = all.flatMap((one, index) => {
    const colour = COLOURS[index % COLOURS.length];
    const every = one.points.map((point) => ({
      ...point,
      x: scaleX(point.x),
      ...reach(point.figure, settings.figure, factor),
    }));
    const points = every.filter((point) => point.middle !== null);
    failed.push({
      name: clip(one.name, 90),
      data: every
        .filter((point) => point.middle === null)
        .map((point) => ({ value: [point.x, 0], point, itemStyle: crossed(colour) })),
    });
    if (!category) points.sort((a, b) => a.x - b.x);
    return [
      band(one.name, points, colour),
      {
        type: 'line',
        name: clip(one.name, 90),
        color: colour,
        symbol: index % 2 ? 'diamond' : 'circle',
        symbolSize: 8,
        showAllSymbol: true,
        data: points.map((point) => ({ value: [point.x, point.middle], point })),
      },
    ];
  });
  const option = {
    grid: { left: 72, right: 24, top: all.length > 1 ? 40 : 16, bottom: 46 },
    legend: all.length > 1 ? legendOfLines(all.map((one) => one.name)) : undefined,
    tooltip: {
      trigger: 'item',
      formatter: (/** @type {Item} */ item) =>
        tell(item.data?.point, item.seriesName, heading, settings.figure),
    },
    xAxis: {
      type: category ? 'category' : settings.xlog ? 'log' : 'value',
      ...(category ? { data: tried } : triedEnds(tried, settings.xlog)),
      name: clip(axisName(xHeading), 50),
      nameGap: 28,
    },
    yAxis: {
      type: settings.ylog ? 'log' : 'value',
      ...ends,
      name: `${clip(axisName(heading), 44)}, ${settings.figure}`,
      nameGap: 52,
    },
    series,
  };
  return withField(option, 'above', failed);
}

/**
 * The middle of a figure and how far it reaches: an interval, or the least and the largest.
 * @param {Api.Figure|undefined} figure
 * @param {'median'|'mean'} which
 * @param {number} factor
 */
export function reach(figure, which, factor) {
  const interval = figure?.[`${which}Interval`];
  const [low, high] = interval ? [interval.low, interval.high] : [figure?.min, figure?.max];
  /** @param {number|null|undefined} value */
  const scaled = (value) => (value === null || value === undefined ? null : value * factor);
  const middle = scaled(figure?.[which]);
  return {
    middle,
    low: scaled(low) ?? middle,
    high: scaled(high) ?? middle,
    interval: interval?.method ?? null,
  };
}

/**
 * @param {string} name
 * @param {Array<Pick<Reached, "x"|"low"|"high">>} points
 * @param {string} colour
 * @returns {ChartOption}
 */
export function band(name, points, colour) {
  return {
    type: 'custom',
    name: clip(name, 90),
    color: colour,
    silent: true,
    z: 1,
    clip: true,
    tooltip: { show: false },
    encode: { x: 0, y: [1, 2] },
    data: points.map((point) => [point.x, point.low, point.high]),
    renderItem: (params, api) => {
      if (params.dataIndex !== 0 || points.length === 0) return null;
      /** @param {'low'|'high'} key */
      const edge = (key) => points.map((point) => api.coord([point.x, point[key]]));
      return {
        type: 'polygon',
        shape: { points: [...edge('high'), ...edge('low').reverse()] },
        style: { fill: colour, opacity: 0.16, stroke: colour, lineWidth: 1 },
      };
    },
  };
}

/**
 * @param {Reached|undefined} point
 * @param {string} name
 * @param {Api.Heading} heading
 * @param {string} which
 */
export function tell(point, name, heading, which) {
  if (!point) return '';
  const { group, figure, middle } = point;
  const failures = Object.entries(group.failures ?? {})
    .map(([what, count]) => `${count} ${what}`)
    .join(', ');
  return [
    clip(name, 60),
    `${clip(heading.title, 40)} (${which}): ${middle === null ? 'no run counts' : number(middle)}`,
    `${point.interval ?? 'least to largest'}: ${number(point.low)} to ${number(point.high)}`,
    `n = ${figure?.n} of ${group.runs} runs${failures ? `; ${failures}` : ''}`,
    `coverage: ${number(group.coverage?.mean, 3)}`,
  ].join('\n');
}
