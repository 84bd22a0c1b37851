import { api, choice, empty, field, fill, h, heading, jobView, mm, sentence, toast, trouble } from "../lib.js";
import { flatOrDeep } from "../flat_or_deep.js";
import { innovationChart } from "../live_chart.js";
import { livePlan } from "../live_plan.js";

const KEPT = 600; // states of the last minute
const WORDS = {
  ok: "Ok: the pose agrees with what is seen", ambiguous: "Ambiguous: the pose is not sure yet", imprecise: "Imprecise: poses half a meter away explain what is seen as well",
  no_landmarks: "No landmarks: too few of the map are read", inconsistent: "Inconsistent: no pose explains what is read", swapped: "Swapped: left and right image are exchanged", lost: "Lost: the pose is not known",
};
const STALE_MS = 4000; // without a state, a run has ended or waits
const goes = (job) => job.verb === "run" && (job.state === "running" || job.state === "waiting");
const RETRY_MS = 2000;
const SLOWLY_MS = 250; // between two changes of what is read rather than followed

export async function show(stage) {
  const box = h("div"), planBox = h("div", { class: "layers" }), plan = livePlan(planBox), chart = innovationChart();
  const image = h("canvas", { class: "plan", role: "img", "aria-label": "Newest image of every camera, with the landmarks outlined", hidden: true });
  const legend = h("p", { class: "small soft", hidden: true }, "Green: read and agrees with the pose. Red: read and contradicts it. Magenta with a question mark: expected, not read.");
  const status = h("p", { role: "status" }), facts = ["landmarks", "position", "poses", "latency"].map((label) => [h("dd"), label]), scale = h("p", { class: "small soft" });
  const health = h("div"), happened = h("ul", { class: "small" });
  const scrub = h("input", { type: "range", min: 0, max: 0, value: 0, "aria-label": "Look back", oninput: () => { back = Number(scrub.value) < states.length - 1 ? Number(scrub.value) : null; draw(); } });
  let states = [], back = null, waiting = false, shown = false, run = null, events = [], slowly = 0, newest = 0, decoding = null, pictured = null;
  const say = (element, text) => { if (element.textContent !== text) element.textContent = text; };
  let map = { landmarks: [], walls: [] };
  const views = flatOrDeep(planBox, { draw: (view) => { view.show(map); draw(); } });
  const loadMap = async () => { map = await api("live/map").catch(() => map); plan.show(map); views.view?.show(map); };
  await loadMap();

  function draw() {
    waiting = false;
    if (!states.length) return;
    const k = back ?? states.length - 1, { state, jpeg } = states[k], now = performance.now();
    const stale = performance.now() - newest > STALE_MS && back === null;
    const words = stale ? "Nothing new comes: the run has ended, or waits. This is its last state." : sentence(`${WORDS[state.status] ?? state.status}${state.reason ? ` (${state.reason})` : ""}`);
    if (status.textContent !== words) {
      status.className = `note ${stale ? "" : state.status === "ok" ? "good" : state.status === "lost" ? "bad" : "warn"}`;
      status.textContent = words;
    }
    const gain = plan.draw(states, k);
    views.view?.robot(states, k, gain);
    say(scale, state.position ? `The arrow is the robot. Its ellipse holds 95 %${gain > 1 ? `, drawn ${gain} times as large` : ""}.` : "The robot's place is not known at this time.");
    picture(jpeg);
    if (back === null && now - slowly < SLOWLY_MS) return;
    slowly = now;
    const C = state.covariance;
    const values = [(state.ids ?? []).length, C ? `± ${mm(Math.sqrt(C[0][0] + C[1][1]))}` : "–", `${(state.rate_hz ?? 0).toFixed(1)} Hz`, state.latency_ms == null ? "–" : `${state.latency_ms.toFixed(0)} ms`];
    facts.forEach(([dd], n) => say(dd, `${values[n]}`));
    chart.draw(states, k);
    report([...(state.sources ?? []).map((e) => ["in", e]), ...(state.outputs ?? []).map((e) => ["out", e])]);
    scrub.max = states.length - 1;
    if (back === null) scrub.value = states.length - 1;
  }
  // Decodes one image at a time; those that come meanwhile are passed over, but for the newest.
  async function picture(jpeg) {
    if (!jpeg || jpeg === pictured) return;
    pictured = jpeg;
    if (decoding) return;
    while (decoding !== pictured) {
      decoding = pictured;
      const bitmap = await createImageBitmap(new Blob([decoding], { type: "image/jpeg" })).catch(() => null);
      if (!bitmap) continue;
      if (image.width !== bitmap.width || image.height !== bitmap.height) [image.width, image.height] = [bitmap.width, bitmap.height];
      image.getContext("bitmaprenderer").transferFromImageBitmap(bitmap);
      image.hidden = legend.hidden = false;
    }
    decoding = null;
  }
  const cells = [];
  function report(entries) {
    if (!entries.length || entries.length !== cells.length) { cells.length = 0; fill(health, table(entries, cells)); }
    entries.forEach(([way, e], n) => [way, e.name, `${e.rate_hz.toFixed(1)} Hz`, `${e.count}`, `${e.lost}`, e.problem ?? ""].forEach((text, c) => say(cells[n][c], text)));
  }
  function reset() { states = []; back = null; events = []; pictured = null; image.hidden = legend.hidden = true; happened.replaceChildren(); plan.reset(); }

  let socket, ended = null, retry;
  function connect() {
    socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/api/live`);
    socket.binaryType = "arraybuffer";
    socket.onmessage = take;
    socket.onopen = () => { ended?.remove(); ended = null; };
    socket.onclose = ({ code }) => {
      const full = code === 1013;
      ended ??= trouble(full ? { message: "too many browsers look at this run", hint: "close one of them, then reload" } : { message: "the connection to lmkit web ended", hint: "is it still running in the terminal? This page looks for it every two seconds" });
      if (!ended.isConnected) box.prepend(ended);
      if (!full) retry = setTimeout(connect, RETRY_MS);
    };
  }
  function take({ data }) {
    const length = new DataView(data).getUint32(0, true);
    const state = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
    if (state.run !== run) { if (run !== null) reset(); run = state.run; if (map.run !== run) loadMap(); }
    const jpeg = data.byteLength > 4 + length ? data.slice(4 + length) : states.at(-1)?.jpeg ?? null;
    if (!shown) { shown = true; fill(box, ...panels()); }
    states.push({ state, jpeg });
    newest = performance.now();
    for (const event of state.events ?? []) { events = [event, ...events].slice(0, 6); happened.replaceChildren(...events.map((e) => h("li", null, e.message))); }
    if (states.length > KEPT) { states.shift(); if (back !== null && back > 0) back -= 1; }
    if (!waiting) { waiting = true; requestAnimationFrame(draw); }
  }
  connect();
  const panels = () => [status,
    h("div", { class: "grid wide" }, h("section", { class: "card stack" }, image, legend, h("dl", { class: "figures by2" }, facts.map(([dd, label]) => h("div", null, h("dt", null, label), dd)))), h("section", { class: "card stack" }, views.element, scale, h("label", null, "The last minute", scrub))),
    h("div", { class: "grid wide" }, h("section", { class: "card stack" }, h("h2", null, "Innovation"), chart.box), h("section", { class: "card stack" }, h("h2", null, "Inputs and outputs"), h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": "Inputs and outputs" }, health), happened))];

  const [project, { cameras }] = await Promise.all([api("project"), api("cameras")]);
  const runs = h("div"), record = h("input", { type: "checkbox" });
  const idle = () => fill(box, empty("Nothing runs live", `${project.can_run ? "Start a run, or replay a recording" : "Connect a run to this page"}: the robot appears on the plan with its trail, and you see why a pose is or is not sure.`));
  const starts = (job) => fill(box, empty(job.waits_for ? "The run waits" : "The run starts", job.waits_for ? "Something else runs; the first pose appears here after it." : "The first pose appears here when rig, map and cameras are read."));
  const ends = (j) => { if (!shown) idle(); if (j.state !== "failed" && j.outputs.length) toast(`Recorded to ${j.outputs[0]}`); };
  const start = (source, second = () => "") => async () => {
    const body = { source: typeof source === "string" ? source : source(), second: second(), record: record.checked };
    try {
      // A run from cameras has no end of its own.
      for (const j of (await api("jobs")).jobs) if (goes(j)) await api(`jobs/${j.id}/cancel`, { method: "POST" }).catch(() => null);
      reset();
      const job = await api("jobs/run", { method: "POST", body });
      runs.replaceChildren(jobView(job, { done: ends }));
      if (!shown) starts(job);
      runs.querySelector("[data-key=cancel]")?.focus();
    } catch (error) { runs.replaceChildren(trouble(error)); }
  };
  const left = choice(cameras.map((c) => [c, c]), cameras[0]), right = choice([["", "none: one camera, or one that shows both"], ...cameras.map((c) => [c, c])], cameras[1] ?? "");
  const byCameras = !cameras.length || !project.can_run ? null : h("div", { class: "stack" }, h("div", { class: "pairfields" }, field("Left camera", left), field("Right camera", right)),
    h("div", { class: "row" }, h("button", { class: project.has.run ? "" : "primary", type: "button", onclick: start(() => left.value, () => right.value) }, "Start with the cameras")));
  const button = (text, source, kind) => h("button", { class: kind, type: "button", onclick: start(source) }, text);
  const buttons = !project.can_run ? [h("a", { class: "button primary", href: "#/recordings" }, "Track a recording")] : [
    project.has.run ? button("Start run.yaml", "run.yaml", "primary") : null,
    project.recordings.filter((r) => r.images).slice(0, 4).map((r) => button(`Replay ${r.name}`, r.name)),
    project.bags.filter((b) => b.name.startsWith("runs/")).slice(-4).map((b) => button(`Replay ${b.name}`, b.name)),
    button("Watch a simulated robot", "sim:"),
  ];
  const ongoing = (await api("jobs")).jobs.find(goes);
  if (!shown) { if (ongoing) starts(ongoing); else idle(); }
  stage.append(...heading("Live", "The pose while it happens, and the last minute to look back at."), h("section", { class: "card stack" }, h("h2", null, "Runs"), byCameras, h("div", { class: "row" }, buttons),
    project.can_run ? h("label", { class: "check" }, record, "Record the next run to runs/, to replay it later") : null, runs), box);
  const watch = setInterval(() => { if (performance.now() - newest > STALE_MS) draw(); }, 1000);
  if (ongoing) runs.append(jobView(ongoing, { done: ends }));
  requestAnimationFrame(() => { slowly = 0; draw(); }); // before it was shown, the chart had no colors
  return () => { clearTimeout(retry); socket.onclose = null; socket.close(); clearInterval(watch); views.close(); };
}

// The table of inputs and outputs; `cells` is given what changes, row by row.
function table(entries, cells) {
  if (!entries.length) return h("p", { class: "small soft" }, "Not reported by this run.");
  return h("table", null, h("thead", null, h("tr", null, ["Direction", "Name", "Rate", "Count", "Lost"].map((t, k) => h("th", { scope: "col", class: k > 1 ? "n" : null }, t)))),
    h("tbody", null, entries.map(() => {
      const [way, name, rate, count, lost, problem] = ["span", "span", "span", "span", "span", "div"].map((tag) => h(tag));
      problem.className = "small bad";
      cells.push([way, name, rate, count, lost, problem]);
      return h("tr", null, h("td", { class: "soft" }, way), h("td", null, name, problem), [rate, count, lost].map((e) => h("td", { class: "n" }, e)));
    })));
}
