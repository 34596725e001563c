// Solve: start, the queue, what runs, and two results side by side.
import { arrays, busy, get, path, reload, send, started, store, text, waits } from "./api.js";
import { curves } from "./charts.js";
import { button, card, day, empty, fixed, keeping, make, number, percent, put, row, select, table, time } from "./dom.js";
import { chosen, go, mark } from "./main.js";
import { Slices, heat } from "./slices.js";

export const KINDS = { solve: "Solve", model: "Model", prove: "Simulate", expose: "Expose with errors", orient: "Compare orientations", export: "Export", rehearse: "Dry run", print: "Print" };
const STATES = { queued: ["none", "waits"], running: ["busy", "running"], cancelling: ["busy", "stopping"], done: ["good", "done"], failed: ["bad", "failed"], cancelled: ["warn", "cancelled"] };

export class SolveTab {
  constructor(root) {
    if (!chosen.job && !chosen.result) {
      root.append(empty("No job to solve", chosen.part ? "Make a job with this part first, under Part." : "Choose a job at the left."));
      return;
    }
    this.want = { device: "", prove: true, fresh: false, evaluations: "" };
    this.start = make("div", {});
    this.now = make("div", { class: "stack" });
    this.queue = make("div", {});
    this.compare = make("div", { class: "stack" });
    root.append(make("div", { class: "split solve" }, make("div", { class: "stack" }, this.now, this.compare), make("div", { class: "stack inspector" }, this.start, this.queue)));
    this.fill();
    this.comparing();
    this.clock = setInterval(() => this.shown && this.task()?.state === "running" && this.running(), 1000); // time passes between events
  }

  /** The task to show at large: the newest of this job that solves or simulates. */
  task() {
    const own = store.tasks.filter(({ kind, job, result }) => ["solve", "model", "prove", "expose"].includes(kind) && (job === chosen.job?.id || (result && result === chosen.result?.id)));
    return own.find(({ state }) => state === "running" || state === "cancelling") || own.find(({ state }) => state === "queued") || own[0] || null;
  }

  fill() {
    this.starting();
    this.running();
    this.list();
  }

  starting() {
    const job = chosen.job, want = this.want;
    if (!job) return;
    const interrupted = job.state === "interrupted", invalid = chosen.file?.errors.length;
    const solving = busy("solve", "job", job.id);
    const check = (name, text_) => make("label", { class: "check" }, make("input", { type: "checkbox", checked: want[name], onchange: (event) => { want[name] = event.target.checked; } }), make("span", {}, text_));
    const stack = job.kind === "slices", verb = stack ? "Correct" : "Solve";
    const label = solving ? (stack ? "Correcting" : "Solving") : interrupted && !want.fresh ? "Continue" : job.state === "new" ? verb : `${verb} again`;
    this.start.replaceChildren(card(stack ? "Correct these slices" : "Solve this job", make("div", { class: "stack tight" },
      select("Device", [["", store.devices.length ? "best one" : "searching for devices …"], ...store.devices.map(({ name, description }) => [name, description || name])], want.device, (value) => { want.device = value; }, { "data-key": "device" }),
      stack ? null : check("prove", "Simulate the print afterwards, for the verdict"), interrupted ? check("fresh", "Start from scratch instead of continuing") : null,
      invalid ? make("p", { class: "error" }, "The job has a wrong value: see Machine and resin.") : null,
      button(label, () => started({ kind: "solve", job: job.id, device: want.device || null, prove: want.prove, fresh: want.fresh || ["changed", "solved", "proved"].includes(job.state), set: {} }), { class: "primary", disabled: solving || Boolean(invalid) }))));
  }

  running() {
    const task = this.task();
    if (!task) {
      this.shown = null;
      this.now.replaceChildren(empty("Not solved yet", "Start at the right. Progress, the window and slices of the dose appear here while the patterns are optimized."));
      return;
    }
    if (this.shown !== task.id) this.frame(task);
    const { progress, state } = task, working = waits(task), key = STATES[state] || ["none", state], solves = task.kind === "solve";
    this.parts.title.replaceChildren(mark(key[0]), make("h2", {}, `${KINDS[task.kind]} · ${task.job || task.result}`), make("span", { class: "soft" }, key[1]));
    const label = state === "queued" ? "Waits for the device" : working ? progress?.said || "starting" : task.message || key[1];
    put(this.parts.said, label[0].toUpperCase() + label.slice(1));
    this.parts.said.className = state === "failed" ? "error" : "stage";
    this.parts.bar.hidden = !working;
    if (progress?.share === null || progress?.share === undefined) this.parts.bar.removeAttribute("value"); else this.parts.bar.value = progress.share;
    this.parts.values.replaceChildren(...[
      working && ["time left", progress?.left === null || progress?.left === undefined ? "–" : time(progress.left)], ["time", time((task.ended || Date.now() / 1000) - (task.began || task.added))],
      solves && ["evaluations", number(progress?.evaluations ?? null)], solves && ["window", progress?.window === null || progress?.window === undefined ? "–" : fixed(progress.window, 3)], solves && ["loss", number(progress?.loss ?? null)],
    ].filter(Boolean).map(([name, value]) => make("div", {}, make("dt", {}, name), make("dd", {}, value))));
    this.buttons(task, working);
    const done = progress?.stages || [];
    this.parts.stages.replaceChildren(...done.map(({ said, seconds }) => make("li", {}, mark(seconds === null || seconds === undefined ? "busy" : "good"), make("span", {}, said), make("span", { class: "soft" }, time(seconds)))));
    this.parts.notes.replaceChildren(...[...(progress?.warnings || []).map((each) => make("p", { class: "note" }, each)), ...(progress?.notes || []).map((each) => make("p", { class: "soft" }, each))]);
    this.history(task);
  }

  frame(task) {
    this.shown = task.id;
    this.slices = this.evaluations = -1;
    const parts = (this.parts = { title: make("div", { class: "row title" }), said: make("p", { class: "stage", role: "status" }), bar: make("progress", { max: 1, "aria-label": "Progress" }), values: make("dl", { class: "values" }), buttons: make("div", { class: "row" }),
      stages: make("ul", { class: "stages" }), notes: make("div", { class: "stack tight" }), curve: make("div", {}), dose: make("canvas", { role: "img", "aria-label": "Middle slice of the dose so far" }), log: make("pre", { hidden: true, tabindex: 0, "aria-label": "Output of the command" }) });
    this.figure = make("figure", { class: "dose", hidden: true }, make("h3", {}, "Dose so far"), parts.dose, make("figcaption", {}, "Middle slice of the dose, with the part’s outline"));
    this.now.replaceChildren(make("section", { class: "card", "aria-label": "Progress" }, make("div", { class: "stack" }, parts.title, make("div", { class: "stack tight" }, parts.said, parts.bar), parts.values, parts.buttons,
      make("div", { class: "pair" }, make("div", { class: "stack" }, task.kind === "solve" ? [make("h3", {}, "Window after each evaluation"), parts.curve] : null, make("h3", {}, "Stages"), parts.stages), this.figure), parts.notes, parts.log)));
  }

  buttons(task, working) {
    const key = `${task.id}${task.state}${task.resumable}`;
    if (this.pressed === key && this.parts.buttons.childElementCount) return;
    this.pressed = key;
    const act = (verb) => () => send("POST", `tasks/${path(task.id)}/${verb}`).then(reload.tasks);
    this.parts.buttons.replaceChildren(...[
      working && button(task.state === "cancelling" ? "Stopping; press after 10 s to end it at once" : task.kind === "solve" ? "Stop; keep the patterns so far" : "Stop", act("cancel"), { class: "stop" }),
      !working && task.resumable && button("Continue", act("resume"), { class: "primary" }),
      task.state === "done" && task.result && button("Show the result", () => go(chosen.kind, chosen.id, "look"), { class: "primary" }),
      button("Output", async () => {
        this.parts.log.hidden = !this.parts.log.hidden;
        if (!this.parts.log.hidden) put(this.parts.log, await text(`tasks/${path(task.id)}/log`) || "nothing yet");
      }, { class: "quiet" }),
    ].filter(Boolean));
  }

  /** Reload curve and slice when the run has more of them. */
  async history(task) {
    const { evaluations = 0, slices = 0 } = task.progress || {}, ended = !waits(task);
    if (this.asking || (evaluations === this.evaluations && slices === this.slices && this.ended === ended)) return;
    this.asking = true;
    try {
      const more = slices > 0 && slices !== this.slices, [full, slice] = await Promise.all([get(`tasks/${path(task.id)}`), more ? arrays(`tasks/${path(task.id)}/slice`) : null]);
      [this.evaluations, this.slices, this.ended] = [evaluations, slices, ended];
      if (this.closed || this.shown !== task.id) return;
      const { evaluations: across = [], window: up = [] } = full.history || {}, chart = curves("Window after each evaluation", [{ points: across.map((each, k) => [each, up[k]]) }], { across: "evaluations" });
      this.parts.curve.replaceChildren(chart || make("p", { class: "soft" }, "It appears after the first evaluations."));
      if (slice) this.paint(slice);
    } catch { /* the next event asks again */ } finally { this.asking = false; }
  }

  paint({ dose, target }) {
    const [rows, columns] = dose.shape, canvas = this.parts.dose, pen = canvas.getContext("2d");
    canvas.width = columns;
    canvas.height = rows;
    const image = pen.createImageData(columns, rows), solid = (k) => target.data[k] > (target.data.BYTES_PER_ELEMENT === 1 ? 0 : 0.5);
    for (let k = 0; k < dose.data.length; k++) {
      const edge = solid(k) && (!solid(k - 1) || !solid(k + 1) || !solid(k - columns) || !solid(k + columns));
      image.data.set(edge ? [255, 255, 255, 255] : [...heat(dose.data[k] / 1.3), 255], 4 * k);
    }
    pen.putImageData(image, 0, 0);
    this.figure.hidden = false;
  }

  list() {
    const rows = store.tasks.slice(0, 12).map((task) => {
      const [sort, said] = STATES[task.state] || ["none", task.state], working = waits(task);
      return make("li", {}, mark(sort), make("span", {}, `${KINDS[task.kind] || task.kind} · ${task.job || task.result}`), make("small", {}, working ? `${said}${task.progress?.share ? ` · ${percent(task.progress.share, 0)}` : ""}${task.progress?.left ? ` · ${time(task.progress.left)} left` : ""}` : [said, ...(task.kind === "export" ? task.made || [] : []), day(task.ended || task.added)].join(" · ")),
        working ? button("Stop", () => send("POST", `tasks/${path(task.id)}/cancel`).then(reload.tasks), { class: "quiet", "aria-label": `Stop ${KINDS[task.kind]} of ${task.job || task.result}` }) : button("Clear", () => send("DELETE", `tasks/${path(task.id)}`).then(reload.tasks), { class: "quiet", "aria-label": `Remove ${KINDS[task.kind]} of ${task.job || task.result} from the list` }));
    });
    this.queue.replaceChildren(card("Queue", rows.length ? make("ul", { class: "queue" }, rows) : make("p", { class: "soft" }, "Nothing ran yet. One task runs at a time on a device; others wait here.")));
  }

  comparing() {
    const all = store.workspace.results.filter(({ state, kind }) => kind === "vial" && ["solved", "proved"].includes(state)).map(({ id }) => id), a = chosen.result?.id;
    if (!all.includes(a) || all.length < 2) return this.compare.replaceChildren();
    const others = all.filter((id) => id !== a), b = others.includes(this.other) ? this.other : "";
    this.table ||= make("div", { class: "stack" });
    this.compare.replaceChildren(card("Compare", make("div", { class: "stack" }, select(`${a} with`, [["", "choose another result"], ...others.map((id) => [id, id])], b, (id) => { this.other = id; this.show(a, id); }, { "data-key": "compare" }), this.table)));
  }

  async show(a, b) {
    this.panes?.close();
    this.panes = null;
    if (!b) return this.table.replaceChildren();
    try {
      const { rows, keys } = await get(`compare?a=${encodeURIComponent(a)}&b=${encodeURIComponent(b)}`);
      const cells = (list, first) => list.map((each) => row([each[first], each.meaning ? make("small", { class: "block" }, each.meaning) : null], String(each.a ?? "–"), String(each.b ?? "–")));
      this.table.replaceChildren(table("Results", { "aria-label": "Results of both" }, ["result", a, b], cells(rows, "name")), keys.length ? table("Keys", { "aria-label": "Keys that differ" }, ["key that differs", a, b], cells(keys, "key")) : make("p", { class: "soft" }, "Their job files have the same values."));
      await this.differ(a, b);
    } catch (error) { this.table.replaceChildren(make("p", { class: "note bad" }, error.message)); }
  }

  async differ(a, b) {
    const load = (id, of) => arrays(`results/${path(id)}/volume?of=${of}&most=128&dtype=uint8`), [one, two, part] = await Promise.all([load(a, "dose"), load(b, "dose"), load(a, "target")]).catch(() => []);
    if (!one || this.closed) return;
    if (String(one.values.shape) !== String(two.values.shape)) return this.table.append(make("p", { class: "soft" }, "Their grids differ, so slices are not subtracted."));
    const most = Math.max(one.meta.full, two.meta.full), scaled = ({ values, meta }) => ({ shape: values.shape, data: meta.full === most ? values.data : values.data.map((value) => Math.round((value * meta.full) / most)) });
    const canvas = make("canvas", { class: "panes", role: "img", "aria-label": "Slice of the dose, and the difference of both doses" });
    const height = make("input", { type: "range", min: 0, max: 1, step: 0.005, value: 0.5, "aria-label": "Height of the slice", oninput: (event) => this.panes.set({ slice: +event.target.value }) });
    this.table.append(canvas, make("div", { class: "captions two" }, make("span", {}, `dose of ${a}`), make("span", {}, `${a} − ${b}: blue more, red less, full color at 0.3`)), height);
    this.panes = new Slices(canvas, [1, 3]);
    this.panes.load("dose", scaled(one));
    this.panes.load("other", scaled(two));
    this.panes.load("target", part.values);
    this.panes.set({ most });
  }

  update(event) {
    if (!this.now) return;
    keeping(() => {
      if (event === "task") { this.running(); this.list(); }
      else if (["tasks", "devices", "job", "workspace"].includes(event)) { this.fill(); if (event === "workspace") this.comparing(); }
    });
  }

  close() {
    this.closed = true;
    clearInterval(this.clock);
    this.panes?.close();
  }
}
