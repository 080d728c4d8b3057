// SPDX-License-Identifier: Apache-2.0
/** Paths in three dimensions, seen from any side: lengths stay true (no perspective), z points up. */
import { number } from '../core/format.js';
import { ramp } from '../core/scale.js';
import { endsOf, pieces } from './trajectory.js';

const RADIANS = Math.PI / 180;
const CHUNK = 12;
const STEPS = 24;
/** Pixels of the ring where a path begins, and of the dot where it ends. */
const RING = 7;
const DOT = 8;

/**
 * What is drawn, independent of where it is seen from.
 * @param {Path[]} paths
 * @param {ErrorRange} range of the errors that the colours span
 * @returns {Scene|null} null without a point
 */
export function scene(paths, range) {
  const chunks = paths.flatMap((path) =>
    pieces(path.track).flatMap(([from, to]) => chunked(path, from, to, range)),
  );
  const points = chunks.flatMap((chunk) => chunk.points);
  if (points.length === 0) return null;
  /**
   * @param {(a: number, b: number) => number} choose
   * @param {number} start
   */
  const end = (choose, start) =>
    [0, 1, 2].map((axis) => points.reduce((found, point) => choose(found, point[axis]), start));
  const [low, high] = [end(Math.min, Infinity), end(Math.max, -Infinity)];
  const middle = low.map((value, axis) => (value + high[axis]) / 2);
  const half = low.map((value, axis) => (high[axis] - value) / 2);
  const ends = paths
    .filter((path) => !path.under)
    .flatMap((path, index) => {
      const found = endsOf(path, index, Boolean(path.error));
      const { x, y, z } = path.track;
      return found ? [{ colour: found.colour, points: found.places.map((at) => [x[at], y[at], z[at]]) }] : [];
    });
  return { chunks, ends, low, high, middle, round: Math.hypot(half[0], half[1]), tall: half[2] };
}

/**
 * @param {Path} path
 * @param {number} from
 * @param {number} to
 * @param {ErrorRange} range
 * @returns {Chunk[]}
 */
function chunked({ track, colour, width, error, under = false }, from, to, range) {
  /** @param {number} index */
  const at = (index) => [track.x[index], track.y[index], track.z[index]];
  /** @param {number} index */
  const tint = (index) => {
    if (!error) return colour;
    if (error[index] === null) return null;
    const share = range && range.high > range.low ? (error[index] - range.low) / (range.high - range.low) : 0;
    return ramp(Math.round(share * STEPS) / STEPS);
  };
  /** @type {Chunk[]} */
  const found = [];
  for (let index = from; index < to - 1; index += 1) {
    const shade = tint(index) ?? colour;
    const last = found.at(-1);
    if (last && last.colour === shade && last.points.length < CHUNK) last.points.push(at(index + 1));
    else found.push({ points: [at(index), at(index + 1)], colour: shade, width, under });
  }
  return found.length || to - from !== 1
    ? found
    : [{ points: [at(from), at(from)], colour: tint(from) ?? colour, width: width * 2, under }];
}

/**
 * Return a function that lays a point out on paper: [x, y, depth], depth growing towards the reader.
 * @param {Scene} found
 * @param {View} view degrees: round the z axis, above the horizon
 * @param {number} width
 * @param {number} height
 * @param {number} [margin]
 * @returns {(point: number[]) => number[]}
 */
export function projector(found, view, width, height, margin = 34) {
  const [a, e] = [view.azimuth * RADIANS, view.elevation * RADIANS];
  const [across, down] = [
    Math.max(found.round, 1e-6),
    Math.max(found.round * Math.abs(Math.sin(e)) + found.tall * Math.cos(e), 1e-6),
  ];
  const scale = view.zoom * Math.min((width / 2 - margin) / across, (height / 2 - margin) / down);
  return (point) => {
    const [x, y, z] = point.map((value, axis) => value - found.middle[axis]);
    const right = -Math.sin(a) * x + Math.cos(a) * y;
    const towards = Math.cos(a) * x + Math.sin(a) * y;
    const up = Math.cos(e) * z - Math.sin(e) * towards;
    return [width / 2 + scale * right, height / 2 - scale * up, Math.cos(e) * towards + Math.sin(e) * z];
  };
}

/**
 * Return the lines, texts and dots on paper, the farthest first.
 * @param {Scene} found of scene
 * @param {View} view
 * @param {number} width
 * @param {number} height
 * @param {Inks} ink
 * @returns {Paper}
 */
export function drawing(found, view, width, height, ink) {
  const project = projector(found, view, width, height);
  const { low, high } = found;
  /** @type {Stroke[]} */
  const edges = [];
  /** @type {Word[]} */
  const texts = [];
  /** @param {number[]} bits */
  const corner = (bits) => bits.map((bit, axis) => (bit ? high[axis] : low[axis]));
  // Of the box around the paths, the three sides that lie behind them.
  const behind = [0, 1, 2].map((axis) => {
    const unit = [0, 0, 0];
    unit[axis] = 1;
    const [near, far] = [project(found.middle.map((value, at) => value + unit[at])), project(found.middle)];
    return near[2] > far[2] ? 0 : 1;
  });
  [0, 1, 2].forEach((axis) => {
    const [b, c] = [0, 1, 2].filter((one) => one !== axis);
    for (const [vb, vc] of [
      [0, 0],
      [0, 1],
      [1, 0],
      [1, 1],
    ]) {
      if (vb !== behind[b] && vc !== behind[c]) continue;
      const bits = [0, 0, 0];
      [bits[b], bits[c]] = [vb, vc];
      const other = [...bits];
      other[axis] = 1;
      edges.push({ points: [corner(bits), corner(other)].map(project), colour: ink.line, width: 1 });
    }
    texts.push(...labels(found, project, axis, behind, ink, [width, height]));
  });
  const lines = found.chunks
    .map((chunk) => {
      const points = chunk.points.map(project);
      return {
        points,
        colour: chunk.colour,
        width: chunk.width,
        under: chunk.under,
        depth: points[points.length >> 1][2],
      };
    })
    .sort((one, other) => Number(other.under) - Number(one.under) || one.depth - other.depth);
  for (const { points, colour } of found.ends) {
    const [[x, y], last] = points.map(project);
    const ring = Array.from({ length: 25 }, (_, step) => (step * Math.PI) / 12).map((angle) => [
      x + RING * Math.cos(angle),
      y + RING * Math.sin(angle),
    ]);
    lines.push({ points: ring, colour, width: 2, under: false, depth: Infinity });
    lines.push({ points: [last, last], colour, width: DOT, under: false, depth: Infinity });
    if (found.ends.length === 1) {
      texts.push({ text: 'start', colour, at: [x, y - 15] });
      texts.push({ text: 'end', colour, at: [last[0], last[1] + 15] });
    }
  }
  return { lines: [...edges, ...lines], texts };
}

/**
 * The name and the two ends of an axis, along the edge of the box that is seen against nothing.
 * @param {Scene} found
 * @param {(point: number[]) => number[]} project
 * @param {number} axis
 * @param {number[]} behind
 * @param {Inks} ink
 * @param {number[]} size
 * @returns {Word[]}
 */
function labels(found, project, axis, behind, ink, [width, height]) {
  const { low, high } = found;
  const [b, c] = [0, 1, 2].filter((one) => one !== axis);
  /** @param {number[]} ends of the other two axes: 0 low, 1 high */
  const edge = ([vb, vc]) =>
    [low, high].map((end) => {
      const point = [0, 0, 0];
      point[axis] = end[axis];
      point[b] = vb ? high[b] : low[b];
      point[c] = vc ? high[c] : low[c];
      return project(point);
    });
  const outer =
    axis === 2
      ? [
          [behind[0], 1 - behind[1]],
          [1 - behind[0], behind[1]],
        ]
          .map(edge)
          .sort((p, q) => p[0][0] - q[0][0])[0]
      : edge([b, c].map((one) => (one === 2 ? 0 : 1 - behind[one])));
  const [from, to] = outer;
  if (Math.hypot(to[0] - from[0], to[1] - from[1]) < 30) return [];
  const away = [(from[0] + to[0]) / 2 - width / 2, (from[1] + to[1]) / 2 - height / 2];
  const length = Math.hypot(...away) || 1;
  /**
   * @param {number} share
   * @param {string} text
   * @param {string} colour
   */
  const put = (share, text, colour) => ({
    text,
    colour,
    at: [0, 1].map((i) => from[i] + (to[i] - from[i]) * share + (away[i] / length) * 14),
  });
  /** @param {number} value */
  const short = (value) => number(value, 3);
  return [
    put(0.5, `${'xyz'[axis]} [m]`, ink.text),
    put(0.04, short(low[axis]), ink.faint),
    put(0.96, short(high[axis]), ink.faint),
  ];
}

/**
 * Draw on a canvas' context.
 * @param {CanvasRenderingContext2D} context
 * @param {Paper} paper
 */
export function paint(context, { lines, texts }) {
  context.lineJoin = 'round';
  context.lineCap = 'round';
  for (const line of lines) {
    context.strokeStyle = line.colour;
    context.lineWidth = line.width;
    context.beginPath();
    line.points.forEach(([x, y], at) => {
      if (at) context.lineTo(x, y);
      else context.moveTo(x, y);
    });
    context.stroke();
  }
  context.font = '12px system-ui, sans-serif';
  context.textAlign = 'center';
  context.textBaseline = 'middle';
  for (const { text, at, colour } of texts) {
    context.fillStyle = colour;
    context.fillText(text, at[0], at[1]);
  }
}

/**
 * Return the same as an SVG file.
 * @param {Paper} paper
 * @param {number} width
 * @param {number} height
 * @param {string} back
 */
export function toSvg({ lines, texts }, width, height, back) {
  /** @param {number} value */
  const digit = (value) => value.toFixed(1);
  /** @param {Stroke} line */
  const path = ({ points, colour, width: thick }) => {
    const places = points.map(([x, y]) => `${digit(x)},${digit(y)}`).join(' ');
    return `<polyline points="${places}" stroke="${escaped(colour)}" stroke-width="${thick}"/>`;
  };
  /** @param {Word} word */
  const word = ({ text, at, colour }) =>
    `<text x="${digit(at[0])}" y="${digit(at[1])}" fill="${escaped(colour)}">${escaped(text)}</text>`;
  const size = `width="${width}" height="${height}" viewBox="0 0 ${width} ${height}"`;
  const font = 'font-family="system-ui, sans-serif" font-size="12"';
  return [
    `<svg xmlns="http://www.w3.org/2000/svg" ${size}>`,
    `<rect width="100%" height="100%" fill="${escaped(back)}"/>`,
    `<g fill="none" stroke-linecap="round" stroke-linejoin="round">${lines.map(path).join('\n')}</g>`,
    `<g ${font} text-anchor="middle" dominant-baseline="middle">${texts.map(word).join('')}</g></svg>`,
  ].join('\n');
}

/** @type {Record<string, string>} */
const ENTITIES = { '&': '&amp;', '<': '&lt;', '>': '&gt;', '"': '&quot;' };

/**
 * Return a text as XML takes it.
 * @param {string} text
 */
const escaped = (text) => text.replaceAll(/[&<>"]/g, (sign) => ENTITIES[sign]);
