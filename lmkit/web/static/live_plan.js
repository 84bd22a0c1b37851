// The plan of Live: landmarks are drawn once; robot, ellipse, trail and what is seen change with each state.
import { ellipseOf, frameOf, planOf } from "./plan.js";
import { s } from "./lib.js";

const CHUNK = 40; // points of a piece of the trail; finished pieces are not drawn again

export function livePlan(box) {
  const ellipse = ellipseOf([[0, 0], [0, 0]], [0, 0], 1, "robotsure"), robot = s("path", { class: "robot" }), path = s("g"), moving = s("g", null, ellipse, robot);
  let map = { landmarks: [], walls: [] }, marks = new Map(), marked = new Map(), frame = null, unit = 1, reach = [], gain = 1, pieces = [], newest = null, across = 0;

  function still() {
    across = box.clientWidth; // 0 until the box is on the page
    const drawn = planOf(map.landmarks, { walls: map.walls, extra: reach, ellipses: false, across });
    ({ unit, frame, marks } = drawn);
    marked = new Map();
    robot.setAttribute("d", `M${2.6 * unit},0 L${-1.5 * unit},${1.5 * unit} L${-0.8 * unit},0 L${-1.5 * unit},${-1.5 * unit} Z`);
    // The robot has a layer of its own: the browser does not paint the landmarks again when it moves.
    const over = s("svg", { class: "over", viewBox: drawn.svg.getAttribute("viewBox"), "aria-hidden": "true" }, path, moving);
    box.replaceChildren(drawn.svg, over);
  }
  // What was once in the plan stays in it, and the frame grows in steps, so that nothing jumps.
  function keepInside([x, y]) {
    if (x >= frame[0] && x <= frame[1] && y >= frame[2] && y <= frame[3]) return;
    const [x0, x1, y0, y1] = frameOf(map, reach), more = 0.15 * Math.max(x1 - x0, y1 - y0, 1), beyond = (v, low, high) => v + (v > high ? more : v < low ? -more : 0);
    reach.push([beyond(x, x0, x1), beyond(y, y0, y1)]);
    still();
  }
  function mark(state) {
    const kinds = new Map((state.ids ?? []).map((id) => [id, "seen"]));
    for (const id of state.outlier_ids ?? []) kinds.set(id, "bad");
    for (const id of marked.keys()) if (!kinds.has(id)) marks.get(id)?.classList.remove("seen", "bad");
    for (const [id, kind] of kinds) {
      if (marked.get(id) === kind) continue;
      marks.get(id)?.classList.remove("seen", "bad");
      marks.get(id)?.classList.add(kind);
    }
    marked = kinds;
  }
  // The trail ends at `newest`; a later state only lengthens the last piece.
  function lengthen(entry) {
    const p = entry.state.position;
    if (p) {
      let last = pieces.at(-1);
      if (!last || last.count >= CHUNK) {
        const start = last ? [last.end] : [];
        last = { line: s("polyline", { class: "trail", points: start.map((q) => `${q[0]},${-q[1]}`).join(" ") }), count: 0, end: p, last: entry };
        pieces.push(last);
        path.append(last.line);
      }
      const point = box.firstChild.createSVGPoint();
      [point.x, point.y] = [p[0], -p[1]];
      last.line.points.appendItem(point);
      last.count += 1;
      last.end = p;
      last.last = entry;
    }
    newest = entry;
  }
  function trail(states, k) {
    const from = newest ? states.lastIndexOf(newest, k) : -1;
    if (from < 0) { path.replaceChildren(); pieces = []; newest = null; }
    for (let n = from + 1; n <= k; n += 1) lengthen(states[n]);
    while (pieces.length && !states.includes(pieces[0].last)) { pieces.shift().line.remove(); }
  }
  return {
    show(given) { map = given; still(); },
    reset() { reach = []; pieces = []; newest = null; path.replaceChildren(); still(); },
    draw(states, k) {
      const { state } = states[k];
      if (!across && box.clientWidth) still();
      if (state.position) keepInside(state.position);
      mark(state);
      trail(states, k);
      moving.style.display = state.position ? "" : "none";
      const C = state.position ? state.covariance : null;
      ellipse.style.display = C ? "" : "none";
      if (!state.position) return 1;
      const [x, y] = state.position, [i, j, n, w] = state.quaternion ?? [0, 0, 0, 1], yaw = Math.atan2(2 * (w * n + i * j), 1 - 2 * (j * j + n * n)) * 180 / Math.PI;
      robot.setAttribute("transform", `translate(${x} ${-y}) rotate(${-yaw})`);
      if (C) {
        const widest = 2.45 * Math.sqrt(Math.max(C[0][0], C[1][1]));
        if (widest * gain > 9 * unit || widest * gain < 1.5 * unit) gain = widest > 0 ? Math.max(1, 2 ** Math.round(Math.log2(3.5 * unit / widest))) : 1;
        const now = ellipseOf(C, state.position, gain, "robotsure");
        for (const name of ["rx", "ry", "transform"]) ellipse.setAttribute(name, now.getAttribute(name));
      }
      return gain;
    },
  };
}
