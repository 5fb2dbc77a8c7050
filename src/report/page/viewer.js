(function () {
  "use strict";
  var root = document.documentElement;
  var byId = function (id) { return document.getElementById(id); };
  var all = function (selector, within) { return Array.prototype.slice.call((within || document).querySelectorAll(selector)); };
  var figures = all("#gallery figure");
  if (!figures.length) { return; }
  root.classList.add("js");
  var UNITS_PER_MM = 100;
  var canvas = byId("view"), pen = canvas.getContext("2d"), slider = byId("slider");
  var title = byId("view-title"), panel = byId("view-figures"), readout = byId("readout"), measureButton = byId("measure");
  var rows = all("#plane-table tbody tr"), mapRows = all(".maps rect.row");
  var layers = {};
  all("[data-layer]").forEach(function (box) { layers[box.getAttribute("data-layer")] = box; });
  var data = byId("view-data").textContent, setting = JSON.parse(data);
  var range = setting.range_hu, shown = setting.window_hu ? setting.window_hu.slice() : null;
  var current = 0, zoom = 1, centre = null, measuring = false, line = null, grip = null, asked = false;
  var PAUSE_MS = 200, telling = 0, told = -PAUSE_MS, marked = [];
  var onShow = [];

  // A plane's parts, taken from its picture in the document when it is first shown.
  var plates = figures.map(function (figure) {
    var svg = figure.querySelector("svg"), box = svg.viewBox.baseVal;
    return { svg: svg, width: box.width, height: box.height, name: figure.getAttribute("data-name"), paths: null, grey: null, greyKey: "" };
  });
  function load(plate) {
    if (plate.paths) { return; }
    plate.paths = {};
    ["material", "paths", "solid", "contours", "scan"].forEach(function (name) {
      var path = plate.svg.querySelector("path." + name);
      if (path) { plate.paths[name] = new Path2D(path.getAttribute("d")); }
    });
    var image = plate.svg.querySelector("image");
    if (!image) { return; }
    plate.place = ["x", "y", "width", "height"].map(function (name) { return Number(image.getAttribute(name)); });
    var picture = new Image();
    picture.onload = function () {
      var own = document.createElement("canvas"), pixels;
      own.width = picture.naturalWidth; own.height = picture.naturalHeight;
      var brush = own.getContext("2d", { willReadFrequently: true });
      brush.drawImage(picture, 0, 0);
      pixels = brush.getImageData(0, 0, own.width, own.height);
      plate.bytes = new Uint8Array(own.width * own.height);
      for (var i = 0; i < plate.bytes.length; i += 1) { plate.bytes[i] = pixels.data[4 * i]; }
      plate.grey = own; plate.greyKey = ""; plate.pixels = pixels;
      if (plates[current] === plate) { ask(); }
    };
    picture.src = image.getAttribute("href");
  }
  // Moves the window over the bytes of the picture.
  function expose(plate) {
    var key = shown.join();
    if (plate.greyKey === key) { return; }
    var table = new Uint8Array(256), to = plate.pixels.data;
    for (var v = 0; v < 256; v += 1) {
      var hu = range[0] + (range[1] - range[0]) * v / 255;
      table[v] = Math.max(0, Math.min(255, Math.round(255 * (hu - shown[0]) / Math.max(1, shown[1] - shown[0]))));
    }
    for (var i = 0; i < plate.bytes.length; i += 1) { to[4 * i] = to[4 * i + 1] = to[4 * i + 2] = table[plate.bytes[i]]; }
    plate.grey.getContext("2d").putImageData(plate.pixels, 0, 0);
    plate.greyKey = key;
  }

  // Pixels of the canvas a unit, and where the corner of the frame lies.
  function look() {
    var plate = plates[current], fit = Math.min(canvas.width / plate.width, canvas.height / plate.height);
    if (!centre) { centre = [plate.width / 2, plate.height / 2]; }
    var scale = fit * zoom;
    return { scale: scale, x: canvas.width / 2 - centre[0] * scale, y: canvas.height / 2 - centre[1] * scale };
  }
  function place(event) {
    var box = canvas.getBoundingClientRect(), ratio = canvas.width / box.width, at = look();
    return [((event.clientX - box.left) * ratio - at.x) / at.scale, ((event.clientY - box.top) * ratio - at.y) / at.scale];
  }
  function ask() {
    if (!asked) { asked = true; requestAnimationFrame(draw); }
  }
  function stroke(path, colour, width, dash) {
    if (!path) { return; }
    pen.strokeStyle = colour; pen.lineWidth = width; pen.setLineDash(dash || []);
    pen.stroke(path);
  }
  function draw() {
    asked = false;
    var ratio = window.devicePixelRatio || 1, box = canvas.getBoundingClientRect();
    var width = Math.round(box.width * ratio), height = Math.round(box.height * ratio);
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
    var plate = plates[current], at = look(), unit = ratio / at.scale;
    load(plate);
    pen.setTransform(1, 0, 0, 1, 0, 0);
    pen.fillStyle = "#1c1c1e"; pen.fillRect(0, 0, width, height);
    pen.setTransform(at.scale, 0, 0, at.scale, at.x, at.y);
    pen.lineJoin = "round";
    if (layers.image.checked && plate.grey && shown) {
      expose(plate);
      pen.imageSmoothingEnabled = true;
      pen.save(); pen.beginPath(); pen.rect(0, 0, plate.width, plate.height); pen.clip();
      pen.drawImage(plate.grey, plate.place[0], plate.place[1], plate.place[2], plate.place[3]);
      pen.restore();
    }
    if (layers.material.checked && plate.paths.material) { pen.fillStyle = "rgba(255,179,0,.33)"; pen.fill(plate.paths.material, "evenodd"); }
    if (layers.paths.checked) { stroke(plate.paths.paths, "#2682ff", 1.2 * unit); }
    if (layers.solid.checked) { stroke(plate.paths.solid, "#ff3b30", 2.4 * unit); }
    if (layers.contours.checked) { stroke(plate.paths.contours, "#40eb6e", 1.5 * unit, [7 * unit, 5 * unit]); }
    if (layers.scan && layers.scan.checked) { stroke(plate.paths.scan, "#d580ff", 1.6 * unit); }
    pen.setTransform(ratio, 0, 0, ratio, 0, 0); pen.setLineDash([]);
    signs(plate, at.scale / ratio, box.width, box.height, at, ratio);
    frames += 1;
  }
  function text(words, x, y, align) {
    pen.textAlign = align || "left";
    pen.lineWidth = 4; pen.strokeStyle = "rgba(0,0,0,.75)"; pen.strokeText(words, x, y);
    pen.fillStyle = "#fff"; pen.fillText(words, x, y);
  }
  // Names, letters, scale bar and the measured line, in pixels of the page.
  function signs(plate, scale, width, height, at, ratio) {
    pen.font = "15px system-ui, 'DejaVu Sans', sans-serif";
    text(plate.name, 12, 24);
    pen.font = "bold 20px system-ui, 'DejaVu Sans', sans-serif";
    var side = setting.sides;
    text(side[0], 10, height / 2 + 7); text(side[1], width - 10, height / 2 + 7, "right");
    text(side[2], width / 2, 26, "center"); text(side[3], width / 2, height - 12, "center");
    pen.font = "15px system-ui, 'DejaVu Sans', sans-serif";
    var mm = [100, 50, 20, 10, 5, 2, 1, 0.5, 0.2, 0.1].find(function (l) { return l * UNITS_PER_MM * scale <= 0.25 * width; }) || 0.05;
    var long = mm * UNITS_PER_MM * scale, y = height - 16;
    [["rgba(0,0,0,.75)", 6], ["#fff", 2.5]].forEach(function (style) {
      pen.strokeStyle = style[0]; pen.lineWidth = style[1]; pen.beginPath();
      pen.moveTo(14, y - 6); pen.lineTo(14, y); pen.lineTo(14 + long, y); pen.lineTo(14 + long, y - 6); pen.stroke();
    });
    text(mm + " mm", 14, y - 12);
    if (!line) { return; }
    var ends = line.map(function (p) { return [(p[0] * at.scale + at.x) / ratio, (p[1] * at.scale + at.y) / ratio]; });
    [["rgba(0,0,0,.75)", 5], ["#ffe14d", 2]].forEach(function (style) {
      pen.strokeStyle = style[0]; pen.lineWidth = style[1]; pen.beginPath();
      pen.moveTo(ends[0][0], ends[0][1]); pen.lineTo(ends[1][0], ends[1][1]); pen.stroke();
      ends.forEach(function (e) { pen.beginPath(); pen.arc(e[0], e[1], 4, 0, 7); pen.stroke(); });
    });
    text(length().toFixed(2) + " mm", ends[1][0] + 10, ends[1][1] - 8);
  }
  function length() {
    return Math.hypot(line[1][0] - line[0][0], line[1][1] - line[0][1]) / UNITS_PER_MM;
  }

  function show(i) {
    current = Math.max(0, Math.min(figures.length - 1, i));
    slider.value = String(current);
    for (var d = 1; d < 4; d += 1) { [current - d, current + d].forEach(function (k) { if (plates[k]) { load(plates[k]); } }); }
    ask();
    if (!telling) { telling = setTimeout(tell, performance.now() - told > PAUSE_MS ? 0 : PAUSE_MS); }
  }
  // What stands beside the picture: words, figures, marks in tables and in the model. While planes rush by it follows a few
  // times a second; laying out the page anew costs more than a picture.
  function tell() {
    telling = 0; told = performance.now();
    var plate = plates[current], figure = figures[current], number = figure.getAttribute("data-plane");
    title.textContent = plate.name;
    canvas.setAttribute("aria-label", plate.svg.getAttribute("aria-label"));
    panel.replaceChildren(figure.querySelector("figcaption dl").cloneNode(true));
    slider.setAttribute("aria-valuetext", plate.name);
    marked.forEach(function (element) { element.classList.remove("current"); });
    marked = [rows[current]].concat(mapRows.filter(function (row) { return row.getAttribute("data-plane") === number; })).filter(Boolean);
    marked.forEach(function (element) { element.classList.add("current"); });
    onShow.forEach(function (listener) { listener(current); });
  }
  function zoomBy(factor, about) {
    var before = look(), next = Math.max(0.5, Math.min(60, zoom * factor));
    about = about || centre;
    centre = [about[0] + (centre[0] - about[0]) * zoom / next, about[1] + (centre[1] - about[1]) * zoom / next];
    zoom = next;
    ask();
    return before;
  }
  function fit() { zoom = 1; centre = null; ask(); }
  function setMeasuring(on) {
    measuring = on; measureButton.setAttribute("aria-pressed", String(on)); canvas.classList.toggle("measuring", on);
    if (!on) { line = null; readout.textContent = ""; }
    ask();
  }

  slider.max = String(figures.length - 1);
  slider.addEventListener("input", function () { show(Number(slider.value)); });
  byId("previous").addEventListener("click", function () { show(current - 1); });
  byId("next").addEventListener("click", function () { show(current + 1); });
  byId("closer").addEventListener("click", function () { zoomBy(1.4); });
  byId("farther").addEventListener("click", function () { zoomBy(1 / 1.4); });
  byId("fit").addEventListener("click", fit);
  measureButton.addEventListener("click", function () { setMeasuring(!measuring); });
  Object.keys(layers).forEach(function (name) { layers[name].addEventListener("change", ask); });
  function planeButtons(element) {
    element.addEventListener("click", function () {
      var number = element.getAttribute("data-plane");
      show(figures.findIndex(function (f) { return f.getAttribute("data-plane") === number; }));
      byId("browser").scrollIntoView();
    });
  }
  all("button[data-plane]").concat(mapRows).forEach(planeButtons);
  if (shown) {
    var level = byId("level"), contrast = byId("contrast");
    var turn = function () {
      var half = Number(contrast.value) / 2, middle = Number(level.value);
      shown = [middle - half, middle + half];
      byId("window-text").textContent = Math.round(middle) + " / " + Math.round(2 * half) + " HU";
      ask();
    };
    level.min = String(Math.round(range[0])); level.max = String(Math.round(range[1]));
    contrast.min = "20"; contrast.max = String(Math.round(range[1] - range[0]));
    var reset = function () {
      level.value = String(Math.round((setting.window_hu[0] + setting.window_hu[1]) / 2));
      contrast.value = String(Math.round(setting.window_hu[1] - setting.window_hu[0]));
      turn();
    };
    level.addEventListener("input", turn); contrast.addEventListener("input", turn);
    byId("window-reset").addEventListener("click", reset);
    reset();
  }

  canvas.addEventListener("wheel", function (event) {
    event.preventDefault();
    zoomBy(Math.pow(1.0015, -event.deltaY), place(event));
  }, { passive: false });
  canvas.addEventListener("pointerdown", function (event) {
    canvas.setPointerCapture(event.pointerId); canvas.focus({ preventScroll: true });
    var at = place(event);
    grip = at;
    if (measuring) { line = [at, at]; }
  });
  canvas.addEventListener("pointermove", function (event) {
    var at = place(event);
    if (grip && measuring) { line[1] = at; readout.textContent = "Measured: " + length().toFixed(2) + " mm"; ask(); }
    else if (grip) { centre = [centre[0] + grip[0] - at[0], centre[1] + grip[1] - at[1]]; ask(); }
    else if (!line) { readout.textContent = level_at(plates[current], at); }
  });
  canvas.addEventListener("pointerup", function () { grip = null; });
  canvas.addEventListener("pointercancel", function () { grip = null; });
  function level_at(plate, at) {
    if (!plate.bytes || !plate.place) { return ""; }
    var i = Math.floor((at[0] - plate.place[0]) / plate.place[2] * plate.grey.width);
    var j = Math.floor((at[1] - plate.place[1]) / plate.place[3] * plate.grey.height);
    if (i < 0 || j < 0 || i >= plate.grey.width || j >= plate.grey.height) { return ""; }
    var byte = plate.bytes[j * plate.grey.width + i];
    if (byte === 0 || byte === 255) { return "CT under the pointer: beyond the range of this picture"; }
    return "CT under the pointer: about " + Math.round(range[0] + (range[1] - range[0]) * byte / 255) + " HU";
  }

  var names = ["image", "contours", "solid", "paths", "material", "scan"].filter(function (name) { return layers[name]; });
  document.addEventListener("keydown", function (event) {
    var target = event.target;
    if (event.altKey || event.ctrlKey || event.metaKey || event.defaultPrevented) { return; }
    if (target.closest && (target.closest(".scroll") || target.closest("#model")) && /Arrow|Home|End|Page/.test(event.key)) { return; }
    if (target.type === "range" && target !== slider) { return; }
    var step = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1, PageDown: -10, PageUp: 10 }[event.key];
    if (step !== undefined) { show(current + step); }
    else if (event.key === "Home") { show(0); }
    else if (event.key === "End") { show(figures.length - 1); }
    else if (event.key === "+" || event.key === "=") { zoomBy(1.4); }
    else if (event.key === "-") { zoomBy(1 / 1.4); }
    else if (event.key === "0") { fit(); }
    else if (event.key === "m") { setMeasuring(!measuring); }
    else if (event.key === "Escape") { setMeasuring(false); }
    else if (/^[1-6]$/.test(event.key) && names[Number(event.key) - 1]) { var box = layers[names[Number(event.key) - 1]]; box.checked = !box.checked; ask(); }
    else { return; }
    event.preventDefault();
  });
  var frames = 0;
  window.addEventListener("resize", ask);
  window.lumenfabView = {
    show: show,
    plane: function () { return current; },
    frames: function () { return frames; },
    onShow: function (listener) { onShow.push(listener); listener(current); },
    z: figures.map(function (f) { return Number(f.getAttribute("data-z")); }),
    sides: setting.sides
  };
  show(Math.floor(figures.length / 2));
}());
