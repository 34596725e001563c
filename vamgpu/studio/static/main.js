// The frame of the page: the workspace at the left, the tabs, what is dropped, and the connection.
import { JobFile, Refused, follow, get, on, path, reload, send, store, upload } from "./api.js";
import { ask, at, bytes, button, day, draw, empty, make, percent, put, say } from "./dom.js";
import { PartTab } from "./part.js";
import { JobTab } from "./job.js";
import { SolveTab } from "./solve.js";
import { LookTab } from "./look.js";
import { PrintTab } from "./print.js";

const TABS = [["part", "Part", PartTab], ["job", "Machine and resin", JobTab], ["solve", "Solve", SolveTab], ["look", "Look", LookTab], ["print", "Print", PrintTab]];
const SHAPES = {
  good: "M2.5 7.5l3 3 6-7", bad: "M3 3l8 8M11 3l-8 8", warn: "M7 2v6.5M7 11v1", busy: "M7 2a5 5 0 1 1-5 5", none: "M7 7h.01",
};
const STATES = {
  new: ["none", "not solved"], queued: ["busy", "waits in the queue"], running: ["busy", "solving"], interrupted: ["warn", "interrupted; can go on"],
  solved: ["none", "solved, not simulated"], proved: ["good", "prints"], not: ["bad", "does not print"], changed: ["warn", "changed since it was solved"],
  invalid: ["bad", "has a wrong value"], damaged: ["bad", "damaged"], web: ["none", "web"],
};

/** What is chosen, and its job, part and result as the workspace has them. */
export const chosen = { kind: null, id: null, tab: "part", job: null, part: null, result: null, file: null };
let open = null, turns = 0;

/** Choose a part, job or result of the workspace, and a tab. */
export function go(kind, id, tab = chosen.tab) {
  location.hash = `#${kind}/${encodeURIComponent(id)}/${tab}`;
}

function resolve() {
  const { parts, jobs, results } = store.workspace, find = (list, id) => list.find((each) => each.id === id) || null;
  chosen.result = chosen.kind === "results" ? find(results, chosen.id) : null;
  chosen.job = chosen.kind === "jobs" ? find(jobs, chosen.id) : chosen.result?.job ? find(jobs, chosen.result.job) : null;
  chosen.result ||= chosen.job?.result ? find(results, chosen.job.result) : null;
  chosen.part = find(parts, chosen.kind === "parts" ? chosen.id : chosen.job?.part);
  if (!chosen.job && !chosen.part && !chosen.result) chosen.kind = chosen.id = null;
}

function first() { // what the command line named, else the newest job
  const { opened, jobs, parts, results } = store.workspace, newest = [...jobs].sort((a, b) => b.modified - a.modified)[0];
  for (const [kind, list, tab] of [["jobs", jobs, "part"], ["parts", parts, "part"], ["results", results, "look"]])
    if (list.some(({ id }) => id === opened)) return [kind, opened, tab];
  return newest ? ["jobs", newest.id, newest.state === "proved" ? "look" : "part"] : parts[0] ? ["parts", parts[0].id, "part"] : [null, null, "part"];
}

async function route() {
  const [kind, id, tab] = location.hash ? location.hash.slice(1).split("/") : first();
  const before = `${chosen.kind}/${chosen.id}`;
  [chosen.kind, chosen.id] = [kind, id && decodeURIComponent(id)];
  chosen.tab = TABS.some(([key]) => key === tab) ? tab : "part";
  resolve();
  if (before !== `${chosen.kind}/${chosen.id}` || !chosen.file || chosen.file.id !== chosen.job?.id) chosen.file = null;
  at("side").classList.remove("open");
  at("menu").setAttribute("aria-expanded", "false");
  await show();
}

/** Show the chosen tab anew. */
export async function show() {
  const turn = ++turns;
  if (chosen.job && !chosen.file) {
    try { chosen.file = await new JobFile(chosen.job.id).load(); } catch (error) { say(error.message, true); }
    if (turn !== turns) return;
  }
  open?.close();
  side();
  head();
  tabs();
  const root = at("panel"), Tab = TABS.find(([key]) => key === chosen.tab)[2];
  root.replaceChildren();
  root.scrollTop = 0;
  root.setAttribute("aria-label", TABS.find(([key]) => key === chosen.tab)[1]);
  open = chosen.kind || chosen.tab === "print" ? new Tab(root) : nothing(root);
}

function nothing(root) {
  root.append(empty("Start with a part", "Drop an STL, 3MF, PLY or OBJ file anywhere on this page, or a job file (TOML). Or try the bundled boat.",
    button("Choose a file …", choose, { class: "primary" }), button("Use the bundled boat", async () => {
      const made = await send("POST", "jobs", { name: free("boat"), part: null, height: null, vial: null, projector: null, resin: null });
      await reload.workspace();
      go("jobs", made.id, "part");
    })));
  return { close() {} };
}

/** A name that no job of the workspace has yet. */
export function free(name) {
  const taken = new Set(store.workspace.jobs.map(({ id }) => id)), base = name.replace(/\.[^.]+$/, "");
  let made = base;
  for (let k = 2; taken.has(`${made}.toml`); k++) made = `${base}-${k}`;
  return made;
}

export const mark = (kind) => draw("svg", { class: `mark ${kind}`, viewBox: "0 0 14 14", "aria-hidden": "true" }, draw("path", { d: SHAPES[kind] || SHAPES.none }));

function side() {
  if (!store.workspace) return;
  const { parts, jobs, results, trash } = store.workspace, row = (kind, id, sort, note) => make("li", {},
    make("button", { type: "button", "aria-current": chosen.kind === kind && chosen.id === id ? "true" : null, title: id, onclick: () => go(kind, id, kind === "parts" ? "part" : kind === "results" && !["look", "print"].includes(chosen.tab) ? "look" : chosen.tab) },
      mark(sort), make("span", {}, id), make("small", {}, note)));
  const group = (title, rows, none) => make("div", {}, make("h2", {}, title), rows.length ? make("ul", {}, rows) : make("p", { class: "none" }, none));
  const state = (job) => STATES[job.state === "proved" && results.find(({ id }) => id === job.result)?.verdict?.prints === false ? "not" : job.state] || ["none", job.state];
  const own = new Set(jobs.map(({ result }) => result)), others = results.filter(({ id }) => !own.has(id));
  at("side").replaceChildren(...[
    button("Add a part or job …", choose, { class: "add" }),
    group("Jobs", jobs.map((job) => row("jobs", job.id, ...state(job))), "None yet. Choose a part, then make a job."),
    group("Parts", parts.map((part) => row("parts", part.id, "none", bytes(part.bytes))), "None yet. Drop an STL here."),
    others.length ? group("Job folders", others.map((each) => row("results", each.id, ...(STATES[each.verdict?.prints === false ? "not" : each.state] || ["none", each.state])))) : "",
    group("Prints", store.runs.slice(0, 6).map((run) => make("li", {}, make("button", { type: "button", title: run.name, onclick: () => { location.hash = `#${chosen.kind || "none"}/${encodeURIComponent(chosen.id || "")}/print`; } },
      mark(run.running ? "busy" : run.state === "complete" ? "good" : "warn"), make("span", {}, run.name), make("small", {}, `${run.running ? "running" : run.state} · ${day(run.began)}`)))), "None yet."),
    trash ? make("p", { class: "none" }, `${trash} in the folder “trash” of the workspace`) : "",
  ].filter(Boolean));
  put(at("place"), store.workspace.name);
}

function head() {
  const { kind, id, job, part, result } = chosen, actions = [];
  put(at("title"), id || "Workspace");
  put(at("subtitle"), job ? [part ? `part ${part.id}` : "", result ? `job folder ${result.id}` : ""].filter(Boolean).join(" · ") : part ? "part" : result ? "job folder" : store.workspace.name);
  document.title = id ? `${id} · vamgpu Studio` : "vamgpu Studio";
  at("head").querySelectorAll(".spring, button").forEach((each) => each.remove());
  if (job) actions.push(button("Copy the job", async () => {
    const made = await send("POST", `jobs/${path(job.id)}/copy`, { name: free(job.id) });
    await reload.workspace();
    go("jobs", made.id);
  }));
  if (kind) actions.push(button("Move to trash", async () => {
    if (!await ask(`Move ${id} to the trash?`, "It stays in the folder “trash” of the workspace.", "Move to trash")) return;
    await send("DELETE", `${kind}/${path(id)}`);
    location.hash = "";
    await reload.workspace();
  }, { class: "quiet" }));
  if (actions.length) at("head").append(make("span", { class: "spring" }), ...actions);
}

function tabs() {
  const bar = at("tabs");
  bar.replaceChildren(...TABS.map(([key, text]) => make("button", { type: "button", role: "tab", id: `tab-${key}`, "aria-selected": String(key === chosen.tab), "aria-controls": "panel", tabindex: key === chosen.tab ? 0 : -1,
    onclick: () => { location.hash = `#${chosen.kind || "none"}/${encodeURIComponent(chosen.id || "")}/${key}`; } }, text)));
  at("panel").setAttribute("role", "tabpanel");
  bar.querySelector('[aria-selected="true"]').scrollIntoView({ block: "nearest", inline: "nearest" });
}

at("tabs").addEventListener("keydown", (event) => {
  const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key], now = TABS.findIndex(([key]) => key === chosen.tab);
  if (!step) return;
  event.preventDefault();
  const [key] = TABS[(now + step + TABS.length) % TABS.length];
  addEventListener("hashchange", () => setTimeout(() => at(`tab-${key}`)?.focus(), 60), { once: true });
  location.hash = `#${chosen.kind || "none"}/${encodeURIComponent(chosen.id || "")}/${key}`;
});

function choose() {
  const input = make("input", { type: "file", accept: ".stl,.3mf,.ply,.obj,.toml" });
  input.onchange = () => input.files.length && take(input.files[0]);
  input.click();
}

/** Take a file that was dropped or chosen: a part, or a job file. */
async function take(file) {
  try {
    if (/\.toml$/i.test(file.name)) {
      const name = `${free(file.name)}.toml`;
      await send("PUT", `jobs/${path(name)}`, { text: await file.text() });
      await reload.workspace();
      return go("jobs", name, "part");
    }
    if (!/\.(stl|3mf|ply|obj)$/i.test(file.name)) throw new Refused(`${file.name} is no part or job: drop an STL, 3MF, PLY, OBJ or TOML file`, 0);
    let again = false;
    if (store.workspace.parts.some(({ id }) => id === file.name)) {
      if (!await ask(`Replace ${file.name}?`, "The workspace has a part of this name. Jobs that use it get the new one.", "Replace")) return;
      again = true;
    }
    const line = make("p", { class: "toast" }, `Uploading ${file.name}`);
    at("said").append(line);
    try { await upload(file, again, (share) => put(line, `Uploading ${file.name}: ${percent(share, 0)}`)); } finally { line.remove(); }
    await reload.workspace();
    go("parts", file.name, "part");
  } catch (error) { say(error.message, true); }
}

let over = 0;
addEventListener("dragenter", () => { over += 1; document.body.classList.add("drop"); });
addEventListener("dragleave", () => { over -= 1; if (over <= 0) document.body.classList.remove("drop"); });
addEventListener("dragover", (event) => event.preventDefault());
addEventListener("drop", (event) => {
  event.preventDefault();
  over = 0;
  document.body.classList.remove("drop");
  if (event.dataTransfer.files.length) take(event.dataTransfer.files[0]);
});

at("menu").addEventListener("click", () => at("menu").setAttribute("aria-expanded", String(at("side").classList.toggle("open"))));
at("theme").value = localStorage.getItem("theme") || "day";
document.body.dataset.theme = at("theme").value;
at("theme").addEventListener("change", (event) => {
  localStorage.setItem("theme", event.target.value);
  document.body.dataset.theme = event.target.value;
  show();
});

function running() {
  const now = store.tasks.find(({ state }) => ["running", "cancelling"].includes(state)), waits = store.tasks.filter(({ state }) => state === "queued").length;
  const named = now && { solve: "Solving", prove: "Simulating", expose: "Exposing", orient: "Comparing orientations of", export: "Exporting", rehearse: "Dry run of", print: "Printing" }[now.kind];
  put(at("running"), now ? `${named} ${now.job || now.result}${now.progress?.share ? ` · ${percent(now.progress.share, 0)}` : ""}${waits ? ` · ${waits} waiting` : ""}` : "");
}

on("lost", (is) => {
  at("lost").hidden = !is;
  if (is) put(at("lost"), is !== true ? is : "The server of Studio does not answer. A solve or print that runs goes on. This page tries again by itself; if it stays so, start `vam studio` again.");
});
on("workspace", async () => {
  const before = JSON.stringify([chosen.job?.state, chosen.job?.modified, chosen.job?.result, chosen.part?.modified, chosen.result?.modified, chosen.result?.state]);
  resolve();
  side();
  head();
  if (chosen.file && chosen.job && before !== JSON.stringify([chosen.job?.state, chosen.job?.modified, chosen.job?.result, chosen.part?.modified, chosen.result?.modified, chosen.result?.state])) {
    const now = await get(`jobs/${path(chosen.job.id)}`).catch(() => null);
    if (now && now.etag !== chosen.file.etag) chosen.file.take(now);
  }
  open?.update?.("workspace");
});
on("print", () => { side(); open?.update?.("print"); });
for (const event of ["tasks", "task", "job", "devices", "presets"]) on(event, (detail) => { running(); open?.update?.(event, detail); });

addEventListener("hashchange", () => { if (store.workspace) route(); });
try {
  await reload.all();
  follow();
  running();
  await route();
} catch (error) {
  at("lost").hidden = false;
  put(at("lost"), error.message);
}
