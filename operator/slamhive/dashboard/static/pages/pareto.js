// SPDX-License-Identifier: Apache-2.0
/** Error against cost, or any two figures: who is beaten by nobody in both. */
import { CROSS } from '../charts/failures.js';
import { address } from '../core/address.js';
import { csvOf, useData } from '../core/api.js';
import { Chart, COLOURS } from '../core/chart.js';
import { axisName, clip, columnTitle, keysText, number, signOf } from '../core/format.js';
import { NothingFits, Notes, Waiting } from '../core/parts.js';
import { html, useEffect, useMemo } from '../core/ui.js';

/**
 * @param {{set: Settings, filters: import('../core/address.js').Query, title: string, onError: (error:
 *   Error|null) => void}} props of explore
 */
export function Pareto({ set, filters, title, onError }) {
  const by = [...new Set(['algorithm', 'sensors', set.colour].filter(Boolean))].join(',');
  const url = address('/api/v1/analysis/pareto', filters.with({ x: set.x, y: set.y, by }));
  const { current: data, error } = useData(url);
  useEffect(() => onError(error), [error]);
  const drawn = useMemo(
    () =>
      data?.fronts
        .slice(0, 24)
        .map(
          (/** @type {Api.ParetoFront} */ front) =>
            front.points.some((point) => point.x !== null) && pareto(data, front, set),
        )
        .filter(Boolean),
    [data, set.xlog, set.ylog],
  );
  if (!data) return !error && html`<${Waiting} />`;
  if (drawn.length === 0) return html`<${NothingFits} notes=${data.notes} />`;
  return html`
    <div class=${drawn.length > 1 ? 'facets' : ''}>
      ${drawn.map(
        (/** @type {NonNullable<ReturnType<typeof pareto>>} */ one) => html`
          <${Chart}
            key=${one.name}
            title=${one.name ? `${title}: ${clip(one.name, 100)}` : title}
            option=${one.option}
            height=${360}
            csv=${csvOf(url)}
            table=${one.table}
          />
        `,
      )}
    </div>
    <p class="quiet">
      Filled: nobody is better in both. Crosses: the median run failed.
    </p>
    <${Notes} notes=${data.notes} />
  `;
}

/**
 * @param {Api.Pareto} data
 * @param {Api.ParetoFront} front
 * @param {Settings} set
 */
function pareto(data, front, set) {
  /**
   * @param {number|null} value
   * @param {Api.Heading} heading
   */
  const scaled = (value, heading) =>
    value === null || value === undefined ? null : value * (heading.factor ?? 1);
  const points = front.points
    .map((point) => ({ ...point, sx: Number(scaled(point.x, data.x)), sy: scaled(point.y, data.y) }))
    .filter((point) => point.x !== null);
  // What failed stands beyond the worst of the others.
  const top = Math.max(0, ...points.map((point) => point.sy ?? 0)) * 1.15 || 1;
  const bottom = Math.min(top, ...points.flatMap((point) => point.sy ?? [])) * 0.85;
  const beyond = signOf(data.y) > 0 ? top : bottom;
  // They come with the best in x first, which way that may be.
  const best = points.filter((point) => point.front && point.sy !== null);
  /** @param {Api.ParetoPoint & {sy: number|null}} point */
  const mark = (point) =>
    point.sy === null
      ? {
          symbol: CROSS,
          itemStyle: { borderColor: COLOURS[0], borderWidth: 1.8 },
        }
      : point.front
        ? {}
        : { itemStyle: { color: 'transparent', borderColor: COLOURS[0], borderWidth: 1.8 } };
  const columns = [
    ...Object.keys(points[0]?.keys ?? {}).map((name) => ({ name, title: columnTitle(name) })),
    { ...data.x, name: 'x' },
    { ...data.y, name: 'y' },
    { name: 'front', title: 'on the front' },
    ...['n', 'runs', 'failed'].map((name) => ({ name, title: name, kind: 'integer' })),
    { name: 'coverage', title: 'coverage', kind: 'number' },
  ];
  return {
    name: keysText(front.facets),
    table: {
      columns,
      rows: front.points.map((point) => ({
        ...point.keys,
        ...point,
      })),
    },
    option: {
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
        type: set.xlog ? 'log' : 'value',
        scale: true,
        name: clip(axisName(data.x), 44),
        nameGap: 28,
      },
      yAxis: {
        type: set.ylog ? 'log' : 'value',
        scale: true,
        name: `${clip(axisName(data.y), 44)}, median`,
        nameGap: 52,
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
          data: points.map((point) => ({
            value: [point.sx, point.sy ?? beyond],
            ...mark(point),
            point,
          })),
          label: {
            show: points.length <= 14,
            position: 'top',
            fontSize: 11,
            formatter: (/** @type {Item} */ item) => clip(keysText(item.data.point.keys), 30),
          },
          labelLayout: { hideOverlap: true },
        },
      ],
    },
  };
}
