"""The numbers of a payload by the paths of ``[[measurements.map]]``, and the lines of a profile guessed from them."""

import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from replay_kit.logs.tables.columns import number

_DEEPEST = 12
Pattern = re.Pattern[str]


class Leaf(NamedTuple):
    """A number, a list of numbers or a list of lists of numbers.

    Attributes:
        path: Where it stands.
        name: Its last field name, in lower case.
        shape: () for a number, (n,) for a list, (n, m) for n lists of which the first has m.
        values: The numbers in one row; NaN for what is missing.
    """

    path: str
    name: str
    shape: tuple[int, ...]
    values: tuple[float, ...]

    @property
    def parent(self) -> str:
        """The path of what holds it."""
        return self.path.rpartition(".")[0]


def leaves(value: Any, path: str = "") -> Iterator[Leaf]:
    """Yield the numbers of a payload, in its order; texts, flags and what no path can name are left out."""
    if isinstance(value, Mapping) and path.count(".") < _DEEPEST - 1:
        for key, item in value.items():
            if isinstance(key, str) and key and "." not in key and key == key.strip():
                yield from leaves(item, f"{path}.{key}" if path else key)
    elif _is_number(value):
        yield _leaf(path, (), [value])
    elif isinstance(value, list | tuple) and value:
        yield from _in_list(value, path)


def _in_list(items: Sequence[Any], path: str) -> Iterator[Leaf]:
    n = len(items)
    if all(isinstance(item, Mapping) for item in items):
        # every item is taken to be like the first
        within = [{leaf.path: leaf for leaf in leaves(item)} for item in items]
        for inner in within[0].values():
            if len(inner.shape) < 2 and all(inner.path in found for found in within):
                values = [value for found in within for value in found[inner.path].values]
                yield _leaf(f"{path}.*.{inner.path}", (n, *inner.shape), values)
    elif _is_row(items):
        yield _leaf(path, (n,), items)
    else:
        rows = [item for item in items if item is not None]
        if all(isinstance(row, list | tuple) and row and _is_row(row) for row in rows):
            yield _leaf(path, (n, len(rows[0])), [value for row in rows for value in row])


def _leaf(path: str, shape: tuple[int, ...], values: Sequence[Any]) -> Leaf:
    name = path.removesuffix(".*").rpartition(".")[2].lower()
    return Leaf(path, name, shape, tuple(map(number, values)))


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_row(items: Sequence[Any]) -> bool:
    return all(item is None or _is_number(item) for item in items)


_EAST = re.compile(
    r"(.*_)?(east|eastward|u|ve|vel_e|vel_east|east_vel|velocity_east|east_velocity)"
)
_NORTH = re.compile(
    r"(.*_)?(north|northward|v|vn|vel_n|vel_north|north_vel|velocity_north|north_velocity)"
)
_TWIST = re.compile(r".*linear\.x"), re.compile("y")
_VELOCITY = re.compile(r"(.*_)?(vel|velocity|velocities|current|currents|vel_data|velocity_data)")
_DEPTHS = re.compile(r"(.*_)?(cell_|bin_)?depths?")
_DISTANCES = re.compile(r"(.*_)?(distances?|ranges?|cell_positions?)")
_CELL_SIZE = re.compile(r"(.*_)?(cell|bin)_?(size|length|height|depth)")
_FIRST_CELL = re.compile(
    r"(.*_)?(bin0_?distance|bin1_?distance|first_?(cell|bin)(_?distance)?)|(.*_)?blanking(_?distance)?"
)
_COUNT = re.compile(r"(.*_)?(n|num|number_of|no_of)?_?(cells|bins)")
# a flat list this short is one velocity, not a profile
_SHORTEST_FLAT = 6
_MISSING = (-32768.0, -9999.0, 9999.0, -999.0)
#: Why a suggestion leaves open what a velocity is relative to.
NO_REFERENCE = "NOT KNOWN from the message, so it is not used yet: earth if the vehicle's motion is removed, else platform"
# no current in m/s is as fast
_NO_MPS = 20.0


def named(found: Iterable[Leaf], name: Pattern, shape: tuple[int, ...] = ()) -> Leaf | None:
    """Return the first leaf of a shape whose name fits; None without any."""
    return next((leaf for leaf in found if leaf.shape == shape and name.fullmatch(leaf.name)), None)


def pair(
    found: Sequence[Leaf], first: Pattern, second: Pattern, dimensions: int = 0
) -> tuple[Leaf, Leaf] | None:
    """Return the first two leaves of one shape and one part of the message whose names fit; None without any."""
    for one in found:
        if len(one.shape) == dimensions and (
            first.fullmatch(one.name) or first.fullmatch(one.path)
        ):
            beside = [leaf for leaf in found if leaf.parent == one.parent]
            if other := named(beside, second, one.shape):
                return one, other
    return None


def line(key: str, value: object, why: str) -> str:
    """Return one line of an entry with its comment."""
    return f"{key} = {json.dumps(value, ensure_ascii=False)}  # {why}"


def by_name(**found: Leaf) -> list[str]:
    """Return a line for each leaf that was found by its name."""
    return [line(key, leaf.path, "by its name") for key, leaf in found.items()]


def profile_lines(found: Sequence[Leaf]) -> list[str]:
    """Return the lines of a profile entry; none when no list looks like velocities."""
    for lines, n_cells, values in _velocities(found):
        return [
            line("reference", "unknown", NO_REFERENCE),
            line("frame", "enu", "NOT KNOWN from the message: enu, ned, ship, instrument or beam"),
            *lines,
            *speed_lines(values),
            *geometry_lines(found, n_cells),
        ]
    return []


def _velocities(found: Sequence[Leaf]) -> Iterator[tuple[list[str], int, tuple[float, ...]]]:
    """Yield what may be the velocities of a profile, the likeliest first: their lines, number of cells, and numbers."""
    if columns := pair(found, _EAST, _NORTH, 1):
        east, north = columns
        yield by_name(east=east, north=north), east.shape[0], east.values + north.values
    lists = [leaf for leaf in found if leaf.shape and _VELOCITY.fullmatch(leaf.name)]
    for leaf in lists:
        n, *width = leaf.shape
        if width and width[0] >= 2:
            why = f"by its name: {n} cells of {width[0]} numbers"
            yield [line("velocity", leaf.path, why)], n, leaf.values
    for leaf in lists:
        n, *width = leaf.shape
        if width or n < _SHORTEST_FLAT:
            continue
        counts = [c.values[0] for c in found if c.shape == () and _COUNT.fullmatch(c.name)]
        fitting = [int(c) for c in counts if c >= 1.0 and n % int(c) == 0 and n // int(c) >= 2]
        components = n // fitting[0] if fitting else 3 if n % 3 == 0 else 2
        why = "from the number of cells" if fitting else "NOT KNOWN from the message"
        lines = [
            line("velocity", leaf.path, f"by its name: {n} numbers"),
            line("components", components, why),
        ]
        yield lines, n // components, leaf.values


def speed_lines(values: Sequence[float]) -> list[str]:
    """Return the lines of the unit of velocities, and of numbers that stand for none."""
    missing = sorted({value for value in values if value in _MISSING})
    known = [value for value in values if math.isfinite(value) and value not in _MISSING]
    whole = any(known) and all(value.is_integer() for value in known)
    fast = max((abs(value) for value in known), default=0.0)
    unit = "mm/s" if whole or fast > _NO_MPS else "m/s"
    why = f"up to {fast:g}{', whole numbers' if whole else ''}; check it"
    stand_in = [line("missing", missing, "these stand for no velocity")] if missing else []
    return [line("speed_unit", unit, why), *stand_in]


def geometry_lines(found: Sequence[Leaf], n_cells: int) -> list[str]:
    """Return the lines of where the cells of a profile are, by the numbers beside it."""
    for key, pattern in (("depths", _DEPTHS), ("distances", _DISTANCES)):
        if (listed := named(found, pattern, (n_cells,))) is not None:
            lines, least = by_name(**{key: listed}), min(listed.values)
            if key == "depths" and least < 0.0:
                lines.append(line("depth_positive", "up", f"{least:g}: negative below the surface"))
            return lines
    lines = []
    for key, pattern in (("cell_size", _CELL_SIZE), ("first_cell", _FIRST_CELL)):
        leaf = named(found, pattern)
        why = "NOT FOUND in the message: state the instrument's, in m"
        if leaf is not None and "blanking" in leaf.name:
            why = f"{leaf.values[0]:g}; blanking ends where the first cell begins: state half a cell more"
        elif leaf is not None:
            why = f"by its name: {leaf.values[0]:g} m"
        lines.append(line(key, 1.0 if leaf is None else leaf.path, why))
    return lines


def velocity_lines(scalars: Sequence[Leaf]) -> list[str]:
    """Return the lines of a velocity at one depth; none when no two numbers look like its components."""
    found, twist = pair(scalars, _EAST, _NORTH), pair(scalars, *_TWIST)
    east, north = found or twist or (None, None)
    if east is None or north is None:
        return []
    lines = by_name(east=east, north=north)
    if not found:
        why = "a twist's {}: {} only if its frame is east, north, up"
        lines = [
            line("east", east.path, why.format("x", "east")),
            line("north", north.path, why.format("y", "north")),
        ]
    reference = line("reference", "unknown", NO_REFERENCE)
    return [reference, *lines, *speed_lines(east.values + north.values)]
