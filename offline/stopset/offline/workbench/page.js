// Whatever the state holds enters this page as text alone: nothing here makes markup of a string.
'use strict';
const TOKEN = document.querySelector('meta[name=token]').content, $ = id => document.getElementById(id);
const el = (tag, props, ...inside) => { const e = Object.assign(document.createElement(tag), props || {}); e.append(...inside.filter(x => x != null)); return e; };
const fill = (id, ...inside) => $(id).replaceChildren(...inside.filter(x => x != null));
const num = x => x == null ? '–' : String(Number(Number(x).toPrecision(3)));
const unit = h => h.replace(/\[[^\]]*\]/g, u => u.replaceAll(' ', '\u00a0'));  // a unit stays in one piece
const cell = x => el('td', null, x), figure = (...x) => el('td', {className: 'n'}, ...x);
const words = x => el('td', {className: String(x ?? '').length > 36 ? 'text' : ''}, String(x ?? ''));
const small = t => el('p', {className: 'note'}, t);
const wide = (label, ...inside) => { const d = el('div', {className: 'wide', tabIndex: 0}, ...inside); d.setAttribute('role', 'group'); d.setAttribute('aria-label', label); return d; };
const table = (label, head, rows) => wide(label, el('table', null,
  el('tr', null, ...head.map((h, k) => el('th', {scope: 'col', className: rows.length && rows[0][k].className === 'n' ? 'n' : ''}, unit(h)))), ...rows.map(r => el('tr', null, ...r))));
const link = (text, to) => el('a', {href: to, target: '_blank', rel: 'noopener'}, text);
let running = false, shown = '', asked = false;

async function act(what, options) {
  let r;
  try { r = await fetch('/do/' + what, {method: 'POST', headers: {'X-Stopset-Token': TOKEN, 'Content-Type': 'application/json'}, body: JSON.stringify(options || {})}); }
  catch (e) { return poll(); }
  if (!r.ok) $('jobtext').textContent = await r.text();
  return poll();
}
const asAdd = (effect, joint) => act('add', {effect, joint: joint || null, force: $('force').checked});
document.querySelectorAll('.act').forEach(b => { b.onclick = () => b.dataset.do === 'add' ? asAdd($('effect').value, $('joint').value) : act(b.dataset.do); });

function job(j, models) {
  running = !!(j && j.running); $('job').className = 'wide-section ' + (running ? 'running' : j && j.error ? 'bad' : '');
  const bold = j && el('b', null, j.what);
  fill('jobtext', ...(!j ? ['Nothing is running.'] : running ? [bold, `: ${j.says} … ${j.seconds.toFixed(0)} s` + (j.usual ? `, usually about ${j.usual.toFixed(0)} s` : '')]
    : j.error ? [bold, ' gave no answer: ', el('pre', null, j.error)] : [bold, ` done in ${j.seconds.toFixed(1)} s.${j.what.startsWith('undo') ? ' ' + j.says + '.' : ''}`]));
  document.querySelectorAll('button.act,button.take').forEach(b => { b.disabled = running; });
  $('undo').disabled = running || models.length < 2;
}
function show(s) {
  job(s.job, s.models);
  const text = JSON.stringify([s.models, s.reports]);
  if (text === shown) return;
  shown = text;
  const at = s.models.length - 1, m = s.models[at], a = m.answers, report = n => s.reports.includes(n) ? link('full page', '/report/' + n) : '';
  $('title').textContent = `${s.robot}: workbench`;
  $('data').textContent = `${m.file} (SHA-256 ${m.sha256.slice(0, 16)}), revision ${m.revisions.length ? m.revisions[m.revisions.length - 1].number : 0}, against ${s.data.join(', ')}`;
  if (!$('effect').options.length) {
    fill('effect', ...s.effects.map(e => el('option', {value: e}, e)));
    fill('joint', el('option', {value: ''}, 'every joint, or the whole arm'), ...s.joints.map(j => el('option', {value: j}, j)));
  }
  $('says').textContent = a.verdict ? a.verdict.text : 'not compared yet: Compare tells where the model fails';
  $('says').className = a.verdict ? a.verdict.kind : '';
  fill('waterfall', ...s.figures.filter(f => f.key !== 'sum_U_width_without_margin').map(f => waterfall(f, m.revisions, f.key === 'held_out_torque_rmse' ? s.floor : null)));
  compare(a.compare, report('compare-' + at)); heat(a.dependence, s.joints); diagnose(s.models, at, report); stage(a, s.joints); added(a.add, s.figures);
  fill('history', table('Revisions', ['revision', 'added', 'note'], m.revisions.map(r => [figure(String(r.number)), words(r.added || 'first identification'), words(r.note)])));
  fill('reports', el('p', null, 'Model files: ', ...s.models.flatMap((x, k) => [el('a', {href: '/model/' + k, download: x.file.split('/').pop()}, x.file.split('/').pop()), ' '])),
    s.reports.length ? el('p', null, 'Pages: ', ...s.reports.flatMap(n => [link(n, '/report/' + n), ' '])) : null);
  $('notice').textContent = s.notice;
  job(s.job, s.models);
}
function compare(c, full) {
  fill('comparelink', full);
  if (!c) return fill('compare', small('not asked yet for this revision'));
  const ratio = r => r.torque_rmse && r.torque_rmse_floor ? r.torque_rmse / r.torque_rmse_floor : null;
  return fill('compare', el('p', null, el('b', {className: c.violations ? 'bad' : ''}, `${c.violations} of ${c.recordings} recordings leave the sets`), `, ${c.outside_domain} leave the domain.`),
    table('Errors per joint', ['joint', 'torque error [N m]', 'repeatability floor [N m]', 'times the floor', 'velocity [rad/s]', 'position [rad]'],
      Object.entries(c.joints).sort((x, y) => (ratio(y[1]) || 0) - (ratio(x[1]) || 0)).map(([j, r]) => [words(j), figure(num(r.torque_rmse)), figure(num(r.torque_rmse_floor)),
        figure(el('span', {className: ratio(r) >= 2 ? 'bad' : ''}, ratio(r) == null ? '–' : ratio(r).toFixed(1))), figure(num(r.velocity_rmse)), figure(num(r.position_rmse))])),
    small(c.guarantee.motions ? `A new motion leaves the sets with probability of at most ${(Math.ceil(1000 * c.guarantee.upper_bound - 1e-9) / 10).toFixed(1)} %, at ${Math.round(100 * c.guarantee.confidence)} % confidence; the full page explains it beside its curve.` : c.guarantee.text));
}
function heat(d, joints) {
  if (!d) { $('partial').hidden = true; return fill('heat', small('Compare shows it')); }
  const order = d.variables.map((_, k) => k).sort((a, b) => Math.max(...d.share.map(r => r[b])) - Math.max(...d.share.map(r => r[a]))).slice(0, 14);
  const body = joints.map((j, i) => el('tr', null, el('th', {scope: 'row'}, j), ...order.map(k => {
    const p = Math.round(100 * d.share[i][k]), b = el('button', {title: `${j} over ${d.variables[k]}`}, String(p)), c = el('td', null, b);
    c.style.background = `rgb(${255 - 2.1 * p},${255 - 1.3 * p},${255 - 0.6 * p})`; c.style.color = p > 60 ? '#fff' : '#1d2733';
    b.setAttribute('aria-label', `${j} over ${d.variables[k]}: ${p} percent`); b.onclick = () => partial(j, d.variables[k]);
    return c;
  })));
  return fill('heat', wide('Share of the torque error that each variable explains', el('table', {className: 'heat'},
    el('thead', null, el('tr', null, el('td'), ...order.map(k => el('th', {scope: 'col'}, d.variables[k])))), el('tbody', null, ...body))),
    d.share.every(r => r.every(x => Math.round(100 * x) === 0)) ? small('No variable explains anything of it, or the recordings are too short to tell.') : null,
    small('Percent of the squared torque error that each variable alone explains on stretches it was not fitted to; one of them shows the dots.'));
}
async function partial(joint, variable) {
  const r = await fetch(`/partial/${encodeURIComponent(joint + '/' + variable)}`);
  if (!r.ok) return;
  const p = await r.json(), c = $('cloud'), g = c.getContext('2d'), w = c.width, h = c.height, L = 80, B = 56;
  const span = v => { const lo = Math.min(...v), hi = Math.max(...v); return hi > lo ? [lo, hi] : [lo - 1, hi + 1]; };
  const [x0, x1] = span(p.x), [y0, y1] = span(p.y), X = x => L + (w - L - 20) * (x - x0) / (x1 - x0), Y = y => h - B - (h - B - 16) * (y - y0) / (y1 - y0);
  g.clearRect(0, 0, w, h); g.font = '20px system-ui,sans-serif'; g.fillStyle = '#4d5866'; g.strokeStyle = '#d5dce4';
  for (let k = 0; k <= 4; k++) {
    const x = x0 + k * (x1 - x0) / 4, y = y0 + k * (y1 - y0) / 4;
    g.beginPath(); g.moveTo(X(x), Y(y0)); g.lineTo(X(x), Y(y1)); g.moveTo(X(x0), Y(y)); g.lineTo(X(x1), Y(y)); g.stroke();
    g.textAlign = 'center'; g.fillText(num(x), X(x), h - B + 24); g.textAlign = 'right'; g.fillText(num(y), L - 8, Y(y) + 6);
  }
  g.textAlign = 'center'; g.fillText(p.variable, w / 2, h - 6);
  g.fillStyle = 'rgba(0,114,178,.4)'; p.x.forEach((x, k) => { g.beginPath(); g.arc(X(x), Y(p.y[k]), 3, 0, 7); g.fill(); });
  g.strokeStyle = '#d55e00'; g.lineWidth = 3; g.beginPath(); p.line.forEach(([x, y], k) => k ? g.lineTo(X(x), Y(y)) : g.moveTo(X(x), Y(y))); g.stroke();
  $('partial').hidden = false;
  $('cloudsays').textContent = `${p.joint}: torque error [N m] over ${p.variable}${p.other ? ', less what ' + p.other + ' explains' : ''}; line: mean within twelfths.`;
  c.setAttribute('aria-label', $('cloudsays').textContent);
}
function diagnose(models, at, report) {
  let k = at; while (k > 0 && !models[k].answers.diagnose) k--;
  const d = models[k].answers.diagnose;
  fill('diagnoselink', report('diagnose-' + k));
  if (!d) return fill('diagnose', small('not asked yet'));
  const there = e => Array.isArray(e.joint) ? e.joint.join('+') : e.joint, taken = models.slice(k + 1).map(m => (m.answers.add || {})).map(x => x.effect + ':' + (x.joint || ''));
  return fill('diagnose', k < at ? el('p', {className: 'note'}, `Of the revision before ${taken.join(', ')}: what is left of this list after that, Diagnose tells anew.`) : null,
    el('p', null, el('b', {className: 'big'}, d.verdict), ` (against the ${d.against})`),
    d.ranked_effects.length ? table('Missing effects', ['effect', 'joint', 'score', 'error before', 'after', 'what it is', 'what to do'], d.ranked_effects.map(e => {
      const b = el('button', {className: 'take', disabled: running}, 'Add this'), done = taken.includes(e.effect + ':' + (there(e) || ''));
      b.onclick = () => asAdd(e.effect, there(e));
      return [cell(e.effect), cell(there(e) || 'whole arm'), figure(num(e.score)), figure(num(e.error_before)), figure(num(e.error_after) + ' ' + (e.unit || '')), words(e.says), cell(done ? '✓ added' : b)];
    })) : null,
    d.rivals.length ? small('Hardly separated: ' + d.rivals.map(g => g.join(' / ')).join('; ')) : null,
    d.depends_on.length ? small('What is left depends on: ' + d.depends_on.join(', ')) : null, d.next_experiment ? small('Next experiment: ' + d.next_experiment) : null,
    (d.not_identifiable || []).length ? el('details', null, el('summary', null, `Not identifiable from these recordings: ${d.not_identifiable.length} effects`),
      table('Not identifiable', ['effect', 'why'], d.not_identifiable.map(b => [words(b.effect || b), words(b.why || '')]))) : null);
}
function added(done, figures) {
  if (!done) return fill('add');
  const own = (done.joint || '').split('+').filter(Boolean), rows = [];
  const row = (title, key) => { const b = done.before[key], x = done.after[key]; if (b != null && x != null) rows.push([words(title), figure(num(b)), figure(num(x)), figure(el('span', {className: x <= b ? 'good' : 'bad'}, b ? ((x / b - 1) * 100).toFixed(0) + ' %' : ''))]); };
  own.forEach(j => figures.forEach(f => row(`at ${j}: ${f.title}`, `${f.key}:${j}`)));
  figures.forEach(f => row(`whole arm: ${f.title}`, f.key));
  return fill('add', el('p', null, el('b', {className: done.file ? 'good' : 'bad'}, `${done.effect}${done.joint ? ' at ' + done.joint : ''}: ` + (done.file ? 'added' + (done.why ? ', though ' + done.why : '') : 'refused, ' + done.why)), `, judged on ${done.judged_on}`),
    table('Before and after', ['figure', 'before', 'after', 'change'], rows));
}
// bars from zero, one per revision; at the effect's own joint where it has one: over the arm, other joints hide what it does
function waterfall(f, revisions, floor) {
  const chain = []; let joint = '';
  revisions.forEach(r => { const own = (r.added.split(':')[1] || '').split('+')[0]; if (own && r.after[`${f.key}:${own}`] != null) joint = own; });
  const of = x => joint && x[`${f.key}:${joint}`] != null ? x[`${f.key}:${joint}`] : joint ? null : x[f.key];
  revisions.forEach(r => { if (!chain.length && of(r.before) != null) chain.push(['before', of(r.before)]); if (of(r.after) != null) chain.push([r.added || 'first', of(r.after)]); });
  const caption = el('figcaption', null, f.title + (joint ? `, at ${joint}` : ''));
  if (!chain.length) return el('figure', null, caption, small('nothing added yet, so nothing to compare'));
  const level = !joint ? floor && floor.arm : floor && floor.joints && floor.joints[joint];
  const c = el('canvas', {width: 460, height: 230}), g = c.getContext('2d'), top = 1.15 * Math.max(...chain.map(x => x[1]), level || 0) || 1, step = 440 / chain.length, Y = v => 190 - 180 * v / top;
  c.setAttribute('role', 'img'); c.setAttribute('aria-label', `${caption.textContent}: ` + chain.map(x => `${x[0]} ${num(x[1])}`).join(', '));
  g.font = '17px system-ui,sans-serif'; g.textAlign = 'center';
  chain.forEach(([name, v], k) => {
    const x = 10 + k * step, b = Math.min(90, step * 0.7);
    g.fillStyle = k === chain.length - 1 ? '#2a6f97' : '#b8c4ce'; g.fillRect(x + (step - b) / 2, Y(v), b, 190 - Y(v));
    g.fillStyle = '#1d2733'; g.fillText(num(v), x + step / 2, Y(v) - 5);
    const short = name.length * 9 > step ? name.slice(0, Math.max(3, Math.floor(step / 9) - 1)) + '…' : name; g.fillText(short, x + step / 2, 214);
  });
  if (level) { g.strokeStyle = '#b3261e'; g.setLineDash([6, 5]); g.beginPath(); g.moveTo(0, Y(level)); g.lineTo(460, Y(level)); g.stroke(); g.setLineDash([]); g.textAlign = 'left'; g.fillStyle = '#b3261e'; g.fillText('repeatability floor', 6, Y(level) - 5); }
  return el('figure', null, caption, c);
}
// ---- the arm over a recording
let scene = null, sceneOf = '', playing = 0;
function stage(a, joints) {
  const told = a.recordings;
  $('stage').hidden = $('tubes').hidden = !told; $('nostage').hidden = !!told;
  if (!told) { scene = null; sceneOf = ''; return; }
  const before = $('recording').value;
  fill('recording', ...told.listed.map(r => el('option', {value: r.label}, r.label + (r.violates ? ' ✕ leaves the sets' : '') + (r.inside_domain ? '' : ', outside the domain'))));
  if (told.listed.some(r => r.label === before)) $('recording').value = before;
  if ($('shownjoint').options.length !== joints.length) fill('shownjoint', ...joints.map(j => el('option', {value: j}, j)));
  load();
}
async function load() {
  const label = $('recording').value, r = await fetch('/scene/' + encodeURIComponent(label));
  if (!r.ok) return;
  scene = await r.json();
  $('time').max = scene.t.length - 1;
  if (sceneOf !== label) {
    $('time').value = scene.violation ? Math.max(0, scene.t.findIndex(t => t >= scene.violation.t)) : 0;
    const j = scene.violation ? scene.violation.state.replace(/^d?q_/, '') : scene.fails;
    if (j) $('shownjoint').value = j;
  }
  sceneOf = label; moment();
}
function moment() {
  if (!scene) return;
  const k = Number($('time').value), names = [...$('shownjoint').options].map(o => o.value), chosen = names.indexOf($('shownjoint').value);
  $('now').textContent = scene.t[k].toFixed(2) + ' s'; $('leaves').textContent = scene.violation ? '✕ ' + scene.violation.says : '';
  Arm.draw($('arm'), scene.arm[k], [], scene.fails ? [names.indexOf(scene.fails)] : []);
  tube($('tube'), scene.joints[Math.max(0, chosen)], scene.t[k], scene.violation && scene.violation.state === 'q_' + names[chosen] ? scene.violation.t : null);
}
function tube(c, j, now, cross) {
  const g = c.getContext('2d'), w = c.width, h = c.height, L = 80, B = 40, all = [...j.y, ...j.lo, ...j.hi], y0 = Math.min(...all), y1 = Math.max(...all), x1 = j.t[j.t.length - 1] || 1;
  const X = t => L + (w - L - 16) * t / x1, Y = y => h - B - (h - B - 14) * (y - y0) / (y1 - y0 || 1);
  const path = (ts, ys) => ts.forEach((t, k) => k ? g.lineTo(X(t), Y(ys[k])) : g.moveTo(X(t), Y(ys[k])));
  g.clearRect(0, 0, w, h); g.font = '20px system-ui,sans-serif'; g.fillStyle = '#4d5866'; g.lineWidth = 1;
  for (let k = 0; k <= 4; k++) {
    const y = y0 + k * (y1 - y0) / 4, x = k * x1 / 4;
    g.strokeStyle = '#e4e9ee'; g.beginPath(); g.moveTo(L, Y(y)); g.lineTo(w - 16, Y(y)); g.stroke();
    g.textAlign = 'right'; g.fillText(num(y), L - 8, Y(y) + 6); g.textAlign = 'center'; g.fillText(num(x) + ' s', X(x), h - 10);
  }
  if (j.band_t.length) { g.fillStyle = 'rgba(120,130,140,.35)'; g.beginPath(); path(j.band_t, j.hi); [...j.band_t].reverse().forEach((t, k) => g.lineTo(X(t), Y(j.lo[j.lo.length - 1 - k]))); g.fill(); }
  g.strokeStyle = '#0072b2'; g.lineWidth = 3; g.beginPath(); path(j.t, j.y); g.stroke();
  g.strokeStyle = '#d55e00'; g.lineWidth = 2; g.beginPath(); g.moveTo(X(now), 10); g.lineTo(X(now), h - B); g.stroke();
  if (cross != null) { g.fillStyle = '#b3261e'; g.font = 'bold 28px system-ui,sans-serif'; g.textAlign = 'center'; const k = j.t.findIndex(t => t >= cross); g.fillText('✕', X(cross), Y(j.y[k < 0 ? j.y.length - 1 : k]) + 10); }
}
Arm.steer($('arm'));
$('recording').onchange = load; $('shownjoint').onchange = moment; $('time').oninput = moment;
$('play').onclick = () => {
  if (playing) { clearInterval(playing); playing = 0; $('play').textContent = 'Play'; return; }
  $('play').textContent = 'Pause';
  playing = setInterval(() => { if (!scene) return; $('time').value = (Number($('time').value) + 1) % scene.t.length; moment(); }, 40);
};
async function poll() {
  if (asked) return;
  asked = true;
  try { show(await (await fetch('/state')).json()); }
  catch (e) { $('job').className = 'wide-section bad'; $('jobtext').textContent = 'The workbench does not answer: it has ended, or this machine has lost it. It is asked again twice a second.'; }
  asked = false;
}
setInterval(poll, 500); poll();
