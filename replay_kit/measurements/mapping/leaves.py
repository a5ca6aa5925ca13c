"""What numbers a payload holds and where: the paths that ``[[measurements.map]]`` understands."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from replay_kit.measurements.messages.fields import number

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
