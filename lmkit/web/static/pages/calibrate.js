import { api, choice, command, empty, field, fill, h, heading, jobView, mm, note, numberOf, s, toast, trouble } from "../lib.js";

const NONE = Array.from({ length: 5 }, () => Array(5).fill(false));
const goes = (job) => job.state === "running" || job.state === "waiting";
const NOTHING = { kept: 0, depth: [], curve: [], words: "starting" };
const BOTH = "the same: it shows both";
const options = (entries, value) => entries.map(([key, text]) => h("option", { value: key, selected: key === value }, text));

export async function show(stage) {
  let [project, { cameras }, { jobs: all }] = await Promise.all([api("project"), api("cameras"), api("jobs")]);
  const list = () => [...cameras.map((c) => [c, c]), ...project.pairs.map((p) => [p.name, `${p.name} (${p.count} pairs)`]), ...project.films.map((f) => [f.name, `${f.name} (video)`])];
  stage.append(...heading("Calibrate", "Show the board at many places and tilts. It stops when the depth error is as small as you ask for, not at a count."));
  const rig = rigCard();
  let sources = list();
  const problem = h("div"), film = h("input", { type: "file", accept: "video/*,.mp4,.avi,.mkv,.mov,.webm", onchange: () => film.files[0] && upload(film.files[0]) });
  async function upload(chosen) {
    fill(problem, h("p", null, "Uploading …"), h("progress", { "aria-label": "uploading" }));
    try {
      const { name } = await api(`films/${encodeURIComponent(chosen.name.replace(/[^A-Za-z0-9._-]+/g, "-") || "film.mp4")}`, { method: "PUT", body: chosen });
      toast(`${name} is stored`);
      if (!sources.length) { stage.replaceChildren(); await show(stage); return; }
      project = await api("project");
      sources = list();
      for (const [k, select] of [source, second].entries()) { const now = select.value; fill(select, ...options(k ? [["", BOTH], ...sources] : sources, k ? now : name)); }
      problem.replaceChildren();
    } catch (error) { problem.replaceChildren(trouble(error)); }
  }
  if (!sources.length) {
    stage.append(empty("No images of a board yet", "Print a board (lmkit board chessboard:9x6:25mm). Then plug the cameras in and reload, or record the board with both cameras side by side in one video, or put photographs into pairs/left and pairs/right of the project. Without cameras, write the example on the overview.", h("a", { class: "button primary", href: "#/" }, "To the overview")));
    stage.append(h("section", { class: "card stack" }, field("Add a video", film, "MP4, AVI, MOV, MKV, WebM"), problem), rig.card);
    await rig.again();
    return undefined;
  }
  const boards = sources.find(([name]) => /board/.test(name)) ?? sources[0];
  // Two cameras are a pair; everything else shows both, until someone says otherwise.
  const other = (name) => (/^camera:/.test(name) ? cameras.find((c) => c !== name) ?? "" : "");
  const source = choice(sources, boards[0], () => { if (/^camera:/.test(second.value) || /^camera:/.test(source.value)) second.value = other(source.value); }), second = choice([["", BOTH], ...sources], other(boards[0]));
  // Another square than that of the board makes every distance wrong, and no image shows it: what was given last stays.
  const remembered = `board of ${project.path}`;
  const board = h("input", { value: localStorage.getItem(remembered) ?? "chessboard:9x6:25mm", required: true, spellcheck: "false", autocomplete: "off" });
  const until = h("input", { value: "5", inputmode: "decimal" });
  const at = choice([["1", "1 m"], ["2", "2 m"], ["4", "4 m"], ["8", "8 m"]], "2");
  const tone = h("input", { type: "checkbox", checked: true });
  let sound = null, kept = 0, last = null, image = null, mine = all.find((j) => j.verb === "guide" && goes(j)) ?? null;
  const live = h("div"), jobs = h("div");
  const start = (verb) => async (event) => {
    event.preventDefault();
    const goal = numberOf(until.value);
    if (goal === null) return;
    live.replaceChildren();
    kept = 0;
    last = image = null;
    if (verb === "guide") draw({ state: "running", progress: NOTHING });
    sound ??= window.AudioContext ? new AudioContext() : null; // browsers let a page sound after a click only
    try {
      // The camera is needed again: what runs with it ends first.
      if (mine) await api(`jobs/${mine.id}/cancel`, { method: "POST" }).catch(() => null);
      mine = null;
      const body = { source: source.value, second: second.value, board: board.value, until_mm: goal, at_m: Number(at.value) };
      follow(await api(`jobs/${verb}`, { method: "POST", body }));
      localStorage.setItem(remembered, board.value);
      jobs.scrollIntoView({ block: "nearest" });
    } catch (error) { live.replaceChildren(); jobs.replaceChildren(trouble(error)); }
  };
  function follow(job) {
    const guided = job.verb === "guide";
    if (guided) mine = job;
    const ended = (j) => { if (guided) draw(j); if (mine?.id === j.id) mine = null; if (j.state === "done") toast("rig.yaml is written"); rig.again(); };
    jobs.replaceChildren(h("section", { class: "card" }, jobView(job, { progress: (j) => guided && mine?.id === j.id && draw(j), done: ended })));
  }
  function draw(job) {
    // The calibration after the guidance has a progress of its own.
    if (job.progress?.kept !== undefined) last = job.progress;
    const p = last;
    if (p === null) return;
    image = p.image ?? image; // the last state comes without one
    if (p.kept > kept && tone.checked) beep(sound, p.reached ? [660, 880, 1320] : [880]);
    kept = p.kept;
    const here = p.depth.find((d) => d.at_m === p.at_m), wanted = p.ghost && !p.reached && job.state === "running";
    const error = (at) => { const d = p.depth.find((e) => e.at_m === at); return d ? `± ${mm(d.error_m)}` : "–"; };
    const first = !live.firstChild;
    live.replaceChildren(h("section", { class: "card guidance", "aria-label": "Guidance" },
      p.reached ? note("good", `good to ${mm(here.error_m)} at ${p.at_m} m`, `${p.kept} pairs were enough for ${mm(p.until_m)}`)
        : job.state === "done" ? note("warn", `the source ended at ${here ? mm(here.error_m) : "an unknown error"} for ${mm(p.until_m)} at ${p.at_m} m`, p.advice?.length ? `next: ${p.advice[0]}; then run it again` : "add more pairs, nearer and tilted, and run it again")
        : note("", p.reason === "kept" ? `pair ${p.kept} is taken` : p.words ?? "looking", p.advice?.length ? `next: ${p.advice[0]}` : ""),
      h("figure", null, h("div", { class: "photo" }, image ? h("img", { src: image, alt: "Newest pair, left and right camera" }) : h("div", { class: "blank" }), wanted ? ghost(p.ghost) : null), h("figcaption", null, wanted ? "Dashed: hold the board here next." : "The newest pair, left and right camera.")),
      h("dl", { class: "figures" }, fact(p.kept, "pairs kept"), [1, 2, 4, 8].map((at) => fact(error(at), `in depth at ${at} m`)), fact(p.held_out_px ? `${p.held_out_px.toFixed(3)} px` : "–", "row error, held out")),
      h("p", { class: "small soft" }, !here ? "From six pairs on: the depth errors that the calibration causes." : `These are the errors that the calibration causes. One corner, matched to 0.1 px, is uncertain by ± ${mm(Math.sqrt(Math.max(here.total_m ** 2 - here.error_m ** 2, 0)))} at ${p.at_m} m besides, however good the calibration: that shrinks with more landmarks in view, a longer baseline or a longer lens.`),
      h("div", { class: "cover" }, (p.coverage ?? [NONE, NONE]).map((cells, k) => h("figure", null, s("svg", { viewBox: "0 0 5 3.6", role: "img", "aria-label": `Coverage of the ${k ? "right" : "left"} image: ${cells.flat().filter(Boolean).length} of 25 cells` }, cells.map((row, r) => row.map((yes, c) => s("rect", { class: yes ? "yes" : "no", x: c, y: r * 0.72, width: 1, height: 0.72 })))), h("figcaption", null, `${k ? "right" : "left"} image: where the board has been`)))),
      p.curve.length > 1 ? curve(p) : null));
    if (first && matchMedia("(max-width: 860px)").matches) live.scrollIntoView({ block: "start" }); // beside the form it is in view
  }
  const fact = (value, label) => h("div", null, h("dt", null, label), h("dd", null, value));
  stage.append(h("div", { class: "two" }, h("form", { class: "card stack", onsubmit: start("guide") }, field("Left camera", source, "or a folder with left/ and right/"), field("Right camera", second), field("Add a video", film, "MP4, AVI, MOV, MKV, WebM"), problem, field("Board", board, "inner corners and side of a square; or charuco:…, landmarks:… Print it with lmkit board"),
    h("div", { class: "pairfields" }, field("Good to, mm", until, "depth error by the calibration"), field("at", at)),
    h("label", { class: "check" }, tone, "A tone for every pair that is taken"),
    h("div", { class: "row" }, h("button", { class: "primary", type: "submit" }, "Calibrate with guidance"), h("button", { type: "button", onclick: start("calibrate") }, "Use all pairs"))), h("div", null, jobs, live)));
  stage.append(rig.card);
  if (mine) follow(mine); // begun before the page was opened, or in another window
  await rig.again();
  return () => sound?.close();
}

// The rig of the project: its cameras, another file in its place, undo.
function rigCard() {
  const card = h("section", { class: "card stack" }), problem = h("div");
  const change = (path, request) => async () => {
    problem.replaceChildren();
    try { draw(await api(path, request())); toast("rig.yaml is changed"); } catch (error) { problem.replaceChildren(trouble(error)); }
  };
  const pick = h("input", { type: "file", accept: ".yaml,.yml,.json,.xml,.txt", onchange: () => pick.files.length && change("rig", () => ({ method: "PUT", body: pick.files[0] }))() });
  // Where the left camera is on the robot: odometry, heights and coverage need it.
  function mounting(mount) {
    const inputs = [["height_m", "Height, m"], ["forward_m", "Ahead of the base, m"], ["left_m", "To its left, m"], ["turned_deg", "Turned left, deg"], ["raised_deg", "Raised, deg"]].map(([key, label]) =>
      [key, h("input", { value: mount ? +mount[key].toFixed(3) : key === "height_m" ? "" : "0", inputmode: "decimal", required: true }), label]);
    const body = () => Object.fromEntries(inputs.map(([key, input]) => [key, Number(input.value.replace(",", "."))]));
    return h("details", { open: !mount }, h("summary", null, mount ? "Where it is on the robot" : "Where is the left camera on the robot? Odometry and coverage need it"),
      h("form", { class: "stack", onsubmit: (e) => { e.preventDefault(); change("rig/mount", () => ({ method: "PUT", body: body() }))(); } }, h("div", { class: "pairfields" }, inputs.map(([, input, label]) => field(label, input))), h("div", { class: "row" }, h("button", { type: "submit" }, "Save to rig.yaml"))));
  }
  function draw(rig) {
    fill(card, h("h2", null, "rig.yaml"), rig.cameras.length ? h("dl", { class: "figures" }, rig.cameras.map((c) => h("div", null, h("dt", null, `${c.name}, ${c.size.join(" × ")}`), h("dd", null, `f ${c.focal_px.toFixed(0)} px`))), rig.cameras.slice(1).map((c) => h("div", null, h("dt", null, `${c.name} from ${rig.cameras[0].name}`), h("dd", null, `${(1000 * c.apart_m).toFixed(1)} mm`)))) : h("p", { class: "soft" }, "No rig yet: calibrate, or take a file that you have."),
      rig.cameras.length > 1 ? h("p", { class: "small soft" }, "Measure the distance between the lenses: if it differs, the board's squares are not as large as stated, and every distance is wrong by as much.") : null,
      rig.cameras.length ? mounting(rig.mount) : null,
      field(rig.cameras.length ? "Replace it by a file" : "Take a file", pick, "of lmkit, Kalibr, ROS or OpenCV"), rig.undo ? h("div", { class: "row" }, h("button", { type: "button", onclick: change("rig/undo", () => ({ method: "POST" })) }, "Undo")) : null, problem, rig.command ? command(rig.command) : null);
  }
  const again = async () => { try { draw(await api("rig")); } catch (error) { card.replaceChildren(trouble(error)); } };
  return { card, again };
}

const ghost = (outline) => s("svg", { viewBox: "0 0 1 1", preserveAspectRatio: "none", "aria-hidden": "true" }, s("polygon", { class: "ghost", points: outline.map((p) => p.join(",")).join(" ") }));

function beep(sound, tones) {
  if (!sound) return;
  tones.forEach((hertz, k) => {
    const source = sound.createOscillator(), loud = sound.createGain(), at = sound.currentTime + 0.13 * k;
    source.frequency.value = hertz;
    loud.gain.setValueAtTime(0.15, at);
    loud.gain.exponentialRampToValueAtTime(0.001, at + 0.12);
    source.connect(loud).connect(sound.destination);
    source.start(at);
    source.stop(at + 0.13);
  });
}

function curve(p) {
  const points = p.curve.filter(([, e]) => e !== null), [w, hh] = [480, 160];
  const top = Math.max(...points.map(([, e]) => e), p.until_m) * 1.1, first = points[0][0], last = Math.max(points.at(-1)[0], first + 1);
  const x = (n) => 46 + (w - 60) * (n - first) / (last - first), y = (e) => hh - 24 - (hh - 40) * e / top;
  return h("figure", null, s("svg", { class: "curve", viewBox: `0 0 ${w} ${hh}`, role: "img", "aria-label": `Expected depth error at ${p.at_m} m, from ${mm(points[0][1])} to ${mm(points.at(-1)[1])}` },
    s("line", { class: "axis", x1: 46, x2: w - 14, y1: y(0), y2: y(0) }), s("line", { class: "goal", x1: 46, x2: w - 14, y1: y(p.until_m), y2: y(p.until_m) }), s("text", { x: 0, y: y(p.until_m) + 4 }, mm(p.until_m)), s("text", { x: 0, y: 14 }, mm(top)),
    s("path", { d: points.map(([n, e], k) => `${k ? "L" : "M"}${x(n).toFixed(1)},${y(e).toFixed(1)}`).join("") }), s("text", { x: x(first), y: hh - 6 }, `${first} pairs`), s("text", { x: w - 14, y: hh - 6, "text-anchor": "end" }, `${points.at(-1)[0]} pairs`)), h("figcaption", null, `Depth error by the calibration at ${p.at_m} m; from 10 pairs on it may end`));
}
