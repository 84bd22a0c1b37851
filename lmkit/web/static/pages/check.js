import { api, choice, command, field, file, grade, h, heading, s, sentence, toast, trouble } from "../lib.js";

// Where on the landmark each line is measured, in its own square (0 to 1): bands and disks.
const WHERE = {
  "white margin": "margin", "border straightness": "border", "contrast of red": "border", "color of red": "border", "evenness": "all", "glare": "all",
  "ring and gap modulation": "rings", "contrast of blue": "rings", "color of blue": "rings", "decodability": "rings", "rotation margin": "rings", "sharpness": "all", "scale": "border", "X to Y": "border", "skew": "border",
};

export async function show(stage) {
  const project = await api("project");
  const results = h("div", { "aria-live": "polite" });
  const want = { size: "180mm", print: "", family: "lm8" };
  let photo = null, typed = false;
  const prints = project.prints.filter((p) => p.name.endsWith(".pdf"));
  const size = h("input", { value: want.size, oninput: (e) => { want.size = e.target.value; typed = true; } });
  const which = choice([["", "none: the size below"], ...prints.map((p) => [p.name, p.name])], "", (e) => { want.print = e.target.value; size.disabled = Boolean(want.print); });
  const input = h("input", { type: "file", accept: "image/*,.pdf", capture: "environment", onchange: () => input.files[0] && send(input.files[0]), "aria-label": "Photograph, scan or PDF" });
  const drop = h("div", { class: "drop",
    ondragover: (e) => { e.preventDefault(); drop.classList.add("over"); }, ondragleave: () => drop.classList.remove("over"),
    ondrop: (e) => { e.preventDefault(); drop.classList.remove("over"); if (e.dataTransfer.files[0]) send(e.dataTransfer.files[0]); } },
    h("p", null, h("strong", null, "Drop a photograph here, or choose one")), input,
    h("p", { class: "hint" }, "Put a bank card flat beside the landmark, or keep the whole sheet in view: then the size is measured too."));
  const again = h("button", { type: "button", hidden: true, onclick: check }, "Check again");
  // A PDF says its own size; one that is typed is compared with it.
  const body = () => ({ ...want, size: want.print || (!typed && /\.pdf$/i.test(photo)) ? "" : want.size });

  async function send(chosen) {
    photo = null;
    again.hidden = true;
    results.replaceChildren(h("p", null, "Uploading …"));
    try {
      const name = chosen.name.replace(/[^A-Za-z0-9._-]+/g, "-") || "photo.jpg";
      photo = (await api(`photos/${encodeURIComponent(name)}`, { method: "PUT", body: chosen })).name;
      await check();
    } catch (error) { results.replaceChildren(trouble(error)); }
  }
  async function check() {
    results.replaceChildren(h("div", { class: "card" }, h("p", null, "Reading and measuring …"), h("progress", { "aria-label": "reading" })));
    again.hidden = false;
    try { results.replaceChildren(...report(await api(`photos/${encodeURIComponent(photo)}/check`, { method: "POST", body: body() }))); }
    catch (error) { results.replaceChildren(trouble(error)); }
  }
  function report(answer) {
    return [...answer.results.map((item) => card(item, answer)), h("section", { class: "card stack" }, h("div", { class: "row" }, h("button", { type: "button", onclick: certify }, "Make the certificate (PDF)")), command(answer.command))];
  }
  async function certify(event) {
    event.target.disabled = true;
    try { const made = await api(`photos/${encodeURIComponent(photo)}/certificate`, { method: "POST", body: body() }); event.target.closest("section").append(command(made.command)); event.target.replaceWith(h("a", { class: "button primary", href: file(made.file), target: "_blank", rel: "noopener" }, "Open the certificate")); toast(`${made.file} is written`); }
    catch (error) { event.target.disabled = false; toast(error.message, "bad"); }
  }
  function card(item, answer) {
    const image = answer.results.find((r) => r.source === item.source && r.image);
    const lines = Object.entries(item.lines);
    const weak = lines.filter(([, l]) => l.grade && !"AB".includes(l.grade));
    const worst = [...weak].sort((a, b) => (a[1].grade < b[1].grade ? 1 : -1))[0];
    const past = (answer.history[`${item.family}:${item.code}`] ?? []).slice(-12);
    return h("section", { class: "card" },
      h("div", { class: "row whole" }, grade(item.grade, true), h("div", null, h("h2", null, `Landmark ${item.code}`), h("p", { class: "soft" }, [item.family, item.side_mm ? `${item.side_mm[0].toFixed(1)} × ${item.side_mm[1].toFixed(1)} mm, measured by the ${item.scale_from.replace(/^a(?=\d$)/, "A")}` : "size not measured"].join(", ")))),
      h("p", null, worst ? h("strong", null, `${worst[0][0].toUpperCase()}${worst[0].slice(1)}: ${worst[1].value}. ${sentence(worst[1].advice ?? "")}`) : "Everything that could be measured is good. Mount it."),
      h("div", { class: "two" },
        image ? h("figure", { class: "photo" }, h("img", { src: image.image, alt: `Photograph with landmark ${item.code} outlined`, width: item.width, height: item.height }), overlay(item, weak)) : h("div"),
        h("div", { class: "scroll", tabindex: "0", role: "region", "aria-label": "Grades line by line" }, h("table", null, h("thead", null, h("tr", null, h("th", { scope: "col" }, "Grade"), h("th", { scope: "col" }, "Line"), h("th", { scope: "col" }, "Measured"))),
          h("tbody", null, lines.map(([name, l]) => h("tr", null, h("td", null, grade(l.grade)), h("td", null, name), h("td", null, l.value, l.advice ? h("div", { class: "small soft" }, l.advice) : null))))))),
      past.length > 1 ? h("p", { class: "row small" }, "Checks so far: ", past.map((e) => h("span", { title: e.photo }, grade(e.grade)))) : null);
  }
  stage.append(...heading("Check a print", "Photograph a sheet from the front, a third of the image wide. Each line says what it measured."),
    h("section", { class: "card stack" }, drop,
      h("div", { class: "pairfields" }, field("The print", which, prints.length ? "its manifest says codes and size" : "make one on the page Prints to compare with it"), field("Intended size", size, "outer side of the border")), again),
    results);
  const known = project.photos.slice(0, 8);
  if (known.length) stage.append(h("section", { class: "card" }, h("h2", null, "Photographed before"), h("div", { class: "row" }, known.map((p) => h("button", { type: "button", onclick: () => { photo = p.name.replace(/^photos\//, ""); check(); } }, p.name.replace(/^photos\//, ""))))));
}

function overlay(item, weak) {
  const at = homography(item.corners);
  const path = (points) => `M${points.map(([x, y]) => at(x, y).map((v) => v.toFixed(1)).join(",")).join("L")}Z`;
  const square = (m) => [[-m, -m], [1 + m, -m], [1 + m, 1 + m], [-m, 1 + m]];
  const disk = (r) => Array.from({ length: 48 }, (_, k) => [0.5 + r * Math.cos(k * Math.PI / 24), 0.5 + r * Math.sin(k * Math.PI / 24)]);
  const shapes = { margin: () => path(square(0.06)) + path(square(0)), border: () => path(square(0)) + path(square(-0.07)), rings: () => path(disk(0.4)), all: () => path(square(0)) };
  const places = [...new Set(weak.map(([name]) => WHERE[name]).filter(Boolean))];
  return s("svg", { viewBox: `0 0 ${item.width} ${item.height}`, "aria-hidden": "true" },
    s("path", { class: "outline", d: path(square(0)), "vector-effect": "non-scaling-stroke" }),
    places.map((place) => s("path", { class: "weak", d: shapes[place](), "fill-rule": "evenodd", "vector-effect": "non-scaling-stroke" })));
}

// The plane of the landmark to pixels, from its four corners (top left, then clockwise).
function homography([[x0, y0], [x1, y1], [x2, y2], [x3, y3]]) {
  const dx1 = x1 - x2, dx2 = x3 - x2, sx = x0 - x1 + x2 - x3, dy1 = y1 - y2, dy2 = y3 - y2, sy = y0 - y1 + y2 - y3;
  const det = dx1 * dy2 - dx2 * dy1, g = (sx * dy2 - dx2 * sy) / det, k = (dx1 * sy - sx * dy1) / det;
  const a = x1 - x0 + g * x1, b = x3 - x0 + k * x3, d = y1 - y0 + g * y1, e = y3 - y0 + k * y3;
  return (u, v) => { const w = g * u + k * v + 1; return [(a * u + b * v + x0) / w, (d * u + e * v + y0) / w]; };
}
