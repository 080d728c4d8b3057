// SPDX-License-Identifier: Apache-2.0
/** What stands around every drawing: its title, its table, its CSV, its pictures. */
import { Download, Link, Table } from './parts.js';
import { html, useState } from './ui.js';

const MOST_ROWS = 1000;
const FORMULA = /^'*[=+\-@\t\r\n]/;
const NUMBER = /^[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?$/i;

/**
 * Let the browser keep a file.
 * @param {string} href address of its content
 * @param {string} name
 */
export function save(href, name) {
  const link = document.createElement('a');
  link.href = href;
  link.download = name;
  link.click();
}

/**
 * Let the browser keep a text as a file.
 * @param {string} text
 * @param {string} name
 * @param {string} type
 */
export function saveText(text, name, type) {
  const url = URL.createObjectURL(new Blob([text], { type }));
  save(url, name);
  URL.revokeObjectURL(url);
}

/**
 * Let the browser keep a text as an SVG file.
 * @param {string} text
 * @param {string} name
 */
export const saveSvg = (text, name) => saveText(text, name, 'image/svg+xml');

/**
 * Return rows as CSV, numbers with every digit; as in the API's, a `'` keeps spreadsheets from taking a text
 * for a formula, and what is not finite is empty.
 * @param {Array<{name: string}>} columns
 * @param {Array<Record<string, any>>} rows
 */
export function toCsv(columns, rows) {
  /** @param {any} value */
  const field = (value) => {
    const known =
      value !== null && value !== undefined && (typeof value !== 'number' || Number.isFinite(value));
    const plain = known ? String(value) : '';
    const text =
      typeof value === 'string' && FORMULA.test(plain) && !NUMBER.test(plain) ? `'${plain}` : plain;
    return /[",\r\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
  };
  return [
    columns.map((column) => column.name),
    ...rows.map((row) => columns.map((column) => row[column.name])),
  ]
    .map((line) => line.map(field).join(','))
    .join('\n');
}

/**
 * Return a file name made of a title.
 * @param {string} title
 * @param {string} ending
 */
export const fileName = (title, ending) =>
  `${
    title
      .replaceAll(/[^\w.-]+/g, '-')
      .slice(0, 80)
      .replaceAll(/^[-.]+|[-.]+$/g, '') || 'chart'
  }.${ending}`;

/** True where the page is dark. */
export const isDark = () => {
  const chosen = document.documentElement.dataset.theme;
  return chosen ? chosen === 'dark' : matchMedia('(prefers-color-scheme: dark)').matches;
};

/**
 * Return the colours of text, lines and background of drawings.
 * @param {boolean} dark
 * @returns {Inks}
 */
export const inks = (dark) =>
  dark
    ? { text: '#d9dde3', faint: '#9aa3ad', line: '#3a424c', back: '#171b21' }
    : { text: '#22272e', faint: '#5b6570', line: '#d9dee4', back: '#ffffff' };

/**
 * The frame of a drawing.
 * @param {{title: string, link?: string, csv?: string|true, table?: TableData, png: () => void, svg: () =>
 *   void, tools?: Shown, children: Shown}} props link: the page that
 *   shows it in full; csv: address of the table behind it, true to make it of the table here; tools: further
 *   buttons
 */
export function Framed({ title, link, csv, table, png, svg, tools, children }) {
  const [open, setOpen] = useState(false);
  /** @param {TableData} all */
  const saveCsv = (all) => saveText(toCsv(all.columns, all.rows), fileName(title, 'csv'), 'text/csv');
  return html`
    <figure class="chart">
      <figcaption>
        <strong>${link ? html`<${Link} href=${link}>${title}</${Link}>` : title}</strong>
        <span class="tools">
          ${tools}
          ${
            table &&
            html`
              <button type="button" aria-expanded=${String(open)} onClick=${() => setOpen(!open)}>
                Table
              </button>
            `
          }
          ${
            csv === true && table
              ? html`
                <button
                  type="button"
                  onClick=${() => saveCsv(table)}
                >
                  CSV
                </button>
              `
              : csv &&
                html`
                  <${Download} href=${csv}>
                    CSV
                  </${Download}>
                `
          }
          <button type="button" onClick=${png}>
            PNG
          </button>
          <button type="button" onClick=${svg}>
            SVG
          </button>
        </span>
      </figcaption>
      ${children}
      ${
        open &&
        table &&
        html`
          <${Table}
            columns=${table.columns}
            rows=${table.rows.slice(0, MOST_ROWS)}
            caption=${`Table of ${title}`}
          />
          ${
            table.rows.length > MOST_ROWS &&
            html`
              <p class="quiet">
                The first ${MOST_ROWS} of ${table.rows.length} rows; the CSV has all.
              </p>
            `
          }
        `
      }
    </figure>
  `;
}
