// The server: requests, binary arrays, events, and what the page knows of the workspace.

const BASE = "api/v1/";
const name = encodeURIComponent;

/** An answer that is an error: `fields` are the values at fault, if the server names some. */
export class Refused extends Error {
  constructor(message, status, fields = []) {
    super(message);
    this.status = status;
    this.fields = fields;
  }
}

async function refused(answer) {
  const text = await answer.text();
  try {
    const { message, fields } = JSON.parse(text).error;
    return new Refused(message, answer.status, fields);
  } catch {
    return new Refused(answer.status === 403 ? "this page is no longer signed in: open it again with `vam studio`" : text || `the server answered ${answer.status}`, answer.status);
  }
}

async function answered(path, options = {}) {
  let answer;
  try {
    answer = await fetch(BASE + path, options);
  } catch {
    if (options.signal?.aborted) throw new DOMException("replaced by a newer request", "AbortError");
    throw new Refused("the server of Studio does not answer: start it again with `vam studio`", 0);
  }
  if (!answer.ok) throw await refused(answer);
  return answer;
}

export const get = async (path) => (await answered(path)).json();
export const text = async (path) => (await answered(path)).text();

/** Send JSON; resolves to the JSON of the answer. */
export async function send(method, path, body) {
  const options = body === undefined ? { method } : { method, body: JSON.stringify(body), headers: { "Content-Type": "application/json" } };
  const answer = await answered(path, options);
  return answer.status === 204 ? null : answer.json().catch(() => null);
}

const ARRAYS = { uint8: Uint8Array, uint16: Uint16Array, uint32: Uint32Array, float32: Float32Array };

/** Arrays of a binary answer by their names: { data, shape }, and its numbers as `meta`. */
export async function arrays(path, signal) {
  const answer = await answered(path, { signal }), buffer = await answer.arrayBuffer();
  const made = { meta: JSON.parse(answer.headers.get("X-Meta") || "{}") };
  let offset = 0;
  for (const { name: key, dtype, shape } of JSON.parse(answer.headers.get("X-Arrays") || "[]")) {
    const count = shape.reduce((all, each) => all * each, 1), type = ARRAYS[dtype];
    made[key] = { data: new type(buffer, offset, count), shape };
    offset += Math.ceil((count * type.BYTES_PER_ELEMENT) / 4) * 4;
  }
  return made;
}

/** Upload a part; `progress` is called with the share that was sent. */
export function upload(file, overwrite, progress) {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest();
    request.open("POST", `${BASE}parts?name=${name(file.name)}${overwrite ? "&overwrite=1" : ""}`);
    request.setRequestHeader("Content-Type", "application/octet-stream");
    request.upload.onprogress = (event) => event.lengthComputable && progress(event.loaded / event.total);
    request.onerror = () => reject(new Refused("the upload was cut off: try again", 0));
    request.onload = async () => {
      if (request.status < 400) return resolve(JSON.parse(request.responseText));
      reject(await refused(new Response(request.responseText, { status: request.status })));
    };
    request.send(file);
  });
}

export const path = (...parts) => parts.map((each) => name(each)).join("/");
export const url = (...parts) => BASE + path(...parts);

/** What the page knows; tabs read it, and hear of changes through `on`. */
export const store = { workspace: null, tasks: [], runs: [], printing: null, devices: [], schemas: null, presets: null, lost: false };
const heard = new EventTarget();

export const on = (event, listener) => {
  const call = ({ detail }) => listener(detail);
  heard.addEventListener(event, call);
  return () => heard.removeEventListener(event, call);
};
export const tell = (event, detail) => heard.dispatchEvent(new CustomEvent(event, { detail }));

const BUSY = ["queued", "running", "cancelling"];

export const waits = (task) => BUSY.includes(task?.state);
/** Whether a task of a kind, whose key has a value, waits or runs. */
export const busy = (kind, key, value) => store.tasks.some((task) => task.kind === kind && task[key] === value && waits(task));
export const started = (task) => send("POST", "tasks", task).then(reload.tasks);

/** Reload a part of the store, and tell who listens. */
export const reload = {
  async workspace() { store.workspace = await get("workspace"); tell("workspace"); },
  async tasks() { store.tasks = (await get("tasks")).tasks; tell("tasks"); },
  async devices() { store.devices = (await get("devices")).devices; tell("devices"); },
  async presets() { store.presets = await get("presets"); tell("presets"); },
  async print() { [store.printing, { runs: store.runs }] = await Promise.all([get("print"), get("runs")]); tell("print"); },
  async all() {
    store.schemas ||= Object.fromEntries(await Promise.all(["vial", "web", "slices"].map(async (kind) => [kind, await get(`schema?kind=${kind}`)])));
    await Promise.all([reload.workspace(), reload.tasks(), reload.presets(), reload.devices(), reload.print()]);
  },
};

function changed(task) {
  const place = store.tasks.findIndex((each) => each.id === task.id), before = store.tasks[place];
  if (place < 0) store.tasks.unshift(task); else store.tasks[place] = task;
  if (!before || before.state !== task.state) {
    tell("tasks", task);
    reload.workspace().catch(() => {}); // the list states what runs
    if (["rehearse", "print"].includes(task.kind)) reload.print().catch(() => {}); // its run is in the history now
  }
  tell("task", task);
}

/** Follow the events of the server for as long as the page is open. */
export function follow() {
  const stream = new EventSource(`${BASE}events`), quietly = (work) => work().catch(() => {});
  const lost = (is) => { if (store.lost !== is) { store.lost = is; tell("lost", is); } };
  stream.onopen = () => lost(false);
  stream.onerror = () => {
    lost(true);
    if (stream.readyState === EventSource.CLOSED) get("workspace").catch(({ message }) => tell("lost", message)); // another Studio has the port
  };
  const listen = (event, act) => stream.addEventListener(event, ({ data }) => { lost(false); act(data ? JSON.parse(data) : null); });
  listen("task", changed);
  listen("removed", ({ id }) => { store.tasks = store.tasks.filter((each) => each.id !== id); tell("tasks"); });
  listen("workspace", () => quietly(reload.workspace));
  listen("devices", () => quietly(reload.devices));
  listen("print", () => quietly(reload.print));
  listen("reset", () => quietly(reload.all));
  return stream;
}

/** One job file that is open: its text, fields and errors. Edits follow one another, each saved before the next. */
export class JobFile {
  constructor(id) {
    this.id = id;
    this.work = Promise.resolve();
  }

  async load() {
    this.take(await get(`jobs/${path(this.id)}`));
    return this;
  }

  take(answer) {
    Object.assign(this, { text: answer.text, etag: answer.etag ?? this.etag, fields: answer.fields || {}, errors: answer.errors || [] });
    tell("job", this);
  }

  /** Value of a key such as "vial.radius"; undefined if it is left out. */
  value(key) {
    return key.split(".").reduce((table, part) => table?.[part], this.fields);
  }

  error(key) {
    return this.errors.find(({ field }) => field === key) || null;
  }

  next(work) {
    const done = this.work.then(work);
    this.work = done.catch(() => {});
    return done;
  }

  async save(text_) {
    try {
      this.take(await send("PUT", `jobs/${path(this.id)}`, { text: text_, etag: this.etag }));
    } catch (error) {
      if (error.status !== 409) throw error;
      await this.load();
      throw new Refused(`${this.id} was changed elsewhere at the same time; it was loaded again: check it, and repeat your change`, 409);
    }
  }

  /** Change keys { "vial.radius": "12 mm" } and remove others; comments of the file stay. */
  edit(set, remove = []) {
    return this.next(async () => this.save((await send("POST", "jobs/edit", { text: this.text, set, remove })).text));
  }

  /** Replace the text. */
  write(text_) {
    return this.next(() => this.save(text_));
  }
}
