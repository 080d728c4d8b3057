// SPDX-License-Identifier: Apache-2.0
'use strict';
(() => {
  /**
   * Return an element of the page.
   * @param {string} id
   */
  const part = (id) => /** @type {HTMLElement} */ (document.getElementById(id));
  /** @type {Report.Data} */
  const data = JSON.parse(String(part('data').textContent));
  const SIZE = { width: 560, height: 360, left: 62, right: 14, top: 12, bottom: 44 };
  const DASHES = ['', '8 3', '2 3', '8 3 2 3'];
  // Of errors along a path, dark is worse: cividis without its ends, as on all pages and in figures.
  const SCALE = [
    [214, 195, 93],
    [192, 177, 103],
    [170, 159, 113],
    [148, 142, 117],
    [125, 124, 120],
    [104, 108, 115],
    [83, 91, 109],
    [60, 76, 110],
    [36, 60, 110],
  ];
  /**
   * @type {{kind: string, hidden: Set<Report.Estimate>, azimuth: number, elevation: number, at: number|null}}
   */
  const state = {
    kind: Object.keys(data.kinds)[0] ?? '',
    hidden: new Set(),
    azimuth: -0.9,
    elevation: 0.55,
    at: null,
  };
  const measured = state.kind !== '';
  const shown = () => data.estimates.filter((one) => one.time.length && !state.hidden.has(one));
  /** @param {Report.Estimate} one */
  const colour = (one) => `var(--c${data.estimates.indexOf(one) % 6})`;
  /** @param {Report.Estimate} one */
  const dash = (one) => DASHES[Math.floor(data.estimates.indexOf(one) / 6) % DASHES.length];

  /**
   * @param {string} name
   * @param {Record<string, string|number|undefined>} attributes
   * @param {Array<string|Node>} children
   */
  function make(name, attributes = {}, ...children) {
    const svg = ['svg', 'g', 'path', 'line', 'rect', 'circle', 'text', 'title'].includes(name);
    const node = /** @type {HTMLElement} */ (
      svg ? document.createElementNS('http://www.w3.org/2000/svg', name) : document.createElement(name)
    );
    for (const [key, value] of Object.entries(attributes)) {
      if (value !== undefined && value !== '') node.setAttribute(key, String(value));
    }
    node.append(...children);
    return node;
  }

  /**
   * @param {number|null|undefined} value
   * @param {number} [digits]
   */
  function figures(value, digits = 4) {
    if (value === null || value === undefined) return '–';
    if (value !== 0 && (Math.abs(value) < 1e-4 || Math.abs(value) >= 1e6))
      return value.toExponential(digits - 1);
    return String(Number(value.toPrecision(digits)));
  }

  /**
   * @param {number} low
   * @param {number} high
   * @param {number} count
   * @returns {number[]}
   */
  function ticks(low, high, count) {
    const raw = (high - low) / count || 1;
    const power = 10 ** Math.floor(Math.log10(raw));
    const steps = [1, 2, 2.5, 5].map((factor) => factor * power);
    const step = steps.find((one) => one >= raw * 0.75) ?? 10 * power;
    const found = [];
    for (let k = Math.ceil(low / step - 1e-9); k * step <= high + step * 1e-9; k += 1) found.push(k * step);
    return found;
  }

  // A loop, not Math.min(...values): arguments have a limit.
  /** @param {number[][]} lists */
  function range(lists) {
    let low = Infinity;
    let high = -Infinity;
    for (const list of lists) {
      for (const value of list) {
        if (value < low) low = value;
        if (value > high) high = value;
      }
    }
    return low <= high ? [low, high] : [0, 1];
  }

  /**
   * @param {number[]} xs
   * @param {number[]} ys
   * @param {number[]} [breaks] points before which the line is broken
   */
  function line(xs, ys, breaks = []) {
    const jumps = new Set(breaks);
    return xs.map((x, k) => `${k && !jumps.has(k) ? 'L' : 'M'}${x.toFixed(1)} ${ys[k].toFixed(1)}`).join('');
  }

  /**
   * @param {HTMLElement} parent
   * @param {string} id
   * @param {string} caption
   * @param {string} label
   */
  function panel(parent, id, caption, label) {
    const svg = make('svg', {
      viewBox: `0 0 ${SIZE.width} ${SIZE.height}`,
      role: 'img',
      id,
      'aria-label': label,
    });
    parent.append(make('figure', {}, make('figcaption', {}, caption), svg));
    return svg;
  }

  /**
   * Draw axes within a panel; equal ones show a metre as long in x as in y.
   * @param {HTMLElement} svg
   * @param {number[]} xRange
   * @param {number[]} yRange
   * @param {string} xName
   * @param {string} yName
   * @param {{equal?: boolean, xTicks?: boolean}} [how]
   * @returns {Report.Scale}
   */
  function axes(svg, xRange, yRange, xName, yName, { equal = false, xTicks = true } = {}) {
    svg.replaceChildren();
    const inner = {
      width: SIZE.width - SIZE.left - SIZE.right,
      height: SIZE.height - SIZE.top - SIZE.bottom,
    };
    let [x0, x1] = xRange;
    let [y0, y1] = yRange;
    if (equal) {
      const unit = Math.max((x1 - x0) / inner.width, (y1 - y0) / inner.height, 1e-9) * 1.06;
      const middle = [(x0 + x1) / 2, (y0 + y1) / 2];
      [x0, x1] = [middle[0] - (unit * inner.width) / 2, middle[0] + (unit * inner.width) / 2];
      [y0, y1] = [middle[1] - (unit * inner.height) / 2, middle[1] + (unit * inner.height) / 2];
    }
    if (!(x1 > x0)) [x0, x1] = [x0 - 0.5, x0 + 0.5];
    if (!(y1 > y0)) y1 = y0 + 1;
    /** @param {number} value */
    const x = (value) => SIZE.left + ((value - x0) / (x1 - x0)) * inner.width;
    /** @param {number} value */
    const y = (value) => SIZE.top + inner.height - ((value - y0) / (y1 - y0)) * inner.height;
    const bottom = SIZE.top + inner.height;
    for (const value of xTicks ? ticks(x0, x1, 6) : []) {
      svg.append(make('line', { class: 'rule', x1: x(value), x2: x(value), y1: SIZE.top, y2: bottom }));
      svg.append(make('text', { x: x(value), y: bottom + 16, 'text-anchor': 'middle' }, figures(value)));
    }
    for (const value of ticks(y0, y1, 5)) {
      svg.append(
        make('line', {
          class: 'rule',
          x1: SIZE.left,
          x2: SIZE.width - SIZE.right,
          y1: y(value),
          y2: y(value),
        }),
      );
      svg.append(make('text', { x: SIZE.left - 6, y: y(value) + 4, 'text-anchor': 'end' }, figures(value)));
    }
    svg.append(
      make('path', { class: 'axis', d: `M${SIZE.left} ${SIZE.top}V${bottom}H${SIZE.width - SIZE.right}` }),
    );
    svg.append(
      make('text', { x: SIZE.left + inner.width / 2, y: SIZE.height - 6, 'text-anchor': 'middle' }, xName),
    );
    const turned = `translate(14 ${SIZE.top + inner.height / 2}) rotate(-90)`;
    svg.append(make('text', { transform: turned, 'text-anchor': 'middle' }, yName));
    return { x, y, x0, x1, bottom };
  }

  /**
   * @param {Report.Estimate} one
   * @param {number[]} xs
   * @param {number[]} ys
   * @param {number[]} breaks
   */
  function curve(one, xs, ys, breaks) {
    const node = make('path', { class: 'curve', d: line(xs, ys, breaks), 'stroke-dasharray': dash(one) });
    node.style.stroke = colour(one);
    return node;
  }

  /**
   * Draw the path of an estimate: one alone by its error, one of several in its colour.
   * @param {Report.Estimate} one
   * @param {number[]} xs
   * @param {number[]} ys
   */
  function way(one, xs, ys) {
    const errors = one.errors[state.kind];
    if (!errors || shown().length > 1) return curve(one, xs, ys, one.breaks);
    const top = range([errors])[1] || 1;
    const jumps = new Set(one.breaks);
    const parts = SCALE.map(() => '');
    for (let k = 1; k < xs.length; k += 1) {
      const place = Math.round((Math.max(errors[k - 1], errors[k]) / top) * (SCALE.length - 1));
      if (!jumps.has(k)) parts[place] += line([xs[k - 1], xs[k]], [ys[k - 1], ys[k]]);
    }
    const group = make('g', { class: 'curve painted' });
    parts.forEach((d, place) => {
      if (d) group.append(make('path', { d, stroke: `rgb(${SCALE[place].join(',')})` }));
    });
    return group;
  }

  /**
   * What paths look like in the legend: as they are drawn.
   * @type {Map<Report.Estimate, HTMLElement>}
   */
  const samples = new Map();

  /**
   * Return the colours of errors side by side.
   * @param {number} width
   * @param {number} [height]
   */
  const bar = (width, height = 3) =>
    make(
      'g',
      {},
      ...SCALE.map((colours, k) =>
        make('rect', { x: k * width, y: 5 - height / 2, width, height, fill: `rgb(${colours.join(',')})` }),
      ),
    );

  /** Say what the colours of a path mean, where they are errors. */
  function drawScale() {
    const place = part('scale');
    const one = shown()[0];
    place.hidden = !measured || shown().length !== 1;
    for (const [each, sample] of samples) {
      sample.replaceChildren(each === one && !place.hidden ? bar(26 / 9) : curve(each, [0, 26], [5, 5], []));
    }
    if (place.hidden) return;
    const svg = make('svg', { viewBox: '0 0 90 10', 'aria-hidden': 'true' }, bar(10, 10));
    place.replaceChildren('0', svg, `${figures(range([one.errors[state.kind]])[1], 3)}: ${errorName()}`);
  }

  /**
   * Return the point of an estimate that is nearest in time to where the pointer is.
   * @param {Report.Estimate} one
   * @param {number} time
   */
  function nearest(one, time) {
    let low = 0;
    let high = one.time.length - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (one.time[middle] < time) low = middle;
      else high = middle;
    }
    return time - one.time[low] < one.time[high] - time ? low : high;
  }

  /**
   * @param {HTMLElement} svg
   * @param {(one: Report.Estimate, k: number) => number[]} place
   */
  function mark(svg, place) {
    svg.querySelectorAll('.mark').forEach((node) => {
      node.remove();
    });
    if (state.at === null) return;
    for (const one of shown()) {
      const [cx, cy] = place(one, nearest(one, state.at));
      const dot = make('circle', { class: 'mark', cx, cy, r: 4.5 });
      dot.style.fill = colour(one);
      svg.append(dot);
    }
  }

  const NAMES = ['x', 'y', 'z'];
  const TURNS = new Map([
    ['ArrowLeft', [0.1, 0]],
    ['ArrowRight', [-0.1, 0]],
    ['ArrowUp', [0, 0.1]],
    ['ArrowDown', [0, -0.1]],
  ]);
  /**
   * Axes before the first drawing.
   * @type {Report.Scale}
   */
  const UNIT = { x: (value) => value, y: (value) => value, x0: 0, x1: 1, bottom: 0 };
  /** @type {Array<{svg: HTMLElement, a: number, b: number, scale: Report.Scale}>} */
  const paths = [];
  const parentOfPaths = part('paths');
  for (const [a, b] of [
    [0, 1],
    [0, 2],
    [1, 2],
  ]) {
    const name = NAMES[a] + NAMES[b];
    const svg = panel(parentOfPaths, `path-${name}`, name, `Trajectories in the ${name} plane, in metres`);
    paths.push({ svg, a, b, scale: UNIT });
  }
  const solid = panel(
    parentOfPaths,
    'path-3d',
    '3D',
    'Trajectories in three dimensions; arrow keys turn the view',
  );
  solid.closest('figure')?.classList.add('turn');
  solid.previousElementSibling?.append(' ', make('small', {}, 'drag, or arrow keys, to turn'));
  solid.setAttribute('tabindex', '0');

  function drawPaths() {
    const all = [data.reference, ...shown()];
    for (const one of paths) {
      const [across, up] = [one.a, one.b].map((axis) => range(all.map((each) => each.path[axis])));
      const [a, b] = [NAMES[one.a], NAMES[one.b]];
      one.scale = axes(one.svg, across, up, `${a} [m]`, `${b} [m]`, { equal: true });
      const { x, y } = one.scale;
      const d = line(
        data.reference.path[one.a].map(x),
        data.reference.path[one.b].map(y),
        data.reference.breaks,
      );
      one.svg.append(make('path', { class: 'truth', d }));
      for (const each of shown()) one.svg.append(way(each, each.path[one.a].map(x), each.path[one.b].map(y)));
    }
    drawSolid();
  }

  /**
   * Return the place that a point is seen at; drawSolid says from where.
   * @type {(p: number[]) => number[]}
   */
  let project = () => [0, 0];
  function drawSolid() {
    solid.replaceChildren();
    const all = [data.reference, ...shown()];
    const ranges = NAMES.map((_, axis) => range(all.map((one) => one.path[axis])));
    const middle = ranges.map(([low, high]) => (low + high) / 2);
    const radius = Math.hypot(...ranges.map(([low, high]) => high - low)) / 2 || 1;
    const [ca, sa, ce, se] = [
      Math.cos(state.azimuth),
      Math.sin(state.azimuth),
      Math.cos(state.elevation),
      Math.sin(state.elevation),
    ];
    const unit = Math.min(SIZE.width, SIZE.height) / 2 / radius;
    project = (p) => {
      const [x, y, z] = p.map((value, axis) => value - middle[axis]);
      const across = -sa * x + ca * y;
      const up = ce * z - se * (ca * x + sa * y);
      return [SIZE.width / 2 + unit * across, SIZE.height / 2 - unit * up];
    };
    /** @param {number} k */
    const corner = (k) => ranges.map((one, axis) => one[(k >> axis) & 1]);
    for (let k = 0; k < 8; k += 1) {
      for (const axis of [0, 1, 2]) {
        if ((k >> axis) & 1) continue;
        const [from, to] = [project(corner(k)), project(corner(k | (1 << axis)))];
        solid.append(make('line', { class: 'rule', x1: from[0], y1: from[1], x2: to[0], y2: to[1] }));
      }
    }
    NAMES.forEach((name, axis) => {
      const [x, y] = project(corner(1 << axis));
      const length = figures(ranges[axis][1] - ranges[axis][0], 3);
      solid.append(
        make(
          'text',
          {
            x: Math.min(Math.max(x, 40), SIZE.width - 40),
            y: Math.min(Math.max(y + 4, 14), SIZE.height - 6),
            'text-anchor': 'middle',
          },
          `${name}: ${length} m`,
        ),
      );
    });
    /** @param {{path: number[][]}} one */
    const points = (one) =>
      one.path[0].map((_, k) => project([one.path[0][k], one.path[1][k], one.path[2][k]]));
    const truth = points(data.reference);
    solid.append(
      make('path', {
        class: 'truth',
        d: line(
          truth.map((p) => p[0]),
          truth.map((p) => p[1]),
          data.reference.breaks,
        ),
      }),
    );
    for (const one of shown()) {
      const found = points(one);
      solid.append(
        way(
          one,
          found.map((p) => p[0]),
          found.map((p) => p[1]),
        ),
      );
    }
  }

  /**
   * @param {number} azimuth
   * @param {number} elevation
   */
  function turn(azimuth, elevation) {
    state.azimuth += azimuth;
    state.elevation = Math.max(-Math.PI / 2, Math.min(Math.PI / 2, state.elevation + elevation));
    drawSolid();
    drawMarks();
  }
  solid.addEventListener('pointerdown', (event) => solid.setPointerCapture(event.pointerId));
  solid.addEventListener('pointermove', (event) => {
    if (event.buttons) turn(-event.movementX / 150, event.movementY / 150);
  });
  solid.addEventListener('keydown', (event) => {
    const step = TURNS.get(event.key);
    if (!step) return;
    event.preventDefault();
    turn(step[0], step[1]);
  });

  const parentOfErrors = part('errors');
  /** @type {Array<{key: 'time'|'distance', name: string, svg: HTMLElement, scale: Report.Scale}>} */
  const curves = [
    {
      key: 'time',
      name: 'time since the ground truth began [s]',
      svg: panel(parentOfErrors, 'error-time', 'Over time', 'Error over time'),
      scale: UNIT,
    },
    {
      key: 'distance',
      name: 'ground-truth path [m]',
      svg: panel(
        parentOfErrors,
        'error-distance',
        'Over the path',
        'Error over the path of the ground truth',
      ),
      scale: UNIT,
    },
  ];
  const bars = panel(parentOfErrors, 'histogram', 'Histogram', 'Share of poses by error');
  const boxes = panel(
    parentOfErrors,
    'boxes',
    'Box plot',
    'Quartiles, whiskers to 1.5 times their distance, and largest error of each estimate',
  );
  const errorName = () => `${data.kinds[state.kind].name} [${data.kinds[state.kind].unit}]`;
  for (const { svg } of curves) {
    const thinned = data.estimates.some((one) => one.thinned);
    if (thinned) svg.previousElementSibling?.append(' ', make('small', {}, 'largest error of each stretch'));
  }

  function drawErrors() {
    const top = range(shown().map((one) => one.errors[state.kind]))[1] * 1.05;
    for (const one of curves) {
      const scale = axes(
        one.svg,
        range(shown().map((each) => each[one.key])),
        [0, top],
        one.name,
        errorName(),
      );
      one.scale = scale;
      for (const each of shown()) {
        one.svg.append(
          curve(each, each[one.key].map(scale.x), each.errors[state.kind].map(scale.y), each.breaks),
        );
      }
    }
    drawHistogram();
    drawBoxes();
  }

  function drawHistogram() {
    const edges = data.edges[state.kind];
    const shares = shown().map((one) => one.histogram[state.kind].map((count) => (100 * count) / one.poses));
    const scale = axes(
      bars,
      [0, edges[edges.length - 1]],
      [0, range(shares)[1] * 1.05],
      errorName(),
      'poses [%]',
    );
    shown().forEach((one, k) => {
      const ends = edges.map((edge) => scale.x(edge).toFixed(1));
      const steps = shares[k].map(
        (share, bin) => `L${ends[bin]} ${scale.y(share).toFixed(1)}H${ends[bin + 1]}`,
      );
      const d = `M${scale.x(0)} ${scale.bottom}${steps.join('')}V${scale.bottom}`;
      const node = make('path', { class: 'curve', d, 'stroke-dasharray': dash(one) });
      node.style.stroke = colour(one);
      node.style.fill = colour(one);
      node.style.fillOpacity = '0.12';
      bars.append(node);
    });
  }

  function drawBoxes() {
    const list = shown();
    const top = range(list.map((one) => [one.box[state.kind].max]))[1] * 1.05;
    const scale = axes(boxes, [0, list.length || 1], [0, top], '', errorName(), { xTicks: false });
    const letters = Math.max(4, Math.floor((SIZE.width - SIZE.left) / Math.max(list.length, 1) / 7));
    list.forEach((one, k) => {
      const box = one.box[state.kind];
      const [middle, half] = [scale.x(k + 0.5), Math.min(34, (scale.x(1) - scale.x(0)) * 0.3)];
      const y = Object.fromEntries(Object.entries(box).map(([name, value]) => [name, scale.y(value)]));
      const [left, right] = [middle - half, middle + half];
      const whiskers = `M${middle} ${y.low}V${y.q1}M${middle} ${y.q3}V${y.high}`;
      const caps = [y.low, y.high].map((end) => `M${middle - half / 2} ${end}h${half}`).join('');
      const body = `M${left} ${y.q1}H${right}V${y.q3}H${left}ZM${left} ${y.median}H${right}`;
      const d = `${whiskers}${caps}${body}`;
      const quartiles = `${figures(box.q1)} to ${figures(box.q3)}`;
      const told = `median ${figures(box.median)}, quartiles ${quartiles}, largest ${figures(box.max)}`;
      const outline = make('path', { class: 'box', d });
      outline.style.stroke = colour(one);
      const group = make('g', {}, make('title', {}, `${one.name}: ${told}`), outline);
      if (box.max > box.high) {
        const dot = make('circle', { cx: middle, cy: y.max, r: 3 });
        dot.style.fill = colour(one);
        group.append(dot);
      }
      const short = one.name.length > letters ? `…${one.name.slice(1 - letters)}` : one.name;
      group.append(make('text', { x: middle, y: scale.bottom + 16, 'text-anchor': 'middle' }, short));
      boxes.append(group);
    });
  }

  function drawMarks() {
    for (const one of paths)
      mark(one.svg, (each, k) => [one.scale.x(each.path[one.a][k]), one.scale.y(each.path[one.b][k])]);
    mark(solid, (each, k) => project([each.path[0][k], each.path[1][k], each.path[2][k]]));
    for (const one of curves)
      mark(one.svg, (each, k) => [one.scale.x(each[one.key][k]), one.scale.y(each.errors[state.kind][k])]);
    const { at } = state;
    if (at === null) return;
    const unit = data.kinds[state.kind].unit;
    const words = shown().map(
      (one) => `${one.name} ${figures(one.errors[state.kind][nearest(one, at)])} ${unit}`,
    );
    part('readout').textContent = `${at.toFixed(2)} s: ${words.join(', ')}`;
  }

  for (const one of curves) {
    one.svg.addEventListener('pointermove', (event) => {
      if (!shown().length) return;
      const place = one.svg.getBoundingClientRect();
      const across = ((event.clientX - place.left) / place.width) * SIZE.width;
      const inner = SIZE.width - SIZE.left - SIZE.right;
      const value = one.scale.x0 + ((across - SIZE.left) / inner) * (one.scale.x1 - one.scale.x0);
      const first = shown()[0];
      const k = one.key === 'time' ? null : first.distance.findIndex((distance) => distance >= value);
      state.at = k === null ? value : first.time[k < 0 ? first.time.length - 1 : k];
      drawMarks();
    });
  }

  function draw() {
    drawPaths();
    drawScale();
    if (!measured) return;
    drawErrors();
    drawStatistics();
    drawMarks();
  }

  function drawStatistics() {
    const names = ['rmse', 'mean', 'median', 'std', 'min', 'max'];
    const rpe = state.kind === 'position';
    const heads = ['estimate', 'outcome', 'coverage', 'poses', ...names, 'RPE rmse', 'pairs', 'scale'];
    const table = make(
      'table',
      {},
      make('caption', {}, `${errorName()}; the RPE is over 1 m, from fewer than 30 pairs in brackets`),
    );
    table.append(
      make('thead', {}, make('tr', {}, ...heads.map((head) => make('th', { scope: 'col' }, head)))),
    );
    const body = make('tbody');
    for (const one of data.estimates) {
      const found = one.statistics[state.kind] || {};
      const relative = one.rpe[0] || { count: 0, ranked: true };
      const values = rpe ? relative : relative.rotationDeg || {};
      const error = figures(values.rmse);
      const cells = [
        one.outcome,
        `${(100 * one.coverage).toFixed(1)} %`,
        one.poses,
        ...names.map((name) => figures(found[name])),
        relative.ranked ? error : `(${error})`,
        relative.count,
        figures(one.scale),
      ];
      body.append(
        make(
          'tr',
          {},
          make('th', { scope: 'row' }, one.name),
          ...cells.map((cell) => make('td', {}, String(cell))),
        ),
      );
    }
    table.append(body);
    const remarks = data.estimates.flatMap((one) =>
      [one.message, ...one.notes].filter(Boolean).map((text) => make('li', {}, `${one.name}: ${text}`)),
    );
    part('statistics').replaceChildren(table, ...(remarks.length ? [make('ul', {}, ...remarks)] : []));
  }

  const legend = part('legend');
  const truth = make(
    'span',
    {},
    make(
      'svg',
      { viewBox: '0 0 26 10', 'aria-hidden': 'true' },
      make('path', { class: 'truth', d: 'M0 5H26' }),
    ),
    data.reference.name,
  );
  legend.append(truth);
  for (const one of data.estimates) {
    const sample = make('svg', { viewBox: '0 0 26 10', 'aria-hidden': 'true' });
    const button = make('button', { type: 'button', 'aria-pressed': 'true' }, sample, one.name);
    samples.set(one, sample);
    if (!one.time.length) button.setAttribute('disabled', '');
    button.addEventListener('click', () => {
      if (!state.hidden.delete(one)) state.hidden.add(one);
      button.setAttribute('aria-pressed', String(!state.hidden.has(one)));
      draw();
    });
    legend.append(button);
  }
  const kinds = part('kinds');
  for (const [kind, { name }] of Object.entries(data.kinds)) {
    const button = make('button', { type: 'button', 'aria-pressed': String(kind === state.kind) }, name);
    button.addEventListener('click', () => {
      state.kind = kind;
      for (const other of kinds.children) other.setAttribute('aria-pressed', String(other === button));
      draw();
    });
    kinds.append(button);
  }
  draw();
  document.body.dataset.ready = 'true';
})();
