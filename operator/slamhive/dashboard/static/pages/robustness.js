// SPDX-License-Identifier: Apache-2.0
/** Robustness card: a chart for each axis, a row for each system. */
import { reachChart } from '../charts/reach.js';
import { Chart } from '../core/chart.js';
import { clip, keysText, number } from '../core/format.js';
import { Table } from '../core/parts.js';
import { html, useMemo } from '../core/ui.js';

/** @param {{data: Api.Robustness, csv: string, without: Shown}} props */
export function Robustness({ data, csv, without }) {
  const drawn = useMemo(
    () =>
      data.axes.map((axis, place) => {
        const rows = data.systems.map(({ keys, cells }) => ({ name: keysText(keys), cell: cells[place] }));
        const table = rows.flatMap(({ name, cell }) => (cell ? [{ name, ...cell }] : []));
        return { axis, table, ...reachChart(axis, rows) };
      }),
    [data],
  );
  if (drawn.length === 0) return without;
  /** @type {TableColumn[]} */
  const columns = [
    { name: 'name', title: 'system', show: (name) => clip(name, 80) },
    {
      name: 'sentence',
      title: 'in words',
      show: (text) => html`<span class="wrapped">${clip(text, 400)}</span>`,
    },
    { name: 'passing', title: 'passes up to', kind: 'number', show: (value) => number(value, 4) },
    { name: 'failing', title: 'fails at', kind: 'number', show: (value) => number(value, 4) },
    { name: 'runs', title: 'runs', kind: 'integer' },
  ];
  return drawn.map(
    ({ axis, table, option, height }) => html`
      <section>
        <${Chart}
          option=${option}
          height=${height}
          csv=${csv}
          table=${{ columns, rows: table }}
          title=${clip(axis.title, 120)}
        />
        <${Table} columns=${columns} rows=${table} caption=${`Thresholds on ${clip(axis.title, 100)}`} />
      </section>
    `,
  );
}
