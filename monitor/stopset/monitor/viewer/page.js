// What came over a bus enters this page as text alone: nothing here makes markup of a string.
'use strict';
const $ = id => document.getElementById(id);
const el = (tag, props, ...inside) => { const e = Object.assign(document.createElement(tag), props || {}); e.append(...inside.filter(x => x != null)); return e; };
const fill = (id, ...inside) => $(id).replaceChildren(...inside);
const figure = (...inside) => el('td', {className: 'n'}, ...inside);
const heads = (...names) => el('tr', null, ...names.map((n, k) => el('th', {className: k && n !== 'what' ? 'n' : '', scope: 'col'}, n)));
const number = x => typeof x === 'number' && isFinite(x);
// bounds are rounded to the safe side: what is shown never promises more than what was proved
const num = (x, f, u, d) => number(x) ? (Math.ceil(x * f * 10 ** d - 1e-9) / 10 ** d).toFixed(d) + ' ' + u : 'not provable';
const count = (n, what) => `${n} ${what}${n === 1 ? '' : 's'}`;
const SIGN = {OK: '✓', DEGRADED: '!', VIOLATION: '✕', UNKNOWN: '?', FAULT: '⚠', 'NO DATA': '–', INIT: '…', SHUTDOWN: '■'};
const MEANS = {
  OK: 'the arm is inside every prediction', DEGRADED: 'bounds hold, but less is known than should be', VIOLATION: 'the ARM has left its model: do not rely on it',
  UNKNOWN: 'cannot be judged here', FAULT: 'the MONITOR or its bus fails: treat as unsafe', 'NO DATA': 'NOTHING is heard: treat as unsafe',
  INIT: 'starting', SHUTDOWN: 'the monitor was ended: treat as unsafe',
};
const WINDOW = 1e4;  // [ms] of positions
let past = [], told = null, last = 0, shownTwin = null, shot = {};

function show(s) {
  const stale = s.word === 'NO DATA' || !s.fresh || !s.twin;
  $('word').textContent = s.word; $('sign').textContent = SIGN[s.word] || '?'; $('means').textContent = MEANS[s.word] || '';
  $('band').className = s.word.replace(' ', ''); $('why').textContent = s.why; document.title = s.word + ' · stopset';
  document.body.classList.toggle('stale', stale);
  if (s.twin) shownTwin = s.twin;
  if (!shownTwin) return;
  stops(stale ? {} : shownTwin.stops, stale);
  margins(shownTwin, stale);
  joints(shownTwin, stale);
  violations(shownTwin);
  drawArm(s, stale);
  remember(s, stale); tubes(shownTwin.joints);
  fill('events', ...(s.events || []).slice().reverse().map(e => el('li', null,
    `${new Date(e.t_ns / 1e6).toLocaleTimeString([], {hourCycle: 'h23'})} ${e.told}` + (e.count > 1 ? `, ${e.count} times` : ''))));
  const t = shownTwin, h = s.health || {}, late = (h.sync_to_publish_ms || {}).max;
  $('counts').textContent = Object.entries(t.verdicts).map(([k, v]) => `${v} ${k.toLowerCase()}`).join(', ') +
    `; ${count(t.gaps, 'gap')}; ${count(s.lost || 0, 'message')} lost, ${s.rejected || 0} rejected` +
    (number(late) ? `; at most ${late.toFixed(1)} ms from measurement to message` : '') + (number(h.cycles_in_window) ? `; ${h.cycles_in_window} cycles in the last second` : '');
  $('notice').textContent = `${t.notice} Model ${t.model_sha256.slice(0, 16)}, configuration ${t.config_sha256.slice(0, 16)}. ${t.guarantee}`;
}
function stops(all, stale) {
  const given = [], refused = new Map();  // a reason stands once, whatever it is the reason for
  Object.entries(all).forEach(([c, v]) => {
    if (v.time_s != null || v.tcp_m != null) given.push(el('tr', {title: v.why}, el('td', null, 'STOP ' + c), figure(num(v.time_s, 1e3, 'ms', 0)), figure(num(v.tcp_m, 1e3, 'mm', 0))));
    else refused.set(v.why, [...(refused.get(v.why) || []), c]);
  });
  refused.forEach((names, why) => given.push(el('tr', null, el('td', null, 'STOP ' + names.join(', ')), el('td', {colSpan: 2}, 'no number', el('small', null, why)))));
  if (!given.length) given.push(el('tr', null, el('td', {colSpan: 3}, stale ? 'withdrawn: nothing current is heard' : 'none is asked for')));
  fill('stops', heads('', 'time', 'flange'), ...given);
}
// what is left to the limits of the configuration if the arm is stopped now; rounded down, for it must not promise more
const rest = (x, f, u, d) => { const v = Math.floor(x * f * 10 ** d + 1e-9) / 10 ** d; return el('span', {className: v < 0 ? 'bad' : ''}, `${v < 0 ? '✕ ' : ''}${v.toFixed(d)} ${u}`); };
function margins(t, stale) {
  const m = stale ? null : t.margins, rows = [];
  const row = (name, ...x) => { if (number(x[0])) rows.push(el('tr', null, el('td', null, name), figure(rest(...x)))); };
  if (m && m.certified) {
    row('time', m.time_s, 1e3, 'ms', 0); row('angle', m.angle_rad, 1, 'rad', 3); row('flange', m.tcp_m, 1e3, 'mm', 0);
    Object.entries(m.planes_m).forEach(([name, x]) => row('plane ' + name, x, 1e3, 'mm', 0));
  }
  fill('margins', ...(rows.length ? [heads('left to the limit of', ''), ...rows] : []));
}
function joints(t, stale) {
  const s0 = stale ? {} : (t.stops['0'] || {}).joints || {}, bad = {};
  t.violations.forEach(v => { bad[v.joint] = (bad[v.joint] || 0) + v.samples; });
  fill('joints', heads('joint', 'room', 'STOP 0', 'to its limit'), ...t.joints.map(j => {
    const r = stale || !t.room ? null : t.room[j], a = s0[j] || {};
    const travel = number(a.forward_rad) && number(a.back_rad) ? Math.max(a.forward_rad, a.back_rad) : null;
    const margin = stale || !t.margins || !t.margins.certified ? null : t.margins.joint_limits_rad[j];
    const bar = el('meter', {min: 0, max: 1, low: 0.1, high: 0.3, optimum: 0.9, value: number(r) ? Math.max(0, Math.min(1, r)) : 0});
    bar.setAttribute('aria-label', `room of ${j}`);
    return el('tr', null, el('td', null, j, bad[j] ? el('small', {className: 'bad'}, '✕ ' + count(bad[j], 'violation')) : null),
      figure(bar, ' ', number(r) ? r.toFixed(2) : '–'),
      stale || (!number(a.time_s) && travel == null) ? figure(stale ? '–' : 'no number') : figure(num(a.time_s, 1e3, 'ms', 0), el('small', null, num(travel, 1, 'rad', 4))),
      figure(number(margin) ? rest(margin, 1, 'rad', 2) : '–'));
  }));
}
function violations(t) {
  $('violated').hidden = !t.violations.length;
  $('cause').textContent = t.violation_class === 'unclassed' ? 'not classed yet: the evidence is being looked at' : t.violation_class ? t.violation_class.replaceAll('_', ' ') + (t.violation_cause && t.violation_cause.says ? ': ' + t.violation_cause.says : '') : '';
  fill('violations', heads('joint', 'what', 'excess', 'samples'), ...t.violations.map(v => el('tr', null, el('td', null, v.joint),
    el('td', null, `${v.state === 'q' ? 'position' : 'speed'} ${v.side}: ${v.kind.replaceAll('_', ' ')}${v.in_domain ? '' : ', outside the domain'}`),
    figure(number(v.excess) ? `${v.excess.toPrecision(3)} ${v.unit}` : ''), figure(String(v.samples)))));
}
function drawArm(s, stale) {
  const all = shownTwin.stops, of = c => (stale || !all[c] || !all[c].capsules) ? [] : all[c].capsules;
  const one = of('1 guaranteed').length ? '1 guaranteed' : '1', first = of(one), bad = shownTwin.violations.map(v => shownTwin.joints.indexOf(v.joint));
  Arm.draw($('arm'), s.arm, [[first, '#7db8e8'], [of('0'), '#f0a202']], bad);
  $('armsays').textContent = !s.arm ? 'no picture: the model has not been heard' : stale ? 'last known pose'
    : of('0').length || first.length ? `swept by the links' axes; add the links' own size${one === '1' ? '' : '. STOP 1: as if the ramp failed'}` : 'no volume: no stop is proved';
}
// the last seconds of each joint; a page that is opened late is told what it has missed
function remember(s, stale) {
  const now = performance.now(), t = s.twin;
  if (s.past) past = s.past.map(p => ({...p, at: now - 1000 * p.ago}));
  else if (!stale && t && t.q && t.tube && s.told !== told) past.push({at: now, q: t.q, lo: t.tube.lo, hi: t.tube.hi});
  told = s.told;
  past = past.filter(p => now - p.at < 1.2 * WINDOW);
}
function tubes(names) {
  if ($('rooms').children.length !== names.length) fill('rooms', ...names.map(() => el('figure', null, el('canvas', {width: 360, height: 220, role: 'img'}), el('figcaption'))));
  [...$('rooms').children].forEach((f, k) => tube(f.firstChild, f.lastChild, names[k], past.map(p => number(p.q[k]) && number(p.lo[k]) && number(p.hi[k]) ?
    {at: p.at, off: p.q[k] - (p.lo[k] + p.hi[k]) / 2, half: (p.hi[k] - p.lo[k]) / 2} : null)));
}
// the measurement from the middle of its prediction, both to scale; what has left it is crossed
function tube(c, caption, name, points) {
  const seen = points.filter(p => p), g = c.getContext('2d'), now = performance.now(), last = seen[seen.length - 1];
  const top = 1.15 * Math.max(1e-9, ...seen.map(p => Math.max(p.half, Math.abs(p.off))));
  const x = p => c.width * (1 - (now - p.at) / WINDOW), y = v => c.height / 2 * (1 - v / top), out = seen.filter(p => Math.abs(p.off) > p.half);
  g.clearRect(0, 0, c.width, c.height);
  const runs = []; points.forEach((p, i) => { if (p) { const q = points[i - 1]; if (q && p.at - q.at < 1500) runs[runs.length - 1].push(p); else runs.push([p]); } });
  runs.forEach(run => {
    const edge = (sign, list) => list.forEach(p => g.lineTo(x(p), y(sign * p.half)));
    g.fillStyle = '#e3ece5'; g.beginPath(); edge(1, run); edge(-1, [...run].reverse()); g.fill();
    g.strokeStyle = '#b00020'; g.lineWidth = 1.5; g.setLineDash([5, 4]); for (const sign of [1, -1]) { g.beginPath(); edge(sign, run); g.stroke(); } g.setLineDash([]);
    g.strokeStyle = '#14532d'; g.lineWidth = 3; g.beginPath(); run.forEach(p => g.lineTo(x(p), y(p.off))); g.stroke();
  });
  g.strokeStyle = '#b00020'; g.lineWidth = 3; g.beginPath(); out.forEach(p => { for (const s of [-6, 6]) { g.moveTo(x(p) - s, y(p.off) - 6); g.lineTo(x(p) + s, y(p.off) + 6); } }); g.stroke();
  const says = !last ? 'nothing to show' : `${mrad(last.off, last.half)} of ± ${mrad(last.half, last.half)} mrad` + (out.length ? `, ✕ left ${((now - out[out.length - 1].at) / 1000).toFixed(0)} s ago` : '');
  caption.replaceChildren(el('b', null, name), ' ' + says); c.setAttribute('aria-label', `${name}: ${says}`);
}
const mrad = (x, of) => String(Number((1000 * x).toFixed(of < 0.01 ? 2 : of < 0.1 ? 1 : 0)));
const TOKEN = document.querySelector('meta[name=token]').content;
$('reset').hidden = !TOKEN;
$('reset').onsubmit = async e => {
  e.preventDefault();
  const reason = $('reason').value.trim();
  if (!reason) { $('resetsays').textContent = 'a reason is needed'; return; }
  let r;
  try { r = await fetch('/reset', {method: 'POST', headers: {'X-Stopset-Token': TOKEN, 'Content-Type': 'application/json'}, body: JSON.stringify({reason})}); }
  catch (x) { $('resetsays').textContent = 'the viewer does not answer'; return; }
  $('resetsays').textContent = r.ok ? 'sent; the event tells whether it was taken' : await r.text();
};
Arm.steer($('arm'));
const heard = s => { last = Date.now(); shot = s; show(s); };
fetch('/now').then(r => r.json()).then(heard);
new EventSource('/stream').onmessage = e => heard(JSON.parse(e.data));
// the page's own connection may fail as well: then nothing on it is true any more
setInterval(() => { if (last && Date.now() - last > 700) show({...shot, word: 'NO DATA', why: 'the viewer does not answer', fresh: false}); }, 200);
