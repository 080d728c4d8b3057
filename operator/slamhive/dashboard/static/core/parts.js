// SPDX-License-Identifier: Apache-2.0
/** Small parts of which the pages are made. */
import { address, go, hrefOf, SITE } from './address.js';
import { blanks, cell, clip, statusClass } from './format.js';
import { html, useEffect } from './ui.js';
import { stays, watch } from './wide.js';

const ARROWS = { ascending: ' ↑', descending: ' ↓' };

/**
 * A link within these pages; modifier keys and the middle button open it as browsers do.
 * @param {{href: string, children?: Shown} & Record<string, any>} props
 */
export const Link = ({ href, children, ...rest }) => html`
  <a
    href=${hrefOf(href)}
    onClick=${(event) => {
      if (event.ctrlKey || event.metaKey || event.shiftKey || event.button) return;
      event.preventDefault();
      go(href);
      scrollTo(0, 0);
    }}
    ...${rest}
  >
    ${children}
  </a>
`;

/**
 * A file of the API to keep; on a site without a server it is made of the site's own.
 * @param {{href: string, children?: Shown} & Record<string, any>} props
 */
export const Download = ({ href, children, ...rest }) => html`
  <a
    href=${SITE ? hrefOf('/') : href}
    download
    onClick=${
      SITE &&
      ((/** @type {Event} */ event) => {
        event.preventDefault();
        import('./site.js').then(({ keep }) => keep(href));
      })
    }
    ...${rest}
  >
    ${children}
  </a>
`;

/** What the pages are called together: the title of a site is its maker's. */
export const NAME = globalThis.document?.title || 'SLAM Hive';

/**
 * Give the page its title.
 * @param {string} title
 */
export const useTitle = (title) =>
  useEffect(() => {
    document.title = `${clip(title, 80)} · ${NAME}`;
  }, [title]);

/** Status of what a site without a server can't answer. */
export const NOT_HERE = 501;

/**
 * What was wrong, in the API's words; a second and third line show the place.
 * @param {{error: {message: string, status?: number}|null|undefined}} props
 */
export const Fault = ({ error }) =>
  error &&
  (SITE && error.status === NOT_HERE
    ? html`<p class="quiet" role="note">${error.message}</p>`
    : html`
    <div class="fault" role="alert">
      <pre>${error.message}</pre>
    </div>
  `);

/** Shown while the first answer is awaited. */
export const Waiting = () => html`
  <p class="quiet" role="status">
    Loading…
  </p>
`;

/**
 * A run's status in words and colour.
 * @param {{value: string}} props
 */
export const Status = ({ value }) => html`
  <span class=${`status ${statusClass(value)}`}>${clip(value ?? '–', 40)}</span>
`;

/**
 * Sentences below a chart.
 * @param {{notes: string[]|null|undefined}} props
 */
export const Notes = ({ notes }) =>
  notes &&
  notes.length > 0 &&
  html`
    <ul class="notes">
      ${notes.map(
        (note) => html`
          <li>${clip(note, 600)}</li>
        `,
      )}
    </ul>
  `;

/**
 * Which competitors are shown where there are too many to read, and a way to those before and behind them.
 * @param {{competitors: number, shown: number, first: number, onChange: (first: string|null) => void}} props
 */
export const Places = ({ competitors, shown, first, onChange }) => {
  if (shown >= competitors) return null;
  const most = Math.max(1, shown);
  /** @param {number} place */
  const from = (place) => onChange(place > 1 ? String(place) : null);
  return html`
    <p class="row">
      <span>
        ${shown ? `Places ${first} to ${first + shown - 1}` : `Nobody has place ${first}`} of
        ${` ${competitors} `}competitors by mean rank
      </span>
      <button type="button" disabled=${first <= 1} onClick=${() => from(Math.max(1, first - most))}>
        before
      </button>
      <button
        type="button"
        disabled=${first + shown > competitors}
        onClick=${() => from(first + most)}
      >
        next
      </button>
    </p>
  `;
};

/** What to do where there are no results yet. */
export const Empty = () => html`
  <section class="empty">
    <h2>Nothing is here yet</h2>
    <p>Run a sweep on this machine:</p>
    <pre>slamhive run examples/…/sweep.yaml</pre>
    <p>or import the runs of the original SLAM Hive:</p>
    <pre>slamhive import slam-hive FOLDER --ground-truth FOLDER --alignment sim3</pre>
    <p>This page shows them as soon as they exist; no reload is needed.</p>
  </section>
`;

/**
 * Nothing fits the filters.
 * @param {{notes?: string[]}} props notes: what is left out
 */
export const NothingFits = ({ notes }) => html`
  <div>
    <p class="empty">No run fits these filters. Remove one of them.</p>
    <${Notes} notes=${notes} />
  </div>
`;

/** Options of a group that a menu can show. */
const MOST_OFFERED = 40;

/**
 * A choice with a label. `options` are [value, text] or texts; a group is {label, options}, and one of very
 * many is searched.
 * @param {{label: string, value: string, options: Array<Offered | OfferedGroup>,
 *   onChange: (value: string) => void, error?: ApiFault|null, none?: string}} props
 */
export const Choice = ({ label, value, options, onChange, error, none }) => {
  /** @param {Offered} option */
  const one = (option) => {
    const [key, text] = Array.isArray(option) ? option : [option, option];
    return html`
      <option value=${key} selected=${key === value}>
        ${clip(text, 60)}
      </option>
    `;
  };
  const [few, many] = [true, false].map((small) =>
    options.filter((option) => (!isGroup(option) || option.options.length <= MOST_OFFERED) === small),
  );
  const rest = many.flatMap((group) => (isGroup(group) ? group.options : []));
  const known = few
    .flatMap((option) => (isGroup(option) ? option.options : [option]))
    .some((option) => (Array.isArray(option) ? option[0] : option) === value);
  return html`
    <label class=${`field ${error ? 'wrong' : ''}`}>
      <span>${label}</span>
      <select
        value=${value}
        aria-invalid=${error ? 'true' : null}
        onChange=${(event) => onChange(event.target.value)}
      >
        ${
          none !== undefined &&
          html`
            <option value="" selected=${!value}>
              ${none}
            </option>
          `
        }
        ${
          value &&
          !known &&
          html`
            <option value=${value} selected>
              ${clip(value, 60)}
            </option>
          `
        }
        ${few.map((option) =>
          isGroup(option)
            ? html`
              <optgroup label=${option.label}>${option.options.map(one)}</optgroup>
            `
            : one(option),
        )}
      </select>
      ${error && html`<${Fault} error=${error} />`}
    </label>
    ${
      rest.length > 0 &&
      html`
        <label class="field">
          <span>${label}, ${rest.length} more</span>
          <input
            type="text"
            list=${`more ${label}`}
            placeholder="type a part of its name"
            spellcheck="false"
            onChange=${(event) => {
              if (event.target.value) onChange(event.target.value);
              event.target.value = '';
            }}
          />
          <datalist id=${`more ${label}`}>
            ${rest.map(one)}
          </datalist>
        </label>
      `
    }
  `;
};

/**
 * Which runs enter the figures.
 * @param {{value: string, error?: any, onChange: (value: string) => void}} props
 */
export const Outcomes = ({ value, error = null, onChange }) => html`
  <${Choice}
    label="Runs"
    value=${value}
    options=${[['tracked', 'tracked'], ['all', 'all evaluated']]}
    error=${error}
    onChange=${onChange}
  />
`;

/**
 * @param {Offered | OfferedGroup} option
 * @returns {option is OfferedGroup}
 */
const isGroup = (option) => typeof option === 'object' && 'options' in option;

/**
 * A box to tick.
 * @param {{label: string, checked: boolean, onChange: (on: boolean) => void}} props
 */
export const Tick = ({ label, checked, onChange }) => html`
  <label class="tick">
    <input
      type="checkbox"
      checked=${checked}
      onChange=${(event) => onChange(event.target.checked)}
    />
    ${label}
  </label>
`;

/**
 * A table.
 * @param {TableData & {caption: string, sort?: string, onSort?: (sort: string) => void, rowKey?: string,
 *   fixed?: number}} props fixed: how many of the first columns stay in sight
 */
export const Table = ({ columns, rows, caption, sort, onSort, rowKey, fixed = 1 }) => {
  const missing = columns.map((column, at) =>
    numeric(column) && !column.show && at >= fixed
      ? blanks(rows.map((row) => cell(row[column.name], column)))
      : [],
  );
  return html`
  <div>
  <div class="wide">
  <div class="scroll" tabindex="0" role="region" aria-label=${caption} ref=${watch}>
    <table>
      <caption class="hidden">${caption}</caption>
      <thead>
        <tr>
          ${columns.map((column, at) => {
            const direction =
              sort?.replace('-', '') === column.name
                ? sort.startsWith('-')
                  ? 'descending'
                  : 'ascending'
                : null;
            const arrow = direction ? ARROWS[direction] : '';
            return html`
              <th
                scope="col"
                class=${classOf(column, at, fixed)}
                aria-sort=${direction}
                title=${column.name}
              >
                ${
                  onSort && column.sortable !== false
                    ? html`
                      <button
                        type="button"
                        onClick=${() => onSort(direction === 'ascending' ? `-${column.name}` : column.name)}
                      >
                        ${head(column)}
                        ${arrow}
                      </button>
                    `
                    : head(column)
                }
              </th>
            `;
          })}
        </tr>
      </thead>
      <tbody>
        ${rows.map(
          (row, index) => html`
            <tr key=${rowKey ? row[rowKey] : index}>
              ${columns.map((column, at) => {
                const value = row[column.name];
                const text = column.show ? null : cell(value, column);
                const said = column.show ? column.show(value, row) : clip(text, 48);
                return html`
                  <td
                    class=${classOf(column, at, fixed)}
                    data-blank=${missing[at][index] || null}
                    title=${text && text.length > 48 ? clip(text, 1000) : null}
                  >
                    ${at < fixed ? html`<div>${said}</div>` : said}
                  </td>
                `;
              })}
            </tr>
          `,
        )}
      </tbody>
    </table>
  </div>
  </div>
  <p class="beyond" aria-hidden="true"></p>
  </div>
`;
};

/**
 * A column's title; a long one has several lines.
 * @param {TableColumn} column
 */
const head = ({ title, name }) => {
  const text = clip(title ?? name, 100);
  return text.length > 28 ? html`<div class="long">${text}</div>` : text;
};

/**
 * @param {TableColumn} column
 * @param {number} at
 * @param {number} fixed
 */
const classOf = (column, at, fixed) =>
  [numeric(column) ? 'number' : '', stays(at, fixed)].filter(Boolean).join(' ');

/** @param {TableColumn} column */
const numeric = (column) => ['number', 'integer'].includes(column.kind ?? '');

/**
 * A link to a run by its uid.
 * @param {string} uid
 * @param {string} [text]
 */
export const runLink = (uid, text) => html`
  <${Link} href=${address(`/runs/${encodeURIComponent(uid)}`)}>${clip(text ?? uid, 90)}</${Link}>
`;
