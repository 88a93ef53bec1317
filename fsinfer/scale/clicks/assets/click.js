// The page of fsinfer scale --click: panes with a photograph and a loupe each; pixels are those of the scene image.
(function () {
  'use strict';
  const given = JSON.parse(document.getElementById('given').textContent);
  const panes = document.getElementById('panes'), told = document.getElementById('told');
  const use = document.getElementById('use'), add = document.getElementById('add');
  const marks = {};
  Object.entries(given.draft).forEach(function (entry) { marks[entry[0]] = entry[1].slice(); });
  const ZOOMS = [1, 2, 4, 6, 8, 12, 16, 24];
  // Three times what a careful click is off.
  const MUCH_PX = 6;
  let asked = 0, over = false;

  // What a browser says by itself, such as "Failed to fetch", tells nobody what to do.
  const GONE = 'The program that shows this page was ended, and what is clicked now is not kept. Run fsinfer scale ' +
    'again: its page has the clicks until then.';

  function post(what, clicks) {
    const body = JSON.stringify({ clicks: clicks });
    return fetch(what, { method: 'POST', headers: { 'Content-Type': 'application/json' }, body: body })
      .catch(function () { throw new Error(GONE); })
      .then(function (answer) {
        return answer.json().then(function (content) {
          if (!answer.ok) { throw new Error(content.error || 'the answer was ' + answer.status); }
          return content;
        });
      });
  }

  function say(text, wrong) { told.textContent = text; told.classList.toggle('error', Boolean(wrong)); }

  function complete() { return Object.values(marks).filter(function (ends) { return ends[0] && ends[1]; }).length; }

  function changed() {
    if (over) { return; }
    asked += 1;
    const turn = asked;
    use.disabled = true;
    post('draft', marks).catch(function (error) { say(error.message, true); });
    if (complete() < 2) {
      say('Both ends are clicked in ' + complete() + ' of at least 2 photographs.');
      return;
    }
    post('measure', marks).then(function (result) {
      if (turn !== asked || over) { return; }
      say(words(result));
      use.disabled = false;
    }, function (error) { if (turn === asked && !over) { say(error.message, true); } });
  }

  function words(result) {
    const errors = result.errors_px.map(function (error) { return error.toFixed(1); }).join(' and ');
    return 'One unit of the model is ' + result.m_per_unit.toPrecision(5) + ' m, \u00b1 ' +
      (100 * result.rel_std).toFixed(2) + ' % (one standard deviation), by ' + result.photos +
      ' photographs; the ends miss your clicks by up to ' + errors + ' pixels.' +
      (Math.max.apply(null, result.errors_px) > MUCH_PX ? ' That is much: is it the same end in each of them?' : '');
  }

  use.addEventListener('click', function () {
    use.disabled = true;
    post('use', marks).then(function (result) {
      over = true;
      say('Done: ' + words(result) + ' The program goes on; this page may be closed.');
      document.querySelectorAll('button, select').forEach(function (one) { one.disabled = true; });
    }, function (error) { say(error.message, true); });
  });

  function open(number) {
    const pane = document.getElementById('pane').content.firstElementChild.cloneNode(true);
    const image = pane.querySelector('img'), drawing = pane.querySelector('svg'), which = pane.querySelector('.which');
    const loupe = pane.querySelector('canvas'), ends = Array.from(pane.querySelectorAll('.end'));
    const pen = loupe.getContext('2d');
    let photo = given.photos[number], end = 0, zoom = 4, looked = null;

    given.photos.forEach(function (one, index) { which.add(new Option(one.name, String(index))); });

    function own() { return marks[photo.name] || [null, null]; }

    function show(index) {
      photo = given.photos[index];
      which.value = String(index);
      image.alt = 'Photograph ' + photo.name;
      image.src = photo.address;
      pane.dataset.photo = photo.name;
      drawing.setAttribute('viewBox', '-0.5 -0.5 ' + photo.width + ' ' + photo.height);
      drawing.setAttribute('preserveAspectRatio', 'none');
      choose(own()[0] && !own()[1] ? 1 : 0);
    }

    function choose(index) {
      end = index;
      ends.forEach(function (one, at) { one.setAttribute('aria-pressed', String(at === end)); });
      looked = own()[end];
      draw();
    }

    function set(place) {
      if (over) { return; }
      const pair = own().slice();
      pair[end] = place && [
        Math.min(Math.max(place[0], -0.5), photo.width - 0.5), Math.min(Math.max(place[1], -0.5), photo.height - 0.5)
      ];
      marks[photo.name] = pair;
      if (!pair[0] && !pair[1]) { delete marks[photo.name]; }
      looked = pair[end];
      document.dispatchEvent(new Event('marks'));
      changed();
    }

    function place(event) {
      // From the corner of a pixel to its centre.
      const box = image.getBoundingClientRect();
      return [(event.clientX - box.left) / box.width * photo.width - 0.5,
        (event.clientY - box.top) / box.height * photo.height - 0.5];
    }

    function draw() {
      drawing.textContent = '';
      const pair = own(), radius = photo.width / 60;
      if (pair[0] && pair[1]) { shape('line', { x1: pair[0][0], y1: pair[0][1], x2: pair[1][0], y2: pair[1][1] }); }
      pair.forEach(function (mark, at) {
        if (mark) { shape('circle', { cx: mark[0], cy: mark[1], r: radius, 'class': 'end' + at }); }
      });
      pane.querySelector('.times').textContent = zoom + '\u00d7';
      pane.querySelector('.where').textContent = ['End 1', 'End 2'].map(function (name, at) {
        return name + ': ' + (pair[at] ? pair[at].map(function (v) { return v.toFixed(1); }).join(', ') : 'not yet');
      }).join(' \u00b7 ');
      magnify(pair);
    }

    function shape(name, attributes) {
      const one = document.createElementNS('http://www.w3.org/2000/svg', name);
      Object.entries(attributes).forEach(function (entry) { one.setAttribute(entry[0], String(entry[1])); });
      drawing.append(one);
    }

    function magnify(pair) {
      const width = loupe.width, height = loupe.height;
      pen.setTransform(1, 0, 0, 1, 0, 0);
      pen.clearRect(0, 0, width, height);
      if (!looked || !image.complete || !image.naturalWidth) { return; }
      pen.imageSmoothingEnabled = zoom < 4;
      const left = width / 2 - (looked[0] + 0.5) * zoom, top = height / 2 - (looked[1] + 0.5) * zoom;
      pen.drawImage(image, left, top, photo.width * zoom, photo.height * zoom);
      pen.strokeStyle = 'rgba(255, 255, 255, .8)';
      cross(width / 2, height / 2, 12, 2);
      pair.forEach(function (mark, at) {
        if (!mark) { return; }
        pen.strokeStyle = at ? '#1b9aaa' : '#e4572e';
        cross(left + (mark[0] + 0.5) * zoom, top + (mark[1] + 0.5) * zoom, 9, 0);
      });
    }

    function cross(x, y, far, near) {
      pen.lineWidth = 1.5;
      pen.beginPath();
      [[1, 0], [-1, 0], [0, 1], [0, -1]].forEach(function (way) {
        pen.moveTo(x + near * way[0], y + near * way[1]);
        pen.lineTo(x + far * way[0], y + far * way[1]);
      });
      pen.stroke();
    }

    function magnified(step) {
      const at = Math.min(Math.max(ZOOMS.indexOf(zoom) + step, 0), ZOOMS.length - 1);
      zoom = ZOOMS[at];
      draw();
    }

    pane.querySelector('.picture').addEventListener('pointermove', function (event) {
      if (own()[end]) { return; }
      looked = place(event);
      draw();
    });
    pane.querySelector('.picture').addEventListener('click', function (event) {
      const first = !own()[end];
      set(place(event));
      if (first) { loupe.focus({ preventScroll: true }); }
    });
    loupe.addEventListener('click', function (event) {
      if (!looked) { return; }
      const box = loupe.getBoundingClientRect(), scale = loupe.width / box.width;
      set([looked[0] + ((event.clientX - box.left) * scale - loupe.width / 2) / zoom,
        looked[1] + ((event.clientY - box.top) * scale - loupe.height / 2) / zoom]);
    });
    loupe.addEventListener('wheel', function (event) {
      event.preventDefault();
      magnified(event.deltaY < 0 ? 1 : -1);
    }, { passive: false });
    loupe.addEventListener('keydown', function (event) {
      const ways = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
      const way = ways[event.key], mark = own()[end];
      if (!way || !mark) { return; }
      event.preventDefault();
      const step = event.shiftKey ? 5 : 0.5;
      set([mark[0] + step * way[0], mark[1] + step * way[1]]);
    });
    ends.forEach(function (one, at) { one.addEventListener('click', function () { choose(at); }); });
    pane.querySelector('.clear').addEventListener('click', function () { set(null); });
    pane.querySelector('.in').addEventListener('click', function () { magnified(1); });
    pane.querySelector('.out').addEventListener('click', function () { magnified(-1); });
    which.addEventListener('change', function () { show(Number(which.value)); });
    [['.back', -1], ['.next', 1]].forEach(function (entry) {
      pane.querySelector(entry[0]).addEventListener('click', function () {
        show((Number(which.value) + entry[1] + given.photos.length) % given.photos.length);
      });
    });
    image.addEventListener('load', draw);
    // The same photograph may be open twice.
    document.addEventListener('marks', draw);
    panes.append(pane);
    show(number);
  }

  add.addEventListener('click', function () {
    const shown = Array.from(panes.querySelectorAll('.which')).map(function (one) { return Number(one.value); });
    open((Math.max.apply(null, shown.concat(-1)) + 1) % given.photos.length);
  });
  given.opened.forEach(open);
  if (complete() > 1) { changed(); }
}());
