// SPDX-License-Identifier: Apache-2.0
/** The way to the other question: whether what runs are measured by is right. */
import { address, Query } from './address.js';
import { Link } from './parts.js';
import { html } from './ui.js';

/**
 * The way from a table to what its runs say of the ground truth that they are measured by.
 * @param {{filters?: Query, dataset?: string, children?: Shown}} props
 */
export const TruthLink = ({ filters = new Query(), dataset, children = 'Does the truth hold?' }) => html`
  <${Link}
    href=${address('/studies', filters.with({ kind: 'suspects', ...(dataset ? { dataset } : {}) }))}
    title="Stretches in which runs of several algorithms agree with each other and not with the ground truth"
  >
    ${children}
  </${Link}>
`;
