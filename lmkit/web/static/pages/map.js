import { api, command, empty, field, file, h, heading, jobView, mm, note, toast, trouble } from "../lib.js";
import { planOf } from "../plan.js";

export async function show(stage) {
  let map = await api("map"), chosen = null;
  const box = h("div");
  const key = (e) => { if ((e.ctrlKey || e.metaKey) && e.key === "z" && !/INPUT|SELECT/.test(e.target.tagName) && map.undo) { e.preventDefault(); undo(); } };
  addEventListener("keydown", key);

  async function edit(change) {
    try { map = await api("map", { method: "PUT", body: { version: map.version, edits: [{ id: chosen, ...change }] } }); if (change.remove) chosen = null; toast("Saved to map.yaml"); }
    catch (error) { toast(`${error.message}. ${error.hint}`, "bad"); if (error.code === "changed") map = await api("map"); }
    draw();
  }
  async function undo() {
    try { map = await api("map/undo", { method: "POST" }); toast("Undone"); } catch (error) { toast(error.message, "bad"); }
    draw();
  }
  function choose(id) { chosen = id; draw(); box.querySelector("#edit h2")?.scrollIntoView({ block: "nearest" }); }
  const number = (value, digits, save, label) => field(label, h("input", { value: value.toFixed(digits), inputmode: "decimal", onchange: (e) => { const v = Number(e.target.value.replace(",", ".")); if (Number.isFinite(v)) save(v); else draw(); } }));

  function editor(l) {
    const move = (axis) => (v) => edit({ position: l.position.map((p, k) => (k === axis ? v : p)) });
    return h("section", { class: "card stack", id: "edit" }, h("h2", null, `Landmark ${l.id}`), map.doubts[l.id] ? note("bad", map.doubts[l.id], "measure its place again, or survey it anew") : null,
      field("Name of the place", h("input", { value: l.name ?? "", onchange: (e) => edit({ name: e.target.value }) }), "lmkit plan route finds it by this name"),
      h("div", { class: "pairfields" }, number(l.position[0], 3, move(0), "x, m"), number(l.position[1], 3, move(1), "y, m"), number(l.position[2], 3, move(2), "Height, m"), number(l.facing_deg, 1, (v) => edit({ facing_deg: v }), "Faces, deg"), number(l.size_m * 1000, 1, (v) => edit({ size_m: v / 1000 }), "Size, mm")),
      h("p", { class: "small soft" }, l.sigma_m === null ? "Its uncertainty is not known: it was placed by hand." : `Known to ${mm(l.sigma_m)}. Moving it by hand drops this.`),
      h("div", { class: "row" }, h("button", { class: "danger", type: "button", onclick: () => edit({ remove: true }) }, "Remove"), h("button", { class: "plain", type: "button", onclick: () => choose(null) }, "Close")));
  }
  const error = h("input", { value: "5cm", autocomplete: "off" }), height = h("input", { value: "", placeholder: "of the rig", autocomplete: "off" }), jobs = h("div"), drawn = h("div");
  const start = (verb) => async () => {
    drawn.replaceChildren();
    const shown = (j) => j.state === "done" && drawn.replaceChildren(...j.outputs.filter((o) => /\.(svg|png)$/.test(o)).map((o) => h("img", { class: "plan onwhite", src: `${file(o)}?t=${Date.now()}`, alt: verb === "coverage" ? "Floor plan colored by the error to expect at every place" : "Floor plan with the landmarks that are mounted and those to mount next" })));
    try { jobs.replaceChildren(jobView(await api(`jobs/${verb}`, { method: "POST", body: { error: error.value, camera_height: height.value } }), { done: shown })); }
    catch (problem) { jobs.replaceChildren(trouble(problem)); }
  };
  const planning = h("section", { class: "card stack" }, h("h2", null, "Is it enough?"), h("p", { class: "small soft" }, "On the floor plan of the project (floor.yaml): the error to expect at every place, and where the next landmark helps most."),
    h("div", { class: "pairfields" }, field("Error allowed", error, "such as 5cm"), field("Camera height", height, "only if rig.yaml does not say")),
    h("div", { class: "row" }, h("button", { class: "primary", type: "button", onclick: start("coverage") }, "Show the coverage"), h("button", { type: "button", onclick: start("place") }, "Where to mount the next ones"), h("button", { type: "button", onclick: start("sheet") }, "Mounting sheet (PDF)")), jobs, drawn);
  function draw() {
    const undoButton = h("button", { type: "button", disabled: !map.undo, onclick: undo, title: "Ctrl+Z" }, "Undo");
    if (!map.landmarks.length) {
      box.replaceChildren(empty("No map yet", "Survey a recording: the map is built with its uncertainty, and landmarks that contradict each other are shown in red.", h("a", { class: "button primary", href: "#/recordings" }, "To the recordings"), map.undo ? undoButton : null));
      return;
    }
    const { svg, gain } = planOf(map.landmarks, { doubts: map.doubts, chosen, choose });
    const picked = map.landmarks.find((l) => l.id === chosen);
    const bad = Object.keys(map.doubts).length;
    box.replaceChildren(
      bad ? note("bad", `${bad} ${bad === 1 ? "landmark contradicts" : "landmarks contradict"} what the survey saw`, "they are red in the plan; choose one to see why") : "",
      h("div", { class: picked ? "two" : "" }, picked ? editor(picked) : null,
        h("section", { class: "card" }, svg, h("p", { class: "row small soft" }, `${map.landmarks.length} landmarks${gain ? `; ellipses hold 95 %, drawn ${gain} times as large` : ""}. `, undoButton))),
      map.warnings.length ? h("section", { class: "card" }, h("h2", null, "What the last survey says"), h("ul", null, map.warnings.map((w) => h("li", null, w)))) : "",
      h("section", { class: "card" }, h("h2", null, "Landmarks"), h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": "Landmarks" }, h("table", null,
        h("thead", null, h("tr", null, ["Landmark", "Name", "x m", "y m", "z m", "faces", "known to"].map((t, k) => h("th", { scope: "col", class: k > 1 ? "n" : null }, t)))),
        h("tbody", null, map.landmarks.map((l) => h("tr", { "aria-selected": l.id === chosen ? "true" : null }, h("td", null, h("button", { class: `plain ${map.doubts[l.id] ? "danger" : ""}`, type: "button", onclick: () => choose(l.id), "aria-label": `Edit landmark ${l.id}` }, l.id)), h("td", null, l.name ?? ""),
          l.position.map((v) => h("td", { class: "n" }, v.toFixed(3))), h("td", { class: "n" }, `${Math.round(l.facing_deg + 360) % 360}°`), h("td", { class: "n" }, l.sigma_m === null ? "–" : mm(l.sigma_m)))))))),
      planning, h("section", { class: "card" }, command(map.command)));
  }
  // A survey may end while the page is open.
  const poll = setInterval(async () => {
    if (document.hidden || box.contains(document.activeElement)) return;
    const now = await api("map").catch(() => map);
    if (now.version !== map.version) { map = now; draw(); }
  }, 4000);
  draw();
  stage.append(...heading("Map", "Where every landmark is mounted, seen from above. Changes are saved at once and can be undone."), box);
  return () => { clearInterval(poll); removeEventListener("keydown", key); };
}
