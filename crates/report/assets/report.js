// Draws the plots of the page. Counts what was drawn in <body data-plots-drawn>, so that a check from outside can
// compare it with data-plots-expected.
(function () {
  'use strict';
  const { element, colours, dashed, name, label, short, finite, swatch, ROLES, FONT, SOFT, GRID, FRAME } = Charts;
  const body = document.body;
  // uPlot knows steps up to 1e16; a model that ran away needs more.
  const HUGE_STEPS = Array.from({ length: 480 }, (_, k) => [1, 2, 5][k % 3] * Math.pow(10, Math.floor(k / 3)));
  const drawn = () => { body.dataset.plotsDrawn = String(Number(body.dataset.plotsDrawn) + 1); };

  // The button that undoes a zoom.
  function controls(host) {
    const ui = { reset: host.closest('figure').querySelector('.reset') };
    ui.zoomed = (on) => { ui.reset.hidden = !on; };
    return ui;
  }

  function timePlot(host, p, ui) {
    const t = p.t.n === undefined ? p.t : Array.from({ length: p.t.n }, (_, k) => p.t.start + k * p.t.step);
    const span = [t[0], t[t.length - 1]];
    const known = { taken: p.panels.flatMap((panel) => panel.series.map((s) => ROLES[s.role])), of: new Map() };
    const charts = p.panels.map((panel, k) => panelChart(host, p, panel, t, k, ui, known));
    const below = element('div', 'axis-below', host, name(p.x));
    ui.readout = element('span', 'value', below);
    ui.reset.addEventListener('click', () => charts.forEach((u) => u.setScale('x', { min: span[0], max: span[1] })));
    return {
      draw(width) { charts.forEach((u, k) => u.setSize({ width, height: height(p.panels.length, width, k) })); },
    };
  }

  // The last panel carries the numbers of the common axis.
  function height(panels, width, k) {
    const base = width < 520 ? (panels > 2 ? 120 : 170) : panels > 3 ? 135 : panels > 1 ? 170 : 240;
    return base + (k === panels - 1 ? 26 : 0);
  }

  function panelChart(host, p, panel, t, k, ui, known) {
    const last = k === p.panels.length - 1;
    const lines = panel.series.concat(panel.levels.map((l) => ({ label: l.label, role: 'limit', level: true, v: new Array(t.length).fill(l.at) })));
    const paint = colours(lines, known);
    const head = element('div', 'panel-head', host);
    element('span', 'axis-name', head, name(panel.y));
    const entries = lineLegend(head, lines, paint, (i, on) => chart.setSeries(i + 1, { show: on }));
    const isBand = (i) => lines[i].role === 'band' && lines[i].label !== '';
    const bands = lines.flatMap((s, i) => (isBand(i) ? [{ series: [i + 2, i + 1], fill: paint[i] + '88' }] : []));
    const huge = lines.some((s) => s.v.some((v) => Math.abs(v) > 1e14));
    let first = true;
    const values = (u, splits, axis, space, step) => splits.map((v) => (v == null ? '' : label(v, step)));
    const axis = { font: FONT, stroke: SOFT, grid: { stroke: GRID, width: 1 }, ticks: { stroke: FRAME, width: 1, size: 4 }, gap: 4 };
    const options = {
      width: 600, height: height(p.panels.length, 600, k), padding: [8, 14, last ? 0 : 2, 0],
      legend: { show: false },
      cursor: { y: false, sync: { key: p.id, scales: ['x', null] }, points: { size: 6 } },
      scales: { x: { time: false }, y: { range: (u, low, high) => panel.range || (low == null ? [0, 1] : uPlot.rangeNum(low, high, 0.1, true)) } },
      axes: [
        { ...axis, size: last ? 28 : 6, space: 70, values: last ? values : (u, s) => s.map(() => '') },
        { ...axis, size: 56, space: 32, values, ...(huge ? { incrs: HUGE_STEPS } : {}) },
      ],
      bands,
      series: [{}].concat(lines.map((s, i) => ({
        label: s.label, stroke: paint[i], width: s.role === 'band' ? 0.8 : s.level ? 1.2 : s.role === 'measured' ? 2 : 1.4, // simulated lies on top
        dash: dashed(s.role) ? [6, 4] : undefined,
        points: s.level || s.held || s.role === 'band' ? { show: false } : { size: 4 },
        paths: s.held ? uPlot.paths.stepped({ align: 1 }) : undefined,
      }))),
      hooks: {
        draw: [(u) => { marks(u, p.marks, k === 0); if (first) { first = false; drawn(); } }],
        setScale: [(u, key) => {
          if (key !== 'x' || t.length < 2) return;
          const s = u.scales.x, tiny = 1e-9 * (t[t.length - 1] - t[0]);
          ui.zoomed(s.min > t[0] + tiny || s.max < t[t.length - 1] - tiny);
        }],
        setCursor: [(u) => {
          const i = u.cursor.idx, on = i != null && u.cursor.left >= 0;
          entries.forEach((e, j) => { if (!lines[j].level) e.textContent = on ? short(lines[j].v[i]) + (isBand(j) ? ' to ' + short(lines[j + 1].v[i]) : '') : ''; });
          if (ui.readout) ui.readout.textContent = on ? short(t[i], 7) : '';
        }],
      },
    };
    const chart = new uPlot(options, [t].concat(lines.map((s) => bounded(s.v, panel.range))), host);
    touch(chart.over);
    return chart;
  }

  // A canvas drops a line that runs far outside: with a fixed range it ends a little beyond it.
  function bounded(values, range) {
    if (!range) return values;
    const far = 5 * (range[1] - range[0]);
    return values.map((v) => (v == null ? v : Math.min(range[1] + far, Math.max(range[0] - far, v))));
  }

  // Buttons that hide a line, with its value under the cursor.
  function lineLegend(head, lines, paint, show) {
    const box = element('span', 'legend', head);
    return lines.map((s, i) => {
      if (s.role === 'band' && s.label === '') return document.createElement('span'); // the upper side goes with the lower
      const item = element('button', 'entry', box);
      item.type = 'button';
      item.title = 'hide or show';
      swatch(item, paint[i], dashed(s.role) ? 'dash' : '');
      element('span', '', item, s.label + (s.v.some(finite) ? '' : ' (no finite value)'));
      item.addEventListener('click', () => {
        const on = !item.classList.toggle('off');
        show(i, on);
        if (s.role === 'band') show(i + 1, on);
      });
      return element('span', 'value', item, s.level ? short(s.v[0]) : '');
    });
  }

  function marks(u, list, named) {
    const c = u.ctx, r = window.devicePixelRatio || 1;
    c.save();
    c.strokeStyle = c.fillStyle = SOFT; c.lineWidth = r; c.setLineDash([2 * r, 3 * r]);
    c.font = FONT.replace('12px', 11 * r + 'px'); c.textBaseline = 'top';
    for (const m of list) {
      if (m.at < u.scales.x.min || m.at > u.scales.x.max) continue;
      const x = u.valToPos(m.at, 'x', true);
      c.beginPath(); c.moveTo(x, u.bbox.top); c.lineTo(x, u.bbox.top + u.bbox.height); c.stroke();
      if (!named) continue;
      const beyond = x + c.measureText(m.label).width + 6 * r > u.bbox.left + u.bbox.width;
      c.textAlign = beyond ? 'right' : 'left';
      c.fillText(m.label, x + (beyond ? -4 : 4) * r, u.bbox.top + 2 * r);
    }
    c.restore();
  }

  // uPlot listens to the mouse only: a sideways finger becomes one, an upright finger scrolls the page. It drops moves
  // by nothing, hence movementX.
  function touch(over) {
    const pass = (type, target, e) => target.dispatchEvent(new MouseEvent(type, { clientX: e.clientX, clientY: e.clientY, movementX: 1, button: 0, bubbles: true, cancelable: true, view: window }));
    over.addEventListener('pointerdown', (e) => { if (e.pointerType === 'touch') pass('mousedown', over, e); });
    over.addEventListener('pointermove', (e) => { if (e.pointerType === 'touch') pass('mousemove', over, e); });
    over.addEventListener('pointerup', (e) => { if (e.pointerType === 'touch') pass('mouseup', document, e); });
    over.addEventListener('pointercancel', (e) => { if (e.pointerType === 'touch') pass('mouseup', document, e); });
  }

  const makers = { time: timePlot, xy: Charts.xy, heat: Charts.heat, bars: Charts.bars };
  const all = [];
  for (const p of JSON.parse(document.getElementById('data').textContent)) {
    const host = document.getElementById(p.id);
    try {
      const plot = makers[p.kind](host, p, controls(host));
      plot.host = host;
      plot.draw(widthOf(host));
      if (plot.canvas && plot.canvas.width > 0) drawn(); // time panels count themselves, once uPlot has painted
      all.push(plot);
    } catch (error) {
      element('p', '', host, 'This plot could not be drawn: ' + error.message);
      console.error(p.id, error.stack);
    }
  }

  // A plot in closed details has no width of its own yet.
  function widthOf(host) {
    for (let e = host; e; e = e.parentElement) if (e.clientWidth > 0) return Math.max(260, Math.floor(e.clientWidth));
    return 600;
  }
  let shown = 0;
  function fitAll(width) {
    for (const plot of all) {
      const w = width || widthOf(plot.host);
      if (w !== plot.width) { plot.width = w; plot.draw(w); }
    }
    body.dataset.overflowPx = String(Math.max(0, document.documentElement.scrollWidth - window.innerWidth));
  }
  new ResizeObserver(() => { cancelAnimationFrame(shown); shown = requestAnimationFrame(() => fitAll()); }).observe(document.querySelector('main'));
  document.querySelectorAll('details').forEach((d) => d.addEventListener('toggle', () => fitAll()));
  window.addEventListener('beforeprint', () => { document.querySelectorAll('details').forEach((d) => { d.open = true; }); fitAll(680); });
  window.addEventListener('afterprint', () => fitAll());
  fitAll();

  // The contents mark where the reader is.
  const links = new Map(Array.from(document.querySelectorAll('nav li a'), (a) => [a.getAttribute('href').slice(1), a]));
  const targets = Array.from(links.keys(), (id) => document.getElementById(id)).filter(Boolean);
  function here() {
    let current = targets[0];
    for (const e of targets) if (e.getBoundingClientRect().top < 120) current = e;
    links.forEach((a, id) => a.classList.toggle('here', Boolean(current) && id === current.id));
  }
  window.addEventListener('scroll', here, { passive: true });
  here();
})();
