// SPDX-License-Identifier: Apache-2.0
/** A chart with what belongs to it: its table, its CSV, its picture. */
import { fileName, Framed, inks, isDark, save, saveSvg } from './figure.js';
import { clip } from './format.js';
import { fitted } from './legend.js';
import { html, useEffect, useLayoutEffect, useRef, useState } from './ui.js';

/** Okabe and Ito's colours, for colour-blind eyes; as in reports and figures, without black (dark theme). */
export const COLOURS = [
  '#0072b2',
  '#e69f00',
  '#009e73',
  '#cc79a7',
  '#d55e00',
  '#56b4e9',
  '#8c6bb1',
  '#a6761d',
  '#7f7f7f',
  '#b3b300',
  '#1b9e77',
  '#7570b3',
];

/**
 * Lines have a short line in the legend. It stands in a box as high as the text: where there are too many
 * names for one row, the drawing library cuts the text off at the box.
 */
const LINES = { icon: 'path://M0 0L0 0M0 5L18 5L18 9L0 9ZM18 14L18 14', itemHeight: 14, itemWidth: 18 };

/**
 * Return the legend of lines: of those that have names in it, or of all.
 * @param {string[]} [names]
 */
export const legendOfLines = (names) =>
  names ? { ...LINES, data: names.map((name) => clip(name, 90)) } : LINES;

/** @type {Promise<typeof import('/vendor/echarts.mjs')>|undefined} */
let loading;
const load = () => (loading ??= import('/vendor/echarts.mjs'));

/**
 * Give an option the colours of the page.
 * @param {any} option
 * @param {boolean} dark
 */
export function dressed(option, dark) {
  const ink = inks(dark);
  /** @param {any} one */
  const axis = (one) => ({
    nameTextStyle: { color: ink.text },
    nameLocation: 'middle',
    ...one,
    axisLabel: { color: ink.faint, hideOverlap: true, ...one.axisLabel },
    axisLine: { lineStyle: { color: ink.faint }, ...one.axisLine },
    splitLine: { lineStyle: { color: ink.line }, ...one.splitLine },
  });
  /** @param {any} all */
  const axes = (all) => (Array.isArray(all) ? all.map(axis) : all && axis(all));
  const base = {
    color: COLOURS,
    animation: false,
    backgroundColor: ink.back,
    textStyle: { color: ink.text, fontFamily: 'system-ui, sans-serif' },
    aria: { enabled: true },
  };
  /** @type {Record<string, any>} */
  const out = { ...base, ...option, xAxis: axes(option.xAxis), yAxis: axes(option.yAxis) };
  if (option.tooltip) {
    out.tooltip = {
      renderMode: 'richText',
      confine: true,
      backgroundColor: ink.back,
      borderColor: ink.line,
      textStyle: { color: ink.text },
      ...option.tooltip,
    };
  }
  if (option.legend)
    out.legend = {
      type: 'scroll',
      top: 0,
      inactiveColor: ink.line,
      pageTextStyle: { color: ink.text },
      pageIconColor: ink.text,
      ...option.legend,
      textStyle: { color: ink.text, ...option.legend.textStyle },
    };
  if (option.graphic)
    out.graphic = option.graphic.map((/** @type {any} */ one) => ({
      ...one,
      style: { fill: ink.text, fontFamily: 'system-ui, sans-serif', ...one.style },
    }));
  if (option.visualMap) out.visualMap = { textStyle: { color: ink.text }, ...option.visualMap };
  if (option.parallel) {
    out.parallelAxis = option.parallelAxis.map((/** @type {any} */ one) => ({
      ...one,
      nameTextStyle: { color: ink.text },
      axisLabel: { color: ink.faint, width: 80, overflow: 'truncate', ...one.axisLabel },
      axisLine: { lineStyle: { color: ink.faint } },
    }));
  }
  for (const key of ['xAxis', 'yAxis']) if (out[key] === undefined) delete out[key];
  return out;
}

/**
 * @param {Sized} option
 * @param {number} width
 * @param {number} height
 */
const sized = (option, width, height) =>
  fitted(typeof option === 'function' ? option({ width, height }) : option, width);

/**
 * @param {import('/vendor/echarts.mjs').Instance|null} chart
 * @param {boolean} on
 */
const take = (chart, on) =>
  chart?.dispatchAction({
    type: 'takeGlobalCursor',
    key: 'brush',
    brushOption: { brushType: on ? 'rect' : false, brushMode: 'single' },
  });

/**
 * A chart.
 * @param {{option: Sized, title: string, height?: number, csv?: string|true, table?: TableData, onClick?:
 *   (event: any) => void, events?: Record<string, (event: any, chart: any) => void>, link?: string, summary?:
 *   string, brushing?: boolean, group?: string}} props option: of ECharts, without colours, or a function of
 *   {width, height} that gives it; csv: address of the table behind it; link: the page that shows it in full;
 *   brushing: dragging selects, where the option has a brush; group: charts of one group share their cursor.
 */
export function Chart({
  option,
  title,
  height = 380,
  csv,
  table,
  onClick,
  events,
  link,
  summary,
  brushing = false,
  group,
}) {
  const box = useRef(null);
  const chart = useRef(null);
  const current = useRef(/** @type {any} */ ({}));
  const [failed, setFailed] = useState(null);
  current.current = { option, onClick, events, brushing, group, height };
  const draw = () => {
    const width = box.current.clientWidth;
    const { option: made, more } = sized(current.current.option, width, current.current.height);
    box.current.style.height = `${current.current.height + more}px`;
    chart.current.resize();
    chart.current.setOption(dressed(made, isDark()), { notMerge: true });
  };

  useLayoutEffect(() => {
    let ended = false;
    /** @type {ResizeObserver|null} */
    let watcher = null;
    const again = () => chart.current && draw();
    load().then(
      (echarts) => {
        if (ended) return;
        chart.current = echarts.init(box.current, null, { renderer: 'canvas' });
        if (current.current.group) {
          chart.current.group = current.current.group;
          echarts.connect(current.current.group);
        }
        chart.current.on('click', (/** @type {any} */ event) => current.current.onClick?.(event));
        for (const name of Object.keys(current.current.events ?? {})) {
          chart.current.on(name, (/** @type {any} */ event) =>
            current.current.events[name]?.(event, chart.current),
          );
        }
        draw();
        if (current.current.option.brush) take(chart.current, current.current.brushing);
        box.current.dataset.drawn = 'yes';
        let drawn = box.current.clientWidth;
        watcher = new ResizeObserver(() => {
          if (box.current && box.current.clientWidth !== drawn) again();
          drawn = box.current?.clientWidth;
        });
        watcher.observe(box.current);
      },
      () => setFailed('The chart library could not be loaded; the table below has the numbers.'),
    );
    addEventListener('themechange', again);
    return () => {
      ended = true;
      removeEventListener('themechange', again);
      watcher?.disconnect();
      chart.current?.dispose();
      chart.current = null;
    };
  }, []);
  useEffect(() => {
    if (chart.current) draw();
    if ('brush' in option) take(chart.current, brushing);
  }, [option, brushing]);

  const png = () =>
    save(
      chart.current.getDataURL({
        type: 'png',
        pixelRatio: 2,
        backgroundColor: inks(isDark()).back,
      }),
      fileName(title, 'png'),
    );
  const svg = async () => {
    const echarts = await load();
    const width = box.current.clientWidth;
    const { option: made, more } = sized(option, width, height);
    const paper = echarts.init(null, null, { renderer: 'svg', ssr: true, width, height: height + more });
    paper.setOption(dressed(made, false));
    saveSvg(paper.renderToSVGString(), fileName(title, 'svg'));
    paper.dispose();
  };

  return html`
    <${Framed} title=${title} link=${link} csv=${csv} table=${table} png=${png} svg=${svg}>
      ${
        failed &&
        html`
          <p class="fault" role="alert">
            ${failed}
          </p>
        `
      }
      <div
        class="canvas"
        ref=${box}
        role="img"
        aria-label=${summary ?? title}
        style=${{ height: `${height}px` }}
      ></div>
    </${Framed}>
  `;
}
