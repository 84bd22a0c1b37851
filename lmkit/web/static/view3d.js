// The map in three dimensions, with the robot: drawn when something changes, loaded when it is opened.
import * as T from "./vendor/three/three.module.min.js";
import { OrbitControls } from "./vendor/three/OrbitControls.js";
import { h } from "./lib.js";
import { frameOf } from "./plan.js";

const SURE = 2.796; // standard deviations that hold 95 % in three dimensions
const WALL_M = 2.5, TRAIL = 700;

export function view3d(box, { choose = null } = {}) {
  const canvas = h("canvas", { tabindex: "0", role: "img" });
  const renderer = new T.WebGLRenderer({ canvas, antialias: true });
  renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
  const scene = new T.Scene(), camera = new T.PerspectiveCamera(45, 1, 0.2, 500), room = new T.Group(), robot = robotParts();
  camera.up.set(0, 0, 1);
  scene.add(room, robot.group);
  const controls = new OrbitControls(camera, canvas), face = new T.TextureLoader().load("/static/icon.svg", later);
  face.colorSpace = T.SRGBColorSpace;
  controls.listenToKeyEvents(canvas);
  controls.maxPolarAngle = 0.55 * Math.PI;
  controls.addEventListener("change", later);
  let map = null, look = {}, asked = false, framed = false, plates = [];

  function later() {
    if (asked) return;
    asked = true;
    requestAnimationFrame(() => { asked = false; if (box.isConnected) renderer.render(scene, camera); });
  }
  function resize() {
    const [w, hh] = [box.clientWidth, box.clientHeight];
    if (!w || !hh) return;
    renderer.setSize(w, hh, false);
    camera.aspect = w / hh;
    camera.updateProjectionMatrix();
    later();
  }
  function show(given, options = {}) {
    [map, look] = [given, options];
    const { doubts = {}, chosen = null, gain = 0 } = look;
    const color = palette(canvas);
    scene.background = color("--page");
    for (const part of room.children) dispose(part);
    room.clear();
    plates = map.landmarks.map((l) => plate(l, face, doubts[l.id] ? color("--red") : l.id === chosen ? color("--blue") : null, color));
    room.add(...floorOf(map, color), ...(map.walls ?? []).map((w) => wallOf(w, color("--soft"))), ...plates);
    if (gain) room.add(...map.landmarks.filter((l) => l.spread).map((l) => ellipsoid(l.spread, l.position, gain, color(doubts[l.id] ? "--red" : "--blue"))));
    robot.paint(color);
    canvas.setAttribute("aria-label", `${map.landmarks.length} landmarks in 3D. Drag or press the arrow keys to move, scroll or press plus and minus to zoom`);
    if (!framed && map.landmarks.length) { framed = true; fit(); }
    later();
  }
  function fit() {
    const [x0, x1, y0, y1] = frameOf(map), size = Math.max(x1 - x0, y1 - y0, 1);
    controls.target.set((x0 + x1) / 2, (y0 + y1) / 2, 0.4);
    const far = size * Math.max(1, 1.25 / camera.aspect); // a window that is high sees less of the width
    camera.position.set((x0 + x1) / 2 - 0.25 * far, (y0 + y1) / 2 - 1.05 * far, 0.85 * far);
    controls.update();
  }
  function zoom(event) {
    const factor = { "+": 0.8, "=": 0.8, "-": 1.25 }[event.key];
    if (!factor) return;
    camera.position.lerpVectors(controls.target, camera.position, factor);
    controls.update();
  }
  function pick(event) {
    const at = canvas.getBoundingClientRect(), ray = new T.Raycaster();
    ray.setFromCamera(new T.Vector2(2 * (event.clientX - at.left) / at.width - 1, 1 - 2 * (event.clientY - at.top) / at.height), camera);
    const hit = ray.intersectObjects(plates, true)[0];
    if (hit) choose(hit.object.parent.name);
  }
  const again = () => map && show(map, look), scheme = matchMedia("(prefers-color-scheme: dark)"), watch = new ResizeObserver(resize);
  canvas.addEventListener("keydown", zoom);
  if (choose) canvas.addEventListener("click", pick);
  scheme.addEventListener("change", again);
  box.replaceChildren(canvas);
  resize();
  watch.observe(box);
  return {
    show,
    robot(states, k, gain) { robot.place(states, k, gain); later(); },
    close() { watch.disconnect(); scheme.removeEventListener("change", again); controls.dispose(); dispose(scene); face.dispose(); renderer.dispose(); renderer.forceContextLoss(); box.replaceChildren(); },
  };
}

// The colors of the style sheet, as it stands now.
function palette(element) {
  const look = getComputedStyle(element);
  return (name) => new T.Color(look.getPropertyValue(name).trim());
}

function dispose(part) {
  part.traverse((p) => { p.geometry?.dispose(); p.material?.map?.isCanvasTexture && p.material.map.dispose(); p.material?.dispose(); });
}

function plate(l, face, frame, color) {
  const group = new T.Group(), back = 1.15 * l.size_m, tall = 0.22;
  group.name = l.id;
  group.position.set(...l.position);
  group.quaternion.set(...l.quaternion);
  const mesh = new T.Mesh(new T.PlaneGeometry(l.size_m, l.size_m), new T.MeshBasicMaterial({ map: face }));
  mesh.position.z = 0.01;
  group.add(mesh, new T.Mesh(new T.PlaneGeometry(back * (frame ? 1.2 : 1), back * (frame ? 1.2 : 1)), new T.MeshBasicMaterial({ color: frame ?? 0xffffff, side: T.DoubleSide })));
  const name = new T.Sprite(new T.SpriteMaterial({ map: textOf(`${l.code}`, frame ?? color("--ink")), depthTest: false }));
  name.scale.set(2 * tall, tall, 1);
  name.position.set(0, l.size_m / 2 + 0.8 * tall, 0.02);
  group.add(name);
  return group;
}

function textOf(text, color) {
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [128, 64];
  const c = canvas.getContext("2d");
  c.font = "600 44px system-ui, sans-serif";
  c.textAlign = "center";
  c.fillStyle = `#${color.getHexString()}`;
  c.fillText(text, 64, 48);
  const texture = new T.CanvasTexture(canvas);
  texture.colorSpace = T.SRGBColorSpace;
  return texture;
}

function floorOf(map, color) {
  const [x0, x1, y0, y1] = frameOf(map), size = 2 * Math.ceil(Math.max(x1 - x0, y1 - y0, 2) / 2) + 2;
  const grid = new T.GridHelper(size, size, color("--line"), color("--line"));
  grid.rotation.x = Math.PI / 2;
  grid.position.set(Math.round((x0 + x1) / 2), Math.round((y0 + y1) / 2), 0);
  return [grid];
}

function wallOf({ start, end }, color) {
  const [dx, dy] = [end[0] - start[0], end[1] - start[1]];
  const mesh = new T.Mesh(new T.PlaneGeometry(Math.hypot(dx, dy), WALL_M), new T.MeshBasicMaterial({ color, transparent: true, opacity: 0.16, side: T.DoubleSide, depthWrite: false }));
  mesh.position.set((start[0] + end[0]) / 2, (start[1] + end[1]) / 2, WALL_M / 2);
  mesh.rotation.set(Math.PI / 2, 0, Math.atan2(dy, dx), "ZXY");
  return mesh;
}

// The image of the unit sphere under a Cholesky factor is the ellipsoid of the covariance.
function shape(C, at, gain) {
  const root = (v) => Math.sqrt(Math.max(v, 1e-18)), k = SURE * gain;
  const a = root(C[0][0]), b = C[1][0] / a, c = C[2][0] / a, d = root(C[1][1] - b * b), e = (C[2][1] - b * c) / d, f = root(C[2][2] - c * c - e * e);
  return new T.Matrix4().set(k * a, 0, 0, at[0], k * b, k * d, 0, at[1], k * c, k * e, k * f, at[2], 0, 0, 0, 1);
}

function ellipsoid(C, at, gain, color) {
  const mesh = new T.Mesh(new T.SphereGeometry(1, 24, 16), new T.MeshBasicMaterial({ color, transparent: true, opacity: 0.25, depthWrite: false }));
  mesh.matrixAutoUpdate = false;
  mesh.matrix.copy(shape(C, at, gain));
  return mesh;
}

function robotParts() {
  const arrow = new T.Shape([[0.3, 0], [-0.17, 0.17], [-0.09, 0], [-0.17, -0.17]].map(([x, y]) => new T.Vector2(x, y)));
  const body = new T.Mesh(new T.ExtrudeGeometry(arrow, { depth: 0.12, bevelEnabled: false }), new T.MeshBasicMaterial());
  const sure = ellipsoid([[0, 0, 0], [0, 0, 0], [0, 0, 0]], [0, 0, 0], 1, 0xff0000);
  const points = new T.BufferAttribute(new Float32Array(3 * TRAIL), 3), geometry = new T.BufferGeometry().setAttribute("position", points);
  const trail = new T.Line(geometry, new T.LineBasicMaterial()), group = new T.Group();
  trail.frustumCulled = false;
  group.visible = false;
  group.add(body, sure, trail);
  return {
    group,
    paint(color) { body.material.color = color("--red"); sure.material.color = color("--red"); trail.material.color = color("--soft"); },
    place(states, k, gain) {
      const { state } = states[k], at = state.position;
      group.visible = true;
      body.visible = Boolean(at);
      sure.visible = Boolean(at && state.covariance);
      if (at) { body.position.set(...at); body.quaternion.set(...(state.quaternion ?? [0, 0, 0, 1])); }
      if (sure.visible) sure.matrix.copy(shape(state.covariance, at, gain));
      const places = states.slice(Math.max(0, k + 1 - TRAIL), k + 1).map((e) => e.state.position).filter(Boolean);
      places.forEach((p, n) => points.setXYZ(n, p[0], p[1], p[2] + 0.02));
      points.needsUpdate = true;
      geometry.setDrawRange(0, places.length);
    },
  };
}
