"""TOML files read as tables, the base model of a table of settings, and messages for invalid ones."""

import re
import reprlib
import tomllib
from collections import defaultdict
from collections.abc import Mapping
from difflib import get_close_matches
from inspect import cleandoc
from pathlib import Path
from typing import Annotated, Any, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from replay_kit.core.errors import ConfigError
from replay_kit.core.files.inputs import open_input
from replay_kit.core.words.quantities import parse_duration

# A configuration has some kB; tomllib takes a hundred times the memory of its file.
_LARGEST = 1 << 18


def read_toml(path: Path) -> dict[str, Any]:
    """Return the tables of a file.

    Raises:
        ConfigError: The file is missing, too large, or no TOML.
    """
    try:
        with open_input(path) as file:
            data = file.read(_LARGEST + 1)
    except OSError as error:
        raise ConfigError(f"{path}: cannot read the configuration: {error.strerror}") from error
    if len(data) > _LARGEST:
        raise ConfigError(
            f"{path}: expected a configuration of at most {_LARGEST} bytes; the right file?"
        )
    # tomllib lets through what Python says of numbers and nesting that are too long
    try:
        return tomllib.loads(data.decode("utf-8"))
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{path}: {_no_toml(error, data)}") from error


def _no_toml(error: ValueError | RecursionError, data: bytes) -> str:
    """Return why bytes are not TOML; for a duplicate key or table its name and line."""
    if place := re.fullmatch(
        r"Cannot (?:overwrite a value|declare .* twice) \(at line (\d+), column \d+\)", str(error)
    ):
        line = data.decode("utf-8").splitlines()[int(place[1]) - 1].strip()
        what = (
            f"the table {line}"
            if line.startswith("[")
            else f"the key '{line.partition('=')[0].strip()}'"
        )
        return f"line {place[1]}: {what} is repeated; keep one"
    if isinstance(error, RecursionError):
        return "not TOML: its values are nested too deeply"
    return f"not TOML: {str(error)[:200]}"


# Errors that are named one by one, and a value in them: a file may hold millions, or one that is nested a thousand deep.
_MOST = 20
_SHORT = reprlib.Repr()
(
    _SHORT.maxlevel,
    _SHORT.maxlist,
    _SHORT.maxdict,
    _SHORT.maxstring,
    _SHORT.maxother,
    _SHORT.maxlong,
) = 4, 20, 20, 200, 200, 200


def explain(
    error: ValidationError, model: type[BaseModel], path: Path | None, options: Mapping[str, Any]
) -> str:
    """Return the message for an invalid configuration: each key with its value, and the known keys for an unknown one.

    Args:
        error: Error of the validation.
        model: Model validated against.
        path: The file; None without one.
        options: Tables of option values, which override the file; None means not given.
    """
    found: dict[str, list[str]] = defaultdict(list)
    errors = error.errors()
    for item in errors[:_MOST]:
        key = ".".join(str(part)[: _SHORT.maxstring] for part in item["loc"])
        if item["type"] == "extra_forbidden":
            known = sorted(_known_keys(model, item["loc"][:-1]))
            nearest = get_close_matches(str(item["loc"][-1])[: _SHORT.maxstring], known, 1)
            meant = f"; did you mean {nearest[0]}?" if nearest else ""
            line = f"unknown key '{key}'; known here: {', '.join(known)}{meant}"
        else:
            said, got = item["msg"].removeprefix("Value error, "), _SHORT.repr(item["input"])
            line = f"'{key}': {said}"
            # of a whole table the error names what it is of
            if not (said.startswith(got) or isinstance(item["input"], Mapping)):
                line += f", got {got}"
        found["options" if path is None or _is_given(options, item["loc"]) else str(path)].append(
            line
        )
    more = [f"and {len(errors) - _MOST} more"] if len(errors) > _MOST else []
    return "; ".join([*(f"{origin}: {'; '.join(lines)}" for origin, lines in found.items()), *more])


def _is_given(options: Mapping[str, Any], location: tuple[int | str, ...]) -> bool:
    """Return whether a value at a location, or below it, was given as an option."""
    value: Any = options
    for part in location:
        if not isinstance(value, Mapping):
            break
        value = value.get(str(part))
    return (
        any(part is not None for part in value.values())
        if isinstance(value, Mapping)
        else value is not None
    )


def _known_keys(model: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    """Return the known keys at a location: those of a section, or of a list entry of stated kind."""
    for part in location:
        if part in model.model_fields:
            kinds = _models_in(model.model_fields[str(part)].annotation)
            model = next((kind for kind in kinds if _is_kind(kind, location)), model)
    return list(model.model_fields)


def _models_in(annotation: Any) -> list[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return [annotation]
    return [model for argument in get_args(annotation) for model in _models_in(argument)]


def _is_kind(model: type[BaseModel], location: tuple[int | str, ...]) -> bool:
    """Return whether a location in the configuration refers to a model: pydantic includes the kind of an entry in it."""
    kinds = get_args(model.model_fields["kind"].annotation) if "kind" in model.model_fields else ()
    return len(kinds) != 1 or kinds[0] in location


_UNIT = re.compile(r"\[(s|min|h|d)\]")
_DURATION = re.compile(r"\s*\d+(\.\d*)?\s*(s|min|h|d)\s*")


def in_unit(value: object, description: str) -> object:
    """Return a duration, such as 36h, in the unit that a description states in brackets; other values unchanged."""
    unit = _UNIT.search(description)
    if unit and isinstance(value, str) and _DURATION.fullmatch(value):
        return parse_duration(value) / parse_duration(f"1{unit[1]}")
    return value


_DESCRIBED = re.compile(r"^ {4}(\w+): (.*(?:\n {8}.*)*)", re.MULTILINE)
#: Numbers above 0, from 0 on, and whole numbers from 1 on.
Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]
Count = Annotated[int, Field(ge=1)]


class Section(BaseModel):
    """Table of settings, described by its docstring."""

    # built when first used: a command's help needs the fields alone
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False, defer_build=True)

    @classmethod
    def __pydantic_init_subclass__(cls, **_: Any) -> None:
        """Set the description of each setting."""
        # Python 3.13 takes the indentation away
        for name, text in _DESCRIBED.findall(cleandoc(cls.__doc__ or "")):
            cls.model_fields[name].description = " ".join(text.split())

    @model_validator(mode="before")
    @classmethod
    def _in_units(cls, given: object) -> object:
        """Return settings with durations, such as 36h, in the units that their descriptions state."""
        if not isinstance(given, dict):
            return given
        return {name: cls._in_unit(name, value) for name, value in given.items()}

    @classmethod
    def _in_unit(cls, name: str, value: object) -> object:
        setting = cls.model_fields.get(name)
        return in_unit(value, setting.description or "") if setting else value

    def __str__(self) -> str:
        """Return the ``repr``."""
        return repr(self)

    def __repr_args__(self) -> list[tuple[str | None, Any]]:
        """Return the settings that differ from the defaults: a whole configuration has some two hundred."""
        defaults = {
            name: field.get_default(call_default_factory=True)
            for name, field in type(self).model_fields.items()
        }
        return [
            (name, getattr(self, name))
            for name in defaults
            if getattr(self, name) != defaults[name]
        ]
