"""Matplotlib back end of figures: files for papers, and SVG in the colours of a page's style."""

import math
import re
from collections.abc import Mapping, Sequence
from io import BytesIO
from textwrap import fill
from typing import Any, NamedTuple

import numpy as np
from matplotlib import dates as untyped
from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure as Canvas
from matplotlib.ticker import LogLocator, MaxNLocator, NullLocator
from matplotlib.transforms import ScaledTranslation

from replay_kit.core.words.colors import LIGHT, PRINT, scale
from replay_kit.show.figures.figure import (
    BEHIND,
    DASHES,
    GRID,
    MARKERS,
    PAGE,
    PAPER,
    SMALL,
    THIN,
    WIDTHS,
    Axis,
    Figure,
    Mark,
    Panel,
)
from replay_kit.show.numbers import nice_number

# matplotlib has no types of dates
dates: Any = untyped
#: What would state when a figure was made, by the forms of its file, so that the same result gives the same bytes.
ENDINGS: dict[str, dict[str, None]] = {
    ".png": {},
    ".svg": {"Date": None},
    ".pdf": {"CreationDate": None},
}


class _Medium(NamedTuple):
    """Drawing parameters of a medium: colours by role, points per pixel of widths and sizes, and number of time labels."""

    palette: Mapping[str, str]
    thin: float
    small: float
    times: int

    def color(self, color: str) -> str:
        """Return the colour of a role; other colours unchanged."""
        return self.palette.get(color, color)

    def label(self, axis: Axis | str) -> str:
        """Return a label with its unit as the medium writes it."""
        return str(axis) if self is _PAGE else str(axis).replace("m/s", "m s$^{-1}$")


_PAPER, _PAGE = _Medium(PRINT, THIN, SMALL, 7), _Medium(LIGHT, 0.9, 0.9, 6)


def draw_panel(axes: Axes, panel: Panel, medium: _Medium = _PAPER) -> None:
    """Draw a panel into axes.

    Args:
        axes: Axes.
        panel: Panel.
        medium: Paper or page.
    """
    soft = medium.color("soft")
    if not panel.marks:
        axes.set(xticks=[], yticks=[])
        look: Any = {"ha": "center", "va": "center", "color": soft, "transform": axes.transAxes}
        axes.text(0.5, 0.5, fill(panel.note, 34), **look)
        return
    if panel.degrees:
        axes.patch.set(facecolor="white", edgecolor=PRINT["soft"], hatch="//////", linewidth=0.0)
    if panel.level is not None:
        axes.axhline(panel.level, color=soft, linewidth=0.5)
    if panel.band is not None:
        low, high, name = panel.band
        axes.axhspan(low, high, color=medium.color("three"), alpha=0.2, linewidth=0.0, label=name)
    for mark in panel.marks:
        _draw_mark(axes, mark, medium)
    if panel.note:
        axes.text(0.02, 0.97, panel.note, transform=axes.transAxes, va="top", fontsize="small")
    _draw_axes(axes, panel, medium)
    _draw_labels(axes, panel.labels, medium)


def _draw_mark(axes: Axes, mark: Mark, medium: _Medium) -> None:
    x, y, color, name = mark.x, mark.y, medium.color(mark.color), mark.name or None
    if mark.kind == "mesh":
        _draw_mesh(axes, mark, medium)
    elif mark.kind == "arrows":
        _draw_arrows(axes, mark)
    elif mark.kind == "band":
        axes.fill(x, y, facecolor=color, alpha=0.2, linewidth=0.0, label=name)
    elif mark.kind == "bars":
        wide = float(np.diff(x).min()) if x.size > 1 else 0.8
        axes.bar(x, y, wide, color=color, alpha=0.6, label=name)
    else:
        _draw_line(axes, mark, medium)


def _draw_line(axes: Axes, mark: Mark, medium: _Medium) -> None:
    """Draw lines, closed ones, and points."""
    x, y, color, light = mark.x, mark.y, medium.color(mark.color), medium.color("paper")
    width, size = medium.thin * mark.width, medium.small * mark.size
    if mark.halo:
        axes.plot(x, y, color=light, linewidth=width + 2.0 * medium.thin, solid_capstyle="round")
    if mark.kind == "ring":
        for ring in np.split(np.column_stack([x, y]), np.flatnonzero(np.isnan(x))):
            known = ring[np.isfinite(ring[:, 0])]
            axes.fill(*known.T, facecolor=color, alpha=0.06, zorder=2.5)
    if mark.base is not None:
        axes.fill_between(x, y, mark.base, color=medium.color("land"), linewidth=0.0)
    dots = mark.kind in ("points", "joined")
    look: Any = {
        **{"color": color, "linewidth": width, "label": mark.name or None},
        "linestyle": "none" if mark.kind == "points" else DASHES.get(mark.dash, "-"),
        "marker": MARKERS.get(mark.symbol, "o") if dots else None,
        "markersize": size,
        "markerfacecolor": "none" if mark.symbol.endswith("-open") else color,
        **({"alpha": 0.45} if mark.kind == "ring" else {}),
    }
    if mark.edge:
        look |= {"markeredgecolor": medium.color(mark.edge), "markeredgewidth": 0.6}
    if mark.symbol == "cross":
        # a cross of lines on a light one is seen on any field and hides little
        axes.plot(x, y, "+", color=light, markersize=size, markeredgewidth=2.2)
        look |= {"markeredgewidth": 1.2}
    if mark.error is None:
        axes.plot(x, y, **look)
    else:
        axes.errorbar(x, y, mark.error, elinewidth=0.6, **look)


def _draw_mesh(axes: Axes, mark: Mark, medium: _Medium) -> None:
    assert mark.z is not None
    x, y, known = mark.x, mark.y, np.ma.masked_invalid(mark.z)
    name, least, most, label = mark.scale or ("land", None, None, "")
    look: Any = {"cmap": colormap(name), "vmin": least, "vmax": most, "zorder": 1.0}
    if x.ndim == 1:
        # cells of equal size, each of them a pixel
        axes.set_facecolor("none" if medium is _PAGE else PRINT["land"])
        across = dates.date2num(x[[0, -1]]) if x.dtype.kind == "M" else x[[0, -1]]
        ends: Any = {"extent": (*across, y[-1], y[0]), "origin": "upper", "aspect": "auto"}
        mesh: Any = axes.imshow(known, interpolation="none", **ends, **look)
    else:
        # beside missing cells there is nothing to interpolate with
        look |= {"shading": "gouraud"} if x.shape == known.shape else {}
        mesh = axes.pcolormesh(x, y, known, rasterized=True, **look)
    if mark.scale is None or medium is _PAGE:
        return
    extend = "neither" if name == "speed" else "both" if least else "max"
    beside = axes.inset_axes((1.03, 0.0, 0.03, 1.0))
    axes.figure.colorbar(mesh, cax=beside, label=medium.label(label), extend=extend)


def _draw_arrows(axes: Axes, mark: Mark) -> None:
    """Draw arrows, ``size`` of them along the width, and a key of their length between axes and title."""
    assert mark.z is not None
    known = np.hypot(*mark.z)
    typical = float(np.nanquantile(known, 0.95)) if np.isfinite(known).any() else 1.0
    long = max(typical, 1e-6)
    look: Any = {
        **{"color": PRINT["ink"], "edgecolor": "white", "linewidth": 0.3, "width": 0.0045},
        **{"minlength": 0.5, "scale": 0.75 * mark.size * long},
    }
    axes.quiver(mark.x, mark.y, *mark.z, zorder=2.0, pivot="mid", **look)
    shown = nice_number(0.6 * long)
    up = ScaledTranslation(0.0, 5.0 / 72.0, axes.figure.dpi_scale_trans)
    place: Any = {"transform": axes.transAxes + up, "clip_on": False}
    axes.quiver([1.0], [1.0], [shown], [0.0], pivot="tip", **place, **look)
    text, at = f"{shown:g} m s$^{{-1}}$", 0.985 - shown / look["scale"]
    axes.text(at, 1.0, text, ha="right", va="center", fontsize="small", **place)


def _draw_axes(axes: Axes, panel: Panel, medium: _Medium) -> None:
    for axis, name in ((panel.x, "x"), (panel.y, "y")):
        axes.set(**{f"{name}label": medium.label(axis)})
        if axis.log:
            axes.set(**{f"{name}scale": "log"})
            _number_logarithms(getattr(axes, f"{name}axis"))
        if axis.ends is not None or axis.from_zero:
            axes.set(**{f"{name}lim": axis.ends or (0.0, None)})
    if panel.marks[0].x.dtype.kind == "M":
        date_axis(axes, medium.times)
    if panel.equal:
        axes.set_box_aspect(1.0)
    if panel.degrees:
        middle = np.cos(np.deg2rad(np.clip(np.mean(axes.get_ylim()), -89.0, 89.0)))
        axes.set_aspect(1.0 / max(float(middle), 0.02))
        for name, bins, letters in (("x", 4, "EW"), ("y", 3, "NS")):
            axes.locator_params(axis=name, nbins=bins)  # type: ignore[arg-type]
            getattr(axes, f"{name}axis").set_major_formatter(
                lambda value, _, letters=letters: degrees_text(value, letters)
            )


def _number_logarithms(axis: Any) -> None:
    """Label a logarithmic axis with round numbers, evenly spaced over a narrow range."""
    least, most = axis.get_view_interval()
    even = MaxNLocator(5, steps=[1, 2, 5, 10])
    axis.set_major_locator(even if most < 4.0 * least else LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_locator(NullLocator())


def _draw_labels(axes: Axes, labels: Sequence[tuple[float, float, str]], medium: _Medium) -> None:
    """Draw centred labels; labels near another one or out of sight are omitted."""
    kept: list[Any] = []
    (west, east), (south, north) = axes.get_xlim(), axes.get_ylim()
    for x, y, text in labels:
        at = np.array([(x - west) / (east - west), (y - south) / (north - south)])
        far = [np.abs(at - other) for other in kept]
        if (np.abs(at - 0.5) < 0.42).all() and all(dx > 0.16 or dy > 0.06 for dx, dy in far):
            look: Any = {"ha": "center", "va": "center", "fontsize": "x-small"}
            axes.text(x, y, text, color=medium.color("ink"), **look, clip_on=True)
            kept.append(at)


def date_axis(axes: Axes, most: int) -> None:
    """Limit the labels of a time axis, with the year at its end.

    Args:
        axes: Axes.
        most: Number of labels that fit.
    """
    locator: Any = dates.AutoDateLocator(minticks=2, maxticks=most)
    # with few labels, spans between two and four days, hours and so on would else have no step
    each = (dates.SECONDLY, 60), (dates.MINUTELY, 60), (dates.HOURLY, 24), (dates.MONTHLY, 12)
    for unit, whole in each:
        locator.intervald[unit] = [*locator.intervald[unit], whole]
    locator.intervald[dates.DAILY] = [1, 2, 3, 4, 5, 7, 14, 21]
    axes.xaxis.set_major_locator(locator)
    axes.xaxis.set_major_formatter(dates.ConciseDateFormatter(locator))
    axes.set_xlabel("time (UTC)")


def degrees_text(value: float, letters: str) -> str:
    """Return the label of a longitude (letters ``EW``, any multiple of 360 added) or latitude (``NS``)."""
    value = (value + 180.0) % 360.0 - 180.0 if letters == "EW" else value
    letter = "" if abs(value) < 1e-9 else letters[0] if value > 0.0 else letters[1]
    return f"{abs(float(f'{value:.6g}')):g}°{letter}"


def colormap(name: str) -> LinearSegmentedColormap:
    """Return a colour map of cmocean, ``speed``, ``balance`` or ``amp``, or the one of land."""
    land = [(0.0, PRINT["land"]), (1.0, PRINT["land"])]
    return LinearSegmentedColormap.from_list(name, land if name == "land" else scale(name))


# Height of the notes and of the legend below a figure [inches a line], and the letters that fit into an inch of each.
_LINE, _LETTERS, _SMALL = 0.13, 17.0, 20.0


class ShownCanvas(Canvas):
    """Matplotlib figure that notebooks display without pyplot."""

    @rc_context(PAPER)
    def draw(self, renderer: Any) -> None:
        """Draw in the print style, also for ticks added by a layout."""
        super().draw(renderer)

    def _repr_png_(self) -> bytes:
        self.savefig(file := BytesIO(), format="png", dpi=120)
        return file.getvalue()


@rc_context(PAPER)
def figure_bytes(canvas: Canvas, ending: str) -> bytes:
    """Return the reproducible bytes of a figure's file, in a format of ``ENDINGS``."""
    content, form = BytesIO(), ending.removeprefix(".")
    canvas.savefig(content, format=form, metadata=ENDINGS[ending])
    return content.getvalue()


def drawn_into(axes: Axes, figure: Figure, number: int, letter: str = "") -> None:
    """Draw a panel of a figure into axes, with its title and, if not shared, its legend."""
    panel = figure.panels[number]
    draw_panel(axes, panel)
    if not (panel.shares_legend and letter) and axes.get_legend_handles_labels()[0]:
        axes.legend(loc="best")
    axes.set_title(f"{letter}{panel.title}".lstrip("-"), pad=13.0 if panel.degrees else 6.0)


@rc_context(PAPER)
def compose(figure: Figure, columns: int) -> Canvas:
    """Return a figure drawn for a paper: lettered panels, common legend and notes.

    Args:
        figure: Figure.
        columns: Width in columns of a page, 1 or 2.
    """
    width, count = WIDTHS[columns], len(figure.panels)
    across = min(figure.across if columns == 2 else 1, count)
    rows = [figure.panels[k : k + across] for k in range(0, count, across)]
    heights = [max(panel.height for panel in row) * width / across for row in rows]
    canvas = ShownCanvas(figsize=(width, sum(heights)), layout="constrained")
    grid = canvas.add_gridspec(len(rows), across, height_ratios=heights)
    entries: dict[str, Any] = {}
    for k, panel in enumerate(figure.panels):
        axes = canvas.add_subplot(grid[divmod(k, across)])
        drawn_into(axes, figure, k, f"({chr(ord('a') + k)}) " if count > 1 else "-")
        if panel.shares_legend:
            marks, labels = axes.get_legend_handles_labels()
            entries |= dict(zip(labels, marks, strict=True))
    notes = fill(" ".join(figure.notes), int(_LETTERS * width))
    lines = notes.count("\n") + 2 if notes else 0
    if entries:
        beside = _beside([*entries], width)
        lines += -(-len(entries) // beside)
        place: Any = {"loc": "outside lower left", "ncols": beside, "alignment": "left"}
        below = canvas.legend([*entries.values()], [*entries], **place)
        below.set_title(notes, {"size": 6.0})  # type: ignore[arg-type]
        below.get_title().set_color(PRINT["soft"])
    elif notes:
        canvas.supxlabel(notes, fontsize=6.0, color=PRINT["soft"], x=0.01, ha="left")
    canvas.set_size_inches(width, sum(heights) + _LINE * lines)
    # axes of a fixed shape depend on their size, which depends on the layout
    for _ in range(3 if entries else 0):
        canvas.draw_without_rendering()
    return canvas


def _beside(names: Sequence[str], width: float) -> int:
    """Return the number of legend columns that fit into a figure's width [inches]."""

    def letters(columns: int) -> int:
        each = np.array_split(np.array([len(name) for name in names]), columns)
        return int(sum(lengths.max() + 9 for lengths in each))

    return next((n for n in range(len(names), 1, -1) if letters(n) <= _SMALL * width), 1)


# Width of a panel of a page [px], and around its axes: left, right, above and below.
_WIDE, _AROUND = 500.0, (58.0, 14.0, 8.0, 44.0)


@rc_context(PAGE)
def panels_svg(figure: Figure, wide: float = _WIDE) -> list[tuple[str, dict[str, Any]]]:
    """Return the panels of a figure for a page, without titles and colour scales, as SVG in the colours of its style.

    With each are the data of its tooltips: position and limits of the axes, and the marks. The width is in pixels.
    """
    return [
        _panel_svg(panel, f"{figure.key}-{number}", wide)
        for number, panel in enumerate(figure.panels)
    ]


def _panel_svg(panel: Panel, key: str, full: float) -> tuple[str, dict[str, Any]]:
    left, right, above, below = _AROUND
    below -= 0.0 if panel.x.label else 18.0
    wide = full - left - right
    high = wide * (1.0 if panel.equal else panel.height)
    total = high + above + below
    timed = panel.marks[0].x.dtype.kind == "M"
    canvas = Canvas(figsize=(full / 72.0, total / 72.0), dpi=72)
    axes = canvas.add_axes((left / full, below / total, wide / full, high / total))
    draw_panel(axes, panel, _PAGE)
    axes.yaxis.set_label_coords(-46.0 / wide, 0.5)
    if not panel.x.log and not timed:
        axes.locator_params(axis="x", nbins=6)
    if not panel.y.log:
        axes.locator_params(axis="y", nbins=5)
    canvas.savefig(file := BytesIO(), format="svg", dpi=144, metadata=ENDINGS[".svg"])
    # of times milliseconds since 1970
    ends = np.array([axes.get_xlim(), axes.get_ylim()]) * [[8.64e7 if timed else 1.0], [1.0]]
    about = {
        "box": [left, above, wide, high],
        "ends": [rounded_column(pair, 12) for pair in ends],
        "log": [panel.x.log, panel.y.log],
        "axes": [str(panel.x), str(panel.y)],
        "marks": [*map(_said, panel.marks)],
    }
    return _slim(file.getvalue().decode(), key), about


def _said(mark: Mark) -> dict[str, Any]:
    """Return the positions, values and tooltips of a mark."""
    said = {"x": mark.x, "y": mark.y, "text": mark.text, "z": mark.z}
    known = {key: rounded_column(values, 6) for key, values in said.items() if values is not None}
    return {"name": mark.name, **known}


def rounded_column(values: Any, digits: int) -> list[Any]:
    """Return values for JSON: times to the second, numbers rounded to significant digits, None if not finite."""
    each = np.asarray(values).ravel()
    if each.dtype.kind == "M":
        return [text.replace("T", " ") for text in np.datetime_as_string(each, unit="s").tolist()]
    values = each.tolist()
    if each.dtype.kind != "f":
        return list(values)
    return [float(f"{one:.{digits}g}") if math.isfinite(one) else None for one in values]


_COLORS = {color: f"var(--{role})" for role, color in LIGHT.items()}
_COLORS |= {GRID: "var(--grid)", BEHIND: "var(--panel)"}


# A group without an attribute around what has none within, and one of nothing.
_PLAIN = re.compile(r"<g>\s*((?:(?!<g[ >]|</g>).)*)</g>\s*|<g/>\s*|<defs>\s*</defs>\s*", re.S)


# All points of a mark have the look of the first; then what a browser takes anyway, or nobody sees at lines of less than a pixel.
_SHORTER = (
    ("xlink:href", "href"),
    (r'(<g[^>]*)>(\s*<use [^>]*?) style="([^"]*)"', r'\1 style="\3">\2'),
    (r'(<use [^>]*?) style="[^"]*"', r"\1"),
    (
        r" font-family: [^;\"]*;| transform=\"rotate\(-0 [^\"]*\"|; stroke-linejoin: miter"
        r"|(?<=stroke-width: 0\.\d); stroke-linecap: square",
        "",
    ),
)


def _slim(svg: str, key: str) -> str:
    """Return a compact SVG for a page, with the colours of its style and unique ids."""
    box = re.search(r'viewBox="[^"]*"', svg)
    assert box is not None
    body = svg[svg.index(">", svg.index("<svg")) + 1 :]
    body = re.sub(r"<metadata>.*?</metadata>|<style .*?</style>|<!--.*?-->", "", body, flags=re.S)
    body = re.sub(r'<g id="[^"]*"', "<g", body)
    ids = {
        identifier: f"{key}-{count}"
        for count, identifier in enumerate(re.findall(r'id="([^"]*)"', body))
    }
    body = re.sub(r'(id="|#)([\w-]+)(?=["\)])', lambda at: at[1] + ids.get(at[2], at[2]), body)
    for pattern, new in _SHORTER:
        body = re.sub(pattern, new, body)
    # places of points to a tenth of a pixel, lines and what a point looks like to a hundredth
    body = re.sub(r"<use [^>]*>", lambda tag: re.sub(r"(\d\.\d)\d+", r"\1", tag[0]), body)
    others = r"<(?!image)[^>!]*>"
    body = re.sub(others, lambda tag: re.sub(r"(\d\.\d\d)\d+", r"\1", tag[0]), body)
    while (plain := re.sub(_PLAIN, r"\1", body)) != body:
        body = plain
    for color, name in _COLORS.items():
        body = body.replace(color, name)
    body = body.replace("; fill: var(--ink)", "")
    # lines of a grid end with it
    body = re.sub(r' clip-path="[^"]*"(?= style="fill: none; stroke: var\(--grid)', "", body)
    return f'<svg {box[0]} style="fill: var(--ink)" aria-hidden="true">' + re.sub(
        r"\s*\n\s*", "\n", body
    )
