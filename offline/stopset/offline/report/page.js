'use strict';
const SHEET = [700, 940];  // [px at 96 per inch] A4 less its margins and a heading
const plots = [...document.querySelectorAll('script.figure')].map(s => {
  const d = document.getElementById(s.dataset.for), f = JSON.parse(s.textContent);
  d.style.minWidth = d.dataset.least + 'px';
  Plotly.newPlot(d, f.data, f.layout, {displayModeBar: false, responsive: true});
  return d;
});
// inside a fold there is no width to draw at until it is opened
document.querySelectorAll('details').forEach(x => x.addEventListener('toggle', () => x.open && x.querySelectorAll('.plot').forEach(d => Plotly.Plots.resize(d))));
addEventListener('beforeprint', () => {
  document.querySelectorAll('details').forEach(d => { if (!d.open) { d.open = true; d.dataset.folded = '1'; } });
  // what needs more room than the sheet has is drawn at its own size and made smaller
  plots.forEach(d => {
    const w = Math.max(SHEET[0], Number(d.dataset.least));
    Plotly.relayout(d, {autosize: false, width: w});
    d.style.zoom = Math.min(SHEET[0] / w, SHEET[1] / d._fullLayout.height);
  });
});
addEventListener('afterprint', () => {
  plots.forEach(d => { d.style.zoom = ''; Plotly.relayout(d, {autosize: true, width: null}); });
  document.querySelectorAll('details[data-folded]').forEach(d => { d.open = false; delete d.dataset.folded; });
});
document.querySelectorAll('button.csv').forEach(b => { b.onclick = () => {
  const quoted = v => typeof v === 'number' ? String(v) : '"' + String(v ?? '').replaceAll('"', '""') + '"', lines = ['trace,name,panel,x,y'];
  document.getElementById(b.dataset.for)._fullData.forEach((t, k) => { for (let i = 0; i < (t.x || []).length; i++) lines.push([k, t.name, t.xaxis, t.x[i], t.y[i]].map(quoted).join(',')); });
  const a = document.createElement('a');
  a.href = URL.createObjectURL(new Blob([lines.join('\n') + '\n'], {type: 'text/csv'})); a.download = b.dataset.for + '.csv'; a.click();
  setTimeout(() => URL.revokeObjectURL(a.href), 1000);
}; });
