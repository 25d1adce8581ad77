// Pictures of the workbench on canvases: bars, clouds of dots, lines within bands.
'use strict';
const num = x => x == null ? '–' : String(Number(Number(x).toPrecision(3)));
const Draw = (() => {
  const span = v => { let lo = Infinity, hi = -Infinity; for (const x of v) { if (x < lo) lo = x; if (x > hi) hi = x; } return hi > lo ? [lo, hi] : [lo - 1, lo + 1]; };
  // as many points as the place has, so that words are as large as those beside it
  function fit(c) {
    c.dataset.shape ??= c.height / c.width;
    const w = Math.round(Math.max(480, Math.min(2000, 1.6 * c.clientWidth)));
    if (c.clientWidth && c.width !== w) { c.width = w; c.height = Math.round(w * c.dataset.shape); }
  }
  function axes(c, [x0, x1], [y0, y1], unit) {
    fit(c);
    const g = c.getContext('2d'), w = c.width, h = c.height, L = 84, B = 40, T = 14, R = 18;
    const X = x => L + (w - L - R) * (x - x0) / (x1 - x0), Y = y => h - B - (h - B - T) * (y - y0) / (y1 - y0);
    g.clearRect(0, 0, w, h); g.font = '20px system-ui,sans-serif'; g.lineWidth = 1; g.strokeStyle = '#e4e9ee'; g.fillStyle = '#4d5866';
    for (let k = 0; k <= 4; k++) {
      const x = x0 + k * (x1 - x0) / 4, y = y0 + k * (y1 - y0) / 4;
      g.beginPath(); g.moveTo(X(x0), Y(y)); g.lineTo(X(x1), Y(y)); g.stroke();
      g.textAlign = 'right'; g.fillText(num(y), L - 8, Y(y) + 6);
      g.textAlign = k === 4 ? 'right' : 'center'; g.fillText(num(x) + unit, X(x), h - 10);
    }
    return [g, X, Y];
  }
  // dots over a variable, and a line through them
  function cloud(c, x, y, line) {
    const [g, X, Y] = axes(c, span(x), span([...y, ...line.map(p => p[1])]), '');
    g.fillStyle = 'rgba(0,114,178,.4)'; x.forEach((v, k) => { g.beginPath(); g.arc(X(v), Y(y[k]), 3, 0, 7); g.fill(); });
    g.strokeStyle = '#d55e00'; g.lineWidth = 3; g.beginPath(); line.forEach(([a, b], k) => k ? g.lineTo(X(a), Y(b)) : g.moveTo(X(a), Y(b))); g.stroke();
  }
  // a claim: the dots without the effect about its line, and the dots with it about zero
  function evidence(c, e) {
    const g = c.getContext('2d'), w = c.width / 2, h = c.height, [x0, x1] = span(e.x), [y0, y1] = span([...e.without, ...e.with]);
    g.clearRect(0, 0, c.width, h);
    [[e.without, e.slope, 'without it'], [e.with, 0, 'with it']].forEach(([ys, slope, word], side) => {
      const L = side * w + (side ? 10 : 66), R = (side + 1) * w - 6, X = x => L + (R - L) * (x - x0) / (x1 - x0), Y = y => h - 44 - (h - 76) * (y - y0) / (y1 - y0);
      g.strokeStyle = '#e4e9ee'; g.lineWidth = 1; g.strokeRect(L, 32, R - L, h - 76);
      g.fillStyle = '#4d5866'; g.font = '19px system-ui,sans-serif'; g.textAlign = 'center'; g.fillText(word, (L + R) / 2, 22);
      g.fillText(num(x0), L + 24, h - 22); g.fillText(num(x1), R - 24, h - 22);
      if (!side) { g.textAlign = 'right'; g.fillText(num(y1), L - 6, 46); g.fillText(num(y0), L - 6, h - 46); }
      g.save(); g.beginPath(); g.rect(L, 32, R - L, h - 76); g.clip();
      g.fillStyle = 'rgba(0,114,178,.35)'; e.x.forEach((x, k) => { g.beginPath(); g.arc(X(x), Y(ys[k]), 2.5, 0, 7); g.fill(); });
      g.strokeStyle = '#d55e00'; g.lineWidth = 3; g.beginPath(); g.moveTo(X(x0), Y(slope * x0)); g.lineTo(X(x1), Y(slope * x1)); g.stroke(); g.restore();
    });
    g.fillStyle = '#4d5866'; g.textAlign = 'center'; g.fillText(e.axis, w, h - 4);
  }
  function band(g, X, Y, b, fill, edge) {
    if (!b || !b.band_t.length) return;
    g.beginPath(); b.band_t.forEach((t, k) => k ? g.lineTo(X(t), Y(b.hi[k])) : g.moveTo(X(t), Y(b.hi[k])));
    for (let k = b.band_t.length - 1; k >= 0; k--) g.lineTo(X(b.band_t[k]), Y(b.lo[k]));
    g.closePath(); if (fill) { g.fillStyle = fill; g.fill(); }
    if (edge) { g.strokeStyle = edge; g.lineWidth = 2; g.setLineDash([7, 5]); g.stroke(); g.setLineDash([]); }
  }
  // a joint's positions within the set predicted now, and the edge of the one predicted before
  function tube(c, j, before, now, cross) {
    const all = [...j.y, ...j.lo, ...j.hi, ...(before ? [...before.lo, ...before.hi] : [])];
    const [g, X, Y] = axes(c, span(j.t), span(all), ' s');
    band(g, X, Y, j, 'rgba(120,130,140,.35)'); band(g, X, Y, before, null, '#7a5195');
    g.strokeStyle = '#0072b2'; g.lineWidth = 3; g.beginPath(); j.t.forEach((t, k) => k ? g.lineTo(X(t), Y(j.y[k])) : g.moveTo(X(t), Y(j.y[k]))); g.stroke();
    g.strokeStyle = '#d55e00'; g.lineWidth = 2; g.beginPath(); g.moveTo(X(now), 10); g.lineTo(X(now), c.height - 40); g.stroke();
    if (cross != null && cross >= j.t[0] && cross <= j.t[j.t.length - 1]) {
      const k = j.t.findIndex(t => t >= cross);
      g.fillStyle = '#b3261e'; g.font = 'bold 28px system-ui,sans-serif'; g.textAlign = 'center'; g.fillText('✕', X(cross), Y(j.y[k < 0 ? j.y.length - 1 : k]) + 10);
    }
  }
  // bars from zero, one per revision; dotted: the least that any model can reach
  function bars(c, chain, level, stands) {
    const g = c.getContext('2d'), top = 1.15 * Math.max(...chain.map(x => x[1]), level || 0) || 1, step = 440 / chain.length, Y = v => 190 - 180 * v / top;
    g.font = '17px system-ui,sans-serif'; g.textAlign = 'center';
    chain.forEach(([name, v], k) => {
      const x = 10 + k * step, b = Math.min(90, step * 0.7), letters = Math.floor(step / 9);
      g.fillStyle = stands && k === chain.length - 1 ? '#2a6f97' : '#b8c4ce'; g.fillRect(x + (step - b) / 2, Y(v), b, 190 - Y(v));
      g.fillStyle = '#1d2733'; g.fillText(num(v), x + step / 2, Y(v) - 5);
      g.fillText(name.length > letters ? name.slice(0, Math.max(3, letters - 1)) + '…' : name, x + step / 2, 214);
    });
    if (!level) return;
    g.strokeStyle = g.fillStyle = '#b3261e'; g.setLineDash([6, 5]); g.beginPath(); g.moveTo(0, Y(level)); g.lineTo(460, Y(level)); g.stroke(); g.setLineDash([]);
    g.textAlign = 'left'; g.fillText('repeatability floor', 6, Y(level) - 5);
  }
  return {cloud, evidence, tube, bars};
})();
