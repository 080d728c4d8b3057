// SPDX-License-Identifier: Apache-2.0
/** All runs as a table: filtered, sorted, page by page, with the columns that the reader wants. */
import { address, Query, useAddress } from '../core/address.js';
import { csvOf, useData } from '../core/api.js';
import { columnOptions, Filters, isEmpty, shownByFilters, useColumns } from '../core/filters.js';
import { clip, number } from '../core/format.js';
import { foremost, useNarrow } from '../core/narrow.js';
import { Empty, Fault, Link, NothingFits, Notes, Table, Tick, useTitle, Waiting } from '../core/parts.js';
import { html, useState } from '../core/ui.js';
import RunPage from './run.js';
import { dressed } from './runrows.js';

const USUAL = [
  'run',
  'algorithm',
  'sensors',
  'dataset',
  'sweep',
  'status',
  'coverage',
  'ate.rmse',
  'rpe[0].rmse',
  'usage.cpu.meanCores',
  'usage.memory.peakBytes',
  'finished',
];
/** What comes first where little is seen. */
const ON_A_PHONE = ['run', 'status', 'ate.rmse'];
const MOST_COMPARED = 8;
/** Settings that vary are shown too, so many. */
const MOST_SETTINGS = 6;

export default function Runs() {
  const { path } = useAddress();
  return path.length > 1 ? html`<${RunPage} key=${path[1]} uid=${path[1]} />` : html`<${AllRuns} />`;
}

function AllRuns() {
  const { query, change } = useAddress();
  const [marked, setMarked] = useState(/** @type {string[]} */ ([]));
  useTitle('Runs');
  const columns = useColumns();
  const known = columns.data?.items ?? [];
  const narrow = useNarrow();
  const settings = known
    .filter(({ group, distinct }) => (group === 'input' || group === 'parameters') && distinct > 1)
    .slice(0, MOST_SETTINGS)
    .map(({ name }) => name);
  const usual = foremost(
    USUAL.flatMap((name) => (name === 'dataset' ? [name, ...settings] : [name])).map((name) => ({ name })),
    narrow ? ON_A_PHONE : [],
  )
    .map((one) => one.name)
    .filter((name) => known.some((one) => one.name === name));
  const chosen = query.get('columns')
    ? query.get('columns').split(',')
    : usual.length
      ? usual
      : ['run', 'algorithm'];
  const asked = {
    columns: ['uid', ...chosen.filter((name) => name !== 'uid')].join(','),
    sort: query.get('sort'),
    limit: query.get('limit', '100'),
  };
  const table = address('/api/v1/runs', query.filters().with(asked));
  const state = useData(
    columns.data
      ? address('/api/v1/runs', query.filters().with({ ...asked, after: query.get('after') }))
      : null,
  );
  if (isEmpty(columns))
    return html`
      <h1>Runs</h1>
      <${Empty} />
    `;
  /**
   * @param {string} uid
   * @param {boolean} on
   */
  const mark = (uid, on) =>
    setMarked(on ? [...marked, uid].slice(-MOST_COMPARED) : marked.filter((one) => one !== uid));
  /** @type {TableColumn} */
  const marks = {
    name: 'uid',
    title: 'compare',
    sortable: false,
    show: (uid) =>
      uid &&
      html`
        <input
          type="checkbox"
          aria-label=${`Compare run ${clip(uid, 60)}`}
          checked=${marked.includes(uid)}
          onChange=${(event) => mark(uid, event.target.checked)}
        />
      `,
  };
  return html`
    <h1>Runs ${state.data && html`<span class="quiet">${number(state.data.total)}</span>`}</h1>
    ${
      query.get('embed') !== '1' &&
      html`
        <${Filters} columns=${known} error=${state.error} />
        <${Columns}
          known=${known}
          chosen=${chosen}
          change=${(names) => change({ columns: names.join(',') })}
          error=${state.error?.field === 'columns' ? state.error : null}
        />
      `
    }
    ${
      state.error &&
      !shownByFilters(state.error, query) &&
      state.error.field !== 'columns' &&
      html`
        <${Fault} error=${state.error} />
        ${
          query.get('after') &&
          html`
            <p>
              <${Link} href=${address('/runs', query.with({ after: null }))}>To the first page</${Link}>
            </p>
          `
        }
      `
    }
    ${
      state.data
        ? html`
          <p class="row">
            <a href=${csvOf(table)} download>
              CSV
            </a>
            ${
              marked.length > 0 &&
              html`
                <${Link} href=${address('/compare', new Query().with({ uid: marked }))}>
                  Compare ${marked.length} ${marked.length === 1 ? 'run' : 'runs'}
                </${Link}>
              `
            }
          </p>
          ${
            state.data.items.length
              ? html`
                <${Table}
                  columns=${[marks, ...dressed(state.data.columns)]}
                  rows=${state.data.items}
                  caption="Runs"
                  sort=${query.get('sort')}
                  onSort=${(sort) => change({ sort, after: null })}
                />
              `
              : html`
                <${NothingFits} />
              `
          }
          <${Notes} notes=${state.data.notes} />
          <nav class="row" aria-label="Pages of the table">
            <p class="row">
              ${
                query.get('after') &&
                html`
                  <${Link} href=${address('/runs', query.with({ after: null }))}>First page</${Link}>
                `
              }
              ${
                state.current?.next &&
                html`
                  <${Link}
                    href=${address(
                      '/runs',
                      query.with({
                        after: Query.parse(state.current.next.split('?')[1]).get('after'),
                      }),
                    )}
                  >
                    Next page
                  </${Link}>
                `
              }
            </p>
          </nav>
        `
        : !state.error && html`<${Waiting} />`
    }
  `;
}

/**
 * @param {{known: Api.Column[], chosen: string[], change: (chosen: string[]) => void, error: ApiFault|null}}
 *   props
 */
function Columns({ known, chosen, change, error }) {
  const options = columnOptions(known);
  /**
   * @param {string} name
   * @param {boolean} on
   */
  const turn = (name, on) => change(on ? [...chosen, name] : chosen.filter((one) => one !== name));
  return html`
    <details class="controls">
      <summary>Columns (${chosen.length})</summary>
      ${options.map(
        (group) => html`
          <fieldset>
            <legend>${group.label}</legend>
            <div class="row">
              ${group.options.map(
                ([name, title]) => html`
                  <${Tick}
                    key=${name}
                    label=${clip(title, 50)}
                    checked=${chosen.includes(name)}
                    onChange=${(on) => turn(name, on)}
                  />
                `,
              )}
            </div>
          </fieldset>
        `,
      )}
    </details>
    <${Fault} error=${error} />
  `;
}
