// SPDX-License-Identifier: Apache-2.0
/** All runs as a table: filtered, sorted, page by page, with the columns that the reader wants. */
import { address, Query, useAddress } from '../core/address.js';
import { csvOf, useData } from '../core/api.js';
import { columnOptions, Filters, isEmpty, shownByFilters, useColumns } from '../core/filters.js';
import { clip, cpuColumn, number, plural } from '../core/format.js';
import { foremost, useNarrow } from '../core/narrow.js';
import {
  Download,
  Empty,
  Fault,
  Link,
  Notes,
  NothingFits,
  Table,
  Tick,
  useTitle,
  Waiting,
} from '../core/parts.js';
import { TruthLink } from '../core/truth.js';
import { html, useState } from '../core/ui.js';
import { FINDINGS, folded, KEPT, onPhone, Same, SEARCHED } from '../core/runrows.js';

/** What a player notes of nodes is there where there are any. */
const CAUSAL = 'beside.online.ate.rmse';
/** Columns before and behind the settings that vary. */
const USUAL = ['run', 'finished', 'status', 'ate.rmse', CAUSAL, 'algorithm', 'sensors', 'dataset'];
const PACE = 'input.pace';
const MORE = ['rpe[0].rmse', 'coverage'];
const PLAYED = ['lateSeconds', 'metrics.latencySeconds.p95', 'metrics.realTimeFactor'];
const LAST = ['usage.memory.peakBytes', ...PLAYED, 'sweep', 'tags', 'note'];
/** A table of runs is read from the latest one. */
const NEWEST = '-finished';
const MOST_COMPARED = 8;
/** Settings that vary are shown too, so many. */
const MOST_SETTINGS = 6;

export default function Runs() {
  const { query, change } = useAddress();
  const [marked, setMarked] = useState(/** @type {string[]} */ ([]));
  useTitle('Runs');
  const columns = useColumns();
  const known = columns.data?.items ?? [];
  const narrow = useNarrow();
  /** @param {string} name */
  const isKnown = (name) => known.some((one) => one.name === name);
  const paces = known.find((one) => one.name === PACE)?.distinct ?? 0;
  const settings = [...(paces > 1 ? [PACE] : []), ...(columns.data?.varied ?? [])].slice(0, MOST_SETTINGS);
  const usual = [...USUAL, ...settings, ...MORE, cpuColumn(known), ...LAST].filter(isKnown);
  const chosen = query.get('columns')
    ? query.get('columns').split(',')
    : usual.length
      ? usual
      : ['run', 'algorithm'];
  const sort = query.get('sort') || (isKnown('finished') ? NEWEST : '');
  const asked = {
    columns: [...new Set(['uid', ...chosen, ...[FINDINGS, SEARCHED].filter(isKnown)])].join(','),
    sort,
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
  const shown = state.data && folded(state.data, chosen, query.get('columns') ? chosen : KEPT);
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
            <${Download} href=${csvOf(table)}>
              CSV
            </${Download}>
            <${TruthLink} filters=${query.filters()} />
            ${
              marked.length > 0 &&
              html`
                <${Link} href=${address('/compare', new Query().with({ uid: marked }))}>
                  Compare ${plural(marked.length, 'run')}
                </${Link}>
              `
            }
          </p>
          ${
            state.data.items.length
              ? html`
                <${Same} said=${shown?.said} />
                <${Table}
                  columns=${foremost(
                    [marks, ...(shown?.columns ?? [])],
                    narrow
                      ? [...onPhone([...settings.slice(0, 1), 'ate.rmse', cpuColumn(known)]), 'uid']
                      : [],
                  )}
                  rows=${state.data.items}
                  caption="Runs"
                  fixed=${narrow ? 1 : 2}
                  sort=${sort}
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
