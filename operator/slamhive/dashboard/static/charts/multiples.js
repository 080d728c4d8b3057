// SPDX-License-Identifier: Apache-2.0
/** Small multiples: rows and columns of charts by two settings, with one pair of axes for all of them. */
import { COLOURS, legendOfLines } from '../core/chart.js';
import { axisName, cell, clip, headingOf, namedValue } from '../core/format.js';
import { band, linesOf, reach, tell } from './line.js';
import { outsideText, robustLimits, roundEnds, triedEnds } from './limits.js';
import { CROSS } from './failures.js';

/** Columns and rows of charts: more could not be told apart. */
const MOST_ACROSS = 12;
const MOST_DOWN = 20;
/** Pixels below which a chart shows nothing. */
const NARROW = 84;
const TALL = 128;
const GAP = 10;
const EDGE = { left: 76, right: 30, top: 26, bottom: 52, legend: 30 };
const MOST_LINES = 12;
const FEW = 6;

/**
 * Return the values of a key in their order; what is missing comes last.
 * @param {Api.Group[]} groups
 * @param {string} name
 * @returns {Api.Value[]}
 */
export function valuesOf(groups, name) {
  if (!name) return [null];
  return [...new Set(groups.map((group) => group.keys[name]))].sort((a, b) => {
    if (a === null || b === null) return (a === null ? 1 : 0) - (b === null ? 1 : 0);
    if (typeof a === 'number' && typeof b === 'number') return a - b;
    return String(a).localeCompare(String(b), 'en', { numeric: true });
  });
}

/**
 * Return the drawing: values of rows and columns, lines of each chart, limits that all share.
 * @param {Api.Aggregate} data answer of analysis/aggregate
 * @param {MultiplesSettings} set
 * @returns {Multiples}
 */
export function arranged(data, set) {
  const heading = headingOf(data.metrics, set.y);
  const factor = heading.factor ?? 1;
  const own = [set.x, set.down, set.across];
  const others = data.keys
    .filter(({ name }) => !own.includes(name))
    .filter(({ name }) => new Set(data.groups.map((group) => String(group.keys[name]))).size > 1);
  const [down, across] = [valuesOf(data.groups, set.down), valuesOf(data.groups, set.across)];
  const names = [...new Set(linesOf(data.groups, set.x, set.y, others).map((one) => one.name))];
  const cells = down.flatMap((row, atRow) =>
    across.map((column, atColumn) => {
      const groups = data.groups.filter(
        ({ keys }) => (!set.down || keys[set.down] === row) && (!set.across || keys[set.across] === column),
      );
      return {
        atRow,
        atColumn,
        lines: linesOf(groups, set.x, set.y, others).map(({ name, points }) => ({
          name,
          points: points
            .filter((point) => point.x !== null)
            .map((point) => ({ ...point, ...reach(point.figure, set.figure, factor) })),
        })),
      };
    }),
  );
  const middles = cells.flatMap((one) =>
    one.lines.flatMap((line) => line.points.map((point) => point.middle)),
  );
  const limits = robustLimits(middles, { log: set.ylog });
  return { down, across, names, cells, limits, ends: roundEnds(limits, { log: set.ylog, steps: 3 }) };
}

/**
 * Return the reason that the charts can't be drawn, or null.
 * @param {Multiples} found
 * @param {MultiplesSettings} set
 */
export function tooMany({ down, across }, set) {
  for (const [values, name, most, what] of /** @type {Array<[Api.Value[], string, number, string]>} */ ([
    [across, set.across, MOST_ACROSS, 'columns'],
    [down, set.down, MOST_DOWN, 'rows'],
  ]))
    if (values.length > most)
      return (
        `${clip(name, 60)} has ${values.length} values, and there are at most ${most} ${what} of charts: ` +
        'choose another column, or filter the runs.'
      );
  return null;
}

/**
 * Return the pixels that the charts need, and their option for a size.
 * @param {Api.Aggregate} data
 * @param {MultiplesSettings} set
 * @param {Multiples} found
 * @returns {Drawn & {width: number, notes: string[]}}
 */
export function multiples(data, set, found) {
  const { down, across, names, cells, ends, limits } = found;
  /**
   * @param {string} name
   * @param {Api.Value|undefined} value
   */
  const named = (name, value) => namedValue(headingOf(data.keys, name), value);
  const heading = headingOf(data.metrics, set.y);
  const xHeading = headingOf(data.keys, set.x);
  const legend = names.length > 1;
  const top = EDGE.top + (legend ? EDGE.legend : 0);
  const height = top + EDGE.bottom + down.length * (TALL + GAP) - GAP;
  const category = !['number', 'integer'].includes(xHeading.kind ?? '');
  const xs = valuesOf(data.groups, set.x).filter((value) => value !== null);
  const categories = category ? xs.map((value) => clip(cell(value), 24)) : null;
  /** @type {(value: any) => any} */
  const placeX = (value) => (category ? clip(cell(value), 24) : value * (xHeading.factor ?? 1));
  const numbers = category ? [] : xs.map(placeX);
  const xEnds = category ? {} : triedEnds(numbers, set.xlog, FEW);
  const [floor, ceiling] = [ends.min ?? 0, ends.max ?? 1];
  const notes = [
    outsideText(limits, set.figure),
    cells.some((one) => one.lines.some((line) => line.points.some((point) => point.middle === null)))
      ? 'A cross at the top: runs are there, and none of them counts.'
      : '',
    names.length > MOST_LINES
      ? `${names.length} lines in each chart are too many to be told apart by colour: filter the runs.`
      : '',
  ].filter(Boolean);
  return {
    notes,
    width: EDGE.left + EDGE.right + across.length * (NARROW + GAP),
    height,
    option: ({ width }) => {
      const wide = (width - EDGE.left - EDGE.right + GAP) / across.length - GAP;
      /** @param {number} column */
      const left = (column) => EDGE.left + column * (wide + GAP);
      /** @param {number} row */
      const above = (row) => top + row * (TALL + GAP);
      /** @type {any[]} */
      const series = [];
      for (const [at, one] of cells.entries()) {
        const axes = { xAxisIndex: at, yAxisIndex: at };
        for (const line of one.lines) {
          const index = names.indexOf(line.name);
          const colour = COLOURS[index % COLOURS.length];
          const name = clip(line.name, 90);
          const all = line.points.map((point) => ({ ...point, x: placeX(point.x) }));
          if (!category) all.sort((a, b) => a.x - b.x);
          const drawn = all.filter((point) => point.middle !== null);
          series.push({ ...band(line.name, drawn, colour), ...axes });
          series.push({
            type: 'line',
            name,
            color: colour,
            ...axes,
            symbol: index % 2 ? 'diamond' : 'circle',
            symbolSize: 6,
            showAllSymbol: true,
            clip: true,
            data: drawn.map((point) => ({ value: [point.x, point.middle], point })),
          });
          series.push({
            type: 'scatter',
            name,
            color: colour,
            ...axes,
            clip: false,
            z: 5,
            data: all.flatMap((point) => mark(point, floor, ceiling, colour)),
          });
        }
      }
      return {
        grid: cells.map((one) => ({
          left: left(one.atColumn),
          top: above(one.atRow),
          width: wide,
          height: TALL,
          show: true,
          borderWidth: 0,
        })),
        legend: legend ? legendOfLines(names) : undefined,
        // A hover in one chart marks its x in all.
        axisPointer: { link: [{ xAxisIndex: 'all' }], triggerOn: 'mousemove' },
        tooltip: {
          trigger: 'item',
          formatter: (/** @type {Item} */ item) => {
            const one =
              cells[item.seriesIndex === undefined ? 0 : (series[item.seriesIndex]?.xAxisIndex ?? 0)];
            return [
              ...[
                [set.down, down[one.atRow]],
                [set.across, across[one.atColumn]],
              ].flatMap(([name, value]) => (name ? [clip(named(String(name), value), 60)] : [])),
              tell(item.data?.point, item.seriesName, heading, set.figure),
            ].join('\n');
          },
        },
        xAxis: cells.map((one, at) => ({
          gridIndex: at,
          type: category ? 'category' : set.xlog ? 'log' : 'value',
          data: categories ?? undefined,
          ...xEnds,
          axisPointer: { show: true, type: 'line', triggerTooltip: false, label: { show: false } },
          axisLabel: {
            ...(category ? { interval: 0 } : xEnds.axisLabel),
            show: one.atRow === down.length - 1,
            fontSize: 11,
          },
          axisTick: { ...xEnds.axisTick, show: one.atRow === down.length - 1 },
        })),
        yAxis: cells.map((one, at) => ({
          gridIndex: at,
          type: set.ylog ? 'log' : 'value',
          ...ends,
          axisLabel: { show: one.atColumn === 0, fontSize: 11 },
        })),
        graphic: [
          ...(set.across
            ? across.map((value, at) =>
                words(clip(named(set.across, value), fitting(wide)), left(at) + wide / 2, top - 12),
              )
            : []),
          ...(set.down
            ? down.map((value, at) =>
                words(
                  clip(named(set.down, value), fitting(TALL)),
                  width - EDGE.right + 16,
                  above(at) + TALL / 2,
                  -Math.PI / 2,
                ),
              )
            : []),
          words(clip(axisName(xHeading), 60), (EDGE.left + width - EDGE.right) / 2, height - 14),
          words(
            `${clip(axisName(heading), 44)}, ${set.figure}`,
            14,
            (top + height - EDGE.bottom) / 2,
            Math.PI / 2,
          ),
        ],
        series,
      };
    },
  };
}

/** How many characters of a head fit into some pixels. @param {number} pixels */
const fitting = (pixels) => Math.max(6, Math.floor(pixels / 6.5));

/**
 * A point that has no place within the axes: a triangle at the end beyond which it lies, a cross at the top
 * where no run counts.
 * @param {any} point
 * @param {number} floor
 * @param {number} ceiling
 * @param {string} colour
 * @returns {any[]}
 */
function mark(point, floor, ceiling, colour) {
  if (point.middle === null)
    return [
      {
        value: [point.x, ceiling],
        point,
        symbol: CROSS,
        symbolSize: 8,
        itemStyle: { borderColor: colour, borderWidth: 2 },
      },
    ];
  const up = point.middle > ceiling;
  if (!up && point.middle >= floor) return [];
  return [
    {
      value: [point.x, up ? ceiling : floor],
      point,
      symbol: 'triangle',
      symbolRotate: up ? 0 : 180,
      symbolSize: 10,
    },
  ];
}

/**
 * A text in the drawing, its middle at a place.
 * @param {string} text
 * @param {number} x
 * @param {number} y
 * @param {number} [rotation]
 */
const words = (text, x, y, rotation = 0) => ({
  type: 'text',
  x,
  y,
  rotation,
  silent: true,
  style: { text, align: 'center', verticalAlign: 'middle', fontSize: 12 },
});
