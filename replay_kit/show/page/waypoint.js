"use strict";
// Editing the plan on the map: its waypoints are dragged, added and removed, and flown at once in the estimate and in samples of it.
function startEditing(map) {
  const { figure: { flight, packed } } = map;
  const values = packedArray(map.figure, "currents");
  const { scale, shape } = packed.currents;
  const velocity = (flow, d, component, j, i) => values[(((flow * shape[1] + d) * 2 + component) * shape[3] + j) * shape[4] + i] * scale;
  const fly = (waypoints) => Array.from({ length: shape[0] }, (_, flow) => flyToWaypoints({ ...flight, velocity }, flow, flight.dives, flight.start, [...waypoints, flight.goal]));
  const panel = map.place.parentElement.querySelector(".edit");
  const button = map.place.parentElement.querySelector("[data-edit]");
  const copy = () => flight.waypoints.map((place) => [...place]);
  const original = copy();
  const edit = { fly, panel, original, untouched: null, undo: [], chosen: 0, held: null, each: [] };
  const open = (opened) => {
    map.edited = opened ? edit : null;
    panel.hidden = !opened;
    button.setAttribute("aria-expanded", String(opened));
    if (opened && !edit.untouched) edit.untouched = fly(original);
    if (opened) flown(map); else drawOver(map);
  };
  button.addEventListener("click", () => open(!map.edited));
  const keep = () => edit.undo.push(copy());
  edit.keep = keep;
  const actions = {
    add: () => {
      keep();
      const k = edit.chosen;
      const [one, other] = [flight.waypoints[k] || flight.start, flight.waypoints[k + 1] || flight.goal];
      flight.waypoints.splice(k + 1, 0, one.map((value, c) => 0.5 * (value + other[c])));
      edit.chosen = Math.min(k + 1, flight.waypoints.length - 1);
    },
    remove: () => { if (!flight.waypoints.length) return; keep(); flight.waypoints.splice(edit.chosen, 1); edit.chosen = Math.max(edit.chosen - 1, 0); },
    undo: () => { if (edit.undo.length) flight.waypoints = edit.undo.pop(); edit.chosen = Math.min(edit.chosen, flight.waypoints.length - 1); },
    reset: () => { keep(); flight.waypoints = original.map((place) => [...place]); edit.chosen = 0; },
    save: () => saveWaypoints(map),
  };
  for (const each of panel.querySelectorAll("[data-action]")) each.addEventListener("click", () => { actions[each.dataset.action](); flown(map); });
  const [select, ...degrees] = panel.querySelectorAll("select, input");
  select.addEventListener("input", () => { edit.chosen = Number(select.value); flown(map); });
  for (const input of degrees) {
    input.addEventListener("change", () => {
      const [longitude, latitude] = degrees.map((each) => Number(each.value));
      if (!flight.waypoints.length || !Number.isFinite(longitude) || !Number.isFinite(latitude)) return;
      keep();
      const own = degreesOf(map, ...flight.waypoints[edit.chosen].map((metres) => metres / 1e3))[0];
      const near = longitude + 360 * Math.round((own - longitude) / 360);
      flight.waypoints[edit.chosen] = placeOf(map, near, latitude).map((km) => km * 1e3);
      flown(map);
    });
  }
}

// Fly the way as it is now, and say what became of it.
function flown(map) {
  const { edited: edit, figure: { flight, tables, key } } = map;
  edit.each = edit.fly(flight.waypoints);
  tables.flights = {
    flow: edit.each.map((_, k) => (k ? `sample ${k}` : "estimate")),
    duration_h: edit.each.map(({ duration }) => duration / 3600),
    miss_m: edit.each.map(({ miss }) => miss),
    arrived: edit.each.map(({ arrived }) => Number(arrived)),
  };
  const same = JSON.stringify(flight.waypoints) === JSON.stringify(edit.original);
  document.querySelector(`#${key} .difference`).textContent = same ? flight.untouched : difference(edit, flight);
  document.querySelector(`#${key} .readout`).textContent = `${readout(edit.each)} ${flight.rule}`;
  const [select, longitude, latitude] = edit.panel.querySelectorAll("select, input");
  select.replaceChildren(...flight.waypoints.map((_, k) => new Option(k + 1, k, false, k === edit.chosen)));
  const own = flight.waypoints[edit.chosen];
  const degrees = own ? degreesOf(map, own[0] / 1e3, own[1] / 1e3) : [NaN, NaN];
  longitude.value = own ? turned(degrees[0]).toFixed(4) : "";
  latitude.value = own ? degrees[1].toFixed(4) : "";
  drawOver(map);
}

const shareNear = (each, radius) => each.slice(1).filter(({ arrived, miss }) => arrived && miss <= radius).length / Math.max(each.length - 1, 1);
const signed = (value, digits) => `${value < 0 ? "−" : "+"}${Math.abs(value).toFixed(digits)}`;

// Both ways are flown by the same rule in the same currents, so that what they differ by is the way's.
function difference({ each, untouched }, { dives: { radius }, plan }) {
  const hours = (each[0].duration - untouched[0].duration) / 3600;
  const text = `${each[0].arrived ? "" : "It does not arrive in time. "}${signed(hours, 1)} h on the plan's ${(plan.duration / 3600).toFixed(1)} h`;
  if (each.length < 2) return `${text}.`;
  const odds = 100 * (shareNear(each, radius) - shareNear(untouched, radius));
  const known = plan.reached === null ? "" : ` on the plan's ${(100 * plan.reached).toFixed(0)} %`;
  return `${text}; odds ${signed(odds, 0)} points${known}.`;
}

function readout(each) {
  const hours = each.map(({ duration }) => duration / 3600);
  const [mean, ...samples] = each;
  const text = `In the estimate the glider ${mean.arrived ? "arrives" : "has not arrived"} after ${hours[0].toFixed(1)} h, ${mean.miss.toFixed(0)} m from the goal.`;
  if (samples.length === 0) return text;
  const misses = samples.map(({ miss }) => miss).sort((a, b) => a - b);
  const median = (misses[Math.floor((misses.length - 1) / 2)] + misses[Math.ceil((misses.length - 1) / 2)]) / 2;
  const ends = [Math.min(...hours.slice(1)), Math.max(...hours.slice(1))].map((value) => value.toFixed(1));
  return `${text} In ${samples.length} samples of it: after ${ends[0]} to ${ends[1]} h, median miss ${median.toFixed(0)} m.`;
}

function drawEdited(map, context) {
  const { edited: { each, chosen }, figure: { flight } } = map;
  each.forEach(({ surfacings }, k) => {
    const at = each.length - 1 - k;
    Object.assign(context, { strokeStyle: styled(at ? "--one" : "--four"), lineWidth: at ? 0.8 : 3, globalAlpha: at ? 0.55 : 1 });
    context.beginPath();
    (at ? each[at].surfacings : each[0].surfacings).forEach(([x, y], n) => context[n ? "lineTo" : "moveTo"](...toScreen(map, x / 1e3, y / 1e3)));
    context.stroke();
  });
  context.globalAlpha = 1;
  flight.waypoints.forEach(([x, y], k) => {
    const [px, py] = toScreen(map, x / 1e3, y / 1e3);
    symbol(context, { symbol: "diamond", size: k === chosen ? 22 : 18, edge: "paper" }, px, py, styled("--four"));
    Object.assign(context, { font: "600 11px system-ui, sans-serif", fillStyle: styled("--paper"), textAlign: "center" });
    context.fillText(String(k + 1), px, py + 4);
    context.textAlign = "start";
  });
}

// The waypoint under the pointer is held; the pointer's distance is that of a finger.
function grab(map, px, py) {
  const { edited: edit, figure: { flight } } = map;
  const far = flight.waypoints.map(([x, y]) => { const [qx, qy] = toScreen(map, x / 1e3, y / 1e3); return Math.hypot(qx - px, qy - py); });
  const nearest = far.indexOf(Math.min(...far));
  if (!(far[nearest] < 22)) return false;
  edit.keep();
  edit.held = edit.chosen = nearest;
  return true;
}

function dragTo(map, px, py) {
  map.figure.flight.waypoints[map.edited.held] = toPlace(map, px, py).map((km) => km * 1e3);
  flown(map);
}

function drop(map) { map.edited.held = null; flown(map); }

function saveWaypoints(map) {
  const { figure: { flight } } = map;
  const at = ([x, y]) => { const [longitude, latitude] = degreesOf(map, x / 1e3, y / 1e3); return [Number(turned(longitude).toFixed(6)), Number(latitude.toFixed(6))]; };
  const way = [flight.start, ...flight.waypoints, flight.goal].map(at);
  const feature = (type, coordinates, properties) => ({ type: "Feature", properties, geometry: { type, coordinates } });
  const names = ["start", ...flight.waypoints.map((_, k) => `waypoint ${k + 1}`), "goal"];
  const features = [feature("LineString", way, { name: "edited plan" }), ...way.map((place, k) => feature("Point", place, { name: names[k] }))];
  saveText("waypoints.geojson", JSON.stringify({ type: "FeatureCollection", features }), "application/geo+json");
}
