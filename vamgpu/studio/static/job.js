// Machine and resin: fields made from the schema, presets, and the job file beside them. Both edit the same file.
import { reload, send, store } from "./api.js";
import { button, card, empty, keeping, make, put, say, select } from "./dom.js";
import { chosen } from "./main.js";

const ORDER = ["vial", "vat", "vessel", "resin", "beam", "turntable", "print", "target", "body", "method", "solve", "frames"];
const VESSELS = ["vial", "vat", "vessel"];
const PAUSE = 700; // after the last key before the text is saved [ms]

const rank = (name) => (ORDER.indexOf(name) + 1 || ORDER.length + 1);
const shown = (value) => (value === undefined ? "" : typeof value === "string" ? value : JSON.stringify(value).replaceAll(",", ", "));

/** A value in one spelling: "1.0 mm" as "1 mm". */
function plain(value) {
  const [, number, unit] = (typeof value === "string" && value.match(/^([-+.\de]+)\s*(\D.*)$/)) || [];
  return Number.isFinite(+number) ? `${+number} ${unit}` : JSON.stringify(value);
}

/** The value that a text means for a key of the schema, as JSON for the server. */
export function meant(key, text) {
  const said = text.trim().replace("−", "-");
  if (key.type === "quantity") return /^[-+.\d][-+.\de]*$/i.test(said) ? `${said} ${key.unit}` : said;
  if (key.type === "count" || key.type === "number") return said !== "" && Number.isFinite(+said) ? +said : said;
  if (key.type === "bool") return said === "true";
  if (["list", "any"].includes(key.type) && /^[[\d-]/.test(said)) {
    const bare = key.type === "list" && !said.startsWith("["); // "60, 32" and "60 × 32" are [60, 32]
    try { return JSON.parse(bare ? `[${said.split(/\s*[,;x×]\s*|\s+/).join(",")}]` : said); } catch { return said; }
  }
  return said;
}

export class JobTab {
  constructor(root) {
    this.root = root;
    if (!chosen.file) {
      root.append(empty("No job yet", chosen.part ? "Make a job with this part first: under Part, choose a height, a vial and a projector." : "Choose a job at the left, or add a job file (TOML)."));
      return;
    }
    this.schema = store.schemas[chosen.job.kind] || store.schemas.vial;
    this.form = make("div", { class: "stack" });
    this.text = make("textarea", { class: "file", spellcheck: "false", autocapitalize: "off", "aria-label": `Text of ${chosen.file.id}`, wrap: "off", oninput: () => this.typed() });
    this.status = make("small", { role: "status" });
    this.faults = make("ul", { class: "faults" });
    root.append(make("div", { class: "split job" }, this.form,
      make("section", { class: "card side", "aria-label": "Job file" }, make("div", { class: "row between" }, make("h2", {}, chosen.file.id), this.status), this.text, this.faults)));
    this.fill();
  }

  typed() {
    clearTimeout(this.timer);
    put(this.status, "typing …");
    this.timer = setTimeout(() => {
      this.timer = null;
      chosen.file.write(this.text.value).catch((error) => say(error.message, true));
    }, PAUSE);
  }

  save(set, remove = []) {
    put(this.status, "saving …");
    return chosen.file.edit(set, remove).catch((error) => { put(this.status, "not saved"); say(error.message, true); });
  }

  fill() {
    const file = chosen.file, open = new Set([...this.form.querySelectorAll("details[open]")].map((each) => each.dataset.table));
    if (!this.timer && this.text.value !== file.text) this.text.value = file.text;
    put(this.status, file.errors.length ? `saved; ${file.errors.length} wrong ${file.errors.length > 1 ? "values" : "value"}` : "saved");
    this.faults.replaceChildren(...file.errors.map(({ field, line, message }) => make("li", {}, button(line ? `line ${line}` : field || "file", () => this.jump(line), { class: "quiet" }), make("span", { class: "error" }, message))));
    const tables = this.schema.tables.filter(({ name }) => file.fields[name] !== undefined || (!this.optional(name) && name !== "body")).sort((a, b) => rank(a.name) - rank(b.name));
    keeping(() => this.form.replaceChildren(this.presets(), ...tables.map((table) => this.table(table, open)), this.adding()));
  }

  optional(name) {
    return this.schema.tables.find((table) => table.name === name)?.optional;
  }

  jump(line) {
    if (!line) return this.text.focus();
    const lines = this.text.value.split("\n"), start = lines.slice(0, line - 1).join("\n").length + (line > 1 ? 1 : 0);
    this.text.focus();
    this.text.setSelectionRange(start, start + lines[line - 1].length);
    this.text.scrollTop = Math.max(0, (line - 4) * parseFloat(getComputedStyle(this.text).lineHeight));
  }

  presets() {
    if (this.schema !== store.schemas.vial) return "";
    const lists = store.presets || { vials: [], projectors: [], resins: [] }, titles = { vials: "Vial", projectors: "Projector", resins: "Resin" };
    const same = (set) => Object.entries(set).every(([key, value]) => plain(chosen.file.value(key)) === plain(value));
    const now = Object.keys(titles).map((family) => {
      const current = lists[family].find(({ set }) => same(set));
      return select(titles[family], [["", "own values"], ...lists[family].map(({ id, name, own }) => [id, own ? `${name} (own)` : name])], current?.id || "", (id) => {
        const preset = lists[family].find((each) => each.id === id);
        if (preset) this.save(preset.set);
      }, { "data-key": `preset-${family}` });
    });
    const used = Object.keys(titles).flatMap((family) => lists[family].filter(({ set, source: from }) => from && same(set)).map(({ name, source: from }) => `${name}: ${from}`));
    const keys = { vials: VESSELS, projectors: ["beam"], resins: ["resin", "print"] };
    let family = "vials";
    const name = make("input", { placeholder: "our 25 mm vial", "aria-label": "Name of the preset" });
    return card("Presets", make("div", { class: "stack tight" }, make("div", { class: "thirds" }, now), used.map((each) => make("p", { class: "soft" }, each)),
      make("details", { "data-table": "presets" }, make("summary", {}, "Save the values of this job as a preset"), make("div", { class: "row" },
        select("Of", Object.entries(titles), family, (value) => { family = value; }), make("label", { class: "field" }, make("span", {}, "Name"), name),
        button("Save the preset", async () => {
          const set = Object.fromEntries(keys[family].flatMap((table) => Object.entries(chosen.file.fields[table] || {}).filter(([, value]) => typeof value !== "object" || Array.isArray(value)).map(([key, value]) => [`${table}.${key}`, value])));
          await send("POST", "presets", { family, name: name.value.trim(), set, source: "" });
          await reload.presets();
          say(`saved the preset “${name.value.trim()}”`);
        })))));
  }

  table(table, open) {
    const value = chosen.file.fields[table.name];
    if (Array.isArray(value)) return card(`[[${table.name}]]`, make("p", { class: "soft" }, `${table.doc} ${value.length} in this file: their roles are under Part, their other keys in the file.`));
    const own = chosen.file.error(table.name), kinds = table.kinds.length > 0, kind = value?.[table.word] || "";
    const component = kinds ? this.schema.components[table.kinds.find((each) => each.endsWith(`.${kind}`))] : null;
    const keys = kinds ? component?.keys || [] : table.keys, first = (key) => key.required || value?.[key.name] !== undefined || chosen.file.error(`${table.name}.${key.name}`);
    const [set, rest] = [keys.filter(first), keys.filter((key) => !first(key))], fields = (some) => make("div", { class: "fields" }, some.map((key) => this.field(table.name, key)));
    return make("section", { class: "card", "aria-label": table.name },
      make("div", { class: "row between" }, make("h2", {}, title(table.name), " ", make("code", {}, `[${table.name}]`)), table.optional && value !== undefined ? button("Remove", () => this.save({}, [table.name]), { class: "quiet", "aria-label": `Remove the table ${table.name}` }) : null),
      make("p", { class: "soft" }, (component?.doc || table.doc).replaceAll("`", "")), own ? make("p", { class: "error" }, own.message) : null,
      kinds ? select("Kind", [["", "choose"], ...table.kinds.map((each) => [each.split(".").pop(), each.split(".").pop()])], kind, (now) => now && this.save({ [`${table.name}.${table.word}`]: now }), { "data-key": `${table.name}.${table.word}` }) : null,
      set.length ? fields(set) : null,
      rest.length ? make("details", { "data-table": table.name, open: open.has(table.name) }, make("summary", {}, `${set.length ? "More keys" : "Keys"}: ${rest.map(({ name }) => name.replaceAll("_", " ")).join(", ")}`), fields(rest)) : null);
  }

  field(table, key) {
    const id = `${table}.${key.name}`, value = chosen.file.value(id), error = chosen.file.error(id), name = key.name.replaceAll("_", " ");
    const given = { "data-key": id, "aria-invalid": error ? "true" : null, "aria-describedby": `d-${id}`, "aria-label": `${table} ${name}` };
    const change = (text) => (text.trim() === "" ? this.save({}, [id]) : this.save({ [id]: meant(key, text) }));
    const left = key.default ? key.default.replaceAll('"', "") : "left out";
    let input;
    if (key.type === "table") input = make("p", { class: "soft" }, value === undefined ? `A table [${id}]: write it in the file.` : `The table [${id}] is in the file.`);
    else if (key.type === "choice" || key.type === "bool") {
      const choices = key.type === "bool" ? ["true", "false"] : key.choices.map(String);
      input = make("select", { ...given, onchange: (event) => change(event.target.value) }, make("option", { value: "", selected: value === undefined }, key.required ? "choose" : left),
        choices.map((each) => make("option", { value: each, selected: String(value) === each }, each)));
    } else input = make("input", { ...given, value: shown(value), placeholder: key.required ? "" : left, spellcheck: "false", autocomplete: "off", onchange: (event) => change(event.target.value) });
    return make("div", { class: "key" }, make("label", { class: "field" }, make("span", {}, name, key.unit ? make("em", {}, key.unit === "um" ? "µm" : key.unit) : null), input),
      error ? make("p", { class: "error", id: `d-${id}` }, error.message) : make("small", { id: `d-${id}` }, sentence(key)));
  }

  adding() {
    const missing = this.schema.tables.filter(({ name, many }) => chosen.file.fields[name] === undefined && this.optional(name) && !many).sort((a, b) => a.name.localeCompare(b.name));
    if (!missing.length) return make("div");
    let name = missing[0].name;
    const about = make("p", { class: "soft" }, missing[0].doc);
    return card("Add a table", make("div", { class: "stack tight" }, make("div", { class: "row nowrap" }, select("Table", missing.map((table) => [table.name, title(table.name)]), name, (value) => {
      name = value;
      put(about, missing.find((table) => table.name === value).doc);
    }, { "data-key": "add-table" }), button("Add", () => {
      const end = chosen.file.text.endsWith("\n") ? "" : "\n";
      return chosen.file.write(`${chosen.file.text}${end}\n[${name}]\n`);
    })), about));
  }

  update(event, detail) {
    if (this.form && ((event === "job" && detail === chosen.file) || event === "presets")) this.fill();
  }

  close() {
    if (!this.timer) return;
    clearTimeout(this.timer);
    chosen.file?.write(this.text.value).catch((error) => say(error.message, true));
  }
}

const title = (name) => name[0].toUpperCase() + name.slice(1).replaceAll("_", " ");

/** The sentence of a key, with its values: what it means, and what it may be. */
function sentence(key) {
  const doc = key.doc.replace(/ \[[^[\]]*\]/, ""), said = doc ? doc[0].toUpperCase() + doc.slice(1) : "", bounds = key.what && !["text", "true or false"].includes(key.what) && key.type !== "choice" ? key.what : "";
  return [said, bounds && `(${bounds})`].filter(Boolean).join(" ");
}
