// Navigation between the pages.
import { api, h, trouble } from "./lib.js";

const PAGES = [
  ["", "Overview", "overview"], ["prints", "Prints", "prints"], ["check", "Check a print", "check"], ["cameras", "Cameras", "cameras"],
  ["calibrate", "Calibrate", "calibrate"], ["map", "Map", "map"], ["live", "Live", "live"], ["recordings", "Recordings", "recordings"],
];
const main = document.getElementById("main");
let leave = null, turn = 0;

async function show(first) {
  const [, path, query] = location.hash.match(/^#\/?([a-z]*)\??(.*)$/) ?? [, "", ""];
  const [, title, module] = PAGES.find(([p]) => p === path) ?? PAGES[0];
  document.title = `${title} – lmkit`;
  document.getElementById("nav").replaceChildren(...PAGES.map(([p, text]) =>
    h("li", null, h("a", { href: `#/${p}`, "aria-current": text === title ? "page" : null }, text))));
  const mine = ++turn;
  leave?.();
  leave = null;
  try {
    const page = await import(`./pages/${module}.js`);
    if (mine !== turn) return;
    const stage = h("div");
    const ended = await page.show(stage, new URLSearchParams(query));
    if (mine !== turn) { ended?.(); return; }
    leave = ended ?? null;
    main.replaceChildren(stage);
  } catch (error) {
    main.replaceChildren(trouble(error));
  }
  main.dataset.ready = path || "overview";
  if (!first) { main.focus({ preventScroll: true }); scrollTo(0, 0); }
  document.querySelector("nav [aria-current]")?.scrollIntoView?.({ block: "nearest", inline: "center" });
}

addEventListener("hashchange", () => { delete main.dataset.ready; if (location.hash !== "#main") show(false); });
show(true);
api("project").then((p) => { document.getElementById("folder").textContent = `${p.path} · lmkit ${p.version}`; }).catch(() => {});
