// SPDX-License-Identifier: Apache-2.0
/** Small multiples as a drawing of Explore: rows and columns by two settings, a chart in each cell. */
import { arranged, multiples, tooMany } from '../charts/multiples.js';
import { address, go } from '../core/address.js';
import { csvOf, useData } from '../core/api.js';
import { Chart } from '../core/chart.js';
import { NothingFits, Notes, Waiting } from '../core/parts.js';
import { html, useEffect, useMemo } from '../core/ui.js';
import { groupTable, pathsOf } from './groups.js';

/**
 * @param {{set: Settings, filters: import('../core/address.js').Query, title: string, onError: (error:
 *   Error|null) => void}} props of explore
 */
export function SmallMultiples({ set, filters, title, onError }) {
  const url = address(
    '/api/v1/analysis/aggregate',
    filters.with({
      by: [...new Set([set.down, set.across, set.x, set.colour].filter(Boolean))].join(','),
      metrics: set.y,
      outcomes: set.outcomes,
    }),
  );
  const { current: data, error } = useData(url);
  useEffect(() => onError(error), [error]);
  const found = useMemo(() => data && arranged(data, set), [data, JSON.stringify(set)]);
  const drawn = useMemo(() => data && found && !tooMany(found, set) && multiples(data, set, found), [found]);
  if (!data || !found) return !error && html`<${Waiting} />`;
  if (data.groups.length === 0) return html`<${NothingFits} notes=${data.notes} />`;
  if (!drawn)
    return html`
      <p class="fault" role="alert">
        ${tooMany(found, set)}
      </p>
    `;
  return html`
    <div class="sideways" tabindex="0" role="region" aria-label="Small multiples">
      <div style=${{ minWidth: `${drawn.width}px` }}>
        <${Chart}
          title=${title}
          option=${drawn.option}
          height=${drawn.height}
          csv=${csvOf(url)}
          onClick=${(/** @type {Item} */ item) =>
            item.data?.point && go(pathsOf(filters, item.data.point.group.keys))}
          table=${groupTable(data)}
          summary=${[
            `${title}, ${found.down.length} by ${found.across.length} charts`,
            'the table has their numbers',
          ].join('; ')}
        />
      </div>
    </div>
    <${Notes} notes=${[...drawn.notes, ...(data.notes ?? [])]} />
    <p class="quiet">
      Lines are ${set.figure}s over n ${set.outcomes === 'all' ? 'evaluated' : 'tracked'} runs, bands their
      intervals or, below 10 runs, the least and the largest. All charts have the same axes.
      A click on a point shows the paths of its runs.
    </p>
  `;
}
