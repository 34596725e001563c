// Three-dimensional views: a part in its vial, and a printed surface colored by its deviation.
import * as THREE from "./three.js";

export const ROLES = { print: "#2f6db3", gray: "#7d8a99", "keep out": "#c2559d", "don't care": "#b7a14a", insert: "#12939a" };
const PRINTS = ["print", "gray"]; // others may stand out of the light
const BAD = "#d63a49", STRAY = "#f09620", GLASS = "#8fb4cf", LIGHT = "#7c4fd0";
const DAY = { room: "#eef2f6", line: "#5a6677" }, DARK = { room: "#120000", line: "#ff8a70" };
/** Color of a role; paler in the dark room, where only its brightness is seen. */
const tint = (role) => new THREE.Color(ROLES[role] || ROLES.print).lerp(new THREE.Color("#ffffff"), dark() ? 0.55 : 0);
const dark = () => document.body.dataset.theme === "room";

/** A canvas that is drawn again only when something changed, with a camera that orbits about z. */
class View {
  constructor(canvas) {
    this.canvas = canvas;
    this.scene = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(28, 1, 0.1, 4000);
    this.camera.up.set(0, 0, 1);
    this.failed = false;
    try {
      this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true });
    } catch {
      this.failed = true; // no WebGL 2: the tab says so, and fields still work
      return;
    }
    this.orbit = new THREE.OrbitControls(this.camera, canvas);
    this.orbit.addEventListener("change", () => this.draw());
    this.scene.add(new THREE.HemisphereLight("#ffffff", "#8a8f98", 1.6));
    this.lamp = new THREE.DirectionalLight("#ffffff", 1.9);
    this.scene.add(this.lamp, this.lamp.target);
    this.watch = new ResizeObserver(() => this.draw());
    this.watch.observe(canvas);
    canvas.addEventListener("keydown", (event) => this.key(event));
  }

  /** Arrow keys turn the view, plus and minus zoom. */
  key(event) {
    const turn = { ArrowLeft: [0.12, 0], ArrowRight: [-0.12, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[event.key];
    const zoom = { "+": 0.9, "=": 0.9, "-": 1.1 }[event.key];
    if (!turn && !zoom) return;
    event.preventDefault();
    const away = this.camera.position.clone().sub(this.orbit.target);
    const radius = away.length() * (zoom || 1), [side, up] = turn || [0, 0];
    const around = Math.atan2(away.y, away.x) + side, high = Math.max(-1.5, Math.min(1.5, Math.asin(away.z / away.length()) + up));
    this.camera.position.set(Math.cos(around) * Math.cos(high), Math.sin(around) * Math.cos(high), Math.sin(high)).multiplyScalar(radius).add(this.orbit.target);
    this.orbit.update();
    this.draw();
  }

  /** Aim the camera so that a sphere about the axis fills the view. */
  frame(radius, height = 0) {
    if (this.failed) return;
    const away = 1.08 * Math.max(radius, 1e-3) / Math.sin((this.camera.fov * Math.PI) / 360);
    this.camera.near = away / 60;
    this.camera.far = away * 10;
    this.orbit.target.set(0, 0, height);
    this.camera.position.set(0.66, -0.66, 0.36).normalize().multiplyScalar(away).add(this.orbit.target);
    this.orbit.update();
    this.draw();
  }

  draw() {
    if (this.failed || this.queued) return;
    this.queued = true;
    requestAnimationFrame(() => { this.queued = false; this.render(); });
  }

  render() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    const ratio = Math.min(2, window.devicePixelRatio || 1);
    this.renderer.setPixelRatio(ratio);
    if (this.canvas.width !== Math.floor(width * ratio) || this.canvas.height !== Math.floor(height * ratio)) this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.fov = width < height ? (2 * Math.atan(Math.tan((14 * Math.PI) / 180) * (height / width)) * 180) / Math.PI : 28;
    this.camera.updateProjectionMatrix();
    this.renderer.setClearColor(dark() ? DARK.room : DAY.room);
    this.lamp.position.copy(this.camera.position).add(new THREE.Vector3(-0.4, 0.2, 0.9).multiplyScalar(this.camera.position.length()));
    this.renderer.render(this.scene, this.camera);
    this.canvas.dataset.drawn = String(+(this.canvas.dataset.drawn || 0) + 1);
  }

  close() {
    if (this.failed) return;
    this.watch.disconnect();
    this.orbit.dispose();
    this.scene.traverse((each) => { each.geometry?.dispose(); each.material?.dispose(); });
    this.renderer.dispose();
    this.renderer.forceContextLoss();
  }
}

/** Geometry from an array of points [x, y, z] and of triangles; colors [r, g, b] are optional. */
function geometry({ points, faces, colors }) {
  const made = new THREE.BufferGeometry();
  made.setAttribute("position", new THREE.BufferAttribute(points, 3));
  if (faces) made.setIndex(new THREE.BufferAttribute(faces, 1));
  if (colors) made.setAttribute("color", new THREE.BufferAttribute(colors, 3));
  made.computeVertexNormals();
  return made;
}

/** A circle about the axis, or the square around it. */
const ring = (radius, height, color, dashed = false, square = false) => {
  const sides = square ? 4 : 96, reach = square ? radius * Math.SQRT2 : radius, points = new Float32Array(3 * sides + 3);
  for (let k = 0; k <= sides; k++) {
    const angle = (2 * Math.PI * (k + (square ? 0.5 : 0))) / sides;
    points.set([reach * Math.cos(angle), reach * Math.sin(angle), height], 3 * k);
  }
  const made = new THREE.Line(geometry({ points }), dashed
    ? new THREE.LineDashedMaterial({ color, dashSize: radius / 14, gapSize: radius / 18 }) : new THREE.LineBasicMaterial({ color }));
  if (dashed) made.computeLineDistances();
  return made;
};

const tube = (radius, height, color, opacity, square = false) => {
  const reach = square ? radius * Math.SQRT2 : radius;
  const made = new THREE.Mesh(new THREE.CylinderGeometry(reach, reach, height, square ? 4 : 96, 1, true, square ? Math.PI / 4 : 0),
    new THREE.MeshBasicMaterial({ color, transparent: true, opacity, side: THREE.DoubleSide, depthWrite: false }));
  made.rotation.x = Math.PI / 2;
  made.renderOrder = 2;
  return made;
};

/** Material of a body with a role: red where a point that prints lies beyond the printable cylinder. */
function fitted(role, limits) {
  const made = new THREE.MeshStandardMaterial({ color: tint(role), roughness: 0.75, metalness: 0, side: THREE.DoubleSide, flatShading: true });
  made.onBeforeCompile = (shader) => {
    Object.assign(shader.uniforms, limits, { prints: made.userData });
    shader.vertexShader = shader.vertexShader.replace("#include <common>", "#include <common>\nvarying vec3 place;")
      .replace("#include <begin_vertex>", "#include <begin_vertex>\nplace = (modelMatrix * vec4(position, 1.0)).xyz;");
    shader.fragmentShader = shader.fragmentShader
      .replace("#include <common>", "#include <common>\nvarying vec3 place; uniform float reach; uniform float half_height; uniform vec3 beyond; uniform bool prints;")
      .replace("#include <color_fragment>", "#include <color_fragment>\nif (prints && (length(place.xy) > reach || abs(place.z) > half_height)) diffuseColor.rgb = beyond;");
  };
  made.userData.value = PRINTS.includes(role);
  return made;
}

/** A part in its vial. `turned` is called with the rotation matrix [3][3] after a handle was moved, `picked` with a body. */
export class PartView extends View {
  constructor(canvas, { turned, picked }) {
    super(canvas);
    if (this.failed) return;
    this.limits = { reach: { value: 1e9 }, half_height: { value: 1e9 }, beyond: { value: new THREE.Color(BAD) } };
    this.part = new THREE.Group();
    this.stage = new THREE.Group();
    this.scene.add(this.part, this.stage);
    this.handles = new THREE.TransformControls(this.camera, canvas);
    this.handles.setMode("rotate");
    this.handles.setSpace("world");
    this.handles.setSize(0.9);
    this.handles.addEventListener("change", () => this.draw());
    this.handles.addEventListener("dragging-changed", ({ value }) => {
      this.orbit.enabled = !value;
      if (!value) turned(this.rotation());
    });
    this.scene.add(this.handles.getHelper());
    let down = null;
    canvas.addEventListener("pointerdown", (event) => { down = [event.clientX, event.clientY]; });
    canvas.addEventListener("pointerup", (event) => {
      if (down && Math.hypot(event.clientX - down[0], event.clientY - down[1]) < 4) this.pick(event, picked);
    });
  }

  pick(event, picked) {
    const box = this.canvas.getBoundingClientRect(), ray = new THREE.Raycaster();
    ray.setFromCamera(new THREE.Vector2((2 * (event.clientX - box.left)) / box.width - 1, 1 - (2 * (event.clientY - box.top)) / box.height), this.camera);
    const [hit] = ray.intersectObjects(this.part.children);
    if (hit) picked(hit.object.userData.body);
  }

  rotation() {
    const e = new THREE.Matrix4().makeRotationFromQuaternion(this.part.quaternion).elements;
    return [[e[0], e[4], e[8]], [e[1], e[5], e[9]], [e[2], e[6], e[10]]];
  }

  /** Show bodies [{ points, faces, role }] of a part. */
  bodies(all) {
    if (this.failed) return;
    this.part.clear();
    all.forEach((body, number) => {
      const made = new THREE.Mesh(geometry(body), fitted(body.role, this.limits));
      made.userData.body = number;
      this.part.add(made);
    });
    this.draw();
  }

  /** Color of a body after its role changed; a chosen body glows. */
  role(number, role, chosen) {
    const body = this.part?.children[number];
    if (!body) return;
    body.material.color.set(tint(role));
    body.material.userData.value = PRINTS.includes(role);
    body.material.emissive.set(chosen ? "#223a55" : "#000000");
    this.draw();
  }

  /** Place the part: rotation matrix [3][3], scale, and the point of the turned mesh that stands at the center. */
  place(matrix, scale, center) {
    if (this.failed) return;
    const [a, b, c] = matrix, m = new THREE.Matrix4().set(...a, 0, ...b, 0, ...c, 0, 0, 0, 0, 1);
    this.part.quaternion.setFromRotationMatrix(m);
    this.part.scale.setScalar(scale);
    this.part.position.set(...center.map((value) => -value * scale));
    this.draw();
  }

  turnable(on) {
    if (this.failed) return;
    if (on) this.handles.attach(this.part); else this.handles.detach();
    this.draw();
  }

  /** Show the vessel: { outer, inner, square, lit, printable, half_height, beam: [width, height] }, lengths in mm. */
  vessel(now) {
    if (this.failed) return;
    this.stage.clear();
    this.limits.beyond.value.set(dark() ? "#ffffff" : BAD);
    this.limits.reach.value = now.printable ?? 1e9;
    this.limits.half_height.value = now.printable ? now.half_height : 1e9;
    const tone = dark() ? DARK : DAY, half = Math.max(now.half_height || 0, 1), high = 1.35 * half;
    const outer = now.outer || now.inner || now.lit || now.printable || now.reach || 10;
    const say = (...all) => this.stage.add(...all);
    for (const [radius, shade] of [[now.outer, 0.14], [now.inner, 0.1]])
      if (radius) say(tube(radius, 2 * high, GLASS, shade, now.square), ring(radius, high, GLASS, false, now.square), ring(radius, -high, GLASS, false, now.square));
    if (now.lit) say(ring(now.lit, half, LIGHT), ring(now.lit, -half, LIGHT));
    if (now.printable) say(tube(now.printable, 2 * half, "#1d9a5b", 0.05), ring(now.printable, half, "#1d9a5b", true), ring(now.printable, -half, "#1d9a5b", true));
    const axis = new THREE.Line(geometry({ points: new Float32Array([0, 0, -1.15 * high, 0, 0, 1.15 * high]) }),
      new THREE.LineDashedMaterial({ color: tone.line, dashSize: high / 12, gapSize: high / 20 }));
    axis.computeLineDistances();
    say(axis);
    if (now.beam) this.beam(now.beam, outer);
    this.frame(1.06 * Math.hypot(now.beam ? 1.25 * outer : outer, now.reach ? half : high));
  }

  /** The light at angle 0: its field, and where it goes. */
  beam([wide, tall], outer) {
    const say = (...all) => this.stage.add(...all), start = 1.5 * outer;
    const sheet = new THREE.Mesh(new THREE.PlaneGeometry(wide, tall), new THREE.MeshBasicMaterial({ color: LIGHT, transparent: true, opacity: 0.1, side: THREE.DoubleSide, depthWrite: false }));
    sheet.rotation.set(Math.PI / 2, Math.PI / 2, 0);
    sheet.position.x = start;
    say(sheet);
    for (const [y, z] of [[0, 0], [-0.35, 0.32], [0.35, 0.32], [-0.35, -0.32], [0.35, -0.32]])
      say(new THREE.ArrowHelper(new THREE.Vector3(-1, 0, 0), new THREE.Vector3(start, y * wide, z * tall), 0.36 * outer, LIGHT, 0.1 * outer, 0.045 * outer));
  }
}

const mix = (a, b, share) => a.map((value, k) => value + (b[k] - value) * share);
const TOO_SMALL = [0.77, 0.2, 0.26], TOO_LARGE = [0.18, 0.4, 0.71], EVEN = [0.85, 0.84, 0.84];

/** Colors of vertices by their deviation [mm]: red where the print is too small, blue where it is too large. */
function deviationColors(deviation, most) {
  const colors = new Float32Array(3 * deviation.length);
  for (let k = 0; k < deviation.length; k++) {
    const share = Math.max(-1, Math.min(1, deviation[k] / most));
    colors.set(mix(EVEN, share < 0 ? TOO_SMALL : TOO_LARGE, Math.abs(share)), 3 * k);
  }
  return colors;
}

/** A printed surface. */
export class SurfaceView extends View {
  /** Show surfaces { points, faces, deviation }, each vertex colored by its deviation [mm], and stray resin in orange. */
  surfaces({ printed, target, stray }, most, mode = "deviation") {
    if (this.failed) return;
    this.shown?.forEach((each) => { this.scene.remove(each); each.geometry.dispose(); each.material.dispose(); });
    this.shown = [];
    const add = (surface, material) => { const made = new THREE.Mesh(geometry(surface), material); this.shown.push(made); this.scene.add(made); };
    const matte = (color) => new THREE.MeshStandardMaterial({ color, roughness: 0.8, side: THREE.DoubleSide });
    const surface = mode === "target" ? target : printed;
    if (surface?.points.length) {
      const colored = mode === "deviation" && surface.deviation;
      const material = matte(colored ? "#ffffff" : mode === "target" ? "#9aa5b4" : ROLES.print);
      material.vertexColors = Boolean(colored);
      add(colored ? { ...surface, colors: deviationColors(surface.deviation, most) } : surface, material);
    }
    if (stray?.points.length && mode !== "target") add(stray, matte(STRAY));
    let far = 0;
    for (const { points } of [printed, target, stray].filter(Boolean))
      for (let k = 0; k < points.length; k += 3) far = Math.max(far, points[k] ** 2 + points[k + 1] ** 2 + points[k + 2] ** 2);
    if (this.size !== far) { this.size = far; this.frame(Math.sqrt(far)); }
    this.draw();
  }
}
