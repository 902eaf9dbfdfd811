// The arm in parallel projection: from the side, from above, or turned by a finger. Lengths in m, base axes, z up.
import { colour, el } from "./dom.js";

const VIEWS = { side: [0, 0], plan: [0, Math.PI / 2], free: [-0.7, 0.45] };
const NEWTON_M = 0.02; // length of the arrow
const LONGEST_M = 0.25;
const GIVE = 50; // how much larger the give is drawn
let view = "side";
let [yaw, pitch] = VIEWS.side;
let box = null; // what has been seen, so that the picture does not jump
let drag = null;

export function setView(name) {
  view = name;
  [yaw, pitch] = VIEWS[name];
  box = null;
  for (const button of document.querySelectorAll("[data-view]")) button.setAttribute("aria-pressed", String(button.dataset.view === name));
}

function project([x, y, z]) {
  const a = Math.cos(yaw) * x + Math.sin(yaw) * y;
  const depth = -Math.sin(yaw) * x + Math.cos(yaw) * y;
  return [a, Math.cos(pitch) * z + Math.sin(pitch) * depth];
}

function listen(canvas) {
  canvas.onpointerdown = (event) => {
    drag = [event.clientX, event.clientY];
    canvas.setPointerCapture(event.pointerId);
  };
  canvas.onpointermove = (event) => {
    if (!drag) return;
    if (view !== "free") {
      const kept = [yaw, pitch];
      setView("free");
      [yaw, pitch] = kept;
    }
    yaw += (event.clientX - drag[0]) / 150;
    pitch = Math.max(-1.57, Math.min(1.57, pitch + (event.clientY - drag[1]) / 150));
    drag = [event.clientX, event.clientY];
    box = null;
  };
  canvas.onpointerup = canvas.onpointercancel = () => (drag = null);
}

function grow(points) {
  const [a, b] = [points.map((p) => p[0]), points.map((p) => p[1])];
  const now = [Math.min(...a), Math.max(...a), Math.min(...b), Math.max(...b)];
  if (!box) box = now;
  box = [Math.min(box[0], now[0]), Math.max(box[1], now[1]), Math.min(box[2], now[2]), Math.max(box[3], now[3])];
}

function arrow(ctx, from, to, width) {
  const angle = Math.atan2(to[1] - from[1], to[0] - from[0]);
  if (Math.hypot(to[0] - from[0], to[1] - from[1]) < 2) return;
  ctx.lineWidth = width;
  ctx.beginPath();
  ctx.moveTo(...from);
  ctx.lineTo(...to);
  for (const side of [2.6, -2.6]) {
    ctx.moveTo(...to);
    ctx.lineTo(to[0] + 11 * Math.cos(angle + side), to[1] + 11 * Math.sin(angle + side));
  }
  ctx.stroke();
}

export function showArm(arm, stale) {
  const canvas = el("arm");
  if (!canvas.onpointerdown) listen(canvas);
  const ratio = devicePixelRatio || 1;
  const [width, height] = [canvas.clientWidth, canvas.clientHeight];
  if (canvas.width !== Math.round(width * ratio)) canvas.width = Math.round(width * ratio);
  if (canvas.height !== Math.round(height * ratio)) canvas.height = Math.round(height * ratio);
  const ctx = canvas.getContext("2d");
  ctx.setTransform(ratio, 0, 0, ratio, 0, 0);
  ctx.clearRect(0, 0, width, height);
  ctx.lineCap = ctx.lineJoin = "round";
  ctx.font = "13px system-ui, sans-serif";
  if (!arm?.lines && !arm?.tip) {
    ctx.fillStyle = colour("soft");
    ctx.fillText(arm ? "no drawing yet: the robot's settings are being read, or cannot be read from here" : "nothing is heard of the arm", 12, 24);
    return;
  }
  drawArm(ctx, arm, stale, width, height);
}

function drawArm(ctx, arm, stale, width, height) {
  const sensor = arm.sensor ?? arm.tip;
  const tip = arm.tip ?? sensor;
  const lines = (arm.lines ?? []).map((line) => line.map(project));
  grow([...lines.flat(), project(tip), project(sensor)]);
  const pad = 46;
  const scale = Math.min((width - 2 * pad) / Math.max(0.1, box[1] - box[0]), (height - 2 * pad) / Math.max(0.1, box[3] - box[2]));
  const middle = [(box[0] + box[1]) / 2, (box[2] + box[3]) / 2];
  const place = ([a, b]) => [width / 2 + scale * (a - middle[0]), height / 2 - scale * (b - middle[1])];
  const at = (point) => place(project(point));
  drawAxes(ctx, height);
  ctx.globalAlpha = stale ? 0.4 : 1;
  lines.forEach((line, i) => {
    // The first is the arm; then rods and columns in turn.
    ctx.strokeStyle = i === 0 ? colour("ink") : colour(i % 2 ? "soft" : "line");
    ctx.lineWidth = i === 0 ? 6 : i % 2 ? 3 : 7;
    ctx.beginPath();
    line.forEach((point, k) => (k ? ctx.lineTo(...place(point)) : ctx.moveTo(...place(point))));
    ctx.stroke();
  });
  ctx.strokeStyle = colour("accent");
  ctx.lineWidth = 3;
  ctx.beginPath();
  ctx.moveTo(...at(sensor));
  ctx.lineTo(...at(tip));
  ctx.stroke();
  for (const joint of arm.joints ?? []) dot(ctx, at(joint), 5, colour("card"), colour("ink"));
  dot(ctx, at(sensor), 6, colour("accent"), colour("card"));
  drawGive(ctx, arm, tip, at);
  drawForce(ctx, arm, tip, at);
  ctx.globalAlpha = 1;
}

function dot(ctx, at, size, fill, stroke) {
  ctx.beginPath();
  ctx.arc(...at, size, 0, 7);
  ctx.fillStyle = fill;
  ctx.fill();
  ctx.strokeStyle = stroke;
  ctx.lineWidth = 2;
  ctx.stroke();
}

function drawForce(ctx, arm, tip, at) {
  if (!arm.force?.every(Number.isFinite)) return;
  const size = Math.hypot(...arm.force);
  if (size < 0.1) return;
  const factor = Math.min(NEWTON_M, LONGEST_M / size);
  const end = at(tip.map((x, i) => x + factor * arm.force[i]));
  ctx.strokeStyle = ctx.fillStyle = colour("bad");
  arrow(ctx, at(tip), end, 4);
  // Beyond the head, where neither the arrow nor the arm is.
  const start = at(tip);
  const length = Math.max(1, Math.hypot(end[0] - start[0], end[1] - start[1]));
  ctx.textAlign = "center";
  ctx.fillText(`${size.toFixed(1)} N`, end[0] + (30 * (end[0] - start[0])) / length, end[1] + (18 * (end[1] - start[1])) / length + 4);
  ctx.textAlign = "start";
}

function drawGive(ctx, arm, tip, at) {
  dot(ctx, at(tip), 5, colour("card"), colour("accent"));
  if (!arm.corrected || !arm.corrected_model) return;
  const give = arm.corrected.map((x, i) => x - tip[i]);
  const shown = at(tip.map((x, i) => x + GIVE * give[i]));
  dot(ctx, shown, 5, colour("warn"), colour("card"));
  ctx.fillStyle = colour("warn");
  ctx.fillText(`tip gives ${(1000 * Math.hypot(...give)).toFixed(2)} mm (drawn ${GIVE} times)`, 12, 20);
}

function drawAxes(ctx, height) {
  const from = [34, height - 34];
  const named = { x: [1, 0, 0], y: [0, 1, 0], z: [0, 0, 1] };
  for (const [name, direction] of Object.entries(named)) {
    const [a, b] = project(direction);
    if (Math.hypot(a, b) < 0.2) continue;
    ctx.strokeStyle = ctx.fillStyle = colour(name);
    const end = [from[0] + 22 * a, from[1] - 22 * b];
    ctx.lineWidth = 2;
    ctx.beginPath();
    ctx.moveTo(...from);
    ctx.lineTo(...end);
    ctx.stroke();
    ctx.fillText(name, end[0] + 5 * a - 3, end[1] - 8 * b + 4);
  }
}
