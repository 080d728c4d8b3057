// SPDX-License-Identifier: Apache-2.0
/** What a change did in each setting: median after over median before. */
import { COLOURS } from '../core/chart.js';
import { cell, clip, number, signOf } from '../core/format.js';
import { crossed, withField } from './failures.js';
import { labelRoom, lineAtOne, rowAxis } from './rows.js';

const MOST = 40;
const WIDE_RANGE = 5;
const NARROW = 560;
const SIGNS = {
  better: ['circle', COLOURS[2]],
  worse: ['diamond', COLOURS[4]],
  same: ['emptyCircle', COLOURS[8]],
};

/**
 * Return the verdict on a setting.
 * @param {Api.Setting} setting
 * @param {number} sign -1 where large is good
 * @returns {'better'|'worse'|'same'}
 */
const verdict = ({ before, after }, sign) => {
  if (before.medianFailed || after.medianFailed)
    return before.medianFailed === after.medianFailed ? 'same' : after.medianFailed ? 'worse' : 'better';
  const [now, then] = [sign * Number(after.median), sign * Number(before.median)];
  return now < then ? 'better' : now > then ? 'worse' : 'same';
};

/**
 * Return a setting in words.
 * @param {Api.Keys} keys
 * @param {string[]} told columns that tell settings apart
 * @param {boolean} [short] whether values do without their names
 */
export const settingText = (keys, told, short = false) =>
  told
    .map((name) =>
      short || name === 'dataset'
        ? cell(keys[name])
        : `${name.replace(/^(parameters|input)\./, '')} ${cell(keys[name])}`,
    )
    .join(', ');

/**
 * Return the columns that tell settings apart; the dataset where there is a single one.
 * @param {Array<{keys: Api.Keys}>} settings
 */
export const toldApart = (settings) => {
  const names = Object.keys(settings[0]?.keys ?? {});
  const varied = names.filter((name) => new Set(settings.map((one) => String(one.keys[name]))).size > 1);
  return varied.length ? varied : names.slice(0, 1);
};

/**
 * Return the chart of a change and its height; null where nothing can be drawn.
 * @param {{settings: Api.Setting[]}} change of /api/v1/analysis/versions
 * @param {Api.Heading} metric
 * @returns {Drawn|null}
 */
export function ratioChart(change, metric) {
  const sign = signOf(metric);
  const shown = change.settings.slice(0, MOST);
  const known = shown
    .filter((one) => !failed(one))
    .map((one) => Number(one.ratio))
    .filter((ratio) => ratio > 0);
  if (shown.length === 0) return null;
  const [least, most] = [Math.min(1, ...known), Math.max(1, ...known)];
  const log = most / least > WIDE_RANGE;
  const told = toldApart(shown);
  return {
    height: 100 + shown.length * 26,
    option: ({ width }) =>
      withField(
        {
          grid: { left: labelRoom(width, 280), right: 30, top: 30, bottom: 50 },
          tooltip: {
            trigger: 'item',
            formatter: (/** @type {Item} */ item) =>
              item.data?.one
                ? `${clip(settingText(item.data.one.keys, told), 120)}\n${words(item.data.one)}`
                : '',
          },
          xAxis: {
            type: log ? 'log' : 'value',
            scale: true,
            name: width < NARROW ? 'after / before' : 'median after over median before',
            nameGap: 28,
            axisLabel: { formatter: (/** @type {number} */ value) => number(value, 3) },
          },
          yAxis: rowAxis(
            shown.map((one) => settingText(one.keys, told, width < NARROW)),
            width,
            280,
          ),
          series: [
            {
              type: 'scatter',
              data: shown.flatMap((one, at) => {
                if (failed(one) || one.ratio === null || (log && one.ratio <= 0)) return [];
                const [symbol, told] = SIGNS[verdict(one, sign)];
                // Nothing is good or bad of a figure of which nobody has said which way is good.
                const color = metric.better ? told : COLOURS[0];
                return [{ value: [one.ratio, at], one, symbolSize: 11, symbol, itemStyle: { color } }];
              }),
              markLine: lineAtOne('as before'),
            },
            // Nobody sees it: it keeps 1 on the axis.
            { type: 'scatter', silent: true, symbolSize: 0.1, itemStyle: { opacity: 0 }, data: [[1, 0]] },
          ],
        },
        'beside',
        [
          {
            data: shown.flatMap((one, at) =>
              failed(one) ? [{ value: [0, at], one, itemStyle: crossed(SIGNS[verdict(one, sign)][1]) }] : [],
            ),
          },
        ],
        width,
      ),
  };
}

/** @param {Api.Setting} setting */
const failed = ({ before, after }) => before.medianFailed || after.medianFailed;

/** @param {Api.Setting} one */
const words = (one) => {
  if (!failed(one)) return `${number(one.ratio, 3)} times what it was`;
  if (!one.after.medianFailed) return 'the median run failed before';
  return one.before.medianFailed ? 'the median run failed before and after' : 'the median run fails now';
};
