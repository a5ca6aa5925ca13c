// How the map is used: views, moving and zooming, what is under the pointer, depth, time and play.
const part = (map, name) => map.place.parentElement.querySelector(name);
const input = (map, number) => document.getElementById(`${map.figure.key}-${number}`);
const made = (kind, values) => Object.assign(document.createElement(kind), values);

function startMap(figure) {
  const place = document.querySelector(`#${figure.key} .plot`);
  const map = { figure, drawn: figure.map, place, hidden: new Set(figure.map.marks.filter(({ off }) => off).map(({ name }) => name)), until: Infinity, quantity: "speed" };
  [map.canvas, map.tip] = [made("canvas", { ariaHidden: "true" }), made("p", { className: "tip", hidden: true, ariaLive: "polite" })];
  place.replaceChildren(map.canvas, map.tip);
  state.map = map;
  state.choices = figure.choices.map((_, number) => Number(input(map, number).value));
  [map.chosen] = Object.keys(map.drawn.views);
  sizeMap(map);
  listen(map);
  place.dataset.drawn = "yes";
}

function sizeMap(map) {
  const ratio = Math.min(window.devicePixelRatio || 1, 2);
  [map.w, map.h] = [map.place.clientWidth, map.place.clientHeight];
  map.dark = !document.documentElement.classList.contains("printing") && window.matchMedia("(prefers-color-scheme: dark)").matches;
  Object.assign(map.canvas, { width: map.w * ratio, height: map.h * ratio });
  map.canvas.getContext("2d").setTransform(ratio, 0, 0, ratio, 0, 0);
  // what the controls and, where they are as wide as the window, the keys leave free above and below [px]
  const [tools, keys, controls] = [".tools", ".keys", ":scope > .controls"].map((name) => part(map, name));
  const tops = [controls, ...(map.w < 560 ? [keys] : [])].filter(({ offsetHeight }) => offsetHeight).map(({ offsetTop }) => offsetTop);
  map.room = { t: tools.offsetHeight ? tools.offsetTop + tools.offsetHeight + 8 : 16, b: map.h - Math.min(map.h, ...tops) + 16 };
  if (map.chosen) fitView(map, map.chosen);
  drawMap(map);
}

// Show a part of the frame, clear of the controls above and below.
function fitView(map, name) {
  const { drawn: { views: { [name]: [west, east, south, north] } }, room } = map;
  map.k = Math.max(Math.min((map.w - 48) / (east - west), (map.h - room.t - room.b) / (north - south)), 1e-3);
  [map.x, map.y] = [(west + east) / 2, (south + north) / 2 + (room.t - room.b) / 2 / map.k];
  map.chosen = name;
}

function drawMap(map) {
  for (const layer of [drawGround, drawField, drawDegrees, drawDrift, drawMarks]) layer(map, map.canvas.getContext("2d"));
  drawKeys(map);
  for (const button of map.place.parentElement.querySelectorAll("[data-view]")) button.setAttribute("aria-pressed", String(button.dataset.view === map.chosen));
}

// Colour bar, length of a drift, length in km.
function drawKeys(map) {
  const km = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000].filter((each) => each * map.k <= 120).pop() || 0.5;
  const parts = [`<span class="bar-km" style="width:${(km * map.k).toFixed(0)}px">${km} km</span>`];
  if (map.drawn.scales) {
    const { most, [map.dark ? "dark" : "light"]: colors } = map.drawn.scales[map.quantity];
    const [hours, speed] = [driftHours(map), map.quantity === "speed"];
    if (speed) parts.unshift(`<span class="bar-drift">drift in ${hours < 1 ? `${60 * hours} min` : `${hours} h`}</span>`);
    const middle = `<span>0</span><span>${speed ? "current" : "standard error"}</span><span>${+(100 * most).toPrecision(3)} cm/s</span>`;
    parts.unshift(`<span class="bar-color"><i style="background:linear-gradient(to right,${colors.join(",")})"></i>${middle}</span>`);
  }
  part(map, ".keys").innerHTML = parts.join("");
}

// What the point nearest to the pointer says; empty where none is near.
function saidAt(map, px, py) {
  let [best, said] = [9, ""];
  for (const mark of map.drawn.marks.filter(({ text, name }) => text && !map.hidden.has(name))) {
    mark.text.forEach((text, k) => {
      const at = text && isShown(map, mark, k) ? toScreen(map, mark.x[k], mark.y[k]) : [Infinity, 0];
      if (Math.hypot(at[0] - px, at[1] - py) < best) [best, said] = [Math.hypot(at[0] - px, at[1] - py), text];
    });
  }
  return said;
}

// What is under a point of the window: what a mark there says, place, current with its error, depth and time.
function showTip(map, px, py) {
  const [[x, y], out] = [toPlace(map, px, py), new Float64Array(4)];
  const [kind, [longitude, latitude]] = [fieldReader(map)(x, y, out), degreesOf(map, x, y)];
  const lines = [saidAt(map, px, py), `${degreeText(latitude, "NS", 1)}, ${degreeText(longitude, "EW", 1)}`];
  if (kind === "known") {
    const [error, north] = [Math.hypot(out[2], out[3]) / Math.SQRT2, [1, 0].map((k) => degreesOf(map, x + k, y + 1 - k)[1] - latitude)];
    const about = error >= 0 ? ` ± ${(100 * error).toFixed(1)}` : "";
    // clockwise from true north, towards which latitude grows
    const bearing = Math.round((Math.atan2(out[0], out[1]) - Math.atan2(...north)) * (180 / Math.PI) + 720) % 360;
    lines.push(`<b>${(100 * Math.hypot(out[0], out[1])).toFixed(1)}${about} cm/s</b> toward ${String(bearing).padStart(3, "0")}°`);
    lines.push([1, 2].map((number) => map.figure.choices[number][state.choices[number]]).join(", "));
  } else if (kind) lines.push(kind === "dry" ? map.drawn.dry : "outside the forecast");
  map.tip.innerHTML = lines.filter(Boolean).join("<br>");
  map.tip.hidden = false;
  const { offsetWidth: wide, offsetHeight: high, style } = map.tip;
  Object.assign(style, { left: `${px + 16 + wide > map.w ? Math.max(px - wide - 16, 4) : px + 16}px`, top: `${clamp(py - high / 2, 48, map.h - high - 8)}px` });
}

// Move by pixels, and zoom about a point of the window.
function move(map, dx, dy, factor = 1, px = map.w / 2, py = map.h / 2) {
  const [x, y] = toPlace(map, px + dx, py + dy);
  map.k = clamp(map.k * factor, 0.02, 2000);
  [map.x, map.y, map.chosen] = [x - (px - map.w / 2) / map.k, y + (py - map.h / 2) / map.k, ""];
  map.due ||= requestAnimationFrame(() => { map.due = 0; drawMap(map); });
}

const KEYS = { ArrowLeft: [-60, 0], ArrowRight: [60, 0], ArrowUp: [0, -60], ArrowDown: [0, 60], "+": [0, 0, 1.5], "-": [0, 0, 1 / 1.5] };
function listen(map) {
  const [{ place }, pressed] = [map, new Map()];
  const at = (event) => { const { left, top } = place.getBoundingClientRect(); return [event.clientX - left, event.clientY - top]; };
  const on = (name, act, options) => place.addEventListener(name, act, options);
  on("pointerdown", (event) => pressed.set(event.pointerId, at(event)));
  on("pointermove", (event) => {
    const [[px, py], from] = [at(event), pressed.get(event.pointerId)];
    if (!from) { if (event.pointerType === "mouse") showTip(map, px, py); return; }
    pressed.set(event.pointerId, [px, py]);
    place.setPointerCapture(event.pointerId);
    map.tip.hidden = true;
    const other = [...pressed].find(([id]) => id !== event.pointerId)?.[1];
    const far = (one) => Math.max(Math.hypot(one[0] - other[0], one[1] - other[1]), 1);
    move(map, ...(other ? [0, 0, far([px, py]) / far(from), ...other] : [from[0] - px, from[1] - py]));
  });
  for (const name of ["pointerup", "pointercancel"]) on(name, (event) => { if (pressed.delete(event.pointerId) && event.pointerType !== "mouse") showTip(map, ...at(event)); });
  on("pointerleave", () => { map.tip.hidden = true; });
  on("dblclick", (event) => move(map, 0, 0, 2, ...at(event)));
  // a page that scrolls under the pointer must not zoom the map
  on("wheel", (event) => { if (event.ctrlKey || event.metaKey) { event.preventDefault(); move(map, 0, 0, 2 ** (-event.deltaY / 240), ...at(event)); } }, { passive: false });
  on("keydown", (event) => {
    if (!(event.key in KEYS)) return;
    event.preventDefault();
    move(map, ...KEYS[event.key]);
    showTip(map, map.w / 2, map.h / 2);
  });
  for (const button of place.parentElement.querySelectorAll(".tools button")) {
    const { view, zoom } = button.dataset;
    button.addEventListener("click", () => { if (view) { fitView(map, view); drawMap(map); } else move(map, 0, 0, Number(zoom)); });
  }
  part(map, ".layers").addEventListener("change", ({ target: { checked, name } }) => { map.hidden[checked ? "delete" : "add"](name); drawMap(map); });
  part(map, ".play")?.addEventListener("click", () => setPlaying(map, !map.timer));
  state.choices.forEach((_, number) => input(map, number).addEventListener("input", ({ target }) => { setPlaying(map, false); choose(map, number, Number(target.value)); }));
}

// Set a control, its text and the picture; what lies after the last published time is shown with it.
function choose(map, number, value) {
  const [control, text, { times }] = [input(map, number), map.figure.choices[number][value], map.drawn];
  [control.value, state.choices[number]] = [value, value];
  if (number) [control.ariaValueText, control.nextElementSibling.textContent] = [text, text];
  map.quantity = state.choices[0] ? "error" : "speed";
  map.until = state.choices[2] === times.length - 1 ? Infinity : times[state.choices[2]];
  drawMap(map);
}

// Time passes in some twelve seconds.
function setPlaying(map, playing) {
  const [button, last] = [part(map, ".play"), map.drawn.times.length - 1];
  Object.assign(button, { ariaPressed: String(playing), ariaLabel: playing ? "Pause" : "Play", textContent: playing ? "❚❚" : "▶" });
  clearInterval(map.timer);
  if (playing && state.choices[2] === last) choose(map, 2, 0);
  const next = () => (state.choices[2] < last ? choose(map, 2, state.choices[2] + 1) : setPlaying(map, false));
  map.timer = playing ? setInterval(next, clamp(12000 / (last + 1), 150, 1200)) : 0;
}
