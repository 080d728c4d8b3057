// SPDX-License-Identifier: Apache-2.0
/** Competitors against each other: size and direction of the effect, datasets won and lost. */
import { clip, keysText, number } from '../core/format.js';
import { labelRoom, rowAxis } from './rows.js';

const FAINT = '#c9ced4';
const NARROW = 560;

/**
 * Return the chart of one board's pairs and its height.
 * @param {Api.Pair[]} pairs of /api/v1/analysis/compare
 * @param {Api.Heading} metric
 * @returns {Drawn}
 */
export function pairsChart(pairs, metric) {
  const scores = new Map();
  /**
   * @param {Api.Keys} keys
   * @param {number} effect
   */
  const add = (keys, effect) => scores.set(keysText(keys), (scores.get(keysText(keys)) ?? 0) + effect);
  for (const pair of pairs) {
    add(pair.a, pair.effect ?? 0);
    add(pair.b, -(pair.effect ?? 0));
  }
  const names = [...scores.keys()].sort((a, b) => scores.get(b) - scores.get(a));
  const place = new Map(names.map((name, at) => [name, at]));
  const both = pairs.flatMap((pair) => {
    const [a, b] = [place.get(keysText(pair.a)), place.get(keysText(pair.b))];
    return [
      one(pair, a, b, pair.effect, pair.wins.a, pair.wins.b),
      one(pair, b, a, -Number(pair.effect), pair.wins.b, pair.wins.a),
    ];
  });
  return {
    height: Math.max(170, 60 + names.length * 34),
    option: ({ width }) => ({
      grid: { left: labelRoom(width, 220), right: width < NARROW ? 14 : 96, top: 34, bottom: 16 },
      tooltip: {
        trigger: 'item',
        formatter: (item) =>
          item.data?.pair
            ? [
                `${clip(names[item.data.value[1]], 60)} against ${clip(names[item.data.value[0]], 60)}`,
                `effect ${number(item.data.value[2], 2)}, p after Holm ${number(item.data.pair.pHolm, 3)}`,
                `won ${item.data.won}, lost ${item.data.lost} of ${item.data.pair.n} datasets`,
              ].join('\n')
            : '',
      },
      // Columns are the rows' numbers: names would have to be turned, and not all would fit.
      xAxis: {
        type: 'category',
        position: 'top',
        data: names.map((_, at) => String(at + 1)),
        axisLabel: { interval: 0 },
        axisTick: { show: false },
        name: '',
      },
      yAxis: {
        ...rowAxis(
          names.map((name, at) => `${at + 1}\u00a0\u00a0${name}`),
          width,
          220,
          { lines: 2 },
        ),
        axisTick: { show: false },
      },
      visualMap: {
        show: width >= NARROW,
        type: 'continuous',
        min: -1,
        max: 1,
        dimension: 2,
        right: 0,
        top: 'middle',
        itemHeight: 110,
        text: metric.better ? ['better', 'worse'] : ['lower', 'higher'],
        inRange: { color: ['#b795cf', '#efe9f2', '#f2f4f0', '#7dbd90'] },
      },
      series: [
        {
          type: 'heatmap',
          data: both,
          label: {
            show: names.length <= 16,
            fontSize: width < NARROW ? 9 : 12,
            formatter: (item) => item.data.told,
            color: '#16191d',
            opacity: 1,
          },
          itemStyle: { borderColor: FAINT, borderWidth: 0.5 },
        },
      ],
    }),
  };
}

/**
 * @param {Api.Pair} pair
 * @param {number|undefined} row
 * @param {number|undefined} column
 * @param {number|null} effect
 * @param {number} won
 * @param {number} lost
 */
const one = (pair, row, column, effect, won, lost) => ({
  value: [column, row, effect ?? 0],
  pair,
  won,
  lost,
  told: `${won}:${lost}${sure(pair) ? ' *' : ''}`,
  ...(!sure(pair) && { itemStyle: { opacity: 0.25 } }),
});

/**
 * Tell whether a difference is more than chance.
 * @param {Api.Pair} pair
 */
export const sure = ({ pHolm }) => pHolm !== null && pHolm < 0.05;
