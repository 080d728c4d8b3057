// SPDX-License-Identifier: Apache-2.0
/** Which runs are meant: chips for what is chosen, a choice of column and value, a condition in words. */
import { address, SITE, useAddress } from './address.js';
import { useData } from './api.js';
import { cell, clip } from './format.js';
import { Fault, Tick } from './parts.js';
import { html, useEffect, useState } from './ui.js';

const GROUPS = [
  'run',
  'result',
  'errors',
  'usage',
  'parameters',
  'input',
  'resources',
  'dataset',
  'labels',
  'metrics',
  'frames',
  'provenance',
  'trajectory',
];

/**
 * Return options for a choice of columns, in groups; those that never vary are left out.
 * @param {Api.Column[]|undefined} columns headings
 * @param {(column: Api.Column) => boolean} [fits]
 */
export function columnOptions(columns, fits = () => true) {
  const usable = (columns ?? []).filter((one) => one.kind !== 'other' && one.distinct !== 1 && fits(one));
  const groups = [...new Set([...GROUPS, ...usable.map((one) => one.group)])];
  return groups
    .map((group) => ({
      label: group,
      options: usable.filter((one) => one.group === group).map((one) => [one.name, one.title]),
    }))
    .filter((group) => group.options.length);
}

/**
 * Parameter of the API and of the address by which results of earlier versions are asked for; as a column it
 * says why a run is one.
 */
const SUPERSEDED = 'superseded';

/**
 * Return the headings of the columns of the runs that are meant: of earlier versions too, or of current ones
 * alone.
 * @returns {Loading<Api.Columns>}
 */
export const useColumns = () =>
  useData(address('/api/v1/columns', { [SUPERSEDED]: useAddress().query.get(SUPERSEDED) }));

/**
 * True where no run is known at all.
 * @param {{data: Api.Columns|null}} columns of useColumns
 */
export const isEmpty = (columns) => columns.data?.rows === 0 && columns.data.notes.length === 0;

/**
 * True for columns of numbers and times.
 * @param {{kind?: string}} column
 */
export const isNumeric = (column) => ['number', 'integer', 'time'].includes(column.kind ?? '');

/** Groups of columns that say what was run, not what came of it. */
const GIVEN = ['run', 'parameters', 'input', 'resources', 'dataset', 'labels', 'provenance'];

/**
 * True for columns by which runs can be measured: a number of a repetition or a seed is no result, and a site
 * has figures over groups for some of the others alone.
 * @param {{kind?: string, group: string, isAsked?: boolean}} column
 */
export const isMeasure = (column) =>
  isNumeric(column) && column.kind !== 'time' && !GIVEN.includes(column.group) && column.isAsked !== false;

/**
 * True for numbers that were chosen for a run, along which it may fail.
 * @param {{kind?: string, group: string, name?: string}} column
 */
export const isSetting = (column) =>
  isNumeric(column) && ['parameters', 'input', 'resources'].includes(column.group);

/** @param {[string, string|null]} pair */
const text = (pair) =>
  pair[1] === null ? pair[0] : /[<>!]$/.test(pair[0]) ? `${pair[0]}=${pair[1]}` : `${pair[0]} = ${pair[1]}`;

/**
 * The filters of a page.
 * @param {{columns: Api.Column[]|undefined, error?: ApiFault|null, hint?: Shown, versions?:
 *   boolean}} props hint: what stands below an error that is shown here; versions: whether earlier versions
 *   can be asked for
 */
export function Filters({ columns, error, hint, versions = true }) {
  const { query, follow, change } = useAddress();
  const [column, setColumn] = useState('');
  const where = query.get('where');
  const [draft, setDraft] = useState(where);
  useEffect(() => setDraft(where), [where]);
  const chosen = query.filters().pairs.filter(([name]) => name !== 'where' && name !== SUPERSEDED);
  const offered = columns?.filter((one) => one.name !== SUPERSEDED);
  const heading = offered?.find((one) => one.name === column);
  /** @param {string} value */
  const add = (value) => {
    if (value !== '') follow(query.and(column, value));
    setColumn('');
  };
  /** @param {[string, string|null]} pair */
  const wrongChip = (pair) => error?.field && pair[0].startsWith(error.field);
  // An error of all filters together is the condition's only where there is one.
  const wrongWhere = error?.field === 'where' && where !== '';
  const wrongChoice = error?.field === 'where' && where === '';
  return html`
    <section class="filters" aria-label="Filters">
      <div class="row">
        ${chosen.map(
          (pair) => html`
            <span class=${`chip ${wrongChip(pair) ? 'wrong' : ''}`}>
              ${clip(text(pair), 60)}
              <button
                type="button"
                aria-label=${`Remove the filter ${clip(text(pair), 80)}`}
                onClick=${() => follow(query.without(pair))}
              >
                ×
              </button>
            </span>
          `,
        )}
        <label class=${`field ${wrongChoice ? 'wrong' : ''}`}>
          <span>Filter by</span>
          <select
            value=${column}
            aria-invalid=${wrongChoice ? 'true' : null}
            onChange=${(event) => setColumn(event.target.value)}
          >
            <option value="">column…</option>
            ${columnOptions(offered).map(
              (group) => html`
                <optgroup label=${group.label}>
                  ${group.options.map(
                    ([name, title]) => html`
                      <option value=${name}>${clip(title, 60)}</option>
                    `,
                  )}
                </optgroup>
              `,
            )}
          </select>
        </label>
        ${
          heading &&
          (heading.values
            ? html`
              <label class="field">
                <span>is</span>
                <select value="" onChange=${(event) => add(event.target.value)}>
                  <option value="">value…</option>
                  ${heading.values.map(
                    (one) => html`
                      <option value=${String(one.value)}>
                        ${clip(cell(one.value, heading), 60)} (${one.count})
                      </option>
                    `,
                  )}
                </select>
              </label>
            `
            : html`
              <label class="field">
                <span>is</span>
                <input
                  type="text"
                  placeholder="value, then Enter"
                  onChange=${(event) => add(event.target.value)}
                />
              </label>
            `)
        }
        <label class=${`field wide ${wrongWhere ? 'wrong' : ''}`} hidden=${SITE && where === ''}>
          <span>Condition</span>
          <input
            type="text"
            spellcheck="false"
            maxlength="8000"
            placeholder="coverage >= 0.9 and run not in (53, 103)"
            readonly=${SITE}
            value=${draft}
            aria-invalid=${wrongWhere ? 'true' : null}
            onInput=${(event) => setDraft(event.target.value)}
            onChange=${(event) => change({ where: event.target.value.trim() })}
          />
        </label>
        ${
          versions &&
          (!SITE || columns?.some((one) => one.name === SUPERSEDED)) &&
          html`
            <${Tick}
              label="earlier versions too"
              checked=${query.get(SUPERSEDED) === '1'}
              onChange=${(on) => change({ [SUPERSEDED]: on ? '1' : null, after: null })}
            />
          `
        }
      </div>
      ${
        error &&
        (error.field === 'where' || chosen.some(wrongChip)) &&
        html`
          <${Fault} error=${error} />
          ${hint}
        `
      }
    </section>
  `;
}

/**
 * True where the filters themselves show an error.
 * @param {ApiFault|null} error
 * @param {import('./address.js').Query} query
 */
export const shownByFilters = (error, query) => {
  const field = error?.field;
  return (
    Boolean(field) &&
    (field === 'where' || query.filters().pairs.some(([name]) => name.startsWith(String(field))))
  );
};
