"use strict";
// What lies on the map: lines, points, rings and their labels, none later than the time chosen.
const colorOf = (color) => (color.startsWith("#") ? color : styled(`--${color}`));
const timeOf = (mark, k) => (Array.isArray(mark.when) ? mark.when[k] : mark.when);
const isShown = (map, mark, k) => mark.when === null || timeOf(mark, k) <= map.until;

function drawMarks(map, context) {
  const marks = map.drawn.marks.filter((mark) => !map.hidden.has(mark.name));
  const labels = [];
  for (const mark of marks) {
    const color = colorOf(mark.color);
    if (mark.kind === "points") drawPoints(map, context, mark, color, labels);
    else drawLine(map, context, mark, color, labels);
  }
  const taken = [];
  // points before closed lines, whose names have more places to stand
  labels.sort((one, other) => Boolean(one.light) - Boolean(other.light));
  labels.forEach((label) => placeLabel(map, context, label, taken));
}

function drawLine(map, context, mark, color, labels) {
  const path = new Path2D();
  let gap = true;
  let named = null;
  mark.x.forEach((x, k) => {
    if (x === null || !isShown(map, mark, k)) { gap = true; return; }
    const [px, py] = toScreen(map, x, mark.y[k]);
    path[gap ? "moveTo" : "lineTo"](px, py);
    gap = false;
    // the name of a closed line stands beside the highest of its points that is seen
    if (mark.label && py > map.room.t + 20 && px > 0 && px < map.w && (!named || py < named.py)) named = { px, py, text: mark.label, far: 8, light: true };
  });
  if (named) labels.push(named);
  Object.assign(context, { lineJoin: "round", lineCap: "round" });
  context.setLineDash(mark.dash === "solid" ? [] : mark.dash === "dot" ? [2, 4] : [6, 4]);
  if (mark.halo) {
    Object.assign(context, { strokeStyle: styled("--paper"), lineWidth: mark.width + 2.5, globalAlpha: 0.8 });
    context.stroke(path);
  }
  const ring = mark.kind === "ring";
  if (ring) {
    Object.assign(context, { fillStyle: color, globalAlpha: mark.label ? 0.14 : 0.06 });
    context.fill(path);
  }
  Object.assign(context, { strokeStyle: color, lineWidth: mark.width, globalAlpha: !ring ? 1 : mark.label ? 0.7 : 0.25 });
  context.stroke(path);
  context.globalAlpha = 1;
  context.setLineDash([]);
}

function drawPoints(map, context, mark, color, labels) {
  mark.x.forEach((x, k) => {
    if (x === null || !isShown(map, mark, k)) return;
    const [px, py] = toScreen(map, x, mark.y[k]);
    symbol(context, mark, px, py, color);
    if (mark.label && k === mark.x.length - 1) labels.push({ px, py, text: mark.label, far: mark.size / 2 + 7 });
  });
}

// The symbols of all media, see core/colors.py.
function symbol(context, { symbol: kind, size, edge, width = 2 }, px, py, color) {
  const r = size / 2;
  Object.assign(context, { fillStyle: color, strokeStyle: color, lineWidth: 2 });
  context.beginPath();
  if (kind === "x") { context.moveTo(px - r, py - r); context.lineTo(px + r, py + r); context.moveTo(px + r, py - r); context.lineTo(px - r, py + r); context.stroke(); return; }
  if (kind === "cross") {
    for (const [ink, wide] of [[styled("--paper"), width + 3], [color, width]]) {
      Object.assign(context, { strokeStyle: ink, lineWidth: wide });
      context.beginPath();
      context.arc(px, py, 0.62 * r, 0, 7);
      for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) { context.moveTo(px + 0.3 * r * dx, py + 0.3 * r * dy); context.lineTo(px + 1.3 * r * dx, py + 1.3 * r * dy); }
      context.stroke();
    }
    return;
  }
  if (kind === "diamond") { context.moveTo(px, py - r); context.lineTo(px + r, py); context.lineTo(px, py + r); context.lineTo(px - r, py); context.closePath(); } else context.arc(px, py, r, 0, 7);
  if (kind.endsWith("-open")) { context.lineWidth = 1.2; context.stroke(); return; }
  if (edge) { Object.assign(context, { strokeStyle: styled(`--${edge}`), lineWidth: size > 8 ? 4 : 3 }); context.stroke(); }
  context.fill();
}

// Beside a point, where nothing is yet: right, left, above, below.
function placeLabel(map, context, { px, py, text, far, light }, taken) {
  const font = light ? LABEL : `600 13px ${LABEL.slice(5)}`;
  context.font = font;
  const wide = context.measureText(text).width;
  if (px < -20 || py < -20 || px > map.w + 20 || py > map.h + 20) return;
  const tries = [[far, 4], [-far - wide, 4], [-wide / 2, -far - 2], [-wide / 2, far + 12], [far, -12], [far, 20]];
  const boxes = tries.map(([dx, dy]) => [px + dx, py + dy - 12, px + dx + wide, py + dy + 4]);
  const free = boxes.find((box) => box[0] > 4 && box[2] < map.w - 4 && box[1] > map.room.t + (light ? 18 : 0) && box[3] < map.h - map.room.b + 8 && taken.every((other) => box[2] < other[0] || other[2] < box[0] || box[3] < other[1] || other[3] < box[1]));
  if (!free) return;
  taken.push(free);
  halo(map, context, text, free[0], free[3] - 4, font);
}

// What the point nearest to the pointer says; empty where none is near.
function saidAt(map, px, py) {
  let [best, said] = [9, ""];
  for (const mark of map.drawn.marks) {
    if (mark.kind !== "points" || !mark.hover || map.hidden.has(mark.name)) continue;
    mark.x.forEach((x, k) => {
      if (x === null || !isShown(map, mark, k)) return;
      const [qx, qy] = toScreen(map, x, mark.y[k]);
      const far = Math.hypot(qx - px, qy - py);
      if (far >= best) return;
      best = far;
      const fill = (values, digits) => { const value = Array.isArray(values) ? values[k] : values; return value === null ? "unknown" : digits && Number.isFinite(value) ? value.toFixed(Number(digits[1])) : value; };
      said = mark.hover.replace(/<extra>.*$/, "").replace("%{text}", fill(mark.text)).replace(/%\{customdata(?::\.(\d)f)?\}/, (_, digits) => fill(mark.detail, [0, digits || 0]));
    });
  }
  return said;
}
