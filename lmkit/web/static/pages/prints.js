import { api, choice, command, field, file, h, heading, note, toast, trouble } from "../lib.js";

const KEY = "lmkit-prints";

export async function show(stage) {
  const [options, project] = await Promise.all([api("prints/choices"), api("project")]);
  let saved = {};
  try { saved = JSON.parse(sessionStorage.getItem(KEY) ?? "{}"); } catch { /* the first visit */ }
  const want = { codes: "0-11", family: "lm8", size: "", paper: "a4", template: "", text: "", map_name: "", compensate: "", mirror: false, ...saved };
  const sheets = h("div", { "aria-live": "polite" });
  const results = h("div", { "aria-live": "polite" });
  let urls = [], timer, asking;

  function body() {
    const { paper, template, ...rest } = want;
    return template ? { ...rest, paper: "", template } : { ...rest, paper, template: "" };
  }
  function change() {
    sessionStorage.setItem(KEY, JSON.stringify(want));
    clearTimeout(timer);
    timer = setTimeout(preview, 250);
  }
  const text = (key, extra) => h("input", { value: want[key], oninput: (e) => { want[key] = e.target.value; change(); }, autocomplete: "off", spellcheck: "false", ...extra });
  const paper = choice(options.papers.map((p) => [p, p.length === 2 ? p.toUpperCase() : p[0].toUpperCase() + p.slice(1)]), want.paper, (e) => { want.paper = e.target.value; change(); });
  paper.disabled = Boolean(want.template);
  const width = h("input", { inputmode: "decimal", placeholder: "178.6", oninput: measured, "aria-label": "Measured width, mm" });
  const height = h("input", { inputmode: "decimal", placeholder: "179.4", oninput: measured, "aria-label": "Measured height, mm" });
  function measured() { want.compensate = width.value && height.value ? `${width.value}x${height.value}` : ""; change(); }
  [width.value, height.value] = want.compensate ? want.compensate.split("x") : ["", ""];

  async function preview() {
    asking?.abort();
    asking = new AbortController();
    try {
      const p = await api("prints/preview", { method: "POST", body: body(), signal: asking.signal });
      urls.forEach(URL.revokeObjectURL);
      urls = p.pages.map((page) => URL.createObjectURL(new Blob([page.svg], { type: "image/svg+xml" })));
      sheets.replaceChildren(
        h("dl", { class: "figures" }, figure(p.landmarks, p.landmarks === 1 ? "landmark" : "landmarks"), figure(p.count, p.count === 1 ? "sheet" : "sheets"), figure(`${+p.size_mm.toFixed(1)} mm`, "outer side of the border"),
          figure(`${p.reads_from_m.toFixed(1)} m`, p.focal_from === "rig" ? `read from up to, with your rig (${p.focal_px.toFixed(0)} px)` : "read from up to, with a usual camera (600 px)")),
        ...p.warnings.map((w) => note("warn", w)),
        h("ul", { class: `sheets ${p.pages.length === 1 ? "one" : ""}` }, p.pages.map((page, k) => h("li", null, h("figure", null, h("img", { src: urls[k], alt: `Sheet ${k + 1}: ${page.title}`, width: page.mm[0], height: page.mm[1] }), h("figcaption", null, page.title))))),
        p.count > p.pages.length ? h("p", { class: "soft" }, `and ${p.count - p.pages.length} more sheets`) : "",
        h("div", { class: "stack" }, command(p.command)));
      make.disabled = false;
    } catch (error) {
      if (error.name === "AbortError") return;
      make.disabled = true;
      sheets.replaceChildren(trouble(error));
    }
  }
  const figure = (value, label) => h("div", null, h("dt", null, label), h("dd", null, value));
  const make = h("button", { class: "primary", type: "submit" }, "Make the PDF");
  async function submit(event) {
    event.preventDefault();
    make.disabled = true;
    make.textContent = "Reading every landmark back …";
    try {
      const made = await api("prints/pdf", { method: "POST", body: body() });
      results.replaceChildren(h("div", { class: "note good" }, h("b", null, `All ${made.landmarks} read back from the file.`), "Print at 100 %, in color, on matt paper; then check the size on the sheet's ruler.",
        h("div", { class: "row", role: "group" }, h("a", { class: "button primary", href: `${file(made.file)}?download` }, "Download"), h("a", { class: "button", href: file(made.file), target: "_blank", rel: "noopener" }, "Open"), h("span", { class: "small soft" }, made.file))));
      toast(`${made.file} is written`);
    } catch (error) { results.replaceChildren(trouble(error)); }
    make.textContent = "Make the PDF";
    make.disabled = false;
  }
  const family = choice(options.families.map((f) => [f.name, `${f.name} (${f.codes} codes)`]), want.family, (e) => { want.family = e.target.value; change(); });
  const template = choice([["", "none: as many as fit"], ...options.templates.map((t) => [t.name, `${t.name}: ${t.description}`])], want.template, (e) => { want.template = e.target.value; paper.disabled = Boolean(want.template); change(); });
  stage.append(...heading("Prints", "True to scale, and read back from the page before you get the file."),
    h("div", { class: "two" },
      h("form", { class: "card stack", onsubmit: submit },
        field("Codes", text("codes", { required: true }), "such as 0-11 or 3,7,42"),
        h("div", { class: "pairfields" }, field("Size", text("size", { placeholder: "180mm" }), "blank: the sheet's own"), field("Paper", paper)),
        field("Layout", template),
        h("details", { open: Boolean(want.text || want.compensate || want.mirror || want.family !== "lm8") }, h("summary", null, "More"), h("div", { class: "stack" },
          field("Family", family, "lm8 unless you have a reason"),
          field("Line of text", text("text"), "for layouts with a place for it, such as a4-door"),
          field("Name of the map", text("map_name"), "for layouts that show it"),
          h("fieldset", null, h("legend", null, "The last print measured, mm"), h("div", { class: "pairfields" }, width, height), h("span", { class: "hint" }, "Outer edges of the border. The next print corrects the printer.")),
          h("label", { class: "check" }, h("input", { type: "checkbox", checked: want.mirror, onchange: (e) => { want.mirror = e.target.checked; change(); } }), "Mirrored, for the inside of glass"))),
        h("div", { class: "row" }, make), results),
      h("section", { class: "card", "aria-label": "Preview" }, sheets)),
    project.prints.length ? h("section", { class: "card" }, h("h2", null, "Made before"), h("ul", null, project.prints.slice(0, 12).map((p) => h("li", null, h("a", { href: file(p.name), target: "_blank", rel: "noopener" }, p.name), h("span", { class: "soft small" }, ` ${(p.bytes / 1024).toFixed(0)} kB`))))) : "");
  await preview();
  return () => { clearTimeout(timer); asking?.abort(); urls.forEach(URL.revokeObjectURL); };
}
