// Curves, maps and bars on canvas. Each chart is built once and gives back {draw(width)}, so that it can follow the
// width of the page. Times are drawn by uPlot in report.js, which shares colours and number formats from here.
const Charts = (function () {
  'use strict';
  const INK = '#1c2430', SOFT = '#5d6b7c', GRID = '#e6eaef', FRAME = '#aeb8c4';
  const FONT = '12px system-ui, -apple-system, "Segoe UI", Roboto, "Liberation Sans", Arial, sans-serif';
  const ROLES = { measured: '#27313f', simulated: '#e0650c', demand: '#1f6fc0', limit: '#b4231f', band: '#f3cfb0' };
  const PALETTE = ['#1f6fc0', '#e0650c', '#178a5c', '#8a4fbf', '#c2337d', '#0f8ea3', '#8a6d00', '#6b7785'];
  const SEQUENTIAL = ['#fdfbe8', '#e3f0c8', '#b5dfc0', '#7cc8bd', '#48a9b8', '#2f83ad', '#2b5b9a', '#2a3478'];
  const DIVERGING = ['#23509e', '#6f9fd4', '#c3d9ee', '#fafafa', '#f6cdbb', '#de8564', '#a92b28'];

  const name = (axis) => axis.label + (axis.unit ? ' [' + axis.unit + ']' : '');
  const finite = (v) => typeof v === 'number' && Number.isFinite(v);

  // Colours of a panel: roles first, then the palette without the colours that the roles took.
  // A label keeps its colour in all panels of a plot: give the `known` of the first panel to the next.
  function colours(series, known) {
    known = known || { taken: series.map((s) => ROLES[s.role]), of: new Map() };
    const free = PALETTE.filter((c) => !known.taken.includes(c));
    const seen = {};
    return series.map((s) => {
      const own = ROLES[s.role];
      // A second line of the same role must not look like the first; bounds may.
      if (own && (s.role === 'limit' || s.role === 'band' || !seen[s.role])) { seen[s.role] = true; return own; }
      if (!known.of.has(s.label)) known.of.set(s.label, free[known.of.size % free.length]);
      return known.of.get(s.label);
    });
  }

  function step(span, count) {
    const raw = span / Math.max(1, count), power = Math.pow(10, Math.floor(Math.log10(raw)));
    const f = raw / power;
    return (f <= 1 ? 1 : f <= 2 ? 2 : f <= 5 ? 5 : 10) * power;
  }
  function ticks(low, high, count) {
    let d = step(high - low, count), out = [];
    // One tick gives no scale: finer steps until there are three, where the axis has a length at all.
    for (let finer = count; high > low && Math.floor(high / d) - Math.ceil(low / d) < 2 && finer < 20; ) d = step(high - low, ++finer);
    const first = Math.ceil(low / d - 1e-9), n = Math.min(100, Math.floor(high / d + 1e-9) - first); // bounded: k + 1 may be k
    for (let i = 0; i <= n; i++) out.push((first + i) * d);
    return { step: d, at: out };
  }
  function label(v, d) {
    if (v === 0 || Math.abs(v) < d * 1e-6) return '0';
    if (Math.abs(v) >= 1e6 || d < 1e-5) return v.toExponential(Math.max(0, Math.floor(Math.log10(Math.abs(v))) - Math.floor(Math.log10(d)))).replace('+', '');
    let decimals = 0; // as many as the step needs: 2.5 needs one
    while (decimals < 10 && Math.abs(d * 10 ** decimals - Math.round(d * 10 ** decimals)) > 1e-6 * d * 10 ** decimals) decimals++;
    return v.toFixed(decimals);
  }
  function short(v, digits) {
    if (!finite(v)) return '–';
    const text = v.toPrecision(digits || 5);
    return text.includes('e') ? text.replace('+', '') : String(Number(text));
  }
  function extent(lists, pad) {
    let low = Infinity, high = -Infinity;
    for (const list of lists) for (const v of list) if (finite(v)) { if (v < low) low = v; if (v > high) high = v; }
    if (low > high) return [0, 1];
    if (low === high) { const d = Math.abs(low) * 0.1 || 1; return [low - d, high + d]; }
    return [low - pad * (high - low), high + pad * (high - low)];
  }

  function element(tag, cls, parent, text) {
    const e = document.createElement(tag);
    if (cls) e.className = cls;
    if (text !== undefined) e.textContent = text;
    if (parent) parent.appendChild(e);
    return e;
  }
  function swatch(parent, colour, shape) {
    const s = element('span', 'swatch ' + (shape || ''), parent);
    if (shape === 'dot' || shape === 'box') s.style.background = colour; else s.style.borderTopColor = colour;
  }
  function legend(parent, entries) {
    const box = element('span', 'legend', parent);
    for (const e of entries) {
      const item = element('span', 'entry', box);
      swatch(item, e.colour, e.shape);
      element('span', '', item, e.label);
    }
  }

  // A canvas in CSS pixels, sharp on any screen.
  function surface(canvas, w, h) {
    const ratio = Math.max(2, window.devicePixelRatio || 1); // at least 2: a printer is finer than a screen
    canvas.width = Math.round(w * ratio); canvas.height = Math.round(h * ratio);
    canvas.style.width = w + 'px'; canvas.style.height = h + 'px';
    const c = canvas.getContext('2d');
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.fillStyle = '#fff'; c.fillRect(0, 0, w, h);
    c.font = FONT; c.lineWidth = 1;
    return c;
  }
  function line(c, x0, y0, x1, y1) { c.beginPath(); c.moveTo(x0, y0); c.lineTo(x1, y1); c.stroke(); }

  // Grid and numbers around a box {l, t, r, b} with ranges x and y; gives the two coordinate functions.
  function axes(c, box, x, y, grid) {
    const px = (v) => box.l + (v - x[0]) / (x[1] - x[0]) * (box.r - box.l);
    const py = (v) => box.b - (v - y[0]) / (y[1] - y[0]) * (box.b - box.t);
    const tx = ticks(x[0], x[1], (box.r - box.l) / 50), ty = ticks(y[0], y[1], (box.b - box.t) / 38);
    c.fillStyle = SOFT; c.strokeStyle = grid ? GRID : FRAME;
    c.textAlign = 'center'; c.textBaseline = 'top';
    for (const v of tx.at) {
      const p = Math.round(px(v)) + 0.5;
      line(c, p, grid ? box.t : box.b, p, box.b + 4);
      c.fillText(label(v, tx.step), p, box.b + 7);
    }
    c.textAlign = 'right'; c.textBaseline = 'middle';
    for (const v of ty.at) {
      const p = Math.round(py(v)) + 0.5;
      line(c, box.l - 4, p, grid ? box.r : box.l, p);
      c.fillText(label(v, ty.step), box.l - 7, p);
    }
    c.strokeStyle = FRAME; c.strokeRect(box.l + 0.5, box.t + 0.5, box.r - box.l, box.b - box.t);
    return { px, py };
  }
  function clip(c, box, paint) {
    c.save(); c.beginPath(); c.rect(box.l, box.t, box.r - box.l, box.b - box.t); c.clip(); paint(); c.restore();
  }

  // ---- curves and clouds
  function xy(host, p, ui) {
    const paint = colours(p.series);
    const head = element('div', 'panel-head', host);
    element('span', 'axis-name', head, name(p.y));
    legend(head, p.series.map((s, i) => ({ label: s.label, colour: paint[i], shape: s.line ? (dashed(s.role) ? 'dash' : '') : 'dot' })).filter((e) => e.label));
    const own = element('div', 'own', host), canvas = element('canvas', '', own);
    element('div', 'axis-below', host, name(p.x));
    const full = { x: extent(p.series.map((s) => s.x), 0.04), y: extent(p.series.map((s) => s.y), 0.06) };
    let view = full, width = 0, box, map;
    function draw(w) {
      width = w;
      const h = Math.round(Math.min(420, Math.max(240, w * 0.62)));
      const c = surface(canvas, w, h);
      box = { l: 56, t: 6, r: w - 12, b: h - 26 };
      if (p.equal) { // the longer unit decides; the box gives way
        const unit = Math.min((box.r - box.l) / (view.x[1] - view.x[0]), (box.b - box.t) / (view.y[1] - view.y[0]));
        box.r = box.l + unit * (view.x[1] - view.x[0]); box.b = box.t + unit * (view.y[1] - view.y[0]);
      }
      map = axes(c, box, view.x, view.y, true);
      clip(c, box, () => p.series.forEach((s, i) => curve(c, s, paint[i], map)));
      if (!p.series.some((s) => s.x.some((v, k) => finite(v) && finite(s.y[k])))) {
        c.textAlign = 'center'; c.fillStyle = SOFT; c.fillText('no finite value', (box.l + box.r) / 2, (box.t + box.b) / 2);
      }
    }
    zoomable(own, canvas, () => box, (a, b) => {
      view = a ? { x: back(a.x, b.x, view.x, box.l, box.r), y: back(b.y, a.y, view.y, box.b, box.t) } : full;
      ui.zoomed(view !== full);
      draw(width);
    });
    ui.readout = readout(own);
    ui.reset.addEventListener('click', () => { view = full; ui.zoomed(false); draw(width); });
    hover(canvas, () => box, ui, (q) => {
      const x = view.x[0] + (q.x - box.l) / (box.r - box.l) * (view.x[1] - view.x[0]);
      const y = view.y[0] + (box.b - q.y) / (box.b - box.t) * (view.y[1] - view.y[0]);
      return p.x.label + ' ' + short(x, 4) + ' ' + p.x.unit + ', ' + p.y.label + ' ' + short(y, 4) + ' ' + p.y.unit;
    });
    return { draw, canvas };
  }
  const dashed = (role) => role === 'limit' || role === 'demand';
  function curve(c, s, colour, map) {
    c.strokeStyle = c.fillStyle = colour;
    if (s.role === 'band') {
      c.globalAlpha = 0.55; c.beginPath();
      s.x.forEach((x, k) => { if (finite(x) && finite(s.y[k])) c.lineTo(map.px(x), map.py(s.y[k])); });
      c.closePath(); c.fill(); c.globalAlpha = 1;
      return;
    }
    if (s.line) {
      c.lineWidth = 1.6; c.setLineDash(dashed(s.role) ? [6, 4] : []); c.lineJoin = 'round';
      c.beginPath();
      let pen = false;
      s.x.forEach((x, k) => {
        if (!finite(x) || !finite(s.y[k])) { pen = false; return; }
        if (pen) c.lineTo(map.px(x), map.py(s.y[k])); else c.moveTo(map.px(x), map.py(s.y[k]));
        pen = true;
      });
      c.stroke(); c.setLineDash([]);
    }
    if (s.points || !s.line) {
      const r = s.x.length > 600 ? 1.6 : 2.8;
      c.globalAlpha = s.x.length > 600 ? 0.45 : 0.85;
      s.x.forEach((x, k) => {
        if (!finite(x) || !finite(s.y[k])) return;
        c.beginPath(); c.arc(map.px(x), map.py(s.y[k]), r, 0, 7); c.fill();
        // On a map a dark point lies on dark colours.
        if (s.ring) { c.strokeStyle = '#ffffff'; c.lineWidth = 1; c.stroke(); }
      });
      c.globalAlpha = 1;
    }
  }
  const back = (p0, p1, range, a, b) => [p0, p1].map((p) => range[0] + (p - a) / (b - a) * (range[1] - range[0]));

  // Calls zoom(corner, corner) after a drag and zoom() after a double click.
  function zoomable(own, canvas, box, zoom) {
    let from = null, mark = null;
    const at = (e) => {
      const q = canvas.getBoundingClientRect(), b = box();
      return { x: Math.min(b.r, Math.max(b.l, e.clientX - q.left)), y: Math.min(b.b, Math.max(b.t, e.clientY - q.top)) };
    };
    const corners = (a, b) => [{ x: Math.min(a.x, b.x), y: Math.min(a.y, b.y) }, { x: Math.max(a.x, b.x), y: Math.max(a.y, b.y) }];
    const end = () => { if (mark) mark.remove(); mark = null; from = null; };
    canvas.addEventListener('pointerdown', (e) => {
      if (e.button !== 0) return;
      from = at(e); canvas.setPointerCapture(e.pointerId); mark = element('div', 'zoom-box', own);
    });
    canvas.addEventListener('pointermove', (e) => {
      if (!from) return;
      const [a, b] = corners(from, at(e));
      Object.assign(mark.style, { left: a.x + 'px', top: a.y + 'px', width: b.x - a.x + 'px', height: b.y - a.y + 'px' });
    });
    canvas.addEventListener('pointerup', (e) => {
      if (!from) return;
      const [a, b] = corners(from, at(e));
      end();
      if (b.x - a.x > 6 && b.y - a.y > 6) zoom(a, b);
    });
    canvas.addEventListener('pointercancel', end);
    canvas.addEventListener('dblclick', () => zoom());
  }
  // Lies on the chart, so that nothing moves when it appears.
  const readout = (own) => element('span', 'readout', own);
  function hover(canvas, box, ui, text) {
    canvas.addEventListener('pointermove', (e) => {
      const q = canvas.getBoundingClientRect(), b = box(), at = { x: e.clientX - q.left, y: e.clientY - q.top };
      const inside = at.x >= b.l && at.x <= b.r && at.y >= b.t && at.y <= b.b;
      ui.readout.textContent = inside ? text(at) : '';
    });
    canvas.addEventListener('pointerleave', () => { ui.readout.textContent = ''; });
  }

  // ---- maps
  function ramp(stops) {
    const rgb = stops.map((s) => [1, 3, 5].map((i) => parseInt(s.slice(i, i + 2), 16)));
    return (f) => {
      const g = Math.min(1, Math.max(0, f)) * (rgb.length - 1), i = Math.min(rgb.length - 2, Math.floor(g));
      return rgb[i].map((a, k) => Math.round(a + (g - i) * (rgb[i + 1][k] - a)));
    };
  }
  const css = (rgb) => 'rgb(' + rgb.join(',') + ')';

  function heat(host, p, ui) {
    const nx = p.xs.length, ny = p.ys.length, smooth = p.contours && nx > 1 && ny > 1;
    let range = p.range || extent([p.zs], 0);
    if (p.scale === 'diverging') { const m = Math.max(Math.abs(range[0]), Math.abs(range[1])); range = [-m, m]; }
    const colour = ramp(p.scale === 'diverging' ? DIVERGING : SEQUENTIAL);
    const shade = (z) => colour((z - range[0]) / (range[1] - range[0]));
    const head = element('div', 'panel-head', host);
    element('span', 'axis-name', head, name(p.y));
    const over = ['#1c2430', '#b4231f', '#8a4fbf'];
    legend(head, p.overlays.map((o, i) => ({ label: o.label, colour: over[i % 3], shape: o.line ? '' : 'dot' })));
    const z = element('span', 'axis-name', head, name(p.z));
    z.style.marginLeft = 'auto';
    const own = element('div', 'own', host), canvas = element('canvas', '', own);
    element('div', 'axis-below', host, name(p.x));
    ui.readout = readout(own);
    const edges = (v) => v.length < 2 ? [v[0] - 0.5, v[0] + 0.5] :
      [1.5 * v[0] - 0.5 * v[1], ...v.slice(1).map((b, i) => 0.5 * (v[i] + b)), 1.5 * v[v.length - 1] - 0.5 * v[v.length - 2]];
    const ex = edges(p.xs), ey = edges(p.ys);
    const x = smooth ? [p.xs[0], p.xs[nx - 1]] : [ex[0], ex[nx]], y = smooth ? [p.ys[0], p.ys[ny - 1]] : [ey[0], ey[ny]];
    // Where numbers would not fit between breakpoints, all cells are as wide, as in the table of an ECU.
    const count = (v) => v.map((_, i) => i), half = (v) => [...count(v), v.length].map((i) => i - 0.5);
    const scaled = { xs: p.xs, ys: p.ys, ex, ey, x, y }, even = { xs: count(p.xs), ys: count(p.ys), ex: half(p.xs), ey: half(p.ys), x: [-0.5, nx - 0.5], y: [-0.5, ny - 0.5] };
    let box, g = scaled;
    function draw(w) {
      const h = Math.round(Math.min(400, Math.max(240, w * 0.62)));
      const c = surface(canvas, w, h);
      box = { l: 56, t: 6, r: w - 66, b: h - 26 };
      const at = (grid) => ({
        px: (v) => box.l + (v - grid.x[0]) / (grid.x[1] - grid.x[0]) * (box.r - box.l),
        py: (v) => box.b - (v - grid.y[0]) / (grid.y[1] - grid.y[0]) * (box.b - box.t),
      });
      const numbers = p.cell_values && !smooth;
      g = numbers && !p.overlays.length && !room(c, p, scaled, at(scaled), range) ? even : scaled;
      const { px, py } = at(g);
      if (smooth) fill(c, box, x, y, (u, v) => bilinear(p, u, v), shade);
      else cells(c, p, g.ex, g.ey, px, py, shade);
      if (smooth) {
        // A level at an end of the range is the rounding of whatever stands there.
        const levels = ticks(range[0], range[1], 8), end = 0.01 * (range[1] - range[0]);
        contour(c, box, p, px, py, { ...levels, at: levels.at.filter((v) => v > range[0] + end && v < range[1] - end) });
      }
      clip(c, { l: box.l - 4, t: box.t - 4, r: box.r + 4, b: box.b + 4 }, () => p.overlays.forEach((o, i) => curve(c, { ...o, ring: true }, over[i % 3], { px, py })));
      if (g === even) breakpoints(c, box, p, px, py);
      else axes(c, box, x, y, false);
      if (numbers && room(c, p, g, { px, py }, range)) values(c, p, g, px, py, shade, range);
      bar(c, box, range, shade);
    }
    hover(canvas, () => box, ui, (q) => {
      const u = g.x[0] + (q.x - box.l) / (box.r - box.l) * (g.x[1] - g.x[0]), v = g.y[0] + (box.b - q.y) / (box.b - box.t) * (g.y[1] - g.y[0]);
      const i = cell(g.ex, u), j = cell(g.ey, v), at = smooth ? bilinear(p, u, v) : p.zs[j * nx + i];
      const [cx, cy] = g === even ? [p.xs[i], p.ys[j]] : [u, v];
      return p.x.label + ' ' + short(cx, 4) + ' ' + p.x.unit + ', ' + p.y.label + ' ' + short(cy, 4) + ' ' + p.y.unit + ': ' + short(at) + ' ' + p.z.unit;
    });
    return { draw, canvas };
  }
  function cell(edges, v) {
    let i = 0;
    while (i < edges.length - 2 && v > edges[i + 1]) i++;
    return i;
  }
  function bilinear(p, u, v) {
    const nx = p.xs.length, i = cell(p.xs, u), j = cell(p.ys, v);
    const a = (u - p.xs[i]) / (p.xs[i + 1] - p.xs[i]), b = (v - p.ys[j]) / (p.ys[j + 1] - p.ys[j]), k = j * nx + i;
    const z = [p.zs[k], p.zs[k + 1], p.zs[k + nx], p.zs[k + nx + 1]];
    return z.every(finite) ? (1 - b) * ((1 - a) * z[0] + a * z[1]) + b * ((1 - a) * z[2] + a * z[3]) : NaN;
  }
  function fill(c, box, x, y, value, shade) {
    const w = Math.max(1, Math.round(box.r - box.l)), h = Math.max(1, Math.round(box.b - box.t));
    const off = document.createElement('canvas');
    off.width = w; off.height = h;
    const oc = off.getContext('2d'), image = oc.createImageData(w, h);
    for (let j = 0; j < h; j++) for (let i = 0; i < w; i++) {
      const z = value(x[0] + (i + 0.5) / w * (x[1] - x[0]), y[1] - (j + 0.5) / h * (y[1] - y[0]));
      const rgb = finite(z) ? shade(z) : [240, 240, 240], k = 4 * (j * w + i);
      image.data[k] = rgb[0]; image.data[k + 1] = rgb[1]; image.data[k + 2] = rgb[2]; image.data[k + 3] = 255;
    }
    oc.putImageData(image, 0, 0);
    c.drawImage(off, box.l, box.t, box.r - box.l, box.b - box.t);
  }
  function cells(c, p, ex, ey, px, py, shade) {
    const nx = p.xs.length;
    for (let j = 0; j < p.ys.length; j++) for (let i = 0; i < nx; i++) {
      const z = p.zs[j * nx + i];
      c.fillStyle = finite(z) ? css(shade(z)) : '#f0f0f0';
      const l = Math.round(px(ex[i])), r = Math.round(px(ex[i + 1])), t = Math.round(py(ey[j + 1])), b = Math.round(py(ey[j]));
      c.fillRect(l, t, r - l, b - t);
    }
  }
  const numbers = (p, range) => {
    const step = Math.pow(10, Math.floor(Math.log10(range[1] - range[0])) - 2);
    return p.zs.map((z) => (finite(z) ? label(z, step) : ''));
  };
  function room(c, p, g, { px, py }, range) {
    const gaps = (v, at) => v.slice(1).map((b, i) => Math.abs(at(b) - at(v[i])));
    const wide = Math.max(...numbers(p, range).map((t) => c.measureText(t).width));
    return Math.min(...gaps(g.xs, px), 1e9) >= wide + 4 && Math.min(...gaps(g.ys, py), 1e9) >= 13; // else the cursor reads them
  }
  function values(c, p, g, px, py, shade, range) {
    const nx = p.xs.length, text = numbers(p, range);
    c.textAlign = 'center'; c.textBaseline = 'middle';
    p.zs.forEach((z, k) => {
      if (!finite(z)) return;
      const rgb = shade(z);
      c.fillStyle = 0.3 * rgb[0] + 0.59 * rgb[1] + 0.11 * rgb[2] > 140 ? INK : '#fff';
      c.fillText(text[k], px(g.xs[k % nx]), py(g.ys[Math.floor(k / nx)]));
    });
  }
  // Breakpoints of cells that are all as wide; one that would touch the last is left out.
  function breakpoints(c, box, p, px, py) {
    c.fillStyle = SOFT; c.textAlign = 'center'; c.textBaseline = 'top';
    let end = -1e9;
    p.xs.forEach((v, i) => {
      const text = short(v, 5), w = 0.5 * c.measureText(text).width;
      if (px(i) - w < end + 3) return;
      c.fillText(text, px(i), box.b + 7);
      end = px(i) + w;
    });
    c.textAlign = 'right'; c.textBaseline = 'middle';
    p.ys.forEach((v, j) => c.fillText(short(v, 5), box.l - 7, py(j)));
    c.strokeStyle = FRAME; c.strokeRect(box.l + 0.5, box.t + 0.5, box.r - box.l, box.b - box.t);
  }
  // Marching squares on a refined grid, so that the lines follow the bilinear surface that is filled.
  function contour(c, box, p, px, py, levels) {
    const n = 72, U = [], V = [];
    const x0 = p.xs[0], x1 = p.xs[p.xs.length - 1], y0 = p.ys[0], y1 = p.ys[p.ys.length - 1];
    for (let i = 0; i <= n; i++) { U.push(x0 + i / n * (x1 - x0)); V.push(y0 + i / n * (y1 - y0)); }
    const Z = V.map((v) => U.map((u) => bilinear(p, u, v)));
    const placed = [], labels = [];
    c.strokeStyle = 'rgba(28,36,48,0.55)'; c.lineWidth = 1;
    for (const level of levels.at) {
      const mids = [];
      c.beginPath();
      for (let j = 0; j < n; j++) for (let i = 0; i < n; i++) {
        const corner = [[i, j], [i + 1, j], [i + 1, j + 1], [i, j + 1]], cut = [];
        for (let k = 0; k < 4; k++) {
          const [a, b] = [corner[k], corner[(k + 1) % 4]], za = Z[a[1]][a[0]], zb = Z[b[1]][b[0]];
          if (!finite(za) || !finite(zb) || (za < level) === (zb < level)) continue;
          const f = (level - za) / (zb - za);
          cut.push([px(U[a[0]] + f * (U[b[0]] - U[a[0]])), py(V[a[1]] + f * (V[b[1]] - V[a[1]]))]);
        }
        for (let k = 0; k + 1 < cut.length; k += 2) {
          c.moveTo(...cut[k]); c.lineTo(...cut[k + 1]);
          mids.push([(cut[k][0] + cut[k + 1][0]) / 2, (cut[k][1] + cut[k + 1][1]) / 2]);
        }
      }
      c.stroke();
      // One number per line: near the falling diagonal, away from the frame and from other numbers.
      const u = (q) => (q[0] - box.l) / (box.r - box.l), v = (q) => (q[1] - box.t) / (box.b - box.t);
      const best = mids.filter((q) => u(q) > 0.06 && u(q) < 0.94 && v(q) > 0.06 && v(q) < 0.94)
        .filter((q) => placed.every((o) => Math.abs(o[0] - q[0]) > 38 || Math.abs(o[1] - q[1]) > 15))
        .sort((a, b) => Math.abs(u(a) - v(a)) - Math.abs(u(b) - v(b)))[0];
      if (best) { placed.push(best); labels.push([best, label(level, levels.step)]); }
    }
    c.textAlign = 'center'; c.textBaseline = 'middle';
    for (const [q, text] of labels) {
      c.strokeStyle = 'rgba(255,255,255,0.85)'; c.lineWidth = 4; c.lineJoin = 'round';
      c.strokeText(text, q[0], q[1]);
      c.fillStyle = INK; c.fillText(text, q[0], q[1]);
    }
    c.lineWidth = 1;
  }
  function bar(c, box, range, shade) {
    const l = box.r + 14, w = 12, h = box.b - box.t;
    for (let k = 0; k < h; k++) {
      c.fillStyle = css(shade(range[1] - (k + 0.5) / h * (range[1] - range[0])));
      c.fillRect(l, box.t + k, w, 1.5);
    }
    c.strokeStyle = FRAME; c.strokeRect(l + 0.5, box.t + 0.5, w, h);
    const t = ticks(range[0], range[1], h / 38);
    c.fillStyle = SOFT; c.textAlign = 'left'; c.textBaseline = 'middle';
    for (const v of t.at) {
      const y = box.b - (v - range[0]) / (range[1] - range[0]) * h;
      line(c, l + w, y, l + w + 4, y);
      c.fillText(label(v, t.step), l + w + 7, y);
    }
  }

  // ---- bars
  function bars(host, p) {
    const paint = p.series.map((s, i) => PALETTE[i % PALETTE.length]);
    const head = element('div', 'panel-head', host);
    const entries = p.series.map((s, i) => ({ label: s.label, colour: paint[i], shape: 'box' }));
    p.levels.forEach((l) => entries.push({ label: l.label + ' ' + short(l.at), colour: ROLES.limit, shape: 'dash' }));
    legend(head, entries);
    const canvas = element('canvas', '', element('div', 'own', host));
    element('div', 'axis-below', host, name(p.value));
    const all = p.series.map((s) => s.v).concat([p.levels.map((l) => l.at), [0]]);
    function draw(w) {
      const narrow = w < 560, thick = p.series.length > 2 ? 14 : 18, group = p.series.length * (thick + 2);
      const above = narrow ? 20 : 0, gap = narrow ? 12 : 16, pitch = group + gap + above;
      const h = 8 + p.categories.length * pitch + 28;
      const c = surface(canvas, w, h);
      const column = narrow ? 4 : Math.min(Math.round(w * 0.34), 14 + Math.max(...p.categories.map((t) => c.measureText(t).width)));
      const box = { l: column, t: 6, r: w - 14, b: h - 26 };
      let x = extent(all, 0);
      const room = 0.16 * (x[1] - x[0]) * Math.min(1, 400 / (box.r - box.l)); // for the numbers at the bars
      x = [x[0] < 0 ? x[0] - room : 0, x[1] > 0 ? x[1] + room : 0];
      const px = (v) => box.l + (v - x[0]) / (x[1] - x[0]) * (box.r - box.l);
      const t = ticks(x[0], x[1], (box.r - box.l) / 70);
      c.textAlign = 'center'; c.textBaseline = 'top';
      for (const v of t.at) {
        const q = Math.round(px(v)) + 0.5;
        c.strokeStyle = v === 0 ? FRAME : GRID; line(c, q, box.t, q, box.b + 4);
        c.fillStyle = SOFT; c.fillText(label(v, t.step), Math.max(q, c.measureText(label(v, t.step)).width / 2), box.b + 7);
      }
      c.setLineDash([6, 4]); c.strokeStyle = ROLES.limit; c.lineWidth = 1.5;
      p.levels.forEach((l) => line(c, px(l.at), box.t, px(l.at), box.b));
      c.setLineDash([]); c.lineWidth = 1;
      p.categories.forEach((text, g) => {
        const top = box.t + g * pitch + gap / 2;
        c.fillStyle = INK; c.textBaseline = 'middle'; c.textAlign = narrow ? 'left' : 'right';
        const limit = narrow ? w - 8 : column - 10;
        const shown = fit(c, text, limit);
        if (narrow) { c.fillStyle = '#fff'; c.fillRect(box.l + 1, top, c.measureText(shown).width + 4, 17); c.fillStyle = INK; }
        c.fillText(shown, narrow ? 6 : column - 8, narrow ? top + 8 : top + group / 2);
        p.series.forEach((s, i) => {
          const v = s.v[g], y = top + above + i * (thick + 2), from = px(0), to = finite(v) ? px(v) : from;
          c.fillStyle = paint[i]; c.fillRect(Math.min(from, to), y, Math.max(1, Math.abs(to - from)), thick);
          const note = finite(v) ? short(v, 4) : 'no value', left = finite(v) && v < 0, wide = c.measureText(note).width;
          const at = left ? to - 5 - wide : to + 5;
          c.fillStyle = 'rgba(255,255,255,0.8)'; c.fillRect(at - 1, y, wide + 2, thick);
          c.fillStyle = INK; c.textAlign = 'left'; c.fillText(note, at, y + thick / 2);
        });
      });
    }
    return { draw, canvas };
  }
  function fit(c, text, width) {
    if (c.measureText(text).width <= width) return text;
    let n = text.length;
    while (n > 1 && c.measureText(text.slice(0, n) + '…').width > width) n--;
    return text.slice(0, n) + '…';
  }

  return { xy, heat, bars, colours, dashed, name, label, short, finite, element, swatch, ROLES, FONT, SOFT, GRID, FRAME, INK };
})();
