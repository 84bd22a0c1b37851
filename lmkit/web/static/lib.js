// Elements, requests, and the small parts that every page uses.
const SVG = "http://www.w3.org/2000/svg";

function build(element, attributes, children) {
  for (const [name, value] of Object.entries(attributes ?? {})) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else if (name in element && (name === "value" || name === "checked" || name === "disabled")) element[name] = value;
    else element.setAttribute(name, value === true ? "" : value);
  }
  element.append(...children.flat(9).filter((c) => c !== null && c !== undefined && c !== false));
  return element;
}
export const h = (tag, attributes, ...children) => build(document.createElement(tag), attributes, children);
export const s = (tag, attributes, ...children) => build(document.createElementNS(SVG, tag), attributes, children);

export const fill = (element, ...children) => element.replaceChildren(...children.filter((c) => c !== null && c !== undefined && c !== false));

// Draws a part of the page anew; the keyboard stays where it was.
export function keepFocus(part, work) {
  const parts = () => [...part.querySelectorAll("input, button, select, summary")], place = parts().indexOf(document.activeElement);
  work();
  if (place >= 0) parts()[place]?.focus({ preventScroll: true });
}

export class Problem extends Error {
  constructor(code, message, hint) { super(message); this.code = code; this.hint = hint; }
}

export async function api(path, { method = "GET", body, signal } = {}) {
  const raw = body instanceof Blob;
  let reply;
  try {
    reply = await fetch(`/api/${path}`, {
      method, signal,
      headers: body === undefined || raw ? {} : { "content-type": "application/json" },
      body: body === undefined || raw ? body : JSON.stringify(body),
    });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new Problem("offline", "lmkit web does not answer", "is it still running in the terminal?");
  }
  const data = await reply.json().catch(() => ({}));
  if (!reply.ok) throw new Problem(data.code ?? "error", data.message ?? `error ${reply.status}`, data.hint ?? "");
  return data;
}

export function note(kind, text, hint) {
  return h("div", { class: `note ${kind}`, role: kind === "bad" ? "alert" : null }, hint ? h("b", null, sentence(text)) : sentence(text), hint ? sentence(hint) : null);
}
export const trouble = (error) => note("bad", error.message, error.hint);
// Names of files, options and cameras keep their first letter.
export const sentence = (text) => (text ? (/^(lmkit\b|camera:|-|\S*[._/]\S)/.test(text) ? text[0] : text[0].toUpperCase()) + text.slice(1) + (/[.!?]$/.test(text) ? "" : ".") : "");

export function toast(text, kind = "") {
  const box = h("div", { class: `toast ${kind}` }, text), all = document.getElementById("toasts");
  if (all.children.length > 1) all.firstChild.remove();
  all.append(box);
  setTimeout(() => box.remove(), kind === "bad" ? 8000 : 4000);
}

export function command(text) {
  const button = h("button", { type: "button", onclick: async () => {
    try { await navigator.clipboard.writeText(text); button.textContent = "Copied"; }
    catch { getSelection().selectAllChildren(button.previousSibling); button.textContent = "Selected"; }
    setTimeout(() => { button.textContent = "Copy"; }, 2000);
  } }, "Copy");
  return h("div", null, h("p", { class: "small soft label" }, "The same on the command line"), h("div", { class: "command" }, h("code", null, text), button));
}

export function field(label, input, hint) {
  const id = `f${field.count = (field.count ?? 0) + 1}`;
  input.id = id;
  if (hint) input.setAttribute("aria-describedby", `${id}h`);
  return h("div", { class: "field" }, h("label", { for: id }, label), input, hint ? h("span", { class: "hint", id: `${id}h` }, hint) : null);
}
export const choice = (options, value, onchange) =>
  h("select", { onchange }, options.map(([key, text]) => h("option", { value: key, selected: key === value }, text)));
export const heading = (title, lead) => [h("h1", null, title), h("p", { class: "lead" }, lead)];
export const empty = (title, text, ...actions) =>
  h("div", { class: "card empty" }, h("h2", null, title), h("p", null, text), h("div", { class: "row" }, actions));
export const grade = (letter, big) => h("span", { class: `grade ${letter ?? ""} ${big ? "big" : ""}`, title: letter ? `grade ${letter}` : "not graded" }, letter ?? "–");
// The number that someone wrote, with a comma or a point; null, and said, where it is none.
export function numberOf(text) {
  const value = Number(text.trim().replace(",", "."));
  if (text.trim() && Number.isFinite(value)) return value;
  toast(text.trim() ? `${text.trim()} is not a number` : "a number is missing", "bad");
  return null;
}
export const mm = (m) => (m >= 1 ? `${m.toFixed(2)} m` : m >= 0.1 ? `${(m * 100).toFixed(0)} cm` : `${(m * 1000).toFixed(1)} mm`);
export const file = (name) => `/api/files/${name.split("/").map(encodeURIComponent).join("/")}`;

const KINDS = { html: "Open the report", svg: "Open the plan", png: "Open the plan", pdf: "Open the PDF", csv: "Download the list" };
function outputLink(name) {
  const kind = name.split(".").at(-1);
  return !(kind in KINDS) || !/^(prints|photos|reports)\//.test(name) ? null : h("a", { class: "button", href: file(name) + (kind === "csv" ? "?download" : ""), target: "_blank", rel: "noopener" }, KINDS[kind]);
}

// Jobs: one card that follows a job until it ends.
export function jobView(job, { done, progress } = {}) {
  const box = h("div", { class: "job" });
  let timer;
  const bar = (p) => h("progress", p && p.total ? { value: p.done, max: p.total, "aria-label": p.step } : { "aria-label": "running" });
  function draw(j) {
    const live = j.verb === "run", going = j.state === "running" || j.state === "waiting";
    const open = box.querySelector("details")?.open;
    const focused = box.contains(document.activeElement) ? document.activeElement.dataset?.key : null;
    fill(box,
      h("div", { class: "row" }, h("h3", null, j.title), h("span", { class: `state ${j.state}` }, live && j.state === "canceled" ? "stopped" : j.state),
        j.seconds !== null ? h("span", { class: "soft small" }, `${j.seconds.toFixed(0)} s`) : null,
        going ? h("button", { class: "danger", "data-key": "cancel", type: "button", onclick: () => api(`jobs/${j.id}/cancel`, { method: "POST" }).then(draw).catch((e) => toast(e.message, "bad")) }, live ? "Stop" : "Cancel") : null,
        j.can_finish ? h("button", { "data-key": "finish", type: "button", disabled: (j.progress?.kept ?? 0) < 6, title: "from six pairs on", onclick: () => api(`jobs/${j.id}/finish`, { method: "POST" }).then(draw).catch((e) => toast(e.message, "bad")) }, "Calibrate with these") : null),
      going && (!live || j.waits_for) ? h("div", null, h("p", { class: "small soft" }, j.progress ? `${j.progress.step}${j.progress.total ? `: ${j.progress.done} of ${j.progress.total}` : ""}` : j.waits_for ? `waits for the end of: ${j.waits_for}` : j.state === "waiting" ? "begins" : "working"), bar(j.progress)) : null,
      j.state === "failed" ? note("bad", j.error) : null,
      j.state === "done" ? h("div", { class: "row" }, j.outputs.map(outputLink)) : null,
      h("details", { open: open ?? false }, h("summary", { "data-key": "log" }, "Log and command line"), h("div", null, command(j.command), h("pre", { class: "log", tabindex: "0", "aria-label": "Log" }, (j.log ?? []).join("\n") || "nothing yet"))),
    );
    if (focused) box.querySelector(`[data-key=${focused}]`)?.focus();
    if (progress && j.progress) progress(j);
  }
  async function follow() {
    if (!box.isConnected && timer) return;
    try {
      const j = await api(`jobs/${job.id}`);
      draw(j);
      if (j.state === "running" || j.state === "waiting") timer = setTimeout(follow, 500);
      else done?.(j);
    } catch (error) {
      // The program may come back, but not with this job.
      if (error.code === "no_job") { box.replaceChildren(note("warn", `${job.title}: lmkit web was started anew, and the job ended with it`, "start it again")); return; }
      box.replaceChildren(trouble(error));
      if (error.code === "offline") timer = setTimeout(follow, 2000);
    }
  }
  draw(job);
  timer = setTimeout(follow, 50);
  return box;
}
