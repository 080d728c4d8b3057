// SPDX-License-Identifier: Apache-2.0
/** Groups of runs as a table: what a paper prints. */
import { address, useAddress } from '../core/address.js';
import { csvOf, useData } from '../core/api.js';
import { Filters, shownByFilters, useColumns } from '../core/filters.js';
import { clip } from '../core/format.js';
import { useNarrow } from '../core/narrow.js';
import {
  Choice,
  Download,
  Fault,
  Link,
  Notes,
  NothingFits,
  Table,
  Tick,
  useTitle,
  Waiting,
} from '../core/parts.js';
import { published } from '../core/questions.js';
import { TruthLink } from '../core/truth.js';
import { html } from '../core/ui.js';
import { FIGURES, groupTable, onPhone } from './groups.js';

export default function Groups() {
  const { query, change } = useAddress();
  const title = query.get('title') || 'Table';
  const narrow = useNarrow();
  useTitle(title);
  const columns = useColumns();
  const set = {
    by: query.get('by'),
    metrics: query.get('metrics', 'ate.rmse'),
    outcomes: query.get('outcomes', 'tracked'),
  };
  const asked = query
    .get('figures')
    .split(',')
    .flatMap((name) => FIGURES.filter((one) => one === name));
  const figures = asked.length ? asked : FIGURES;
  const url = address('/api/v1/analysis/aggregate', query.filters().with(set));
  const state = useData(url);
  /**
   * @param {string} label
   * @param {'by'|'metrics'} name
   */
  const list = (label, name) => html`
    <label class=${`field wide ${state.error?.field === name ? 'wrong' : ''}`}>
      <span>${label}</span>
      <input
        type="text"
        value=${set[name]}
        spellcheck="false"
        onChange=${(event) => change({ [name]: event.target.value.trim(), title: null })}
      />
    </label>
  `;
  const preset = published(columns.data?.items ?? []).find((one) => one.title === query.get('title'));
  const shown = state.data && groupTable(state.data, figures);
  return html`
    <h1>${clip(title, 120)}</h1>
    ${
      query.get('embed') !== '1' &&
      html`
        <section class="controls" aria-label="What is in the table">
          <div class="row">
            ${list('Rows tell apart', 'by')}
            ${list('Metrics', 'metrics')}
            <${Choice}
              label="Runs"
              value=${set.outcomes}
              options=${[['tracked', 'tracked'], ['all', 'all evaluated']]}
              error=${state.error?.field === 'outcomes' ? state.error : null}
              onChange=${(outcomes) => change({ outcomes, title: null })}
            />
          </div>
          <div class="row">
            ${FIGURES.map(
              (one) => html`
                <${Tick}
                  key=${one}
                  label=${one}
                  checked=${figures.includes(one)}
                  onChange=${(on) =>
                    change({
                      figures: FIGURES.filter((other) => (other === one ? on : figures.includes(other))).join(
                        ',',
                      ),
                    })}
                />
              `,
            )}
            ${published(columns.data?.items ?? []).map(
              ({ title: name, page, settings }) => html`
                <${Link} href=${address(page, { ...settings, title: name })}>${name}</${Link}>
              `,
            )}
          </div>
        </section>
        <${Filters} columns=${columns.data?.items} error=${state.error} />
      `
    }
    ${state.error && !shownByFilters(state.error, query) && html`<${Fault} error=${state.error} />`}
    ${preset && html`<p>${preset.note}</p>`}
    ${
      shown
        ? html`
          <p class="quiet">
            Figures are over n ${set.outcomes === 'all' ? 'evaluated' : 'tracked'} runs.${' '}
            <${Download} href=${csvOf(url)}>
              CSV
            </${Download}>${' '}
            <${TruthLink} filters=${query.filters()} />
          </p>
          ${
            shown.rows.length
              ? html`
                <${Table}
                  columns=${narrow ? onPhone(shown, figures[0]) : shown.columns}
                  rows=${shown.rows.slice(0, 1000)}
                  caption=${title}
                />
              `
              : html`
                <${NothingFits} />
              `
          }
          <${Notes} notes=${state.data.notes} />
        `
        : !state.error && html`<${Waiting} />`
    }
  `;
}
