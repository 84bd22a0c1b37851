import { api, choice, empty, field, file, fill, h, heading, jobView, toast, trouble } from "../lib.js";

export async function show(stage) {
  const [project, { jobs }] = await Promise.all([api("project"), api("jobs")]);
  const list = h("div");
  const size = h("input", { value: "180mm" });
  const lines = (placeholder) => h("input", { placeholder, autocomplete: "off", spellcheck: "false" }), walls = lines("12,44,137"), heights = lines("12,44");
  const groups = (input) => input.value.split(";").map((part) => part.replace(/\s+/g, "")).filter(Boolean);
  const none = h("p", { class: "soft" }, "Nothing has run yet.");
  list.append(...(jobs.length ? jobs.map((j) => jobView(j)) : [none]));
  const reports = h("div");
  function listReports(now) {
    const found = now.reports.filter((r) => r.name.endsWith(".html"));
    fill(reports, found.length ? h("section", { class: "card" }, h("h2", null, "Reports"), h("ul", null, found.map((r) => h("li", null, h("a", { href: file(r.name), target: "_blank", rel: "noopener" }, r.name))))) : null);
  }
  async function start(verb, source, extra) {
    try { const job = await api(`jobs/${verb}`, { method: "POST", body: { source, ...extra } }); none.remove(); list.prepend(jobView(job, { done: async (j) => { if (j.state === "done") toast(`${j.title}: done`); if (j.state === "done" && verb === "unbag") { stage.replaceChildren(); await show(stage); } else listReports(await api("project")); } })); list.closest("section").scrollIntoView({ block: "nearest" }); }
    catch (error) { list.prepend(trouble(error)); }
  }
  const what = (r) => [r.images ? "images of both cameras" : "saved detections", r.odometry ? "odometry" : null, r.gyro ? "gyro" : null].filter(Boolean).join(", ");
  stage.append(...heading("Recordings", "Survey a recording to build the map; track one to get the robot's trajectory. Jobs run in processes of their own."));
  if (project.recordings.length) {
    stage.append(h("section", { class: "card stack" }, h("div", { class: "pairfields" }, field("Landmark size", size, "outer side of the border")),
      h("details", null, h("summary", null, "What is known of the walls"), h("div", { class: "pairfields" }, field("On one flat wall", walls, "codes; a semicolon begins the next wall"), field("At the same height", heights, "codes; a semicolon begins the next height"))),
      project.has.pins ? h("p", { class: "small soft" }, "The pinned landmarks (pins.yaml) hold the map in place.") : null,
      project.recordings.map((r) => h("div", { class: "job" }, h("h2", null, r.name || "(project folder)"), h("p", { class: "soft small" }, `${what(r)}${r.own_rig ? ", its own rig" : project.has.rig ? ", rig.yaml of the project" : ", no rig yet"}`),
        h("div", { class: "row" }, h("button", { class: "primary", type: "button", onclick: () => start("survey", r.name, { size: size.value, walls: groups(walls), heights: groups(heights) }) }, "Survey: build the map"),
          h("button", { type: "button", onclick: () => start("track", r.name) }, "Track"), r.odometry ? h("button", { type: "button", onclick: () => start("track", r.name, { live: true }) }, "Track as if live") : null)))));
  } else {
    stage.append(empty("No recording yet", "Put a folder with left/ and right/ images (and odometry.csv if you have it), or a detections.csv, into drives/ of the project. A bag (.bag, .mcap) in the project can be unpacked here. Without cameras, write the example on the overview.", h("a", { class: "button primary", href: "#/" }, "To the overview")));
  }
  const bags = project.bags.filter((b) => !b.name.startsWith("runs/")); // those are replayed on the page Live
  if (bags.length) stage.append(h("section", { class: "card" }, h("h2", null, "Bags"), h("p", null, "Unpack a bag once, then it is listed among the recordings."), bags.map((b) => h("div", { class: "job" }, h("div", { class: "row" }, h("h3", null, b.name), h("button", { type: "button", onclick: () => start("unbag", b.name) }, "Unpack"))))));
  stage.append(h("section", { class: "card" }, h("h2", null, "Jobs"), list));
  stage.append(reports);
  listReports(project);
}
