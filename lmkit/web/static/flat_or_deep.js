// A plan with a button that shows the same in three dimensions; what that needs is loaded at the first press.
import { fill, h, note } from "./lib.js";

export function flatOrDeep(flat, { draw, choose = null }) {
  const deep = h("div", { class: "view3d", hidden: true });
  const buttons = ["Plan", "3D"].map((text, k) => h("button", { type: "button", "aria-pressed": k === 0 ? "true" : "false", onclick: () => turn(k === 1) }, text));
  let view = null, isDeep = false, gone = false;
  async function turn(on) {
    isDeep = on;
    buttons.forEach((b, k) => b.setAttribute("aria-pressed", String((k === 1) === on)));
    if (on && !view) {
      try {
        fill(deep, h("p", { class: "soft" }, "Loading …"));
        [deep.hidden, flat.hidden] = [false, true];
        const { view3d } = await import("./view3d.js");
        if (gone) return;
        view ??= view3d(deep, { choose });
      } catch { fill(deep, note("warn", "this browser shows no 3D", "it needs WebGL; switch it on in the browser's settings, or use another browser")); }
    }
    [deep.hidden, flat.hidden] = [!isDeep, isDeep];
    if (isDeep && view) draw(view);
  }
  return {
    element: h("div", null, h("div", { class: "switch", role: "group", "aria-label": "View" }, buttons), flat, deep),
    get view() { return isDeep ? view : null; },
    close() { gone = true; view?.close(); },
  };
}
