import { api, h, heading, jobView, toast } from "../lib.js";

const step = (number, done, next, title, text, href, action) =>
  h("li", { class: `step ${done ? "done" : next ? "next" : ""}` }, h("span", { class: "mark", "aria-hidden": "true" }, done ? "✓" : number),
    h("h2", null, title), h("p", null, text), h("a", { href }, action));

const some = (list, one, several) => `${list.length} ${list.length === 1 ? one : several}`;

export async function show(stage) {
  const p = await api("project");
  const job = h("div");
  const tracks = p.reports.filter((report) => report.name.endsWith("-track.html"));
  const steps = [
    [p.prints.length > 0, "Print landmarks", p.prints.length ? some(p.prints, "file in prints/", "files in prints/") : "Choose codes and a size; the file is read back before you get it.", "#/prints", "Prints"],
    [p.photos.length > 0, "Check a print", p.photos.length ? some(p.photos, "photograph checked", "photographs checked") : "Photograph one sheet. Scale, colors and sharpness are graded.", "#/check", "Check a print"],
    [p.has.rig, "Calibrate the cameras", p.has.rig ? "rig.yaml is there" : "From photographs or a video of a board.", "#/calibrate", "Calibrate"],
    [p.has.map, "Build the map", p.has.map ? "map.yaml is there" : "Survey a recording: the map comes with its uncertainty.", "#/recordings", "Recordings"],
    [tracks.length > 0, "Track the robot", tracks.length ? some(tracks, "report in reports/", "reports in reports/") : "A trajectory through the map, with a report.", "#/recordings", "Recordings"],
  ];
  const next = steps.findIndex(([done]) => !done);
  const start = h("button", { type: "button", onclick: async () => {
    start.disabled = true;
    try { job.replaceChildren(jobView(await api("jobs/example", { method: "POST", body: {} }), { done: (j) => { start.disabled = false; if (j.state === "done") job.prepend(h("div", { class: "note good" }, h("b", null, "The example is in drives/example."), h("div", { class: "row" }, h("a", { href: "#/calibrate" }, "Calibrate with its video of a board"), h("a", { href: "#/recordings" }, "Survey its recording")))); } })); }
    catch (error) { start.disabled = false; toast(error.message, "bad"); }
  } }, "Write the example");
  stage.append(...heading("From print to pose", "Five steps; each writes files into the project's folder, and says the command that does the same."),
    h("ol", { class: "card stack", role: "list" }, steps.map(([done, title, text, href, action], k) => step(k + 1, done, k === next, title, text, href, action))),
    h("section", { class: "card stack" }, h("h2", null, "No cameras at hand?"), h("p", null, "A simulated room as files: calibration boards, a recording with odometry, a rig and a map. It goes into drives/example and takes some seconds."), start, job),
    p.address ? h("section", { class: "card" }, h("h2", null, "On the phone"), h("p", null, "Scan to open this page on the phone, and photograph prints with it."), h("img", { class: "qr", src: "/api/phone.png", alt: "QR code of this page's address" })) : "");
}
