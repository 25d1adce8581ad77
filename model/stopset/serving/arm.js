// The arm in space, seen along a direction one turns with the mouse or the arrow keys.  A capsule seen from far away is exactly a
// thick line with round ends, so its picture is what it covers.
'use strict';
const Arm = (() => {
  let turn = 0.7, tilt = 0.35, held = null, last = null;
  const seen = ([x, y, z]) => {
    const a = x * Math.cos(turn) - y * Math.sin(turn), b = x * Math.sin(turn) + y * Math.cos(turn);
    return [a, z * Math.cos(tilt) + b * Math.sin(tilt), b * Math.cos(tilt) - z * Math.sin(tilt)];
  };
  function draw(canvas, joints, sweeps, marked) {
    last = [canvas, joints, sweeps, marked];
    const g = canvas.getContext('2d'), w = canvas.width, h = canvas.height;
    g.clearRect(0, 0, w, h);
    if (!joints || joints.length < 2) return;
    const reach = Math.max(0.3, joints.slice(1).reduce((s, p, i) => s + Math.hypot(...p.map((v, k) => v - joints[i][k])), 0));
    // what is swept is shown whole, in steps, so that the picture does not breathe with every bound
    const base = joints[0], far = Math.max(0, ...sweeps.flatMap(([capsules]) => capsules.flatMap(c => [0, 3].map(k => Math.hypot(c[k] - base[0], c[k + 1] - base[1], 0.6 * (c[k + 2] - base[2])) + c[6]))));
    const away = 1.3 ** Math.max(0, Math.ceil(Math.log(far / (0.72 * reach)) / Math.log(1.3))), scale = 0.68 * Math.min(w, h) / reach / away;
    const at = p => { const [a, b] = seen(p.map((v, k) => v - base[k])); return [w / 2 + scale * a, 0.72 * h - scale * b]; };
    const line = (from, to) => { g.beginPath(); g.moveTo(...at(from)); g.lineTo(...at(to)); g.stroke(); };
    g.lineCap = 'round';
    g.strokeStyle = '#d8d8d4'; g.lineWidth = 1;
    for (let k = -4; k <= 4; k++) {
      const e = 0.6 * reach, s = e * k / 4;
      line([base[0] + s, base[1] - e, base[2]], [base[0] + s, base[1] + e, base[2]]);
      line([base[0] - e, base[1] + s, base[2]], [base[0] + e, base[1] + s, base[2]]);
    }
    for (const [capsules, colour] of sweeps) {
      const part = new OffscreenCanvas(w, h), p = part.getContext('2d');
      p.lineCap = 'round'; p.strokeStyle = p.fillStyle = colour;  // drawn whole, then laid on once: one volume, not a pile of capsules
      for (const c of capsules) {
        const from = at(c.slice(0, 3)), radius = Math.max(0.5, scale * c[6]);
        p.lineWidth = 2 * radius;
        p.beginPath(); p.moveTo(...from); p.lineTo(...at(c.slice(3, 6))); p.stroke();
        p.beginPath(); p.arc(...from, radius, 0, 2 * Math.PI); p.fill();  // a ball: a line without length is not stroked
      }
      g.globalAlpha = 0.55; g.drawImage(part, 0, 0); g.globalAlpha = 1;
    }
    joints.slice(1).map((p, i) => [joints[i], p]).sort((a, b) => seen(b[0])[2] - seen(a[0])[2]).forEach(([a, b]) => {
      g.strokeStyle = '#fff'; g.lineWidth = 17; line(a, b);
      g.strokeStyle = '#26323d'; g.lineWidth = 12; line(a, b);
    });
    // the first is the base, the last the flange; several joints may share a place: the marked ones come last
    joints.slice(1, -1).map((p, i) => [p, marked.includes(i)]).sort((a, b) => a[1] - b[1]).forEach(([p, bad]) => {
      const [x, y] = at(p);
      g.beginPath(); g.arc(x, y, bad ? 17 : 9, 0, 2 * Math.PI);
      g.fillStyle = bad ? '#b00020' : '#fff'; g.fill(); g.lineWidth = 3; g.strokeStyle = bad ? '#fff' : '#26323d'; g.stroke();
      if (bad) { g.fillStyle = '#fff'; g.font = 'bold 22px system-ui,sans-serif'; g.textAlign = 'center'; g.textBaseline = 'middle'; g.fillText('!', x, y); }
    });
    const [x, y] = at(joints[joints.length - 1]);
    g.beginPath(); g.arc(x, y, 6, 0, 2 * Math.PI); g.fillStyle = '#f0a202'; g.fill();
  }
  const again = () => last && draw(...last);
  function steer(canvas) {
    canvas.onpointerdown = e => { held = [e.clientX, e.clientY]; canvas.setPointerCapture(e.pointerId); };
    canvas.onpointerup = () => { held = null; };
    canvas.onpointermove = e => {
      if (!held) return;
      turn += (e.clientX - held[0]) * 0.01; tilt = Math.max(-1.5, Math.min(1.5, tilt + (e.clientY - held[1]) * 0.01));
      held = [e.clientX, e.clientY]; again();
    };
    canvas.onkeydown = e => {
      const by = {ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1]}[e.key];
      if (!by) return;
      e.preventDefault(); turn += by[0]; tilt = Math.max(-1.5, Math.min(1.5, tilt + by[1])); again();
    };
  }
  return {draw, steer};
})();
