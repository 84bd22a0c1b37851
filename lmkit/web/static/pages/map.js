import { api, command, empty, field, file, h, heading, jobView, keepFocus, mm, note, numberOf, sentence, toast, trouble } from "../lib.js";
import { flatOrDeep } from "../flat_or_deep.js";
import { planOf } from "../plan.js";
import { wallsCard } from "../walls.js";

export async function show(stage) {
  let map = await api("map"), chosen = null, gain = 0;
  const box = h("div"), doubted = h("div"), side = h("div"), flat = h("div"), caption = h("span", { class: "small soft" }), table = h("div"), said = h("div"), words = h("div");
  const views = flatOrDeep(flat, { choose, draw: (view) => view.show({ landmarks: map.landmarks, walls: map.floor.walls }, { doubts: map.doubts, chosen, gain }) });
  const walls = wallsCard({ save: (all) => change("floor", () => ({ method: "PUT", body: { version: map.floor.version, walls: all } }), "Saved to floor.yaml"), load: (given, scale) => load(given, scale), redraw: () => { draw(); if (walls.drawing) planCard.scrollIntoView({ block: "nearest" }); } });
  const undoButton = h("button", { type: "button", onclick: undo, title: "Ctrl+Z" }, "Undo");
  const key = (e) => { if ((e.ctrlKey || e.metaKey) && e.key === "z" && !/INPUT|SELECT/.test(e.target.tagName) && map.undo) { e.preventDefault(); undo(); } };
  addEventListener("keydown", key);

  // One change after the other, each to the version that the one before has left.
  let queue = Promise.resolve();
  function change(path, request, done) {
    queue = queue.then(async () => {
      let said = [done, ""];
      try { await api(path, request()); } catch (error) { said = [`${sentence(error.message)} ${sentence(error.hint)}`, "bad"]; }
      map = await api("map").catch(() => map);
      if (!map.landmarks.some((l) => l.id === chosen)) chosen = null;
      draw();
      toast(...said);
    });
  }
  function edit(part) {
    const id = chosen;
    change("map", () => ({ method: "PUT", body: { version: map.version, edits: [{ id, ...part }] } }), part.pin_mm === undefined ? "Saved to map.yaml" : "Saved to pins.yaml");
  }
  const load = (given, scale) => change(`floor/${encodeURIComponent(given.name.replace(/[^A-Za-z0-9._-]+/g, "-"))}${scale ? `?scale=${encodeURIComponent(scale)}` : ""}`, () => ({ method: "PUT", body: given }), "Saved to floor.yaml");
  function undo() { change("map/undo", () => ({ method: "POST" }), "Undone"); }
  function choose(id) { if (walls.drawing) return; chosen = id; draw(); side.querySelector("h2")?.scrollIntoView({ block: "nearest" }); }
  const number = (value, digits, save, label) => field(label, h("input", { value: value.toFixed(digits), inputmode: "decimal", onchange: (e) => { const v = numberOf(e.target.value); if (v === null) draw(); else save(v); } }));

  function editor(l) {
    const move = (axis) => (v) => edit({ position: l.position.map((p, k) => (k === axis ? v : p)) }), pin = map.pins[l.id];
    return h("section", { class: "card stack" }, h("h2", null, `Landmark ${l.id}`), map.doubts[l.id] ? note("bad", map.doubts[l.id], "measure its place again, or survey it anew") : null,
      field("Name of the place", h("input", { value: l.name ?? "", onchange: (e) => edit({ name: e.target.value }) }), "lmkit plan route finds it by this name"),
      h("div", { class: "pairfields" }, number(l.position[0], 3, move(0), "x, m"), number(l.position[1], 3, move(1), "y, m"), number(l.position[2], 3, move(2), "Height, m"), number(l.facing_deg, 1, (v) => edit({ facing_deg: v }), "Faces, deg"), number(l.size_m * 1000, 1, (v) => edit({ size_m: v / 1000 }), "Size, mm")),
      h("p", { class: "small soft" }, l.sigma_m === null ? "Its uncertainty is not known: it was placed by hand." : `Known to ${mm(l.sigma_m)}. Moving it by hand drops this.`),
      h("label", { class: "check" }, h("input", { type: "checkbox", checked: pin !== undefined, onchange: (e) => edit({ pin_mm: e.target.checked ? 5 : 0 }) }), "Pinned: measured by hand, surveys keep it here"),
      pin === undefined ? null : number(pin, 1, (v) => edit({ pin_mm: Math.max(v, 0.1) }), "Measured to, mm"),
      h("div", { class: "row" }, h("button", { class: "danger", type: "button", onclick: () => edit({ remove: true }) }, "Remove"), h("button", { class: "plain", type: "button", onclick: () => choose(null) }, "Close")));
  }
  const error = h("input", { value: "5cm", autocomplete: "off" }), height = h("input", { value: "", placeholder: "of the rig", autocomplete: "off" }), jobs = h("div"), drawn = h("div");
  const start = (verb) => async () => {
    drawn.replaceChildren();
    const shown = (j) => j.state === "done" && drawn.replaceChildren(...j.outputs.filter((o) => /\.(svg|png)$/.test(o)).map((o) => h("img", { class: "plan onwhite", src: `${file(o)}?t=${Date.now()}`, alt: verb === "coverage" ? "Floor plan colored by the error to expect at every place" : "Floor plan with the landmarks that are mounted and those to mount next" })));
    try { jobs.replaceChildren(jobView(await api(`jobs/${verb}`, { method: "POST", body: { error: error.value, camera_height: height.value } }), { done: shown })); }
    catch (problem) { jobs.replaceChildren(trouble(problem)); }
  };
  const planning = h("section", { class: "card stack" }, h("h2", null, "Is it enough?"), h("p", { class: "small soft" }, "The error to expect at every place of the floor, and where the next landmark helps most."),
    h("div", { class: "pairfields" }, field("Error allowed", error, "such as 5cm"), field("Camera height", height, "if rig.yaml does not say")),
    h("div", { class: "row" }, h("button", { class: "primary", type: "button", onclick: start("coverage") }, "Show the coverage"), h("button", { type: "button", onclick: start("place") }, "Where to mount the next ones"), h("button", { type: "button", onclick: start("sheet") }, "Mounting sheet (PDF)")), jobs, drawn);
  const planCard = h("section", { class: "card" }, views.element, walls.bar, h("div", { class: "row under" }, caption, undoButton));
  const two = h("div", null, side, planCard), nothing = empty("No map yet", "Survey a recording: the map is built with its uncertainty, and landmarks that contradict each other are shown in red.", h("a", { class: "button primary", href: "#/recordings" }, "To the recordings"));
  box.append(doubted, nothing, two, said, table, walls.box, planning, words);

  function rows() {
    return h("section", { class: "card" }, h("h2", null, "Landmarks"), h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": "Landmarks" }, h("table", null,
      h("thead", null, h("tr", null, ["Landmark", "Name", "x m", "y m", "z m", "faces", "known to"].map((t, k) => h("th", { scope: "col", class: k > 1 ? "n" : null }, t)))),
      h("tbody", null, map.landmarks.map((l) => h("tr", { "aria-selected": l.id === chosen ? "true" : null }, h("td", null, h("button", { class: `plain ${map.doubts[l.id] ? "danger" : ""}`, type: "button", onclick: () => choose(l.id), "aria-label": `Edit landmark ${l.id}` }, l.id)), h("td", null, l.name ?? "", map.pins[l.id] === undefined ? null : h("span", { class: "tag" }, "pinned")),
        l.position.map((v) => h("td", { class: "n" }, v.toFixed(3))), h("td", { class: "n" }, `${Math.round(l.facing_deg + 360) % 360}°`), h("td", { class: "n" }, l.sigma_m === null ? "–" : mm(l.sigma_m))))))));
  }
  function draw() {
    const some = map.landmarks.length > 0, bad = Object.keys(map.doubts).length, pins = Object.keys(map.pins).length, picked = map.landmarks.find((l) => l.id === chosen);
    undoButton.disabled = !map.undo;
    nothing.hidden = some;
    planCard.hidden = !some && !map.floor.walls.length && !walls.drawing && !map.undo;
    planning.hidden = words.hidden = !some;
    const plan = planOf(map.landmarks, { walls: map.floor.walls, doubts: map.doubts, pins: map.pins, chosen, choose });
    ({ gain } = plan);
    walls.listen(plan.svg);
    flat.replaceChildren(plan.svg);
    views.view?.show({ landmarks: map.landmarks, walls: map.floor.walls }, { doubts: map.doubts, chosen, gain });
    caption.textContent = `${map.landmarks.length} landmarks${pins ? `, ${pins} pinned` : ""}${gain ? `; ellipses hold 95 %, drawn ${gain} times as large` : ""}.`;
    doubted.replaceChildren(bad ? note("bad", `${bad} ${bad === 1 ? "landmark contradicts" : "landmarks contradict"} what the survey saw`, "they are red in the plan; choose one to see why") : "", map.floor.problem ? note("warn", map.floor.problem, map.floor.hint) : "");
    keepFocus(side, () => side.replaceChildren(picked ? editor(picked) : ""));
    two.className = picked ? "two" : "";
    said.replaceChildren(map.warnings.length ? h("section", { class: "card" }, h("h2", null, "What the last survey says"), h("ul", null, map.warnings.map((w) => h("li", null, w)))) : "");
    keepFocus(table, () => table.replaceChildren(some ? rows() : ""));
    walls.show(map.floor, map.landmarks);
    words.replaceChildren(map.command ? h("section", { class: "card" }, command(map.command)) : "");
  }
  // A survey may end while the page is open.
  const poll = setInterval(async () => {
    if (document.hidden || walls.drawing || box.contains(document.activeElement)) return;
    const now = await api("map").catch(() => map);
    if (now.version !== map.version || now.floor.version !== map.floor.version) { map = now; draw(); }
  }, 4000);
  draw();
  stage.append(...heading("Map", "Where every landmark is mounted, seen from above. Changes are saved at once and can be undone."), box);
  return () => { clearInterval(poll); removeEventListener("keydown", key); views.close(); };
}
