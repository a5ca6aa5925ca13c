"use strict";
// How the map is used: views, moving and zooming, what is under the pointer, depth, time and play.
const CANVASES = ["ground", "drift", "marks"];

function startMap(figure) {
  const place = document.querySelector(`#${figure.key} .plot`);
  const map = { figure, drawn: figure.map, place, canvases: {}, hidden: new Set(), playing: false, until: Infinity, quantity: "speed" };
  state.map = map;
  place.textContent = "";
  for (const name of CANVASES) {
    const canvas = document.createElement("canvas");
    canvas.setAttribute("aria-hidden", "true");
    map.canvases[name] = canvas;
    place.append(canvas);
  }
  map.tip = Object.assign(document.createElement("p"), { className: "tip", hidden: true });
  map.tip.setAttribute("aria-live", "polite");
  place.append(map.tip);
  layerBoxes(map);
  // a tab that is told its size late still opens on the plan
  sizeMap(map, true);
  listen(map);
  chooseTime(map);
  place.dataset.drawn = "yes";
}

function sizeMap(map, first = false) {
  const ratio = Math.min(window.devicePixelRatio || 1, 2);
  [map.w, map.h] = [map.place.clientWidth, map.place.clientHeight];
  map.dark = isDark();
  for (const canvas of Object.values(map.canvases)) {
    [canvas.width, canvas.height] = [map.w * ratio, map.h * ratio];
    canvas.getContext("2d").setTransform(ratio, 0, 0, ratio, 0, 0);
  }
  measureRoom(map);
  if (first || map.chosen) fitView(map, map.chosen || Object.keys(map.drawn.views)[0]);
  drawMap(map);
}

const isDark = () => !document.documentElement.classList.contains("printing") && window.matchMedia("(prefers-color-scheme: dark)").matches;

function drawMap(map) {
  const ground = map.canvases.ground.getContext("2d");
  const layers = [drawNowhere, drawLand, drawField, drawContours, drawDegrees, nameNowhere];
  layers.forEach((layer) => layer(map, ground));
  if (!map.playing) drawDrift(map);
  drawOver(map);
  drawKeys(map);
  for (const button of map.place.parentElement.querySelectorAll("[data-view]")) button.setAttribute("aria-pressed", String(button.dataset.view === map.chosen));
  map.place.dataset.choices = (state.choices[map.figure.key] || []).join(",");
}

function drawOver(map) {
  const context = map.canvases.marks.getContext("2d");
  context.clearRect(0, 0, map.w, map.h);
  drawMarks(map, context);
}

// Colour bar, length of a drift, length in km.
function drawKeys(map) {
  const { scales } = map.drawn;
  const nice = (most) => [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000].filter((each) => each <= most).pop() || 0.5;
  const km = nice(120 / map.k);
  const parts = [`<span class="bar-km" style="width:${(km * map.k).toFixed(0)}px">${km} km</span>`];
  if (scales) {
    const { most } = scales[map.quantity];
    const colors = scales[map.quantity][map.dark ? "dark" : "light"];
    const title = map.quantity === "speed" ? "current" : "standard error";
    const hours = driftHours(map);
    if (map.quantity === "speed") parts.unshift(`<span class="bar-drift">drift in ${hours < 1 ? `${60 * hours} min` : `${hours} h`}</span>`);
    parts.unshift(`<span class="bar-color"><i style="background:linear-gradient(to right,${colors.join(",")})"></i><span>0</span><span>${title}</span><span>${most} m/s</span></span>`);
  }
  map.place.parentElement.querySelector(".keys").innerHTML = parts.join("");
}

// One box for each kind of mark, to hide it.
function layerBoxes(map) {
  const list = map.place.parentElement.querySelector(".layers ul");
  const names = [...new Set(map.drawn.marks.filter(({ name }) => name).map(({ name }) => name)), ...(map.drawn.scales ? ["drift"] : [])];
  map.drawn.marks.filter(({ shown }) => !shown).forEach(({ name }) => map.hidden.add(name));
  for (const name of names) {
    const box = Object.assign(document.createElement("input"), { type: "checkbox", checked: !map.hidden.has(name) });
    const label = document.createElement("label");
    label.append(box, ` ${name}`);
    list.append(Object.assign(document.createElement("li"), {}));
    list.lastChild.append(label);
    box.addEventListener("change", () => { map.hidden[box.checked ? "delete" : "add"](name); drawMap(map); });
  }
}

// What is under a point of the window: what a mark there says, place, current with its error, depth and time, bottom.
function describe(map, px, py) {
  const [x, y] = toPlace(map, px, py);
  const lines = [];
  const said = saidAt(map, px, py);
  if (said) lines.push(said);
  const out = new Float64Array(4);
  const read = fieldReader(map);
  const kind = read ? read(x, y, out) : "";
  lines.push(placeText(degreesOf(map, x, y)));
  if (kind === "known") {
    const [speed, error] = [Math.hypot(out[0], out[1]), Math.hypot(out[2], out[3]) / Math.SQRT2];
    const about = Number.isFinite(error) ? ` ± ${error.toFixed(error < 0.01 ? 3 : 2)}` : "";
    const [, depth, time] = state.choices[map.figure.key];
    lines.push(`<b>${speed.toFixed(2)}${about} m/s</b> toward ${String(Math.round(bearingOf(map, x, y, out[0], out[1])) % 360).padStart(3, "0")}°`);
    lines.push(`${map.figure.choices[1][depth]}, ${map.figure.choices[2][time]}`);
  } else if (kind) lines.push(kind === "dry" ? map.drawn.dry : "outside the forecast");
  const bottom = bottomReader(map);
  const deep = bottom ? bottom.depth(x, y) : NaN;
  if (Number.isFinite(deep)) lines.push(`bottom at ${deep.toFixed(0)} m`);
  return lines.join("<br>");
}

function showTip(map, px, py) {
  map.tip.innerHTML = describe(map, px, py);
  map.tip.hidden = false;
  const [wide, high] = [map.tip.offsetWidth, map.tip.offsetHeight];
  map.tip.style.left = `${px + 16 + wide > map.w ? Math.max(px - wide - 16, 4) : px + 16}px`;
  map.tip.style.top = `${Math.min(Math.max(py - high / 2, 48), map.h - high - 8)}px`;
}

function zoom(map, factor, px = map.w / 2, py = map.h / 2) {
  const [x, y] = toPlace(map, px, py);
  map.k = Math.min(Math.max(map.k * factor, 0.02), 2000);
  [map.x, map.y] = [x - (px - map.w / 2) / map.k, y + (py - map.h / 2) / map.k];
  map.chosen = "";
  drawMap(map);
}

const KEYS = { ArrowLeft: [-60, 0], ArrowRight: [60, 0], ArrowUp: [0, -60], ArrowDown: [0, 60] };
function listen(map) {
  const { place, figure } = map;
  const box = place.parentElement;
  const at = (event) => { const { left, top } = place.getBoundingClientRect(); return [event.clientX - left, event.clientY - top]; };
  const pressed = new Map();
  let due = false;
  const soon = () => { if (!due) { due = true; requestAnimationFrame(() => { due = false; drawMap(map); }); } };
  place.addEventListener("pointerdown", (event) => pressed.set(event.pointerId, at(event)));
  place.addEventListener("pointermove", (event) => {
    const [px, py] = at(event);
    const from = pressed.get(event.pointerId);
    if (!from) { if (event.pointerType === "mouse") showTip(map, px, py); return; }
    pressed.set(event.pointerId, [px, py]);
    place.setPointerCapture(event.pointerId);
    map.tip.hidden = true;
    map.chosen = "";
    if (pressed.size === 2) {
      const [other] = [...pressed].filter(([id]) => id !== event.pointerId).map(([, value]) => value);
      const far = (one) => Math.hypot(one[0] - other[0], one[1] - other[1]);
      zoom(map, far([px, py]) / Math.max(far(from), 1), ...other);
      return;
    }
    map.x -= (px - from[0]) / map.k;
    map.y += (py - from[1]) / map.k;
    soon();
  });
  const release = (event) => {
    const from = pressed.get(event.pointerId);
    pressed.delete(event.pointerId);
    if (from && event.pointerType !== "mouse") showTip(map, ...at(event));
  };
  for (const name of ["pointerup", "pointercancel"]) place.addEventListener(name, release);
  place.addEventListener("pointerleave", () => { map.tip.hidden = true; });
  place.addEventListener("dblclick", (event) => zoom(map, 2, ...at(event)));
  // a page that scrolls under the pointer must not zoom the map
  place.addEventListener("wheel", (event) => {
    if (!event.ctrlKey && !event.metaKey) return;
    event.preventDefault();
    zoom(map, 2 ** (-event.deltaY / 240), ...at(event));
  }, { passive: false });
  place.addEventListener("keydown", (event) => {
    if (event.key === "+" || event.key === "-") zoom(map, event.key === "+" ? 1.5 : 1 / 1.5);
    else if (event.key in KEYS) {
      [map.x, map.y] = toPlace(map, map.w / 2 + KEYS[event.key][0], map.h / 2 + KEYS[event.key][1]);
      map.chosen = "";
      drawMap(map);
    } else return;
    event.preventDefault();
    showTip(map, map.w / 2, map.h / 2);
  });
  for (const button of box.querySelectorAll("[data-view]")) button.addEventListener("click", () => { fitView(map, button.dataset.view); drawMap(map); });
  for (const button of box.querySelectorAll("[data-zoom]")) button.addEventListener("click", () => zoom(map, Number(button.dataset.zoom)));
  const play = box.querySelector(".play");
  if (play) play.addEventListener("click", () => setPlaying(map, !map.playing));
  document.getElementById(`${figure.key}-2`)?.addEventListener("input", () => { if (map.playing) setPlaying(map, false); });
}

// A control was changed: the picture, and where it is the time, all other figures through time.
function obey(map, number) {
  map.quantity = state.choices[map.figure.key][0] ? "error" : "speed";
  if (number === 2) chooseTime(map);
  drawMap(map);
}

function chooseTime(map) {
  const { times } = map.drawn;
  if (!times) return;
  const k = state.choices[map.figure.key][2];
  // what lies after the last published time is shown with it
  map.until = k === times.length - 1 ? Infinity : times[k];
  state.cursor = times[k];
  moveCursors();
}

// Time passes in some twelve seconds; where motion is not wanted, only the map's time moves.
function setPlaying(map, playing) {
  const slider = document.getElementById(`${map.figure.key}-2`);
  const [button, last] = [map.place.parentElement.querySelector(".play"), Number(slider.max)];
  map.playing = playing;
  button.setAttribute("aria-pressed", String(playing));
  button.setAttribute("aria-label", playing ? "Pause" : "Play");
  button.textContent = playing ? "❚❚" : "▶";
  clearInterval(map.timer);
  if (!playing) { drawDrift(map); return; }
  if (Number(slider.value) === last) { show(slider, 0); obey(map, 2); }
  if (!window.matchMedia("(prefers-reduced-motion: reduce)").matches) startParticles(map);
  map.timer = setInterval(() => {
    const next = Number(slider.value) + 1;
    if (next > last) { setPlaying(map, false); return; }
    show(slider, next);
    obey(map, 2);
  }, Math.min(Math.max(12000 / (last + 1), 150), 1200));
}
