// SPDX-License-Identifier: Apache-2.0
/** Parallel axes: one line a run; dragging on an axis selects runs for the table below. */
import { address, useAddress } from '../core/address.js';
import { csvOf, useData } from '../core/api.js';
import { Chart, COLOURS } from '../core/chart.js';
import { isNumeric } from '../core/filters.js';
import { cell, clip, cpuColumn, headingOf, number, plural } from '../core/format.js';
import { NothingFits, Notes, Table, Waiting } from '../core/parts.js';
import { html, useEffect, useMemo, useState } from '../core/ui.js';
import { dressed } from '../core/runrows.js';

const MOST = 1000;

/**
 * @param {{set: Settings, columns: Api.Column[], filters: import('../core/address.js').Query, title: string,
 *   onError: (error: Error|null) => void}} props of explore
 */
export function Parallel({ set, columns, filters, onError }) {
  const { query, change } = useAddress();
  const usual = [
    set.x,
    ...columns
      .filter((one) => ['parameters', 'input'].includes(one.group) && one.distinct > 1)
      .map((one) => one.name)
      .slice(0, 5),
    'coverage',
    cpuColumn(columns),
    'usage.memory.peakBytes',
    set.y,
  ];
  const axes = [
    ...new Set(
      query.get('axes')
        ? query.get('axes').split(',').filter(Boolean)
        : usual.filter((name) => columns.some((one) => one.name === name)),
    ),
  ];
  const asked = filters.with({
    columns: [
      ...new Set(
        ['uid', 'run', 'algorithm', 'sensors', 'dataset', 'status', ...axes, set.colour].filter(Boolean),
      ),
    ].join(','),
  });
  const url = address('/api/v1/runs', asked.with({ limit: MOST }));
  const { current: data, error } = useData(url);
  const [active, setActive] = useState(null);
  useEffect(() => onError(error), [error]);
  const option = useMemo(
    () => data && parallel(data, axes, set.colour || 'algorithm'),
    [data, axes.join(' '), set.colour],
  );
  const field = html`
    <label class="field wide">
      <span>Axes, in their order</span>
      <input
        type="text"
        spellcheck="false"
        value=${axes.join(',')}
        onChange=${(event) => change({ axes: event.target.value.replaceAll(' ', '') })}
      />
    </label>
  `;
  if (!data)
    return html`
      <p>${field}</p>
      ${!error && html`<${Waiting} />`}
    `;
  if (data.items.length === 0) return html`<${NothingFits} notes=${data.notes} />`;
  const rows = active
    ? data.items.filter((/** @type {Api.Row} */ _, /** @type {number} */ index) => active.has(index))
    : data.items;
  /**
   * @param {Item} _
   * @param {any} chart
   */
  const select = (_, chart) => {
    const indices = chart
      .getModel()
      .getSeries()
      .flatMap((/** @type {any} */ series) =>
        series
          .getRawIndicesByActiveState('active')
          .map((/** @type {number} */ index) => series.option.data[index].item),
      );
    setActive(indices.length ? new Set(indices) : null);
  };
  return html`
    ${query.get('embed') !== '1' && html`<p>${field}</p>`}
    <${Chart}
      title=${`${plural(data.items.length, 'run')} over ${axes.length} axes`}
      option=${option}
      height=${420}
      csv=${csvOf(address('/api/v1/runs', asked))}
      table=${{ columns: dressed(data.columns), rows: data.items }}
      events=${{ axisareaselected: select }}
    />
    ${
      data.total > MOST &&
      html`
        <p class="quiet">
          The first ${MOST} of ${number(data.total)} runs are drawn; filter them.
        </p>
      `
    }
    <${Notes} notes=${data.notes} />
    <h2>
      ${active ? 'Selected runs' : 'Runs'} <span class="quiet">${number(rows.length)}</span>
    </h2>
    <p class="quiet">
      Drag along an axis to select; click on it to select all again. Runs without a value on an
      axis are drawn with a gap.
    </p>
    <${Table}
      columns=${dressed(data.columns)}
      rows=${rows.slice(0, 50)}
      caption="Runs of the chart"
    />
  `;
}

/**
 * @param {Api.Runs} data
 * @param {string[]} axes
 * @param {string} colour
 */
function parallel(data, axes, colour) {
  /** @param {string} name */
  const heading = (name) => headingOf(data.columns, name);
  const groups = [...new Set(data.items.map((item) => cell(item[colour])))].slice(0, COLOURS.length);
  const texts = Object.fromEntries(
    axes
      .filter((name) => !isNumeric(heading(name)))
      .map((name) => [name, [...new Set(data.items.map((item) => cell(item[name])))]]),
  );
  /**
   * @param {Api.Row} item
   * @param {string} name
   */
  const place = (item, name) =>
    texts[name]
      ? texts[name].indexOf(cell(item[name]))
      : typeof item[name] === 'number'
        ? item[name] * (heading(name).factor ?? 1)
        : '-';
  return {
    parallel: { left: 60, right: 70, top: 84, bottom: 26 },
    legend: groups.length > 1 ? {} : undefined,
    parallelAxis: axes.map((name, dim) => ({
      dim,
      name: clip(heading(name).title.replace(/^(parameters|input)\./, ''), 18),
      nameLocation: 'end',
      ...(texts[name]
        ? { type: 'category', data: texts[name].map((text) => clip(text, 18)) }
        : { type: 'value', scale: true }),
    })),
    tooltip: {
      trigger: 'item',
      formatter: (/** @type {Item} */ item) => `run ${cell(data.items[item.data?.item]?.run)}`,
    },
    series: groups.map((name, number) => ({
      type: 'parallel',
      name: clip(name, 40),
      color: COLOURS[number],
      lineStyle: { width: 1.3, opacity: 0.6, color: COLOURS[number] },
      data: data.items.flatMap((item, index) =>
        cell(item[colour]) === name ? [{ value: axes.map((axis) => place(item, axis)), item: index }] : [],
      ),
    })),
  };
}
