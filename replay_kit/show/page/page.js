// The page: packed data, values beside the pointer in charts, folded parts, print. map.js draws the map, explore.js moves it.
const MISSING = -32768;
const bytesOf = (base64) => Uint8Array.from(atob(base64), (letter) => letter.charCodeAt(0));
const unpacked = (id) => new Response(new Blob([bytesOf(document.getElementById(id).textContent)]).stream().pipeThrough(new DecompressionStream("gzip"))).json();
const styled = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();
const clamp = (value, low, high) => Math.min(Math.max(value, low), high);
const state = { figures: [], choices: [], arrays: {} };

function packedArray(figure, name) {
  if (state.arrays[name]) return state.arrays[name];
  const { data, shape, along } = figure.packed[name];
  const bytes = bytesOf(data);
  const stride = shape.slice(along + 1).reduce((product, size) => product * size, 1);
  const values = new Int16Array(bytes.length / 2);
  // low bytes, then high ones, of differences along an axis; the array wraps as the packing did
  for (let i = 0; i < values.length; i += 1) values[i] = (bytes[i] | (bytes[values.length + i] << 8)) + (Math.floor(i / stride) % shape[along] ? values[i - stride] : 0);
  return (state.arrays[name] = values);
}

// Values in charts: what is nearest to the pointer.
function listenChart(svg, { box, ends, log, axes, marks }) {
  const place = (value, axis) => {
    const number = typeof value === "string" ? Date.parse(`${value.replace(" ", "T")}Z`) : value;
    const [low, high, at] = [...ends[axis], number].map((each) => (log[axis] ? Math.log(each) : each));
    return axis ? box[1] + ((high - at) / (high - low)) * box[3] : box[0] + ((at - low) / (high - low)) * box[2];
  };
  const text = (value) => (typeof value === "number" ? Number(value.toPrecision(4)) : String(value).slice(0, 16));
  const cell = (edges, axis, at) => edges.findIndex((edge, k) => k && (place(edges[k - 1], axis) - at) * (place(edge, axis) - at) <= 0) - 1;
  const said = (px, py) => {
    let [best, words] = [20, ""];
    for (const { name, x: xs, y: ys, z: zs, text: texts } of marks) {
      const [i, j] = zs ? [cell(xs, 0, px), cell(ys, 1, py)] : [-1, -1];
      const value = i < 0 || j < 0 ? null : zs[j * (xs.length - 1) + i];
      if (value !== null) words = `${name} ${text(value)} m/s<br>${text(xs[i])}, ${text(ys[j])} to ${text(ys[j + 1])} m`;
      for (let k = 0; !zs && k < xs.length; k += 1) {
        const far = xs[k] === null || ys[k] === null ? best : Math.hypot(place(xs[k], 0) - px, place(ys[k], 1) - py);
        if (far >= best) continue;
        best = far;
        words = `${name}${texts ? `, ${text(texts[k])}` : ""}<br>${axes[0]}: ${text(xs[k])}<br>${axes[1]}: ${text(ys[k])}`;
      }
    }
    return words;
  };
  const tip = svg.parentElement.appendChild(Object.assign(document.createElement("p"), { className: "tip chart", hidden: true }));
  svg.addEventListener("pointermove", ({ clientX, clientY }) => {
    const { left, top, width } = svg.getBoundingClientRect();
    const unit = svg.viewBox.baseVal.width / width;
    tip.innerHTML = said((clientX - left) * unit, (clientY - top) * unit);
    tip.hidden = !tip.innerHTML;
    Object.assign(tip.style, { left: `${clamp(clientX + 14, 0, innerWidth - tip.offsetWidth - 8)}px`, top: `${clientY + 14}px` });
  });
  svg.addEventListener("pointerleave", () => { tip.hidden = true; });
}

// A link to a part that is folded opens it.
function openTarget() {
  const target = document.getElementById(location.hash.slice(1));
  for (let part = target?.querySelector(":scope > details.main") || target; part; part = part.parentElement) if (part.tagName === "DETAILS") part.open = true;
  target?.scrollIntoView({ behavior: "instant" });
}

async function start() {
  state.figures = await unpacked("figures");
  for (const figure of state.figures) {
    if (figure.map) startMap(figure);
    else document.querySelectorAll(`#${figure.key} .panel > svg`).forEach((svg, k) => listenChart(svg, figure.panels[k]));
  }
  const again = () => { if (state.map) sizeMap(state.map); };
  const print = ({ type }) => {
    if (document.documentElement.classList.toggle("printing", type === "beforeprint")) document.querySelectorAll("details").forEach((one) => { one.open = true; });
    again();
  };
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", again);
  for (const [event, act] of Object.entries({ resize: again, hashchange: openTarget, beforeprint: print, afterprint: print })) window.addEventListener(event, act);
  openTarget();
  document.body.dataset.ready = "yes";
}

start();
