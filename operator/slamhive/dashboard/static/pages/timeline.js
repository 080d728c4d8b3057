// SPDX-License-Identifier: Apache-2.0
/** Timeline: which node and core did what, and when, of a sweep or of whatever the filters leave. */
import { fullShare, KEY, moved, timelineChart, usedText } from '../charts/timeline.js';
import { address, go, useAddress } from '../core/address.js';
import { csvOf, useData } from '../core/api.js';
import { Chart } from '../core/chart.js';
import { Filters, shownByFilters, useColumns } from '../core/filters.js';
import { cell, number, plural } from '../core/format.js';
import { Fault, NothingFits, Notes, runLink, Status, useTitle, Waiting } from '../core/parts.js';
import { html, useMemo } from '../core/ui.js';

/** @type {Array<['closer'|'wider'|'earlier'|'later', string]>} */
const STEPS = [
  ['earlier', 'Earlier'],
  ['later', 'Later'],
  ['closer', 'Closer'],
  ['wider', 'Wider'],
];

export default function TimelinePage() {
  const { query, change } = useAddress();
  useTitle('Timeline');
  const columns = useColumns();
  const url = address(
    '/api/v1/analysis/timeline',
    query.filters().with({ from: query.get('from'), to: query.get('to') }),
  );
  const { data, error } = useData(url);
  return html`
    <h1>Timeline</h1>
    ${
      query.get('embed') !== '1' &&
      html`<${Filters} columns=${columns.data?.items} error=${error} versions=${false} />`
    }
    ${!shownByFilters(error, query) && html`<${Fault} error=${error} />`}
    ${
      data
        ? data.whole[0] === null
          ? html`<${NothingFits} notes=${data.notes} />`
          : html`<${Times} data=${data} csv=${csvOf(url)} change=${change} />`
        : !error && html`<${Waiting} />`
    }
  `;
}

/** @param {{data: Api.Timeline, csv: string, change: (changes: Changes) => void}} props */
function Times({ data, csv, change }) {
  const drawn = useMemo(() => timelineChart(data), [data]);
  const shown = /** @type {[number, number]} */ (data.extent);
  const part =
    shown[0] > /** @type {number} */ (data.whole[0]) || shown[1] < /** @type {number} */ (data.whole[1]);
  /** @param {[number, number]|null} span */
  const show = (span) =>
    change({ from: span ? span[0].toFixed(1) : null, to: span ? span[1].toFixed(1) : null });
  /** @param {Item} item */
  const look = (item) => {
    if (data.bars) go(address(`/runs/${encodeURIComponent(data.bars.uid[item.dataIndex])}`));
    else show(moved(shown, 'closer', (item.value[1] + item.value[2]) / 2000));
  };
  return html`
    <p class="row">
      ${STEPS.filter(([step]) => part || step === 'closer').map(
        ([step, text]) => html`
          <button type="button" onClick=${() => show(moved(shown, step))}>${text}</button>
        `,
      )}
      ${
        part &&
        html`
          <button type="button" onClick=${() => show(null)}>All of the time</button>
        `
      }
      <span>
        ${plural(data.runs, 'run')}${data.failed ? `, ${number(data.failed)} failed` : ''}${
          data.live ? `, ${number(data.live)} under way` : ''
        }
      </span>
    </p>
    <${Chart}
      key=${`${data.lanes.length} ${Boolean(data.bars)}`}
      title="Timeline"
      option=${drawn.option}
      height=${drawn.height}
      csv=${csv}
      table=${data.bars ? barTable(data, data.bars) : undefined}
      onClick=${look}
      summary=${`Timeline of ${plural(data.runs, 'run')} (lanes: ${data.lanes.length}); the CSV has times`}
    />
    <p class="key">
      ${KEY.map(
        ([text, colour]) => html`
          <span>
            <svg width="14" height="10" aria-hidden="true">
              <rect width="14" height="10" rx="2" fill=${colour} />
            </svg>${' '}
            ${text}
          </span>
        `,
      )}
    </p>
    <${Notes}
      notes=${[
        usedText(data),
        data.bars
          ? 'A click on a bar opens its run.'
          : [
              'The runs are many: a column is as high as the share of its time that was used, in full',
              `for ${number(100 * fullShare(data), 3)} %, and red by the share of its ends that failed.`,
              'A click on one looks closer; where at most 1,500 runs are in view each has a bar.',
            ].join(' '),
        ...data.notes,
      ].filter(Boolean)}
    />
  `;
}

/**
 * @param {Api.Timeline} data
 * @param {NonNullable<Api.Timeline['bars']>} bars
 * @returns {TableData}
 */
function barTable(data, bars) {
  return {
    columns: [
      { name: 'run', title: 'run', show: (run, row) => runLink(row.uid, cell(run ?? row.uid)) },
      ...bars.keys,
      { name: 'outcome', title: 'outcome', show: (value) => html`<${Status} value=${value} />` },
      { name: 'lane', title: 'lane' },
      { name: 'begun', title: 'begun', kind: 'time' },
      { name: 'prepared', title: 'prepared [s]', kind: 'number' },
      { name: 'ran', title: 'ran [s]', kind: 'number' },
    ],
    rows: bars.uid.map((uid, at) => ({
      ...bars.settings[at],
      uid,
      run: bars.run[at],
      outcome: bars.status[at],
      lane: data.lanes[bars.lane[at]],
      begun: bars.begin[at],
      prepared: (bars.start[at] ?? bars.end[at]) - bars.begin[at],
      ran: bars.start[at] === null ? null : bars.end[at] - /** @type {number} */ (bars.start[at]),
    })),
  };
}
