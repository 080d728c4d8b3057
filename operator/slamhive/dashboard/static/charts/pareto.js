// SPDX-License-Identifier: Apache-2.0
/** Competitors over two figures with the front of those that nobody beats in both. */
import { COLOURS } from '../core/chart.js';
import { axisName, clip, keysText, number } from '../core/format.js';
import { crossed, withField } from './failures.js';
import { roundEnds } from './limits.js';

/**
 * Return the option of one front's chart; charts of several fronts share their axes unless told otherwise.
 * @param {Api.Pareto} data
 * @param {Api.ParetoFront} front
 * @param {{xlog: boolean, ylog: boolean, own?: boolean}} settings
 * @returns {ChartOption}
 */
export function paretoChart(data, front, { xlog, ylog, own = false }) {
  /** @param {Api.ParetoFront} one */
  const placed = (one) =>
    one.points
      .filter((point) => point.x !== null)
      .map((point) => ({
        ...point,
        sx: Number(point.x) * (data.x.factor ?? 1),
        sy: point.y === null ? null : point.y * (data.y.factor ?? 1),
      }));
  const points = placed(front);
  const every = own ? points : data.fronts.flatMap(placed);
  const known = points.filter((point) => point.sy !== null);
  const differing = Object.keys(points[0]?.keys ?? {}).filter(
    (name) => new Set(points.map(({ keys }) => String(keys[name]))).size > 1,
  );
  /** What tells a point from the others, without settings that it has not. @param {Api.ParetoPoint} point */
  const called = ({ keys }) =>
    keysText(
      Object.fromEntries(
        (differing.length ? differing : ['algorithm'])
          .map((name) => [name, keys[name]])
          .filter(([, value]) => value !== null),
      ),
    );
  // They come with the best in x first, which way that may be.
  const best = known.filter((point) => point.front);
  const option = {
    grid: { left: 72, right: 30, top: 20, bottom: 48 },
    tooltip: {
      trigger: 'item',
      formatter: (/** @type {Item} */ item) => {
        const point = item.data?.point;
        if (!point) return '';
        return [
          clip(keysText(point.keys), 60),
          `${clip(data.x.title, 40)}: ${number(point.sx)}`,
          `${clip(data.y.title, 40)}: ${number(point.sy)}`,
          `n = ${point.n} of ${point.runs}, ${point.failed} failed`,
        ].join('\n');
      },
    },
    xAxis: {
      type: xlog ? 'log' : 'value',
      scale: true,
      name: clip(axisName(data.x), 44),
      nameGap: 28,
      ...endsOf(
        every.map((point) => point.sx),
        xlog,
      ),
    },
    yAxis: {
      type: ylog ? 'log' : 'value',
      scale: true,
      name: `${clip(axisName(data.y), 44)}, median`,
      nameGap: 52,
      ...endsOf(
        every.map((point) => point.sy),
        ylog,
      ),
    },
    series: [
      {
        type: 'line',
        step: 'end',
        symbol: 'none',
        data: best.map((point) => [point.sx, point.sy]),
        lineStyle: { color: COLOURS[1], type: 'dashed' },
        silent: true,
      },
      {
        type: 'scatter',
        symbolSize: 11,
        color: COLOURS[0],
        data: known.map((point) => ({
          value: [point.sx, point.sy],
          ...(!point.front && {
            itemStyle: { color: 'transparent', borderColor: COLOURS[0], borderWidth: 1.8 },
          }),
          point,
        })),
        label: {
          show: points.length <= 14,
          position: 'top',
          fontSize: 11,
          formatter: (/** @type {Item} */ item) => clip(called(item.data.point), 30),
        },
        labelLayout: { hideOverlap: true },
      },
    ],
  };
  const failed = points.filter((point) => point.sy === null);
  return withField(option, 'above', [
    { data: failed.map((point) => ({ value: [point.sx, 0], itemStyle: crossed(COLOURS[0]), point })) },
  ]);
}

/**
 * @param {Array<number|null>} values
 * @param {boolean} log
 */
function endsOf(values, log) {
  const shown = /** @type {number[]} */ (values.filter((one) => one !== null && !(log && one <= 0)));
  return shown.length ? roundEnds({ low: Math.min(...shown), high: Math.max(...shown) }, { log }) : {};
}
