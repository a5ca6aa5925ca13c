"""The numbers of a payload by the paths of ``[[measurements.map]]``, and the lines of a profile guessed from them."""

import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from replay_kit.logs.tables.columns import number

_DEEPEST = 12


@dataclass(frozen=True, slots=True)
class Leaf:
    """A number, a list of numbers or a list of lists of numbers.

    Attributes:
        path: Where it stands.
        name: Its last field name, in lower case.
        parent: The path of what holds it.
        shape: () for a number, (n,) for a list, (n, m) for n lists of which the first has m.
        values: The numbers in one row; NaN for what is missing.
    """

    path: str
    name: str
    parent: str
    shape: tuple[int, ...]
    values: tuple[float, ...]


def leaves(payload: Mapping[str, Any]) -> list[Leaf]:
    """Return the numbers of a payload, in its order; texts, flags and what no path can name are left out."""
    return list(_walk(payload, ()))


def _walk(value: Any, path: tuple[str, ...]) -> Iterator[Leaf]:
    if isinstance(value, Mapping):
        if len(path) < _DEEPEST:
            for key, item in value.items():
                if isinstance(key, str) and key and "." not in key and key == key.strip():
                    yield from _walk(item, (*path, key))
    elif _is_number(value):
        yield _leaf(path, (), [value])
    elif isinstance(value, list | tuple) and value:
        yield from _walk_list(value, path)


def _walk_list(items: Sequence[Any], path: tuple[str, ...]) -> Iterator[Leaf]:
    if all(isinstance(item, Mapping) for item in items):
        # every item is taken to be like the first
        within = [{leaf.path: leaf for leaf in _walk(item, ())} for item in items]
        for inner in within[0].values():
            if len(inner.shape) < 2 and all(inner.path in found for found in within):
                values = [value for found in within for value in found[inner.path].values]
                yield _leaf(
                    (*path, "*", *inner.path.split(".")), (len(items), *inner.shape), values
                )
    elif all(item is None or _is_number(item) for item in items):
        yield _leaf(path, (len(items),), items)
    elif all(item is None or _is_row(item) for item in items):
        rows = [item for item in items if item is not None]
        yield _leaf(path, (len(items), len(rows[0])), [value for row in rows for value in row])


def _leaf(path: tuple[str, ...], shape: tuple[int, ...], values: Sequence[Any]) -> Leaf:
    names = [part for part in path if part != "*"]
    return Leaf(
        ".".join(path),
        names[-1].lower() if names else "",
        ".".join(path[:-1]),
        shape,
        tuple(number(v) for v in values),
    )


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _is_row(value: Any) -> bool:
    return (
        isinstance(value, list | tuple)
        and len(value) > 0
        and all(item is None or _is_number(item) for item in value)
    )


_EAST = re.compile(
    r"(.*_)?(east|eastward|u|ve|vel_e|vel_east|east_vel|velocity_east|east_velocity)"
)
_NORTH = re.compile(
    r"(.*_)?(north|northward|v|vn|vel_n|vel_north|north_vel|velocity_north|north_velocity)"
)
_TWIST_NORTH = re.compile("y")
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


def named(found: Sequence[Leaf], name: re.Pattern[str], shape: tuple[int, ...] = ()) -> Leaf | None:
    """Return the first leaf of a shape whose name fits; None without any."""
    return next((leaf for leaf in found if leaf.shape == shape and name.fullmatch(leaf.name)), None)


def beside(one: Leaf, found: Sequence[Leaf], name: re.Pattern[str]) -> Leaf | None:
    """Return the first leaf of a leaf's shape that the same part of the message holds and whose name fits; None without any."""
    return named([leaf for leaf in found if leaf.parent == one.parent], name, one.shape)


def line(key: str, value: object, why: str) -> str:
    """Return one line of an entry with its comment."""
    return f"{key} = {json.dumps(value, ensure_ascii=False)}  # {why}"


def profile_lines(found: Sequence[Leaf]) -> list[str]:
    """Return the lines of a profile entry; none when no list looks like velocities."""
    velocity = _columns(found) or _matrix(found) or _flat(found)
    if velocity is None:
        return []
    lines, n_cells, values = velocity
    return [
        line("reference", "unknown", NO_REFERENCE),
        line("frame", "enu", "NOT KNOWN from the message: enu, ned, ship, instrument or beam"),
        *lines,
        *speed_lines(values),
        *geometry_lines(found, n_cells),
    ]


def _columns(found: Sequence[Leaf]) -> tuple[list[str], int, tuple[float, ...]] | None:
    for east in found:
        if (
            len(east.shape) == 1
            and _EAST.fullmatch(east.name)
            and (north := beside(east, found, _NORTH))
        ):
            lines = [
                line("east", east.path, "by its name"),
                line("north", north.path, "by its name"),
            ]
            return lines, east.shape[0], east.values + north.values
    return None


def _matrix(found: Sequence[Leaf]) -> tuple[list[str], int, tuple[float, ...]] | None:
    for leaf in found:
        if len(leaf.shape) == 2 and leaf.shape[1] >= 2 and _VELOCITY.fullmatch(leaf.name):
            why = f"by its name: {leaf.shape[0]} cells of {leaf.shape[1]} numbers"
            return [line("velocity", leaf.path, why)], leaf.shape[0], leaf.values
    return None


def _flat(found: Sequence[Leaf]) -> tuple[list[str], int, tuple[float, ...]] | None:
    for leaf in found:
        n = leaf.shape[0] if len(leaf.shape) == 1 else 0
        if n >= _SHORTEST_FLAT and _VELOCITY.fullmatch(leaf.name):
            counts = (
                int(c.values[0])
                for c in found
                if c.shape == () and _COUNT.fullmatch(c.name) and c.values[0] >= 1.0
            )
            n_cells = next((c for c in counts if n % c == 0 and n // c >= 2), 0)
            components = n // n_cells if n_cells else (3 if n % 3 == 0 else 2)
            why = "from the number of cells" if n_cells else "NOT KNOWN from the message"
            lines = [
                line("velocity", leaf.path, f"by its name: {n} numbers"),
                line("components", components, why),
            ]
            return lines, n_cells or n // components, leaf.values
    return None


def speed_lines(values: Sequence[float]) -> list[str]:
    """Return the lines of the unit of velocities, and of numbers that stand for none."""
    missing = sorted({value for value in values if value in _MISSING})
    known = [value for value in values if math.isfinite(value) and value not in _MISSING]
    whole = any(known) and all(value.is_integer() for value in known)
    fast = max((abs(value) for value in known), default=0.0)
    in_mm = whole or fast > _NO_MPS
    lines = [
        line(
            "speed_unit",
            "mm/s" if in_mm else "m/s",
            f"up to {fast:g}{', whole numbers' if whole else ''}; check it",
        )
    ]
    return [*lines, line("missing", missing, "these stand for no velocity")] if missing else lines


def geometry_lines(found: Sequence[Leaf], n_cells: int) -> list[str]:
    """Return the lines of where the cells of a profile are, by the numbers beside it."""
    for key, pattern in (("depths", _DEPTHS), ("distances", _DISTANCES)):
        if (listed := named(found, pattern, (n_cells,))) is not None:
            lines, least = [line(key, listed.path, "by its name")], min(listed.values)
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
    for east in scalars:
        twist = east.path.endswith("linear.x")
        if not (_EAST.fullmatch(east.name) or twist):
            continue
        if (north := beside(east, scalars, _TWIST_NORTH if twist else _NORTH)) is not None:
            why = (
                "a twist's x: east only if its frame is east, north, up" if twist else "by its name"
            )
            return [
                line("reference", "unknown", NO_REFERENCE),
                line("east", east.path, why),
                line("north", north.path, why.replace("x: east", "y: north")),
                *speed_lines(east.values + north.values),
            ]
    return []
