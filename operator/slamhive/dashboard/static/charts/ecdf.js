// SPDX-License-Identifier: Apache-2.0
/**
 * Cumulative shares: which share of the runs has at most a figure, at least where large is good; failed runs
 * never reach one.
 */
import { COLOURS, legendOfLines } from '../core/chart.js';
import { axisName, clip, keysText, number, signOf } from '../core/format.js';
import { outsideText, robustLimits, roundEnds } from './limits.js';

/** Keys that charts are told apart by, rather than the curves in them. */
const APART = ['dataset'];
const DASHES = ['solid', 'dashed', 'dotted'];

/**
 * Return the charts: the curves of each, with a name that tells them apart, and limits that all share.
 * @param {Api.Ecdf} data answer of analysis/ecdf
 * @param {{facet: string, xlog: boolean}} set
 */
export function curveCharts(data, { facet, xlog }) {
  const varied = data.keys
    .map((key) => key.name)
    .filter((name) => new Set(data.curves.map((curve) => String(curve.keys[name]))).size > 1);
  const apart = varied.filter((name) => name === facet || APART.includes(name));
  const within = varied.filter((name) => !apart.includes(name));
  /**
   * @param {Api.Keys} keys
   * @param {string[]} names
   */
  const told = (keys, names) =>
    keysText(Object.fromEntries(names.map((name) => [name, keys[name]])), data.keys);
  const factor = data.metric.factor ?? 1;
  const names = [...new Set(data.curves.map((curve) => told(curve.keys, within)))];
  /** @type {Map<string, DrawnCurve[]>} */
  const charts = new Map();
  for (const curve of data.curves) {
    const chart = told(curve.keys, apart);
    const name = told(curve.keys, within);
    const held = charts.get(chart) ?? [];
    charts.set(chart, held);
    held.push({
      ...curve,
      name: name || 'runs',
      // The same name has the same look in all charts.
      place: names.indexOf(name),
      x: curve.x.map((value) => value * factor),
    });
  }
  const limits = robustLimits(
    data.curves.flatMap((curve) => curve.x.map((value) => value * factor)),
    { log: xlog },
  );
  return { charts: [...charts].map(([name, curves]) => ({ name, curves })), limits };
}

/**
 * Return the corners of a curve's steps, from the good end of the axis to its bad one.
 * @param {{x: number[], share: number[]}} curve with the best first
 * @param {number} good
 * @param {number} bad
 * @returns {number[][]}
 */
export function steps({ x, share }, good, bad) {
  const sign = good <= bad ? 1 : -1;
  const inside = x.map((value, at) => [value, share[at]]).filter(([value]) => sign * (bad - value) >= 0);
  const first = inside.findLastIndex(([value]) => sign * (good - value) > 0);
  const shown = inside.slice(first + 1);
  const begin = first < 0 ? 0 : inside[first][1];
  return [[good, begin], ...shown, [bad, shown.length ? shown[shown.length - 1][1] : begin]];
}

/**
 * Return the option of one chart.
 * @param {Api.Heading} metric
 * @param {DrawnCurve[]} curves
 * @param {Limits|null} limits that all charts share
 * @param {boolean} xlog
 * @returns {ChartOption}
 */
export function ecdfChart(metric, curves, limits, xlog) {
  const ends = roundEnds(limits, { log: xlog });
  const sign = signOf(metric);
  const [good, bad] = sign > 0 ? [ends.min ?? 0, ends.max ?? 1] : [ends.max ?? 1, ends.min ?? 0];
  return {
    grid: { left: 60, right: 26, top: curves.length > 1 ? 40 : 16, bottom: 48 },
    legend: curves.length > 1 ? legendOfLines(curves.map((one) => one.name)) : undefined,
    tooltip: {
      trigger: 'axis',
      axisPointer: { type: 'line' },
      formatter: (/** @type {Item[]} */ items) => {
        const at = Number(items[0].axisValue);
        return [
          `${clip(axisName(metric), 40)} ${sign > 0 ? '≤' : '≥'} ${number(at)}`,
          ...curves.map((one) => {
            const reached = one.x.findLastIndex((value) => sign * (at - value) >= 0);
            const share = reached < 0 ? 0 : one.share[reached];
            return `${clip(one.name, 90)}: ${number(100 * share, 3)} % of ${one.total} runs`;
          }),
        ].join('\n');
      },
    },
    xAxis: {
      type: xlog ? 'log' : 'value',
      ...ends,
      name: clip(axisName(metric), 50),
      nameGap: 28,
    },
    yAxis: { type: 'value', min: 0, max: 1, name: 'share of runs', nameGap: 38 },
    series: curves.flatMap((one) => {
      const colour = COLOURS[one.place % COLOURS.length];
      const beyond = one.x.filter((value) => sign * (value - bad) > 0).length;
      return [
        {
          type: 'line',
          step: 'end',
          symbol: 'none',
          name: clip(one.name, 90),
          color: colour,
          lineStyle: { width: 2, type: DASHES[Math.floor(one.place / COLOURS.length) % DASHES.length] },
          data: steps(one, good, bad),
        },
        ...(beyond
          ? [
              {
                type: 'scatter',
                name: clip(one.name, 90),
                color: colour,
                symbol: 'triangle',
                symbolRotate: -90 * sign,
                symbolSize: 10,
                clip: false,
                silent: true,
                data: [[bad, steps(one, good, bad).at(-1)?.[1] ?? 0]],
              },
            ]
          : []),
      ];
    }),
  };
}

/**
 * Say what lies beyond the ends of the charts.
 * @param {Limits|null} limits
 */
export const beyondText = (limits) => outsideText(limits, 'run');
