// The walls of the map: a card to take, draw, edit and remove them. `save` is given all walls; `load` a file.
import { fill, field, h, keepFocus, note, numberOf, s, toast } from "./lib.js";

const SNAP_M = 0.15, GRID_M = 0.05; // a click goes to the end of a wall nearby, or else to a grid

export function wallsCard({ save, load, redraw }) {
  const box = h("section", { class: "card stack" }), bar = h("div"), scale = h("input", { inputmode: "decimal", placeholder: "0.05" });
  let walls = [], gap = null, landmarks = [], chosen = null, drawing = null;
  const pick = h("input", { type: "file", accept: ".yaml,.yml,.svg,.dxf,.png,.pgm,.jpg,.jpeg", onchange: async () => { if (pick.files[0]) await load(pick.files[0], scale.value.trim().replace(",", ".")); pick.value = ""; } });
  const point = (p) => p.map((v) => v.toFixed(2)).join(", ");
  const change = (k, part) => save(walls.map((w, n) => (n === k ? { ...w, ...part } : w)));

  function editor(k) {
    const w = walls[k];
    const number = (end, axis, label) => field(label, h("input", { value: w[end][axis].toFixed(2), inputmode: "decimal", onchange: (e) => { const v = numberOf(e.target.value); if (v === null) draw(); else change(k, { [end]: w[end].map((p, n) => (n === axis ? v : p)) }); } }));
    return h("div", { class: "inset stack" }, h("h3", null, `Wall ${w.name || k + 1}`), field("Name", h("input", { value: w.name, onchange: (e) => change(k, { name: e.target.value }) })),
      h("div", { class: "pairfields" }, number("start", 0, "From x, m"), number("start", 1, "From y, m"), number("end", 0, "To x, m"), number("end", 1, "To y, m")),
      h("label", { class: "check" }, h("input", { type: "checkbox", checked: w.landmarks, onchange: (e) => change(k, { landmarks: e.target.checked }) }), "Landmarks may be mounted on it"),
      h("div", { class: "row" }, h("button", { class: "danger", type: "button", onclick: () => { chosen = null; save(walls.filter((_, n) => n !== k)); } }, "Remove the wall"), h("button", { class: "plain", type: "button", onclick: () => { chosen = null; draw(); } }, "Close")));
  }
  function around() {
    const xs = landmarks.map((l) => l.position[0]), ys = landmarks.map((l) => l.position[1]), r = (v) => Math.round(v * 100) / 100;
    const [x0, x1, y0, y1] = [Math.min(...xs), Math.max(...xs), Math.min(...ys), Math.max(...ys)].map(r);
    if (x1 - x0 < 0.5 || y1 - y0 < 0.5) { toast("All landmarks are on one wall: draw the others", "bad"); return; }
    const corners = [[x0, y0], [x1, y0], [x1, y1], [x0, y1]];
    save(corners.map((start, k) => ({ start, end: corners[(k + 1) % 4], name: "", landmarks: true })));
  }
  const draw = () => keepFocus(box, drawAll);
  function drawAll() {
    const turn = () => { drawing = drawing ? null : { from: null }; draw(); redraw(); };
    const begin = drawing ? null : h("button", { type: "button", onclick: turn }, "Draw walls on the plan");
    fill(bar, drawing ? note("", drawing.from ? "click at the next corner" : "click where a wall begins, then at each of its corners", "ends snap to each other and to 5 cm") : null, drawing ? h("div", { class: "row" }, h("button", { class: "primary", type: "button", onclick: turn }, "Done drawing")) : null);
    fill(box, h("h2", null, "Walls"), h("p", { class: "small soft" }, "floor.yaml: what blocks the view, and where landmarks can be mounted. Coverage and mounting sites need closed rooms."),
      gap ? note("warn", `the walls do not close a room: one ends freely at ${point(gap)} m`, drawing ? "go on to the wall where it begins" : "draw what is missing, or move its end onto another wall") : null,
      walls.length ? h("ul", { class: "list" }, walls.map((w, k) => h("li", null, h("button", { class: "plain", type: "button", "aria-label": `Edit wall ${w.name || k + 1}`, onclick: () => { chosen = chosen === k ? null : k; draw(); } }, w.name || `Wall ${k + 1}`), h("span", { class: "soft small" }, `${point(w.start)} to ${point(w.end)}${w.landmarks ? "" : ", no landmarks"}`), chosen === k ? editor(k) : null))) : null,
      h("div", { class: "row" }, !walls.length && landmarks.length > 1 ? h("button", { class: "primary", type: "button", onclick: around }, "A room around the landmarks") : null, begin),
      h("details", null, h("summary", null, "Take them from a floor plan"), h("div", { class: "pairfields" }, field("Meters per pixel", scale, "of an image; of SVG and DXF: per unit"), field("File", pick, "floor.yaml, SVG, DXF, PNG, PGM"))));
  }
  // Clicks on a plan become walls while drawing is on.
  function listen(svg) {
    if (!drawing) return;
    const line = s("line", { class: "wall draft" }), ends = walls.flatMap((w) => [w.start, w.end]);
    svg.append(line);
    svg.classList.add("drawing");
    const at = (e) => {
      const p = new DOMPoint(e.clientX, e.clientY).matrixTransform(svg.getScreenCTM().inverse()), here = [p.x, -p.y];
      const near = ends.find((q) => Math.hypot(q[0] - here[0], q[1] - here[1]) < SNAP_M);
      return near ?? here.map((v) => Math.round(v / GRID_M) * GRID_M).map((v) => Number(v.toFixed(3)));
    };
    const show = (to) => { const [a, b] = [drawing.from, to]; for (const [name, v] of [["x1", a[0]], ["y1", -a[1]], ["x2", b[0]], ["y2", -b[1]]]) line.setAttribute(name, v); };
    svg.addEventListener("pointermove", (e) => drawing?.from && show(at(e)));
    svg.addEventListener("click", (e) => {
      const to = at(e), from = drawing.from;
      drawing.from = to;
      if (!from) draw();
      show(to);
      if (from && Math.hypot(from[0] - to[0], from[1] - to[1]) >= 0.1) save([...walls, { start: from, end: to, name: "", landmarks: true }]);
    });
  }
  return { box, bar, listen, get drawing() { return Boolean(drawing); }, show(floor, marks) { ({ walls, gap } = floor); landmarks = marks; if (chosen >= walls.length) chosen = null; draw(); } };
}
