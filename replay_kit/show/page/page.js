// Draws the figures of the page. Each figure has traces of plotly with references that are resolved here:
//   "$table.column"                          a column of its data
//   {"$choose": k, "of": [...]}              by the k-th control
//   {"$field": name, "at": [...]}            two last axes of a packed array; "c0" is the choice of the control 0
//   {"$color": name}                         a colour of the page's style, which changes between light and dark
// A figure with a map is drawn by map.js and explore.js.
const MISSING = -32768;
// The loop takes a tenth of the time of Uint8Array.from with a function.
function bytesOf(base64) {
  const text = atob(base64);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i += 1) bytes[i] = text.charCodeAt(i);
  return bytes;
}
const unpacked = (id) => {
  const packed = new Blob([bytesOf(document.getElementById(id).textContent)]);
  return new Response(packed.stream().pipeThrough(new DecompressionStream("gzip"))).text();
};
const styled = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const state = { figures: [], choices: {}, arrays: {} };

function packedArray(figure, name) {
  const key = `${figure.key}.${name}`;
  if (!state.arrays[key]) {
    const { data, shape, along } = figure.packed[name];
    const bytes = bytesOf(data);
    const values = new Int16Array(bytes.length / 2);
    const stride = shape.slice(along + 1).reduce((product, size) => product * size, 1);
    // low bytes, then high ones, of differences along an axis; the array wraps as the packing did
    for (let i = 0; i < values.length; i += 1) {
      const step = bytes[i] | (bytes[values.length + i] << 8);
      values[i] = Math.floor(i / stride) % shape[along] ? step + values[i - stride] : step;
    }
    state.arrays[key] = values;
  }
  return state.arrays[key];
}

function field(figure, name, at) {
  const { shape, scale } = figure.packed[name];
  const values = packedArray(figure, name);
  const [rows, columns] = shape.slice(-2);
  let start = 0;
  at.forEach((index, axis) => {
    const k = typeof index === "string" ? state.choices[figure.key][Number(index.slice(1))] : index;
    start = start * shape[axis] + k;
  });
  start *= rows * columns;
  const out = [];
  for (let j = 0; j < rows; j += 1) {
    const row = [];
    for (let i = 0; i < columns; i += 1) {
      const value = values[start + j * columns + i];
      row.push(value === MISSING ? null : value * scale);
    }
    out.push(row);
  }
  return out;
}

function resolved(figure, value) {
  if (typeof value === "string" && value.startsWith("$")) {
    const dot = value.indexOf(".");
    return figure.tables[value.slice(1, dot)][value.slice(dot + 1)];
  }
  if (Array.isArray(value)) return value.map((item) => resolved(figure, item));
  if (value === null || typeof value !== "object") return value;
  if ("$choose" in value) return resolved(figure, value.of[state.choices[figure.key][value.$choose]]);
  if ("$field" in value) return field(figure, value.$field, value.at);
  if ("$color" in value) return styled(`--${value.$color}`);
  return Object.fromEntries(Object.entries(value).map(([key, item]) => [key, resolved(figure, item)]));
}

function layoutOf(figure) {
  const layout = resolved(figure, figure.layout);
  const narrow = isNarrow();
  const [ink, grid, paper] = [styled("--ink"), styled("--grid"), styled("--panel")];
  const axis = { gridcolor: grid, zerolinecolor: grid, linecolor: styled("--soft"), automargin: true };
  const out = {
    margin: { l: narrow ? 48 : 64, r: narrow ? 8 : 16, t: 12, b: 48 },
    hovermode: "closest",
    legend: { orientation: "h", y: -0.22, yanchor: "top", x: 0 },
    ...layout,
    paper_bgcolor: "rgba(0,0,0,0)",
    plot_bgcolor: paper,
    font: { color: ink, size: narrow ? 11 : 13, family: "system-ui, 'DejaVu Sans', sans-serif" },
    colorway: ["--one", "--two", "--three", "--four"].map(styled),
    hoverlabel: { bgcolor: styled("--paper"), bordercolor: styled("--line"), font: { color: ink } },
    // plotly would lay a dark bar over the figure, as the page's background is transparent
    modebar: { bgcolor: "rgba(0,0,0,0)", color: styled("--line"), activecolor: ink },
  };
  for (const key of Object.keys(out)) if (/^[xy]axis/.test(key)) out[key] = { ...axis, ...out[key] };
  for (const key of ["xaxis", "yaxis"]) if (!out[key]) out[key] = axis;
  return out;
}

const isNarrow = () => document.documentElement.clientWidth < 560;

// A figure whose axes have one scale is as high as its ranges ask for; on a phone its colour bar lies above it.
function fitMap(figure, place, traces, layout) {
  const [west, east] = layout.xaxis.range;
  const [south, north] = layout.yaxis.range;
  const beside = isNarrow() ? 70 : 190;
  const high = Math.max((place.clientWidth - beside) * ((north - south) / (east - west)), 260) + (isNarrow() ? 210 : 130);
  layout.height = Math.round(Math.min(high, figure.layout.height));
  layout.legend = { ...layout.legend, y: -90 / layout.height };
  if (!isNarrow()) return;
  for (const trace of traces) {
    if (trace.colorbar) {
      Object.assign(trace.colorbar, { orientation: "h", x: 0.5, xanchor: "center", y: 1.01, yanchor: "bottom", len: 0.95, thickness: 10 });
      trace.colorbar.title.side = "top";
    }
  }
}

async function draw(figure) {
  const place = document.querySelector(`#${figure.key} .plot`);
  if (figure.map.frame) {
    if (state.map) sizeMap(state.map); else startMap(figure);
    return;
  }
  // of a closed part nothing is seen, and nothing has a width
  if (!place.clientWidth) return;
  await plotly();
  const layout = layoutOf(figure);
  const traces = figure.traces.map((trace) => resolved(figure, trace));
  if (layout.yaxis.scaleanchor && layout.yaxis.range) fitMap(figure, place, traces, layout);
  place.style.height = `${layout.height}px`;
  layout.width = place.clientWidth;
  layout.shapes = [...(layout.shapes || []), ...cursorOf(figure)];
  if (!place.dataset.drawn) place.textContent = "";
  await Plotly.react(place, traces, layout, { displaylogo: false, modeBarButtonsToRemove: ["select2d", "lasso2d"] });
  if (!place.dataset.drawn && isTimed(figure)) place.on("plotly_click", ({ points: [{ x }] }) => chooseNearest(x));
  place.dataset.drawn = "yes";
  place.dataset.choices = state.choices[figure.key].join(",");
}

// One time for the map and all figures through time: a line in each, and a click in one chooses another.
const isTimed = ({ layout }) => /UTC/.test(layout.xaxis?.title?.text || "");
function cursorOf(figure) {
  if (!state.cursor || !isTimed(figure)) return [];
  const x = new Date(state.cursor).toISOString().slice(0, 19).replace("T", " ");
  return [{ type: "line", xref: "x", x0: x, x1: x, yref: "paper", y0: 0, y1: 1, line: { color: styled("--two"), width: 1.5 } }];
}

function moveCursors() {
  for (const figure of state.figures) {
    const place = document.querySelector(`#${figure.key} .plot`);
    if (place?.dataset.drawn && isTimed(figure)) Plotly.relayout(place, { shapes: [...(resolved(figure, figure.layout).shapes || []), ...cursorOf(figure)] });
  }
}

function chooseNearest(x) {
  const { map } = state;
  if (!map?.drawn.times) return;
  const [at, { times }] = [Date.parse(`${String(x).replace(" ", "T")}Z`), map.drawn];
  if (!Number.isFinite(at)) return;
  show(document.getElementById(`${map.figure.key}-2`), times.reduce((best, time, k) => (Math.abs(time - at) < Math.abs(times[best] - at) ? k : best), 0));
  obey(map, 2);
}

const csvCell = (value) => (value === null || value === undefined ? "" : /[",\n]/.test(value) ? `"${String(value).replaceAll('"', '""')}"` : value);

// A table of packed fields is made when it is asked for: a row a cell that is not missing.
function fieldTable(figure, { field: name, axes, cells, names }) {
  const { shape } = figure.packed[name];
  const columns = Object.fromEntries([...Object.keys(axes), ...Object.keys(cells), ...names].map((key) => [key, []]));
  const ends = Object.values(axes);
  for (let d = 0; d < shape[0]; d += 1) {
    for (let t = 0; t < shape[1]; t += 1) {
      const each = names.map((_, k) => field(figure, name, [d, t, k].slice(0, shape.length - 2)).flat());
      each[0].forEach((value, cell) => {
        if (value === null) return;
        [d, t].forEach((at, k) => columns[Object.keys(axes)[k]].push(ends[k][at]));
        Object.entries(cells).forEach(([key, list]) => columns[key].push(list[cell]));
        names.forEach((key, k) => columns[key].push(each[k][cell] === null ? null : Number(each[k][cell].toFixed(4))));
      });
    }
  }
  return columns;
}

function save(button) {
  const figure = state.figures.find(({ key }) => key === button.dataset.figure);
  const table = figure.tables[button.dataset.table];
  const columns = "field" in table ? fieldTable(figure, table) : table;
  const names = Object.keys(columns);
  const lines = [names.join(",")];
  for (let row = 0; row < columns[names[0]].length; row += 1) lines.push(names.map((name) => csvCell(columns[name][row])).join(","));
  saveText(`${figure.key}-${button.dataset.table}.csv`, `${lines.join("\n")}\n`, "text/csv");
}

function saveText(name, text, type) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([text], { type }));
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}

const figureOf = (input) => state.figures.find(({ key }) => key === input.dataset.figure);
const numberOf = (input) => Number(input.id.slice(input.id.lastIndexOf("-") + 1));

// Set a control and its text to a choice.
function show(input, value) {
  input.value = value;
  state.choices[input.dataset.figure][numberOf(input)] = value;
  if (input.type !== "range") return;
  const text = figureOf(input).choices[numberOf(input)][value];
  input.setAttribute("aria-valuetext", text);
  input.parentElement.querySelector("output").textContent = text;
}

const inside = (part) => state.figures.filter(({ key }) => part.querySelector(`#${key}`));

// A link to a part that is folded opens it, and lands there when its figures have their heights.
async function openTarget() {
  const target = document.getElementById(location.hash.slice(1));
  if (!target) return;
  const folded = target.querySelector(":scope > details.main");
  for (let part = folded || target; part; part = part.parentElement) if (part.tagName === "DETAILS") part.open = true;
  for (const figure of inside(target)) await draw(figure);
  target.scrollIntoView({ behavior: "instant" });
}

// The charts' library is read when the first chart is seen: the map does without it.
let loading = null;
function plotly() {
  loading ??= unpacked("plotly").then((text) => {
    const script = document.createElement("script");
    script.textContent = text;
    document.head.append(script);
  });
  return loading;
}

async function start() {
  state.figures = JSON.parse(await unpacked("figures"));
  const inputs = [...document.querySelectorAll("[data-figure][id]")];
  for (const figure of state.figures) {
    state.choices[figure.key] = inputs.filter((input) => input.dataset.figure === figure.key).map((input) => Number(input.value));
  }
  for (const input of inputs) {
    input.addEventListener("input", () => {
      show(input, Number(input.value));
      const figure = figureOf(input);
      if (figure.map.frame) obey(state.map, numberOf(input)); else draw(figure);
    });
  }
  for (const part of document.querySelectorAll("details")) part.addEventListener("toggle", () => { if (part.open) inside(part).forEach(draw); });
  for (const button of document.querySelectorAll("button[data-table]")) button.addEventListener("click", () => save(button));
  const all = async () => { for (const figure of state.figures) await draw(figure); };
  // the browser shows each figure before the next is drawn
  for (const figure of state.figures) {
    await draw(figure);
    await new Promise((shown) => { requestAnimationFrame(() => setTimeout(shown)); });
  }
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", all);
  window.addEventListener("hashchange", openTarget);
  openTarget();
  let due = 0;
  window.addEventListener("resize", () => {
    clearTimeout(due);
    due = setTimeout(all, 150);
  });
  for (const [event, printing] of [["beforeprint", true], ["afterprint", false]]) {
    window.addEventListener(event, () => { document.documentElement.classList.toggle("printing", printing);
      if (printing) document.querySelectorAll("details").forEach((part) => { part.open = true; });
      all();
    });
  }
  document.body.dataset.ready = "yes";
}

start().catch((error) => {
  for (const place of document.querySelectorAll(".waiting")) place.textContent = `This figure could not be drawn: ${error.message}. A browser of 2023 or later draws it.`;
  throw error;
});
