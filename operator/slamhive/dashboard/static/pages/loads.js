// SPDX-License-Identifier: Apache-2.0
/** CPU and memory over time. */
import { overTime } from '../charts/trajectory.js';

const MIB = 2 ** 20;
const COLUMNS = [
  { name: 'run', title: 'run' }, { name: 't', title: 't [s]', kind: 'number' }, { name: 'cpu', title: 'CPU [cores]', kind: 'number' }, { name: 'memory', title: 'memory [MiB]', kind: 'number' },
];

const inMib = (values) => values.map((value) => (value === null ? null : value / MIB));

/** Return the charts [title, option] of some runs' load, and its table. @param {Array<{name: string, usage: object}>} runs */
export function loads(runs) {
  const single = runs.length === 1;
  const lines = (values) => runs.map(({ name, usage }) => ({ name, t: usage.t, values: values(usage) }));
  const memory = lines((usage) => inMib(usage.memory));
  const anonymous = single && runs[0].usage.anonymous ? [{ name: 'anonymous', t: runs[0].usage.t, values: inMib(runs[0].usage.anonymous) }] : [];
  if (anonymous.length) memory[0].name = 'working set';
  return {
    charts: [['CPU over time', overTime(lines((usage) => usage.cpu), 'CPU [cores]')], ['Memory over time', overTime([...memory, ...anonymous], 'memory [MiB]')]],
    table: { columns: COLUMNS, rows: runs.flatMap(({ name, usage }) => usage.t.map((t, at) => ({ run: name, t, cpu: usage.cpu[at], memory: usage.memory[at] === null ? null : usage.memory[at] / MIB }))) },
  };
}
