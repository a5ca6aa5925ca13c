// The figure whose waypoints can be moved: what its controls and the pointer do; used by page.js.
// The flights over the waypoints, in the estimate and in its samples.
function flights(figure) {
  const { flight, packed } = figure;
  const values = packedArray(figure, "currents");
  const { scale, shape } = packed.currents;
  const velocity = (flow, d, component, j, i) => values[(((flow * shape[1] + d) * 2 + component) * shape[3] + j) * shape[4] + i] * scale;
  const each = Array.from({ length: shape[0] }, (_, flow) => flyToWaypoints({ ...flight, velocity }, flow, flight.dives, flight.start, [...flight.waypoints, flight.goal]));
  figure.tables.flights = {
    flow: each.map((_, k) => (k ? `sample ${k}` : "estimate")),
    duration_h: each.map(({ duration }) => duration / 3600),
    miss_m: each.map(({ miss }) => miss),
    arrived: each.map(({ arrived }) => Number(arrived)),
  };
  document.querySelector(`#${figure.key} .readout`).textContent = readout(each, flight.dives.radius);
  const line = (places, more) => ({ type: "scatter", mode: "lines", hoverinfo: "skip", x: places.map((p) => p[0] / 1e3), y: places.map((p) => p[1] / 1e3), ...more });
  const samples = each.slice(1).map(({ surfacings }, k) => line(surfacings, { name: "samples", legendgroup: "samples", showlegend: k === 0, line: { width: 0.8, color: styled("--one") } }));
  const mark = { size: 16, symbol: "diamond", color: styled("--two"), line: { width: 2, color: styled("--paper") } };
  return [
    ...samples,
    line(each[0].surfacings, { name: "estimate", mode: "lines+markers", line: { width: 3, color: styled("--two") }, marker: { size: 5 } }),
    line(flight.waypoints, { name: "waypoints", mode: "markers+text", text: flight.waypoints.map((_, k) => k + 1), textposition: "top center", marker: mark }),
  ];
}

function readout(each, tolerance) {
  const hours = each.map(({ duration }) => duration / 3600);
  const [mean, ...samples] = each;
  const text = `In the estimate the glider ${mean.arrived ? "arrives" : "has not arrived"} after ${hours[0].toFixed(1)} h, ${mean.miss.toFixed(0)} m from the goal.`;
  if (samples.length === 0) return text;
  const misses = samples.map(({ miss }) => miss).sort((a, b) => a - b);
  const median = (misses[Math.floor((misses.length - 1) / 2)] + misses[Math.ceil((misses.length - 1) / 2)]) / 2;
  const near = samples.filter(({ arrived, miss }) => arrived && miss <= tolerance).length;
  const ends = [Math.min(...hours.slice(1)), Math.max(...hours.slice(1))].map((value) => value.toFixed(1));
  return `${text} In ${samples.length} samples of it: after ${ends[0]} to ${ends[1]} h, median miss ${median.toFixed(0)} m; ${((100 * near) / samples.length).toFixed(0)} % arrive within ${tolerance.toFixed(0)} m.`;
}

// A control of the waypoints: another waypoint moves the sliders, a slider moves the waypoint.
function setWaypoint({ key, flight }, number, value) {
  if (number > 0) {
    flight.waypoints[state.choices[key][0]][number - 1] = flight.places[number - 1][value];
    return;
  }
  flight.places.forEach((axis, k) => show(document.getElementById(`${key}-${k + 1}`), nearest(axis, flight.waypoints[value][k])));
}

const nearest = (axis, at) => axis.reduce((best, value, i) => (Math.abs(value - at) < Math.abs(axis[best] - at) ? i : best), 0);

// The waypoint nearest to where the pointer goes down follows it.
function dragWaypoint(figure) {
  const place = document.querySelector(`#${figure.key} .plot`);
  const { flight, key } = figure;
  const placeOf = (event) => {
    const { xaxis, yaxis } = place._fullLayout;
    const box = place.getBoundingClientRect();
    return [xaxis.p2d(event.clientX - box.left - xaxis._offset), yaxis.p2d(event.clientY - box.top - yaxis._offset)].map((km) => km * 1e3);
  };
  const move = (event) => {
    const at = placeOf(event);
    flight.places.forEach((axis, k) => set(document.getElementById(`${key}-${k + 1}`), nearest(axis, at[k])));
    return draw(figure);
  };
  place.style.touchAction = "none";
  place.addEventListener("pointerdown", (event) => {
    if (event.target.closest(".modebar, .legend")) return;
    place.setPointerCapture(event.pointerId);
    const at = placeOf(event);
    const far = flight.waypoints.map((waypoint) => Math.hypot(waypoint[0] - at[0], waypoint[1] - at[1]));
    set(document.getElementById(`${key}-0`), far.indexOf(Math.min(...far)));
    move(event);
  });
  place.addEventListener("pointermove", (event) => { if (place.hasPointerCapture(event.pointerId)) move(event); });
}
