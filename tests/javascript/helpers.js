// SPDX-License-Identifier: Apache-2.0
/** What several tests need: kept answers of the API, hostile texts, the text of elements. */
import { readFileSync } from 'node:fs';

/** Texts of an archive that break out of whatever takes them for its own language. */
export const HOSTILE = [
  '<img src=x onerror=alert(1)>',
  '</script><script>alert(1)</script>',
  '"><svg onload=alert(1)>',
  // biome-ignore lint/suspicious/noTemplateCurlyInString: a text that looks like one
  '${alert(1)}',
  '{a|b}{c}',
  '=HYPERLINK("http://x")',
  '__proto__',
  'constructor',
  'toString',
  'a\nb\r\nc',
  '&uid=1#?',
  '\u202eevil\u0000',
  '😀'.repeat(200),
];

const kept = JSON.parse(readFileSync(new URL('answers.json', import.meta.url), 'utf8'));

/** Return a copy of a kept answer whose address begins so. */
export const answer = (begin) => {
  const address = Object.keys(kept).find((one) => one.startsWith(`/api/v1${begin}`));
  return structuredClone(kept[address]);
};

/** Return all elements of a tree of Preact, with functions called as components. */
export function elements(node) {
  if (Array.isArray(node)) return node.flatMap(elements);
  if (node === null || typeof node !== 'object') return [];
  if (typeof node.type === 'function') return elements(node.type(node.props));
  return [node, ...elements(node.props.children)];
}

/** Return the text of a tree of Preact. */
export function text(node) {
  if (Array.isArray(node)) return node.map(text).join('');
  if (node === null || node === undefined || typeof node === 'boolean') return '';
  if (typeof node !== 'object') return String(node);
  return text(typeof node.type === 'function' ? node.type(node.props) : node.props.children);
}

/** Return the elements of a name. */
export const found = (node, name) => elements(node).filter((one) => one.type === name);
