"""Panels of figures as SVG for pages, in the colours of the page's style."""

import struct
import zlib
from base64 import b64encode
from collections.abc import Iterator
from datetime import datetime
from html import escape
from math import ceil, floor
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.arrays import Array
from replay_kit.core.colors import scale
from replay_kit.show.figures.figure import Axis, Figure, Mark, Panel, Tables, values_of
from replay_kit.show.numbers import nice

# Width of a panel [px], and around its axes: left, right, above and below.
_WIDE, _AROUND = 500.0, (58.0, 14.0, 8.0, 44.0)
# Most ticks across and up.
_ACROSS, _UP = 6, 5
_HOUR = 3.6e6
#: Steps of a time axis [ms]: seconds, minutes, hours and days.
_STEPS = [
    unit * count
    for unit, counts in (
        (1e3, (1, 2, 5, 10, 30)),
        (6e4, (1, 2, 5, 10, 15, 30)),
        (_HOUR, (1, 2, 3, 6, 12)),
        (24.0 * _HOUR, (1, 2, 4, 7, 14, 28, 56, 112, 365, 730, 3650)),
    )
    for count in counts
]
_DASHES = {"dash": "6 4", "dot": "1.5 3", "dashdot": "7 3 1.5 3", "longdash": "9 4"}
# Outlines of symbols about a point, in half their sizes.
_SYMBOLS = {
    "circle": "M-1 0a1 1 0 1 0 2 0a1 1 0 1 0-2 0z",
    "square": "M-.9-.9h1.8v1.8h-1.8z",
    "diamond": "M0-1.3 1.3 0 0 1.3-1.3 0z",
    "triangle-up": "M0-1.1 1.1 1H-1.1z",
    "triangle-down": "M0 1.1 1.1-1H-1.1z",
    "x": "M-1-1 1 1M1-1-1 1",
    "cross": "M0-1V1M-1 0H1",
}


class Drawn(NamedTuple):
    """Panel drawn for a page.

    Attributes:
        svg: Drawing in the colours of the page's style.
        about: Data of the tooltips: position and limits of the axes, and the marks.
    """

    svg: str
    about: dict[str, Any]


class _Scale(NamedTuple):
    """Scale of an axis: limits of its values, the pixels of both, and whether it is logarithmic or of times."""

    low: float
    high: float
    first: float
    last: float
    log: bool
    timed: bool

    def at(self, values: Any) -> Array:
        """Return the pixels of values."""
        low, high, each = (
            np.log10(part) if self.log else part for part in (self.low, self.high, values)
        )
        return np.asarray(self.first + (each - low) / (high - low) * (self.last - self.first))


def panels_svg(figure: Figure, wide: float = _WIDE) -> Iterator[Drawn]:
    """Yield the panels of a figure, without titles and colour scales; the width is in pixels."""
    for number, panel in enumerate(figure.panels):
        yield _drawn(panel, figure.tables, wide, f"{figure.key}-{number}")


def _drawn(panel: Panel, tables: Tables, full: float, key: str) -> Drawn:
    left, right, above, below = _AROUND
    below -= 0.0 if panel.x.label else 18.0
    wide = full - left - right
    high = wide * (1.0 if panel.equal else panel.height)
    x, y = _scale(panel, tables, "x", (0.0, wide)), _scale(panel, tables, "y", (high, 0.0))
    inside = "".join(
        _mark(mark, tables, (x, y), f"{key}-{count}") for count, mark in enumerate(panel.marks)
    )
    svg = (
        f'<svg viewBox="0 0 {full:g} {high + above + below:g}" aria-hidden="true" font-size="11">'
        f'<g transform="translate({left:g} {above:g})" style="fill:var(--ink)">{_axes(panel, x, y)}'
        f'<svg width="{wide:g}" height="{high:g}">{_references(panel, x, y)}{inside}</svg>{_note(panel)}</g></svg>'
    )
    about = {
        "box": [left, above, wide, high],
        "ends": [[float(f"{end:.12g}") for end in each[:2]] for each in (x, y)],
        "log": [panel.x.log, panel.y.log],
        "axes": [str(panel.x), str(panel.y)],
        "marks": [_said(mark) for mark in panel.marks],
    }
    return Drawn(svg, about)


def _numbers(values: Any) -> Array:
    """Return values as numbers, times as milliseconds since 1970."""
    each = np.asarray(values)
    if each.dtype.kind == "M":
        return each.astype("datetime64[ns]").astype(np.int64) / 1e6
    return each.astype(np.float64)


def _scale(panel: Panel, tables: Tables, name: str, pixels: tuple[float, float]) -> _Scale:
    axis: Axis = getattr(panel, name)
    timed = values_of(tables, getattr(panel.marks[0], name)).dtype.kind == "M"
    if axis.ends is not None:
        low, high = _numbers(axis.ends)
        return _Scale(low, high, *pixels, axis.log, timed)
    values = np.concatenate([_reach(mark, tables, name) for mark in panel.marks])
    known = values[np.isfinite(values) & ((values > 0.0) | (not axis.log))]
    if name == "y" and panel.level is not None:
        known = np.append(known, [panel.level, *(panel.band or ())[:2]])
    low, high = (known.min(), known.max()) if known.size else (1.0, 10.0)
    if axis.log:
        return _Scale(low / 1.2, high * 1.2, *pixels, True, timed)
    more = 0.05 * (high - low) or (_HOUR if timed else max(0.05 * abs(high), 1e-3))
    return _Scale(0.0 if axis.from_zero else low - more, high + more, *pixels, False, timed)


def _reach(mark: Mark, tables: Tables, name: str) -> Array:
    """Return the values of a mark along an axis, with errors."""
    values = _numbers(values_of(tables, getattr(mark, name))).ravel()
    if name == "x" or mark.error is None:
        return values
    error = values_of(tables, mark.error)
    return np.append(values - error, values + error)


def _axes(panel: Panel, x: _Scale, y: _Scale) -> str:
    """Return grid, ticks and labels of both axes."""
    wide, high = x.last, y.first
    (across, below), (up, beside) = _ticks(x, _ACROSS), _ticks(y, _UP)
    xs, ys = x.at(across), y.at(up)
    grid = "".join([f"M{at:.1f} 0V{high:g}" for at in xs] + [f"M0 {at:.1f}H{wide:g}" for at in ys])
    texts = [
        f'<text x="{at:.1f}" y="{high + 15.0:g}" text-anchor="middle">{text}</text>'
        for at, text in zip(xs, below, strict=True)
    ]
    texts += [
        f'<text x="-6" y="{at + 4.0:.1f}" text-anchor="end">{text}</text>'
        for at, text in zip(ys, beside, strict=True)
    ]
    name = f"time (UTC){_date(x)}" if x.timed else str(panel.x)
    return (
        f'<path d="{grid}" style="stroke:var(--grid)"/><path d="M0 0V{high:g}H{wide:g}" style="stroke:var(--soft);fill:none"/>'
        f'{"".join(texts)}<g font-size="12" text-anchor="middle"><text x="{0.5 * wide:g}" y="{high + 34.0:g}">{escape(name)}</text>'
        f'<text transform="translate(-44 {0.5 * high:g})rotate(-90)">{escape(str(panel.y))}</text></g>'
    )


def _ticks(of: _Scale, most: int) -> tuple[Array, list[str]]:
    """Return values and labels of ticks."""
    low, high = sorted(of[:2])
    if of.timed:
        step = next((step for step in _STEPS if (high - low) / step <= most), _STEPS[-1])
        values = _multiples(low, high, step)
        return values, [
            _time_text(value, step) for value in values.astype("datetime64[ms]").tolist()
        ]
    if of.log and high > 4.0 * low:
        tens = range(floor(np.log10(low)), ceil(np.log10(high)) + 1)
        subs = (1.0, 2.0, 5.0) if high < 1e3 * low else (1.0,)
        every = np.array([sub * 10.0**power for power in tens for sub in subs])
        values = every[(every >= low) & (every <= high)]
    else:
        values = _multiples(low, high, nice((high - low) / most, least=True))
    return values, [f"{value:.6g}".replace("-", "−") for value in values]


def _multiples(low: float, high: float, step: float) -> Array:
    return np.asarray(
        step * np.arange(ceil(low / step - 1e-9), floor(high / step + 1e-9) + 1) + 0.0
    )


def _time_text(time: datetime, step: float) -> str:
    """Return the label of a time: its day at midnight, otherwise its clock."""
    if time.hour == time.minute == time.second == 0:
        return f"{time.day} {time:%b}"
    return f"{time:%H:%M}" if step >= 6e4 else f"{time:%H:%M:%S}"


def _date(of: _Scale) -> str:
    """Return what the ticks of a time axis do not say of its date."""
    first, last = np.array(of[:2]).astype("datetime64[ms]").tolist()
    if first.date() == last.date():
        return f", {first.day} {first:%b %Y}"
    return f", {first.year}" if first.year == last.year else f", {first.year} to {last.year}"


def _references(panel: Panel, x: _Scale, y: _Scale) -> str:
    """Return the reference value and interval of y."""
    svg = ""
    if panel.band is not None:
        low, high = y.at(np.array(panel.band[:2]))
        svg += f'<rect y="{high:.1f}" width="{x.last:g}" height="{low - high:.1f}" style="fill:var(--three);opacity:.2"/>'
    if panel.level is not None:
        svg += f'<path d="M0 {float(y.at(panel.level)):.1f}H{x.last:g}" style="stroke:var(--soft);stroke-width:.6"/>'
    return svg


def _note(panel: Panel) -> str:
    rows = panel.note.split("\n")
    each = (f'<text x="9" y="{14 + 13 * k}">{escape(row)}</text>' for k, row in enumerate(rows))
    return f'<g font-size="10">{"".join(each)}</g>' if panel.note else ""


def _mark(mark: Mark, tables: Tables, scales: tuple[_Scale, _Scale], key: str) -> str:
    (x, y), base = scales, mark.base
    across, up = (_numbers(values_of(tables, values)) for values in (mark.x, mark.y))
    xs, ys, color = x.at(across), y.at(up), _color(mark.color)
    if mark.kind == "mesh":
        return _picture(mark, tables, xs, ys)
    if mark.kind == "band":
        return f'<path d="{_line(xs, ys)}z" style="fill:{color};opacity:.2"/>'
    if mark.kind == "bars":
        half = 0.5 * float(np.diff(across).min()) if across.size > 1 else 0.4
        ends = zip(x.at(across - half), x.at(across + half), ys, strict=True)
        bars = "".join(f"M{a:.1f} {y.first:g}V{top:.1f}H{b:.1f}V{y.first:g}z" for a, b, top in ends)
        return f'<path d="{bars}" style="fill:{color};opacity:.6"/>'
    svg = ""
    if mark.kind == "ring":
        svg += f'<path d="{_line(xs, ys)}z" style="fill:{color};opacity:.06"/>'
        color += ";opacity:.45"
    if base is not None:
        ground = y.at(values_of(tables, base))
        outline = _line(np.append(xs, xs[::-1]), np.append(ys, ground[::-1]))
        svg += f'<path d="{outline}z" style="fill:var(--land)"/>'
    if mark.error is not None:
        error = values_of(tables, mark.error)
        ends = zip(xs, y.at(up - error), y.at(up + error), strict=True)
        bars = "".join(
            f"M{at:.1f} {low:.1f}V{top:.1f}" for at, low, top in ends if np.isfinite(low + top)
        )
        svg += f'<path d="{bars}" style="stroke:{color};stroke-width:.8"/>'
    if mark.kind != "points":
        dash = f";stroke-dasharray:{_DASHES[mark.dash]}" if mark.dash in _DASHES else ""
        look = f"fill:none;stroke:{color};stroke-width:{0.9 * mark.width:g};stroke-linejoin:round"
        svg += f'<path d="{_line(xs, ys)}" style="{look}{dash}"/>'
    return svg + (_points(mark, xs, ys, color, key) if mark.kind in ("points", "joined") else "")


def _color(color: str) -> str:
    return color if color.startswith("#") else f"var(--{color})"


def _line(xs: Array, ys: Array) -> str:
    """Return the path of a line; what is not finite leaves a gap."""
    known = np.isfinite(xs + ys)
    begins = known & ~np.append(False, known[:-1])
    each = zip(xs.tolist(), ys.tolist(), known.tolist(), begins.tolist(), strict=True)
    return "".join(f"{'M' if begin else 'L'}{a:.1f} {b:.1f}" for a, b, here, begin in each if here)


def _points(mark: Mark, xs: Array, ys: Array, color: str, key: str) -> str:
    shape = _SYMBOLS.get(mark.symbol.removesuffix("-open"), _SYMBOLS["circle"])
    hollow = mark.symbol.endswith("-open") or mark.symbol in ("x", "cross")
    half = 0.45 * mark.size
    look = f"fill:none;stroke:{color};stroke-width:{1.2 / half:.3g}" if hollow else f"fill:{color}"
    known = np.isfinite(xs + ys)
    uses = (
        f'<use href="#{key}" x="{a:.1f}" y="{b:.1f}"/>'
        for a, b in zip(xs[known].tolist(), ys[known].tolist(), strict=True)
    )
    symbol = f'<path id="{key}" transform="scale({half:g})" d="{shape}" style="{look}"/>'
    return f"<defs>{symbol}</defs>{''.join(uses)}"


def _picture(mark: Mark, tables: Tables, xs: Array, ys: Array) -> str:
    """Return cells of equal size as an image, transparent where unknown."""
    assert mark.z is not None
    assert mark.scale is not None
    values, (name, least, most, _) = values_of(tables, mark.z), mark.scale
    places, colors = zip(*scale(name), strict=True)
    channels = np.array([[int(color[k : k + 2], 16) for k in (1, 3, 5)] for color in colors])
    share = (values.reshape(-1, xs.size - 1) - least) / (most - least)
    known = np.isfinite(share)
    shown = [np.interp(np.nan_to_num(share), places, channel) for channel in channels.T]
    data = b64encode(_png(np.stack([*shown, 255.0 * known], axis=-1).round().astype(np.uint8)))
    return (
        f'<image width="{xs[-1]:g}" height="{ys[-1]:g}" preserveAspectRatio="none" style="image-rendering:pixelated" '
        f'href="data:image/png;base64,{data.decode()}"/>'
    )


def _png(pixels: NDArray[np.uint8]) -> bytes:
    """Return red, green, blue and opacity of pixels, shape (rows, columns, 4), as a PNG."""
    rows, columns, _ = pixels.shape
    lines = b"".join(b"\0" + row.tobytes() for row in pixels)
    parts = {
        b"IHDR": struct.pack(">IIBBBBB", columns, rows, 8, 6, 0, 0, 0),
        b"IDAT": zlib.compress(lines, 9),
        b"IEND": b"",
    }
    each = (
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in parts.items()
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(each)


def _said(mark: Mark) -> dict[str, Any]:
    """Return the positions and tooltips of a mark; columns of the page's tables are given by name."""
    said = {"x": mark.x, "y": mark.y, "text": mark.text, "z": mark.z}
    return {"name": mark.name} | {
        key: values if isinstance(values, str) else column_of(key, values)
        for key, values in said.items()
        if values is not None
    }


def column_of(name: str, values: Any) -> list[Any]:
    """Return a column for JSON: times to the second, positions to a metre or better, other numbers to five digits."""
    array = np.asarray(values)
    if array.dtype.kind == "M":
        return [
            text.replace("T", " ") for text in np.datetime_as_string(array.astype("M8[s]")).tolist()
        ]
    if array.dtype.kind != "f":
        return list((array.astype(int) if array.dtype.kind == "b" else array).tolist())
    digits = 9 if name.endswith(("longitude", "latitude")) else 6 if name.endswith("_km") else 5
    return column(array, digits)


def column(values: Any, digits: int = 5) -> list[float | None]:
    """Return numbers for JSON, rounded to significant digits; None if not finite."""
    each = np.asarray(values, dtype=np.float64).ravel()
    known, size = np.isfinite(each), np.abs(each)
    with np.errstate(all="ignore"):
        tens = np.floor(np.log10(np.where(known & (size > 0.0), size, 1.0)))
        places = 10.0 ** (digits - 1 - tens)
        rounded = (np.rint(each * places) / places).astype(object)
    rounded[~known] = None
    return list(rounded.tolist())
