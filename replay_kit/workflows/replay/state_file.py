"""State file of a run: one npz, written completely or not at all; reading it creates only values of this program.

Frozen values, tuples, mappings and numbers form a JSON tree. Their arrays are concatenated in one member per type, each stored once; zeros
of real arrays, as above the diagonal of a covariance, are omitted by a mask. Only plain data classes of this program are stored; they are
restored without a call. No member takes more memory than its bytes, except the mask, with one number per bit.
"""

import importlib
import json
import math
import struct
import zipfile
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from replay_kit.core.errors import LogError
from replay_kit.core.files.atomic import atomic_file
from replay_kit.core.files.inputs import open_input

# The first member: the version of the form is in its name, which lies after the fixed part of its entry.
_TREE, _ENTRY = "replay-kit state 15", 30
_REAL, _MASK = "<f8", "nonzero"
_PLAIN = (type(None), bool, int, float, str)


class StateError(LogError):
    """Error: a state is unusable, and the run restarts."""


def write_state(path: Path, run: str, value: Any) -> None:
    """Write the state of a run, completely or not at all.

    Args:
        path: The file; an existing one is replaced.
        run: Identity of the run.
        value: State.

    Raises:
        TypeError: The state has an unsupported type.
        ConfigError, ReplayKitError: See ``atomic_file``.
    """
    packed = _Packed()
    tree = json.dumps([run, packed.tree(value)]).encode()
    members: Any = {_TREE: np.frombuffer(tree, np.uint8), **packed.members()}
    with atomic_file(path) as file:
        np.savez(file, allow_pickle=False, **members)


def read_state(path: Path, run: str) -> Any:
    """Return the state of a run written by ``write_state``.

    Raises:
        LogError: The file was not written by this program.
        StateError: It is of another run or version, truncated or damaged.
    """
    try:
        file = open_input(path)
    except OSError as error:
        raise LogError(f"{path}: the state of a run cannot be read: {error.strerror}") from error
    try:
        with file:
            if _TREE[:16].encode() not in file.read(_ENTRY + 16)[_ENTRY:]:
                raise LogError(f"{path}: exists and is not the state of a run; choose another name")
            members = _members(file, path.stat().st_size)
        of, tree = json.loads(members.pop(_TREE).tobytes())
        if of == run:
            return _value(tree, members)
    except (
        *(OSError, ValueError, LookupError, TypeError, AttributeError, ImportError),
        *(RuntimeError, MemoryError, EOFError, struct.error, zipfile.BadZipFile),
    ) as error:
        raise unusable(path, repr(error)) from error
    raise unusable(path, "it is of another run: inputs, options, versions or settings differ")


def unusable(path: Path, why: str) -> StateError:
    """Return the error for an unusable state, with the reason."""
    return StateError(f"{path}: the run cannot resume from it: {' '.join(why.split())[:200]}")


def _members(file: Any, size: int) -> dict[str, Any]:
    """Return the flat arrays of an npz of given size, with the zeros of real numbers restored."""
    found: dict[str, Any] = {}
    with zipfile.ZipFile(file) as archive:
        entries = archive.infolist()
        if sum(entry.file_size for entry in entries) > size or any(
            e.compress_type for e in entries
        ):
            raise ValueError("its members are packed, or larger than the file")
        for entry in entries:
            data = archive.read(entry)
            at = BytesIO(data)
            np.lib.format.read_magic(at)
            _, _, kind = np.lib.format.read_array_header_1_0(at)
            # a copy may be written to
            array = np.frombuffer(data, kind, offset=at.tell()).copy()
            found[entry.filename.removesuffix(".npy")] = array
    held = np.unpackbits(found[_MASK]).astype(bool)
    real = np.zeros(held.size)
    real[held] = found[_REAL]
    return found | {_REAL: real}


class _Packed:
    """Arrays of a value, collected for storage; mutable."""

    def __init__(self) -> None:
        self._parts: dict[str, list[Any]] = {_REAL: [np.zeros(0)]}
        self._ends: dict[str, int] = {}
        self._known: dict[tuple[Any, ...], list[Any]] = {}

    def members(self) -> dict[str, Any]:
        """Return the arrays of the file."""
        found: dict[str, Any] = {kind: np.concatenate(of) for kind, of in self._parts.items()}
        # by their bits, as -0.0 is a number too
        held = found[_REAL].view(np.int64) != 0
        return found | {_REAL: found[_REAL][held], _MASK: np.packbits(held)}

    def tree(self, value: Any) -> Any:
        """Return a value as JSON, with references to its arrays."""
        kind = type(value)
        if kind in _PLAIN:
            return value
        if kind is tuple:
            return list(map(self.tree, value))
        if kind is bytes:
            return {"bytes": value.hex()}
        if kind is frozenset:
            return {"set": list(map(self.tree, value))}
        if isinstance(value, Mapping):
            return {"mapping": [[self.tree(key), self.tree(each)] for key, each in value.items()]}
        if isinstance(value, np.ndarray | np.generic):
            array = np.asarray(value)
            if array.dtype.hasobject:
                return {"objects": [list(array.shape), list(map(self.tree, array.flat))]}
            return {"array": self._placed(array)}
        held = (
            value.name
            if isinstance(value, Enum)
            else [self.tree(getattr(value, name)) for name in _names(kind)]
        )
        return {f"{kind.__module__}:{kind.__name__}": held}

    def _placed(self, array: Any) -> list[Any]:
        """Return type, start, shape and order of an array among those of its type."""
        order, kind = "F" if array.flags.fnc else "C", array.dtype.str
        flat = array.ravel(order)
        key = order, kind, array.shape, flat.tobytes()
        if key not in self._known:
            start = self._ends.get(kind, 0)
            self._known[key] = [kind, start, list(array.shape), order]
            self._ends[kind] = start + flat.size
            self._parts.setdefault(kind, []).append(flat)
        return self._known[key]


def _value(tree: Any, members: Mapping[str, Any]) -> Any:
    """Return the value of a tree and its arrays, without calling constructors or methods of classes."""
    if isinstance(tree, list):
        return tuple(_value(each, members) for each in tree)
    if not isinstance(tree, dict):
        return tree
    ((name, held),) = tree.items()
    if name == "bytes":
        return bytes.fromhex(held)
    if name == "set":
        return frozenset(_value(held, members))
    if name == "mapping":
        return {_value(key, members): _value(each, members) for key, each in held}
    if name == "objects":
        shape, each = held
        return np.fromiter(_value(each, members), object, len(each)).reshape(shape)
    if name == "array":
        kind, start, shape, order = held
        flat = members[kind][slice(start, start + math.prod(shape))]
        return flat.reshape(shape, order=order)[()]
    kind = _class(name)
    if issubclass(kind, Enum):
        return kind[held]
    own = dict(zip(_names(kind), _value(held, members), strict=True))
    if issubclass(kind, tuple):
        return tuple.__new__(kind, own.values())
    made = object.__new__(kind)
    for field, each in own.items():
        object.__setattr__(made, field, each)
    return made


def _names(kind: Any) -> tuple[str, ...]:
    """Return the field names of a class of this program; TypeError for unsupported classes."""
    own = kind.__module__.startswith(("replay_kit.", "planners."))
    if own and is_dataclass(kind):
        return tuple(each.name for each in fields(kind))
    if own and issubclass(kind, tuple):
        return tuple(kind._fields)
    raise TypeError(
        f"it holds {kind.__module__}.{kind.__name__}, which is not a value of this program"
    )


def _class(name: str) -> Any:
    """Return the class with a name."""
    module, _, own = name.partition(":")
    if not module.startswith(("replay_kit.", "planners.")) or "__" in name:
        raise TypeError(f"it holds {name}, which is not a value of this program")
    found = getattr(importlib.import_module(module), own)
    if not isinstance(found, type) or found.__module__ != module:
        raise TypeError(f"it holds {name}, which is not a value of this program")
    return found
