// SPDX-License-Identifier: Apache-2.0
/** A search drawn: how the best came about, the front between two objectives, and the settings tried. */
import { COLOURS } from '../core/chart.js';
import { cell, clip, number } from '../core/format.js';
import { ramp } from '../core/scale.js';
import { crossed, withField } from './failures.js';

const FAINT = '#8a929c';
/** Spread from which on an axis is logarithmic. */
const STEEP = 20;
const MOST_FRONTS = 3;

/** @param {Api.SweepSearch} data @param {number} objective @param {number|null|undefined} value */
const shown = (data, objective, value) =>
  value === null || value === undefined ? null : value * (data.metrics[objective].factor ?? 1);

/** @param {Api.SweepSearch} data @param {Api.Trial} trial @param {number} objective */
const figure = (data, trial, objective) => shown(data, objective, trial.figures[objective]);

/** @param {Array<number|null>} values */
const steep = (values) => {
  const known = /** @type {number[]} */ (values.filter((value) => value !== null));
  const low = Math.min(...known);
  return known.length > 1 && low > 0 && Math.max(...known) > STEEP * low;
};

/**
 * Return a setting as a text of few words.
 * @param {Api.SweepSearch} data
 * @param {Api.Trial} trial
 */
export const settingText = (data, trial) =>
  data.axes
    .map(({ label }, at) => `${clip(data.titles[at], 30)} ${clip(valueText(trial.values[label]), 40)}`)
    .join('\n');

/** @param {any} value */
const valueText = (value) => (typeof value === 'number' ? number(value) : cell(value));

/**
 * Return what is said of a setting where the pointer is.
 * @param {Api.SweepSearch} data
 * @param {Api.Trial} trial
 */
export function trialText(data, trial) {
  const figures = data.metrics.map(
    (metric, at) => `${metric.title} ${trial.figures[at] === null ? '–' : cell(trial.figures[at], metric)}`,
  );
  const count = Math.round((trial.failed ?? 0) * trial.judged);
  const failed = count ? [`${count} of ${trial.judged} runs failed`] : [];
  const why = trial.dropped ? [clip(trial.dropped, 120)] : [];
  const first = `setting ${trial.number}: ${trial.state}`;
  return [first, ...figures, ...failed, ...why, settingText(data, trial)].join('\n');
}

/**
 * Tell whether figures of settings that were dropped may stand on the axis of those with all runs: with
 * several datasets they are of the first ones alone.
 * @param {Api.SweepSearch} data
 */
const comparable = (data) => data.contexts.length < 2;

/**
 * Return the chart of the best so far over the runs that were computed; null where there is none yet.
 * @param {Api.SweepSearch} data with one objective
 */
export function bestSoFar(data) {
  const trials = data.trials.filter((trial) => trial.runs > 0);
  if (!trials.length) return null;
  /** @param {Api.Trial} trial @param {any} at */
  const point = (trial, at) => ({ value: [trial.at, at], trial });
  const complete = trials.filter((trial) => trial.state === 'all runs' || trial.state === 'best');
  const rest = trials.filter((trial) => trial.state === 'dropped');
  const curve = data.history.map((step) => [step.runs, figure(data, data.trials[step.best[0]], 0)]);
  const last = curve[curve.length - 1];
  if (last) curve.push([Math.max(data.computed, Number(last[0])), last[1]]);
  const beside = comparable(data) ? rest.filter((trial) => trial.figures[0] !== null) : [];
  const [lost, dropped] = [
    // Of whom nothing is known nobody can say that it failed.
    [...complete, ...rest].filter((trial) => trial.figures[0] === null && trial.failed !== null),
    rest.filter((trial) => trial.figures[0] !== null && !beside.includes(trial)),
  ];
  const values = [...complete, ...beside].map((trial) => figure(data, trial, 0));
  const names = dropped.length ? ['dropped', 'failed'] : ['failed'];
  const option = {
    grid: { left: 66, right: 24, top: 34, bottom: 46 },
    legend: { data: ['best so far', 'with all runs', ...(beside.length ? ['dropped'] : [])] },
    tooltip: {
      trigger: 'item',
      formatter: (/** @type {Item} */ item) => (item.data?.trial ? trialText(data, item.data.trial) : ''),
    },
    xAxis: { type: 'value', min: 0, max: Math.max(1, data.computed), name: 'runs computed', nameGap: 26 },
    yAxis: {
      type: steep(values) ? 'log' : 'value',
      scale: true,
      name: clip(data.metrics[0].label ?? data.metrics[0].title, 50),
      nameGap: 50,
    },
    series: [
      {
        name: 'dropped',
        type: 'scatter',
        symbolSize: 6,
        itemStyle: { color: FAINT, opacity: 0.35 },
        data: beside.map((trial) => point(trial, figure(data, trial, 0))),
      },
      {
        name: 'with all runs',
        type: 'scatter',
        symbolSize: 8,
        itemStyle: { color: 'transparent', borderColor: COLOURS[0], borderWidth: 1.5 },
        data: complete.flatMap((trial) =>
          trial.figures[0] === null ? [] : [point(trial, figure(data, trial, 0))],
        ),
      },
      {
        name: 'best so far',
        type: 'line',
        step: 'end',
        symbol: 'none',
        lineStyle: { width: 2.5, color: COLOURS[4] },
        itemStyle: { color: COLOURS[4] },
        data: curve,
      },
    ],
  };
  const crosses = [
    { itemStyle: crossed(), data: lost.map((trial) => point(trial, names.length - 1)) },
    {
      symbol: 'circle',
      symbolSize: 6,
      itemStyle: { color: FAINT, opacity: 0.55 },
      data: dropped.map((trial) => point(trial, 0)),
    },
  ];
  return withField(option, 'above', crosses, 0, names);
}

/**
 * Return the chart of the front between two objectives, and how it grew.
 * @param {Api.SweepSearch} data with two objectives
 */
export function growingFront(data) {
  const complete = data.trials.filter((trial) => trial.state === 'all runs' || trial.state === 'best');
  const known = complete.filter((trial) => trial.figures.every((value) => value !== null));
  if (!known.length) return null;
  const parts = [1, 2, 3].map((part) => Math.ceil((data.history.length * part) / MOST_FRONTS) - 1);
  const places = [...new Set(parts)];
  const fronts = places.filter((place) => place >= 0).map((place) => data.history[place]);
  const small = data.objectives.every(({ goal }) => goal === 'Minimize');
  /** @param {Api.Trial} trial */
  const point = (trial) => ({ value: [figure(data, trial, 0), figure(data, trial, 1)], trial });
  const axes = [0, 1].map((at) => ({
    type: steep(known.map((trial) => figure(data, trial, at))) ? 'log' : 'value',
    scale: true,
    name: clip(data.metrics[at].label ?? data.metrics[at].title, 50),
    nameGap: at ? 50 : 26,
  }));
  return {
    grid: { left: 66, right: 24, top: 34, bottom: 46 },
    legend: { data: fronts.map((front) => `after ${front.runs} runs`) },
    tooltip: {
      trigger: 'item',
      formatter: (/** @type {Item} */ item) => (item.data?.trial ? trialText(data, item.data.trial) : ''),
    },
    xAxis: axes[0],
    yAxis: axes[1],
    series: [
      {
        type: 'scatter',
        symbolSize: 7,
        itemStyle: { color: FAINT, opacity: 0.5 },
        data: known.filter((trial) => trial.state !== 'best').map(point),
      },
      ...fronts.map((front, at) => {
        const last = at === fronts.length - 1;
        const colour = last ? COLOURS[4] : ramp(at / 2);
        const items = front.best
          .map((place) => point(data.trials[place]))
          .sort((a, b) => Number(a.value[0]) - Number(b.value[0]));
        return {
          name: `after ${front.runs} runs`,
          type: 'line',
          step: small && 'end',
          symbol: last ? 'circle' : 'none',
          symbolSize: 9,
          lineStyle: { width: last ? 2.5 : 1.5, color: colour, opacity: last ? 1 : 0.7 },
          itemStyle: { color: colour },
          data: items,
        };
      }),
    ],
  };
}

/**
 * Return an axis that reaches as far as its values do.
 * @param {number[]} values
 * @param {boolean} log
 */
function endsOf(values, log) {
  const [low, high] = [Math.min(...values), Math.max(...values)];
  if (!(log && low > 0 && high > low)) return { type: 'value', scale: true };
  const formatter = (/** @type {number} */ value) => number(value, 2);
  return { type: 'log', min: low, max: high, axisLabel: { formatter } };
}

/**
 * Return the chart of all settings, a line each over the axes, coloured by one objective; dropped ones faint.
 * @param {Api.SweepSearch} data
 * @param {number} objective
 * @param {boolean} [down] whether axes lie below each other, as a phone has room for
 */
export function settingLines(data, objective, down = false) {
  const trials = data.trials.filter((trial) => trial.runs > 0);
  const complete = trials.filter((trial) => trial.state === 'all runs' || trial.state === 'best');
  const sign = data.objectives[objective]?.goal === 'Maximize' ? -1 : 1;
  const order = complete
    .filter((trial) => trial.figures[objective] !== null)
    .sort((a, b) => sign * (Number(a.figures[objective]) - Number(b.figures[objective])));
  const ranks = new Map(order.map((trial, rank) => [trial.number, rank / Math.max(1, order.length - 1)]));
  const axes = data.axes.map(({ label, log }, dim) => {
    const values = trials.map((trial) => trial.values[label]);
    const numeric = values.every((value) => typeof value === 'number');
    const texts = numeric ? null : [...new Set(values.map((value) => valueText(value)))];
    const name = clip(data.titles[dim], 18);
    return {
      label,
      texts,
      axis: texts
        ? { dim, name, type: 'category', data: texts.map((text) => clip(text, 18)) }
        : { dim, name, ...endsOf(values, log) },
    };
  });
  const figures = data.metrics.map((metric, at) => ({
    dim: axes.length + at,
    name: clip(metric.title, 18),
    type: steep(order.map((trial) => figure(data, trial, at))) ? 'log' : 'value',
    scale: true,
  }));
  /** @param {Api.Trial} trial */
  const line = (trial) => {
    const rank = ranks.get(trial.number);
    const best = trial.state === 'best';
    const colour = best ? COLOURS[4] : rank === undefined ? FAINT : ramp(rank);
    return {
      trial,
      value: [
        ...axes.map(({ label, texts }) =>
          texts ? texts.indexOf(valueText(trial.values[label])) : trial.values[label],
        ),
        ...data.metrics.map((_, at) => (rank === undefined ? '-' : (figure(data, trial, at) ?? '-'))),
      ],
      lineStyle: {
        color: colour,
        width: best ? 3 : rank === undefined ? 1 : 1.6,
        opacity: best ? 1 : rank === undefined ? 0.22 : 0.85,
      },
    };
  };
  const items = [...trials.filter((trial) => !ranks.has(trial.number)), ...[...order].reverse()].map(line);
  return {
    parallel: {
      layout: down ? 'vertical' : 'horizontal',
      left: down ? 34 : 60,
      right: down ? 110 : 70,
      top: down ? 20 : 40,
      bottom: 30,
      parallelAxisDefault: { nameLocation: 'end', nameGap: down ? 10 : 16 },
    },
    parallelAxis: [...axes.map(({ axis }) => axis), ...figures],
    tooltip: {
      trigger: 'item',
      formatter: (/** @type {Item} */ item) => (item.data?.trial ? trialText(data, item.data.trial) : ''),
    },
    series: [{ type: 'parallel', progressive: 0, smooth: false, data: items }],
  };
}
