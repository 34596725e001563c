"use strict";
const PATIENCE = 2000; // longest wait for an answer [ms]
const SILENT = 1.0; // age of the last status poll above which a print with light counts as silent [s]
const SHAPES = {
  standby: "M12 3a9 9 0 1 0 .01 0zm0 3a6 6 0 1 1-.01 0z",
  starting: "M12 3a9 9 0 1 0 .01 0zm0 3a6 6 0 1 1-.01 0zm-2 2l5 4-5 4z",
  printing: "M5 3l16 9-16 9z",
  paused: "M5 3h5v18H5zm9 0h5v18h-5z",
  held: "M12 1l11 11-11 11L1 12zm-1.5 5v8h3V6zm0 10v3h3v-3z",
  complete: "M2 13l3-3 5 5L20 4l3 3-13 14z",
  incomplete: "M12 2a10 10 0 0 0 0 20zm1 0a10 10 0 0 1 0 20v-2a8 8 0 0 0 0-16z",
  cancelled: "M4 4h16v16H4z",
  error: "M12 1l11.5 21H.5zm-1.5 7v7h3V8zm0 9v3h3v-3z",
  lost: "M3 5l2-2 7 7 7-7 2 2-7 7 7 7-2 2-7-7-7 7-2-2 7-7z",
};
const at = (id) => document.getElementById(id);
const values = {}, images = {}, buttons = {};
let heard = 0, wait = 0.25, lost = true, name = "lost", last = null, readings = -1, ended = null, pastDue = 0, prints = [], explained = null;
let timer = 0, looking = false, again = false, drawnChecks = null, drawnClaims = null, drawnPast = null;
const SURE = { guaranteed: "●", watched: "◐", believed: "○", "not there": "–" };
const CHECKS = { images: "misfit of the images", conversion: "fraction of the conversion that the light does not explain" };
const MOST = 2; // top of the plot of checks, in limits

function made(tag, parent, text, type) {
  const element = document.createElement(tag);
  if (text !== undefined) element.textContent = text;
  if (type) element.className = type;
  parent.append(element);
  return element;
}

function put(element, text) { // an unchanged text is not announced again
  if (element.textContent !== text) element.textContent = text;
}

function drawn(tag, parent, attributes) {
  const element = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  parent.append(element);
  return element;
}

function time(seconds) {
  if (seconds === null || seconds === undefined) return "—";
  const whole = Math.max(0, Math.round(seconds)), hours = Math.floor(whole / 3600);
  const minutes = String(Math.floor(whole / 60) % 60), rest = String(whole % 60).padStart(2, "0");
  if (whole < 60) return `${whole} s`;
  return hours ? `${hours} h ${minutes.padStart(2, "0")} min` : `${minutes} min ${rest} s`;
}

const total = (now) => (now.period && now.stop !== null ? Math.min(now.stop * now.period, now.slots || Infinity) : now.slots);

function clock(now) { // turn k of n, and the time left
  const turns = now.period ? Math.ceil(total(now) / now.period) : 0;
  const turn = now.frame < 0 ? 0 : Math.min(Math.floor(now.slot / now.period) + 1, turns);
  const left = now.ended || now.left === null ? "" : `${time(now.left)} left`;
  return [turns ? (turn ? `turn ${turn} of ${turns}` : `${turns} turns`) : "", left].filter(Boolean).join(" · ");
}

const claim = (now, about) => now.guarantees.find((each) => each.about === about);
const unsensed = (now, about) => (claim(now, about) || {}).holds === false;

function doubtful(now) {
  if (!now.doubt.length) return now.frame < 0 ? ["nothing yet", ""] : ["nothing", ""];
  const slots = now.doubt.map(([first, stop]) => (stop - first > 1 ? `${first + 1} to ${stop}` : `${stop}`)).join(", ");
  return [`slot ${slots}: lit for an unknown time`, "warn"];
}

function rows(now) {
  const ms = (seconds) => (seconds < 1 ? `${Math.round(1000 * seconds)} ms` : `${seconds.toFixed(1)} s`);
  const fixed = (value, digits) => (value === null ? "—" : value.toFixed(digits));
  const age = now.renewed === null ? null : now.renewed + now.ago, silent = now.light && now.ago > SILENT;
  const leased = claim(now, "lease");
  const told = {
    light: [now.light ? `ON at ${100 * now.power} %`.replace(/(\.\d)\d+/, "$1") + (now.rehearsed ? ", emulated" : "")  + (unsensed(now, "light") ? ", as commanded: no machine reports it" : "") : "off", now.light ? "lit" : ""],
    "time left": [now.ended ? "none: the print has ended" : time(now.left) + (now.waits === null ? "" : " of light"), ""],
    dose: [`${fixed(100 * now.spent, 1)} % of the plan`, ""],
    frame: [now.frame < 0 ? "none yet" : `${now.frame} (slot ${now.slot + 1}${now.slots ? ` of ${now.slots}` : ""})`, ""],
    position: [`${fixed(now.position, 3)} ${now.unit}${unsensed(now, "position") ? ", by counted steps" : ""}`, ""],
    interlock: (claim(now, "interlock") || {}).kind === "not there" ? ["not there", "warn"] : now.light && now.interlock_closed ? ["closed: the controller allows the light", ""] : now.ended ? ["no longer read", ""]
      : now.interlock_closed === null ? [now.state === "standby" ? "not read yet" : "not known", ""] : now.interlock_closed ? ["closed", ""] : ["OPEN: close the enclosure", "warn"],
    lease: leased && !leased.holds ? ["not there: the light may stay on if the host dies", "warn"] : !now.light || age === null ? ["light is off", ""]
      : age > now.lease ? [`not renewed for ${ms(age)}: the controller has switched the light off`, "warn"]
      : [`light off ${ms(now.lease - age)} after the host falls silent; last renewal ${ms(age)} ago`, silent ? "warn" : ""],
  };
  if (now.focus !== null) told.lens = [`${now.focus > 0 ? "+" : ""}${now.focus.toFixed(3)} dpt`, ""];
  if (now.lens_temperature !== null) told["lens temperature"] = [`${now.lens_temperature.toFixed(1)} °C, measured while dark`, ""];
  if (now.light) told.buffer = [`${Math.round(100 * now.fill)} % full, frames ready ${ms(now.margin / 1e9)} early`, ""];
  const step = now.unit === "deg" ? "turn" : "segment"; // of a vial, of a web
  if (now.plan || now.live) told.plan = [`version ${now.plan}, ${now.stop === null ? `all ${step}s` : `until ${step} ${now.stop}`}${now.live ? `; ${now.live}` : ""}`, now.live ? "warn" : ""];
  for (const each of now.parameters) told[each.name] = [`${+each.value.toPrecision(4)}${each.error ? ` ± ${each.error.toPrecision(2)}` : ""}`, "", each.usual && each];
  told["in doubt"] = doubtful(now);
  told["shown black"] = [`${now.dark} frames`, now.dark ? "warn" : ""];
  if (silent) told.light = [`last known ON, no status of the machines for ${time(now.ago)}`, "warn"];
  return told;
}

function show(now) {
  const begun = now.state === "standby" && "pause" in now.buttons && !("start" in now.buttons);
  const state = begun || now.resuming ? "starting" : now.state;
  name = state;
  document.body.dataset.state = state;
  at("shape").firstElementChild.setAttribute("d", SHAPES[state] || SHAPES.held);
  put(at("state"), state);
  put(at("clock"), clock(now));
  put(at("job"), now.job);
  at("dry").hidden = !now.rehearsed;
  document.title = `${now.rehearsed ? "dry run, " : ""}${state} · ${now.job || "vamgpu"}`;
  const left = now.slots - now.slot - 1;
  const none = state === "complete" || !now.slots || (left === 0 && now.frame >= 0);
  const missing = none ? "" : `${now.frame < 0 ? now.slots : left} of ${now.slots} slots were not shown. `;
  const black = now.dark ? `${now.dark} frames were shown black. ` : "";
  const waits = now.waits !== null && state !== "starting", open = now.interlock_closed === false;
  const todo = state === "starting" ? "Frames are loaded and the motion accelerates; then the light turns on. "
    : !waits || !(now.waits > 0) ? "" : open ? "Close the enclosure, then press resume. "
    : state === "held" ? "Fix the cause, then press resume. " : "Press resume to continue. ";
  explain((now.message && !now.resuming ? `${now.message}. ` : "") + todo + (now.ended ? missing + black : ""), now);
  at("waits").hidden = !waits;
  at("waits").textContent = !waits ? "" : now.waits > 0 ? `can continue for ${time(now.waits)}` : "can no longer continue: start again with fresh resin";
  const share = total(now) ? Math.min(100, (100 * (now.frame < 0 ? 0 : now.slot + 1)) / total(now)) : 0;
  at("bar").style.width = `${share}%`;
  at("progress").setAttribute("aria-valuenow", share.toFixed(0));
  const told = rows(now);
  if (Object.keys(values).join() !== Object.keys(told).join()) { // their order stays the same
    at("values").replaceChildren();
    for (const key of Object.keys(values)) delete values[key];
  }
  for (const [key, [text, type, estimated]] of Object.entries(told)) {
    if (!values[key]) {
      made("dt", at("values"), key);
      values[key] = made("dd", at("values"));
      values[key].dataset.testid = key;
    }
    put(values[key], text);
    values[key].className = type;
    if (estimated) bar(values[key], estimated);
  }
  for (const [key, why] of Object.entries(now.buttons)) {
    if (!buttons[key]) {
      buttons[key] = made("button", at("buttons"), key);
      buttons[key].type = "button";
      buttons[key].dataset.testid = key;
      buttons[key].addEventListener("click", () => (key === "cancel" ? at("ask").showModal() : press(`press/${key}`)));
    }
    buttons[key].disabled = why !== null;
    buttons[key].title = why || "";
  }
  if (now.ended && at("ask").open) at("ask").close();
  for (const [key, number] of Object.entries(now.images)) {
    showImage(key, number);
    const text = now.light || !key.startsWith("projector") ? key : `${key}: last frame; the light is off`;
    put(images[key].caption, text);
  }
  for (const key of Object.keys(images)) if (!(key in now.images)) { images[key].figure.remove(); delete images[key]; }
  checks(now);
  claims(now);
  if (now.readings !== readings) { readings = now.readings; scatter(); }
  const changed = now.ended !== ended; // at first the server may still report values from before the end
  if (changed || Date.now() > pastDue) { ended = now.ended; pastDue = Date.now() + (changed ? 6000 : 15000); past(); }
}

function bar(parent, { name, value, error, usual: [low, high] }) { // the usual value, and on it value ± deviation
  const track = parent.querySelector("svg") || drawn("svg", parent, { class: "bar", preserveAspectRatio: "none", viewBox: "0 0 100 10", role: "img" });
  const from = Math.min(low, value - error), wide = Math.max(high, value + error) - from, x = (at) => (100 * (at - from)) / wide;
  track.setAttribute("aria-label", `${name}: usual from ${+low.toPrecision(3)} to ${+high.toPrecision(3)}`);
  track.replaceChildren();
  const block = (type, begin, end, y, height) => drawn("rect", track, { class: type, x: x(begin), y, width: Math.max(x(end) - x(begin), 1), height });
  block("usual", low, high, 3, 4);
  block("planned", (low + high) / 2, (low + high) / 2, 0, 10);
  block("found", value - error, value + error, 2, 6);
}

function explain(text, now) {
  const own = now.ended && prints.find((each) => each.name === now.run), pages = own ? own.reports : [];
  const key = text + pages.join();
  if (key === explained) return; // a link that is replaced between press and release is never followed
  explained = key;
  at("message").textContent = text;
  at("message").hidden = !key;
  for (const each of pages) made("a", at("message"), "report ").href = `runs/${encodeURIComponent(own.name)}/${each}`;
}

function showImage(key, number) {
  if (!images[key]) {
    const figure = made("figure", at("images")), image = made("img", figure);
    image.alt = key.startsWith("projector") ? `frame of ${key}` : key;
    image.dataset.testid = key;
    images[key] = { figure, image, caption: made("figcaption", figure), number: 0, loading: false };
    image.onload = image.onerror = () => { images[key] && (images[key].loading = false); };
  }
  const kept = images[key];
  if (kept.number === number || kept.loading) return; // a slow reader skips frames
  kept.number = number;
  kept.loading = true;
  kept.image.src = `image/${encodeURIComponent(key)}?${number}`;
}

function claims(now) { // as the record of the run lists them
  const key = JSON.stringify(now.guarantees);
  if (key === drawnClaims) return;
  drawnClaims = key;
  at("machine").hidden = !now.guarantees.length;
  at("claims").replaceChildren();
  for (const each of now.guarantees) {
    const row = made("tr", at("claims")), sure = each.kind;
    made("th", row, each.about).scope = "row"; // its role stays where a phone sets the cells below each other
    const cell = made("td", row, undefined, sure.replace(" ", "-"));
    made("span", cell, `${SURE[sure] || ""} `).ariaHidden = "true";
    cell.append(sure);
    made("td", row, each.remedy ? `${each.why}; ${each.remedy}` : each.why);
    row.role = "row";
    for (const [number, each] of [...row.children].entries()) each.role = number ? "cell" : "rowheader";
  }
}

function checks(now) { // value over limit of each check, turn by turn; red beyond the limit
  const key = JSON.stringify([now.checks, now.live]);
  if (key === drawnChecks) return;
  drawnChecks = key;
  at("checks").hidden = !now.checks.length;
  if (!now.checks.length) return;
  const plot = at("checks-plot"), turns = now.checks.map((each) => each.turn), names = new Set(now.checks.map((each) => each.name));
  const share = (value, limit) => (limit < 1 ? `${+(100 * value).toPrecision(3)} %` : `${+value.toPrecision(3)}`);
  const start = Math.min(...turns), end = Math.max(...turns), latest = [];
  const x = (turn) => 40 + (270 * (turn - start)) / Math.max(end - start, 1);
  const y = (ratio) => 130 - (118 * Math.min(Math.max(ratio, 0), MOST)) / MOST;
  plot.replaceChildren();
  drawn("path", plot, { class: "axis", d: "M40 10V130H310", fill: "none" });
  drawn("line", plot, { class: "stop", x1: 40, x2: 310, y1: y(1), y2: y(1) });
  drawn("text", plot, { x: 36, y: y(1) + 3, "text-anchor": "end" }).textContent = "limit";
  drawn("text", plot, { x: 36, y: 133, "text-anchor": "end" }).textContent = "0";
  drawn("text", plot, { x: 310, y: 144, "text-anchor": "end" }).textContent = `turn ${end}`;
  drawn("text", plot, { x: 40, y: 144 }).textContent = `turn ${start}`;
  for (const name of names) {
    const found = now.checks.filter((each) => each.name === name), last = found[found.length - 1];
    for (const [number, each] of found.entries()) {
      const type = `${name}${each.value > each.limit ? " beyond" : ""}`, at = { cx: x(each.turn), cy: y(each.value / each.limit) };
      if (number) drawn("line", plot, { class: type, x1: x(found[number - 1].turn), y1: y(found[number - 1].value / found[number - 1].limit), x2: at.cx, y2: at.cy });
      drawn("circle", plot, { class: type, r: 2.5, ...at });
    }
    latest.push([`${CHECKS[name] || name} ${share(last.value, last.limit)} after turn ${last.turn}, at most ${share(last.limit, last.limit)}`, `${name}${last.value > last.limit ? " beyond" : ""}`]);
  }
  at("checks-reading").replaceChildren();
  for (const [text, type] of latest) made("span", at("checks-reading"), text, type);
  const beyond = now.checks.find((each) => each.value > each.limit);
  if (beyond) made("strong", at("checks-reading"), `From turn ${beyond.turn} on, the images are not used; the planned light continues.`, "beyond");
}

async function scatter() {
  const told = readings > 0 ? await asked("scatter") : null;
  at("curve").hidden = !told || !told.points.length;
  if (at("curve").hidden) return;
  const plot = at("plot"), stop = told.threshold, [end, density] = told.points[told.points.length - 1];
  const start = told.points[0][0], most = 1.1 * Math.max(stop || 0, 1e-9, ...told.points.map((point) => point[1]));
  const x = (value) => 34 + (276 * (value - start)) / Math.max(end - start, 1e-9);
  const y = (value) => 130 - (120 * Math.max(value, 0)) / most;
  plot.replaceChildren();
  drawn("path", plot, { class: "axis", d: "M34 10V130H310", fill: "none" });
  if (stop) {
    drawn("line", plot, { class: "stop", x1: 34, x2: 310, y1: y(stop), y2: y(stop) });
    drawn("text", plot, { x: 38, y: y(stop) - 3 }).textContent = `stops at ${stop}`;
  }
  drawn("polyline", plot, { class: "curve", points: told.points.map(([s, d]) => `${x(s)},${y(d)}`).join(" ") });
  drawn("text", plot, { x: 310, y: 144, "text-anchor": "end" }).textContent = `${end.toFixed(0)} s`;
  drawn("text", plot, { x: 30, y: 133, "text-anchor": "end" }).textContent = "0";
  drawn("text", plot, { x: 30, y: 16, "text-anchor": "end" }).textContent = most.toPrecision(2);
  at("reading").textContent = `${density.toPrecision(3)} gray levels/voxel after ${end.toFixed(1)} s`;
}

async function past() {
  prints = (await asked("history")) || [];
  const key = JSON.stringify([prints, last && last.state]);
  if (key === drawnPast) return; // whoever is at a link stays there
  drawnPast = key;
  at("past").hidden = !prints.length;
  at("history").replaceChildren();
  for (const each of prints) {
    const item = made("li", at("history"));
    const now = last && each.name === last.run, state = now ? last.state : each.state;
    item.dataset.state = state;
    drawn("path", drawn("svg", item, { viewBox: "0 0 24 24", "aria-hidden": true }), { d: SHAPES[state] || SHAPES.held });
    const gone = ["standby", "printing", "paused", "held"].includes(state) && !now && !each.running;
    made("strong", item, `${each.job || each.name}: ${state}${now ? " (this print)" : each.running ? " (running now)" : gone ? ", left by its host" : ""} `);
    made("small", item, `${new Date(1000 * each.began).toLocaleString("sv")} · ${time(each.seconds)} · ${each.name}${each.doubt ? ` · ${each.doubt} frames in doubt` : ""} `);
    if (each.running) made("small", item, `· watch it with vam panel --attach ${each.name} `);
    for (const page of each.reports) made("a", item, "report ").href = `runs/${encodeURIComponent(each.name)}/${page}`;
    if (each.message) { made("br", item); made("small", item, each.message); }
  }
}

async function asked(path, options = {}) {
  try {
    const answer = await fetch(path, { signal: AbortSignal.timeout(PATIENCE), ...options });
    return answer.ok ? await answer.json() : null;
  } catch { return null; }
}

async function press(path) {
  let said = "";
  try {
    const answer = await fetch(path, { method: "POST", keepalive: true, signal: AbortSignal.timeout(10000) });
    if (!answer.ok) said = await answer.text();
  } catch { said = "no answer"; }
  if (said && path === "stop") said = `THE STOP WAS NOT CONFIRMED (${said}): use the switch at the machine`;
  at("notice").textContent = said;
  at("notice").hidden = !said;
  look(); // the user who pressed sees the result
}

function connection() {
  const age = (Date.now() - heard) / 1000;
  if (!lost && age < wait + PATIENCE / 1000 + 0.5) return;
  lost = true;
  document.body.dataset.state = "lost";
  document.body.classList.add("stale");
  at("shape").firstElementChild.setAttribute("d", SHAPES.lost);
  put(at("state"), "connection lost");
  document.title = "connection lost";
  const leased = last && claim(last, "lease"), closes = last && last.lease && !(leased && !leased.holds) ? ` The controller switches the light off ${Math.round(1000 * last.lease)} ms after its host falls silent.` : "";
  put(at("lost"), heard ? `No answer for ${time(Math.max(1, age))}; the values below are old (${name}).${closes} A stop may not get through: use the switch at the machine.` : "No answer yet.");
  at("lost").hidden = false;
  for (const button of Object.values(buttons)) { button.disabled = true; button.title = "connection lost"; }
}

async function look() {
  if (looking) { again = true; return; }
  clearTimeout(timer);
  [looking, again] = [true, false];
  const now = await asked("state?page");
  looking = false;
  try {
    if (now) {
      [heard, wait, last, lost] = [Date.now(), now.wait, now, false];
      document.body.classList.remove("stale");
      at("lost").hidden = true;
      show(now);
    } else lost = true;
    connection();
  } finally { timer = setTimeout(look, again ? 0 : lost ? 500 : 1000 * wait); }
}

at("stop").addEventListener("click", () => press("stop"));
at("keep").addEventListener("click", () => at("ask").close());
at("cancel").addEventListener("click", () => { at("ask").close(); press("press/cancel"); });
document.addEventListener("visibilitychange", look); // a phone that was asleep
setInterval(connection, 250);
look();
