// SPDX-License-Identifier: Apache-2.0
/** CPU and memory: over time, and as figures of a run. */
import { overTime } from '../charts/trajectory.js';
import { bytes, number } from '../core/format.js';

const MIB = 2 ** 20;
const PROGRAM = 'time since the program’s start [s]';

/** @type {Record<string, string>} */
const KINDS = {
  Resident: 'resident',
  WorkingSet: 'working set',
  Container: 'container with page cache',
};

/**
 * Return the columns of what runs cost. As of cpuColumn: mean cores say what a robot needs in Realtime alone.
 * @param {Api.Run[]} runs
 * @param {(row: any) => Api.Run} of
 * @returns {TableColumn[]}
 */
export function costColumns(runs, of) {
  const realtime = runs.some((run) => run.configuration?.input?.pace === 'Realtime');
  return [
    {
      name: 'cpu',
      title: realtime ? 'CPU [cores]' : 'CPU [s/s]',
      kind: 'number',
      show: (_, row) => number(of(row).usage?.cpu?.[realtime ? 'meanCores' : 'secondsPerDataSecond']),
    },
    {
      name: 'memory',
      title: 'peak memory',
      kind: 'number',
      show: (_, row) => bytes(of(row).usage?.memory?.peakBytes),
    },
  ];
}

/** @param {Api.Numbers} values */
const inMib = (values) => values.map((value) => (value === null ? null : value / MIB));

/**
 * Return the charts {title, option, table, ofDataset} of some runs' load: by the dataset's clock of those
 * whose place on it is known, by the program's own time of the others.
 * @param {Array<Load & {t: number[]|null}>} runs t: time on the dataset's clock
 * @param {{title: string, span?: number[]}|null} clock what to call that clock, and what is drawn of it
 */
export function loads(runs, clock) {
  const single = runs.length === 1;
  const placed = runs.flatMap((run) => (run.t ? [{ ...run, t: run.t }] : []));
  const others = runs.filter((run) => !run.t).map((run) => ({ ...run, t: run.usage.t }));
  return [
    ...(placed.length ? pair(placed, 'over time', { title: '', ...clock, ofDataset: true, single }) : []),
    ...(others.length
      ? pair(others, 'since the program’s start', { title: PROGRAM, ofDataset: false, single })
      : []),
  ];
}

/**
 * The charts of CPU and memory of some runs on one clock.
 * @param {Array<Load & {t: number[]}>} runs
 * @param {string} when
 * @param {{title: string, span?: number[], ofDataset: boolean, single: boolean}} clock
 */
function pair(runs, when, { title, span, ofDataset, single }) {
  /** @param {(usage: Api.Usage) => Api.Numbers} values */
  const lines = (values) =>
    runs.map(({ name, usage, t, colour }) => ({ name, t, colour, values: values(usage) }));
  const memory = lines((usage) => inMib(usage.memory));
  const [{ usage: first, t: times }] = runs;
  const anonymous =
    single && first.anonymous ? [{ name: 'anonymous', t: times, values: inMib(first.anonymous) }] : [];
  const kinds = runs.map(({ usage }) => KINDS[usage.kind ?? ''] ?? 'memory');
  const mixed = new Set(kinds).size > 1;
  if (anonymous.length) Object.assign(memory[0], { name: kinds[0], colour: undefined });
  else if (mixed)
    memory.forEach((line, at) => {
      line.name = `${line.name}, ${kinds[at]}`;
    });
  const cores = runs.some(({ usage }) => usage.readerShare) ? 'CPU with the reader [cores]' : 'CPU [cores]';
  const table = {
    columns: [
      { name: 'run', title: 'run' },
      { name: 't', title, kind: 'number' },
      { name: 'cpu', title: cores, kind: 'number' },
      { name: 'memory', title: 'memory [MiB]', kind: 'number' },
    ],
    rows: runs.flatMap(({ name, usage, t }) =>
      t.map((value, at) => ({
        run: name,
        t: value,
        cpu: usage.cpu[at],
        memory: inMib([usage.memory[at]])[0],
      })),
    ),
  };
  /**
   * @param {string} what
   * @param {Array<{name: string, t: number[], values: Api.Numbers, colour?: string}>} drawn
   * @param {string} unit
   */
  const chart = (what, drawn, unit) => ({
    title: `${what} ${when}`,
    option: overTime(drawn, unit, title, { span, legend: !single || drawn.length > 1 }),
    table,
    ofDataset,
  });
  return [
    chart(
      'CPU',
      lines((usage) => usage.cpu),
      cores,
    ),
    chart('Memory', [...memory, ...anonymous], 'memory [MiB]'),
  ];
}
