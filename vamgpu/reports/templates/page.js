"use strict";
// ---- slices: one picture holds dose, target and verdict of every slice in its three channels
(() => {
  const sheet = DATA.sheet, slider = document.getElementById("height"), where = document.getElementById("where");
  const views = ["target", "dose", "verdict"].map(name => document.getElementById("slice-" + name));
  for (const view of views) { view.width = sheet.width; view.height = sheet.height; }
  const image = new Image(), reader = document.createElement("canvas");
  const pen = reader.getContext("2d", { willReadFrequently: true });
  const paint = {
    target: (d, t) => { const v = 247 - t * 0.75; return [v, v, v]; },
    dose: d => DATA.heat.slice(3 * d, 3 * d + 3),
    verdict: (d, t, v) => DATA.colors[Math.round(v / 40)],
  };
  const draw = () => {
    const at = +slider.value, x = at % sheet.across * sheet.width, y = Math.floor(at / sheet.across) * sheet.height;
    const source = pen.getImageData(x, y, sheet.width, sheet.height).data;
    for (const view of views) {
      const canvas = view.getContext("2d"), picture = canvas.createImageData(sheet.width, sheet.height);
      const color = paint[view.id.slice(6)];
      for (let k = 0; k < source.length; k += 4) {
        picture.data.set(color(source[k], source[k + 1], source[k + 2]), k);
        picture.data[k + 3] = 255;
      }
      canvas.putImageData(picture, 0, 0);
    }
    where.textContent = "z = " + DATA.heights[at].toFixed(2).replace("-", "−") + " mm";
  };
  image.onload = () => {
    reader.width = image.width; reader.height = image.height;
    pen.drawImage(image, 0, 0);
    slider.max = sheet.slices.length - 1;
    slider.value = DATA.first;
    slider.oninput = draw;
    draw();
  };
  image.src = sheet.image;
})();

// ---- surfaces: WebGL where there is some, else triangles painted from back to front
(async () => {
  const inflate = text => new Response(new Blob([Uint8Array.from(atob(text), c => c.charCodeAt(0))]).stream()
    .pipeThrough(new DecompressionStream("deflate"))).arrayBuffer();
  const summed = (steps, stride) => { for (let k = stride; k < steps.length; k++) steps[k] += steps[k - stride]; return steps; };
  const unpack = async s => ({
    points: Float32Array.from(summed(new Int16Array(await inflate(s.points)), 3), v => v / 32767),
    normals: Float32Array.from(new Int8Array(await inflate(s.normals)), v => v / 127),
    shade: Float32Array.from(new Int8Array(await inflate(s.shade)), v => v / 127),
    faces: Uint32Array.from(summed(new Int32Array(await inflate(s.faces)), 1)),
  });
  const solids = { target: await unpack(DATA.target), printed: await unpack(DATA.printed) };
  const canvas = document.getElementById("solid");
  let mode = "both", turn = -0.9, tilt = 0.42, zoom = 1.15, queued = false;
  const gl = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true });

  // rows of the rotation that turns z upright and then towards the eye
  const rotation = () => {
    const c = Math.cos(turn), s = Math.sin(turn), d = Math.cos(tilt), e = Math.sin(tilt);
    return [c, -s, 0, s * e, c * e, d, s * d, c * d, -e];
  };
  const color = (shade, by) => {
    if (shade > 0.995) return [0.95, 0.55, 0.1];
    if (by !== "both") return by === "target" ? [0.62, 0.67, 0.73] : [0.38, 0.56, 0.78];
    const ends = shade < 0 ? [0.77, 0.2, 0.26] : [0.18, 0.4, 0.71], k = Math.min(1, Math.abs(shade));
    return [0.85, 0.84, 0.84].map((v, i) => v + (ends[i] - v) * k);
  };
  const resize = () => {
    const scale = window.devicePixelRatio || 1, w = canvas.clientWidth * scale, h = canvas.clientHeight * scale;
    if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
    const most = 0.94 * zoom / Math.max(DATA.radius, 1e-6) * Math.min(w, h);
    return [most / w, most / h];
  };

  let render;
  if (gl) {
    const shader = (kind, text) => { const s = gl.createShader(kind); gl.shaderSource(s, text); gl.compileShader(s); return s; };
    const program = gl.createProgram();
    gl.attachShader(program, shader(gl.VERTEX_SHADER, `#version 300 es
      in vec3 point; in vec3 normal; in vec3 tint; uniform mat3 turned; uniform vec2 scale; out vec3 n; out vec3 hue;
      void main() { vec3 p = turned * point; n = turned * normal; hue = tint; gl_Position = vec4(p.xy * scale, p.z * 0.4, 1.0); }`));
    gl.attachShader(program, shader(gl.FRAGMENT_SHADER, `#version 300 es
      precision highp float; in vec3 n; in vec3 hue; out vec4 seen;
      void main() {
        vec3 m = normalize(n);
        float key = max(dot(m, normalize(vec3(-0.45, 0.75, -0.6))), 0.0), fill = max(dot(m, normalize(vec3(0.8, 0.1, -0.5))), 0.0);
        seen = vec4(hue * (0.46 + 0.56 * key + 0.18 * fill), 1.0);
      }`));
    gl.linkProgram(program);
    gl.useProgram(program);
    const upload = (name, data) => {
      const at = gl.getAttribLocation(program, name);
      gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
      gl.enableVertexAttribArray(at);
      gl.vertexAttribPointer(at, 3, gl.FLOAT, false, 0, 0);
    };
    const shown = {};
    for (const by of ["both", "printed", "target"]) {
      const solid = solids[by === "target" ? "target" : "printed"], tint = new Float32Array(solid.points.length);
      for (let k = 0; k < solid.shade.length; k++) tint.set(color(solid.shade[k], by), 3 * k);
      shown[by] = { array: gl.createVertexArray(), count: solid.faces.length };
      gl.bindVertexArray(shown[by].array);
      upload("point", solid.points); upload("normal", solid.normals); upload("tint", tint);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, solid.faces, gl.STATIC_DRAW);
    }
    gl.enable(gl.DEPTH_TEST);
    gl.clearColor(0.953, 0.961, 0.973, 1);
    render = () => {
      const scale = resize();
      gl.viewport(0, 0, canvas.width, canvas.height);
      gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
      gl.uniformMatrix3fv(gl.getUniformLocation(program, "turned"), true, rotation());
      gl.uniform2fv(gl.getUniformLocation(program, "scale"), scale.map(v => 2 * v));
      gl.bindVertexArray(shown[mode].array);
      gl.drawElements(gl.TRIANGLES, shown[mode].count, gl.UNSIGNED_INT, 0);
    };
  } else {
    const pen = canvas.getContext("2d");
    document.getElementById("painted").hidden = false;
    render = () => {
      const [sx, sy] = resize(), m = rotation(), solid = solids[mode === "target" ? "target" : "printed"];
      const p = solid.points, n = solid.normals, seen = new Float32Array(p.length), faces = solid.faces, order = [];
      for (let k = 0; k < p.length; k += 3)
        for (let r = 0; r < 3; r++) seen[k + r] = m[3 * r] * p[k] + m[3 * r + 1] * p[k + 1] + m[3 * r + 2] * p[k + 2];
      for (let f = 0; f < faces.length; f += 3) {
        const k = 3 * faces[f], facing = m[6] * n[k] + m[7] * n[k + 1] + m[8] * n[k + 2];
        if (facing < 0.2) order.push([seen[k + 2] + seen[3 * faces[f + 1] + 2] + seen[3 * faces[f + 2] + 2], f]);
      }
      order.sort((a, b) => b[0] - a[0]);
      pen.clearRect(0, 0, canvas.width, canvas.height);
      for (const [, f] of order) {
        const k = 3 * faces[f], normal = [0, 1, 2].map(r => m[3 * r] * n[k] + m[3 * r + 1] * n[k + 1] + m[3 * r + 2] * n[k + 2]);
        const light = 0.46 + 0.56 * Math.max(0, -0.42 * normal[0] + 0.7 * normal[1] - 0.56 * normal[2]);
        const hue = color(solid.shade[faces[f]], mode).map(v => Math.round(Math.min(1, v * light) * 255));
        pen.fillStyle = pen.strokeStyle = `rgb(${hue})`;
        pen.beginPath();
        for (let c = 0; c < 3; c++) {
          const at = 3 * faces[f + c];
          pen.lineTo((0.5 + seen[at] * sx) * canvas.width, (0.5 - seen[at + 1] * sy) * canvas.height);
        }
        pen.closePath(); pen.fill(); pen.stroke();
      }
    };
  }
  const refresh = () => { if (!queued) { queued = true; requestAnimationFrame(() => { queued = false; render(); }); } };
  canvas.addEventListener("pointerdown", e => canvas.setPointerCapture(e.pointerId));
  canvas.addEventListener("pointermove", e => {
    if (!e.buttons) return;
    turn += e.movementX * 0.01;
    tilt = Math.max(-1.57, Math.min(1.57, tilt + e.movementY * 0.01));
    refresh();
  });
  canvas.addEventListener("wheel", e => { e.preventDefault(); zoom = Math.max(0.5, Math.min(8, zoom * Math.exp(-e.deltaY * 0.001))); refresh(); }, { passive: false });
  for (const button of document.querySelectorAll("#modes button")) button.onclick = () => {
    mode = button.dataset.mode;
    for (const other of document.querySelectorAll("#modes button")) other.classList.toggle("on", other === button);
    refresh();
  };
  window.addEventListener("resize", refresh);
  render();
})();
