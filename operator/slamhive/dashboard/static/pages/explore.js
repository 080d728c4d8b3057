// SPDX-License-Identifier: Apache-2.0
/** Explore: one chart over all runs, made of columns that the reader chooses. */
import { box } from '../charts/box.js';
import { line, lines } from '../charts/line.js';
import { facets, readAxis } from '../charts/points.js';
import { scatter } from '../charts/scatter.js';
import { address, go, Query, useAddress } from '../core/address.js';
import { csvOf, fetchJson, useData } from '../core/api.js';
import { Chart } from '../core/chart.js';
import { columnOptions, Filters, isNumeric, shownByFilters, useColumns } from '../core/filters.js';
import { axisName, clip, cpuColumn, headingOf, namedValue } from '../core/format.js';
import { mostVaried } from '../core/questions.js';
import { Choice, Fault, Link, Notes, NothingFits, Outcomes, Tick, useTitle, Waiting } from '../core/parts.js';
import { html, useMemo, useState } from '../core/ui.js';
import { groupTable, GroupTable } from './groups.js';
import { Ecdf } from './ecdf.js';
import { Heat } from './heat.js';
import { SmallMultiples } from './multiples.js';
import { Parallel } from './parallel.js';
import { Pareto } from './pareto.js';
import { usePublished } from './published.js';
import { RunRows } from '../core/runrows.js';
import { Contours, Slices } from './surface.js';

const KINDS = [
  ['scatter', 'points'],
  ['line', 'lines'],
  ['multiples', 'small multiples'],
  ['box', 'boxes'],
  ['ecdf', 'cumulative shares'],
  ['heat', 'heat map'],
  ['contour', 'contours'],
  ['slices', 'slices'],
  ['parallel', 'parallel axes'],
  ['pareto', 'Pareto front'],
];
const KIND_NAMES = KINDS.map(([kind]) => kind).join(', ');
/** @type {Record<string, ((props: any) => Shown) | undefined>} */
const OTHERS = {
  contour: Contours,
  slices: Slices,
  ecdf: Ecdf,
  heat: Heat,
  multiples: SmallMultiples,
  parallel: Parallel,
  pareto: Pareto,
};
const LOG_X = ['scatter', 'line', 'multiples', 'pareto', 'ecdf'];
/** Drawings that have no column along x. */
const NO_X = ['ecdf', 'slices'];
/** Which field shows an error of a parameter. @type {Record<string, string>} */
const FIELD_OF = { by: 'x', metrics: 'y', metric: 'y' };
/** @type {Record<string, string>} */
const COLOUR_LABELS = { contour: 'Other setting', ecdf: 'Curves', heat: 'Rows', pareto: 'Competitors' };
/** What stands in the place of a column of colours that isn't chosen. @type {Record<string, string>} */
const NO_COLOUR = { contour: 'the first that varies', ecdf: 'algorithm' };
/** Drawings of groups of runs: a load, which is another in each run, makes none. */
const OVER_GROUPS = ['line', 'heat', 'contour', 'multiples'];
const FIELDS = ['x', 'y', 'colour', 'facet', 'down', 'across', 'outcomes'];

/**
 * Return the settings of an address, with what is shown where it names nothing: the setting that was varied
 * most for one algorithm, as what algorithms have by default tells nothing but them, if all runs have it or
 * groups are drawn, and who reached what.
 * @param {Query} query
 * @param {Pick<Api.Columns, 'items'|'varied'|'rows'>} known facts about the columns
 * @returns {Settings}
 */
export function settingsOf(query, { items: columns, varied: settings, rows }) {
  const varied = columns.filter((one) => one.distinct > 1);
  /**
   * @param {string} name
   * @param {string} [otherwise]
   */
  const at = (name, otherwise) => query.get(name, otherwise);
  const kind = KINDS.some(([one]) => one === at('kind')) ? at('kind') : 'scatter';
  const numbers = varied.filter((one) => isNumeric(one) && settings.includes(one.name));
  const guess =
    mostVaried(numbers.filter((one) => one.count === rows)) ??
    mostVaried(OVER_GROUPS.includes(kind) ? numbers : []) ??
    varied.find((one) => one.name === cpuColumn(columns)) ??
    varied.find(isNumeric);
  const y = at('y', 'ate.rmse');
  const apart = !at('x') && ['scatter', 'box'].includes(kind);
  return {
    kind,
    x: at('x', guess?.name ?? 'algorithm'),
    y: kind === 'line' ? y : y.split(',')[0], // only lines are drawn of several columns
    colour: at('colour', apart && varied.some((one) => one.name === 'algorithm') ? 'algorithm' : ''),
    facet: at('facet'),
    down: at('down'),
    across: at('across'),
    outcomes: at('outcomes', 'tracked'),
    figure: at('figure') === 'mean' ? 'mean' : 'median',
    xlog: at('xlog') === '1',
    ylog: at('ylog') === '1',
    own: at('scales') === 'own',
  };
}

export default function Explore() {
  const { query } = useAddress();
  const columns = useColumns();
  useTitle(query.get('title') || 'Explore');
  if (columns.error)
    return html`
      <h1>Explore</h1>
      <${Fault} error=${columns.error} />
    `;
  if (!columns.data) return html`<${Waiting} />`;
  if (columns.data.items.length === 0)
    return html`
      <h1>Explore</h1>
      <${NothingFits} />
    `;
  return html`<${Explored} known=${columns.data} />`;
}

/** @param {{known: Api.Columns}} props */
function Explored({ known }) {
  const { query, change } = useAddress();
  const columns = known.items;
  const embedded = query.get('embed') === '1';
  const filters = query.filters();
  // What was varied is another thing in each sweep: where x isn't said, the runs that are meant are asked.
  const own = !query.get('x') && filters.pairs.some(([name]) => name !== 'superseded');
  const meant = useData(own ? address('/api/v1/columns', filters) : null);
  const waits = own && !meant.data && !meant.error;
  const set = settingsOf(query, meant.data?.items.length ? meant.data : known);
  const Other = waits ? undefined : OTHERS[set.kind];
  const asked = query.get('kind');
  const unknown =
    asked && asked !== set.kind
      ? {
          message: `There is no drawing ${clip(asked, 40)}; these are: ${KIND_NAMES}.`,
          field: 'kind',
        }
      : null;
  const drawn =
    Other || waits
      ? null
      : set.kind === 'line'
        ? address(
            '/api/v1/analysis/aggregate',
            filters.with({
              by: [set.x, set.colour, set.facet].filter(Boolean).join(','),
              metrics: set.y,
              outcomes: set.outcomes,
            }),
          )
        : address(
            '/api/v1/analysis/points',
            filters.with({ x: set.x, y: set.y, colour: set.colour, facet: set.facet }),
          );
  const state = useData(drawn);
  const title =
    query.get('title') ||
    (NO_X.includes(set.kind)
      ? `${titleOf(columns, set.y)}: ${set.kind === 'ecdf' ? 'cumulative shares of runs' : 'slices'}`
      : `${titleOf(columns, set.y)} over ${titleOf(columns, set.x)}`);
  const [otherError, setOtherError] = useState(null);
  const error = Other ? otherError : state.error;
  const at = FIELD_OF[error?.field ?? ''] ?? error?.field;
  const atFilters = shownByFilters(error, query);
  return html`
    <h1>${clip(title, 120)}</h1>
    ${
      !embedded &&
      html`
        <${Controls}
          columns=${columns}
          set=${set}
          change=${(changes) =>
            change({
              title: null,
              ...(query.get('x') || 'kind' in changes ? {} : { x: set.x, colour: set.colour }),
              ...changes,
            })}
          error=${error ?? unknown}
          field=${error ? at : unknown?.field}
        />
        <${Filters} columns=${columns} error=${error} />
      `
    }
    ${(embedded || (!atFilters && !FIELDS.includes(at))) && html`<${Fault} error=${error} />`}
    ${
      Other
        ? html`
          <${Other}
            key=${set.kind}
            set=${set}
            columns=${columns}
            filters=${filters}
            title=${title}
            onError=${setOtherError}
          />
        `
        : state.current
          ? html`
            <${Drawing}
              key=${set.kind}
              set=${set}
              data=${state.current}
              title=${title}
              csv=${csvOf(drawn ?? '')}
            />
          `
          : (!state.error && html`<${Waiting} />`)
    }
    ${
      !embedded &&
      !Other &&
      state.data &&
      html`
        <${GroupTable} columns=${columns} set=${set} filters=${filters} />
      `
    }
    ${
      !embedded &&
      !error &&
      !waits &&
      !['scatter', 'parallel'].includes(set.kind) &&
      html`
        <${RunRows}
          filters=${filters}
          extra=${[NO_X.includes(set.kind) ? '' : set.x, ...set.y.split(','), set.colour]}
        />
      `
    }
  `;
}

/**
 * Several columns, separated by commas, are named one after the other.
 * @param {Api.Column[]} columns
 * @param {string} names
 */
const titleOf = (columns, names) =>
  names
    .split(',')
    .map((name) => axisName(headingOf(columns, name)))
    .join(', ');

/**
 * @param {{columns: Api.Column[], set: Settings, change: (changes: Changes) => void, error: ApiFault|null,
 *   field?: string}} props
 */
function Controls({ columns, set, change, error, field }) {
  const { query } = useAddress();
  /** @param {string} name */
  const wrong = (name) => (field === name ? error : null);
  const any = columnOptions(columns);
  const numbers = columnOptions(columns, isNumeric);
  return html`
    <section class="controls" aria-label="What is drawn">
      <div class="row">
        <${Choice}
          label="Draw"
          value=${set.kind}
          options=${KINDS}
          error=${wrong('kind')}
          onChange=${(kind) => change({ kind })}
        />
        ${
          !NO_X.includes(set.kind) &&
          html`
            <${Choice}
              label="x"
              value=${set.x}
              options=${any}
              error=${wrong('x')}
              onChange=${(x) => change({ x })}
            />
          `
        }
        <${Choice}
          label="y"
          value=${set.y}
          options=${numbers}
          error=${wrong('y')}
          onChange=${(y) => change({ y })}
        />
        ${
          set.kind !== 'slices' &&
          html`
        <${Choice}
          label=${COLOUR_LABELS[set.kind] ?? 'Colour'}
          value=${set.colour}
          options=${any}
          none=${NO_COLOUR[set.kind] ?? 'none'}
          error=${wrong('colour')}
          onChange=${(colour) => change({ colour })}
        />`
        }
        ${
          (!OTHERS[set.kind] || set.kind === 'ecdf') &&
          html`
            <${Choice}
              label="One chart each"
              value=${set.facet}
              options=${any}
              none="all in one"
              error=${wrong('facet')}
              onChange=${(facet) => change({ facet })}
            />
          `
        }
        ${
          set.kind === 'multiples' &&
          [
            ['down', 'Rows of charts', set.down],
            ['across', 'Columns of charts', set.across],
          ].map(
            ([name, label, value]) => html`
              <${Choice}
                key=${name}
                label=${label}
                value=${value}
                options=${any}
                none="one"
                error=${wrong(name)}
                onChange=${(chosen) => change({ [name]: chosen })}
              />
            `,
          )
        }
        ${
          !['scatter', 'parallel', 'pareto'].includes(set.kind) &&
          html`
            <${Outcomes}
              value=${set.outcomes}
              error=${wrong('outcomes')}
              onChange=${(outcomes) => change({ outcomes })}
            />
          `
        }
        ${
          ['line', 'heat', 'multiples'].includes(set.kind) &&
          html`
            <${Choice}
              label="Figure"
              value=${set.figure}
              options=${['median', 'mean']}
              onChange=${(figure) => change({ figure })}
            />
          `
        }
        <${Link} class="alone" href=${address('/explore', query.with({ embed: 1 }))}>
          Alone, to embed
        </${Link}>
        <span class="row ticks">
          ${
            LOG_X.includes(set.kind) &&
            html`
              <${Tick}
                label="log x"
                checked=${set.xlog}
                onChange=${(on) => change({ xlog: on ? 1 : null })}
              />
            `
          }
          ${
            [...LOG_X, 'box', 'slices'].includes(set.kind) &&
            set.kind !== 'ecdf' &&
            html`
              <${Tick}
                label="log y"
                checked=${set.ylog}
                onChange=${(on) => change({ ylog: on ? 1 : null })}
              />
            `
          }
          ${
            set.facet &&
            ['scatter', 'line', 'box'].includes(set.kind) &&
            html`
              <${Tick}
                label="axes of their own"
                checked=${set.own}
                onChange=${(on) => change({ scales: on ? 'own' : null })}
              />
            `
          }
        </span>
      </div>
    </section>
  `;
}

/**
 * @param {{set: Settings, data: any, title: string, csv: string}} props data: points, or groups where lines
 *   are drawn
 */
function Drawing({ set, data, title, csv }) {
  const { query } = useAddress();
  const [area, setArea] = useState(null);
  const [brushing, setBrushing] = useState(false);
  const beside = usePublished(query.filters(), set.kind === 'scatter');
  const parts = useMemo(
    () => (set.kind === 'line' ? lineParts(data, set) : pointParts(data, set, beside)),
    [data, JSON.stringify(set), beside],
  );
  if (parts === null)
    return html`
      <p class="fault" role="alert">
        ${clip(set.facet, 60)} has too many values for one chart each; choose another column.
      </p>
    `;
  if ((data.count ?? data.groups?.length) === 0) return html`<${NothingFits} notes=${data.notes} />`;
  const sentences = [
    ...new Set([
      ...(data.mixed ?? []).map((/** @type {{sentence: string}} */ one) => one.sentence),
      ...(data.notes ?? []),
      ...(set.kind === 'scatter' ? unplaced(data) : []),
      ...(decades(data) > 4 && !set.ylog
        ? [`Values span ${decades(data)} decades: “log y” tells the small ones apart`]
        : []),
      ...(parts[0]?.left
        ? [
            `${parts[0].left} of the charts would have ${
              set.kind === 'line' ? 'no line with two values of' : 'no run with'
            } ${clip(set.x, 60)}; they are left out, the table has them`,
          ]
        : []),
    ]),
  ];
  /** @param {Item} event */
  const open = (event) => openRun(data, event);
  const many = parts.length > 1;
  return html`
    ${
      set.kind === 'scatter' &&
      html`
        <p class="row">
          <${Tick} label="Select by dragging" checked=${brushing} onChange=${setBrushing} />
          ${
            area &&
            html`
              <button type="button" onClick=${() => setArea(null)}>
                All runs again
              </button>
            `
          }
          <span class="quiet">
            A click on a point opens its run. Hollow: not tracked to the end. Crosses have no
            value: they are in the grey field above the others.
            ${' '}${beside.length > 0 && 'Grey, hollow diamonds are published numbers.'}
          </span>
        </p>
      `
    }
    <div class=${many ? 'facets' : ''}>
      ${parts.map((part) =>
        part.option
          ? html`
            <${Chart}
              key=${`${part.name} ${part.metric}`}
              option=${part.option}
              height=${many ? 320 : 440}
              brushing=${brushing}
              onClick=${open}
              events=${{ brushEnd: (/** @type {Item} */ event) => setArea(ranges(event, data)) }}
              title=${part.name ? `${part.title ?? title}: ${clip(part.name, 80)}` : (part.title ?? title)}
              csv=${csv}
              table=${part.table}
              summary=${`${title}; the table has its numbers`}
            />
          `
          : html`
            <p class="fault" role="alert">
              ${clip(set.x, 60)} has too many values for boxes; choose another column or draw
              points.
            </p>
          `,
      )}
    </div>
    <${Notes} notes=${sentences} />
    ${
      set.kind === 'scatter' &&
      query.get('embed') !== '1' &&
      html`
        <${RunRows}
          filters=${new Query([...query.filters().pairs, ...(area ?? [])])}
          extra=${[set.x, set.y, set.colour]}
          selected=${area !== null}
        />
      `
    }
  `;
}

/**
 * Return a sentence on the runs that no point can stand for, as they have nothing on the horizontal axis.
 * @param {Api.Points} data
 */
function unplaced(data) {
  const x = readAxis(data.axes.x);
  const count = Array.from(data.id).filter((_, index) => x.at(index) === null).length;
  return count ? [`${count} of ${data.count} have no ${clip(x.heading.title, 60)} and are not drawn`] : [];
}

/**
 * Return how many powers of ten the values of y span; 0 where they are not numbers above 0.
 * @param {any} data points, or groups where lines are drawn
 */
function decades(data) {
  const values = (
    data.axes?.y.values ??
    (data.groups ?? []).map((/** @type {any} */ one) => Object.values(one.figures)[0]?.median)
  ).filter((/** @type {any} */ value) => value > 0);
  const [low, high] = [Math.min, Math.max].map((end) =>
    values.reduce((/** @type {number} */ a, /** @type {number} */ b) => end(a, b), values[0]),
  );
  return values.length ? Math.round(Math.log10(high / low)) : 0;
}

/**
 * @param {Api.Aggregate} data
 * @param {Settings} set
 * @returns {ChartOfSettings[]|null}
 */
function lineParts(data, set) {
  const values = set.facet ? [...new Set(data.groups.map((group) => String(group.keys[set.facet])))] : [null];
  if (values.length > 24) return null;
  // A chart is worth drawing where at least one of its lines has two points.
  const wide = values.filter((value) =>
    lines(data, set.x, data.metrics[0].name, set.facet, value).some((one) => one.points.length > 1),
  );
  const over = clip(axisName(headingOf(data.keys, set.x)), 60);
  const shown = wide.length ? wide : values;
  return shown.flatMap((value) =>
    data.metrics.map((metric) => ({
      name: value && facetName(data, set.facet, value),
      metric: metric.name,
      title: data.metrics.length > 1 ? `${clip(metric.title, 40)} over ${over}` : null,
      left: wide.length ? values.length - wide.length : 0,
      option: line(data, { ...set, y: metric.name, facetValue: value, among: shown }),
      table: groupTable({
        ...data,
        metrics: [metric],
        groups: set.facet
          ? data.groups.filter((group) => String(group.keys[set.facet]) === value)
          : data.groups,
      }),
    })),
  );
}

/**
 * @param {Api.Aggregate} data
 * @param {string} facet
 * @param {string} value
 */
function facetName(data, facet, value) {
  const known = data.groups.find((group) => String(group.keys[facet]) === value);
  return namedValue(headingOf(data.keys, facet), known?.keys[facet]);
}

/**
 * @param {Api.Points} data
 * @param {Settings} set
 * @param {Api.PublishedRow[]} beside
 * @returns {ChartOfSettings[]|null}
 */
function pointParts(data, set, beside) {
  const every = facets(data);
  if (every === null) return null;
  const x = readAxis(data.axes.x);
  const placed = every.filter(({ indices }) => indices.some((index) => x.at(index) !== null));
  const parts = placed.length ? placed : every;
  return parts.map(({ name, indices }) => ({
    name,
    left: every.length - parts.length,
    table: pointTable(data, indices),
    option:
      set.kind === 'box'
        ? box(data, indices, { ylog: set.ylog, tracked: set.outcomes === 'tracked', own: set.own })
        : scatter(data, indices, set, set.facet && set.facet !== 'dataset' ? [] : of(name, beside)),
  }));
}

/**
 * Return the published rows of one part: of all datasets, or of the one that it is of.
 * @param {string|null} part
 * @param {Api.PublishedRow[]} rows
 */
const of = (part, rows) => (part === null ? rows : rows.filter((row) => row.dataset === part));

/**
 * @param {Api.Points} data
 * @param {number[]} indices
 * @returns {TableData}
 */
function pointTable(data, indices) {
  const axes = Object.values(data.axes).map(readAxis);
  const status = readAxis(data.status);
  return {
    columns: [
      { name: 'run', title: 'run' },
      ...axes.map((axis) => ({
        name: axis.heading.name,
        title: axis.heading.title,
        show: (/** @type {unknown} */ value) => clip(value, 48),
      })),
      { name: 'status', title: 'status' },
    ],
    rows: indices.slice(0, 1001).map((index) => ({
      run: data.run?.[index] ?? data.id[index],
      ...Object.fromEntries(axes.map((axis) => [axis.heading.name, axis.text(index)])),
      status: status.text(index),
    })),
  };
}

/**
 * @param {Api.Points} data
 * @param {Item} event
 */
async function openRun(data, event) {
  const index = event.value?.[2];
  if (event.seriesType !== 'scatter' || index === undefined) return;
  const uid =
    data.uid?.[index] ??
    (await fetchJson(address('/api/v1/runs', { id: data.id[index], columns: 'uid' }))).items[0]?.uid;
  if (uid) go(`/runs/${encodeURIComponent(uid)}`);
}

/**
 * Turn a dragged rectangle into filters of the API, in stored units.
 * @param {Item} event
 * @param {Api.Points} data
 * @returns {Array<[string, string]>|null}
 */
function ranges(event, data) {
  const area = event.areas?.[0]?.coordRange;
  if (!area) return null;
  return ['x', 'y'].flatMap((name, at) => {
    const axis = readAxis(name === 'x' ? data.axes.x : data.axes.y);
    const [low, high] = area[at];
    if (axis.categories)
      return axis.categories
        .slice(Math.max(0, Math.ceil(low)), Math.floor(high) + 1)
        .map((value) => [axis.heading.name, value]);
    if (axis.heading.kind === 'time') return [];
    const factor = axis.heading.factor ?? 1;
    return [
      [`${axis.heading.name}>`, String(low / factor)],
      [`${axis.heading.name}<`, String(high / factor)],
    ];
  });
}
