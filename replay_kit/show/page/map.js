// The map: what of the local frame [km] is seen, the coloured field, land, degrees, drift, and what lies on it, none later than the time chosen.
const LABEL = "12px system-ui, 'DejaVu Sans', sans-serif";
const toScreen = (map, x, y) => [(x - map.x) * map.k + map.w / 2, (map.y - y) * map.k + map.h / 2];
const toPlace = (map, px, py) => [(px - map.w / 2) / map.k + map.x, map.y - (py - map.h / 2) / map.k];
const rgb = (color) => [1, 3, 5].map((k) => parseInt(color.slice(k, k + 2), 16));
const trace = (context, ...points) => { context.beginPath(); points.forEach((point) => context.lineTo(...point)); return context; };

// Longitude and latitude [degrees] of a place, linear between nodes and beyond them.
function degreesOf(map, x, y) {
  const { ends: [west, east, south, north], nodes, longitude, latitude } = map.drawn.frame;
  const [a, b] = [((x - west) / (east - west)) * (nodes - 1), ((y - south) / (north - south)) * (nodes - 1)];
  const [i, j] = [a, b].map((value) => clamp(Math.floor(value), 0, nodes - 2));
  const [f, g, k] = [a - i, b - j, j * nodes + i];
  return [longitude, latitude].map((table) => {
    const low = table[k] + f * (table[k + 1] - table[k]);
    return low + g * (table[k + nodes] + f * (table[k + nodes + 1] - table[k + nodes]) - low);
  });
}

// The field at the depth and time chosen, read fast: u, v and their errors into out; returns "known", "dry" or "outside".
function fieldReader(map) {
  const { figure: { packed }, drawn: { east, north } } = map;
  if (!packed.current) return () => "";
  const { shape: [, count, , rows, columns], scale } = packed.current;
  const [values, outside] = [packedArray(map.figure, "current"), packed.outside && packedArray(map.figure, "outside")];
  const [, depth, time] = state.choices;
  const [size, dx, dy] = [rows * columns, east[1] - east[0], north[1] - north[0]];
  const first = (depth * count + time) * 4 * size;
  return (x, y, out) => {
    const [a, b] = [(x - east[0]) / dx, (y - north[0]) / dy];
    const [i, j] = [Math.round(a), Math.round(b)];
    if (i < 0 || j < 0 || i >= columns || j >= rows) return "outside";
    const near = j * columns + i;
    if (values[first + near] === MISSING) return outside && outside[near] !== MISSING ? "outside" : "dry";
    const [i0, j0] = [clamp(Math.floor(a), 0, columns - 2), clamp(Math.floor(b), 0, rows - 2)];
    const [f, g] = [clamp(a - i0, 0, 1), clamp(b - j0, 0, 1)];
    for (let part = 0, k = first + j0 * columns + i0; part < 4; part += 1, k += size) {
      const [p, q, r, s, own] = [values[k], values[k + 1], values[k + columns], values[k + columns + 1], values[first + part * size + near]];
      const known = p !== MISSING && q !== MISSING && r !== MISSING && s !== MISSING;
      out[part] = own === MISSING ? NaN : scale * (known ? (1 - g) * (p + f * (q - p)) + g * (r + f * (s - r)) : own);
    }
    return "known";
  };
}

// Hatching behind everything: what no forecast covers. Land lies on it, and the field on that.
function drawGround(map, context) {
  Object.assign(context, { fillStyle: styled("--panel"), strokeStyle: styled("--line"), lineWidth: 1 });
  context.fillRect(0, 0, map.w, map.h);
  for (let k = -map.h; k < map.w; k += 9) trace(context, [k, map.h], [k + map.h, 0]).stroke();
  const land = new Path2D();
  for (const ring of map.drawn.frame.land) land.addPath(new Path2D(`M${ring.map(([x, y]) => toScreen(map, x, y)).join("L")}`));
  context.fillStyle = styled("--land");
  context.fill(land, "evenodd");
}

function drawField(map, context) {
  if (!map.drawn.scales) return;
  const [read, out, step] = [fieldReader(map), new Float64Array(4), 2];
  const image = new ImageData(Math.ceil(map.w / step), Math.ceil(map.h / step));
  const { data } = image;
  const { most, [map.dark ? "dark" : "light"]: colors } = map.drawn.scales[map.quantity];
  const [land, pale, ramp] = [rgb(styled("--land")), rgb(styled("--missing")), colors.map(rgb)];
  for (let n = 0; n < image.width * image.height; n += 1) {
    const kind = read(...toPlace(map, ((n % image.width) + 0.5) * step, (Math.floor(n / image.width) + 0.5) * step), out);
    if (kind === "outside") continue;
    const [speed, error] = [Math.hypot(out[0], out[1]), Math.hypot(out[2], out[3]) / Math.SQRT2];
    const at = clamp((map.quantity === "speed" ? speed : error) / most, 0, 0.9999) * (ramp.length - 1);
    // less colour is left where the error comes near the current, and exceeds it
    const left = map.quantity === "speed" && Number.isFinite(error) ? clamp(1.6 - error / Math.max(speed, 1e-6), 0.3, 1) : 1;
    const [k, plain] = [Math.floor(at), kind === "known" ? pale : land];
    for (let c = 0; c < 4; c += 1) data[4 * n + c] = c > 2 ? 255 : kind === "known" && at >= 0 ? pale[c] + left * (ramp[k][c] + (at - k) * (ramp[k + 1][c] - ramp[k][c]) - pale[c]) : plain[c];
  }
  const own = Object.assign(document.createElement("canvas"), { width: image.width, height: image.height });
  own.getContext("2d").putImageData(image, 0, 0);
  context.drawImage(own, 0, 0, image.width * step, image.height * step);
}

// A text that is read on light and on dark fields.
function halo(map, context, text, px, py, font = LABEL) {
  Object.assign(context, { font, lineWidth: 3, lineJoin: "round", strokeStyle: map.dark ? "#11181fcc" : "#ffffffcc", fillStyle: styled("--ink") });
  context.strokeText(text, px, py);
  context.fillText(text, px, py);
}

// Meridians and parallels: along rows or columns of the window the place where a degree is passed, found by Newton's steps.
function drawDegrees(map, context) {
  for (const kind of [0, 1]) {
    const [along, across] = kind ? [map.h, map.w] : [map.w, map.h];
    const at = (p, q) => degreesOf(map, ...(kind ? toPlace(map, q, p) : toPlace(map, p, q)))[kind];
    const ends = [at(0, across / 2), at(along, across / 2)].sort((a, b) => a - b);
    const step = [1 / 600, 1 / 300, 1 / 120, 1 / 60, 1 / 30, 1 / 12, 1 / 6, 1 / 4, 1 / 2, 1, 2, 5, 10, 15, 30].find((each) => (ends[1] - ends[0]) / each <= Math.max(along / 150, 2)) || 30;
    for (let value = Math.ceil(ends[0] / step) * step; value <= ends[1]; value += step) {
      const line = Array.from({ length: 17 }, (_, n) => {
        let [p, q] = [along / 2, (n * across) / 16];
        for (let k = 0; k < 4; k += 1) p = clamp(p + (20 * (value - at(p, q))) / (at(p + 10, q) - at(p - 10, q) || 1e-9), -along, 2 * along);
        return kind ? [q, p] : [p, q];
      });
      Object.assign(context, { strokeStyle: map.dark ? "#ffffff26" : "#0f19231f", lineWidth: 1 });
      trace(context, ...line).stroke();
      const [label, text] = [line[0][kind], degreeText(value, kind ? "NS" : "EW", step < 1 / 60 ? 1 : 0, step < 1)];
      if (kind && label > map.room.t + 32 && label < map.h - map.room.b) halo(map, context, text, 8, label - 5);
      if (!kind && label > 24 && label < along - 70) halo(map, context, text, label + 5, map.room.t + 12);
    }
  }
}

function degreeText(degrees, letters, digits, minutes = true) {
  const value = letters === "EW" ? ((degrees + 540) % 360) - 180 : degrees;
  const whole = Math.round(Math.abs(value) * 60 * 10 ** digits) / 10 ** digits;
  return `${Math.floor(whole / 60)}°${minutes ? `${(whole % 60).toFixed(digits).padStart(digits ? 4 : 2, "0")}′` : ""}${whole ? ` ${letters[value < 0 ? 1 : 0]}` : ""}`;
}

// Where water drifts: streaks of equal duration [h], in which the fastest water crosses two spacings.
const SPACING = 34;
function driftHours(map) {
  const far = (hours) => Math.abs(Math.log((hours * map.k * map.drawn.scales.speed.most * 3.6) / (3.4 * SPACING)));
  return [0.25, 0.5, 1, 2, 3, 6, 12, 24, 48, 96, 240].sort((one, other) => far(one) - far(other))[0];
}

function drawDrift(map, context) {
  if (!map.drawn.scales || map.hidden.has("drift")) return;
  const [read, out, step, ink] = [fieldReader(map), new Float64Array(4), 0.36 * driftHours(map), map.dark ? "255,255,255" : "15,40,70"];
  context.lineCap = "round";
  for (let n = 1; n <= Math.round((map.w * map.h) / SPACING ** 2); n += 1) {
    // even, and without the look of rows: the fractional parts of multiples of two irrational numbers
    let [x, y] = toPlace(map, ((n * 0.7548776662466927) % 1) * map.w, ((n * 0.5698402909980532) % 1) * map.h);
    const way = [toScreen(map, x, y)];
    while (way.length < 11 && read(x, y, out) === "known" && read(x + 0.5 * step * out[0], y + 0.5 * step * out[1], out) === "known") {
      [x, y] = [x + step * out[0], y + step * out[1]];
      way.push(toScreen(map, x, y));
    }
    if (way.length < 6) continue;
    for (let k = 1; k < way.length; k += 1) {
      Object.assign(context, { strokeStyle: `rgba(${ink},${0.02 + 0.042 * k})`, lineWidth: 0.5 + 0.09 * k });
      trace(context, way[k - 1], way[k]).stroke();
    }
    const [[ax, ay], [bx, by]] = way.slice(-2);
    const far = Math.hypot(bx - ax, by - ay);
    const [dx, dy] = [(bx - ax) / far, (by - ay) / far];
    context.fillStyle = `rgba(${ink},0.5)`;
    if (far >= 2) trace(context, [bx + 3 * dx, by + 3 * dy], [bx - 2 * dx - 1.8 * dy, by - 2 * dy + 1.8 * dx], [bx - 2 * dx + 1.8 * dy, by - 2 * dy - 1.8 * dx]).fill();
  }
}

const isShown = (map, mark, k) => mark.x[k] !== null && (!mark.when || mark.when[k] <= map.until);

function drawMarks(map, context) {
  const [labels, taken] = [[], []];
  for (const mark of map.drawn.marks.filter(({ name }) => !map.hidden.has(name))) {
    const [color, light] = [mark.color.startsWith("#") ? mark.color : styled(`--${mark.color}`), mark.kind !== "points"];
    const at = mark.x.map((x, k) => (isShown(map, mark, k) ? toScreen(map, x, mark.y[k]) : null));
    if (light) drawLine(context, mark, at, color);
    else at.filter(Boolean).forEach((one) => drawSymbol(context, mark, ...one, color));
    // the name of a line stands beside the highest of its points that is seen, that of a point beside the last
    const seen = at.filter((one) => one && (!light || (one[1] > map.room.t + 20 && one[0] > 0 && one[0] < map.w)));
    const one = light && seen.length ? seen.reduce((best, each) => (best[1] < each[1] ? best : each)) : seen.at(-1);
    if (mark.label && one) labels.push({ one, text: mark.label, far: light ? 8 : mark.size / 2 + 7, light });
  }
  // points before lines, whose names have more places to stand
  labels.sort((one, other) => one.light - other.light).forEach((label) => placeLabel(map, context, label, taken));
}

function drawLine(context, mark, at, color) {
  const [path, ring, named] = [new Path2D(), mark.kind === "ring", Boolean(mark.label)];
  at.forEach((one, k) => { if (one) path[k && at[k - 1] ? "lineTo" : "moveTo"](...one); });
  const stroke = (look) => { Object.assign(context, look); context.stroke(path); };
  Object.assign(context, { lineJoin: "round", lineCap: "round", fillStyle: color, globalAlpha: named ? 0.14 : 0.06 });
  context.setLineDash(mark.dash === "dot" ? [2, 4] : []);
  if (ring) context.fill(path);
  if (mark.halo) stroke({ strokeStyle: styled("--paper"), lineWidth: mark.width + 2.5, globalAlpha: 0.8 });
  stroke({ strokeStyle: color, lineWidth: mark.width, globalAlpha: ring ? (named ? 0.7 : 0.25) : mark.role === "bottom" ? 0.5 : 1 });
  context.globalAlpha = 1;
  context.setLineDash([]);
}

function drawSymbol(context, { symbol, size, edge, width }, px, py, color) {
  const [r, path] = [size / 2, new Path2D()];
  const stroke = (strokeStyle, lineWidth) => { Object.assign(context, { strokeStyle, lineWidth }); context.stroke(path); };
  if (symbol === "x") path.addPath(new Path2D(`M${px - r} ${py - r}l${size} ${size}M${px + r} ${py - r}l${-size} ${size}`));
  else if (symbol === "diamond") path.addPath(new Path2D(`M${px} ${py - r}l${r} ${r}l${-r} ${r}l${-r} ${-r}Z`));
  else path.arc(px, py, symbol === "cross" ? 0.62 * r : r, 0, 7);
  if (symbol === "cross") for (const [dx, dy] of [[r, 0], [-r, 0], [0, r], [0, -r]]) path.addPath(new Path2D(`M${px + 0.3 * dx} ${py + 0.3 * dy}L${px + 1.3 * dx} ${py + 1.3 * dy}`));
  if (symbol === "cross") stroke(styled("--paper"), width + 3);
  if (edge) stroke(styled(`--${edge}`), size > 8 ? 4 : 3);
  context.fillStyle = color;
  if (/^(circle|diamond)$/.test(symbol)) context.fill(path);
  else stroke(color, symbol === "cross" ? width : symbol === "x" ? 2 : 1.2);
}

// Beside a point, where nothing is yet: right, left, above, below.
function placeLabel(map, context, { one: [px, py], text, far, light }, taken) {
  const font = light ? LABEL : `600 13px ${LABEL.slice(5)}`;
  context.font = font;
  const wide = context.measureText(text).width;
  const tries = [[far, 4], [-far - wide, 4], [-wide / 2, -far - 2], [-wide / 2, far + 12], [far, -12], [far, 20]];
  const boxes = tries.map(([dx, dy]) => [px + dx, py + dy - 12, px + dx + wide, py + dy + 4]);
  const seen = ([left, top, right, low]) => left > 4 && right < map.w - 4 && top > map.room.t + (light ? 18 : 0) && low < map.h - map.room.b + 8;
  const free = boxes.find((box) => seen(box) && taken.every((other) => box[2] < other[0] || other[2] < box[0] || box[3] < other[1] || other[3] < box[1]));
  if (!free) return;
  taken.push(free);
  halo(map, context, text, free[0], free[3] - 4, font);
}
