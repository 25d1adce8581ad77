// Whatever came over a bus enters this page as text alone.
'use strict';
const $ = id => document.getElementById(id), PATIENCE = 1000;  // [ms] without the viewer's word: everything is grey
const SIGN = {OK: '✓', DEGRADED: '△', VIOLATION: '✕', UNKNOWN: '?', FAULT: '⚠', INIT: '…', SHUTDOWN: '■', 'NO DATA': '–'};
const el = (tag, name, ...inside) => { const e = document.createElement(tag); if (name) e.className = name; e.append(...inside); return e; };
let heard = 0;
const stopWords = s => s.tcp_m == null ? 'not provable' : `${Math.ceil(s.tcp_m * 1000 - 1e-9)} mm, ${s.time_s == null ? '–' : Math.ceil(s.time_s * 1000 - 1e-9) + ' ms'}`;
const age = s => s < 90 ? `${Math.floor(s)} s` : s < 5400 ? `${Math.floor(s / 60)} min` : `${Math.floor(s / 3600)} h`;
function tile(r) {
  const t = el('article', r.word.replace(' ', '-'), el('h2', '', r.arm), el('p', 'word', `${SIGN[r.word] || ''} ${r.word}`),
    ...Object.entries(r.stops).filter(([c]) => c === '0' || c === '1').map(([c, s]) => el('p', 'way', `STOP ${c}: ${stopWords(s)}`)),
    el('p', 'why', `${r.class ? r.class + ': ' : ''}${r.why} (for ${age(r.since_s)})`));
  return t;
}
function show(s) {
  heard = performance.now(); document.body.classList.remove('lost');
  $('counts').textContent = `${s.arms} arms: ` + (Object.entries(s.counts).map(([w, n]) => `${n} ${SIGN[w] || ''} ${w}`).join(', ') || 'none has spoken yet');
  $('notice').textContent = s.notice;
  $('tiles').replaceChildren(...s.rows.map(tile));
  $('more').textContent = s.arms > s.rows.length ? `and ${s.arms - s.rows.length} more` : '';
}
setInterval(() => { if (performance.now() - heard > PATIENCE) { document.body.classList.add('lost'); $('counts').textContent = 'The viewer does not answer: what is shown is old.'; } }, 200);
const stream = new EventSource('/stream');
stream.onmessage = m => show(JSON.parse(m.data));
