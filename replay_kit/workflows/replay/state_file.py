"""State file of a run: a sealed pickle, written completely or not at all.

A pickle may name any function to be called. Reading is restricted to the values of this program (data classes, named tuples and
enumerations) and to the arrays of NumPy; any other name is refused.
"""

import pickle
from dataclasses import is_dataclass
from enum import Enum
from io import BytesIO
from pathlib import Path
from typing import Any

from replay_kit.core.errors import LogError
from replay_kit.core.files.atomic import sealed, unsealed, write_whole
from replay_kit.core.files.inputs import open_input

# First line of the file; the number is that of the form.
_KIND, _FORM = b"replay-kit state ", b"17\n"
_ARRAYS = frozenset({"_reconstruct", "_frombuffer", "scalar", "dtype", "ndarray"})


class StateError(LogError):
    """Error: a state is unusable, and the run restarts."""


def write_state(path: Path, run: str, value: Any) -> None:
    """Write the state of a run, completely or not at all.

    Args:
        path: The file; an existing one is replaced.
        run: Identity of the run.
        value: State.

    Raises:
        ConfigError, ReplayKitError: See ``atomic_file``.
    """
    write_whole(path, sealed(_KIND + _FORM + pickle.dumps((run, value), protocol=5)))


def read_state(path: Path, run: str) -> Any:
    """Return the state of a run written by ``write_state``.

    Raises:
        LogError: The file was not written by this program.
        StateError: It is of another run or version, truncated or damaged.
    """
    try:
        with open_input(path) as file:
            if file.read(len(_KIND)) != _KIND:
                raise LogError(f"{path}: exists and is not the state of a run; choose another name")
            content = unsealed(_KIND + file.read())
        if content is None or not content.startswith(_KIND + _FORM):
            raise ValueError("it is incomplete, or of another version")
        of, value = _OwnValues(BytesIO(content[len(_KIND + _FORM) :])).load()
    except OSError as error:
        raise LogError(f"{path}: the state of a run cannot be read: {error.strerror}") from error
    except (
        *(ValueError, LookupError, TypeError, AttributeError, ImportError),
        *(pickle.UnpicklingError, EOFError, MemoryError, OverflowError),
    ) as error:
        raise unusable(path, str(error)) from error
    if of != run:
        raise unusable(path, "it is of another run: inputs, options, versions or settings differ")
    return value


def unusable(path: Path, why: str) -> StateError:
    """Return the error for an unusable state, with the reason."""
    return StateError(f"{path}: the run cannot resume from it: {' '.join(why.split())[:200]}")


class _OwnValues(pickle.Unpickler):
    """Reader of pickles that hold only values of this program and arrays."""

    def find_class(self, module: str, name: str) -> Any:
        """Return a class of values, or what makes an array; all other names are refused."""
        package = module.partition(".")[0]
        if package in ("replay_kit", "planners", "numpy") and "." not in name:
            found = super().find_class(module, name)
            if package == "numpy" and name in _ARRAYS:
                return found
            # what a module merely imports may be anything
            if isinstance(found, type) and found.__module__ == module and _is_value(found):
                return found
        raise pickle.UnpicklingError(
            f"it holds {module}.{name}, which is not a value of this program"
        )


def _is_value(kind: type) -> bool:
    return is_dataclass(kind) or issubclass(kind, tuple | Enum)
