"""This project's frozen values and arrays as bytes, and back; nothing whose construction has side effects is loaded."""

import pickle
import pickletools
from collections.abc import Callable, Iterable
from dataclasses import is_dataclass
from enum import Enum
from typing import Any, BinaryIO

from pydantic import BaseModel
from scipy.sparse import sparray, spmatrix

# The functions and classes of other libraries that a pickle of these values may name; nothing else is loaded.
_FUNCTIONS = {
    ("numpy._core.multiarray", "_reconstruct"),
    ("numpy._core.multiarray", "scalar"),
    ("numpy._core.numeric", "_frombuffer"),
}
_CLASSES = {("numpy", "ndarray"), ("numpy", "dtype"), ("builtins", "float"), ("builtins", "slice")}
# Opcodes that the dumper never writes: a place in the memo takes memory for all places before it.
_FOREIGN = frozenset(
    {"PUT", "BINPUT", "LONG_BINPUT", "EXT1", "EXT2", "EXT4", "INST", "OBJ", "GLOBAL"}
)


def dump(
    value: object,
    file: BinaryIO,
    on_array: Callable[[pickle.PickleBuffer], Any] | None = None,
) -> None:
    """Write a value to a file.

    Args:
        value: Of this project's classes, and arrays.
        file: Where to.
        on_array: Takes the contents of contiguous arrays, which are then not written; None writes them.
    """
    pickle.Pickler(file, protocol=5, buffer_callback=on_array).dump(value)


def load(file: BinaryIO, arrays: Iterable[object] = ()) -> Any:
    """Return the value that ``dump`` wrote.

    Args:
        file: Where from.
        arrays: Contents of the arrays that were not written, in their order.

    Raises:
        Exception: Of any kind, on bytes that are not its own: pickle states no end to what it raises.
    """
    return _Loader(file, buffers=arrays).load()


def check_opcodes(body: bytes) -> None:
    """Raise ValueError when the bytes of a value, arrays included, would take memory that they do not fill."""
    foreign = next(
        (
            opcode.name
            for opcode, _, _ in pickletools.genops(body)
            if opcode.name in _FOREIGN | {"NEXT_BUFFER"}
        ),
        None,
    )
    if foreign is not None:
        raise ValueError(f"it holds {foreign}, which no checkpoint does")


def _is_value(kind: type[Any]) -> bool:
    """Return whether constructing an object of a class does no more than hold values."""
    return (
        is_dataclass(kind)
        or issubclass(kind, (Enum, tuple, BaseModel))
        or issubclass(kind, (sparray, spmatrix))
    )


class _Loader(pickle.Unpickler):
    """Loads this project's values and arrays; nothing whose construction has side effects."""

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) in _FUNCTIONS | _CLASSES:
            return super().find_class(module, name)
        if module.startswith(("replay_kit.", "planners.", "scipy.sparse.")) and "." not in name:
            found = super().find_class(module, name)
            if isinstance(found, type) and found.__module__ == module and _is_value(found):
                return found
        raise pickle.UnpicklingError(
            f"it holds {module}.{name}, which no value of this program does"
        )
