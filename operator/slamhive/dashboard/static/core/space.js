// SPDX-License-Identifier: Apache-2.0
/** A view of paths in space that is turned by dragging or by keys. */
import { drawing, paint, scene, toSvg } from '../charts/space.js';

import { fileName, Framed, inks, isDark, save, saveSvg } from './figure.js';
import { clip, number } from './format.js';
import { SCALE } from './scale.js';
import { html, useEffect, useLayoutEffect, useMemo, useRef, useState } from './ui.js';

/** @type {View} */
const START = { azimuth: -60, elevation: 30, zoom: 1 };
const TURN = 10;
const HELP = 'Arrow keys turn it, plus and minus change its size, Home brings it back.';
/** @type {Record<string, (view: View) => View>} */
const KEYS = {
  ArrowLeft: (view) => ({ ...view, azimuth: view.azimuth - TURN }),
  ArrowRight: (view) => ({ ...view, azimuth: view.azimuth + TURN }),
  ArrowUp: (view) => ({ ...view, elevation: view.elevation + TURN }),
  ArrowDown: (view) => ({ ...view, elevation: view.elevation - TURN }),
  '+': (view) => ({ ...view, zoom: view.zoom * 1.25 }),
  '=': (view) => ({ ...view, zoom: view.zoom * 1.25 }),
  '-': (view) => ({ ...view, zoom: view.zoom / 1.25 }),
  Home: () => START,
};

/**
 * @param {View} view
 * @returns {View}
 */
const kept = ({ azimuth, elevation, zoom }) => ({
  azimuth: ((((azimuth + 180) % 360) + 360) % 360) - 180,
  elevation: Math.min(90, Math.max(-90, elevation)),
  zoom: Math.min(20, Math.max(0.3, zoom)),
});

/**
 * Read "azimuth,elevation,zoom" of an address.
 * @param {string|null} text
 */
export const readView = (text) => {
  const [azimuth, elevation, zoom] = String(text ?? '')
    .split(',')
    .map(Number);
  return text && [azimuth, elevation, zoom].every(Number.isFinite)
    ? kept({ azimuth, elevation, zoom })
    : START;
};

/**
 * Return a view as the address keeps it; null for the one at the start.
 * @param {View} view
 */
export const writeView = (view) => {
  const text = [view.azimuth, view.elevation, view.zoom].map((value) => Number(value.toFixed(2))).join(',');
  return text === Object.values(START).join(',') ? null : text;
};

/**
 * Paths in space. `paths` and `range` are as charts/space.js takes them, `view` is "azimuth,elevation,zoom"
 * in degrees.
 * @param {SpaceProps} props
 */
export function Space({ title, paths, range, height = 380, csv, table, view: told, onView }) {
  const [view, setView] = useState(() => readView(told));
  const canvas = useRef(null);
  const held = useRef(null);
  const latest = useRef(view);
  latest.current = view;
  const found = useMemo(() => scene(paths, range), [paths, range]);
  const draw = () => {
    const surface = canvas.current;
    if (!surface || !found) return;
    const ratio = devicePixelRatio || 1;
    const width = surface.clientWidth;
    [surface.width, surface.height] = [Math.round(width * ratio), Math.round(height * ratio)];
    const context = surface.getContext('2d');
    context.scale(ratio, ratio);
    const ink = inks(isDark());
    context.fillStyle = ink.back;
    context.fillRect(0, 0, width, height);
    paint(context, drawing(found, latest.current, width, height, ink));
    surface.dataset.drawn = `${surface.width}`;
  };
  useLayoutEffect(draw, [found, view, height]);
  useEffect(() => {
    const watcher = new ResizeObserver(draw);
    if (canvas.current) watcher.observe(canvas.current);
    addEventListener('themechange', draw);
    return () => {
      watcher.disconnect();
      removeEventListener('themechange', draw);
    };
  }, [found]);
  /** @param {View} next */
  const turn = (next) => {
    const view = kept(next);
    setView(view);
    onView?.(writeView(view));
  };
  /** @param {KeyboardEvent} event */
  const press = (event) => {
    const action = KEYS[event.key];
    if (!action || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    turn(action(view));
  };
  /** @param {PointerEvent & {target: Element}} event */
  const grab = (event) => {
    held.current = [event.clientX, event.clientY, view];
    event.target.setPointerCapture?.(event.pointerId);
  };
  /** @param {PointerEvent} event */
  const drag = (event) => {
    if (!held.current) return;
    const [x, y, from] = held.current;
    setView(
      kept({
        ...from,
        azimuth: from.azimuth - (event.clientX - x) / 2,
        elevation: from.elevation + (event.clientY - y) / 2,
      }),
    );
  };
  const drop = () => {
    if (!held.current) return;
    held.current = null;
    onView?.(writeView(latest.current));
  };
  const png = () => save(canvas.current.toDataURL('image/png'), fileName(title, 'png'));
  const svg = () => {
    if (!found) return;
    const ink = inks(false);
    const width = canvas.current.clientWidth;
    saveSvg(toSvg(drawing(found, view, width, height, ink), width, height, ink.back), fileName(title, 'svg'));
  };
  const [round, up] = [number(Math.round(view.azimuth)), number(Math.round(view.elevation))];
  const seen = `azimuth ${round}°, elevation ${up}°`;
  if (!found) return null;
  /**
   * @param {string} text
   * @param {string} name
   * @param {View} next
   */
  const button = (text, name, next) => html`
    <button type="button" title=${name} aria-label=${name} onClick=${() => turn(next)}>
      ${text}
    </button>
  `;
  return html`
    <${Framed}
      title=${title}
      csv=${csv}
      table=${table}
      png=${png}
      svg=${svg}
      tools=${html`
        ${button('Above', 'From above', { azimuth: -90, elevation: 90, zoom: view.zoom })}
        ${button('Reset', 'Reset the view', START)}
        ${button('−', 'Smaller', KEYS['-'](view))}
        ${button('+', 'Larger', KEYS['+'](view))}
      `}
    >
      <canvas
        ref=${canvas}
        class="space"
        style=${{ height: `${height}px` }}
        tabindex="0"
        role="application"
        aria-roledescription="view in space"
        aria-label=${`${title}: ${clip(paths.map((path) => path.name).join(', '), 200)}. ${HELP}`}
        onKeyDown=${press}
        onPointerDown=${grab}
        onPointerMove=${drag}
        onPointerUp=${drop}
        onPointerCancel=${drop}
      ></canvas>
      <div class="key">
        <span class="quiet" role="status">
          ${seen}
        </span>
        ${
          range
            ? html`
              <span class="ramp">
                <span>${number(range.low, 3)}</span>
                <svg width="110" height="10" aria-hidden="true">
                  <defs>
                    <linearGradient id="ramp">
                      ${SCALE.map(
                        (colour, at) => html`
                          <stop
                            offset=${at / (SCALE.length - 1)}
                            stop-color=${colour}
                          />
                        `,
                      )}
                    </linearGradient>
                  </defs>
                  <rect width="110" height="10" rx="2" fill="url(#ramp)" />
                </svg>
                <span>${number(range.high, 3)} m error</span>
              </span>
            `
            : ''
        }
        ${paths
          .filter((path) => !range || !path.error)
          .filter((path, at, all) => all.findIndex((one) => one.name === path.name) === at)
          .map(
            (path) => html`
              <span>
                <svg width="18" height="4" aria-hidden="true">
                  <rect width="18" height="4" rx="2" fill=${path.colour} />
                </svg>${' '}
                ${clip(path.name, 40)}
              </span>
            `,
          )}
      </div>
    </${Framed}>
  `;
}
