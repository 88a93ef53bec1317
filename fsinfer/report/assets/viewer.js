// The point cloud in the page: quantized points in WebGL, turned, moved and zoomed by mouse, finger or keys.
(function () {
  'use strict';
  var holder = document.getElementById('viewer');
  if (!holder) { return; }
  var info = JSON.parse(document.getElementById('viewer-info').textContent);
  var canvas = holder.querySelector('canvas'), names = holder.querySelector('.names');
  var legend = holder.querySelector('.key'), modes = holder.querySelectorAll('[data-mode]');
  var gl = null, place = null, parts = {}, buffers = {}, started = false;
  var view = { yaw: 0, pitch: 0, distance: 1, target: [0, 0, 0] }, home = null;
  var mode = null, sizeFactor = 1, budget = info.points, picked = null;
  var wanted = false, moving = 0, lastFrame = 0;

  // Dark blue over green to yellow: told apart by those who see no red or green, and in a grey print.
  var RAMP = [[60, 30, 110], [50, 90, 150], [35, 140, 140], [90, 190, 90], [250, 230, 60]];

  function ramp(value) {
    var at = Math.min(Math.max(value, 0), 1) * (RAMP.length - 1), low = Math.min(Math.floor(at), RAMP.length - 2);
    return RAMP[low].map(function (channel, i) { return channel + (at - low) * (RAMP[low + 1][i] - channel); });
  }

  function treeColour(number) {
    if (!number) { return [96, 104, 99]; }
    // Steps of the golden angle: neighbouring numbers get colours far apart.
    var hue = number * 137.508 % 360, f = function (n) {
      var k = (n + hue / 30) % 12;
      return 255 * (0.62 - 0.34 * Math.max(-1, Math.min(k - 3, 9 - k, 1)));
    };
    return [f(0), f(8), f(4)];
  }

  function decode() {
    var text = atob(document.getElementById('viewer-cloud').textContent.trim());
    var bytes = new Uint8Array(text.length);
    for (var i = 0; i < text.length; i++) { bytes[i] = text.charCodeAt(i); }
    var n = info.points, offset = 6 * n;
    parts.xyz = new Uint16Array(bytes.buffer, 0, 3 * n);
    info.parts.forEach(function (name) {
      var length = name === 'rgb' ? 3 * n : n;
      parts[name] = name === 'tree' ? new Uint16Array(bytes.buffer, offset, n)
        : new Uint8Array(bytes.buffer, offset, length);
      offset += name === 'tree' ? 2 * n : length;
    });
  }

  function heights() {
    // Ends of the colours: a hundredth of the points may lie beyond either.
    var count = Math.min(info.points, 20000), z = new Uint16Array(count);
    for (var i = 0; i < count; i++) { z[i] = parts.xyz[3 * i + 2]; }
    z.sort();
    return [z[Math.floor(0.01 * count)], z[Math.min(Math.floor(0.99 * count), count - 1)]];
  }

  function colours(name) {
    var n = info.points, out = new Uint8Array(4 * n), table, i, c, of;
    if (name === 'rgb') {
      for (i = 0; i < n; i++) {
        out[4 * i] = parts.rgb[3 * i]; out[4 * i + 1] = parts.rgb[3 * i + 1]; out[4 * i + 2] = parts.rgb[3 * i + 2];
      }
      return out;
    }
    table = new Uint8Array(3 * 65536);
    var ends = name === 'height' ? heights() : null;
    for (i = 0; i < 65536; i++) {
      c = name === 'tree' ? treeColour(i)
        : ramp(name === 'height' ? (i - ends[0]) / Math.max(ends[1] - ends[0], 1) : i / 255);
      table[3 * i] = c[0]; table[3 * i + 1] = c[1]; table[3 * i + 2] = c[2];
      if (name === 'confidence' && i > 255) { break; }
    }
    for (i = 0; i < n; i++) {
      of = 3 * (name === 'height' ? parts.xyz[3 * i + 2] : parts[name][i]);
      out[4 * i] = table[of]; out[4 * i + 1] = table[of + 1]; out[4 * i + 2] = table[of + 2];
    }
    return out;
  }

  function legendOf(name) {
    var bar = '<span class="scale" style="background:linear-gradient(90deg,' + RAMP.map(function (c) {
      return 'rgb(' + c.join(',') + ')';
    }).join(',') + ')"></span>';
    if (name === 'height') {
      var ends = heights().map(function (v) { return (info.low[2] + info.step * v).toFixed(1); });
      return 'Height ' + ends[0] + bar + ends[1] + ' ' + info.unit;
    }
    if (name === 'confidence') { return 'Unsure' + bar + 'sure'; }
    if (name === 'tree') { return 'Each measured stem in a colour of its own, all else grey.'; }
    return 'Colours of the photos.';
  }

  function compile(kind, source) {
    var shader = gl.createShader(kind);
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    return shader;
  }

  function start() {
    gl = canvas.getContext('webgl', { antialias: false, alpha: false, powerPreference: 'high-performance' });
    if (!gl) { document.documentElement.classList.add('flat'); return; }
    if (!started) { decode(); }
    started = true;
    var program = gl.createProgram();
    gl.attachShader(program, compile(gl.VERTEX_SHADER,
      'attribute vec3 at; attribute vec4 paint; uniform mat4 matrix; uniform vec3 low; uniform float step, size;' +
      'varying vec3 colour; void main() { gl_Position = matrix * vec4(low + step * at, 1.0);' +
      'gl_PointSize = clamp(size / max(gl_Position.w, 1e-6), 1.0, 14.0); colour = paint.rgb; }'));
    gl.attachShader(program, compile(gl.FRAGMENT_SHADER,
      'precision mediump float; varying vec3 colour; void main() { gl_FragColor = vec4(colour, 1.0); }'));
    gl.bindAttribLocation(program, 0, 'at');
    gl.bindAttribLocation(program, 1, 'paint');
    gl.linkProgram(program);
    gl.useProgram(program);
    place = {};
    ['matrix', 'low', 'step', 'size'].forEach(function (name) { place[name] = gl.getUniformLocation(program, name); });
    buffers.at = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, buffers.at);
    gl.bufferData(gl.ARRAY_BUFFER, parts.xyz, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 3, gl.UNSIGNED_SHORT, false, 0, 0);
    buffers.paint = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, buffers.paint);
    gl.enableVertexAttribArray(1);
    gl.vertexAttribPointer(1, 4, gl.UNSIGNED_BYTE, true, 0, 0);
    gl.enable(gl.DEPTH_TEST);
    gl.clearColor(0.09, 0.115, 0.1, 1);
    if (!home) { frame(); }
    paint(mode || modes[0].dataset.mode);
  }

  function paint(name) {
    mode = name;
    modes.forEach(function (button) { button.setAttribute('aria-pressed', String(button.dataset.mode === name)); });
    legend.innerHTML = legendOf(name);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffers.paint);
    gl.bufferData(gl.ARRAY_BUFFER, colours(name), gl.STATIC_DRAW);
    redraw();
  }

  // All lengths below are relative to the middle of the cloud: map coordinates would be too large for the card.
  function middle() { return info.middle; }

  function frame() {
    home = { yaw: -1.1, pitch: 0.55, distance: 1.25 * info.extent, target: [0, 0, info.ground - middle()[2]] };
    reset();
  }

  function reset() {
    view = { yaw: home.yaw, pitch: home.pitch, distance: home.distance, target: home.target.slice() };
    redraw();
  }

  function axes() {
    var cp = Math.cos(view.pitch), sp = Math.sin(view.pitch), cy = Math.cos(view.yaw), sy = Math.sin(view.yaw);
    return { back: [cp * cy, cp * sy, sp], right: [-sy, cy, 0], up: [-sp * cy, -sp * sy, cp] };
  }

  var HALF = Math.tan(25 * Math.PI / 180);

  function matrix() {
    var a = axes(), d = view.distance, near = Math.max(d / 200, info.extent / 20000), far = d + 4 * info.extent;
    var eye = a.back.map(function (v, i) { return view.target[i] + d * v; });
    var dot = function (v) { return v[0] * eye[0] + v[1] * eye[1] + v[2] * eye[2]; };
    var aspect = canvas.width / canvas.height, fy = 1 / HALF / Math.max(1, 1 / aspect), fx = fy / aspect;
    var k = -(far + near) / (far - near), q = -2 * far * near / (far - near);
    var r = a.right, u = a.up, b = a.back, tx = -dot(r), ty = -dot(u), tz = -dot(b);
    return [fx * r[0], fy * u[0], k * b[0], -b[0], fx * r[1], fy * u[1], k * b[1], -b[1],
      fx * r[2], fy * u[2], k * b[2], -b[2], fx * tx, fy * ty, k * tz + q, -tz];
  }

  function redraw() {
    if (!wanted && gl) { wanted = true; requestAnimationFrame(draw); }
  }

  function move() {
    moving = performance.now();
    redraw();
    clearTimeout(move.later);
    move.later = setTimeout(redraw, 220);
  }

  function draw(now) {
    wanted = false;
    var ratio = Math.min(window.devicePixelRatio || 1, 2);
    var width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
    if (!width || !height || gl.isContextLost()) { return; }
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
    // While it turns on a slow machine fewer points are drawn; they lie in random order.
    var turning = performance.now() - moving < 200, count = info.points;
    if (turning) {
      var passed = now - lastFrame;
      if (passed > 50 && passed < 1000) { budget = Math.max(0.7 * budget, 50000); }
      if (passed < 25) { budget = Math.min(1.15 * budget, info.points); }
      count = Math.min(Math.floor(budget), info.points);
    }
    lastFrame = now;
    var m = matrix();
    gl.viewport(0, 0, width, height);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniformMatrix4fv(place.matrix, false, new Float32Array(m));
    gl.uniform3f(place.low, info.low[0] - middle()[0], info.low[1] - middle()[1], info.low[2] - middle()[2]);
    gl.uniform1f(place.step, info.step);
    // Focal length in pixels times the size of a point: divided by the depth it is the size on the screen.
    var focal = 0.5 * height / HALF / Math.max(1, height / width);
    gl.uniform1f(place.size, sizeFactor * info.spacing * Math.sqrt(info.points / count) * focal);
    gl.drawArrays(gl.POINTS, 0, count);
    label(m);
    holder.dataset.drawn = String(count);
  }

  function label(m) {
    var width = canvas.clientWidth, height = canvas.clientHeight;
    info.trees.forEach(function (tree, index) {
      var span = names.children[index], p = tree.at, w = m[3] * p[0] + m[7] * p[1] + m[11] * p[2] + m[15];
      var x = (m[0] * p[0] + m[4] * p[1] + m[8] * p[2] + m[12]) / w;
      var y = (m[1] * p[0] + m[5] * p[1] + m[9] * p[2] + m[13]) / w;
      var shown = w > 0 && Math.abs(x) < 1 && Math.abs(y) < 1;
      span.style.display = shown ? '' : 'none';
      span.style.transform = 'translate(' + ((x + 1) / 2 * width) + 'px,' + ((1 - y) / 2 * height) + 'px) translate(-50%,-50%)';
      span.classList.toggle('picked', tree.id === picked);
    });
  }

  function turn(dx, dy) {
    view.yaw -= 0.006 * dx;
    view.pitch = Math.min(Math.max(view.pitch + 0.006 * dy, -1.5), 1.5707);
    move();
  }

  function pan(dx, dy) {
    var a = axes(), perPx = 2 * HALF * view.distance / Math.min(canvas.clientHeight, canvas.clientWidth);
    for (var i = 0; i < 3; i++) { view.target[i] += perPx * (-dx * a.right[i] + dy * a.up[i]); }
    move();
  }

  function zoom(factor) {
    view.distance = Math.min(Math.max(view.distance * factor, info.extent / 300), 5 * info.extent);
    move();
  }

  var fingers = {};
  canvas.addEventListener('pointerdown', function (event) {
    canvas.focus({ preventScroll: true });
    canvas.setPointerCapture(event.pointerId);
    fingers[event.pointerId] = [event.clientX, event.clientY];
    event.preventDefault();
  });
  canvas.addEventListener('pointermove', function (event) {
    var before = fingers[event.pointerId], ids = Object.keys(fingers);
    if (!before || !gl) { return; }
    var dx = event.clientX - before[0], dy = event.clientY - before[1];
    if (ids.length === 2) {
      var other = fingers[ids[0] === String(event.pointerId) ? ids[1] : ids[0]];
      var was = Math.hypot(before[0] - other[0], before[1] - other[1]);
      var is = Math.hypot(event.clientX - other[0], event.clientY - other[1]);
      if (is > 1) { zoom(was / is); }
      pan(dx / 2, dy / 2);
    } else if (event.shiftKey || event.buttons === 2 || event.buttons === 4) { pan(dx, dy); } else { turn(dx, dy); }
    fingers[event.pointerId] = [event.clientX, event.clientY];
  });
  ['pointerup', 'pointercancel'].forEach(function (name) {
    canvas.addEventListener(name, function (event) { delete fingers[event.pointerId]; });
  });
  canvas.addEventListener('contextmenu', function (event) { event.preventDefault(); });
  canvas.addEventListener('wheel', function (event) {
    // Only once the cloud was clicked: otherwise the wheel scrolls the page, as people expect.
    if (!gl || (document.activeElement !== canvas && !event.ctrlKey)) { return; }
    event.preventDefault();
    zoom(Math.exp(Math.max(-0.4, Math.min(0.4, 0.0015 * event.deltaY))));
  }, { passive: false });
  canvas.addEventListener('keydown', function (event) {
    var step = 40, moves = {
      ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, -step], ArrowDown: [0, step]
    };
    if (!gl) { return; }
    if (moves[event.key]) { (event.shiftKey ? pan : turn)(moves[event.key][0], moves[event.key][1]); }
    else if (event.key === '+' || event.key === '=') { zoom(0.85); }
    else if (event.key === '-') { zoom(1 / 0.85); }
    else if (event.key === 'Home') { reset(); }
    else { return; }
    event.preventDefault();
  });
  canvas.addEventListener('webglcontextlost', function (event) { event.preventDefault(); });
  canvas.addEventListener('webglcontextrestored', function () { start(); });

  modes.forEach(function (button) {
    button.addEventListener('click', function () { if (gl) { paint(button.dataset.mode); } });
  });
  holder.querySelectorAll('[data-look]').forEach(function (button) {
    button.addEventListener('click', function () {
      if (!gl) { return; }
      reset();
      if (button.dataset.look === 'top') { view.pitch = 1.5707; view.yaw = -Math.PI / 2; }
      if (button.dataset.look === 'side') { view.pitch = 0.02; view.yaw = -Math.PI / 2; }
      redraw();
    });
  });
  holder.querySelector('[data-size]').addEventListener('input', function (event) {
    sizeFactor = Math.pow(2, Number(event.target.value));
    redraw();
  });
  info.trees.forEach(function (tree) {
    tree.at = tree.at.map(function (v, i) { return v - middle()[i]; });
    names.appendChild(document.createElement('span')).textContent = tree.id;
  });
  window.addEventListener('resize', redraw);

  // Told by the rest of the page: another tree was picked, or is to be looked at here.
  document.addEventListener('tree-picked', function (event) { picked = event.detail; redraw(); });
  document.addEventListener('tree-shown', function (event) {
    var tree = info.trees.find(function (one) { return one.id === event.detail; });
    holder.scrollIntoView({ block: 'start' });
    if (!started) { start(); }
    if (!tree || !gl) { return; }
    view.target = tree.at.slice();
    view.distance = 5 * info.metre;
    view.pitch = 0.25;
    redraw();
  });

  // Unpacking takes a moment: only when the reader comes near.
  if ('IntersectionObserver' in window) {
    var watcher = new IntersectionObserver(function (entries) {
      if (entries.some(function (entry) { return entry.isIntersecting; })) {
        watcher.disconnect();
        if (!started) { start(); }
      }
    }, { rootMargin: '300px' });
    watcher.observe(holder);
  } else { start(); }
}());
