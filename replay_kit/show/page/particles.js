"use strict";
// Where water drifts: streaks of equal duration, or particles that move while time plays.
const SPACING = 34;

// The duration [h] in which the fastest water crosses two spacings, of 1, 2, 3, 6, 12 or more hours.
function driftHours(map) {
  const fast = map.drawn.scales.speed.most * 3.6;
  const wanted = (3.4 * SPACING) / map.k / fast;
  return [0.25, 0.5, 1, 2, 3, 6, 12, 24, 48, 96, 240].reduce((best, each) => (Math.abs(Math.log(each / wanted)) < Math.abs(Math.log(best / wanted)) ? each : best));
}

// Steps of a drift by the midpoint rule from a place, [km] and [h]; shorter where nothing is known.
function driftFrom(read, x, y, hours, steps) {
  const out = new Float64Array(4);
  const way = [[x, y]];
  const step = (3.6 * hours) / steps;
  for (let k = 0; k < steps; k += 1) {
    if (read(x, y, out) !== "known") break;
    if (read(x + 0.5 * step * out[0], y + 0.5 * step * out[1], out) !== "known") break;
    x += step * out[0];
    y += step * out[1];
    way.push([x, y]);
  }
  return way;
}

// Even, and without the look of rows: the fractional parts of multiples of two irrational numbers.
const scattered = (k) => [(k * 0.7548776662466927) % 1, (k * 0.5698402909980532) % 1];

function drawStreaks(map, context) {
  const read = fieldReader(map);
  if (!read || map.hidden.has("drift")) return;
  const hours = driftHours(map);
  const count = Math.round((map.w * map.h) / SPACING ** 2);
  const ink = map.dark ? "255,255,255" : "15,40,70";
  context.lineCap = "round";
  for (let n = 0; n < count; n += 1) {
    const [a, b] = scattered(n + 1);
    const way = driftFrom(read, ...toPlace(map, a * map.w, b * map.h), hours, 10).map(([x, y]) => toScreen(map, x, y));
    if (way.length < 6) continue;
    for (let k = 1; k < way.length; k += 1) {
      Object.assign(context, { strokeStyle: `rgba(${ink},${0.02 + 0.042 * k})`, lineWidth: 0.5 + 0.09 * k });
      context.beginPath();
      context.moveTo(...way[k - 1]);
      context.lineTo(...way[k]);
      context.stroke();
    }
    arrowHead(context, way[way.length - 2], way[way.length - 1], `rgba(${ink},0.5)`);
  }
}

function arrowHead(context, [ax, ay], [bx, by], color) {
  const far = Math.hypot(bx - ax, by - ay);
  if (far < 2) return;
  const [dx, dy] = [(bx - ax) / far, (by - ay) / far];
  context.fillStyle = color;
  context.beginPath();
  context.moveTo(bx + 3 * dx, by + 3 * dy);
  context.lineTo(bx - 2 * dx - 1.8 * dy, by - 2 * dy + 1.8 * dx);
  context.lineTo(bx - 2 * dx + 1.8 * dy, by - 2 * dy - 1.8 * dx);
  context.fill();
}

// Particles for as long as time plays; fewer of them where a frame takes longer than 33 ms.
function startParticles(map) {
  const context = map.canvases.drift.getContext("2d");
  const most = Math.min(1400, Math.round((map.w * map.h) / 700));
  const all = Array.from({ length: most }, (_, k) => ({ k: k + 1, age: (k * 37) % 90, x: 0, y: 0, born: false }));
  let [count, last, slow] = [most, performance.now(), 0];
  const out = new Float64Array(4);
  const frame = (now) => {
    if (!map.playing) { drawDrift(map); return; }
    const read = fieldReader(map);
    slow = now - last > 33 ? slow + 1 : 0;
    if (slow > 8 && count > 150) { count = Math.round(count / 2); slow = 0; }
    last = now;
    Object.assign(context, { globalCompositeOperation: "destination-in", fillStyle: "rgba(0,0,0,0.93)" });
    context.fillRect(0, 0, map.w, map.h);
    Object.assign(context, { globalCompositeOperation: "source-over", lineWidth: 1.5, strokeStyle: map.dark ? "rgba(255,255,255,.75)" : "rgba(15,40,70,.7)" });
    context.beginPath();
    const step = (driftHours(map) * 3.6) / 60;
    for (const one of all.slice(0, count)) {
      if (!one.born || one.age > 90) {
        const [a, b] = scattered(one.k);
        [one.x, one.y] = toPlace(map, a * map.w, b * map.h);
        one.k += most;
        one.age = one.born ? 0 : one.age;
        one.born = true;
      }
      one.age += 1;
      if (read(one.x, one.y, out) !== "known") { one.age = 99; continue; }
      context.moveTo(...toScreen(map, one.x, one.y));
      one.x += step * out[0];
      one.y += step * out[1];
      context.lineTo(...toScreen(map, one.x, one.y));
    }
    context.stroke();
    requestAnimationFrame(frame);
  };
  context.clearRect(0, 0, map.w, map.h);
  requestAnimationFrame(frame);
}

// The still picture of the drift.
function drawDrift(map) {
  const context = map.canvases.drift.getContext("2d");
  context.clearRect(0, 0, map.w, map.h);
  drawStreaks(map, context);
}
