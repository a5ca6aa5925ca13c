"use strict";
// The map: what of the local frame [km] is seen, the coloured field, land, bottom, degrees and keys. marks.js draws what lies on it.
const LABEL = "12px system-ui, 'DejaVu Sans', sans-serif";
const toScreen = (map, x, y) => [(x - map.x) * map.k + map.w / 2, (map.y - y) * map.k + map.h / 2];
const toPlace = (map, px, py) => [(px - map.w / 2) / map.k + map.x, map.y - (py - map.h / 2) / map.k];

// What the controls and, where they are as wide as the window, the keys leave free above and below [px].
function measureRoom(map) {
  const part = (name) => map.place.parentElement.querySelector(`:scope > ${name}`);
  const [tools, keys, controls] = [".tools", ".keys", ".controls"].map(part);
  const tops = [controls, ...(map.w < 560 ? [keys] : [])].filter(({ offsetHeight }) => offsetHeight).map(({ offsetTop }) => offsetTop);
  map.room = { l: 24, r: 24, t: tools.offsetHeight ? tools.offsetTop + tools.offsetHeight + 8 : 16, b: map.h - Math.min(map.h, ...tops) + 16 };
}

// Show a part of the frame, clear of the controls above and below.
function fitView(map, name) {
  const [west, east, south, north] = map.drawn.views[name];
  const { room } = map;
  const [wide, high] = [map.w - room.l - room.r, map.h - room.t - room.b];
  map.k = Math.max(Math.min(wide / (east - west), high / (north - south)), 1e-3);
  map.x = (west + east) / 2 + (room.r - room.l) / 2 / map.k;
  map.y = (south + north) / 2 + (room.t - room.b) / 2 / map.k;
  map.chosen = name;
}

// Longitude and latitude [degrees] of a place, linear between nodes and beyond them.
function degreesOf(map, x, y) {
  const { ends: [west, east, south, north], nodes, longitude, latitude } = map.drawn.frame;
  const [a, b] = [((x - west) / (east - west)) * (nodes - 1), ((y - south) / (north - south)) * (nodes - 1)];
  const [i, j] = [a, b].map((value) => Math.min(Math.max(Math.floor(value), 0), nodes - 2));
  const [f, g] = [a - i, b - j];
  const at = (table) => {
    const k = j * nodes + i;
    const low = table[k] + f * (table[k + 1] - table[k]);
    return low + g * (table[k + nodes] + f * (table[k + nodes + 1] - table[k + nodes]) - low);
  };
  return [at(longitude), at(latitude)];
}

// The direction of a velocity [degrees clockwise from true north]: latitude grows towards true north.
function bearingOf(map, x, y, u, v) {
  const north = [1, 0].map((k) => degreesOf(map, x + k, y + 1 - k)[1] - degreesOf(map, x, y)[1]);
  const angle = (Math.atan2(u, v) - Math.atan2(north[0], north[1])) * (180 / Math.PI);
  return (angle + 720) % 360;
}

const minutes = (value, letters) => {
  const whole = Math.round(Math.abs(value) * 600);
  return `${Math.floor(whole / 600)}° ${((whole % 600) / 10).toFixed(1).padStart(4, "0")}′ ${letters[value < 0 ? 1 : 0]}`;
};
const turned = (longitude) => ((longitude + 540) % 360) - 180;
const placeText = ([longitude, latitude]) => `${minutes(latitude, "NS")}, ${minutes(turned(longitude), "EW")}`;

// The field at the depth and time chosen, read fast: u, v and their errors into out; returns "known", "dry" or "outside".
function fieldReader(map) {
  const { figure: { packed, key }, drawn: { east, north } } = map;
  if (!packed.current) return null;
  const { shape: [, count, , rows, columns], scale } = packed.current;
  const values = packedArray(map.figure, "current");
  const outside = packed.outside && packedArray(map.figure, "outside");
  const [, depth, time] = state.choices[key];
  const size = rows * columns;
  const first = (depth * count + time) * 4 * size;
  const [dx, dy] = [east[1] - east[0], north[1] - north[0]];
  return (x, y, out) => {
    const [a, b] = [(x - east[0]) / dx, (y - north[0]) / dy];
    const [i, j] = [Math.round(a), Math.round(b)];
    if (i < 0 || j < 0 || i >= columns || j >= rows) return "outside";
    const near = j * columns + i;
    if (values[first + near] === MISSING) return outside && outside[near] !== MISSING ? "outside" : "dry";
    const [i0, j0] = [Math.min(Math.max(Math.floor(a), 0), columns - 2), Math.min(Math.max(Math.floor(b), 0), rows - 2)];
    const [f, g] = [Math.min(Math.max(a - i0, 0), 1), Math.min(Math.max(b - j0, 0), 1)];
    for (let part = 0; part < 4; part += 1) {
      const start = first + part * size;
      const k = start + j0 * columns + i0;
      const [p, q, r, s] = [values[k], values[k + 1], values[k + columns], values[k + columns + 1]];
      const known = p !== MISSING && q !== MISSING && r !== MISSING && s !== MISSING;
      const mixed = (1 - g) * (p + f * (q - p)) + g * (r + f * (s - r));
      const own = values[start + near];
      out[part] = own === MISSING ? NaN : scale * (known ? mixed : own);
    }
    return "known";
  };
}

const rgb = (color) => [1, 3, 5].map((k) => parseInt(color.slice(k, k + 2), 16));
function rampOf(map) {
  const colors = map.drawn.scales[map.quantity][map.dark ? "dark" : "light"].map(rgb);
  return (share) => {
    const at = Math.min(Math.max(share, 0), 0.9999) * (colors.length - 1);
    const k = Math.floor(at);
    return colors[k].map((value, c) => value + (at - k) * (colors[k + 1][c] - value));
  };
}

// How much colour is left where the error comes near the current, and exceeds it.
const faded = (speed, error) => (Number.isFinite(error) ? Math.min(Math.max(1.6 - error / Math.max(speed, 1e-6), 0.3), 1) : 1);

function drawField(map, context) {
  const read = fieldReader(map);
  if (!read) return;
  const step = 2;
  const [wide, high] = [Math.ceil(map.w / step), Math.ceil(map.h / step)];
  const image = new ImageData(wide, high);
  const [ramp, land, pale] = [rampOf(map), rgb(styled("--land")), rgb(styled("--missing"))];
  const out = new Float64Array(4);
  const { most } = map.drawn.scales[map.quantity];
  const bottom = bottomReader(map);
  for (let row = 0; row < high; row += 1) {
    for (let line = 0; line < wide; line += 1) {
      const [x, y] = toPlace(map, (line + 0.5) * step, (row + 0.5) * step);
      const kind = read(x, y, out);
      if (kind === "outside") continue;
      let color = land;
      if (kind === "known") {
        const [speed, error] = [Math.hypot(out[0], out[1]), Math.hypot(out[2], out[3]) / Math.SQRT2];
        if (map.quantity === "speed") {
          const share = faded(speed, error);
          color = ramp(speed / most).map((value, c) => pale[c] + share * (value - pale[c]));
        } else color = Number.isFinite(error) ? ramp(error / most) : pale;
        if (bottom) { const lit = bottom.light(x, y); color = color.map((value) => value * lit); }
      }
      const k = 4 * (row * wide + line);
      [image.data[k], image.data[k + 1], image.data[k + 2], image.data[k + 3]] = [color[0], color[1], color[2], 255];
    }
  }
  const own = document.createElement("canvas");
  [own.width, own.height] = [wide, high];
  own.getContext("2d").putImageData(image, 0, 0);
  context.drawImage(own, 0, 0, wide * step, high * step);
}

// The bottom: its depth [m], and how it lies to a light from the north-west.
function bottomReader(map) {
  const { seabed } = map.drawn;
  if (!seabed) return null;
  const { shape: [rows, columns], scale } = map.figure.packed.seabed;
  const values = packedArray(map.figure, "seabed");
  const { east, north } = seabed;
  const at = (j, i) => values[Math.min(Math.max(j, 0), rows - 1) * columns + Math.min(Math.max(i, 0), columns - 1)];
  const cell = (x, y) => [(x - east[0]) / (east[1] - east[0]), (y - north[0]) / (north[1] - north[0])];
  const depth = (x, y) => {
    const [a, b] = cell(x, y);
    if (a < -0.5 || b < -0.5 || a > columns - 0.5 || b > rows - 0.5) return NaN;
    const [i, j] = [Math.floor(a), Math.floor(b)];
    const corners = [at(j, i), at(j, i + 1), at(j + 1, i), at(j + 1, i + 1)];
    if (corners.includes(MISSING)) return NaN;
    const [f, g] = [a - i, b - j];
    return scale * ((1 - g) * (corners[0] + f * (corners[1] - corners[0])) + g * (corners[2] + f * (corners[3] - corners[2])));
  };
  const light = (x, y) => {
    const half = 0.5 * (east[1] - east[0]);
    const slope = depth(x + half, y - half) - depth(x - half, y + half);
    return Number.isFinite(slope) ? 1 - Math.min(Math.max(slope / 4000, -0.16), 0.16) : 1;
  };
  return { at, depth, light, rows, columns, scale };
}

// Contours by marching squares, each labelled once or twice.
function drawContours(map, context) {
  const bottom = bottomReader(map);
  if (!bottom) return;
  const { east, north, step } = map.drawn.seabed;
  context.strokeStyle = map.dark ? "#ffffff66" : "#0f192366";
  context.lineWidth = 0.8;
  const labels = [];
  for (let level = step; level < 12000; level += step) {
    const limit = level / bottom.scale;
    let drawn = 0;
    context.beginPath();
    for (let j = 0; j + 1 < bottom.rows; j += 1) {
      for (let i = 0; i + 1 < bottom.columns; i += 1) {
        const corners = [[j, i], [j, i + 1], [j + 1, i + 1], [j + 1, i]];
        const found = [];
        corners.forEach(([a, b], k) => {
          const [c, d] = corners[(k + 1) % 4];
          const [one, other] = [bottom.at(a, b), bottom.at(c, d)];
          if (one === MISSING || other === MISSING || (one < limit) === (other < limit)) return;
          const f = (limit - one) / (other - one);
          found.push(toScreen(map, east[b] + f * (east[d] - east[b]), north[a] + f * (north[c] - north[a])));
        });
        if (found.length < 2) continue;
        context.moveTo(...found[0]);
        context.lineTo(...found[1]);
        const [px, py] = found[0];
        if (px > 60 && px < map.w - 80 && py > 70 && py < map.h - 90 && drawn % 60 === 20) labels.push([px, py, `${level} m`]);
        drawn += 1;
      }
    }
    context.stroke();
  }
  labels.forEach(([px, py, text]) => halo(map, context, text, px, py, "10px system-ui, sans-serif", styled("--soft")));
}

// A text that is read on light and on dark fields.
function halo(map, context, text, px, py, font = LABEL, color = styled("--ink")) {
  Object.assign(context, { font, lineWidth: 3, lineJoin: "round", strokeStyle: map.dark ? "#11181fcc" : "#ffffffcc", fillStyle: color });
  context.strokeText(text, px, py);
  context.fillText(text, px, py);
}

function drawLand(map, context) {
  context.fillStyle = styled("--land");
  context.beginPath();
  for (const ring of map.drawn.frame.land) {
    for (let k = 0; k < ring.length; k += 2) context[k ? "lineTo" : "moveTo"](...toScreen(map, ring[k], ring[k + 1]));
    context.closePath();
  }
  context.fill("evenodd");
}

// Meridians and parallels: along rows or columns of the window the place where a degree is passed.
const STEPS = [1 / 600, 1 / 300, 1 / 120, 1 / 60, 1 / 30, 1 / 12, 1 / 6, 1 / 4, 1 / 2, 1, 2, 5, 10, 15, 30];
function drawDegrees(map, context) {
  const labelled = [];
  for (const kind of [0, 1]) {
    const along = kind ? map.h : map.w;
    const across = kind ? map.w : map.h;
    const at = (p, q) => degreesOf(map, ...(kind ? toPlace(map, q, p) : toPlace(map, p, q)))[kind];
    const ends = [at(0, across / 2), at(along, across / 2)].sort((a, b) => a - b);
    const step = STEPS.find((each) => (ends[1] - ends[0]) / each <= Math.max(along / 150, 2)) || 30;
    for (let value = Math.ceil(ends[0] / step) * step; value <= ends[1]; value += step) {
      let label = null;
      Object.assign(context, { strokeStyle: map.dark ? "#ffffff26" : "#0f19231f", lineWidth: 1 });
      context.beginPath();
      for (let q = 0; q <= across; q += across / 16) {
        let [low, high] = [-0.5 * along, 1.5 * along];
        const rising = at(high, q) > at(low, q);
        for (let k = 0; k < 18; k += 1) {
          const middle = 0.5 * (low + high);
          if ((at(middle, q) < value) === rising) low = middle; else high = middle;
        }
        context[q ? "lineTo" : "moveTo"](...(kind ? [q, low] : [low, q]));
        if (q === 0) label = low;
      }
      context.stroke();
      if (label > 24 && label < along - (kind ? 40 : 70)) labelled.push([kind, value, label, step]);
    }
  }
  for (const [kind, value, at, step] of labelled) {
    const text = axisText(kind ? value : turned(value), kind ? "NS" : "EW", step);
    if (kind && (at < map.room.t + 32 || at > map.h - map.room.b)) continue;
    halo(map, context, text, kind ? 8 : at + 5, kind ? at - 5 : map.room.t + 12);
  }
}

function axisText(value, letters, step) {
  const digits = step < 1 / 60 ? 1 : 0;
  const whole = Math.round(Math.abs(value) * 60 * 10 ** digits) / 10 ** digits;
  const part = (whole % 60).toFixed(digits).padStart(digits ? 4 : 2, "0");
  const letter = whole === 0 ? "" : ` ${letters[value < 0 ? 1 : 0]}`;
  return `${Math.floor(whole / 60)}°${step < 1 ? `${part}′` : ""}${letter}`;
}

// Hatching behind everything: what no forecast covers.
function drawNowhere(map, context) {
  context.fillStyle = styled("--panel");
  context.fillRect(0, 0, map.w, map.h);
  Object.assign(context, { strokeStyle: styled("--line"), lineWidth: 1 });
  context.beginPath();
  for (let k = -map.h; k < map.w; k += 9) { context.moveTo(k, map.h); context.lineTo(k + map.h, 0); }
  context.stroke();
}

// The name of what is hatched, where there is room for it.
function nameNowhere(map, context) {
  const read = fieldReader(map);
  if (!read) return;
  const out = new Float64Array(4);
  for (let py = map.h - 90; py > 100; py -= 30) {
    for (let px = 20; px + 150 < map.w; px += 50) {
      if ([0, 75, 150].every((dx) => [-14, 8].every((dy) => read(...toPlace(map, px + dx, py + dy), out) === "outside"))) {
        halo(map, context, "outside the forecast", px, py, LABEL, styled("--soft"));
        return;
      }
    }
  }
}
