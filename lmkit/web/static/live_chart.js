// Innovations against their band, on a canvas: some hundred dots that move with every state.
import { h } from "./lib.js";

const SHOWN = 200, W = 480, H = 150, TOP = 4;
const x = (k) => 34 + (W - 44) * k / (SHOWN - 1), y = (v) => 8 + (H - 30) * (1 - Math.min(v, TOP) / TOP);

export function innovationChart() {
  const canvas = h("canvas", { class: "curve", role: "img" }), words = h("figcaption", null), nothing = h("p", { class: "small soft" }, "Nothing is compared with a prediction so far. A run without odometry has none.");
  const figure = h("figure", null, canvas, words), box = h("div", null, nothing);
  function draw(states, k) {
    const entries = states.slice(Math.max(0, k + 1 - SHOWN), k + 1);
    const points = entries.map(({ state }, n) => [n, state.innovation, state.band]).filter(([, v]) => v !== null && v !== undefined);
    if (!points.length) { if (box.firstChild !== nothing) box.replaceChildren(nothing); return; }
    if (box.firstChild !== figure) box.replaceChildren(figure);
    const banded = points.filter(([, , b]) => b), count = (is) => Math.round(100 * banded.filter(([, v, b]) => is(v, b)).length / banded.length);
    const share = banded.length ? `${count((v, b) => v >= b[0] && v <= b[1])} % in the band, ${count((v, b) => v < b[0])} % below, ${count((v, b) => v > b[1])} % above` : "no band";
    const text = `Normalized innovation of each step against its 95 % band: ${share}. Around 1 errors are as large as stated; below, they are smaller, or images share them (lenses, map); above, something contradicts the map or the odometry.`;
    if (words.textContent !== text) { words.textContent = text; canvas.setAttribute("aria-label", `Innovations of ${points.length} steps: ${share}`); }
    paint(canvas, points, banded);
  }
  return { box, draw };
}

function paint(canvas, points, banded) {
  const look = getComputedStyle(canvas), color = (name) => look.getPropertyValue(name);
  const scale = Math.min(2, (canvas.clientWidth || W) / W * devicePixelRatio), size = [Math.round(W * scale), Math.round(H * scale)];
  if (canvas.width !== size[0] || canvas.height !== size[1]) [canvas.width, canvas.height] = size;
  const c = canvas.getContext("2d");
  c.setTransform(scale, 0, 0, scale, 0, 0);
  c.clearRect(0, 0, W, H);
  if (banded.length > 1) {
    c.beginPath();
    for (const [k, , b] of banded) c.lineTo(x(k), y(b[1]));
    for (const [k, , b] of [...banded].reverse()) c.lineTo(x(k), y(b[0]));
    c.globalAlpha = 0.14;
    c.fillStyle = color("--blue");
    c.fill();
    c.globalAlpha = 1;
  }
  c.strokeStyle = color("--good");
  c.lineWidth = 1.5;
  c.setLineDash([5, 4]);
  c.beginPath(); c.moveTo(34, y(1)); c.lineTo(W - 10, y(1)); c.stroke();
  c.setLineDash([]);
  c.font = `12px ${look.fontFamily}`;
  c.textAlign = "end";
  c.fillStyle = color("--soft");
  for (const v of [0, 1, 2, 4]) c.fillText(`${v}`, 24, y(v) + 4);
  for (const bad of [false, true]) {
    c.beginPath();
    for (const [k, v, b] of points) if (Boolean(b && v > b[1]) === bad) { c.moveTo(x(k) + 2.2, y(v)); c.arc(x(k), y(v), 2.2, 0, 7); }
    c.fillStyle = color(bad ? "--red" : "--blue");
    c.fill();
  }
}
