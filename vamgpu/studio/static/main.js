// The frame of the page: the workspace at the left, the tabs, what is dropped, and the connection.
import { JobFile, follow, get, on, path, reload, send, store, upload } from "./api.js";
import { ask, at, bytes, button, day, draw, empty, make, percent, put, say } from "./dom.js";
import { PartTab } from "./part.js";
import { JobTab } from "./job.js";
import { SolveTab } from "./solve.js";
import { LookTab } from "./look.js";
import { StackTab, WebLook, WebPart } from "./films.js";
import { PrintTab } from "./print.js";

const TABS = [["part", "Part", PartTab], ["job", "Machine and resin", JobTab], ["solve", "Solve", SolveTab], ["look", "Look", LookTab], ["print", "Print", PrintTab]];
const OTHERS = { web: { part: WebPart, look: WebLook }, slices: { part: StackTab, look: StackTab } };
const SHAPES = {
  good: "M2.5 7.5l3 3 6-7", bad: "M3 3l8 8M11 3l-8 8", warn: "M7 2v6.5M7 11v1", busy: "M7 2a5 5 0 1 1-5 5", none: "M7 7h.01",
};
const STATES = {
  new: ["none", "not solved"], queued: ["busy", "waits in the queue"], running: ["busy", "solving"], interrupted: ["warn", "interrupted; can continue"],
  solved: ["none", "solved, not simulated"], proved: ["good", "prints"], not: ["bad", "does not print"], changed: ["warn", "changed since it was solved"],
  invalid: ["bad", "has a wrong value"], damaged: ["bad", "damaged"],
};

/** What is chosen, and its job, part and result as the workspace has them. */
export const chosen = { kind: null, id: null, tab: "part", job: null, part: null, result: null, file: null };
let open = null, turns = 0;

/** Choose a part, job or result of the workspace, and a tab. */
export function go(kind, id, tab = chosen.tab) {
  location.hash = `#${kind || "none"}/${encodeURIComponent(id || "")}/${tab}`;
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

function decoded(text) {
  try { return decodeURIComponent(text); } catch { return text; }
}

async function route() {
  const { parts, jobs, results } = store.workspace, asked = location.hash.slice(1).split("/"), wanted = decoded(asked[1] || "");
  const there = [...parts, ...jobs, ...results].some(({ id }) => id === wanted);
  const [kind, id, tab] = there ? [asked[0], wanted, asked[2]] : [...first().slice(0, 2), asked.at(-1) || first()[2]]; // "#look" is a tab of what is open
  if (wanted && !there) say(`there is no ${wanted} in this workspace`, true);
  const before = `${chosen.kind}/${chosen.id}`;
  [chosen.kind, chosen.id] = [kind, id];
  chosen.tab = TABS.some(([key]) => key === tab) ? tab : "part";
  resolve();
  if (before !== `${chosen.kind}/${chosen.id}` || !chosen.file || chosen.file.id !== chosen.job?.id) chosen.file = null;
  at("side").classList.remove("open");
  at("menu").setAttribute("aria-expanded", "false");
  await show();
}

const seen = () => JSON.stringify([chosen.job?.state, chosen.job?.modified, chosen.job?.result, chosen.part?.modified, chosen.result?.modified, chosen.result?.state]);

/** Show the chosen tab again. */
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
  const root = at("panel"), Tab = OTHERS[(chosen.job || chosen.result)?.kind]?.[chosen.tab] || TABS.find(([key]) => key === chosen.tab)[2];
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
  const state = ({ state: now, verdict }) => STATES[now === "proved" && verdict?.prints === false ? "not" : now] || ["none", now];
  const own = new Set(jobs.map(({ result }) => result)), others = results.filter(({ id }) => !own.has(id));
  at("side").replaceChildren(...[
    button("Add a part or job …", choose, { class: "add" }),
    group("Jobs", jobs.map((job) => row("jobs", job.id, ...state(job))), "None yet. Choose a part, then make a job."),
    group("Parts", parts.map((part) => row("parts", part.id, "none", bytes(part.bytes))), "None yet. Drop an STL here."),
    others.length ? group("Job folders", others.map((each) => row("results", each.id, ...state(each)))) : "",
    group("Prints", store.runs.slice(0, 6).map((run) => make("li", {}, make("button", { type: "button", title: run.name, onclick: () => go(chosen.kind, chosen.id, "print") },
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
    onclick: () => go(chosen.kind, chosen.id, key) }, text)));
  at("panel").setAttribute("role", "tabpanel");
  bar.querySelector('[aria-selected="true"]').scrollIntoView({ block: "nearest", inline: "nearest" });
}

at("tabs").addEventListener("keydown", (event) => {
  const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key], now = TABS.findIndex(([key]) => key === chosen.tab);
  if (!step) return;
  event.preventDefault();
  const [key] = TABS[(now + step + TABS.length) % TABS.length];
  addEventListener("hashchange", () => setTimeout(() => at(`tab-${key}`)?.focus(), 60), { once: true });
  go(chosen.kind, chosen.id, key);
});

function choose() {
  const input = make("input", { type: "file", accept: ".stl,.3mf,.ply,.obj,.step,.stp,.toml", multiple: true });
  input.onchange = () => takeAll([...input.files]);
  input.click();
}

const KNOWN = /\.(stl|3mf|ply|obj|step|stp|toml)$/i;

/** Files of what was dropped, those in folders included. */
async function dropped(items) {
  const entries = [...items].map((item) => item.webkitGetAsEntry?.()).filter(Boolean), files = [];
  const walk = async (entry) => {
    if (entry.isFile) return files.push(await new Promise((done, fail) => entry.file(done, fail)));
    const reader = entry.createReader();
    for (let some; (some = await new Promise((done, fail) => reader.readEntries(done, fail))).length;) for (const each of some) await walk(each);
  };
  for (const entry of entries) await walk(entry);
  return files;
}

/** Take files that were dropped or chosen, parts before the jobs that name them, and show the last one. */
async function takeAll(files) {
  const some = files.filter(({ name }) => KNOWN.test(name)), left = files.length - some.length;
  if (left) say(`left out ${left === 1 ? files.find((each) => !some.includes(each)).name : `${left} files`}: drop STL, 3MF, PLY, OBJ, STEP or TOML files, and put job folders and slices into the folder of the workspace`, true);
  let last = null;
  for (const file of some.sort((a, b) => /\.toml$/i.test(a.name) - /\.toml$/i.test(b.name))) {
    try { last = (await take(file)) || last; } catch (error) { say(error.message, true); }
  }
  if (!last) return;
  await reload.workspace();
  go(...last, "part");
}

/** Take a part or a job file; resolves to its kind and name. */
async function take(file) {
  if (/\.toml$/i.test(file.name)) {
    const name = `${free(file.name)}.toml`;
    await send("PUT", `jobs/${path(name)}`, { text: await file.text() });
    await reload.workspace(); // the next one finds another free name
    return ["jobs", name];
  }
  let again = false;
  if (store.workspace.parts.some(({ id }) => id === file.name)) {
    if (!await ask(`Replace ${file.name}?`, "The workspace has a part of this name. Jobs that use it get the new one.", "Replace")) return null;
    again = true;
  }
  const line = make("p", { class: "toast" }, `Uploading ${file.name}`);
  at("said").append(line);
  try { await upload(file, again, (share) => put(line, `Uploading ${file.name}: ${percent(share, 0)}`)); } finally { line.remove(); }
  return ["parts", file.name];
}

let over = 0;
addEventListener("dragenter", () => { over += 1; document.body.classList.add("drop"); });
addEventListener("dragleave", () => { over -= 1; if (over <= 0) document.body.classList.remove("drop"); });
addEventListener("dragover", (event) => event.preventDefault());
addEventListener("drop", (event) => {
  event.preventDefault();
  over = 0;
  document.body.classList.remove("drop");
  dropped(event.dataTransfer.items).then(takeAll).catch((error) => say(error.message, true));
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
  const named = now && { solve: "Solving", model: "Modeling", prove: "Simulating", expose: "Exposing", orient: "Comparing orientations of", export: "Exporting", rehearse: "Dry run of", print: "Printing" }[now.kind];
  put(at("running"), now ? `${named} ${now.job || now.result}${now.progress?.share ? ` · ${percent(now.progress.share, 0)}` : ""}${waits ? ` · ${waits} waiting` : ""}` : "");
}

on("lost", (is) => {
  at("lost").hidden = !is;
  if (is) put(at("lost"), is !== true ? is : "The server of Studio does not answer. A running solve or print continues. This page tries again by itself; if that fails, start `vam studio` again.");
});
on("workspace", async () => {
  const before = seen();
  resolve();
  side();
  head();
  if (chosen.file && chosen.job && before !== seen()) {
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
