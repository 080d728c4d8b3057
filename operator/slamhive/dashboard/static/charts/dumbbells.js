// SPDX-License-Identifier: Apache-2.0
/** Each competitor's own error and its error over the common support, joined by a line. */
import { COLOURS } from '../core/chart.js';
import { clip, keysText, namedValue, number } from '../core/format.js';
import { labelRoom } from './points.js';

const WIDE_RANGE = 5;
const NARROW = 560;
const SERIES = [
  { key: 'own', name: 'own poses', symbol: 'circle', symbolSize: 10, color: COLOURS[1], itemStyle: { color: 'transparent', borderColor: COLOURS[1], borderWidth: 2 } },
  { key: 'common', name: 'common support', symbol: 'diamond', symbolSize: 13, color: COLOURS[0] },
];

/** Return the chart of one group and its height; null where nobody was measured over the common support.
 * @param {object[]} entries of a group of /api/v1/analysis/common, the best first */
export function dumbbells(entries) {
  const measured = entries.map((entry, at) => ({ entry, at })).filter(({ entry }) => entry.common !== null);
  const errors = measured.flatMap(({ entry }) => [entry.own, entry.common]).filter((value) => value !== null);
  if (errors.length === 0) return null;
  const [least, most] = [Math.min(...errors), Math.max(...errors)];
  const log = least > 0 && most / least > WIDE_RANGE;
  const name = (entry, width) => `${entry.common === null ? '× ' : ''}${width < NARROW ? twoLines(entry.keys) : clip(keysText(entry.keys), 46)}`;
  const moved = ({ entry }, key) => entry.rank !== entry.ownRank && (entry.own > entry.common ? 'own' : 'common') === key;
  return {
    height: 110 + entries.length * 28,
    option: ({ width }) => ({
      grid: { left: labelRoom(width, 250), right: 62, top: 34, bottom: 50 }, legend: {},
      tooltip: { trigger: 'item', formatter: (item) => (item.data?.entry ? told(item.data.entry) : '') },
      xAxis: { type: log ? 'log' : 'value', scale: true, name: 'ATE [m]', nameGap: 28, ...(log && { min: rounded(least, Math.floor), max: rounded(most, Math.ceil) }),
        axisLabel: { formatter: (value) => number(value, 2) }, minorTick: { show: log, splitNumber: 9 } },
      yAxis: { type: 'category', inverse: true, data: entries.map((entry) => name(entry, width)), name: '', axisLabel: { interval: 0, width: labelRoom(width, 250) - 14, overflow: 'truncate', ...(width < NARROW && { fontSize: 11, lineHeight: 12 }) } },
      series: [
        { type: 'custom', silent: true, tooltip: { show: false }, encode: { x: [0, 1], y: 2 }, data: measured.filter(({ entry }) => entry.own !== null).map(({ entry, at }) => [entry.own, entry.common, at]),
          renderItem: (_, api) => {
            const [from, to] = [api.coord([api.value(0), api.value(2)]), api.coord([api.value(1), api.value(2)])];
            return { type: 'line', shape: { x1: from[0], y1: from[1], x2: to[0], y2: to[1] }, style: { stroke: COLOURS[8], lineWidth: 3, opacity: 0.6 } };
          } },
        ...SERIES.map(({ key, ...series }) => ({ ...series, type: 'scatter', data: measured.map((one) => ({
          value: [one.entry[key], one.at], entry: one.entry,
          label: { show: moved(one, key), position: 'right', distance: 8, formatter: `${number(one.entry.ownRank)} → ${number(one.entry.rank)}` },
        })) })),
      ],
    }),
  };
}

const twoLines = (keys) => {
  const [first, ...rest] = Object.entries(keys).map(([name, value]) => clip(namedValue(name, value), 46));
  return rest.length ? `${first}\n${rest.join(', ')}` : first;
};

const told = (entry) => [clip(keysText(entry.keys), 100), `own ${number(entry.own)} m, rank ${number(entry.ownRank)}`, `in common ${number(entry.common)} m, rank ${number(entry.rank)}`].join('\n');

/** Return the end of a logarithmic axis: one digit and zeros. */
function rounded(value, towards) {
  const size = 10 ** Math.floor(Math.log10(value));
  return Number((towards(value / size) * size).toPrecision(1));
}
