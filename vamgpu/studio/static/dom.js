// Elements, numbers with units, and messages: what every tab uses.

/** An element: `make("p", { class: "soft", onclick }, "text", child)`. Values that are null or false are left out. */
export function make(tag, given = {}, ...children) {
  const element = document.createElement(tag);
  for (const [key, value] of Object.entries(given)) {
    if (value === null || value === undefined || value === false) continue;
    if (key.startsWith("on")) element.addEventListener(key.slice(2), value);
    else if (key === "class") element.className = value;
    else if (["value", "checked", "disabled", "selected", "hidden"].includes(key)) element[key] = value;
    else element.setAttribute(key, value === true ? "" : value);
  }
  element.append(...children.flat().filter((child) => child !== null && child !== undefined && child !== false));
  return element;
}

const SVG = "http://www.w3.org/2000/svg";

/** An element of a drawing. */
export function draw(tag, given = {}, ...children) {
  const element = document.createElementNS(SVG, tag);
  for (const [key, value] of Object.entries(given)) element.setAttribute(key, value);
  element.append(...children);
  return element;
}

export const at = (id) => document.getElementById(id);

/** Set a text only if it changed, so that it is not announced again. */
export function put(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** A number with few digits and a true minus sign; a dash if there is none. */
export function number(value, digits = 3) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  const text = value === 0 ? "0" : Math.abs(value) >= 10 ** digits ? Math.round(value).toString() : `${+value.toPrecision(digits)}`;
  return text.replace("-", "−");
}

export const fixed = (value, digits = 2) => (value === null || value === undefined ? "–" : value.toFixed(digits).replace("-", "−"));
export const percent = (share, digits = 1) => (share === null || share === undefined ? "–" : `${fixed(100 * share, digits)} %`);

/** A length [mm] in the unit that keeps it readable. */
export const length = (mm) => (mm === null || mm === undefined ? "–" : Math.abs(mm) < 0.1 ? `${number(1000 * mm)} µm` : `${number(mm)} mm`);

/** A duration [s] as a clock reads. */
export function time(seconds, digits = 0) {
  if (seconds === null || seconds === undefined) return "–";
  if (seconds < 10) return `${fixed(Math.max(0, seconds), 1)} s`;
  const whole = Math.max(0, Math.round(seconds)), hours = Math.floor(whole / 3600), minutes = Math.floor(whole / 60) % 60;
  if (whole < 60) return `${digits ? fixed(seconds, digits) : whole} s`;
  return hours ? `${hours} h ${minutes} min` : `${minutes} min ${whole % 60} s`;
}

export const bytes = (count) => (count > 1e9 ? `${number(count / 1e9)} GB` : count > 1e6 ? `${number(count / 1e6)} MB` : `${number(count / 1e3)} kB`);
export const day = (wall) => new Date(1000 * wall).toLocaleString("en-GB", { day: "numeric", month: "short", hour: "2-digit", minute: "2-digit" });

/** Tell what was done, or what failed, at the foot of the page for some seconds. */
export function say(text, bad = false) {
  const line = make("p", { class: bad ? "toast bad" : "toast" }, text);
  at("said").append(line);
  setTimeout(() => line.remove(), bad ? 12000 : 5000);
}

/** Ask before what cannot be undone; resolves to true if the answer is yes. */
export function ask(question, detail, yes, danger = true) {
  const box = at("ask");
  put(at("question"), question);
  put(at("detail"), detail);
  return new Promise((resolve) => {
    const done = (answer) => { box.close(); resolve(answer); };
    at("answers").replaceChildren(
      button("Cancel", () => done(false)), button(yes, () => done(true), { class: danger ? "danger" : "primary" }));
    box.oncancel = () => resolve(false);
    box.showModal();
  });
}

/** A button whose action may fail: it is disabled until the answer is there, and the failure is said. */
export function button(text, action, given = {}) {
  return make("button", { type: "button", ...given, onclick: async (event) => {
    const target = event.currentTarget;
    target.setAttribute("aria-busy", "true");
    try { await action(event); } catch (error) { say(error.message, true); }
    finally { target.removeAttribute("aria-busy"); }
  } }, text);
}

/** A card with a heading. */
export function card(title, ...children) {
  const id = `h-${Math.random().toString(36).slice(2, 8)}`;
  return make("section", { class: "card", "aria-labelledby": id }, make("h2", { id }, title), ...children);
}

/** What an empty place says: what is missing, and what to do. */
export const empty = (title, text, ...actions) =>
  make("div", { class: "empty" }, make("h2", {}, title), make("p", {}, text), actions.length ? make("div", { class: "row" }, actions) : null);

/** Names and values in two columns. */
export const facts = (pairs) => make("dl", { class: "facts" }, pairs.filter(Boolean).flatMap(([name, value]) => [make("dt", {}, name), make("dd", {}, value)]));

export const legend = (type, text) => make("span", {}, make("i", { class: type }), text);

/** A table that scrolls sideways; all columns but the first are numbers, unless it has a class. */
export const table = (name, given, heads, rows) => make("div", { class: "scroll", tabindex: 0, role: "group", "aria-label": name }, make("table", given,
  heads.length ? make("thead", {}, make("tr", {}, heads.map((text, k) => make("th", { scope: "col", class: k && !given.class ? "n" : "" }, text)))) : null, make("tbody", {}, rows)));
export const row = (name, ...values) => make("tr", {}, make("th", { scope: "row" }, name), values.map((value) => make("td", { class: "n" }, value)));

/** Buttons of which one is pressed, from [value, text] pairs. */
export function choice(name, all, now, change) {
  const made = make("div", { class: "choice", role: "group", "aria-label": name }, all.map(([value, text]) => make("button", { type: "button", "aria-pressed": String(value === now), onclick: (event) => {
    made.childNodes.forEach((each) => each.setAttribute("aria-pressed", String(each === event.currentTarget)));
    change(value);
  } }, text)));
  return made;
}

/** Draw again, and give the focus and the caret back to the element of the same key. */
export function keeping(redraw) {
  const { dataset, selectionStart: caret } = document.activeElement || {}, key = dataset?.key;
  redraw();
  const again = key && document.querySelector(`[data-key="${CSS.escape(key)}"]`);
  if (!again || again === document.activeElement) return;
  again.focus();
  if (caret !== null && caret !== undefined) again.setSelectionRange?.(caret, caret);
}

/** A labelled select of [value, text] pairs. */
export function select(name, options, value, change, given = {}) {
  return make("label", { class: "field" }, make("span", {}, name),
    make("select", { ...given, onchange: (event) => change(event.target.value) }, options.map(([key, text]) =>
      make("option", { value: key, selected: key === value }, text))));
}

/** A slider with its value beside it; `say` makes the text of a value. */
export function slider(name, { min, max, step, value, say: text, input }) {
  const output = make("output", {}, text(value));
  const range = make("input", { type: "range", min, max, step, value, "aria-label": name, "aria-valuetext": text(value), oninput: (event) => {
    const now = +event.target.value;
    put(output, text(now));
    event.target.setAttribute("aria-valuetext", text(now));
    input(now);
  } });
  const row = make("label", { class: "slider" }, make("span", {}, name), range, output);
  row.set = (now) => { range.value = now; put(output, text(now)); range.setAttribute("aria-valuetext", text(now)); };
  return row;
}
