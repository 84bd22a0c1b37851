import { command, h, heading } from "../lib.js";

export async function show(stage) {
  stage.append(...heading("Cameras", "Cameras on this machine are looked at from the terminal; the page shows what a run sends it."),
    h("section", { class: "card stack" }, h("h2", null, "See what the cameras see"), h("p", null, "Detect landmarks in the first camera, image by image. A gray camera and exchanged colors are reported."), command("lmkit detect camera:0 --json")),
    h("section", { class: "card stack" }, h("h2", null, "Calibrate them"), h("p", null, "Guided capture keeps sharp and new pairs, and names the view to show next."), command("lmkit calibrate camera:0 camera:2 --board chessboard:9x6:25mm --capture --save-pairs pairs/today -o rig.yaml"), h("p", null, "Pairs saved under pairs/ appear on the page ", h("a", { href: "#/calibrate" }, "Calibrate"), ".")));
}
