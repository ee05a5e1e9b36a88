// Shows what /api/v1/stream tells. Every text is put in as text, never as HTML.
'use strict';
const $ = (id) => document.getElementById(id);
const put = (id, text) => { const e = $(id); if (e.textContent !== text) e.textContent = text; };
const HALF = { x: 190, y: 130 };
const MOST_EVENTS = 100, MOST_POINTS = 1800, STALE_MS = 3000;
let track = [], latest = null, heardAt = 0, begun = null;

const metres = (m) => m == null ? '–' : m < 10 ? m.toFixed(1) + ' m' : m < 10000 ? Math.round(m) + ' m' : (m / 1000).toFixed(0) + ' km';
const count = (n) => n < 1e5 ? String(n) : n < 1e7 ? Math.round(n / 1e3) + 'k' : (n / 1e6).toFixed(1) + 'M';
const span = (s) => {
  s = Math.floor(s);
  if (s < 60) return s + ' s';
  if (s < 3600) return Math.floor(s / 60) + ' min ' + String(s % 60).padStart(2, '0') + ' s';
  return Math.floor(s / 3600) + ' h ' + String(Math.floor(s / 60) % 60).padStart(2, '0') + ' min';
};
const element = (name, text, kind) => {
  const e = document.createElement(name);
  if (text != null) e.textContent = text;
  if (kind) e.className = kind;
  return e;
};

function show(s) {
  latest = s;
  heardAt = performance.now();
  // Another process counts from the beginning: what was shown is of the one before.
  if (begun != null && s.uptime_s < begun) restart();
  begun = s.uptime_s;
  $('top').dataset.mode = s.mode.name;
  document.title = s.mode.name + ' – Holdover';
  put('mode', s.mode.name);
  put('since', 'for ' + span(s.mode.for_s));
  const reason = s.mode.reason || '';
  put('reason', [reason, /GNSS/.test(reason) && s.mode.gnss !== 'trusted' ? null : 'GNSS ' + s.mode.gnss].filter(Boolean).join(' · '));
  const v = s.vehicle;
  put('link', v ? `${v.autopilot}${v.version ? ' ' + v.version : ''}, system ${v.system}, ${v.armed ? 'armed' : 'disarmed'}${v.heard ? '' : ', SILENT'}` : 'no autopilot is heard');
  const u = s.mode.name === 'Aligning' ? null : s.uncertainty;
  put('sigma', u ? metres(u.horizontal_m) : '–');
  put('sigma-more', u ? `height ± ${metres(u.height_m)}, heading ± ${u.heading_deg.toFixed(1)}°` : 'not aligned yet');
  put('carried', s.carried_by || '–');
  put('carried-more', u ? `± ${u.velocity_mps.toFixed(2)} m/s` : '');
  const o = s.outlook;
  put('outlook-after', Math.round(o ? o.after_s : 60) + ' s');
  put('outlook', o ? metres(o.off_m) : '–');
  put('outlook-more', !o ? 'not known yet' : o.off_m == null ? `on ${o.carried_by}, not measured yet` : `off, on ${o.carried_by}; measured ${o.times} times`);
  const out = s.output;
  put('sent', out.sent > 0 && out.rate_hz > 0.05 ? out.rate_hz.toFixed(0) + ' Hz' : out.sent > 0 ? 'silent' : 'nothing');
  put('sent-more', out.sending.replace(/^(not )?sent: /, (_, not) => not ? 'not: ' : '') + (s.clock.latency_ms == null ? '' : `; ${s.clock.latency_ms.toFixed(0)} ms old there`));
  sources(s.sources);
  facts(s);
  follow(s);
  put('version', 'Holdover ' + s.version + ', up ' + span(s.uptime_s));
}

function sources(list) {
  const rows = list.map((s) => {
    const row = element('tr', null, s.health);
    const name = element('td', s.kind + (s.id ? ' ' + s.id : ''));
    const why = [s.charge, s.reason].filter(Boolean);
    if (why.length && (s.health !== 'healthy' || s.reason)) name.append(element('span', why.join('; '), 'why'));
    const number = (text, kind) => element('td', text, 'n' + (kind || ''));
    row.append(name, element('td', s.health, 'health'),
      number(s.rate_hz < 10 ? s.rate_hz.toFixed(1) : s.rate_hz.toFixed(0)),
      number(s.age_s < 10 ? s.age_s.toFixed(1) + ' s' : span(s.age_s)),
      number(s.test_ratio == null ? '–' : s.test_ratio.toFixed(2)),
      number(count(s.used), ' wide'), number(count(s.refused), ' wide'));
    return row;
  });
  $('sources').replaceChildren(...rows);
}

function facts(s) {
  const rows = [];
  const add = (name, text) => { if (text) rows.push(element('dt', name), element('dd', text)); };
  add('autopilot stands on', s.output.autopilot_on);
  add('it makes of ours', s.output.fused);
  const rec = s.output.recording;
  if (rec) add('recorded', `${(rec.bytes / 1e6).toFixed(1)} MB${rec.lost ? ', ' + rec.lost + ' frames missing' : ''}`);
  add('sent', `${s.output.sent}${s.output.withheld ? ', ' + s.output.withheld + ' withheld' : ''}${s.output.quality == null ? '' : ', quality ' + s.output.quality}`);
  add('received', `${s.input.frames} frames, ${s.input.rate_hz.toFixed(0)} a second`);
  add('rejected', s.input.rejected.map((c) => `${c.count} ${c.cause}`).join(', ') || 'nothing');
  add('dropped', s.input.dropped ? String(s.input.dropped) : '');
  add('strangers', s.input.strangers ? String(s.input.strangers) + ' datagrams or connections' : '');
  add('heights at fault', s.faulty_heights.join(', '));
  const c = s.clock;
  add('clock', c.round_trip_ms == null ? 'no timesync' : `round trip ${c.round_trip_ms.toFixed(1)} ms${c.reboots ? ', ' + c.reboots + ' reboots' : ''}`);
  for (const l of s.input.links) add(l.endpoint, `${l.peer || 'nobody'}: ${l.frames[0]} in, ${l.frames[1]} out, ${l.lost} lost`);
  $('facts').replaceChildren(...rows);
}

function follow(s) {
  const p = s.plan;
  if (p && s.mode.name !== 'Aligning') {
    const [n, e] = p.position_ned_m, last = track[track.length - 1];
    if (!last || s.uptime_s - last[0] >= 1) track.push([s.uptime_s, n, e]);
    if (track.length > MOST_POINTS) track.shift();
  }
  draw(p);
}

// North up, the vehicle and its track in the picture.
function draw(p) {
  if (!p) return;
  const points = track.map(([, n, e]) => [n, e]);
  const marks = [p.position_ned_m.slice(0, 2), p.gnss_m, p.autopilot_m].filter(Boolean);
  let [n0, n1, e0, e1] = [Infinity, -Infinity, Infinity, -Infinity];
  for (const [n, e] of points.concat(marks)) { n0 = Math.min(n0, n); n1 = Math.max(n1, n); e0 = Math.min(e0, e); e1 = Math.max(e1, e); }
  const r = Math.max(5, Math.min(p.ellipse.major_m, 500));
  const [pn, pe] = p.position_ned_m;
  n0 = Math.min(n0, pn - r); n1 = Math.max(n1, pn + r); e0 = Math.min(e0, pe - r); e1 = Math.max(e1, pe + r);
  const scale = Math.min(HALF.x / ((e1 - e0) / 2), HALF.y / ((n1 - n0) / 2)) * 0.92;
  const cn = (n0 + n1) / 2, ce = (e0 + e1) / 2;
  const at = ([n, e]) => [(e - ce) * scale, -(n - cn) * scale];
  $('track').setAttribute('points', points.concat([p.position_ned_m]).map((q) => at(q).map((x) => x.toFixed(1)).join(',')).join(' '));
  const [x, y] = at([pn, pe]);
  const ellipse = $('ellipse');
  ellipse.setAttribute('rx', Math.max(p.ellipse.major_m * scale, 0.5));
  ellipse.setAttribute('ry', Math.max(p.ellipse.minor_m * scale, 0.5));
  ellipse.setAttribute('transform', `translate(${x} ${y}) rotate(${p.ellipse.azimuth_deg - 90})`);
  $('vehicle').setAttribute('transform', `translate(${x} ${y}) rotate(${p.heading_deg})`);
  for (const [id, mark] of [['gnss', p.gnss_m], ['autopilot', p.autopilot_m]]) {
    $(id).setAttribute('class', mark ? '' : 'hidden');
    if (mark) $(id).setAttribute('transform', `translate(${at(mark)})`);
  }
  grid(scale, cn, ce);
  const apart = p.gnss_m ? `; GNSS ${metres(Math.hypot(p.gnss_m[0] - pn, p.gnss_m[1] - pe))} away` : '';
  put('place', `${metres(Math.hypot(pn, pe))} from the origin, ${metres(-p.position_ned_m[2])} up${apart}`);
}

function grid(scale, cn, ce) {
  const rough = 90 / scale, power = 10 ** Math.floor(Math.log10(rough));
  const step = power * ([1, 2, 5].findLast((k) => k * power <= rough) || 1);
  const lines = [];
  const line = (x1, y1, x2, y2) => {
    const l = document.createElementNS('http://www.w3.org/2000/svg', 'line');
    l.setAttribute('x1', x1); l.setAttribute('y1', y1); l.setAttribute('x2', x2); l.setAttribute('y2', y2);
    lines.push(l);
  };
  for (let e = Math.ceil((ce - 200 / scale) / step) * step; (e - ce) * scale <= 200; e += step) line((e - ce) * scale, -140, (e - ce) * scale, 140);
  for (let n = Math.ceil((cn - 140 / scale) / step) * step; (n - cn) * scale <= 140; n += step) line(-200, -(n - cn) * scale, 200, -(n - cn) * scale);
  $('grid').replaceChildren(...lines);
  put('plan-scale', `north up, a square is ${step < 1000 ? step + ' m' : step / 1000 + ' km'}`);
}

function event(e) {
  if ($('event-' + e.number)) return;
  const row = element('li', null, e.severity);
  row.id = 'event-' + e.number;
  const time = element('time', new Date(e.unix_s * 1000).toTimeString().slice(0, 8));
  row.append(time, element('span', e.text));
  if (e.code) row.append(element('code', e.code));
  $('events').prepend(row);
  while ($('events').childElementCount > MOST_EVENTS) $('events').lastElementChild.remove();
}

function restart() {
  track = [];
  $('events').replaceChildren();
}

async function catchUp() {
  try {
    const told = await (await fetch('/api/v1/track')).json();
    const newest = told.length ? told[told.length - 1][0] : 0;
    track = told.concat(track.filter(([t]) => t > newest));
    if (latest) draw(latest.plan);
  } catch { /* The next connection tries again. */ }
}

function connect() {
  const stream = new EventSource('/api/v1/stream');
  stream.addEventListener('open', () => { begun = null; restart(); catchUp(); });
  stream.addEventListener('status', (e) => show(JSON.parse(e.data)));
  stream.addEventListener('event', (e) => event(JSON.parse(e.data)));
  // A browser gives up for good where the answer was no stream, as with too many viewers.
  stream.addEventListener('error', () => { if (stream.readyState === EventSource.CLOSED) setTimeout(connect, 2000); });
}

setInterval(() => {
  const stale = performance.now() - heardAt > STALE_MS;
  $('top').classList.toggle('stale', stale && latest != null);
  if (stale && latest) put('link', 'NO WORD FROM THE DAEMON for ' + span((performance.now() - heardAt) / 1000));
}, 500);
connect();
