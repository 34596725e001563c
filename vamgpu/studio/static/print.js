// Print: the rig and what it guarantees, the dry run, the start, the page of the print, and earlier prints.
import { get, path, reload, send, started, store, waits } from "./api.js";
import { button, card, day, empty, keeping, make, percent, put, select, table, time } from "./dom.js";
import { chosen, go, mark } from "./main.js";

const SURE = { guaranteed: "●", watched: "◐", believed: "○", "not there": "–" };
const ALIVE = ["starting", "printing", "paused", "held", "standby"];

export class PrintTab {
  constructor(root) {
    const rigs = store.workspace.rigs.map(({ id }) => id);
    this.rig = localStorage.getItem("rig");
    if (!rigs.includes(this.rig)) this.rig = rigs[0] || null;
    this.page = make("section", { class: "card live-print", "aria-label": "Print", hidden: true });
    this.machine = make("div", {});
    this.begin = make("div", { class: "stack" });
    this.past = make("div", {});
    root.append(make("div", { class: "split print" }, make("div", { class: "stack" }, this.page, this.machine, this.past), make("div", { class: "stack inspector" }, this.begin)));
    this.speed = "";
    this.turns = "";
    this.starting();
    this.show();
    this.history();
    this.guarantees();
  }

  starting() {
    const { result } = chosen, rigs = store.workspace.rigs.map(({ id }) => [id, id === "emulated" ? "emulated machines" : id]);
    if (!result) return this.begin.replaceChildren(empty("Nothing to print here", chosen.job ? "Solve the job first." : "Choose a job with a result at the left.", ...(chosen.job ? [button("To Solve", () => go("jobs", chosen.job.id, "solve"), { class: "primary" })] : [])));
    const own = store.tasks.filter(({ kind, result: of }) => ["rehearse", "print"].includes(kind) && of === result.id), dry = own.find(({ kind }) => kind === "rehearse"), print = own.find(({ kind }) => kind === "print");
    const busy = own.some(waits), good = result.verdict?.prints, request = (extra) => ({ result: result.id, rig: this.rig, speed: this.speed.trim() || null, turns: this.turns.trim() ? +this.turns : null, live: this.live && this.camera === this.rig, ...extra });
    const field = (name, key, hint, id) => make("label", { class: "field" }, make("span", {}, name), make("input", { value: this[key], placeholder: hint, "data-key": id, onchange: (event) => { this[key] = event.target.value; } }));
    const state = (task, text) => task && make("div", { class: "task" }, mark({ done: "good", failed: "bad", cancelled: "warn" }[task.state] || "busy"), make("span", {}, waits(task) ? `${text}: ${task.progress?.said || task.state}${task.progress?.share ? `, ${percent(task.progress.share, 0)}` : ""}` : `${text}: ${/^report /.test(task.message) ? "done; its report is under Earlier prints" : task.message || task.state}`));
    const confirm = make("input", { "aria-label": `Type ${result.id} to confirm`, placeholder: result.id, autocomplete: "off", spellcheck: "false", "data-key": "confirm", value: this.confirmed || "", oninput: (event) => {
      this.confirmed = event.target.value;
      start.disabled = held();
    } });
    const held = () => busy || (this.confirmed || "").trim() !== result.id || (!good && this.anyway !== result.id);
    const anyway = make("label", { class: "check", hidden: good }, make("input", { type: "checkbox", checked: this.anyway === result.id, "data-key": "anyway", onchange: (event) => {
      this.anyway = event.target.checked ? result.id : null;
      start.disabled = held();
    } }), make("span", {}, result.verdict ? "Print anyway, although it does not print in the simulation" : "Print anyway, without knowing whether it prints"));
    const start = button("Start the print", async () => {
      await send("POST", "tasks", { kind: "print", ...request({ anyway: !good, confirm: this.confirmed.trim() }) });
      this.confirmed = this.anyway = "";
      await Promise.all([reload.tasks(), reload.print()]);
    }, { class: "danger", disabled: held() });
    this.begin.replaceChildren(
      card("Machine", make("div", { class: "stack tight" }, rigs.length ? select("Rig file", rigs, this.rig, (value) => { this.rig = value; localStorage.setItem("rig", value); this.guarantees(); }, { "data-key": "rig" }) : make("p", { class: "soft" }, "No rig file in the workspace: put one there (see docs/machines.md)."),
        make("div", { class: "halves" }, field("Speed", "speed", "from the rig file", "speed"), field("Turns", "turns", "from the dose", "turns")),
        this.camera === this.rig && make("label", { class: "check" }, make("input", { type: "checkbox", checked: this.live, "data-key": "live", onchange: (event) => { this.live = event.target.checked; } }), make("span", {}, "Watch with the camera, and replan the patterns after each turn")))),
      card("1 · Dry run", make("div", { class: "stack tight" }, make("p", { class: "soft" }, "Prints on emulated machines, without light, and delivers the dose to a simulated vial."), state(dry, "Dry run"),
        make("div", { class: "row" }, button(dry ? "Repeat the dry run" : "Start the dry run", () => started({ kind: "rehearse", ...request({}) }), { class: dry?.state === "done" ? "" : "primary", disabled: busy || !this.rig })))),
      card("2 · Print", make("div", { class: "stack tight" },
        result.verdict ? make("p", { class: good ? "note good" : "note bad" }, result.verdict.sentence) : make("p", { class: "note" }, "This result was not simulated: whether it prints is unknown."),
        state(print, "Print"), make("p", { class: "soft" }, this.emulated === this.rig ? "These are emulated machines: no light is switched on." : "The lamp will light the vial. Close the enclosure first."),
        make("label", { class: "field" }, make("span", {}, `Type ${result.id} to confirm`), confirm), anyway, make("div", { class: "row" }, start))));
  }

  async guarantees() {
    if (!this.rig) return;
    const rig = this.rig;
    try {
      const now = await get(`rigs/${path(rig)}`);
      if (rig !== this.rig || this.closed) return;
      [this.emulated, this.camera] = [now.emulated ? rig : null, now.parts?.feedback?.some((each) => each.includes("camera")) ? rig : null];
      this.starting();
      const rows = now.guarantees.map((each) => make("tr", {}, make("th", { scope: "row" }, each.about), make("td", { class: `sure ${each.kind.replace(" ", "-")}` }, make("span", { "aria-hidden": "true" }, `${SURE[each.kind] || ""} `), each.kind), make("td", { class: "soft" }, each.remedy ? `${each.why}; ${each.remedy}` : each.why)));
      this.machine.replaceChildren(card(`Machine ${rig === "emulated" ? "(emulated)" : rig}: guaranteed, watched or believed`, now.refused ? make("p", { class: "note bad" }, now.refused) : null,
        table("Guarantees", { class: "guarantees", "aria-label": "Guarantees of the machine" }, ["what", "how sure", "why"], rows)));
    } catch (error) {
      if (!this.closed) this.machine.replaceChildren(card(`Machine ${rig}`, make("p", { class: "note bad" }, error.message)));
    }
  }

  /** The page of the print, as it is shown on the machine's host. */
  show() {
    const { run, state, page } = store.printing || {};
    if (!run) { this.page.hidden = true; this.page.replaceChildren(); this.shown = null; return; }
    if (this.shown === run) return;
    this.shown = run;
    this.page.hidden = false;
    const lively = ALIVE.includes(state);
    this.page.replaceChildren(make("div", { class: "row between" }, make("h2", {}, lively ? `Printing ${run}` : `Print ${run}`), make("a", { class: "button", href: page.replace(/^\//, ""), target: "_blank", rel: "noopener" }, "Open in its own tab")), make("iframe", { src: page.replace(/^\//, ""), title: `Page of the print ${run}` }));
  }

  history() {
    const rows = store.runs.map((run) => make("li", {}, mark(run.running ? "busy" : run.state === "complete" ? "good" : run.state === "error" ? "bad" : "warn"), make("span", {}, make("strong", {}, run.name), ` ${run.running ? "running" : run.state}`), make("small", {}, `${day(run.began)} · ${time(run.seconds)}${run.doubt ? ` · ${run.doubt} frames in doubt` : ""}${run.message ? ` · ${run.message}` : ""}`),
      make("div", { class: "row" }, button("Show", () => send("POST", "print/attach", { run: run.name }).then(reload.print), { class: "quiet", "aria-label": `Show ${run.name}` }), ...run.reports.map((page) => make("a", { class: "button", href: `api/v1/runs/${path(run.name, page)}`, target: "_blank", rel: "noopener", "aria-label": `Report of ${run.name}` }, "Report")))));
    this.past.replaceChildren(card("Earlier prints", rows.length ? make("ul", { class: "queue prints" }, rows) : make("p", { class: "soft" }, "None yet. Dry runs and prints of this workspace are listed here.")));
  }

  update(event) {
    keeping(() => {
      if (event === "print") { this.show(); this.history(); }
      if (["tasks", "task", "workspace"].includes(event)) this.starting();
    });
  }

  close() { this.closed = true; }
}
