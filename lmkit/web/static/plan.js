// The plan view that Map and Live share: x to the right, y up, meters.
import { s } from "./lib.js";

const LETTER_PX = 7.2; // of a unit, so that the smallest letters have 12 px wherever the plan is drawn

// Smallest and largest x and y of everything that the plan shows.
export function frameOf({ landmarks, walls = [] }, extra = []) {
  const points = [...landmarks.map((l) => l.position), ...walls.flatMap((w) => [w.start, w.end]), ...extra], xs = points.map((p) => p[0]), ys = points.map((p) => p[1]);
  return points.length ? [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)] : [0, 4, 0, 3];
}

export function planOf(landmarks, { walls = [], doubts = {}, pins = {}, chosen = null, choose = null, extra = [], ellipses = true, across = 0 } = {}) {
  const [x0, x1, y0, y1] = frameOf({ landmarks, walls }, extra);
  const pad = 0.5 + 0.06 * Math.max(x1 - x0, y1 - y0), w = Math.max(x1 - x0, 1) + 2 * pad, hh = Math.max(y1 - y0, 1) + 2 * pad;
  const left = x0 - pad, top = -(y1 + pad), unit = Math.max(w, hh) / Math.min(100, Math.max(46, (across || innerWidth - 100) / LETTER_PX));
  const step = w > 40 ? 10 : w > 15 ? 5 : w > 6 ? 2 : 1;
  const lines = [];
  for (let x = Math.ceil(left / step) * step; x <= left + w; x += step) lines.push(s("line", { class: "gridline", x1: x, x2: x, y1: top, y2: top + hh }), axisLabel(x, left + w, top + hh, unit));
  for (let y = Math.ceil(top / step) * step; y <= top + hh; y += step) lines.push(s("line", { class: "gridline", x1: left, x2: left + w, y1: y, y2: y }));
  // Ellipses are magnified alike, so that the largest shows.
  const widest = Math.max(1e-6, ...landmarks.map((l) => (l.spread ? Math.sqrt(Math.max(l.spread[0][0], l.spread[1][1])) : 0)));
  const some = ellipses && landmarks.some((l) => l.spread);
  const gain = !some ? 0 : Math.max(1, Math.min(200, 2 ** Math.round(Math.log2(2.2 * unit / (2.45 * widest)))));
  const marks = new Map(landmarks.map((l) => {
    const a = l.facing_deg * Math.PI / 180, [x, y] = [l.position[0], -l.position[1]], half = Math.max(l.size_m / 2, 0.9 * unit);
    const tx = -Math.sin(a) * half, ty = -Math.cos(a) * half, nx = Math.cos(a) * 1.8 * unit, ny = -Math.sin(a) * 1.8 * unit;
    return [l.id, s("g", { class: `mark ${doubts[l.id] ? "bad" : ""} ${l.id === chosen ? "chosen" : ""}`, onclick: choose ? () => choose(l.id) : null },
      gain && l.spread ? ellipseOf(l.spread, l.position, gain) : null, s("line", { class: "face", x1: x - tx, y1: y - ty, x2: x + tx, y2: y + ty }), s("line", { class: "looks", x1: x, y1: y, x2: x + nx, y2: y + ny }),
      s("text", { x: x + (1.7 + 0.35 * `${l.code}`.length) * nx, y: y + 1.8 * ny + 0.8 * unit, "font-size": 2.2 * unit, "text-anchor": "middle" }, `${l.code}`), pins[l.id] === undefined ? null : s("circle", { class: "pin", cx: x, cy: y, r: 0.7 * unit }))];
  }));
  const drawn = walls.map((w) => s("line", { class: `wall ${w.landmarks === false ? "without" : ""}`, x1: w.start[0], y1: -w.start[1], x2: w.end[0], y2: -w.end[1] }));
  const svg = s("svg", { class: "plan", viewBox: `${left} ${top} ${w} ${hh}`, role: "img", "aria-label": `Plan with ${landmarks.length} landmarks` }, lines, drawn, [...marks.values()]);
  return { svg, unit, gain, marks, frame: [left, left + w, -top - hh, -top] };
}

// Labels stand right of their line, the last one left of it where the window ends.
function axisLabel(x, right, bottom, unit) {
  const last = x + 6 * unit > right;
  return s("text", { class: "axis", x: x + (last ? -0.4 : 0.4) * unit, y: bottom - 0.6 * unit, "font-size": 1.7 * unit, "text-anchor": last ? "end" : "start" }, `${x} m`);
}

// 95 % of two dimensions, `gain` times as large.
export function ellipseOf([[a, b], [, c]], at, gain, kind = "ellipse") {
  const mean = (a + c) / 2, root = Math.sqrt(((a - c) / 2) ** 2 + b * b), turn = 0.5 * Math.atan2(2 * b, a - c) * 180 / Math.PI, k = 2.45 * gain;
  return s("ellipse", { class: kind, rx: k * Math.sqrt(Math.max(mean + root, 0)), ry: k * Math.sqrt(Math.max(mean - root, 0)), transform: `translate(${at[0]} ${-at[1]}) rotate(${-turn})` });
}
