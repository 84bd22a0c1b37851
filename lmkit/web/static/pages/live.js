import { api, empty, h, heading, jobView, mm, s, trouble } from "../lib.js";
import { planOf } from "../plan.js";

const KEPT = 600; // states of the last minute

export async function show(stage) {
  const map = await api("map").catch(() => ({ landmarks: [] }));
  const box = h("div");
  const image = h("img", { class: "plan", alt: "Newest image", hidden: true });
  const status = h("p", { role: "status" }), facts = h("dl", { class: "figures" }), plan = h("div");
  const scrub = h("input", { type: "range", min: 0, max: 0, value: 0, "aria-label": "Look back", oninput: () => { back = Number(scrub.value) < states.length - 1 ? Number(scrub.value) : null; draw(); } });
  let states = [], back = null, url = null, waiting = false;
  const fact = (value, label) => h("div", null, h("dt", null, label), h("dd", null, value));

  function draw() {
    waiting = false;
    const k = back ?? states.length - 1, { state } = states[k];
    status.className = `note ${state.status === "ok" ? "good" : state.status === "lost" ? "bad" : "warn"}`;
    status.textContent = `${state.status}${state.reason ? `: ${state.reason}` : ""}`;
    const C = state.covariance, sigma = C ? Math.sqrt(C[0][0] + C[1][1]) : null;
    facts.replaceChildren(fact((state.ids ?? []).length, "landmarks"), fact(sigma === null ? "–" : `± ${mm(sigma)}`, "position"), fact(`${(state.rate_hz ?? 0).toFixed(1)} Hz`, "poses"), fact(state.latency_ms == null ? "–" : `${state.latency_ms.toFixed(0)} ms`, "latency"));
    const trail = states.slice(0, k + 1).map((e) => e.state.position).filter(Boolean);
    const { svg, unit } = planOf(map.landmarks, { extra: trail });
    if (trail.length > 1) svg.append(s("polyline", { class: "trail", points: trail.map((p) => `${p[0]},${-p[1]}`).join(" ") }));
    if (state.position) svg.append(s("circle", { class: "robot", cx: state.position[0], cy: -state.position[1], r: 1.2 * unit }));
    plan.replaceChildren(svg);
    if (states[k].jpeg) { const old = url; url = URL.createObjectURL(states[k].jpeg); image.onload = () => old && URL.revokeObjectURL(old); image.src = url; image.hidden = false; }
    scrub.max = states.length - 1;
    if (back === null) scrub.value = states.length - 1;
  }
  const socket = new WebSocket(`${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/api/live`);
  socket.binaryType = "arraybuffer";
  socket.onmessage = ({ data }) => {
    const length = new DataView(data).getUint32(0, true);
    const state = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
    const jpeg = data.byteLength > 4 + length ? new Blob([data.slice(4 + length)], { type: "image/jpeg" }) : null;
    if (!states.length) box.replaceChildren(status, h("div", { class: "two" }, h("section", { class: "card stack" }, image, facts), h("section", { class: "card stack" }, plan, h("label", null, "The last minute", scrub))));
    states.push({ state, jpeg });
    if (states.length > KEPT) { states.shift(); if (back !== null && back > 0) back -= 1; }
    if (!waiting) { waiting = true; requestAnimationFrame(draw); }
  };
  const project = await api("project");
  const runs = h("div");
  const start = (source) => async () => {
    try { states = []; back = null; runs.replaceChildren(jobView(await api("jobs/run", { method: "POST", body: { source } }))); } catch (error) { runs.replaceChildren(trouble(error)); }
  };
  const buttons = !project.can_run ? [h("a", { class: "button primary", href: "#/recordings" }, "Track a recording")] : [
    project.has.run ? h("button", { class: "primary", type: "button", onclick: start("run.yaml") }, "Start run.yaml") : null,
    project.recordings.filter((r) => r.images).slice(0, 4).map((r) => h("button", { type: "button", onclick: start(r.name) }, `Replay ${r.name}`)),
    h("button", { type: "button", onclick: start("sim:") }, "Watch a simulated robot"),
  ];
  box.append(empty("Nothing runs live", `${project.can_run ? "Start a run, or replay a recording" : "Connect a run to this page"}: the robot appears on the plan with its trail, and you see why a pose is or is not sure.`));
  stage.append(...heading("Live", "The pose while it happens, and the last minute to look back at."), box, h("section", { class: "card stack" }, h("h2", null, "Runs"), h("div", { class: "row" }, buttons), runs));
  return () => { socket.close(); if (url) URL.revokeObjectURL(url); };
}
