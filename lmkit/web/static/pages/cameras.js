import { api, choice, command, empty, field, fill, h, heading, note, trouble } from "../lib.js";

export async function show(stage) {
  const { cameras, stand_ins } = await api("cameras");
  const all = [...cameras, ...stand_ins];
  stage.append(...heading("Cameras", "One look through every camera, side by side: exposure, color, sharpness, and whether left and right are swapped."));
  const results = h("div", { "aria-live": "polite" });
  if (!all.length) {
    stage.append(empty("No camera found", "Plug a color camera in and reload; folders of pairs and videos in the project can stand for one. Without cameras, write the example on the overview.", h("a", { class: "button primary", href: "#/" }, "To the overview")));
  } else {
    const none = [["", "none"]], options = all.map((name) => [name, name]);
    const first = choice(options, all[0]), second = choice([...none, ...options], cameras[1] ?? "");
    const button = h("button", { class: "primary", type: "submit" }, "Look");
    const many = cameras.length > 2 ? h("button", { type: "button", onclick: () => look(cameras.slice(0, 4)) }, `Look through ${cameras.length > 4 ? "the first four" : `all ${cameras.length}`}`) : null;
    async function look(sources) {
      button.disabled = true;
      results.replaceChildren(h("p", null, "Looking …"));
      try { draw(await api("cameras/look", { method: "POST", body: { sources } })); }
      catch (error) { results.replaceChildren(trouble(error)); }
      button.disabled = false;
    }
    stage.append(h("form", { class: "card stack", onsubmit: (event) => { event.preventDefault(); look([first.value, second.value].filter(Boolean)); } },
      h("div", { class: "pairfields" }, field("Camera", first, "the left one; a folder has both"), field("Second camera", second)), h("div", { class: "row" }, button, many)), results);
  }
  function draw({ views, problems, apart_s: apart, command: words }) {
    fill(results, ...problems.map((p) => note("bad", p.message, p.hint)),
      h("div", { class: views.length > 1 ? "grid wide" : "" }, views.map((v) => h("section", { class: "card stack" }, h("h2", null, v.name),
        v.error ? note("bad", v.error) : [h("img", { class: "plan", src: v.image, alt: `Image of ${v.name}`, width: v.width, height: v.height }),
          v.faults.length ? v.faults.map((f) => note("warn", f)) : note("good", "exposure and color are good"),
          h("dl", { class: "figures" }, fact(`${v.width} × ${v.height}`, "pixels"), fact(`${Math.round(100 * v.sharpness)} %`, "sharpness"), fact(v.landmarks.length, v.landmarks.length === 1 ? "landmark read" : "landmarks read"))]))),
      h("section", { class: "card stack" }, apart === null ? null : h("dl", { class: "figures" }, fact(`${(1000 * apart).toFixed(1)} ms`, "between their images")), command(words)));
  }
  const fact = (value, label) => h("div", null, h("dt", null, label), h("dd", null, value));
  stage.append(h("section", { class: "card stack" }, h("h2", null, "Calibrate them"), h("p", null, "Guided capture keeps sharp and new pairs, and names the view to show next. Pairs saved under pairs/ appear on the page ", h("a", { href: "#/calibrate" }, "Calibrate"), "."), command(`lmkit calibrate ${cameras[0] ?? "camera:0"} ${cameras[1] ?? "camera:2"} --board chessboard:9x6:25mm --capture --save-pairs pairs/today -o rig.yaml`)));
}
