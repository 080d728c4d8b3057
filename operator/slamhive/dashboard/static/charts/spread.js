// SPDX-License-Identifier: Apache-2.0
/** How far repetitions lie from each other, and scales from 1. */
import { COLOURS } from '../core/chart.js';
import { clip, keysText, namedValue, number, SUBJECT } from '../core/format.js';
import { labelRoom } from './points.js';

const MOST = 30;

/** Return the chart of repetitions over the median of their configuration, and its height; null where nothing was repeated.
 * @param {object} data answer of /api/v1/analysis/repeatability */
export function spreadChart(data) {
  const repeated = data.groups.filter((group) => group.n > 1 && group.figure?.median > 0).slice(0, MOST);
  if (repeated.length === 0) return null;
  const told = Object.keys(repeated[0].keys).sort((a, b) => SUBJECT.includes(a) - SUBJECT.includes(b)).filter((name) => repeated.length === 1 || new Set(repeated.map((group) => String(group.keys[name]))).size > 1);
  const name = (group) => clip(told.map((key) => namedValue(key, group.keys[key])).join(', '), 60);
  const over = (group, value) => value / group.figure.median;
  return {
    height: 90 + repeated.length * 26,
    option: ({ width }) => ({
      grid: { left: labelRoom(width, 290), right: 30, top: 10, bottom: 50 },
      tooltip: { trigger: 'item', formatter: (item) => (item.data?.group ? `${name(item.data.group)}\n${number(item.data.value[0], 4)} of the median ${number(item.data.group.figure.median * (data.metric.factor ?? 1))}\n${clip(item.data.group.verdict, 120)}` : '') },
      xAxis: { type: 'value', scale: true, name: width < 560 ? 'run / median' : 'run over the median of its configuration', nameGap: 26 },
      yAxis: { type: 'category', inverse: true, data: repeated.map(name), name: '', axisLabel: { interval: 0, width: labelRoom(width, 290) - 14, overflow: 'truncate' } },
      series: [
        { type: 'custom', silent: true, tooltip: { show: false }, encode: { x: [0, 1], y: 2 }, data: repeated.map((group, at) => [over(group, group.figure.min), over(group, group.figure.max), at]),
          renderItem: (_, api) => {
            const [from, to] = [api.coord([api.value(0), api.value(2)]), api.coord([api.value(1), api.value(2)])];
            return { type: 'line', shape: { x1: from[0], y1: from[1], x2: to[0], y2: to[1] }, style: { stroke: COLOURS[4], lineWidth: 5, opacity: 0.45 } };
          } },
        { type: 'scatter', symbolSize: 8, color: COLOURS[0], itemStyle: { opacity: 0.8 }, data: repeated.flatMap((group, at) => (group.figure.points ?? [group.figure.min, group.figure.median, group.figure.max]).map((value) => ({ value: [over(group, value), at], group }))) },
      ],
    }),
  };
}

/** Return the chart of suspect scales, and its height. @param {object[]} items of /api/v1/analysis/suspects */
export function suspectChart(items) {
  const shown = items.slice(0, MOST);
  return {
    height: 100 + shown.length * 30,
    option: ({ width }) => ({
      grid: { left: labelRoom(width, 280), right: 30, top: 26, bottom: 50 },
      tooltip: { trigger: 'item', formatter: (item) => (item.data?.item ? `${clip(keysText(item.data.item.keys), 100)}\nscale ${number(item.data.item.scale)} ± ${number(item.data.item.spread, 2)}, ${item.data.item.n} runs` : '') },
      xAxis: { type: 'value', scale: true, name: 'scale of the alignment', nameGap: 26 },
      yAxis: { type: 'category', inverse: true, data: shown.map((item) => clip(keysText(item.keys), 46)), name: '', axisLabel: { interval: 0, width: labelRoom(width, 280) - 14, overflow: 'truncate' } },
      series: [{
        type: 'scatter', symbolSize: 11, color: COLOURS[5], data: shown.map((item, at) => ({ value: [item.scale, at], item })),
        markLine: { silent: true, symbol: 'none', data: [{ xAxis: 1 }], label: { formatter: 'true to scale', position: 'start', color: 'inherit' }, lineStyle: { type: 'dashed' } },
      }],
    }),
  };
}
