// Look: the verdict, slices with the exposure under a slider, the printed surface, the light, and errors of the machine.
import { arrays, busy, get, path, started, url } from "./api.js";
import { histogram } from "./charts.js";
import { button, card, choice, empty, fixed, legend, length, make, number, percent, put, row, say, slider, table, time } from "./dom.js";
import { reel } from "./films.js";
import { chosen, go } from "./main.js";
import { SurfaceView } from "./scene.js";
import { Slices, printed, tally } from "./slices.js";

const OFF = [["axis", "Axis, across the light", "µm", 0, 200, 5, "um"], ["spread", "Lens blur added (σ)", "µm", 0, 100, 5, "um"], ["absorption", "Absorption", "%", -30, 30, 1, "%"], ["dose", "Dose", "%", -30, 30, 1, "%"]];
const signed = (value, digits = 0) => `${value > 0 ? "+" : ""}${fixed(value, digits)}`;

export class LookTab {
  constructor(root) {
    this.root = root;
    this.gain = 1;
    this.off = { axis: 0, spread: 0, absorption: 0, dose: 0 };
    this.proof = null;
    if (!chosen.result) {
      root.append(chosen.job ? empty("No result yet", "Solve the job first. Verdict, slices and surface appear here.", button("To Solve", () => go("jobs", chosen.job.id, "solve"), { class: "primary" }))
        : empty("No result here", "A part alone has none. Make a job with it, and solve it."));
      return;
    }
    root.append(make("p", { class: "soft" }, "Reading the result …"));
    this.load();
  }

  /** Path of something of the result, of the chosen exposure. */
  at(what, query = {}) {
    const all = new URLSearchParams({ ...query, ...(this.proof ? { proof: this.proof } : {}) }).toString();
    return `results/${path(chosen.result.id)}${what ? `/${what}` : ""}${all ? `?${all}` : ""}`;
  }

  async load() {
    const turn = (this.loading = (this.loading || 0) + 1);
    try {
      const result = await get(this.at(""));
      if (this.closed || turn !== this.loading) return;
      this.free();
      this.result = result;
      this.root.replaceChildren(this.verdict());
      if (result.verdict) this.root.append(this.layout());
      else this.root.append(this.light());
    } catch (error) {
      if (!this.closed) this.root.replaceChildren(make("p", { class: "note bad" }, error.message));
    }
  }

  verdict() {
    const { verdict, seconds, scores, report } = this.result, proving = busy("prove", "result", chosen.result.id);
    const prove = (text, tolerances) => button(proving ? "Simulating …" : text, () => started({ kind: "prove", result: chosen.result.id, device: null, tolerances }), { class: verdict ? "" : "primary", disabled: proving });
    if (!verdict) return make("section", { class: "verdict none", "aria-label": "Verdict" }, make("p", { class: "head" }, "Not simulated yet"), make("p", {}, "The frames are there. The simulation traces its own rays through them, and says whether the part prints."), make("div", { class: "row" }, prove("Simulate the print", false)));
    const figure = (value, name) => make("div", {}, make("b", {}, value), make("span", {}, name));
    const changed = chosen.job?.state === "changed" ? make("p", { class: "note" }, "The job file was changed after this result: solve again to see the effect.") : null;
    return make("div", { class: "stack" }, changed, make("section", { class: `verdict ${verdict.prints ? "good" : "bad"}`, "aria-label": "Verdict" },
      make("p", { class: "head", "data-testid": "verdict" }, verdict.sentence), verdict.remedies.map((each) => make("p", { class: "remedy" }, each)),
      (verdict.not_judged || []).length ? make("p", { class: "soft" }, `Not judged: ${verdict.not_judged.join("; ")}.`) : null,
      make("div", { class: "figures" }, figure(seconds === null ? "–" : time(seconds, 1), "exposure"), figure(verdict.latitude ? `${signed(100 * (verdict.latitude[0] - 1), 1)} … ${signed(100 * (verdict.latitude[1] - 1), 1)} %` : "–", "dose may vary by"),
        figure(scores ? fixed(scores.iou, 4) : "–", "IoU with the part"), figure(scores ? number(scores.missing) : "–", "voxels missing"), figure(scores ? number(scores.excess) : "–", "voxels in excess")),
      make("div", { class: "row" }, report ? make("a", { class: "button", href: report.replace(/^\//, ""), target: "_blank", rel: "noopener" }, "Open the report") : null, this.exports(), button("Print …", () => go(chosen.kind, chosen.id, "print")), this.choice())));
  }

  exports() {
    const formats = [["", "Export …"], ["png", "PNG frames"], ["tiff", "TIFF stack"], ["npz", "NumPy archive"], ["mp4", "MP4 film"], ["drtvam", "for Dr.TVAM"]];
    return make("select", { "aria-label": "Export the frames", onchange: async (event) => {
      const format = event.target.value;
      event.target.value = "";
      if (!format) return;
      try {
        await started({ kind: "export", result: chosen.result.id, format, canvas: null, fps: 30, overwrite: true });
        say(`exporting ${chosen.result.id}; the queue under Solve shows where the files are`);
      } catch (error) { say(error.message, true); }
    } }, formats.map(([value, text]) => make("option", { value }, text)));
  }

  choice() {
    const all = this.result.exposed || [];
    if (!all.length) return null;
    const named = ({ off }) => [...off.matchAll(/(axis|spread|absorption|dose)-(minus)?([\d.]+)/g)].map(([, key, less, value]) => `${key} ${less ? "−" : key === "axis" || key === "spread" ? "" : "+"}${value} ${key === "axis" || key === "spread" ? "µm" : "%"}`).join(", ") || off;
    return make("select", { "aria-label": "Exposure that is shown", onchange: (event) => { this.proof = event.target.value || null; this.load(); } },
      make("option", { value: "" }, "as designed"), all.map((each) => make("option", { value: each.proof, selected: each.proof === this.proof }, named(each))));
  }

  layout() {
    return make("div", { class: "cards" }, this.slices(), make("div", { class: "stack" }, this.surface(), this.doses()), this.errors(), this.light(), this.numbers());
  }

  exposed(gain) {
    const { seconds } = this.result;
    return seconds ? time(seconds * gain, 1) : `${signed(100 * (gain - 1))} %`;
  }

  slices() {
    this.panes = make("canvas", { class: "panes", role: "img", "aria-label": "Slices of target, dose and print", "data-testid": "slices" });
    this.where = make("span", { class: "soft" });
    this.live = make("p", { class: "live", "data-testid": "live" });
    this.exact = make("p", { class: "soft", role: "status", "data-testid": "exact" });
    const axes = choice("Direction of the slice", ["z", "y", "x"].map((axis) => [axis, `across ${axis}`]), "z", (axis) => { this.viewer?.set({ axis }); this.tell(); });
    this.place = make("input", { type: "range", min: 0, max: 1, step: 0.002, value: 0.5, "aria-label": "Place of the slice", oninput: (event) => { this.viewer?.set({ slice: +event.target.value }); this.tell(); } });
    this.exposure = slider("Exposure", { min: 0.5, max: 1.5, step: 0.002, value: this.gain, say: (gain) => this.exposed(gain), input: (gain) => this.expose(gain) });
    const made = card("Slices", make("div", { class: "stack" }, make("div", { class: "row between" }, axes, make("div", { class: "legend" }, legend("solid", "printed"), legend("missing", "missing"), legend("excess", "excess"), legend("heat", "dose, to 1.5 × what prints"))),
      this.panes, make("div", { class: "captions" }, make("span", {}, "target"), make("span", {}, "dose, with the part’s outline"), make("span", {}, "prints")),
      make("label", { class: "slider" }, make("span", {}, "Slice"), this.place, this.where), this.exposure, make("div", { class: "row between" }, this.live, button("As designed", () => { this.exposure.set(1); this.expose(1); this.settle(); })), this.exact));
    this.exposure.querySelector("input").addEventListener("change", () => this.settle());
    made.classList.add("wide");
    this.volumes();
    return made;
  }

  async volumes() {
    try {
      const [dose, target] = await Promise.all(["dose", "target"].map((of) => arrays(this.at("volume", { of, most: 128, dtype: "uint8" }))));
      if (this.closed) return;
      [this.dose, this.meta, this.most] = [dose.values, dose.meta, dose.meta.full];
      this.counts = tally(dose.values, target.values);
      this.viewer = new Slices(this.panes);
      if (!this.viewer.gl) return this.panes.replaceWith(make("p", { class: "note" }, "This browser has no WebGL 2: slices are in the report."));
      this.viewer.load("dose", dose.values);
      this.viewer.load("target", target.values);
      this.viewer.set({ most: this.most, gain: this.gain });
      this.watch = new ResizeObserver(() => this.viewer?.set({}));
      this.watch.observe(this.panes);
      this.bars = histogram(this.counts.inside, this.counts.outside, this.most, this.gain);
      this.plot.replaceChildren(this.bars);
      this.tell();
      this.expose(this.gain);
    } catch (error) { put(this.exact, error.message); }
  }

  tell() {
    if (!this.viewer) return;
    const { axis } = this.viewer.now, [z, y, x] = this.dose.shape, count = { z, y, x }[axis], low = { z: this.meta.low, y: this.meta.bottom, x: this.meta.left }[axis];
    const index = Math.min(count - 1, Math.floor(+this.place.value * count)), mm = low + (index + 0.5) * this.meta.pitch;
    put(this.where, `${axis} = ${fixed(mm, 2)} mm`);
    this.place.setAttribute("aria-valuetext", this.where.textContent);
  }

  /** What prints at an exposure, at once, from the volume that the page has. */
  expose(gain) {
    this.gain = gain;
    this.viewer?.set({ gain });
    this.bars?.move(gain);
    if (!this.counts) return;
    const { part, outside } = printed(this.counts, this.most, gain);
    put(this.live, `At ${this.exposed(gain)}${this.result.seconds && Math.abs(gain - 1) > 0.0005 ? ` (${signed(100 * (gain - 1), 1)} %)` : ""}: ${percent(part, 2)} of the part prints, and ${percent(outside, 2)} of the resin outside it.`);
  }

  /** When the slider rests: the exact counts of all voxels, and the surface of that exposure. */
  async settle() {
    const gain = this.gain;
    put(this.exact, "counting all voxels …");
    try {
      const { missing, excess, iou } = await get(this.at("exposure", { dose: gain }));
      if (gain !== this.gain || this.closed) return;
      put(this.exact, `All voxels: ${missing} missing, ${excess} in excess, IoU ${fixed(iou, 4)}.`);
      await this.mesh();
    } catch (error) { put(this.exact, error.message); }
  }

  surface() {
    this.solid = make("canvas", { class: "scene", tabindex: 0, role: "img", "aria-label": "Printed surface in three dimensions, colored by its deviation. Drag or use the arrow keys to turn, plus and minus to zoom." });
    this.mode = "deviation";
    const modes = choice("Surface that is shown", ["deviation", "printed", "target"].map((mode) => [mode, mode]), this.mode, (mode) => { this.mode = mode; this.mesh(); });
    this.scale = make("div", { class: "scale" });
    const { outer } = this.result, [x, y, z] = outer?.place || [], spot = outer?.place ? `${number(Math.hypot(x, y))} mm from the axis at z = ${number(z)} mm` : "beside the part";
    const stray = outer?.share >= 1 ? make("p", { class: "error" }, `Stray resin: the dose ${spot} reaches ${percent(outer.share, 0)} of what prints.`) : outer ? make("p", { class: "soft" }, `Brightest resin away from the part: ${percent(outer.share, 0)} of the dose that prints, ${spot}.`) : null;
    this.view = new SurfaceView(this.solid);
    this.meshes = {};
    this.mesh();
    return card("Printed surface", make("div", { class: "stack" }, modes, this.view.failed ? make("p", { class: "note" }, "This browser has no WebGL 2: the surface is in the report.") : this.solid, this.scale, stray));
  }

  async mesh() {
    const gain = this.gain, load = async (of) => {
      const made = await arrays(this.at("surface", of === "target" ? { of } : { of, dose: gain })).catch((error) => ({ error }));
      return made.error ? null : { points: made.positions.data, faces: made.indices.data, deviation: made.deviation?.data, meta: made.meta };
    };
    try {
      if (this.meshes.gain !== gain) Object.assign(this.meshes, { gain, printed: await load("printed"), stray: (this.result.outer?.share ?? 1) * gain >= 1 ? await load("stray") : null });
      if (this.mode === "target") this.meshes.target ||= await load("target");
      if (this.closed) return;
      const { printed: surface, target, stray } = this.meshes, most = surface?.meta.pitch || this.result.pitch || 0.05;
      this.view.surfaces({ printed: surface || { points: new Float32Array(0), faces: new Uint32Array(0) }, target, stray }, most, this.mode);
      this.scale.replaceChildren(...(this.mode === "deviation" ? [make("span", {}, `−${length(most)}`), make("i", { class: "diverging" }), make("span", {}, `+${length(most)}`), make("i", { class: "excess" }), make("span", {}, "stray")] : []));
    } catch (error) { say(error.message, true); }
  }

  doses() {
    this.plot = make("div", {}, make("p", { class: "soft" }, "loading …"));
    return card("Histogram of the dose", make("div", { class: "stack tight" }, this.plot, make("div", { class: "legend" }, legend("in", "inside the part"), legend("out", "outside"), legend("line", "solid from here on"))));
  }

  errors() {
    const rows = OFF.map(([key, name, unit, min, max, step]) => slider(name, { min, max, step, value: this.off[key], say: (value) => `${min < 0 ? signed(value) : fixed(value, 0)} ${unit}`, input: (value) => { this.off[key] = value; } }));
    const tolerances = this.result.tolerances, first = tolerances?.first || [], [known, unknown] = [(row) => !row.note, (row) => row.note].map((each) => (tolerances?.rows || []).filter(each));
    return card("If the machine is off", make("div", { class: "stack" }, make("p", { class: "soft" }, "Set errors, and expose the same frames again with them."), make("div", { class: "stack sliders" }, rows), make("div", { class: "row" }, button("Expose with these errors", async () => {
      const off = Object.fromEntries(OFF.filter(([key]) => this.off[key]).map(([key, , , , , , unit]) => [key, `${this.off[key]} ${unit}`]));
      if (!Object.keys(off).length) return say("set an error first", true);
      await started({ kind: "expose", result: chosen.result.id, device: null, off });
      say("exposing again; the result appears here");
    }, { class: "primary" }), tolerances ? null : button("Measure all tolerances", () => started({ kind: "prove", result: chosen.result.id, device: null, tolerances: true }))),
    known.length ? table("Tolerances", { "aria-label": "Windows with one error at a time" }, ["error", "window", "wrong voxels"],
      known.map((each) => row(`${each.name} ${each.change}`.replace("-", "−"), fixed(each.window, 3), number(each.wrong)))) : null,
    [...new Set(unknown.map(({ note }) => note))].map((note) => make("p", { class: "soft" }, `Not measured: ${[...new Set(unknown.filter((each) => each.note === note).map(({ name }) => name))].join(", ")} (${note}).`)),
    first.length ? make("h3", {}, "Errors that cause the first wrong voxel") : null, first.length ? make("ul", { class: "plain" }, first.map(({ name, text }) => make("li", {}, `${name}: ${text}`))) : null));
  }

  light() {
    const { frames } = this.result;
    if (!frames) return make("div");
    this.reel = reel(chosen.result.id, { ...frames, step: `${number(360 / frames.count)}° from one to the next over a full turn` });
    const sinogram = make("img", { class: "sinogram", alt: "Sinogram of a row: one line for each frame", src: `${url("results", chosen.result.id, "sinogram")}?row=${Math.floor(frames.rows / 2)}` });
    const row = slider("Row", { min: 0, max: frames.rows - 1, step: 1, value: Math.floor(frames.rows / 2), say: (value) => `${value + 1} of ${frames.rows}`, input: () => {} });
    row.querySelector("input").addEventListener("change", (event) => { sinogram.src = `${url("results", chosen.result.id, "sinogram")}?row=${event.target.value}`; });
    const made = card("Frames and sinogram", make("div", { class: "pair" }, this.reel,
      make("div", { class: "stack tight" }, sinogram, row, make("p", { class: "soft" }, "One line for each frame, the columns of one row across"))));
    made.classList.add("wide");
    return made;
  }

  numbers() {
    const lines = this.result.lines || [];
    if (!lines.length) return make("div");
    const made = card("All numbers", table("All numbers", { class: "numbers", "aria-label": "Numbers of the result" }, [],
      lines.map(({ name, value, meaning }) => make("tr", {}, make("th", { scope: "row" }, name), make("td", { class: "n" }, value.replace(/^-/, "−")), make("td", { class: "soft" }, meaning)))));
    made.classList.add("wide");
    return made;
  }

  update(event, task) {
    if (event === "tasks" && task && task.result === chosen.result?.id && task.state === "done" && ["prove", "expose"].includes(task.kind)) return this.load();
    if (event === "workspace" && chosen.result && !this.result) return this.load();
    if (event === "tasks" && this.result && !this.result.verdict) this.root.firstChild?.replaceWith(this.verdict());
  }

  free() {
    this.reel?.stop();
    this.watch?.disconnect();
    this.viewer?.close();
    this.view?.close();
    this.viewer = this.view = this.counts = null;
  }

  close() {
    this.closed = true;
    this.free();
  }
}
