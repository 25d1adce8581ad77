// Whatever the state holds enters this page as text alone: nothing here makes markup of a string.
'use strict';
const TOKEN = document.querySelector('meta[name=token]').content, $ = id => document.getElementById(id);
const el = (tag, props, ...inside) => { const e = Object.assign(document.createElement(tag), props || {}); e.append(...inside.filter(x => x != null)); return e; };
const fill = (id, ...inside) => $(id).replaceChildren(...inside.filter(x => x != null));
const unit = h => h.replace(/\[[^\]]*\]/g, u => u.replaceAll(' ', '\u00a0'));  // a unit stays in one piece
const cell = x => el('td', null, x), figure = (...x) => el('td', {className: 'n'}, ...x);
const words = x => el('td', {className: String(x ?? '').length > 36 ? 'text' : ''}, String(x ?? ''));
const small = t => el('p', {className: 'note'}, t);
const wide = (label, ...inside) => { const d = el('div', {className: 'wide', tabIndex: 0}, ...inside); d.setAttribute('role', 'group'); d.setAttribute('aria-label', label); return d; };
const table = (label, head, rows) => wide(label, el('table', null,
  el('tr', null, ...head.map((h, k) => el('th', {scope: 'col', className: rows.length && rows[0][k].className === 'n' ? 'n' : ''}, unit(h)))), ...rows.map(r => el('tr', null, ...r))));
const link = (text, to) => el('a', {href: to, target: '_blank', rel: 'noopener'}, text);
let running = false, shown = -1, asked = false, state = null;

async function act(what, options) {
  let r;
  try { r = await fetch('/do/' + what, {method: 'POST', headers: {'X-Stopset-Token': TOKEN, 'Content-Type': 'application/json'}, body: JSON.stringify(options || {})}); }
  catch (e) { return poll(); }
  if (!r.ok) { const why = await r.text(); $(what === 'choose' ? 'choosesays' : 'jobtext').textContent = why; return null; }
  return poll();
}
const open = (select, keep, options) => { const was = $(select).value; fill(select, ...options); if (keep && options.some(o => o.value === was)) $(select).value = was; };
const asAdd = (effect, joint) => act('add', {effect, joint: joint || null, force: $('force').checked});
document.querySelectorAll('.act').forEach(b => { b.onclick = () => b.dataset.do === 'add' ? asAdd($('effect').value, $('joint').value) : act(b.dataset.do); });

const seconds = x => x < 90 ? `${Math.max(1, Math.round(x))} s` : `${Math.round(x / 60)} min`;
function job(j) {
  running = !!(j && j.running && !j.automatic); const works = !!(j && j.running);
  $('job').className = 'row-section ' + (works ? 'running' : j && j.error ? 'bad' : '');
  const bold = j && el('b', null, j.what), done = j && !works && !j.error;
  const rest = works && (j.left != null ? `, about ${seconds(j.left)} more of this step` : j.usual ? `, usually about ${seconds(j.usual)}` : '');
  fill('jobtext', ...(!j ? ['Nothing is running.'] : works ? [bold, `: ${j.says || 'begins'} … ${j.seconds.toFixed(0)} s${rest}`]
    : done ? [bold, j.stopped ? ' was stopped.' : ` done in ${j.seconds.toFixed(1)} s.${j.what.startsWith('undo') ? ' ' + j.says + '.' : ''}`] : [bold, ' gave no answer: ', el('pre', null, j.error)]));
  $('bar').hidden = $('stop').hidden = !works;
  if (works && j.share != null) $('bar').value = j.share; else $('bar').removeAttribute('value');
  document.querySelectorAll('button.act,button.take').forEach(b => { b.disabled = running; });
  $('undo').disabled = running || !state || state.models.length < 2;
  if (works && j.what === 'diagnose' && state && !state.models[state.models.length - 1].answers.diagnose) fill('diagnose', ...j.steps.map(small));
}
$('stop').onclick = () => act('stop');
const base = path => path.split('/').pop();
function show(s) {
  state = s;
  const at = s.models.length - 1, m = s.models[at], a = m.answers, report = n => s.reports.includes(n) ? link('full page', '/report/' + n) : '';
  $('title').textContent = `${s.robot}: workbench`;
  $('data').textContent = `${base(m.file)} (SHA-256 ${m.sha256.slice(0, 16)}), revision ${m.revisions.length ? m.revisions[m.revisions.length - 1].number : 0}, against ${s.data.map(base).join(', ')}`;
  $('data').title = [m.file, ...s.data].join('\n');
  if (!$('effect').options.length) {
    fill('effect', ...s.effects.map(e => el('option', {value: e}, e)));
    fill('joint', el('option', {value: ''}, 'every joint, or the whole arm'), ...s.joints.map(j => el('option', {value: j}, j)));
  }
  $('says').textContent = a.verdict ? a.verdict.text : 'not compared yet: Compare tells where the model fails';
  $('says').className = a.verdict ? a.verdict.kind : '';
  fill('waterfall', ...s.figures.filter(f => f.key !== 'sum_U_width_without_margin').map(f => waterfall(f, m.revisions, s.floors[f.key])));
  compare(a.compare, report('compare-' + at)); heat(a.dependence, s.joints); diagnose(s.models, at, report); stage(s, a); added(a.add, s.figures);
  recordings(s.recordings); sides(s);
  fill('history', table('Revisions', ['revision', 'added', 'note'], m.revisions.map(r => [figure(String(r.number)), words(r.added || 'first identification'), words(r.note)])));
  const write = el('button', {className: 'take', disabled: running}, a.fmu ? 'Write the FMU again' : 'Write the FMU'); write.onclick = () => act('fmu');
  const names = {compare: 'comparison', diagnose: 'diagnosis', plan: 'plan'};
  fill('reports', el('p', null, 'Model files: ', ...s.models.flatMap((x, k) => [el('a', {href: '/model/' + k, download: base(x.file)}, base(x.file)), ' '])),
    el('p', null, 'Pages: ', link('history', '/report/history'), ' ', ...s.reports.flatMap(n => { const [what, k] = n.split('-'); return [link(`${names[what] || what} of ${base(s.models[k].file)}`, '/report/' + n), ' ']; })),
    el('p', null, 'FMU: ', write, ' ', ...s.models.flatMap((x, k) => x.answers.fmu ? [el('a', {href: '/fmu/' + k, download: base(x.answers.fmu.file)}, base(x.answers.fmu.file)), ' '] : [])));
  $('notice').textContent = s.notice;
  job(s.job);
}
// which files, each with what held for it
function recordings(list) {
  const text = JSON.stringify(list);
  if ($('chosen').dataset.of === text) return;  // what somebody is typing stays
  $('chosen').dataset.of = text;
  fill('chosen', wide('Recordings', el('table', null, el('tr', null, ...['use', 'file', 'condition'].map(h => el('th', {scope: 'col'}, h))), ...list.map((r, k) => {
    const box = el('input', {type: 'checkbox', checked: r.chosen, className: 'usefile'}), of = el('input', {type: 'text', value: r.condition, className: 'condition', placeholder: r.stated || 'KEY=VALUE', size: 16});
    box.setAttribute('aria-label', 'use ' + r.file); of.setAttribute('aria-label', 'condition of ' + r.file);
    return el('tr', null, el('td', null, box), words(base(r.file)), el('td', null, of));
  }))), small('Recordings of different conditions (payload, tool, day) are not taken as one.'));
}
$('choose').onclick = () => {
  $('choosesays').textContent = '';
  const boxes = [...document.querySelectorAll('.usefile')], texts = [...document.querySelectorAll('.condition')];
  act('choose', {files: boxes.map((b, k) => b.checked ? k : -1).filter(k => k >= 0), conditions: texts.map(t => t.value)});
};
// two models joint by joint, what is better on the right in green
function sides(s) {
  const options = () => s.models.map((m, k) => el('option', {value: String(k)}, `${k}: ${base(m.file)}`));
  if ($('lefthand').options.length !== s.models.length) {
    open('lefthand', false, options()); open('righthand', false, options());
    $('lefthand').value = String(Math.max(0, s.models.length - 2)); $('righthand').value = String(s.models.length - 1);
  }
  const [l, r] = ['lefthand', 'righthand'].map(k => s.models[Number($(k).value)].answers.compare);
  if (!l || !r) return fill('sides', small('Both are shown once they are compared.'));
  const pair = (a, b) => [figure(num(a)), figure(el('span', {className: a == null || b == null || Math.abs(b - a) < 0.005 * a ? '' : b < a ? 'good' : 'bad'}, num(b) + (a && b != null && b !== a ? ` (${b > a ? '+' : ''}${((b / a - 1) * 100).toFixed(0)} %)` : '')))];
  const wideOf = (c, j) => c.sets[j].U[1] - c.sets[j].U[0];
  fill('sides', table('Two revisions', ['joint', 'floor [N m]', ...['torque error [N m]', 'width of U [N m]', 'velocity [rad/s]', 'position [rad]'].flatMap(h => [h, 'right'])],
    s.joints.map(j => [words(j), figure(num(l.joints[j].torque_rmse_floor)), ...pair(l.joints[j].torque_rmse, r.joints[j].torque_rmse), ...pair(wideOf(l, j), wideOf(r, j)),
      ...pair(l.joints[j].velocity_rmse, r.joints[j].velocity_rmse), ...pair(l.joints[j].position_rmse, r.joints[j].position_rmse)])),
    small(`Left: ${l.violations} of ${l.recordings} recordings leave the sets; right: ${r.violations} of ${r.recordings}.`));
}
$('lefthand').onchange = $('righthand').onchange = () => state && sides(state);
function compare(c, full) {
  fill('comparelink', full);
  if (!c) return fill('compare', small('not asked yet for this revision'));
  // with all the model knows, as its verdict has it: what the abstraction leaves out besides is in U
  const inFull = r => r.torque_rmse_known || r.torque_rmse, ratio = r => inFull(r) && r.torque_rmse_floor ? inFull(r) / r.torque_rmse_floor : null;
  return fill('compare', el('p', null, el('b', {className: c.violations ? 'bad' : ''}, `${c.violations} of ${c.recordings} recordings leave the sets`), `, ${c.outside_domain} leave the domain.`),
    table('Errors per joint', ['joint', 'torque error [N m]', 'in full [N m]', 'floor [N m]', 'times the floor'],
      Object.entries(c.joints).sort((x, y) => (ratio(y[1]) || 0) - (ratio(x[1]) || 0)).map(([j, r]) => [words(j), figure(num(r.torque_rmse)), figure(num(inFull(r))), figure(num(r.torque_rmse_floor)),
        figure(el('span', {className: ratio(r) >= 2 ? 'bad' : ''}, ratio(r) == null ? '–' : ratio(r).toFixed(1)))])),
    small('Floor: what repetitions of the same torques differ by. In full: with all the model knows; what the abstraction leaves out besides is in U.'),
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
  const p = await r.json(), c = $('cloud');
  $('partial').hidden = false;
  Draw.cloud(c, p.x, p.y, p.line);
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
    ...d.ranked_effects.map((e, i) => card(d, e, (d.evidence || [])[i], there(e), taken.includes(e.effect + ':' + (there(e) || '')))),
    ...(d.alternatives || []).map(a => el('p', null, `${a.one_of[0]} may as well be ${a.one_of.slice(1).join(' or ')}: ${a.why}.`)),
    d.depends_on.length ? small('What is left depends on: ' + d.depends_on.join(', ')) : null, decides(d, models[at].answers.plan, report('plan-' + at)),
    (d.not_identifiable || []).length ? el('details', null, el('summary', null, `Not identifiable from these motions: ${d.not_identifiable.length} effects`),
      table('Not identifiable', ['effect', 'why', 'what would show it'], d.not_identifiable.map(b => [words(b.effect || b), words(b.why || ''), words(b.experiment || '')]))) : null);
}
// one effect: what it is, what shows it, its law with numbers, who looks like it, and how to put it in
function card(d, e, dots, joint, done) {
  const name = e.effect + (joint ? ':' + joint : ''), b = el('button', {className: 'take main', disabled: running}, 'Add this'), group = d.rivals.find(g => g.includes(name));
  b.onclick = () => asAdd(e.effect, joint);
  const law = Object.entries(e.parameters).map(([k, p]) => `${k} = ${num(p.value)}${p.std == null ? ' (searched)' : `, ${num(p.value - 1.96 * p.std)} to ${num(p.value + 1.96 * p.std)}`} ${p.unit}`);
  const c = dots ? el('canvas', {width: 640, height: 260, className: 'evidence'}) : null;
  if (c) { Draw.evidence(c, dots); c.setAttribute('role', 'img'); c.setAttribute('aria-label', `Torque of ${dots.joint} [N m] over ${dots.axis}, without and with ${e.effect}`); }
  const fall = e.error_before ? ` (${((e.error_after / e.error_before - 1) * 100).toFixed(0)} %)` : '';
  return el('article', {className: 'card'}, el('h3', null, `${e.effect}${joint ? ' at ' + joint : ', whole arm'} `, done ? el('span', {className: 'good'}, '✓ added') : b), el('p', null, e.says),
    el('p', null, 'Held-out error ', el('b', null, `${num(e.error_before)} → ${num(e.error_after)} ${e.unit || ''}${fall}`), `; score ${num(e.score)}`), c,
    c ? small(`Torque of ${dots.joint} [N m] that the whole model leaves, with the effect's own torque and without; line: the law.`) : null,
    law.length ? el('p', {className: 'law'}, law.join('; '), ' (95 %)') : null, group ? small('Hardly separated from ' + group.filter(x => x !== name).join(' and ')) : null);
}
function decides(d, plan, full) {
  if (!d.next_experiment) return null;
  const b = el('button', {className: 'take', disabled: running}, 'Write its plan'); b.onclick = () => act('plan', {decides: d.next_experiment.slice(0, 1500)});
  return el('div', {className: 'card'}, el('h3', null, 'The experiment that decides ', b), el('p', null, d.next_experiment),
    plan ? el('p', null, `Written: ${plan.files} files in ${plan.folder}, ${plan.minutes.toFixed(0)} min of motion. `, full) : null);
}
function added(done, figures) {
  $('addedsection').hidden = !done;
  if (!done) return fill('add');
  const own = (done.joint || '').split('+').filter(Boolean), rows = [];
  const row = (title, key) => { const b = done.before[key], x = done.after[key]; if (b != null && x != null) rows.push([words(title), figure(num(b)), figure(num(x)), figure(el('span', {className: Math.abs(x - b) < 0.005 * b ? '' : x < b ? 'good' : 'bad'}, b ? ((x / b - 1) * 100).toFixed(0) + ' %' : ''))]); };
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
  revisions.forEach(r => { const b = of(r.before); if (b != null && !(chain.length && Math.abs(b - chain[chain.length - 1][1]) <= 0.02 * b)) chain.push([chain.length ? 'without' : 'before', b]); if (of(r.after) != null) chain.push([r.added || 'first', of(r.after)]); });
  const caption = el('figcaption', null, f.title + (joint ? `, at ${joint}` : ''));
  const stands = revisions.length > 0 && of(revisions[revisions.length - 1].after) != null;
  if (!chain.length) return el('figure', null, caption, small('nothing added yet, so nothing to compare'));
  const level = !joint ? floor && floor.arm : floor && floor.joints && floor.joints[joint];
  const c = el('canvas', {width: 460, height: 230});
  c.setAttribute('role', 'img'); c.setAttribute('aria-label', `${caption.textContent}: ` + chain.map(x => `${x[0]} ${num(x[1])}`).join(', '));
  Draw.bars(c, chain, level, stands);
  return el('figure', null, caption, c, stands ? null : small('not known of the model at hand: not everything it needs is proved'));
}
// ---- the arm over a recording
let scene = null, sceneOf = '', playing = 0, view = [0, Infinity], asking = false, again = false;
function stage(s, a) {
  const reply = a.recordings;
  $('stage').hidden = !reply; $('nostage').hidden = !!reply;
  if (!reply) { scene = null; sceneOf = ''; return; }
  open('recording', true, reply.listed.map(r => el('option', {value: r.label}, r.label + (r.violates ? ' ✕ leaves the sets' : '') + (r.inside_domain ? '' : ', outside the domain'))));
  if ($('shownjoint').options.length !== s.joints.length) fill('shownjoint', ...s.joints.map(j => el('option', {value: j}, j)));
  if ($('beside').options.length !== s.models.length) {
    open('beside', false, [el('option', {value: '-'}, 'nothing'), ...s.models.slice(0, -1).map((m, k) => el('option', {value: String(k)}, base(m.file)))]);
    $('beside').value = s.models.length > 1 ? String(s.models.length - 2) : '-';
  }
  load();
}
// one question at a time; what was asked meanwhile is asked when it is answered
async function load() {
  if (asking) { again = true; return; }
  asking = true;
  const label = $('recording').value, fresh = sceneOf !== label;
  if (fresh) view = [0, Infinity];
  try {
    const end = isFinite(view[1]) ? view[1].toFixed(4) : 'inf', r = await fetch(`/scene/${encodeURIComponent(label)}/${view[0].toFixed(4)}/${end}/${$('beside').value || '-'}`);
    if (r.ok) arrived(await r.json(), label, fresh);
  } catch (e) { /* the poll says that nobody answers */ }
  asking = false;
  if (again) { again = false; load(); }
}
function arrived(got, label, fresh) {
  const t = fresh || !scene ? null : scene.t[Number($('time').value)];
  scene = got; sceneOf = label; view = [scene.t[0], scene.t[scene.t.length - 1]];
  $('time').max = scene.t.length - 1;
  const wanted = t == null && scene.violation ? scene.violation.t : t == null ? scene.t[0] : t, k = scene.t.findIndex(x => x >= wanted);
  $('time').value = k < 0 ? scene.t.length - 1 : k;
  const j = fresh && (scene.violation ? scene.violation.state.replace(/^d?q_/, '') : scene.fails);
  if (j) $('shownjoint').value = j;
  moment();
}
function moment() {
  if (!scene) return;
  const k = Number($('time').value), names = [...$('shownjoint').options].map(o => o.value), chosen = Math.max(0, names.indexOf($('shownjoint').value));
  $('now').textContent = scene.t[k].toFixed(2) + ' s'; $('leaves').textContent = scene.violation ? '✕ ' + scene.violation.says : '';
  Arm.draw($('arm'), scene.arm[k], [], scene.fails ? [names.indexOf(scene.fails)] : []);
  Draw.tube($('tube'), scene.joints[chosen], scene.before && scene.before[chosen], scene.t[k], scene.violation && scene.violation.state === 'q_' + names[chosen] ? scene.violation.t : null);
}
// closer about the moment drawn
function zoom(by) {
  if (!scene) return;
  const t = scene.t[Number($('time').value)], half = Math.max(0.1, by * (view[1] - view[0]) / 2);
  view = by === Infinity || 2 * half >= scene.whole ? [0, scene.whole] : [Math.max(0, Math.min(t - half, scene.whole - 2 * half)), 0];
  if (!view[1]) view[1] = Math.min(scene.whole, view[0] + 2 * half);
  load();
}
Arm.steer($('arm'));
$('recording').onchange = load; $('beside').onchange = load; $('shownjoint').onchange = moment; $('time').oninput = moment;
$('closer').onclick = () => zoom(0.4); $('wider').onclick = () => zoom(2.5); $('whole').onclick = () => zoom(Infinity);
$('tube').onwheel = e => { e.preventDefault(); zoom(e.deltaY < 0 ? 0.6 : 1.7); };
$('tube').onkeydown = e => { if (e.key === '+') zoom(0.4); else if (e.key === '-') zoom(2.5); };
$('play').onclick = () => {
  if (playing) { clearInterval(playing); playing = 0; $('play').textContent = 'Play'; return; }
  $('play').textContent = 'Pause';
  playing = setInterval(() => { if (!scene) return; $('time').value = (Number($('time').value) + 1) % scene.t.length; moment(); }, 40);
};
// how far the job is, twice a second; everything else only when it has changed
async function poll() {
  if (asked) return;
  asked = true;
  let reply, s;
  try {
    reply = await (await fetch('/job')).json();
    if (reply.version !== shown) s = await (await fetch('/state')).json();
  } catch (e) { failed('The workbench does not answer: it has ended, or this machine has lost it. It is asked again twice a second; what runs there goes on.'); }
  asked = false;
  try {
    if (s) { show(s); shown = s.version; } else if (reply) job(reply.job);
  } catch (e) { failed(`This page cannot show what the workbench answered, a defect of stopset (${e.message}). Models and reports are in their folder, unharmed.`); }
}
function failed(why) { shown = -1; $('job').className = 'row-section bad'; $('jobtext').textContent = why; }
setInterval(poll, 500); poll();
