// Part: the mesh in its vial, its size and orientation, its bodies, and how it should stand.
import { arrays, get, path, reload, send, started, store, waits } from "./api.js";
import { button, card, empty, facts, fixed, legend, length, make, number, put, row, say, select, time } from "./dom.js";
import { meant } from "./job.js";
import { chosen, free, go } from "./main.js";
import { PartView, ROLES } from "./scene.js";

const IDENTITY = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
const UNITS = [["mm", 1], ["µm", 0.001], ["cm", 10], ["m", 1000], ["inch", 25.4]];
const multiply = (a, b) => a.map((row) => b[0].map((_, c) => row.reduce((sum, value, k) => sum + value * b[k][c], 0)));
const SHOWN = 120000; // triangles
const DOSES = { gray: 0.7, "keep out": 0.7 }; // of roles that need one, until it is changed
const inMm = (text) => meant({ type: "quantity", unit: "mm" }, text);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

/** Rotation matrix about x, y or z by degrees. */
function about(axis, degrees) {
  const c = Math.cos((degrees * Math.PI) / 180), s = Math.sin((degrees * Math.PI) / 180);
  return { x: [[1, 0, 0], [0, c, -s], [0, s, c]], y: [[c, 0, s], [0, 1, 0], [-s, 0, c]], z: [[c, -s, 0], [s, c, 0], [0, 0, 1]] }[axis];
}

/** Angles [degree] about x, then y, then z of a rotation matrix. */
function angles(m) {
  const y = Math.asin(Math.max(-1, Math.min(1, -m[2][0])));
  return [Math.atan2(m[2][1], m[2][2]), y, Math.atan2(m[1][0], m[0][0])].map((each) => Math.round((each * 1800) / Math.PI) / 10 + 0);
}

/** Points and triangles of one body of a mesh. */
function piece({ positions, indices, owner }, number_) {
  const places = new Map(), points = [], faces = [];
  for (let k = 0; k < indices.data.length; k++) {
    if ((owner?.data[Math.floor(k / 3)] || 0) !== number_) continue;
    const corner = indices.data[k];
    if (!places.has(corner)) { places.set(corner, places.size); for (let c = 0; c < 3; c++) points.push(positions.data[3 * corner + c]); }
    faces.push(places.get(corner));
  }
  return { points: Float32Array.from(points), faces: Uint32Array.from(faces) };
}

const clean = (matrix) => matrix.map((row) => row.map((value) => +value.toFixed(6) + 0));

export class PartTab {
  constructor(root) {
    this.root = root;
    this.body = 0;
    if (!chosen.job && !chosen.part) {
      root.append(empty("This job folder has no job file here", "Its results are under Look. To print the part again, add its job file (TOML)."));
      return;
    }
    this.canvas = make("canvas", { class: "scene", tabindex: 0, role: "img", "aria-label": "The part in its vial, in three dimensions. Drag or use the arrow keys to turn the view, plus and minus to zoom." });
    this.caption = make("div", { class: "legend" });
    this.inspector = make("div", { class: "stack inspector" }, make("p", { class: "soft" }, "Reading the part …"));
    this.handles = make("button", { type: "button", "aria-pressed": "false", hidden: !chosen.job, onclick: () => this.toggle() }, "Turn the part");
    root.append(make("div", { class: "split" },
      make("div", { class: "viewer" }, this.canvas, make("div", { class: "over" }, this.handles, button("Reset the view", () => this.scene && this.view.vessel(this.stage()))), this.caption), this.inspector));
    this.view = new PartView(this.canvas, { turned: (matrix) => this.turn(matrix), picked: (body) => this.pick(body) });
    if (this.view.failed) this.canvas.replaceWith(make("p", { class: "note" }, "This browser has no WebGL 2, so the part is not drawn. Turn on hardware acceleration in the browser's settings. All fields work without it."));
    this.load();
  }

  toggle() {
    const on = this.handles.getAttribute("aria-pressed") !== "true";
    this.handles.setAttribute("aria-pressed", String(on));
    this.view.turnable(on);
  }

  async load() {
    const turn = (this.loading = (this.loading || 0) + 1), { job, part } = chosen;
    try {
      const [mesh, scene, about_] = await Promise.all([
        arrays(`${job ? `jobs/${path(job.id)}` : `parts/${path(part.id)}`}/mesh?most=${SHOWN}`).catch((error) => ({ error })),
        job ? get(`jobs/${path(job.id)}/scene`) : null,
        part ? get(`parts/${path(part.id)}`) : null,
      ]);
      if (turn !== this.loading || this.closed) return;
      [this.mesh, this.scene, this.about] = [mesh, scene, about_];
      this.place();
      this.fill();
    } catch (error) {
      if (!this.closed) this.inspector.replaceChildren(make("p", { class: "note bad" }, error.message));
    }
  }

  /** Put the mesh and the vessel into the view. */
  place() {
    const { mesh } = this;
    if (!mesh.error) {
      this.view.bodies(this.bodies().map(({ role }, n) => ({ ...piece(mesh, n), role })));
      const center = this.scene ? [0, 0, 0] : [0, 1, 2].map((k) => (this.about.low[k] + this.about.high[k]) / 2);
      this.view.place(IDENTITY, 1, center);
    }
    this.view.vessel(this.stage());
    this.caption.replaceChildren(...(this.scene ? [legend("glass", "vial"), legend("lit", "lit by the projector"), legend("fits", "printable: lit at every angle"), legend("beyond", "does not fit")] : [make("span", {}, "The part as drawn. Make a job to see it in a vial.")]));
  }

  stage() {
    if (!this.scene) {
      const extents = this.about.extents, radius = Math.hypot(extents[0], extents[1]) / 2;
      return { half_height: extents[2] / 2, reach: radius };
    }
    const { vessel, beam, grid, part } = this.scene, tall = beam?.height ?? (grid ? grid.shape[2] * grid.pitch : (part?.extents[2] ?? vessel?.inner ?? 10));
    const lit = beam ? (beam.reach ?? beam.width / 2) : null, printable = lit && Math.min(lit, vessel?.lit ?? vessel?.inner ?? Infinity);
    return { outer: vessel?.radius, inner: vessel?.inner, square: vessel?.shape === "box", lit, printable, half_height: tall / 2, beam: beam && [beam.width, beam.height] };
  }

  bodies() {
    const all = chosen.file?.fields.body, drawn = this.mesh.meta?.bodies || [];
    const named = (each, entry) => drawn.filter((body) => body.entry === entry).map((body) => ({ ...body, named: true, dose: body.role in DOSES ? each.dose : undefined }));
    if (Array.isArray(all)) return all.flatMap((each, entry) => each.roles ? named(each, entry) : [{ entry, role: each.role || "print", dose: each.dose, name: each.name || (each.part ? `${each.mesh}, part ${each.part}` : each.mesh || each.shape || `body ${entry + 1}`) }]);
    const solids = this.about?.bodies || [{}], file = chosen.part?.id || "part";
    return solids.map(({ name }, entry) => ({ entry, role: "print", said: name, name: name || (solids.length > 1 ? `${file}, part ${entry + 1}` : file) }));
  }

  fill() {
    const job = chosen.job, about_ = this.about, cards = [];
    if (this.mesh.error) cards.push(make("p", { class: "note bad" }, this.mesh.error.message));
    for (const { message } of this.scene?.problems || []) cards.push(make("p", { class: "note bad" }, message));
    for (const doubt of new Set([...(this.scene?.doubts || []), ...(about_?.doubts || [])])) cards.push(make("p", { class: "note" }, doubt));
    if (!job) cards.push(this.newJob());
    cards.push(card("Size", facts([
      about_ && ["file", about_.id], about_ && ["as drawn", `${about_.extents.map((each) => number(each)).join(" × ")} ${about_.unit}`],
      this.scene?.part && ["as printed", `${this.scene.part.extents.map((each) => number(each)).join(" × ")} mm`],
      this.scene?.part && ["reaches from the axis", length(this.scene.part.radius)],
      this.stage().printable && ["prints up to", length(this.stage().printable)],
      this.scene?.grid && ["voxels", this.scene.grid.shape.join(" × ")], this.scene?.grid && ["width of a voxel", length(this.scene.grid.pitch)],
      about_ && ["triangles", `${about_.triangles.toLocaleString("en")}${this.mesh.meta?.shown < this.mesh.meta?.triangles ? `, ${this.mesh.meta.shown.toLocaleString("en")} drawn` : ""}`],
    ])));
    if (job) cards.push(this.orientation(), this.roles(), this.standing());
    this.inspector.replaceChildren(...cards);
  }

  newJob() {
    const { extents } = this.about, lists = store.presets || { vials: [], projectors: [], resins: [] }, want = { vial: null, projector: null, resin: null };
    const list = (family) => [["", "choose later"], ...lists[family].map(({ id, name }) => [id, name])];
    let factor = 1;
    const name = make("input", { value: free(chosen.part.id), "aria-label": "Name of the job" });
    const height = make("input", { value: number(extents[2], 4), placeholder: "as drawn" });
    const doubt = this.about.doubts.some((each) => each.includes("unit")), fault = make("p", { class: "error", role: "alert" });
    const unit = select("Unit of the file", UNITS.map(([text, mm]) => [String(mm), `${text}: ${length(extents[2] * mm)} high`]), "1", (value) => {
      factor = +value;
      height.value = number(extents[2] * factor, 4);
    });
    return card("New job with this part", make("div", { class: "stack" },
      make("label", { class: "field" }, make("span", {}, "Name"), name), doubt || extents[2] > 60 || extents[2] < 1 ? unit : null,
      make("label", { class: "field" }, make("span", {}, "Height along the axis"), height),
      select("Vial", list("vials"), "", (value) => { want.vial = value || null; }),
      select("Projector", list("projectors"), "", (value) => { want.projector = value || null; }),
      select("Resin", list("resins"), "", (value) => { want.resin = value || null; }),
      fault, button("Make the job", async () => {
        put(fault, "");
        try {
          const made = await send("POST", "jobs", { name: name.value.trim(), part: chosen.part.id, height: inMm(height.value) || null, ...want });
          await reload.workspace();
          go("jobs", made.id, "part");
        } catch (error) { put(fault, error.message); }
      }, { class: "primary" })));
  }

  matrix() {
    const now = chosen.file?.value("target.orientation");
    return Array.isArray(now) ? now : IDENTITY;
  }

  /** Turn the part further, by a rotation matrix. */
  turn(matrix) {
    return this.save({ "target.orientation": clean(multiply(matrix, this.matrix())) });
  }

  async save(set, remove = []) {
    try { await chosen.file.edit(set, remove); } catch (error) { say(error.message, true); await this.load(); }
  }

  orientation() {
    const file = chosen.file, [x, y, z] = angles(this.matrix()), error = file.error("target.height") || file.error("target.factor") || file.error("target.orientation");
    const height = make("input", { value: file.value("target.height") ?? "", placeholder: "as drawn", "aria-invalid": error ? "true" : null, onchange: (event) => {
      const value = event.target.value.trim();
      this.save(value ? { "target.height": inMm(value) } : {}, value ? ["target.factor"] : ["target.height"]);
    } });
    const field = (text, value, change) => make("label", { class: "field" }, make("span", {}, text), make("input", { value: fixed(value, 1), inputmode: "decimal", onchange: (event) => change(+event.target.value.replace("−", "-")) }));
    const set = (a, b, c) => [a, b, c].every(Number.isFinite) ? this.save({ "target.orientation": clean(multiply(about("z", c), multiply(about("y", b), about("x", a)))) }) : say("an angle is a number of degrees, such as 37.5", true);
    return card("Height and orientation", make("div", { class: "stack" },
      make("label", { class: "field" }, make("span", {}, "Height along the axis"), height),
      error ? make("p", { class: "error" }, error.message) : null,
      make("div", { class: "thirds" }, field("Tilt about x, °", x, (v) => set(v, y, z)), field("Tilt about y, °", y, (v) => set(x, v, z)), field("Turn about z, °", z, (v) => set(x, y, v))),
      make("div", { class: "thirds" }, ["x", "y", "z"].map((axis) => button(`${axis} by 90°`, () => this.turn(about(axis, 90)), { "aria-label": `Turn about ${axis} by 90°` }))), make("div", { class: "row" }, button("As drawn", () => this.save({}, ["target.orientation"])))));
  }

  pick(number_) {
    this.body = number_;
    this.inspector.querySelectorAll("[data-body]").forEach((row) => row.classList.toggle("on", +row.dataset.body === number_));
    this.bodies().forEach(({ role }, n) => this.view.role(n, role, n === number_ && this.bodies().length > 1));
    this.inspector.querySelector(`[data-body="${number_}"] select`)?.focus();
  }

  roles() {
    const many = Array.isArray(chosen.file.fields.body), all = this.bodies();
    const says = many ? [] : (this.about?.bodies || []).map(({ role }) => role), asked = says.some((role) => role && role !== "print");
    const rows = all.map(({ role, name, dose, entry, named }, n) => make("div", { class: "body", "data-body": n },
      make("i", { class: `role ${role.replace(/[^a-z]/g, "")}` }),
      named ? make("span", {}, `${name}: ${role}`) : select(name, Object.keys(ROLES).map((each) => [each, each]), role, (value) => this.role(entry, value)),
      role in DOSES && !named ? make("label", { class: "field dose" }, make("span", {}, role === "gray" ? "Dose, of what prints" : "Dose below, of what prints"), make("input", { value: dose ?? "", inputmode: "decimal", "aria-label": `Dose of ${name}`, onchange: (event) => this.save({ [`body.${entry}.dose`]: +event.target.value }) })) : null,
      many && all.length > 1 && !named ? button("Remove", () => this.save({}, [`body.${entry}`]), { class: "quiet", "aria-label": `Remove ${name}` }) : null));
    const parts = store.workspace.parts.map(({ id }) => id);
    let adds = parts[0];
    return card("Bodies and their roles", make("div", { class: "stack tight" }, rows,
      asked ? make("div", { class: "row" }, button("Use the roles in their names", () => this.become(says))) : null,
      make("p", { class: "soft" }, many || all.length > 1 ? "Bodies keep their drawn positions. Click one in the view to choose its role." : "This job prints one body. Add another, as drawn in the same coordinates, to keep resin out or to print around an insert."),
      parts.length ? make("div", { class: "row nowrap" }, select("Add a body", parts.map((id) => [id, id]), adds, (value) => { adds = value; }),
        button("Add", () => this.add(adds))) : null));
  }

  add(part) {
    const count = (chosen.file.fields.body || this.bodies()).length, more = { [`body.${count}.mesh`]: part, [`body.${count}.role`]: "keep out", [`body.${count}.dose`]: DOSES["keep out"] };
    return Array.isArray(chosen.file.fields.body) ? this.save(more) : this.become({}, more);
  }

  /** Turn a job of one part into one of bodies: the part keeps its place by a factor and an origin. */
  async become(roles, more = {}) {
    const target = chosen.file.fields.target || {}, set = {}, all = this.bodies();
    all.forEach(({ said }, n) => {
      const role = roles[n] || "print";
      Object.assign(set, { [`body.${n}.${target.mesh ? "mesh" : "shape"}`]: target.mesh || target.shape, ...(all.length > 1 ? { [`body.${n}.part`]: n + 1 } : {}), ...(said ? { [`body.${n}.name`]: said } : {}), [`body.${n}.role`]: role, ...(role in DOSES ? { [`body.${n}.dose`]: DOSES[role] } : {}) });
    });
    Object.assign(set, more);
    if (chosen.part && this.mesh.positions) {
      const drawn = (await arrays(`parts/${path(chosen.part.id)}/mesh?most=${SHOWN}`)).positions.data, placed = this.mesh.positions.data, turn = this.matrix();
      const away = (points, k) => Math.hypot(points[k] - points[0], points[k + 1] - points[1], points[k + 2] - points[2]);
      let far = 3;
      for (let k = 3; k < drawn.length; k += 3) if (away(drawn, k) > away(drawn, far)) far = k;
      const factor = away(placed, far) / away(drawn, far);
      set["target.factor"] = +factor.toPrecision(6);
      set["target.origin"] = [0, 1, 2].map((axis) => +(drawn[axis] - dot(turn.map((row) => row[axis]), placed) / factor).toPrecision(5) + 0);
    }
    return this.save(set, ["mesh", "shape", "height"].filter((key) => key in target).map((key) => `target.${key}`));
  }

  role(n, value) {
    if (!Array.isArray(chosen.file.fields.body)) return this.become({ [n]: value });
    const without = [...(value in DOSES ? [] : ["dose"]), ...(value === "insert" ? [] : ["index", "absorption"])].filter((key) => key in chosen.file.fields.body[n]);
    const dose = value in DOSES && !("dose" in chosen.file.fields.body[n]) ? { [`body.${n}.dose`]: DOSES[value] } : {};
    return this.save({ [`body.${n}.role`]: value, ...dose }, without.map((key) => `body.${n}.${key}`));
  }

  standing() {
    this.found = make("div", {});
    this.stand();
    return card("How should it stand?", make("p", { class: "soft" }, "Solves the part coarsely in 20 orientations and lists the five best."), this.found);
  }

  stand() {
    if (!this.found) return;
    const task = store.tasks.find((each) => each.kind === "orient" && each.job === chosen.job.id), busy = waits(task);
    const start = button(task ? "Compare again" : "Compare orientations", () => started({ kind: "orient", job: chosen.job.id, device: null, count: 20 }), { disabled: busy });
    const parts = [];
    if (busy) parts.push(make("progress", { max: 1, value: task.progress?.share ?? 0, "aria-label": "Orientations compared" }),
      make("div", { class: "row between" }, make("span", { class: "soft" }, task.state === "queued" ? "waits in the queue" : `${task.progress?.said || "comparing"}${task.progress?.left ? ` · ${time(task.progress.left)} left` : ""}`),
        button("Cancel", () => send("POST", `tasks/${path(task.id)}/cancel`))));
    else if (task?.state === "failed") parts.push(make("p", { class: "error" }, task.message));
    else if (task?.orientations) parts.push(make("table", { class: "stands", "aria-label": "Orientations, best first" }, make("thead", {}, make("tr", {}, ["tilt", "towards", "window", "time", "height"].map((text, k) => make("th", { class: k ? "n" : "", scope: "col" }, text)), make("th", {}))),
      make("tbody", {}, task.orientations.map((each) => row(`${fixed(each.tilt, 0)}°`, each.tilt ? `${fixed(each.azimuth, 0)}°` : "–", fixed(each.window, 3), time(each.seconds), length(each.height),
        each.fits ? button("Use", () => this.save(each.set, each.remove || []), { "aria-label": `Use tilt ${fixed(each.tilt, 0)}°` }) : make("span", { class: "error" }, "too large"))))));
    if (!busy) parts.push(make("div", { class: "row" }, start));
    this.found.replaceChildren(make("div", { class: "stack tight" }, parts));
  }

  update(event, detail) {
    if (event === "job" && detail === chosen.file) this.load();
    if (event === "task" || event === "tasks") this.stand();
  }

  close() {
    this.closed = true;
    this.view?.close();
  }
}
