// Films on a roller and stacks of slices: the machine in section, frames with their focus planes, slices, and reports.
import { busy, get, path, started, url } from "./api.js";
import { button, card, draw, empty, facts, fixed, legend, length, make, number, put, row, slider, table } from "./dom.js";
import { chosen, go } from "./main.js";

/** Frames as a film: play, and move to one; with focus planes, also the columns that each of them shows. */
export function reel(id, { count, rows, columns, bits, step }, planes = []) {
  const base = url("results", id, "frame"), first = Math.floor(count / 2), image = make("img", { class: "film", alt: "frame 1" }), where = make("output", {});
  let fetching = false, waiting = null, playing = null, plane = "";
  const show = (index) => {
    put(where, `frame ${index + 1}`);
    image.alt = `frame ${index + 1} of ${count}`;
    if (fetching) { waiting = index; return; }
    fetching = true;
    image.src = `${base}?index=${index}${plane === "" ? "" : `&plane=${plane}`}`;
  };
  image.onload = image.onerror = () => {
    fetching = false;
    if (waiting !== null) { const next = waiting; waiting = null; show(next); }
  };
  const range = make("input", { type: "range", min: 0, max: count - 1, value: first, "aria-label": "Frame", oninput: (event) => show(+event.target.value) });
  const stop = () => { clearInterval(playing); playing = null; };
  const play = make("button", { type: "button", onclick: () => {
    put(play, playing ? "Play" : "Pause");
    if (playing) return stop();
    playing = setInterval(() => { range.value = (+range.value + 1) % count; show(+range.value); }, 80);
  } }, "Play");
  const choice = planes.length > 1 && make("select", { "aria-label": "Focus plane", onchange: (event) => { plane = event.target.value; show(+range.value); } },
    make("option", { value: "" }, "all columns"), planes.map((depth, k) => make("option", { value: k }, `focused at ${fixed(depth, 2)} mm`)));
  show(first);
  const made = make("div", { class: "stack tight" }, image, make("div", { class: "slider reel" }, play, range, where), choice || null,
    make("p", { class: "soft" }, `${count} frames, ${columns} × ${rows} pixels${bits ? `, ${bits} bit` : ""}; ${step}`));
  return Object.assign(made, { stop });
}

/** The film about its roller, seen along the axis; light comes from below. Lengths in mm. */
function section({ radius: r, outer: o, leg, planes, beam: [wide] }) {
  const reach = 1.15 * Math.max(o, wide / 2), low = 1.5 * o, y = (value) => -value;
  const svg = draw("svg", { class: "section", viewBox: `${-reach} ${-leg} ${2 * reach} ${leg + low}`, role: "img", "aria-label": "The film about its roller, with the light from below and its focus planes" });
  svg.append(draw("rect", { class: "light", x: -wide / 2, y: y(0), width: wide, height: low }), draw("circle", { class: "roller", cx: 0, cy: 0, r }),
    draw("path", { class: "band", d: `M${-o} ${-leg}V0A${o} ${o} 0 0 0 ${o} 0V${-leg}H${r}V0A${r} ${r} 0 0 1 ${-r} 0V${-leg}Z` }));
  for (const depth of planes) svg.append(draw("line", { class: "plane", x1: -wide / 2, x2: wide / 2, y1: y(depth), y2: y(depth) }));
  for (let k = -3; k <= 3; k++) svg.append(draw("path", { class: "ray", d: `M${(k * wide) / 7} ${low}v${-0.4 * r}m${-0.05 * r} ${0.1 * r}l${0.05 * r} ${-0.1 * r}l${0.05 * r} ${0.1 * r}` }));
  return svg;
}

function machine(web) {
  return card("The film about its roller", make("div", { class: "stack" }, section(web), make("div", { class: "legend" }, legend("glass", "film"), legend("lit", "light, from below"), web.planes.length ? legend("plane", "focus planes") : null), facts([
    ["radius of the roller", length(web.radius)], ["thickness of the film", length(web.thickness)], ["light, wide × high", `${number(web.beam[0])} × ${number(web.beam[1])} mm`],
    ["from one angle to the next", `${number(web.step)}°, ${length(web.advance)} of film`], web.planes.length && ["focus planes", `${web.planes.map((each) => fixed(each, 2)).join(", ")} mm`],
    web.window && ["window: film lit at one moment", length(web.window)], ["length of the web", length(web.length)], web.speed && ["speed", `${number(60 * web.speed)} mm/min`]])));
}

/** A verdict with what can be done about it. */
function judged(verdict, none, ...actions) {
  const kind = verdict ? (verdict.prints ? "good" : "bad") : "none";
  return make("section", { class: `verdict ${kind}`, "aria-label": "Verdict" }, make("p", { class: "head", "data-testid": "verdict" }, verdict ? verdict.sentence : none), make("div", { class: "row" }, actions));
}

/** A report in the page, and the way to open it alone. */
function report(title, address) {
  const made = card(title, make("div", { class: "row" }, make("a", { class: "button", href: address, target: "_blank", rel: "noopener" }, "Open in its own tab")), make("iframe", { src: address, title }));
  made.classList.add("wide", "live-print");
  return made;
}

/** A tab that reads its content, and reads it again when a task of the job or of the workspace ends. */
class Read {
  constructor(root) {
    this.root = root;
    root.append(make("p", { class: "soft" }, "Reading …"));
    this.load();
  }

  async load() {
    const turn = (this.loading = (this.loading || 0) + 1);
    try {
      const parts = await this.parts();
      if (this.closed || turn !== this.loading) return;
      this.reel?.stop();
      this.reel = parts.reel;
      this.root.replaceChildren(...parts.filter(Boolean));
    } catch (error) {
      if (!this.closed && turn === this.loading) this.root.replaceChildren(make("p", { class: "note bad" }, error.message));
    }
  }

  update(event, detail) {
    const now = JSON.stringify([chosen.job?.state, chosen.result?.state, chosen.result?.modified]);
    const own = event === "tasks" && detail && (detail.job === chosen.job?.id || (detail.result && detail.result === chosen.result?.id));
    if (own || (event === "job" && detail === chosen.file) || (event === "workspace" && this.seen !== now)) this.load();
    this.seen = now;
  }

  close() {
    this.closed = true;
    this.reel?.stop();
  }
}

/** Part of a web: its machine. */
export class WebPart extends Read {
  async parts() {
    if (!chosen.job) return [empty("This job folder has no job file here", "Its results are under Look.")];
    const { web, problems } = await get(`jobs/${path(chosen.job.id)}/scene`);
    return [...problems.map(({ message }) => make("p", { class: "note bad" }, message)), web && machine(web)];
  }
}

/** A solved web: verdict, machine, frames, segments and report. */
export class WebLook extends Read {
  async parts() {
    if (!chosen.result) return [empty("No result yet", "Solve the web first.", button("To Solve", () => go("jobs", chosen.job.id, "solve"), { class: "primary" }))];
    const { id } = chosen.result, { state, verdict, web, frames, report: page } = await get(`results/${path(id)}`), proving = busy("prove", "result", id);
    const prove = button(proving ? "Simulating …" : verdict ? "Simulate again" : "Simulate the print", () => started({ kind: "prove", result: id, device: null, tolerances: false }), { class: verdict ? "" : "primary", disabled: proving });
    const none = state === "interrupted" ? "Not complete: columns that all angles lit can be simulated" : "Not simulated yet";
    const film = frames.count ? reel(id, { ...frames, step: `${length(frames.step)} of film from one to the next` }, web.planes) : make("p", { class: "soft" }, "No segment is complete yet.");
    const rows = web.segments.map((each, k) => row(String(k + 1), `${fixed(each.mm[0], 1)} to ${fixed(each.mm[1], 1)} mm`, `${each.frames[0]} to ${each.frames[1] - 1}`, number(each.loss), number(each.saturated)));
    const segments = table("Segments", { "aria-label": "Segments of the web" }, ["segment", "web", "frames", "loss", "pixels too dim"], rows);
    const parts = [judged(verdict, none, prove), make("div", { class: "cards" }, machine(web), make("div", { class: "stack" }, card("Frames", film), card("Segments", segments)), page && report("Report on the simulated web", page.replace(/^\//, "")))];
    return Object.assign(parts, { reel: frames.count ? film : null });
  }
}

/** A stack of slices before and after its correction, and what it cures. */
export class StackTab extends Read {
  async parts() {
    const { id } = chosen.job, stack = await get(`stacks/${path(id)}`), { before, after, model, correct } = stack, run = (kind, more = {}) => started({ kind, job: id, device: null, ...more });
    const modelling = busy("model", "job", id), correcting = busy("solve", "job", id), verdict = correct?.verdict || model?.verdict;
    const parts = [judged(verdict, "Not modeled yet", button(modelling ? "Modeling …" : "Model what the slices cure", () => run("model"), { disabled: modelling, class: verdict ? "" : "primary" }),
      button(correcting ? "Correcting …" : after ? "Correct again" : "Correct the slices", () => run("solve", { prove: false, fresh: Boolean(after), set: {} }), { disabled: correcting }))];
    if (before || after) parts.push(this.slices(id, stack));
    else parts.push(make("p", { class: "soft" }, `The slices are made of the part ${chosen.job.part || ""} while they are modeled or corrected.`));
    const page = (of, title, there) => there?.report && report(title, `api/v1/stacks/${path(id)}/report?of=${of}`);
    return [...parts, page("correct", "Before and after the correction", correct), page("model", "What the uncorrected slices cure", model)];
  }

  slices(id, { before, after, height }) {
    const shown = [["before", before], ["after", after]].filter(([, each]) => each), most = Math.max(...shown.map(([, { shape }]) => shape[0]));
    const images = shown.map(([of, { name }]) => ({ of, image: make("img", { class: "film", alt: "" }), name, caption: make("figcaption", {}, `${of === "before" ? "before" : "after the correction"}: ${name}`) }));
    let timer = null;
    const load = (index) => images.forEach(({ of, image }, k) => {
      image.alt = `slice ${index + 1} ${of} the correction`;
      image.hidden = index >= shown[k][1].shape[0];
      if (!image.hidden) image.src = `api/v1/stacks/${path(id)}/slice?of=${of}&index=${index}`;
    });
    const place = slider("Slice", { min: 0, max: most - 1, step: 1, value: Math.floor(most / 2), say: (k) => length(k * height), input: (index) => { clearTimeout(timer); timer = setTimeout(load, 30, index); } });
    load(Math.floor(most / 2));
    return card("Slices", make("div", { class: "stack" }, make("div", { class: "halves" }, images.map(({ image, caption }) => make("figure", {}, image, caption))), place));
  }
}
