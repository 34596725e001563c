// Slices of target, dose and print through volumes on the graphics card; the exposure is applied while they are drawn.

const HEAT = [[0, 0, 4], [11, 7, 36], [33, 12, 74], [61, 9, 101], [87, 16, 110], [113, 25, 110], [138, 34, 106], [163, 44, 97],
  [188, 55, 84], [210, 70, 68], [228, 90, 49], [241, 115, 29], [249, 142, 9], [252, 172, 17], [249, 203, 53], [242, 234, 105], [252, 255, 164]];

/** Red, green and blue of a share from 0 to 1. */
export function heat(share) {
  const place = Math.max(0, Math.min(1, share)) * (HEAT.length - 1), k = Math.min(HEAT.length - 2, Math.floor(place));
  return HEAT[k].map((value, c) => Math.round(value + (HEAT[k + 1][c] - value) * (place - k)));
}

const VERTEX = `#version 300 es
  in vec2 corner; out vec2 at;
  void main() { at = 0.5 + 0.5 * corner; gl_Position = vec4(corner, 0.0, 1.0); }`;
const FRAGMENT = `#version 300 es
  precision highp float; precision highp sampler3D;
  in vec2 at; out vec4 seen;
  uniform sampler3D dose, target, other; uniform sampler2D heat; uniform int axis, pane; uniform bool dark; uniform float slice, most, gain;
  vec3 inside(vec2 p) { return axis == 2 ? vec3(slice, p.x, p.y) : axis == 1 ? vec3(p.x, slice, p.y) : vec3(p.x, p.y, slice); }
  float part(vec3 p) { return texture(target, p).r; }
  void main() {
    vec3 p = inside(at), dx = inside(at + vec2(dFdx(at.x), 0.0)) - p, dy = inside(at + vec2(0.0, dFdy(at.y))) - p;
    float t = part(p), d = texture(dose, p).r * most * gain;
    bool edge = (t > 0.5) != (part(p + dx) > 0.5) || (t > 0.5) != (part(p + dy) > 0.5);
    vec3 color = vec3(0.0);
    if (pane == 0) color = dark ? vec3(mix(0.06, 0.75, t)) : mix(vec3(0.95, 0.96, 0.97), vec3(0.42, 0.49, 0.58), t);
    else if (pane == 1) { color = texture(heat, vec2(clamp(d / 1.5, 0.002, 0.998), 0.5)).rgb; if (edge) color = vec3(1.0); }
    else if (pane == 2) {
      vec3 voxels = vec3(textureSize(dose, 0)); // whole voxels print, as they are counted
      bool solid = texture(dose, (floor(p * voxels) + 0.5) / voxels).r * most * gain >= 1.0, part = t > 0.5;
      bool hatch = mod(gl_FragCoord.x + gl_FragCoord.y, 6.0) < 3.0; // in the dark room brightness and stripes replace hues
      if (dark) color = vec3(solid ? (part ? 0.45 : hatch ? 1.0 : 0.0) : part ? 1.0 : 0.06);
      else color = solid ? (part ? vec3(0.69, 0.745, 0.815) : vec3(0.94, 0.588, 0.125)) : part ? vec3(0.84, 0.227, 0.286) : vec3(0.965, 0.97, 0.98);
    } else {
      float change = (d - texture(other, p).r * most * gain) / 0.3;
      color = mix(vec3(dark ? 0.3 : 0.97), change < 0.0 ? (dark ? vec3(0.0) : vec3(0.77, 0.2, 0.26)) : dark ? vec3(1.0) : vec3(0.18, 0.4, 0.71), min(1.0, abs(change)));
    }
    seen = vec4(color, 1.0);
  }`;
const AXES = { z: 0, y: 1, x: 2 };

/** Panes side by side on one canvas: 0 target, 1 dose, 2 printed, 3 difference of two doses. */
export class Slices {
  /** Volumes are { shape: [z, y, x], data: Uint8Array with x contiguous }; `most` is the dose of byte 255. */
  constructor(canvas, panes = [0, 1, 2]) {
    this.canvas = canvas;
    this.panes = panes;
    this.gl = canvas.getContext("webgl2", { antialias: false, preserveDrawingBuffer: true });
    this.now = { axis: "z", slice: 0.5, gain: 1 };
    if (!this.gl) return;
    const gl = this.gl, shader = (kind, text) => {
      const made = gl.createShader(kind);
      gl.shaderSource(made, text);
      gl.compileShader(made);
      return made;
    };
    this.program = gl.createProgram();
    gl.attachShader(this.program, shader(gl.VERTEX_SHADER, VERTEX));
    gl.attachShader(this.program, shader(gl.FRAGMENT_SHADER, FRAGMENT));
    gl.linkProgram(this.program);
    if (!gl.getProgramParameter(this.program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(this.program));
    gl.useProgram(this.program);
    this.places = Object.fromEntries(["dose", "target", "other", "heat", "axis", "pane", "slice", "most", "gain", "dark"].map((name) => [name, gl.getUniformLocation(this.program, name)]));
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([-1, -1, 1, -1, -1, 1, 1, 1]), gl.STATIC_DRAW);
    const corner = gl.getAttribLocation(this.program, "corner");
    gl.enableVertexAttribArray(corner);
    gl.vertexAttribPointer(corner, 2, gl.FLOAT, false, 0, 0);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    const colors = new Uint8Array(256 * 4);
    for (let k = 0; k < 256; k++) colors.set([...heat(k / 255), 255], 4 * k);
    gl.activeTexture(gl.TEXTURE3);
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, 256, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, colors);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
    gl.uniform1i(this.places.heat, 3);
    ["dose", "target", "other"].forEach((name, unit) => gl.uniform1i(this.places[name], unit));
  }

  /** Load a volume as "dose", "target" or "other". */
  load(name, { shape, data }) {
    this.shape = shape;
    const gl = this.gl, unit = ["dose", "target", "other"].indexOf(name);
    if (!gl) return;
    gl.activeTexture(gl.TEXTURE0 + unit);
    this.textures ||= {};
    gl.deleteTexture(this.textures[name] || null);
    gl.bindTexture(gl.TEXTURE_3D, (this.textures[name] = gl.createTexture()));
    gl.texImage3D(gl.TEXTURE_3D, 0, gl.R8, shape[2], shape[1], shape[0], 0, gl.RED, gl.UNSIGNED_BYTE, data);
    const filter = name === "target" ? gl.NEAREST : gl.LINEAR;
    for (const [key, value] of [[gl.TEXTURE_MIN_FILTER, filter], [gl.TEXTURE_MAG_FILTER, filter],
      [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE], [gl.TEXTURE_WRAP_R, gl.CLAMP_TO_EDGE]]) gl.texParameteri(gl.TEXTURE_3D, key, value);
  }

  /** Width and height of a slice across an axis [voxels]. */
  size(axis = this.now.axis) {
    const [z, y, x] = this.shape || [1, 1, 1];
    return { z: [x, y], y: [x, z], x: [y, z] }[axis];
  }

  /** Draw with changed settings: axis "x", "y" or "z", slice 0 to 1, gain of the dose, most. */
  set(changed) {
    Object.assign(this.now, changed);
    if (this.queued || !this.gl || !this.shape) return;
    this.queued = true;
    requestAnimationFrame(() => { this.queued = false; this.render(); });
  }

  render() {
    const gl = this.gl, { axis, slice, gain, most = 1 } = this.now, [wide, high] = this.size();
    const ratio = Math.min(2, window.devicePixelRatio || 1), gap = Math.round(10 * ratio), count = this.panes.length;
    const width = Math.max(count * 8, Math.round(this.canvas.clientWidth * ratio));
    const each = Math.floor((width - gap * (count - 1)) / count), tall = Math.max(4, Math.round((each * high) / wide));
    this.canvas.style.aspectRatio = `${width} / ${tall}`;
    if (this.canvas.width !== width || this.canvas.height !== tall) { this.canvas.width = width; this.canvas.height = tall; }
    gl.disable(gl.SCISSOR_TEST);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.uniform1i(this.places.axis, AXES[axis]);
    gl.uniform1i(this.places.dark, +(document.body.dataset.theme === "room"));
    gl.uniform1f(this.places.slice, slice);
    gl.uniform1f(this.places.gain, gain);
    gl.uniform1f(this.places.most, most);
    this.panes.forEach((pane, k) => {
      gl.viewport(k * (each + gap), 0, each, tall);
      gl.uniform1i(this.places.pane, pane);
      gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    });
    this.canvas.dataset.drawn = String(+(this.canvas.dataset.drawn || 0) + 1);
  }

  close() {
    this.gl?.getExtension("WEBGL_lose_context")?.loseContext();
  }
}

/** Counts of dose bytes inside and outside the part: what prints at an exposure follows without the volume. */
export function tally(dose, target) {
  const inside = new Float64Array(256), outside = new Float64Array(256);
  for (let k = 0; k < dose.data.length; k++) (target.data[k] > 127 ? inside : outside)[dose.data[k]] += 1;
  return { inside, outside };
}

/** Share of the part that prints, and of the resin outside it, at a gain of the dose. */
export function printed({ inside, outside }, most, gain) {
  const least = 255 / (most * gain), share = (counts) => {
    let all = 0, solid = 0;
    for (let k = 0; k < 256; k++) { all += counts[k]; if (k >= least) solid += counts[k]; }
    return all ? solid / all : 0;
  };
  return { part: share(inside), outside: share(outside) };
}
