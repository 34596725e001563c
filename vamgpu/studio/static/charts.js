// Charts as drawings: curves over time, and a histogram with a threshold.
import { draw, number } from "./dom.js";

const LEFT = 46, RIGHT = 10, TOP = 10, BOTTOM = 34;

/** Round positions of at most `count` ticks between two numbers. */
function ticks(low, high, count = 5) {
  const raw = (high - low) / count, power = 10 ** Math.floor(Math.log10(raw || 1));
  const step = [1, 2, 5, 10].map((each) => each * power).find((each) => each >= raw) || raw;
  const found = [];
  for (let k = Math.ceil(low / step - 1e-9); k * step <= high + 1e-9 * step; k++) found.push(+(k * step).toPrecision(6));
  return found;
}

function frame(name, { x: [x0, x1], y: [y0, y1], across, width = 520, height = 200, plain = false }) {
  const svg = draw("svg", { class: "chart", viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": name });
  const x = (value) => LEFT + ((value - x0) / (x1 - x0 || 1)) * (width - LEFT - RIGHT);
  const y = (value) => height - BOTTOM - ((value - y0) / (y1 - y0 || 1)) * (height - TOP - BOTTOM);
  for (const each of plain ? [] : ticks(y0, y1, 4)) svg.append(
    draw("line", { class: "grid", x1: LEFT, x2: width - RIGHT, y1: y(each), y2: y(each) }),
    draw("text", { x: LEFT - 6, y: y(each) + 4, "text-anchor": "end" }, number(each)));
  for (const each of ticks(x0, x1, 6)) svg.append(
    draw("text", { x: x(each), y: height - BOTTOM + 15, "text-anchor": "middle" }, number(each)));
  svg.append(draw("path", { class: "axis", d: `M${LEFT} ${height - BOTTOM}H${width - RIGHT}` }),
    draw("text", { x: width - RIGHT, y: height - 4, "text-anchor": "end" }, across));
  return { svg, x, y, width, height };
}

/** Curves [{ name, type, points: [[x, y], …] }] in one frame. */
export function curves(name, all, { across, low = null }) {
  const points = all.flatMap((each) => each.points).filter(([, y]) => Number.isFinite(y));
  if (!points.length) return null;
  const xs = points.map(([x]) => x), ys = points.map(([, y]) => y);
  const from = low ?? Math.min(...ys), to = Math.max(...ys), pad = 0.06 * (to - from || 1);
  const { svg, x, y } = frame(name, { x: [Math.min(...xs), Math.max(...xs)], y: [from - (low === null ? pad : 0), to + pad], across });
  if (from < 0 && to > 0) svg.append(draw("line", { class: "zero", x1: x(Math.min(...xs)), x2: x(Math.max(...xs)), y1: y(0), y2: y(0) }));
  for (const { type = "one", points: line } of all) svg.append(
    draw("polyline", { class: `curve ${type}`, points: line.filter(([, v]) => Number.isFinite(v)).map(([a, b]) => `${x(a).toFixed(1)},${y(b).toFixed(1)}`).join(" ") }));
  return svg;
}

/** Histogram of dose inside and outside the part; the line is the dose that prints. `gain` moves the line, not the bars. */
export function histogram(inside, outside, most, gain) {
  const bins = 64, sums = (counts) => {
    const made = new Array(bins).fill(0);
    let all = 0;
    for (let k = 0; k < counts.length; k++) { made[Math.floor((k * bins) / counts.length)] += counts[k]; all += counts[k]; }
    return made.map((each) => each / (all || 1));
  };
  const shares = { out: sums(outside), in: sums(inside) };
  shares.out[0] = Math.min(shares.out[0], 1.5 * Math.max(...shares.out.slice(1), ...shares.in)); // dark resin far away hides the rest
  const top = Math.max(...shares.out, ...shares.in, 1e-9);
  const { svg, x, y } = frame("Histogram of the dose, inside and outside the part", { x: [0, most], y: [0, top], across: "dose / dose that prints", plain: true, height: 190 });
  for (const kind of ["out", "in"]) {
    let path = `M${x(0)} ${y(0)}`;
    shares[kind].forEach((share, k) => { path += `L${x((k * most) / bins).toFixed(1)} ${y(share).toFixed(1)}H${x(((k + 1) * most) / bins).toFixed(1)}`; });
    svg.append(draw("path", { class: `bars ${kind}`, d: `${path}L${x(most)} ${y(0)}Z` }));
  }
  const line = draw("line", { class: "threshold", y1: TOP, y2: y(0) });
  svg.append(line);
  svg.move = (now) => { const place = x(Math.min(most, 1 / now)); line.setAttribute("x1", place); line.setAttribute("x2", place); };
  svg.move(gain);
  return svg;
}
