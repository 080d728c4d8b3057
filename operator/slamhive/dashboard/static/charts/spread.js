// SPDX-License-Identifier: Apache-2.0
/** How far repetitions lie from each other, and scales from 1. */
import { COLOURS } from '../core/chart.js';
import { clip, keysText, namedValue, number, SUBJECT } from '../core/format.js';
import { labelRoom, lineAtOne, rowAxis, rowLines } from './rows.js';

const MOST = 30;

/**
 * Return the chart of repetitions over the median of their configuration, and its height; null where nothing
 * was repeated.
 * @param {Api.Repeatability} data answer of /api/v1/analysis/repeatability
 * @returns {Drawn|null}
 */
export function spreadChart(data) {
  const repeated = data.groups
    .flatMap((group) => {
      const { min, median, max, points } = group.figure ?? {};
      if (group.n < 2 || !median || median < 0) return [];
      const [low, high] = [min ?? median, max ?? median];
      return [
        {
          keys: group.keys,
          verdict: group.verdict,
          low,
          median,
          high,
          points: points ?? [low, median, high],
        },
      ];
    })
    .slice(0, MOST);
  if (repeated.length === 0) return null;
  const told = Object.keys(repeated[0].keys)
    .sort((a, b) => Number(SUBJECT.includes(a)) - Number(SUBJECT.includes(b)))
    .filter(
      (name) => repeated.length === 1 || new Set(repeated.map((group) => String(group.keys[name]))).size > 1,
    );
  /** @param {{keys: Api.Keys}} group */
  const name = (group) => told.map((key) => namedValue(key, group.keys[key])).join(', ');
  /**
   * @param {{median: number}} group
   * @param {number} value
   */
  const over = (group, value) => value / group.median;
  return {
    height: 90 + repeated.length * 26,
    option: ({ width }) => ({
      grid: { left: labelRoom(width, 290), right: 30, top: 10, bottom: 50 },
      tooltip: {
        trigger: 'item',
        formatter: ({ data: point }) => {
          if (!point?.group) return '';
          const median = number(point.group.median * (data.metric.factor ?? 1));
          return [
            clip(name(point.group), 60),
            `${number(point.value[0], 4)} of the median ${median}`,
            clip(point.group.verdict, 120),
          ].join('\n');
        },
      },
      xAxis: {
        type: 'value',
        scale: true,
        name: width < 560 ? 'run / median' : 'run over the median of its configuration',
        nameGap: 26,
      },
      yAxis: rowAxis(repeated.map(name), width, 290, { lines: 2 }),
      series: [
        rowLines(
          repeated.map((group, at) => [over(group, group.low), over(group, group.high), at]),
          { stroke: COLOURS[5], lineWidth: 5, opacity: 0.45 },
        ),
        {
          type: 'scatter',
          symbolSize: 8,
          color: COLOURS[0],
          itemStyle: { opacity: 0.8 },
          data: repeated.flatMap((group, at) =>
            group.points.map((value) => ({ value: [over(group, value), at], group })),
          ),
        },
      ],
    }),
  };
}

/**
 * Return the chart of suspect scales, and its height.
 * @param {Api.Suspect[]} items of /api/v1/analysis/suspects
 * @returns {Drawn}
 */
export function suspectChart(items) {
  return ratioRows(
    items.slice(0, MOST).map(({ keys, scale, spread, n }) => ({
      name: keysText(keys),
      ratio: scale,
      tooltip: `${clip(keysText(keys), 100)}\nscale ${number(scale)} ± ${number(spread, 2)}, ${n} runs`,
      color: COLOURS[4],
    })),
    'scale of the alignment',
    'true to scale',
  );
}

/**
 * Return the chart of nodes' CPU time by that of others of their kind, and its height.
 * @param {Api.NodeStanding[]} items of /api/v1/analysis/suspects/nodes
 * @returns {Drawn}
 */
export function nodesChart(items) {
  return ratioRows(
    items.slice(0, MOST).map(({ node, ratio, low, high, sentence, verdict }) => ({
      name: node,
      ratio,
      interval: low === null || high === null ? undefined : [low, high],
      tooltip: clip(sentence, 160),
      color: COLOURS[verdict === 'slower' ? 4 : 0],
    })),
    'CPU time by the others’',
    'as the others',
  );
}

/**
 * Return a chart of ratios, a row each, with a line at one.
 * @param {{name: string, ratio: number|null, interval?: number[], tooltip: string, color: string}[]} rows
 * @param {string} axis what the ratio is of
 * @param {string} one what a ratio of one says
 * @returns {Drawn}
 */
function ratioRows(rows, axis, one) {
  return {
    height: 100 + rows.length * 30,
    option: ({ width }) => ({
      grid: { left: labelRoom(width, 280), right: 30, top: 26, bottom: 50 },
      tooltip: { trigger: 'item', formatter: ({ data }) => data?.tooltipText ?? '' },
      xAxis: { type: 'value', scale: true, name: axis, nameGap: 26 },
      yAxis: rowAxis(
        rows.map(({ name }) => name),
        width,
        280,
      ),
      series: [
        rowLines(
          rows.flatMap(({ interval }, at) => (interval ? [[...interval, at]] : [])),
          { stroke: COLOURS[5], lineWidth: 5, opacity: 0.45 },
        ),
        {
          type: 'scatter',
          symbolSize: 11,
          data: rows.map(({ ratio, tooltip, color }, at) => ({
            value: [ratio, at],
            tooltipText: tooltip,
            itemStyle: { color },
          })),
          markLine: lineAtOne(one),
        },
      ],
    }),
  };
}
