"use strict";
const data = JSON.parse(document.getElementById("motion-data").textContent);
const canvas = document.getElementById("robot"), pen = canvas.getContext("2d");
const play = document.getElementById("play"), slider = document.getElementById("time"), clock = document.getElementById("clock");
const speed = document.getElementById("speed"), last = data.frames.length - 1, pause = 0.7;
const all = [...data.frames.flat(), ...data.targets, ...data.balls.flatMap(b => [0, 1, 2].flatMap(i => [-1, 1].map(s =>
  [0, 1, 2].map(j => b[j] + (i === j ? s * b[3] : 0)))))];
const low = [0, 1, 2].map(i => Math.min(...all.map(p => p[i]))), high = [0, 1, 2].map(i => Math.max(...all.map(p => p[i])));
const size = Math.hypot(...high.map((h, i) => h - low[i])) || 1;
const middle = low.map((l, i) => 0.5 * (l + high[i])), flat = high.map((h, i) => h - low[i] < 0.05 * size);
// Plane mechanisms are seen from the side.
let yaw = flat[1] ? 0.12 : flat[0] ? Math.PI / 2 + 0.12 : 0.75, pitch = flat[2] ? 1.3 : flat[0] || flat[1] ? 0.1 : 0.35;
let t = 0, playing = !matchMedia("(prefers-reduced-motion: reduce)").matches, before = null;

// Right, up and towards the viewer, of an orthographic picture.
function seen(p) {
  const x = p[0] - middle[0], y = p[1] - middle[1], z = p[2] - middle[2];
  const c = Math.cos(yaw), s = Math.sin(yaw), d = -s * x + c * y;
  return [c * x + s * y, Math.cos(pitch) * z + Math.sin(pitch) * d, Math.sin(pitch) * z - Math.cos(pitch) * d];
}

function between(frames, place) {
  const k = Math.min(Math.floor(place), last - 1), s = place - k;
  const mix = (a, b) => typeof a === "number" ? (1 - s) * a + s * b : a.map((x, i) => mix(x, b[i]));
  return mix(frames[k], frames[k + 1]);
}

function draw() {
  const style = getComputedStyle(document.documentElement), color = name => style.getPropertyValue("--" + name).trim();
  const ratio = devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
  if (canvas.width !== Math.round(width * ratio)) { canvas.width = Math.round(width * ratio); canvas.height = Math.round(height * ratio); }
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, width, height);
  pen.lineCap = pen.lineJoin = "round";
  const scale = 0.98 * Math.min(width, height) / size;
  const at = p => { const [x, y] = seen(p); return [width / 2 + scale * x, height / 2 - scale * y]; };
  const line = (points, stroke, thick) => {
    pen.beginPath(); points.forEach((p, i) => pen[i ? "lineTo" : "moveTo"](...at(p))); pen.strokeStyle = stroke; pen.lineWidth = thick; pen.stroke();
  };
  const disc = (p, radius, fill, stroke) => {
    pen.beginPath(); pen.arc(...at(p), radius, 0, 2 * Math.PI);
    if (fill) { pen.fillStyle = fill; pen.fill(); }
    if (stroke) { pen.strokeStyle = stroke; pen.lineWidth = 1.5; pen.stroke(); }
  };
  const ball = (p, radius, name, alpha) => { pen.globalAlpha = alpha; disc(p, scale * radius, color(name)); pen.globalAlpha = 1; disc(p, scale * radius, null, color(name)); };

  const rough = size / 6, power = 10 ** Math.floor(Math.log10(rough)), step = power * [1, 2, 5, 10].find(by => by * power >= rough);
  const from = [0, 1].map(i => Math.floor((middle[i] - 0.5 * size) / step) * step);
  const count = Math.ceil(size / step);
  for (let i = 0; i <= count; i++) {
    line([[from[0] + i * step, from[1], data.floor], [from[0] + i * step, from[1] + count * step, data.floor]], color("grid"), 1);
    line([[from[0], from[1] + i * step, data.floor], [from[0] + count * step, from[1] + i * step, data.floor]], color("grid"), 1);
  }
  const place = Math.min(t / data.duration, 1) * last, points = between(data.frames, place);
  line(data.frames.map(f => f[data.trace]), color("measured"), 1.5);
  pen.globalAlpha = 0.16;
  for (const f of [data.frames[0], data.frames[last]]) for (const [a, b] of data.lines) line([f[a], f[b]], color("ink"), b < data.bodies ? 6 : 3);
  pen.globalAlpha = 1;
  const things = data.lines.map(([a, b]) => [0.5 * (seen(points[a])[2] + seen(points[b])[2]), () => line([points[a], points[b]], color("predicted"), b < data.bodies ? 7 : 4)]);
  for (const j of data.joints) things.push([seen(points[j])[2] + 0.04 * size, () => disc(points[j], 4.5, color("paper"), color("predicted"))]);
  for (const b of data.balls) things.push([seen(b)[2], () => ball(b, b[3], "nominal", 0.25)]);
  for (const c of data.carried) { const p = between(c.frames, place); things.push([seen(p)[2], () => ball(p, c.radius, "predicted", 0.12)]); }
  things.sort((a, b) => a[0] - b[0]).forEach(thing => thing[1]());
  for (const p of data.targets) {
    const [x, y] = at(p);
    pen.strokeStyle = color("bad"); pen.lineWidth = 2; pen.beginPath();
    pen.moveTo(x - 6, y - 6); pen.lineTo(x + 6, y + 6); pen.moveTo(x - 6, y + 6); pen.lineTo(x + 6, y - 6); pen.stroke();
  }
  disc(points[data.trace], 3.5, color("ink"));
  slider.value = Math.min(t / data.duration, 1);
  clock.textContent = Math.min(t, data.duration).toFixed(2) + " s";
  for (const c of cursors) { const x = c.left + (c.right - c.left) * Math.min(t / data.duration, 1); c.line.setAttribute("x1", x); c.line.setAttribute("x2", x); }
}

// A line in every panel says what time it is.
const picture = document.querySelector("#signals svg");
const cursors = data.panels.map(([left, right, top, bottom]) => {
  const line = document.createElementNS("http://www.w3.org/2000/svg", "line");
  line.setAttribute("y1", top); line.setAttribute("y2", bottom); line.setAttribute("class", "cursor");
  picture.appendChild(line);
  return { line, left, right };
});

function tick(now) {
  if (playing && before !== null) { t += Number(speed.value) * (now - before) / 1000; if (t > data.duration + pause * Number(speed.value)) t = 0; }
  before = now;
  draw();
  if (playing) requestAnimationFrame(tick); else before = null;
}

function start(on) { playing = on; play.textContent = on ? "Pause" : "Play"; requestAnimationFrame(tick); }

play.onclick = () => { if (!playing && t >= data.duration) t = 0; start(!playing); };
slider.oninput = () => { t = Number(slider.value) * data.duration; start(false); };
canvas.onpointerdown = event => { canvas.setPointerCapture(event.pointerId); canvas.classList.add("held"); };
canvas.onpointerup = canvas.onpointercancel = () => canvas.classList.remove("held");
canvas.onpointermove = event => {
  if (!event.buttons) return;
  yaw -= 0.01 * event.movementX;
  pitch = Math.max(-1.57, Math.min(1.57, pitch + 0.01 * event.movementY));
  if (!playing) draw();
};
canvas.onkeydown = event => {
  const by = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[event.key];
  if (!by) return;
  event.preventDefault(); yaw += by[0]; pitch = Math.max(-1.57, Math.min(1.57, pitch + by[1])); draw();
};
addEventListener("resize", draw);
document.getElementById("controls").hidden = false;
start(playing);
