'use strict';
// Draws the page from the block of JSON written by cdcrctl. Lengths are in millimetres, times in seconds.

const data = JSON.parse(document.getElementById('data').textContent);
const curves = data.curves;
const times = curves.t_s;
const end_s = Math.max(data.duration_s, 1e-3);
const safe_mm = data.safe_distance_mm;

// ---- the document

function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.append(...children);
  return made;
}

function drawn(name, attributes = {}, text = '') {
  const made = document.createElementNS('http://www.w3.org/2000/svg', name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  made.textContent = text;
  return made;
}

function number(value, digits = 4) {
  if (value === null || value === undefined || !Number.isFinite(value)) return '–';
  if (value === 0) return '0';
  const size = Math.abs(value);
  if (size < 1e-3 || size >= 1e6) return value.toExponential(digits - 2).replace('e+', 'e');
  return String(Number(value.toPrecision(digits)));
}

// A percentile of a histogram with bins from 1 µs to 1 s.
function percentile(us) {
  if (us <= 1) return '< 1';
  return us > 1e6 ? '> 1e6' : number(us, 3);
}

const main = document.querySelector('main');
const contents = element('nav', { 'aria-label': 'Contents' });

function section(id, title, ...children) {
  contents.append(element('a', { href: '#' + id }, title));
  const made = element('section', { id }, element('h2', {}, title), ...children);
  main.append(made);
  return made;
}

function key(colour, name, kind = '') {
  const mark = element('i', { class: kind, style: `border-color: ${colour}` });
  const value = element('span');
  const made = element('span', { class: 'key' }, mark, name, value);
  return { made, value };
}

// ---- the time shown in all panels

const watchers = [];
let now_s = 0;

function go(time_s) {
  now_s = Math.min(Math.max(time_s, 0), end_s);
  for (const watch of watchers) watch();
}

// Whether columns are so far apart that interpolation between them does not show the robot.
const sparse = curves.width_s > 0.1;

// Index of the column at or before a time, and the fraction towards the next, 0 to 1.
function at(time_s) {
  let [low, high] = [0, times.length - 1];
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (times[middle] <= time_s) low = middle; else high = middle - 1;
  }
  const next = Math.min(low + 1, times.length - 1);
  const span = times[next] - times[low];
  return [low, next, span > 0 && !sparse ? Math.min(Math.max((time_s - times[low]) / span, 0), 1) : 0];
}

function between(list, time_s) {
  const [from, to, share] = at(time_s);
  return list[from].map((value, i) => {
    const next = list[to][i];
    return value === null || next === null ? value : value + share * (next - value);
  });
}

// ---- axes

function step(span, count) {
  const raw = span / count;
  const power = 10 ** Math.floor(Math.log10(raw));
  return [1, 2, 5, 10].map((part) => part * power).find((size) => size >= raw * 0.999);
}

function ticks(low, high, count) {
  const size = step(high - low, count);
  const made = [];
  for (let k = Math.ceil(low / size - 1e-9); k * size <= high + 1e-9 * size; k++) made.push(k * size);
  const digits = Math.max(0, -Math.floor(Math.log10(size) + 1e-9));
  return made.map((value) => [value, digits > 6 ? number(value, 3) : value.toFixed(digits).replace(/^-(0\.?0*)$/, '$1')]);
}

function decades(low, high, count) {
  const [first, last] = [Math.ceil(Math.log10(low) - 1e-9), Math.floor(Math.log10(high) + 1e-9)];
  const every = Math.max(1, Math.ceil((last - first + 1) / count));
  const made = [];
  for (let k = first; k <= last; k += every) {
    const plain = k >= -3 && k <= 5;
    made.push([10 ** k, plain ? String(Number((10 ** k).toPrecision(1))) : `1e${k}`]);
  }
  return made;
}

const LEFT = 58;
const RIGHT = 14;
let clips = 0;

// A panel with grid and axes; `x`, `y`: {low, high, ticks, log}. Returns the drawing and its scales.
function panel(width, height, x, y, x_label) {
  const svg = drawn('svg', { viewBox: `0 0 ${width} ${height}`, height, role: 'img' });
  const box = { left: LEFT, right: width - RIGHT, top: 8, bottom: height - (x_label ? 36 : 20) };
  const scale = (axis, from, to) => (value) => {
    const [low, high, here] = axis.log ? [axis.low, axis.high, value].map(Math.log10) : [axis.low, axis.high, value];
    return from + (to - from) * (here - low) / (high - low);
  };
  const [sx, sy] = [scale(x, box.left, box.right), scale(y, box.bottom, box.top)];
  svg.append(drawn('rect', { class: 'frame', x: box.left, y: box.top, width: box.right - box.left, height: box.bottom - box.top }));
  for (const [value, text] of x.ticks) {
    svg.append(drawn('line', { class: 'grid', x1: sx(value), x2: sx(value), y1: box.top, y2: box.bottom }));
    svg.append(drawn('text', { x: sx(value), y: box.bottom + 15, 'text-anchor': 'middle' }, text));
  }
  for (const [value, text] of y.ticks) {
    svg.append(drawn('line', { class: 'grid', x1: box.left, x2: box.right, y1: sy(value), y2: sy(value) }));
    svg.append(drawn('text', { x: box.left - 6, y: sy(value) + 4, 'text-anchor': 'end' }, text));
  }
  // The content is clipped at the edges.
  const clip = `clip-${clips++}`;
  const mask = drawn('clipPath', { id: clip });
  mask.append(drawn('rect', { x: box.left, y: box.top, width: box.right - box.left, height: box.bottom - box.top }));
  const inside = drawn('g', { 'clip-path': `url(#${clip})` });
  svg.append(mask, inside);
  if (x_label) svg.append(drawn('text', { x: (box.left + box.right) / 2, y: height - 4, 'text-anchor': 'middle' }, x_label));
  return { svg, inside, box, sx, sy };
}

// In the next frame, because changing sizes inside the observer is an error.
function resized(holder, act) {
  new ResizeObserver(() => requestAnimationFrame(act)).observe(holder);
}

// Functions that draw for the present width: called once when the page is complete, and on every resize.
const fits = [];

function fitted(holder, draw) {
  let last = 0;
  const fit = () => {
    const width = Math.max(280, Math.round(holder.clientWidth));
    if (width !== last) {
      last = width;
      holder.replaceChildren(draw(width));
      go(now_s);
    }
  };
  fits.push(fit);
  resized(holder, fit);
  return holder;
}

function time_axis(width) {
  return { low: 0, high: end_s, ticks: ticks(0, end_s, Math.min(10, width / 80)) };
}

// ---- curves over time

const ends = (name) => curves.series[name] || [[]];
const low_of = (name) => ends(name)[0];
const high_of = (name) => ends(name)[ends(name).length - 1];

function extent(names) {
  let [low, high] = [Infinity, -Infinity];
  for (const name of names) {
    for (const value of low_of(name)) if (value !== null && value < low) low = value;
    for (const value of high_of(name)) if (value !== null && value > high) high = value;
  }
  return [low, high];
}

// The path of a curve, with the minimum and maximum of the columns in one pixel.
function curve(name, sx, sy, floor) {
  const [low, high] = [low_of(name), high_of(name)];
  const parts = [];
  let pixel = null;
  let last_s = -Infinity;
  const flush = () => {
    if (!pixel) return;
    const [x, a, b] = [pixel.x.toFixed(1), sy(pixel.low).toFixed(1), sy(pixel.high).toFixed(1)];
    parts.push(`${pixel.begins ? 'M' : 'L'}${x} ${a}`);
    if (a !== b) parts.push(`L${x} ${b}`);
    pixel = null;
  };
  for (let i = 0; i < times.length; i++) {
    if (high[i] === null || high[i] === undefined) {
      flush();
      last_s = -Infinity;
      continue;
    }
    const x = sx(times[i]);
    const [bottom, top] = [Math.max(low[i], floor), Math.max(high[i], floor)];
    const begins = times[i] - last_s > 4 * curves.width_s;
    last_s = times[i];
    if (pixel && !begins && Math.floor(x) === Math.floor(pixel.x)) {
      pixel.low = Math.min(pixel.low, bottom);
      pixel.high = Math.max(pixel.high, top);
    } else {
      flush();
      pixel = { x, low: bottom, high: top, begins };
    }
  }
  flush();
  if (parts.length === 1) parts.push(parts[0].replace('M', 'L') + 'h1');
  return parts.join('');
}

const COLOURS = ['var(--c1)', 'var(--c2)', 'var(--c3)', 'var(--c4)', 'var(--c5)', 'var(--c6)'];

// A chart of series [{name, label}] with limits [{value, label}]; `range` is that of the y axis.
function chart({ title, unit, series, limits = [], range, log = false, factor = 1, height = 190, less = 0 }) {
  const keys = series.map(({ label }, i) => key(COLOURS[i], label));
  const caption = element('figcaption', {}, element('b', {}, `${title} [${unit}]`), ...keys.map(({ made }) => made));
  const [low, high] = range;
  const holder = fitted(element('div'), (width) => {
    const y_ticks = log ? decades(low, high, 5) : ticks(low, high, height / 40);
    const { svg, inside, box, sx, sy } = panel(width, height, time_axis(width), { low, high, log, ticks: y_ticks }, 'time [s]');
    const value = (shown) => sy(factor * shown - less);
    svg.setAttribute('aria-label', `${title} over time`);
    series.forEach(({ name }, i) => {
      // Smaller values are drawn outside of the chart.
      const floor = log ? 0.5 * low / factor : -Infinity;
      inside.append(drawn('path', { d: curve(name, sx, value, floor), style: `stroke: ${COLOURS[i]}` }));
    });
    for (const limit of limits) {
      if (limit.value < low || limit.value > high) continue;
      const y = sy(limit.value);
      svg.append(drawn('line', { class: 'limit', x1: box.left, x2: box.right, y1: y, y2: y }));
      const below = y < box.top + 18;
      svg.append(drawn('text', { class: 'limit-text', x: box.right - 4, y: below ? y + 14 : y - 5, 'text-anchor': 'end' }, limit.label));
    }
    tells_time(svg, box, sx);
    return svg;
  });
  watchers.push(() => {
    holder.firstChild?.cursor();
    const [here] = at(now_s);
    series.forEach(({ name }, i) => {
      const value = high_of(name)[here];
      keys[i].value.textContent = value === null || value === undefined ? '' : ` ${number(factor * value - less, 3)}`;
    });
  });
  return element('figure', {}, caption, holder);
}

// Shows the present time as a line in a panel, and lets clicks select another.
function tells_time(svg, box, sx) {
  const cursor = drawn('line', { class: 'now', y1: box.top, y2: box.bottom });
  svg.append(cursor);
  svg.cursor = () => {
    cursor.setAttribute('x1', sx(now_s));
    cursor.setAttribute('x2', sx(now_s));
  };
  picks_time(svg, box);
}

// Selects the time by a click or a drag in a panel.
function picks_time(svg, box) {
  const choose = (event) => {
    const place = svg.getBoundingClientRect();
    const x = (event.clientX - place.left) * svg.viewBox.baseVal.width / place.width;
    go(end_s * (x - box.left) / (box.right - box.left));
  };
  svg.addEventListener('pointerdown', choose);
  svg.addEventListener('pointermove', (event) => { if (event.buttons & 1) choose(event); });
}

function padded([low, high], least) {
  if (!(low <= high)) return [-least, least];
  const room = Math.max(0.06 * (high - low), 0.5 * (least - (high - low)), 1e-12);
  return [low - room, high + room];
}

// ---- summary

function counted(counts) {
  const parts = Object.entries(counts).map(([name, count]) => `${count} ${name}`);
  return parts.length ? parts.join(', ') : 'none';
}

function summary() {
  const list = element('dl');
  const add = (name, value, bad = false) =>
    list.append(element('div', {}, element('dt', {}, name), element('dd', bad ? { class: 'bad' } : {}, value)));
  const lengths = data.sections.map((part) => number(1e3 * part.length_m)).join(' + ');
  const kind = { simulated: ' (simulated)', driver: ' (behind a driver)' }[data.link] || '';
  add('robot', `${data.robot || 'not named'}${kind}: ${data.sections.length} section${data.sections.length === 1 ? '' : 's'}, ${lengths} mm`);
  add('duration', `${number(data.duration_s, 5)} s, ${data.cycles} cycles of ${number(data.period_ms)} ms`);
  add('cycles by mode', counted(data.modes));
  const missed = Object.values(data.deadline_misses).reduce((sum, count) => sum + count, 0);
  add(`deadline misses (deadline ${number(data.deadline_ms)} ms)`, missed ? `${missed} (${counted(data.deadline_misses)})` : 'none', missed > 0);
  add('late starts, skipped periods', `${data.late_starts}, ${data.skipped_periods}`);
  const error = data.error_mm;
  const unused = data.unused_percent;
  add(`tip error${data.is_by_model ? ' by the model' : ''} while tracking, after the approach`, error ? `mean ${number(error[0], 3)}, max ${number(error[1], 3)}, final ${number(error[2], 3)} mm` : 'nothing was tracked');
  const measured = data.measured_mm;
  if (measured) add('the same as measured, noise included', `mean ${number(measured[0], 3)}, max ${number(measured[1], 3)} mm`);
  if (data.strays) add('stray measurements of the tip, refused and left out', `${data.strays}`);
  if (unused) add('measured tip not in use', `${number(unused, 3)} % of that time`, true);
  const least = data.least_clearance;
  add(`least clearance (safe distance ${number(safe_mm)} mm)`, least ? `${number(least.mm)} mm at ${number(least.t_s)} s` : 'no obstacle', least && least.mm < safe_mm - 0.01);
  const response = data.latencies.response;
  add('response time', `median ${percentile(response.p50_us)}, 99 % ${percentile(response.p99_us)}, max ${number(response.max_us, 3)} µs`);
  add('recorded from', data.daemon ? `cdcrd ${data.daemon}` : 'not named');
  const title = `Recording ${data.file}`;
  document.title = title;
  main.append(element('h1', {}, title), element('p', { class: 'quiet' }, `Made by ${data.made_by}.${data.is_cut ? ' The recording is cut: what is whole is shown.' : ''}`), contents);
  section('summary', 'Summary', list);
}

// ---- the robot in 3-D

// The backbone: points with their frames for each section, base first.
function backbone(bend_rad) {
  let frame = { p: [0, 0, 0], r: [[1, 0, 0], [0, 1, 0], [0, 0, 1]] };
  const turn = (r, v) => r.map((row) => row[0] * v[0] + row[1] * v[1] + row[2] * v[2]);
  const times_matrix = (a, b) => a.map((row) => [0, 1, 2].map((j) => row[0] * b[0][j] + row[1] * b[1][j] + row[2] * b[2][j]));
  return data.sections.map((part, j) => {
    const [u, v] = [bend_rad[2 * j], bend_rad[2 * j + 1]];
    const theta = Math.hypot(u, v);
    const [cos_phi, sin_phi] = theta > 1e-9 ? [u / theta, v / theta] : [1, 0];
    const length_mm = 1e3 * part.length_m;
    const base = frame;
    const points = [];
    for (let k = 0; k <= 16; k++) {
      const angle = theta * k / 16;
      const [c, s] = [Math.cos(angle), Math.sin(angle)];
      const along_mm = length_mm * k / 16;
      const side = theta > 1e-9 ? length_mm * (1 - c) / theta : 0;
      const up = theta > 1e-9 ? length_mm * s / theta : along_mm;
      const local = turn(base.r, [side * cos_phi, side * sin_phi, up]);
      const bent = [
        [1 + (c - 1) * cos_phi * cos_phi, (c - 1) * cos_phi * sin_phi, s * cos_phi],
        [(c - 1) * cos_phi * sin_phi, 1 + (c - 1) * sin_phi * sin_phi, s * sin_phi],
        [-s * cos_phi, -s * sin_phi, c],
      ];
      points.push({ p: base.p.map((m, i) => m + local[i]), r: times_matrix(base.r, bent) });
    }
    frame = points[16];
    return points;
  });
}

// Obstacles at a time, interpolated to the next scene if they are in it, too.
function solids(time_s) {
  const scenes = data.scenes;
  let k = scenes.length - 1;
  while (k > 0 && scenes[k].t_s > time_s) k--;
  if (k < 0) return [];
  const next = scenes[k + 1];
  return scenes[k].solids.map((solid) => {
    const other = next && next.solids.find((one) => one[0] === solid[0]);
    const share = other ? Math.min(Math.max((time_s - scenes[k].t_s) / (next.t_s - scenes[k].t_s), 0), 1) : 0;
    const here = other ? solid.map((value, i) => value + share * (other[i] - value)) : solid;
    const [, radius, ...ends_mm] = here;
    const start = ends_mm.slice(0, 3);
    // A sphere is drawn as a very short capsule, because one of zero length is not drawn.
    return { radius, start, end: ends_mm.length === 6 ? ends_mm.slice(3) : [start[0], start[1], start[2] + 0.01] };
  });
}

// Distance between the surfaces of an obstacle and of the body.
function nearness(solid, robot) {
  const axis = solid.end.map((value, i) => value - solid.start[i]);
  const square = axis.reduce((sum, value) => sum + value * value, 0);
  let least = Infinity;
  robot.forEach((points, j) => points.forEach(({ p }) => {
    const to = p.map((value, i) => value - solid.start[i]);
    const along = to.reduce((sum, value, i) => sum + value * axis[i], 0);
    const share = square > 0 ? Math.min(Math.max(along / square, 0), 1) : 0;
    const apart = Math.hypot(...to.map((value, i) => value - share * axis[i]));
    least = Math.min(least, apart - solid.radius - 1e3 * data.sections[j].body_radius_m);
  }));
  return least;
}

// The references, one after the other, with gaps between them.
const references = [[]];
for (const point of curves.reference_mm) {
  if (point[0] !== null) references[references.length - 1].push(point);
  else if (references[references.length - 1].length) references.push([]);
}

const length_mm = 1e3 * data.sections.reduce((sum, part) => sum + part.length_m, 0);

function scene3d() {
  const canvas = element('canvas', { 'aria-label': 'The robot, which can be turned', tabindex: 0 });
  const view = { azimuth: -0.9, elevation: 0.32, zoom: 1 };
  let far = 0.2 * length_mm;
  for (const point of [...curves.tip_mm, ...curves.reference_mm]) if (point[0] !== null) far = Math.max(far, Math.hypot(point[0], point[1]));
  far = Math.min(far, 1.1 * length_mm);
  const radius = Math.hypot(far, 0.58 * length_mm);
  const middle = [0, 0, 0.5 * length_mm];
  const paint = canvas.getContext('2d');
  const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

  function draw() {
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    const ratio = window.devicePixelRatio || 1;
    if (!width) return;
    canvas.width = width * ratio;
    canvas.height = height * ratio;
    paint.setTransform(ratio, 0, 0, ratio, 0, 0);
    paint.lineCap = paint.lineJoin = 'round';
    const scale = view.zoom * Math.min(0.46 * width / (1.1 * far), 0.84 * height / (length_mm + 0.7 * far));
    const [ca, sa, ce, se] = [Math.cos(view.azimuth), Math.sin(view.azimuth), Math.cos(view.elevation), Math.sin(view.elevation)];
    // Right, up and towards the viewer.
    const project = (point) => {
      const [x, y, z] = point.map((value, i) => value - middle[i]);
      const [right, away] = [ca * x + sa * y, -sa * x + ca * y];
      return [width / 2 + scale * right, height / 2 - scale * (ce * z + se * away), ce * -away + se * z];
    };
    const line = (points, style, thick, dash = []) => {
      paint.beginPath();
      for (const point of points) {
        const [x, y] = project(point);
        paint.lineTo(x, y);
      }
      paint.setLineDash(dash);
      paint.strokeStyle = style;
      paint.lineWidth = thick;
      paint.stroke();
      paint.setLineDash([]);
    };
    floor(line, project);
    for (const reference of references) line(reference, colour('--reference'), 1.3, [5, 4]);
    const bend_rad = between(curves.bend_rad, now_s);
    const robot = backbone(bend_rad);
    const items = [];
    robot.forEach((points, j) => body(items, points, data.sections[j], [colour('--c1'), colour('--c3'), colour('--c4')][j % 3], { project, line, scale }));
    for (const solid of solids(now_s)) {
      const style = colour(nearness(solid, robot) < safe_mm ? '--bad' : '--c5');
      const [start, end] = [project(solid.start), project(solid.end)];
      items.push([(start[2] + end[2]) / 2, () => {
        paint.globalAlpha = 0.75;
        line([solid.start, solid.end], style, Math.max(2 * solid.radius * scale, 3));
        paint.globalAlpha = 1;
      }]);
    }
    items.sort((a, b) => a[0] - b[0]).forEach(([, show]) => show());
    const [here] = at(now_s);
    const begin = at(now_s - 3)[0];
    line(curves.tip_mm.slice(begin, here + 1), colour('--c2'), 2);
    const dot = (point, style) => {
      const [x, y] = project(point);
      paint.beginPath();
      paint.arc(x, y, 4.5, 0, 7);
      paint.fillStyle = style;
      paint.fill();
    };
    const wanted = curves.reference_mm[here];
    if (wanted[0] !== null) dot(wanted, colour('--reference'));
    dot(between(curves.tip_mm, now_s), colour('--c2'));
    bar(scale, height);
  }

  function floor(line, project) {
    const size = step(2 * radius, 8);
    const count = Math.ceil(0.7 * radius / size);
    for (let k = -count; k <= count; k++) {
      line([[k * size, -count * size, 0], [k * size, count * size, 0]], colour('--rule'), 1);
      line([[-count * size, k * size, 0], [count * size, k * size, 0]], colour('--rule'), 1);
    }
    paint.font = '13px system-ui, sans-serif';
    ['x', 'y', 'z'].forEach((name, i) => {
      const tip = [0, 0, 0];
      tip[i] = i === 2 ? 0.22 * radius : 0.3 * radius;
      line([[0, 0, 0], tip], colour('--quiet'), 1.5);
      const [x, y] = project(tip.map((value) => 1.12 * value));
      paint.fillStyle = colour('--quiet');
      paint.fillText(name, x - 4, y + 4);
    });
  }

  // A scale bar of a round length.
  function bar(scale, height) {
    const size = step(120 / scale, 1) / 2;
    paint.strokeStyle = paint.fillStyle = colour('--quiet');
    paint.lineWidth = 2;
    paint.beginPath();
    paint.moveTo(16, height - 16);
    paint.lineTo(16 + size * scale, height - 16);
    paint.stroke();
    paint.fillText(`${number(size)} mm`, 16, height - 24);
  }

  // A section: its body, the discs that guide the cables, and the cables.
  function body(items, points, part, style, { project, line, scale }) {
    const [thick, ring] = [2e3 * part.body_radius_m * scale, 1e3 * part.cable_radius_m];
    const around = ({ p, r }, angle, size) => p.map((value, i) => value + size * (r[i][0] * Math.cos(angle) + r[i][1] * Math.sin(angle)));
    for (let k = 0; k < points.length - 1; k++) {
      const pair = [points[k].p, points[k + 1].p];
      items.push([(project(pair[0])[2] + project(pair[1])[2]) / 2, () => line(pair, style, Math.max(thick, 3))]);
    }
    const edge = colour('--body');
    for (let cable = 0; cable < 3; cable++) {
      const angle = part.cable_offset_rad + cable * 2 * Math.PI / 3;
      const way = points.map((point) => around(point, angle, ring));
      for (let k = 0; k < way.length - 1; k++) items.push([project(way[k])[2] - 1e-3, () => line([way[k], way[k + 1]], edge, 1)]);
    }
    for (let k = 4; k < points.length; k += 4) {
      const rim = Array.from({ length: 25 }, (_, i) => around(points[k], i * Math.PI / 12, Math.max(1.25 * ring, 1.2e3 * part.body_radius_m)));
      const wide = k === points.length - 1 ? 3 : 1.6;
      for (let i = 0; i < 24; i++) items.push([project(rim[i])[2], () => line([rim[i], rim[i + 1]], edge, wide)]);
    }
  }

  const turn = (event) => {
    if (!(event.buttons & 1)) return;
    view.azimuth -= 0.01 * event.movementX;
    view.elevation = Math.min(Math.max(view.elevation + 0.01 * event.movementY, -1.57), 1.57);
    draw();
  };
  canvas.addEventListener('pointerdown', (event) => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener('pointermove', turn);
  canvas.addEventListener('wheel', (event) => {
    event.preventDefault();
    view.zoom = Math.min(Math.max(view.zoom * Math.exp(-0.001 * event.deltaY), 0.3), 20);
    draw();
  }, { passive: false });
  canvas.addEventListener('keydown', (event) => {
    const turns = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[event.key];
    if (!turns) return;
    event.preventDefault();
    view.azimuth += turns[0];
    view.elevation = Math.min(Math.max(view.elevation + turns[1], -1.57), 1.57);
    draw();
  });
  resized(canvas, draw);
  matchMedia('(prefers-color-scheme: dark)').addEventListener('change', draw);
  watchers.push(draw);
  const caption = element('figcaption', {},
    ...[['var(--c2)', 'tip, last 3 s'], ['var(--reference)', 'reference', 'dashed'], ['var(--c5)', 'obstacle'], ['var(--bad)', 'obstacle within the safe distance']]
      .map(([style, name, kind]) => key(style, name, kind).made),
    element('span', { class: 'quiet' }, 'Drag to turn, wheel to zoom.'));
  return element('figure', {}, caption, canvas);
}

function player() {
  const button = element('button', { type: 'button' }, 'Play');
  const slider = element('input', { type: 'range', min: 0, max: end_s, step: 'any', 'aria-label': 'Time' });
  const speed = element('select', { 'aria-label': 'Speed' });
  for (const times_real of [0.1, 0.25, 0.5, 1, 2, 5, 20]) speed.append(element('option', { value: times_real, ...(times_real === 1 ? { selected: '' } : {}) }, `${times_real} ×`));
  const shown = element('output');
  let last_ms = null;
  const frame = (time_ms) => {
    if (last_ms === null) return;
    const passed_s = (time_ms - last_ms) * 1e-3 * Number(speed.value);
    last_ms = time_ms;
    go(now_s + Math.max(passed_s, 0));
    if (now_s >= end_s) pause(); else requestAnimationFrame(frame);
  };
  const pause = () => {
    last_ms = null;
    button.textContent = 'Play';
  };
  button.addEventListener('click', () => {
    if (last_ms !== null) return pause();
    if (now_s >= end_s) go(0);
    last_ms = performance.now();
    button.textContent = 'Pause';
    requestAnimationFrame(frame);
  });
  slider.addEventListener('input', () => go(Number(slider.value)));
  watchers.push(() => {
    slider.value = now_s;
    const mode = data.mode_names[curves.mode[at(now_s)[0]]] || '';
    shown.textContent = `${now_s.toFixed(2)} s, ${mode}`;
  });
  return element('div', { class: 'player' }, button, slider, shown, speed);
}

// ---- path

const VIEWS = [['from the side', 0, 2], ['from the front', 1, 2], ['from above', 0, 1]];

// Bounds of the path on each axis, and of the obstacles that a view would cut at its edges, as far as the robot is long; and half of the largest
// width, the one scale of all views.
function path_window() {
  const all = curves.tip_mm.concat(...references);
  const bounds = [0, 1, 2].map((i) => all.reduce(([low, high], point) => [Math.min(low, point[i]), Math.max(high, point[i])], [Infinity, -Infinity]));
  const long_mm = 1e3 * data.sections.reduce((sum, section) => sum + section.length_m, 0);
  const solids = data.scenes.flatMap((scene) => scene.solids).map(([, radius, ...ends_mm]) =>
    [0, 1, 2].map((i) => [Math.min(ends_mm[i], ends_mm[i + 3] ?? ends_mm[i]) - radius, Math.max(ends_mm[i], ends_mm[i + 3] ?? ends_mm[i]) + radius]));
  for (;;) {
    const half = 0.55 * Math.max(...bounds.map(([low, high]) => high - low), 1);
    const is_shown = (solid, k) => solid[k].every((edge, side) => (side ? edge : -edge) > (side ? 1 : -1) * (bounds[k][0] + bounds[k][1]) / 2 - half);
    let is_wider = false;
    for (const solid of solids) {
      for (const [, ...axes] of VIEWS.filter(([, ...axes]) => axes.every((k) => is_shown(solid, k)))) {
        for (const k of axes) {
          const wider = [Math.min(bounds[k][0], Math.max(solid[k][0], -long_mm)), Math.max(bounds[k][1], Math.min(solid[k][1], long_mm))];
          is_wider ||= wider[0] < bounds[k][0] || wider[1] > bounds[k][1];
          bounds[k] = wider;
        }
      }
    }
    if (!is_wider) return { bounds, half };
  }
}

function path() {
  const { bounds, half } = path_window();
  const row = element('div', { class: 'row' });
  for (const [name, i, j] of VIEWS) {
    const axis = (k, count) => {
      const centre = (bounds[k][0] + bounds[k][1]) / 2;
      return { low: centre - half, high: centre + half, ticks: ticks(centre - half, centre + half, count) };
    };
    const [first, second] = ['x', 'y', 'z'].map((letter) => `${letter} [mm]`).filter((_, k) => k === i || k === j);
    const holder = fitted(element('div'), (width) => {
      const height = width - LEFT - RIGHT + 44;
      const { svg, inside, box, sx, sy } = panel(width, height, axis(i, 5), axis(j, 6), first);
      svg.setAttribute('aria-label', `Path ${name}`);
      const balls = drawn('g');
      const way = (points) => points.map((point, k) => `${k && !sparse ? 'L' : 'M'}${sx(point[i]).toFixed(1)} ${sy(point[j]).toFixed(1)}${sparse ? 'h0' : ''}`).join('');
      inside.append(balls,
        drawn('path', { d: references.map(way).join(''), style: 'stroke: var(--reference); stroke-width: 5; opacity: 0.4' }),
        drawn('path', { d: way(curves.tip_mm), style: 'stroke: var(--c2)' }));
      const tip = drawn('circle', { r: 4.5, style: 'fill: var(--c2)' });
      inside.append(tip);
      const per_mm = (box.right - box.left) / (2 * half);
      svg.cursor = () => {
        const here = between(curves.tip_mm, now_s);
        tip.setAttribute('cx', sx(here[i]));
        tip.setAttribute('cy', sy(here[j]));
        balls.replaceChildren(...solids(now_s).map(({ radius, start, end }) => drawn('line', {
          x1: sx(start[i]), y1: sy(start[j]), x2: sx(end[i]) + 1e-3, y2: sy(end[j]),
          style: `stroke: var(--c5); stroke-linecap: round; opacity: 0.35; stroke-width: ${2 * radius * per_mm}`,
        })));
      };
      return svg;
    });
    watchers.push(() => holder.firstChild?.cursor());
    row.append(element('figure', {}, element('figcaption', {}, element('b', {}, name), element('span', { class: 'quiet' }, `${second} over ${first}`)), holder));
  }
  const keys = [['var(--c2)', 'tip'], ['var(--reference)', 'reference', 'wide'], ['var(--c5)', 'obstacle', 'block']];
  const note = sparse ? element('p', { class: 'quiet' }, `A point each ${number(curves.width_s, 2)} s.`) : '';
  section('path', 'Path', note, element('p', {}, ...keys.flatMap(([style, name, kind]) => [key(style, name, kind).made, ' '])), row);
}

// ---- error, clearance, controls, cables, timing

function error_and_clearance() {
  const names = data.measured_mm ? ['error_mm', 'measured_mm'] : ['error_mm'];
  const [, high] = extent(names);
  if (high > -Infinity) {
    const values = high_of('error_mm').filter((value) => value !== null).sort((a, b) => a - b);
    const positive = values.filter((value) => value > 0);
    // A linear axis would flatten all but the largest values of the approach; a few small values would
    // stretch a logarithmic one.
    const log = high > 30 * values[values.length >> 1];
    const floor = Math.max(positive[positive.length >> 6], 1e-9);
    const range = log ? [10 ** Math.floor(Math.log10(floor)), 10 ** Math.ceil(Math.log10(1.05 * high))] : [0, 1.06 * high || 1];
    const labels = [data.is_by_model ? 'by the model' : 'error', 'as measured'];
    const series = names.map((name, i) => ({ name, label: labels[i] }));
    section('error', 'Error', chart({ title: `distance of tip and reference while tracking${log ? ', logarithmic' : ''}`, unit: 'mm', series, range, log }));
  } else {
    section('error', 'Error', element('p', {}, 'No cycle tracked a reference.'));
  }
  if (!data.least_clearance) {
    section('clearance', 'Clearance', element('p', {}, 'No obstacle was known.'));
    return;
  }
  const [nearest, farthest] = extent(['clearance_mm']);
  const top = Math.min(farthest, Math.max(4 * safe_mm, 3 * nearest)) - safe_mm;
  const part = top < farthest - safe_mm ? ', near it' : '';
  const range = padded([Math.min(nearest - safe_mm, -0.1 * Math.max(safe_mm, 1)), Math.max(top, safe_mm, 1)], 1);
  section('clearance', 'Clearance', chart({
    title: `clearance beyond the safe distance${part}: below 0 the body is too near`, unit: 'mm', series: [{ name: 'clearance_mm', label: 'clearance - D' }],
    limits: [{ value: 0, label: `safe distance D = ${number(safe_mm)} mm` }], range, less: safe_mm,
  }));
}

function by_section(prefix, title, unit, label, limit) {
  const names = Object.keys(curves.series).filter((name) => name.startsWith(prefix + '.'));
  const [low, high] = extent(names);
  // The limit is shown if the curves come near to it.
  const near = limit && Math.max(-low, high) > 0.5 * limit;
  const range = padded(near ? [Math.min(low, -limit), Math.max(high, limit)] : [low, high], 1e-3);
  return data.sections.map((_, j) => {
    const own = names.filter((name) => name.split('.')[1] === String(j + 1));
    const series = own.map((name) => ({ name, label: label(name.split('.')[2]) }));
    const limits = near ? [{ value: limit, label: `limit ${number(limit)} ${unit}` }, { value: -limit, label: '' }] : [];
    return chart({ title: `section ${j + 1}: ${title}`, unit, series, limits, range, height: 160 });
  });
}

function controls_and_cables() {
  const most = Math.max(...data.sections.map((part) => part.rate_max_rad_s));
  section('controls', 'Controls', element('p', { class: 'quiet' }, 'Commanded rates of each section’s bend vector (u, v). One scale for all sections.'),
    ...by_section('rate_rad_s', 'bend rate', 'rad/s', (axis) => axis, most));
  section('cables', 'Cables', element('p', { class: 'quiet' }, 'Change of each cable’s length from the straight robot, as commanded. One scale for all sections.'),
    ...by_section('stroke_mm', 'change of length', 'mm', (cable) => `cable ${cable}`, data.stroke_max_mm));
}

function histograms() {
  const { wake, solve, response } = data.latencies;
  const deadline_us = 1e3 * data.deadline_ms;
  const limit_us = 1e3 * data.late_start_ms;
  const all = [['wake-up latency', wake, limit_us, 'late start'], ['time of the solver', solve, null, ''], ['response time', response, deadline_us, 'deadline']];
  const used = all.map(([, { bins, bins_per_decade }]) => bins.findIndex((count) => count > 0) / bins_per_decade).filter((decade) => decade >= 0);
  const [low, high] = [10 ** Math.floor(Math.min(...used, 2)), 10 ** Math.ceil(Math.log10(2 * deadline_us))];
  const row = element('div', { class: 'row' });
  for (const [name, { bins, bins_per_decade, below_1_us, above_1_s, count, p50_us, p99_us, p999_us, max_us }, limit, limit_name] of all) {
    const edge = (k) => 10 ** (k / bins_per_decade);
    const above = bins.reduce((sum, many, k) => sum + (edge(k) >= high * 0.999 ? many : 0), above_1_s);
    const most = Math.max(...bins, 1);
    const holder = fitted(element('div'), (width) => {
      const y = { low: 0.7, high: 2 * most, log: true, ticks: decades(1, 2 * most, 5) };
      const { svg, box, sx, sy } = panel(width, 200, { low, high, log: true, ticks: decades(low, high, 6) }, y, 'µs');
      svg.setAttribute('aria-label', `Histogram: ${name}`);
      bins.forEach((many, k) => {
        if (!many || edge(k) < low * 0.999 || edge(k) >= high * 0.999) return;
        svg.append(drawn('rect', { x: sx(edge(k)), y: sy(many), width: Math.max(sx(edge(k + 1)) - sx(edge(k)) - 0.5, 1), height: box.bottom - sy(many), style: 'fill: var(--c1)' }));
      });
      if (limit > low && limit < high) {
        svg.append(drawn('line', { class: 'limit', x1: sx(limit), x2: sx(limit), y1: box.top, y2: box.bottom }));
        svg.append(drawn('text', { class: 'limit-text', x: sx(limit) - 4, y: box.top + 13, 'text-anchor': 'end' }, limit_name));
      }
      return svg;
    });
    const summary = count
      ? `median ${percentile(p50_us)}, 99 % ${percentile(p99_us)}, 99.9 % ${percentile(p999_us)}, max ${number(max_us, 3)} µs; ${count} cycles, ${below_1_us} left and ${above} right of the chart`
      : 'none';
    row.append(element('figure', {}, element('figcaption', {}, element('b', {}, `${name}: cycles`)), holder, element('p', { class: 'quiet' }, summary)));
  }
  const names = ['response_us', 'solve_us'];
  const [, most_us] = extent(names);
  const least_us = Math.max(1, Math.min(...names.map((name) => extent([name])[0]).filter(Number.isFinite)));
  const range = [10 ** Math.floor(Math.log10(least_us)), 10 ** Math.ceil(Math.log10(Math.max(most_us, 1.2 * deadline_us)))];
  section('latencies', 'Latencies', row,
    chart({ title: 'response and solver, logarithmic', unit: 'µs', series: [{ name: 'response_us', label: 'response' }, { name: 'solve_us', label: 'solver' }], limits: [{ value: deadline_us, label: `deadline ${number(data.deadline_ms)} ms` }], range, log: true }));
}

// ---- events

function table(heads, rows, empty) {
  if (!rows.length) return element('p', {}, empty);
  const cell = (value, k, name = 'td') => element(name, heads[k][1] ? { class: 'number' } : {}, value);
  const body = rows.map(({ cells, time_s, bad }) => {
    const row = element('tr', bad ? { class: 'bad' } : {}, ...cells.map((value, k) => cell(value, k)));
    row.addEventListener('click', () => go(time_s));
    return row;
  });
  return element('div', { class: 'scroll' }, element('table', {},
    element('thead', {}, element('tr', {}, ...heads.map(([name], k) => cell(name, k, 'th')))), element('tbody', {}, ...body)));
}

function happened() {
  const colour = (mode) => `var(--${(data.mode_names[mode] || 'starting').split(' ')[0]})`;
  const strip = fitted(element('div'), (width) => {
    const { svg, box, sx } = panel(width, 110, time_axis(width), { low: 0, high: 1, ticks: [] }, 'time [s]');
    svg.setAttribute('aria-label', 'Modes and events over time');
    for (let i = 0; i < times.length;) {
      let next = i + 1;
      while (next < times.length && curves.mode[next] === curves.mode[i]) next++;
      const to_s = next < times.length ? times[next] : end_s;
      const bar = drawn('rect', { x: sx(times[i]), width: Math.max(sx(to_s) - sx(times[i]), 1), y: box.top, height: 22, style: `fill: ${colour(curves.mode[i])}` });
      bar.append(drawn('title', {}, data.mode_names[curves.mode[i]]));
      svg.append(bar);
      i = next;
    }
    const mark = (time_s, level, style, text) => {
      const tick = drawn('line', { x1: sx(time_s), x2: sx(time_s), y1: box.top + level, y2: box.top + level + 14, style: `stroke: ${style}; stroke-width: 2` });
      tick.append(drawn('title', {}, text));
      svg.append(tick);
    };
    for (const { t_s, kind, text } of data.events) mark(t_s, 27, kind === 'refused' || kind === 'stop' ? 'var(--bad)' : 'var(--c1)', `${t_s.toFixed(3)} s: ${text}`);
    curves.misses.forEach((count, i) => { if (count) mark(times[i], 46, 'var(--bad)', `${times[i].toFixed(2)} s: ${count} deadline miss${count === 1 ? '' : 'es'}`); });
    if (data.events_left_out) {
      const x = sx(data.events[data.events.length - 1].t_s);
      const rest = { x, width: box.right - x, y: box.top + 27, height: 14, style: 'fill: var(--rule)' };
      svg.append(drawn('rect', rest), drawn('text', { x: box.right - 4, y: box.top + 38, 'text-anchor': 'end' }, 'not listed'));
    }
    ['mode', 'event', 'miss'].forEach((name, k) => svg.append(drawn('text', { x: LEFT - 6, y: box.top + 15 + 21 * k, 'text-anchor': 'end' }, name)));
    tells_time(svg, box, sx);
    return svg;
  });
  watchers.push(() => strip.firstChild?.cursor());
  const used = [...new Set(curves.mode)].map((mode) => key(colour(mode), data.mode_names[mode], 'block').made);
  const rows = data.events.map(({ t_s, kind, text }) => ({ time_s: t_s, bad: kind === 'refused' || kind === 'stop', cells: [t_s.toFixed(3), text] }));
  const more = data.events_left_out ? `${data.events_left_out} more events are not listed.` : '';
  section('events', 'Events', element('figure', {}, element('figcaption', {}, element('b', {}, 'modes, events and deadline misses'), ...used), strip),
    table([['time [s]', true], ['what happened', false]], rows, 'Nothing happened.'), element('p', { class: 'quiet' }, more));
  const worst = data.worst.map((late) => ({
    time_s: late.t_s, cells: [late.t_s.toFixed(3), String(late.cycle), ...['wake_us', 'solve_us', 'response_us'].map((name) => number(late[name], 4)), late.cause],
  }));
  section('misses', 'Deadline misses', element('p', {}, `${counted(data.deadline_misses)}${worst.length ? '. The worst:' : ''}`),
    table([['time [s]', true], ['cycle', true], ['wake-up [µs]', true], ['solver [µs]', true], ['response [µs]', true], ['cause', false]], worst, 'No command was late.'));
}

summary();
main.append(player());
section('robot', 'Robot', scene3d());
path();
error_and_clearance();
controls_and_cables();
histograms();
happened();
for (const fit of fits) fit();
go(end_s / 2);
