// SPDX-License-Identifier: Apache-2.0
/** Boxes of quartiles with every run drawn over them; fewer than five runs get no box. */
import { COLOURS } from '../core/chart.js';
import { clip, namedText, number } from '../core/format.js';
import { quantile } from './limits.js';
import { asCategories, axisOption, endsOf, readAxis } from './points.js';

const MOST_POINTS = 2000;
const [LEFT, RIGHT] = [72, 24];

/**
 * Return the option of a box chart, a function of its size; null where x has too many values.
 * @param {Api.Points} data answer of analysis/points
 * @param {number[]} indices which of its points
 * @param {{ylog: boolean, tracked: boolean, own?: boolean}} settings tracked: only tracked runs count; own:
 *   its axes are for its own runs alone
 * @returns {((size: Size) => ChartOption) | null}
 */
export function box(data, indices, { ylog, tracked, own = false }) {
  const every = asCategories(readAxis(data.axes.x), data.count);
  if (!every) return null;
  const shared = Boolean(data.axes.facet) && !own;
  const x = shared ? every : present(every, indices);
  const y = readAxis(data.axes.y);
  const status = readAxis(data.status);
  const all = Array.from({ length: data.count }, (_, index) => index);
  const ends = endsOf(y, all, { log: ylog, vertical: true });
  const colour = data.axes.colour ? asCategories(readAxis(data.axes.colour), data.count, 12) : null;
  const counted = indices.filter(
    (index) => x.at(index) !== null && y.at(index) !== null && (!tracked || status.text(index) === 'Tracked'),
  );
  const groups = colour
    ? colour.categories
        .map((text, group) => ({
          name: namedText(colour.heading, text),
          group,
          members: counted.filter((index) => colour.at(index) === group),
        }))
        .filter((one) => one.members.length)
    : [{ name: 'runs', group: 0, members: counted }];
  /** @param {number} width */
  const series = (width) =>
    groups.flatMap(({ name, group, members }, at) => {
      const cells = x.categories.map((_, place) => members.filter((index) => x.at(index) === place));
      const boxes = cells.map((cell) =>
        cell.length < 5 ? ['-'] : five(cell.map((index) => Number(y.at(index)))),
      );
      const dots =
        members.length <= MOST_POINTS ? members.map((index) => [x.at(index), y.at(index), index]) : [];
      return [
        {
          type: 'boxplot',
          name: clip(name, 90),
          data: boxes,
          boxWidth: [6, 46],
          itemStyle: { color: 'transparent', borderWidth: 1.5 },
          id: `box${group}`,
        },
        {
          type: 'scatter',
          name: clip(name, 90),
          data: dots,
          symbolSize: 6,
          symbolOffset: [besideOthers(at, groups.length, (width - LEFT - RIGHT) / x.categories.length), 0],
          itemStyle: { opacity: 0.65 },
          id: `dot${group}`,
        },
      ].map((one) => ({ ...one, colorBy: 'series', ...tint(group, one.itemStyle) }));
    });
  /** @param {number} index */
  const told = (index) =>
    [
      `run ${data.run?.[index] ?? ''}`,
      `${clip(y.heading.title, 40)}: ${y.text(index)}`,
      status.text(index),
    ].join('\n');
  return ({ width }) => ({
    grid: { left: LEFT, right: RIGHT, top: colour ? 40 : 16, bottom: 72 },
    legend: colour ? { data: groups.map(({ name }) => clip(name, 90)) } : undefined,
    tooltip: {
      trigger: 'item',
      formatter: (item) =>
        item.seriesType === 'scatter'
          ? told(item.value[2])
          : ['least', 'lower quartile', 'median', 'upper quartile', 'largest']
              .map((what, at) => `${what}: ${number(item.value[at + 1])}`)
              .join('\n'),
    },
    xAxis: twoLines(
      axisOption({
        ...x,
        categories: x.categories.map((name, at) => {
          const here = indices.filter((index) => x.at(index) === at);
          const n = counted.filter((index) => x.at(index) === at).length;
          return `${clip(name, 18)}\nn ${n}/${here.length}`;
        }),
      }),
    ),
    yAxis: { ...axisOption(y, { log: ylog, vertical: true }), ...(shared && ends) },
    series: series(width),
  });
}

/**
 * Return the distance of one series' boxes from the middle of their category: as ECharts lays several of
 * them out.
 * @param {number} at
 * @param {number} count
 * @param {number} band
 */
function besideOthers(at, count, band) {
  const room = band * 0.8 - 2;
  const gap = (room / count) * 0.3;
  const box = (room - gap * (count - 1)) / count;
  return count > 1 ? box / 2 - room / 2 + at * (gap + box) : 0;
}

/**
 * Labels of two lines need more room below the axis.
 * @param {Record<string, any>} axis
 */
const twoLines = (axis) => ({
  ...axis,
  nameGap: 44,
  axisLabel: { ...axis.axisLabel, lineHeight: 15, rotate: 0 },
});

/**
 * Keep the categories that some of the points have.
 * @param {CategoryAxis} axis
 * @param {number[]} indices
 * @returns {CategoryAxis}
 */
function present(axis, indices) {
  const used = [...new Set(indices.map(axis.at))].filter((place) => place !== null).sort((a, b) => a - b);
  /** @type {Map<number|null, number>} */
  const place = new Map(used.map((value, at) => [value, at]));
  return {
    ...axis,
    categories: used.map((value) => axis.categories[value]),
    at: (index) => place.get(axis.at(index)) ?? null,
  };
}

/**
 * @param {number} group
 * @param {Record<string, any>} style
 */
const tint = (group, style) => ({
  itemStyle: { ...style, borderColor: COLOURS[group], ...(style.color ? {} : { color: COLOURS[group] }) },
  color: COLOURS[group],
});

/**
 * The least, the quartiles and the largest of some values.
 * @param {number[]} values
 */
function five(values) {
  const sorted = [...values].sort((a, b) => a - b);
  return [sorted[0], quantile(sorted, 0.25), quantile(sorted, 0.5), quantile(sorted, 0.75), sorted.at(-1)];
}
