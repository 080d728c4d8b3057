// SPDX-License-Identifier: Apache-2.0
/** What stands around every drawing: its title, its table, its CSV, its pictures. */
import { Link, Table } from './parts.js';
import { html, useState } from './ui.js';

const MOST_ROWS = 1000;

/** Let the browser keep a file. @param {string} href address of its content @param {string} name */
export function save(href, name) {
  const link = document.createElement('a');
  link.href = href;
  link.download = name;
  link.click();
}

/** Let the browser keep a text as a file. */
export function saveText(text, name, type) {
  const url = URL.createObjectURL(new Blob([text], { type }));
  save(url, name);
  URL.revokeObjectURL(url);
}

/** Let the browser keep a text as an SVG file. */
export const saveSvg = (text, name) => saveText(text, name, 'image/svg+xml');

/** Return rows as CSV, numbers with every digit. @param {Array<{name: string}>} columns @param {object[]} rows */
export function toCsv(columns, rows) {
  const field = (value) => {
    const text = value === null || value === undefined ? '' : String(value);
    return /[",\r\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
  };
  return [columns.map((column) => column.name), ...rows.map((row) => columns.map((column) => row[column.name]))]
    .map((line) => line.map(field).join(',')).join('\n');
}

/** Return a file name made of a title. */
export const fileName = (title, ending) => `${title.replaceAll(/[^\w.-]+/g, '-').slice(0, 80) || 'chart'}.${ending}`;

/** True where the page is dark. */
export const isDark = () => {
  const chosen = document.documentElement.dataset.theme;
  return chosen ? chosen === 'dark' : matchMedia('(prefers-color-scheme: dark)').matches;
};

/** Return the colours of text, lines and background of drawings. */
export const inks = (dark) => (dark
  ? { text: '#d9dde3', faint: '#9aa3ad', line: '#3a424c', back: '#171b21' }
  : { text: '#22272e', faint: '#5b6570', line: '#d9dee4', back: '#ffffff' });

/** The frame of a drawing.
 * @param {{title: string, link?: string, csv?: string|true, table?: {columns: object[], rows: object[]}, png: () => void, svg: () => void, tools?: any, children: any}} props
 *   link: the page that shows it in full; csv: address of the table behind it, true to make it of the table here; tools: further buttons */
export function Framed({ title, link, csv, table, png, svg, tools, children }) {
  const [open, setOpen] = useState(false);
  return html`<figure class="chart"><figcaption><strong>${link ? html`<${Link} href=${link}>${title}</${Link}>` : title}</strong>
      <span class="tools">${tools}${table && html`<button type="button" aria-expanded=${String(open)} onClick=${() => setOpen(!open)}>Table</button>`}
        ${csv === true ? html`<button type="button" onClick=${() => saveText(toCsv(table.columns, table.rows), fileName(title, 'csv'), 'text/csv')}>CSV</button>` : csv && html`<a href=${csv} download>CSV</a>`}
        <button type="button" onClick=${png}>PNG</button><button type="button" onClick=${svg}>SVG</button></span></figcaption>
    ${children}
    ${open && html`<${Table} columns=${table.columns} rows=${table.rows.slice(0, MOST_ROWS)} caption=${`Table of ${title}`} />
      ${table.rows.length > MOST_ROWS && html`<p class="quiet">The first ${MOST_ROWS} of ${table.rows.length} rows; the CSV has all.</p>`}`}
  </figure>`;
}
