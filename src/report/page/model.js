(function () {
  "use strict";
  var view = window.lumenfabView, holder = document.getElementById("model-data");
  if (!view || !holder) { return; }
  var canvas = document.getElementById("model"), signs = document.getElementById("letters"), none = document.getElementById("no-model");
  var gl = canvas.getContext("webgl", { antialias: true, preserveDrawingBuffer: true });
  if (!gl || !gl.getExtension("OES_element_index_uint")) {
    none.hidden = false;
    return;
  }
  var data = JSON.parse(holder.textContent);
  function bytes(text) {
    var raw = atob(text), list = new Uint8Array(raw.length);
    for (var i = 0; i < raw.length; i += 1) { list[i] = raw.charCodeAt(i); }
    return list.buffer;
  }
  var steps = new Uint16Array(bytes(data.positions)), n = steps.length / 3;
  var size = [0, 1, 2].map(function (i) { return data.max_mm[i] - data.min_mm[i]; });
  var middle = [0, 1, 2].map(function (i) { return (data.max_mm[i] + data.min_mm[i]) / 2; });
  var radius = 0.5 * Math.hypot(size[0], size[1], size[2]) || 1;
  // x, y, z in mm from the middle; normal; deviation as a part of the full colour, 9 where it is not known.
  var vertices = new Float32Array(n * 7), triangles = [];
  for (var v = 0; v < n; v += 1) {
    for (var c = 0; c < 3; c += 1) { vertices[7 * v + c] = (steps[3 * v + c] / 65535 - 0.5) * size[c]; }
  }
  function paint(of) {
    var off = new Int16Array(bytes(data[of]));
    for (var i = 0; i < n; i += 1) { vertices[7 * i + 6] = off[i] === -32768 ? 9 : Math.max(-1, Math.min(1, off[i] / 1000 / data.most_mm)); }
  }
  paint("off_um");
  var start = 0;
  data.strips.forEach(function (count) {
    for (var i = start; i + 3 < start + count; i += 2) { triangles.push(i, i + 2, i + 1, i + 1, i + 2, i + 3); }
    start += count;
  });
  // Normals are those of all triangles that meet in a place, whichever strip they belong to.
  var sums = new Map(), keys = new Array(n);
  for (v = 0; v < n; v += 1) {
    keys[v] = (steps[3 * v] * 65536 + steps[3 * v + 1]) * 65536 + steps[3 * v + 2];
    if (!sums.has(keys[v])) { sums.set(keys[v], [0, 0, 0]); }
  }
  function at(i) { return [vertices[7 * i], vertices[7 * i + 1], vertices[7 * i + 2]]; }
  function minus(a, b) { return [a[0] - b[0], a[1] - b[1], a[2] - b[2]]; }
  function cross(a, b) { return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]; }
  for (var t = 0; t < triangles.length; t += 3) {
    var p = [at(triangles[t]), at(triangles[t + 1]), at(triangles[t + 2])];
    var normal = cross(minus(p[1], p[0]), minus(p[2], p[0]));
    // Strips that go down are wound the other way round.
    var first = triangles[t] & ~1, up = vertices[7 * (first + 1) + 2] >= vertices[7 * first + 2] ? 1 : -1;
    for (var k = 0; k < 3; k += 1) {
      var sum = sums.get(keys[triangles[t + k]]);
      for (c = 0; c < 3; c += 1) { sum[c] += up * normal[c]; }
    }
  }
  for (v = 0; v < n; v += 1) {
    var of = sums.get(keys[v]), long = Math.hypot(of[0], of[1], of[2]) || 1;
    for (c = 0; c < 3; c += 1) { vertices[7 * v + 3 + c] = of[c] / long; }
  }

  function shader(type, source) {
    var made = gl.createShader(type);
    gl.shaderSource(made, source); gl.compileShader(made);
    return made;
  }
  var program = gl.createProgram();
  gl.attachShader(program, shader(gl.VERTEX_SHADER,
    "attribute vec3 place; attribute vec3 normal; attribute float off; uniform mat4 turn; uniform mat4 lens; varying vec3 n; varying float d;" +
    "void main() { n = (turn * vec4(normal, 0.)).xyz; d = off; gl_Position = lens * turn * vec4(place, 1.); }"));
  gl.attachShader(program, shader(gl.FRAGMENT_SHADER,
    "precision mediump float; varying vec3 n; varying float d;" +
    "void main() { " +
    "vec3 mid = vec3(.969), end = d < 0. ? vec3(.129, .4, .675) : vec3(.698, .094, .169);" +
    "vec3 colour = d > 2. ? vec3(.5) : mix(mid, end, abs(d));" +
    "vec3 m = normalize(n); float light = .38 + .62 * abs(dot(m, normalize(vec3(.3, .4, 1.))));" +
    "gl_FragColor = vec4(colour * light, 1.); }"));
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) { none.hidden = false; return; }
  gl.useProgram(program);
  function attach(name, count, offset) {
    var where = gl.getAttribLocation(program, name);
    gl.enableVertexAttribArray(where);
    gl.vertexAttribPointer(where, count, gl.FLOAT, false, 28, offset);
  }
  var body = gl.createBuffer(), order = gl.createBuffer();
  gl.bindBuffer(gl.ARRAY_BUFFER, body); gl.bufferData(gl.ARRAY_BUFFER, vertices, gl.STATIC_DRAW);
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, order); gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, new Uint32Array(triangles), gl.STATIC_DRAW);
  gl.enable(gl.DEPTH_TEST);
  attach("place", 3, 0); attach("normal", 3, 12); attach("off", 1, 24);

  // Seen from the patient's front at first: x to the right, z upward.
  var azimuth = 0, tilt = 0.15, zoom = 1, planeZ = 0, asked = false, grip = null, moved = 0;
  function turning() {
    var ca = Math.cos(azimuth), sa = Math.sin(azimuth), ct = Math.cos(tilt), st = Math.sin(tilt);
    // Rows: right, up, towards the viewer.
    var right = [ca, sa, 0], toward = [sa * ct, -ca * ct, st], upward = cross(toward, right);
    return [right, upward, toward];
  }
  function dot(row, x, y, z) { return row[0] * x + row[1] * y + row[2] * z; }
  function scales() {
    var aspect = canvas.width / canvas.height, half = radius * 1.05 / zoom;
    return aspect > 1 ? [1 / (half * aspect), 1 / half] : [1 / half, aspect / half];
  }
  function ask() { if (!asked) { asked = true; requestAnimationFrame(draw); } }
  function draw() {
    asked = false;
    var ratio = window.devicePixelRatio || 1, box = canvas.getBoundingClientRect();
    if (!box.width || !box.height) { return; }
    var width = Math.round(box.width * ratio), height = Math.round(box.height * ratio);
    if (canvas.width !== width || canvas.height !== height) { canvas.width = signs.width = width; canvas.height = signs.height = height; }
    gl.viewport(0, 0, width, height);
    gl.clearColor(0.11, 0.11, 0.118, 1); gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    var m = turning(), s = scales();
    gl.uniformMatrix4fv(gl.getUniformLocation(program, "turn"), false,
      [m[0][0], m[1][0], m[2][0], 0, m[0][1], m[1][1], m[2][1], 0, m[0][2], m[1][2], m[2][2], 0, 0, 0, 0, 1]);
    gl.uniformMatrix4fv(gl.getUniformLocation(program, "lens"), false,
      [s[0], 0, 0, 0, 0, s[1], 0, 0, 0, 0, -0.4 / radius, 0, 0, 0, 0, 1]);
    gl.drawElements(gl.TRIANGLES, triangles.length, gl.UNSIGNED_INT, 0);
    mark();
  }
  // The shown plane and the sides, over the model: leafing through planes does not draw the model anew.
  function mark() {
    var m = turning(), s = scales(), width = signs.width, height = signs.height, ratio = window.devicePixelRatio || 1;
    var pen = signs.getContext("2d"), far = [0.62 * size[0] + 2, 0.62 * size[1] + 2, 0.5 * size[2] + 3];
    pen.setTransform(1, 0, 0, 1, 0, 0); pen.clearRect(0, 0, width, height);
    var x = 0.56 * size[0] + 1, y = 0.56 * size[1] + 1, z = planeZ - middle[2];
    pen.strokeStyle = "#ffe14d"; pen.lineWidth = 1.5 * ratio; pen.beginPath();
    [[-x, -y], [x, -y], [x, y], [-x, y]].forEach(function (p) {
      pen.lineTo((dot(m[0], p[0], p[1], z) * s[0] + 1) * width / 2, (1 - dot(m[1], p[0], p[1], z) * s[1]) * height / 2);
    });
    pen.closePath(); pen.stroke();
    pen.font = "bold " + 16 * ratio + "px system-ui, 'DejaVu Sans', sans-serif"; pen.textAlign = "center"; pen.textBaseline = "middle";
    view.sides.forEach(function (letter, i) {
      var axis = i >> 1, reach = far[axis] * (i % 2 ? 1 : -1);
      var px = (m[0][axis] * reach * s[0] + 1) * width / 2, py = (1 - m[1][axis] * reach * s[1]) * height / 2;
      px = Math.max(12 * ratio, Math.min(width - 12 * ratio, px)); py = Math.max(14 * ratio, Math.min(height - 14 * ratio, py));
      if (Math.abs(m[2][axis]) > 0.92) { return; }
      pen.lineWidth = 4 * ratio; pen.strokeStyle = "rgba(0,0,0,.75)"; pen.strokeText(letter, px, py);
      pen.fillStyle = "#fff"; pen.fillText(letter, px, py);
    });
  }
  // The height of the nearest triangle under a place of the canvas.
  function pick(event) {
    var box = canvas.getBoundingClientRect(), m = turning(), s = scales(), best = null;
    var px = ((event.clientX - box.left) / box.width * 2 - 1) / s[0], py = (1 - (event.clientY - box.top) / box.height * 2) / s[1];
    var seen = new Float32Array(n * 3);
    for (var i = 0; i < n; i += 1) {
      for (var r = 0; r < 3; r += 1) { seen[3 * i + r] = m[r][0] * vertices[7 * i] + m[r][1] * vertices[7 * i + 1] + m[r][2] * vertices[7 * i + 2]; }
    }
    for (i = 0; i < triangles.length; i += 3) {
      var a = triangles[i], b = triangles[i + 1], d = triangles[i + 2];
      var ax = seen[3 * a] - px, ay = seen[3 * a + 1] - py, bx = seen[3 * b] - px, by = seen[3 * b + 1] - py, dx = seen[3 * d] - px, dy = seen[3 * d + 1] - py;
      var wa = bx * dy - by * dx, wb = dx * ay - dy * ax, wd = ax * by - ay * bx, whole = wa + wb + wd;
      if (!whole || wa * whole < 0 || wb * whole < 0 || wd * whole < 0) { continue; }
      var depth = (wa * seen[3 * a + 2] + wb * seen[3 * b + 2] + wd * seen[3 * d + 2]) / whole;
      if (!best || depth > best.depth) { best = { depth: depth, z: (wa * vertices[7 * a + 2] + wb * vertices[7 * b + 2] + wd * vertices[7 * d + 2]) / whole + middle[2] }; }
    }
    return best;
  }
  function nearest(z) {
    var best = 0;
    view.z.forEach(function (own, i) { if (Math.abs(own - z) < Math.abs(view.z[best] - z)) { best = i; } });
    return best;
  }
  canvas.addEventListener("pointerdown", function (event) {
    canvas.setPointerCapture(event.pointerId); canvas.focus({ preventScroll: true });
    grip = [event.clientX, event.clientY]; moved = 0;
  });
  canvas.addEventListener("pointermove", function (event) {
    if (!grip) { return; }
    var dx = event.clientX - grip[0], dy = event.clientY - grip[1];
    moved += Math.abs(dx) + Math.abs(dy);
    azimuth -= 0.01 * dx; tilt = Math.max(-1.55, Math.min(1.55, tilt + 0.01 * dy));
    grip = [event.clientX, event.clientY];
    ask();
  });
  canvas.addEventListener("pointerup", function (event) {
    grip = null;
    var hit = moved < 5 && pick(event);
    if (hit) { view.show(nearest(hit.z)); }
  });
  canvas.addEventListener("pointercancel", function () { grip = null; });
  canvas.addEventListener("wheel", function (event) {
    event.preventDefault();
    zoom = Math.max(0.5, Math.min(20, zoom * Math.pow(1.0015, -event.deltaY)));
    ask();
  }, { passive: false });
  canvas.addEventListener("keydown", function (event) {
    var turn = { ArrowLeft: [0.1, 0], ArrowRight: [-0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[event.key];
    if (turn) { azimuth += turn[0]; tilt = Math.max(-1.55, Math.min(1.55, tilt + turn[1])); }
    else if (event.key === "+" || event.key === "=") { zoom = Math.min(20, zoom * 1.2); }
    else if (event.key === "-") { zoom = Math.max(0.5, zoom / 1.2); }
    else { return; }
    event.preventDefault();
    ask();
  });
  var choice = document.getElementById("model-of");
  if (choice) {
    choice.addEventListener("change", function () {
      paint(choice.value);
      gl.bindBuffer(gl.ARRAY_BUFFER, body); gl.bufferData(gl.ARRAY_BUFFER, vertices, gl.STATIC_DRAW);
      ask();
    });
  }
  window.addEventListener("resize", ask);
  view.onShow(function (i) { planeZ = view.z[i]; mark(); });
  ask();
}());
