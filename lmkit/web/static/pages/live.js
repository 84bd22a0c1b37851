import { api, empty, h, heading, jobView, mm, s, toast, trouble } from "../lib.js";
import { planOf, ellipseOf } from "../plan.js";

const KEPT = 600; // states of the last minute
const SHOWN = 200; // innovations in the chart

export async function show(stage) {
  let map = await api("live/map").catch(() => ({ landmarks: [] }));
  const box = h("div");
  const image = h("img", { class: "plan", alt: "Newest image of every camera, with the landmarks outlined", hidden: true });
  const legend = h("p", { class: "small soft", hidden: true }, "Green: read and agrees with the pose. Red: read and contradicts it. Magenta with a question mark: expected, not read.");
  const status = h("p", { role: "status" }), facts = h("dl", { class: "figures" }), plan = h("div"), scale = h("p", { class: "small soft" });
  const chart = h("div"), health = h("div"), happened = h("ul", { class: "small" });
  const scrub = h("input", { type: "range", min: 0, max: 0, value: 0, "aria-label": "Look back", oninput: () => { back = Number(scrub.value) < states.length - 1 ? Number(scrub.value) : null; draw(); } });
  let states = [], back = null, url = null, waiting = false, shown = false, run = null, reach = [], gain = 1, events = [], told = "";
  const fact = (value, label) => h("div", null, h("dt", null, label), h("dd", null, value));

  function draw() {
    waiting = false;
    if (!states.length) return;
    const k = back ?? states.length - 1, { state, jpeg } = states[k];
    const words = `${state.status}${state.reason ? `: ${state.reason}` : ""}`;
    if (words !== told) {
      told = words;
      status.className = `note ${state.status === "ok" ? "good" : state.status === "lost" ? "bad" : "warn"}`;
      status.textContent = words;
    }
    const C = state.covariance, sigma = C ? Math.sqrt(C[0][0] + C[1][1]) : null;
    facts.replaceChildren(fact((state.ids ?? []).length, "landmarks"), fact(sigma === null ? "–" : `± ${mm(sigma)}`, "position"), fact(`${(state.rate_hz ?? 0).toFixed(1)} Hz`, "poses"), fact(state.latency_ms == null ? "–" : `${state.latency_ms.toFixed(0)} ms`, "latency"));
    drawPlan(k, state);
    if (jpeg && jpeg !== image.jpeg) { const old = url; url = URL.createObjectURL(jpeg); image.jpeg = jpeg; image.onload = () => old && URL.revokeObjectURL(old); image.src = url; image.hidden = legend.hidden = false; }
    chart.replaceChildren(innovations(states.slice(Math.max(0, k + 1 - SHOWN), k + 1)));
    health.replaceChildren(table([...(state.sources ?? []).map((e) => ["in", e]), ...(state.outputs ?? []).map((e) => ["out", e])]));
    scrub.max = states.length - 1;
    if (back === null) scrub.value = states.length - 1;
  }
  function drawPlan(k, state) {
    const trail = states.slice(0, k + 1).map((e) => e.state.position).filter(Boolean);
    // What was once in the plan stays in it, so that nothing jumps.
    const all = [...reach, ...(state.position ? [state.position] : [])], span = (n) => [Math.min(...all.map((p) => p[n])), Math.max(...all.map((p) => p[n]))];
    if (all.length) { const [x, y] = [span(0), span(1)]; reach = [[x[0], y[0]], [x[1], y[1]]]; }
    const seen = new Set(state.ids ?? []), doubted = Object.fromEntries((state.outlier_ids ?? []).map((id) => [id, "contradicts the pose"]));
    const { svg, unit } = planOf(map.landmarks, { extra: reach, doubts: doubted, seen, ellipses: false });
    if (trail.length > 1) svg.append(s("polyline", { class: "trail", points: trail.map((p) => `${p[0]},${-p[1]}`).join(" ") }));
    if (state.position) {
      const [x, y] = state.position, C = state.covariance, widest = C ? 2.45 * Math.sqrt(Math.max(C[0][0], C[1][1])) : 0;
      if (widest * gain > 9 * unit || widest * gain < 1.5 * unit) gain = widest > 0 ? Math.max(1, 2 ** Math.round(Math.log2(3.5 * unit / widest))) : 1;
      if (C) svg.append(ellipseOf([C[0][0], C[0][1], C[1][1]], state.position, gain, "robotsure"));
      const [i, j, n, w] = state.quaternion ?? [0, 0, 0, 1], yaw = Math.atan2(2 * (w * n + i * j), 1 - 2 * (j * j + n * n)) * 180 / Math.PI;
      svg.append(s("path", { class: "robot", d: `M${2.6 * unit},0 L${-1.5 * unit},${1.5 * unit} L${-0.8 * unit},0 L${-1.5 * unit},${-1.5 * unit} Z`, transform: `translate(${x} ${-y}) rotate(${-yaw})` }));
    }
    plan.replaceChildren(svg);
    scale.textContent = state.covariance ? `The arrow is the robot. Its ellipse holds 95 %${gain > 1 ? `, drawn ${gain} times as large` : ""}.` : "The robot's place is not known at this time.";
  }
  function reset() { states = []; back = null; reach = []; events = []; told = ""; image.hidden = legend.hidden = true; happened.replaceChildren(); }

  const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/api/live`);
  socket.binaryType = "arraybuffer";
  socket.onmessage = ({ data }) => {
    const length = new DataView(data).getUint32(0, true);
    const state = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
    const jpeg = data.byteLength > 4 + length ? new Blob([data.slice(4 + length)], { type: "image/jpeg" }) : states.at(-1)?.state.run === state.run ? states.at(-1)?.jpeg ?? null : null;
    if (state.run !== run) { if (run !== null) reset(); run = state.run; api("live/map").then((m) => { map = m; }).catch(() => {}); }
    if (!shown) {
      shown = true;
      box.replaceChildren(status, h("div", { class: "grid wide" }, h("section", { class: "card stack" }, image, legend, facts), h("section", { class: "card stack" }, plan, scale, h("label", null, "The last minute", scrub))),
        h("div", { class: "grid wide" }, h("section", { class: "card stack" }, h("h2", null, "Innovation"), chart), h("section", { class: "card stack" }, h("h2", null, "Inputs and outputs"), h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": "Inputs and outputs" }, health), happened)));
    }
    states.push({ state, jpeg });
    for (const event of state.events ?? []) { events = [event, ...events].slice(0, 6); happened.replaceChildren(...events.map((e) => h("li", null, e.message))); }
    if (states.length > KEPT) { states.shift(); if (back !== null && back > 0) back -= 1; }
    if (!waiting) { waiting = true; requestAnimationFrame(draw); }
  };
  socket.onclose = (e) => { if (!e.wasClean || e.code === 1013) box.prepend(trouble({ message: e.code === 1013 ? "too many browsers look at this run" : "the connection to lmkit web ended", hint: e.code === 1013 ? "close one of them, then reload" : "is it still running in the terminal? Then reload the page" })); };

  const project = await api("project");
  const runs = h("div"), record = h("input", { type: "checkbox" });
  const start = (source) => async () => {
    const body = { source, record: record.checked };
    try {
      reset();
      runs.replaceChildren(jobView(await api("jobs/run", { method: "POST", body }), { done: (j) => j.state !== "failed" && j.outputs.length && toast(`Recorded to ${j.outputs[0]}`) }));
      runs.querySelector("[data-key=cancel]")?.focus();
    } catch (error) { runs.replaceChildren(trouble(error)); }
  };
  const button = (text, source, kind) => h("button", { class: kind, type: "button", onclick: start(source) }, text);
  const buttons = !project.can_run ? [h("a", { class: "button primary", href: "#/recordings" }, "Track a recording")] : [
    project.has.run ? button("Start run.yaml", "run.yaml", "primary") : null,
    project.recordings.filter((r) => r.images).slice(0, 4).map((r) => button(`Replay ${r.name}`, r.name)),
    project.bags.filter((b) => b.name.startsWith("runs/")).slice(-4).map((b) => button(`Replay ${b.name}`, b.name)),
    button("Watch a simulated robot", "sim:"),
  ];
  box.append(empty("Nothing runs live", `${project.can_run ? "Start a run, or replay a recording" : "Connect a run to this page"}: the robot appears on the plan with its trail, and you see why a pose is or is not sure.`));
  stage.append(...heading("Live", "The pose while it happens, and the last minute to look back at."), h("section", { class: "card stack" }, h("h2", null, "Runs"), h("div", { class: "row" }, buttons),
    project.can_run ? h("label", { class: "check" }, record, "Record the next run to runs/, to replay it later") : null, runs), box);
  const ongoing = (await api("jobs")).jobs.find((j) => j.verb === "run" && (j.state === "running" || j.state === "waiting"));
  if (ongoing) runs.append(jobView(ongoing));
  return () => { socket.onclose = null; socket.close(); if (url) URL.revokeObjectURL(url); };
}

function innovations(entries) {
  const points = entries.map(({ state }, k) => [k, state.innovation, state.band]).filter(([, v]) => v !== null && v !== undefined);
  if (!points.length) return h("p", { class: "small soft" }, "No landmark was compared with the prediction yet.");
  const [w, hh, top] = [480, 150, 4], x = (k) => 34 + (w - 44) * k / Math.max(SHOWN - 1, 1), y = (v) => 8 + (hh - 30) * (1 - Math.min(v, top) / top);
  const banded = points.filter(([, , b]) => b), inside = banded.filter(([, v, b]) => v >= b[0] && v <= b[1]).length, above = banded.filter(([, v, b]) => v > b[1]).length;
  const edge = (n) => banded.map(([k, , b]) => `${x(k).toFixed(1)},${y(b[n]).toFixed(1)}`);
  const share = banded.length ? `${Math.round(100 * inside / banded.length)} % in the band, ${Math.round(100 * above / banded.length)} % above` : "no band";
  return h("figure", null, s("svg", { class: "curve", viewBox: `0 0 ${w} ${hh}`, role: "img", "aria-label": `Innovations of ${points.length} steps: ${share}` },
    banded.length > 1 ? s("polygon", { class: "band", points: [...edge(1), ...edge(0).reverse()].join(" ") }) : null,
    s("line", { class: "goal", x1: 34, x2: w - 10, y1: y(1), y2: y(1) }), [0, 1, 2, 4].map((v) => s("text", { x: 24, y: y(v) + 4, "text-anchor": "end" }, `${v}`)),
    points.map(([k, v, b]) => s("circle", { class: b && v > b[1] ? "dot bad" : "dot", cx: x(k), cy: y(v), r: 2.2 }))),
    h("figcaption", null, `Surprise of each step against its 95 % band: ${share}. Around 1 the stated uncertainty is right; below, it is cautious; above, something contradicts the map or the odometry.`));
}

function table(entries) {
  if (!entries.length) return h("p", { class: "small soft" }, "Not reported by this run.");
  return h("table", null, h("thead", null, h("tr", null, ["", "Name", "Rate", "Count", "Lost"].map((t, k) => h("th", { scope: "col", class: k > 1 ? "n" : null }, t)))),
    h("tbody", null, entries.map(([way, e]) => h("tr", null, h("td", { class: "soft" }, way), h("td", null, e.name, e.problem ? h("div", { class: "small bad" }, e.problem) : null), h("td", { class: "n" }, `${e.rate_hz.toFixed(1)} Hz`), h("td", { class: "n" }, e.count), h("td", { class: "n" }, e.lost)))));
}
