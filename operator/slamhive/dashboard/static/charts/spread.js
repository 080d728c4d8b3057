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
  const shown = items.slice(0, MOST);
  return {
    height: 100 + shown.length * 30,
    option: ({ width }) => ({
      grid: { left: labelRoom(width, 280), right: 30, top: 26, bottom: 50 },
      tooltip: {
        trigger: 'item',
        formatter: ({ data }) => {
          const item = data?.item;
          if (!item) return '';
          const scale = `scale ${number(item.scale)} ± ${number(item.spread, 2)}, ${item.n} runs`;
          return `${clip(keysText(item.keys), 100)}\n${scale}`;
        },
      },
      xAxis: { type: 'value', scale: true, name: 'scale of the alignment', nameGap: 26 },
      yAxis: rowAxis(
        shown.map((item) => keysText(item.keys)),
        width,
        280,
      ),
      series: [
        {
          type: 'scatter',
          symbolSize: 11,
          color: COLOURS[4],
          data: shown.map((item, at) => ({ value: [item.scale, at], item })),
          markLine: lineAtOne('true to scale'),
        },
      ],
    }),
  };
}

/**
 * Return the chart of nodes' CPU time by that of others of their kind, and its height.
 * @param {Api.NodeStanding[]} items of /api/v1/analysis/suspects/nodes
 * @returns {Drawn}
 */
export function nodesChart(items) {
  const shown = items.slice(0, MOST);
  return {
    height: 100 + shown.length * 30,
    option: ({ width }) => ({
      grid: { left: labelRoom(width, 280), right: 30, top: 26, bottom: 50 },
      tooltip: {
        trigger: 'item',
        formatter: ({ data }) => (data?.item ? clip(data.item.sentence, 160) : ''),
      },
      xAxis: { type: 'value', scale: true, name: 'CPU time by the others’', nameGap: 26 },
      yAxis: rowAxis(
        shown.map((item) => item.node),
        width,
        280,
      ),
      series: [
        rowLines(
          shown.flatMap(({ low, high }, at) => (low === null || high === null ? [] : [[low, high, at]])),
          { stroke: COLOURS[5], lineWidth: 5, opacity: 0.45 },
        ),
        {
          type: 'scatter',
          symbolSize: 11,
          data: shown.map((item, at) => ({
            value: [item.ratio, at],
            item,
            itemStyle: { color: COLOURS[item.verdict === 'slower' ? 4 : 0] },
          })),
          markLine: lineAtOne('as the others'),
        },
      ],
    }),
  };
}
