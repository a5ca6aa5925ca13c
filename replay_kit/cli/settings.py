"""Settings as options with the names, values, defaults and help of ``RunConfig``, and the list of all keys."""

import json
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import Field, dataclass, field, fields, make_dataclass
from functools import partial
from operator import methodcaller
from pathlib import Path
from types import FunctionType
from typing import Annotated, Any, Literal, TypeVar, cast, get_args, get_origin

from cyclopts import Group, Parameter
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from replay_kit.cli.options import CHOICES, INPUTS, OUTPUTS, ConfigFile
from replay_kit.config.option import Numbers, Option
from replay_kit.config.run import RunConfig, load_config
from replay_kit.core.errors import ConfigError

_Command = TypeVar("_Command", bound=Callable[..., int])
_HEADINGS = {
    group.name: group for group in (INPUTS, OUTPUTS, CHOICES, Group("Settings", sort_key=4))
}


@dataclass(frozen=True)
class Settings:
    """Settings given as options.

    The class that ``takes_settings`` makes for a command has one field per setting, None if the option is not given, and the file of
    ``--config``. A field's metadata hold the path of its setting and the parser of the option's text.
    """

    @property
    def file(self) -> Path | None:
        """File of ``--config``; None without one."""
        return vars(self).get("config")

    def words(self) -> list[str]:
        """Return the command-line options that reproduce these settings, with the file."""
        found = [] if self.file is None else ["--config", str(self.file)]
        for entry, value in self._options():
            name, values = entry.metadata["option"], value if isinstance(value, list) else [value]
            found += [name if one is True else f"{name}={one}" for one in values]
        return found

    def load(self, **sections: Mapping[str, object]) -> RunConfig:
        """Return the settings: options over the file of ``--config`` over the defaults.

        Args:
            sections: Tables of settings from the command's own options; None means not given.

        Raises:
            ConfigError: The file or a value is wrong.
        """
        given: dict[str, Any] = {section: dict(values) for section, values in sections.items()}
        for entry, value in self._options():
            section, key = entry.metadata["path"].split(".")
            given.setdefault(section, {})[key] = entry.metadata["read"](value)
        return load_config(self.file, given)

    def _options(self) -> Iterator[tuple[Field[Any], Any]]:
        """Yield the options given, with their values."""
        values = vars(self)
        for entry in fields(self):
            if entry.metadata and values[entry.name] is not None:
                yield entry, values[entry.name]


def takes_settings(*paths: str, file: bool = True) -> Callable[[_Command], _Command]:
    """Return a decorator that adds options of settings to the parameter ``settings`` of a command.

    Args:
        paths: Sections such as ``forecast`` and settings such as ``estimator.modes``; only settings marked as options are added.
        file: Whether ``--config`` is added.
    """
    entries: list[tuple[str, Any, Any]] = (
        [("config", ConfigFile, field(default=None))] if file else []
    )
    for path, setting in every_setting():
        mark = next((part for part in setting.metadata if isinstance(part, Option)), None)
        if mark is not None and any(f"{path}.".startswith(f"{wanted}.") for wanted in paths):
            entries.append((path.replace(".", "__"), *_option_of(path, setting, mark)))
    # cyclopts takes a class without a module of its own for one of Python's, which it does not look into
    given = make_dataclass(
        "GivenSettings", entries, bases=(Settings,), frozen=True, namespace={"__module__": __name__}
    )

    def decorate(command: _Command) -> _Command:
        function = cast(FunctionType, command)
        function.__annotations__["settings"] = Annotated[given, Parameter(name="*")]
        function.__kwdefaults__ = {**(function.__kwdefaults__ or {}), "settings": given()}
        return command

    return decorate


def remapped(pairs: list[str], option: str = "--remap") -> dict[str, str]:
    """Return the values of options ``OLD=NEW``, old to new.

    Raises:
        ConfigError: A value is not such a pair, or an old name is repeated.
    """
    names = [pair.partition("=") for pair in pairs]
    if not all(old and new for old, _, new in names) or len({old for old, _, _ in names}) < len(
        names
    ):
        raise ConfigError(f"{option}: expected OLD=NEW, each old name once, got {' '.join(pairs)}")
    return {old: new for old, _, new in names}


def _option_of(path: str, setting: FieldInfo, mark: Option) -> tuple[Any, Any]:
    """Return the annotation of a setting's option, and its field with the parser of its value.

    Switches and words are checked with the option; other text is checked by the model of the settings, as a TOML file is.
    """
    name = mark.name or f"--{path.partition('.')[2].replace('_', '-')}"
    annotation: Any = setting.annotation
    kinds = [annotation, *get_args(annotation)]
    kind: Any = str
    read: Callable[[Any], object] = str
    if bool in kinds or get_origin(annotation) is Literal:
        kind, read = annotation, lambda value: value
    elif get_origin(annotation) is dict:
        kind, read = list[str], partial(remapped, option=name)
    elif mark.repeats:
        kind, read = list[str], list
    elif any(get_origin(kind) is tuple for kind in kinds):
        read = methodcaller("split", ",")
    default = setting.default
    shown = f" [default: {default}]" if isinstance(default, int | float | str) and default else ""
    parameter = Parameter(
        name=name,
        metavar=mark.metavar or ("NUMBER" if "float" in str(annotation) else None),
        allow_leading_hyphen=mark.metavar is not None,
        allow_repeating=True if annotation is bool else None,
        # the option's own default is that it is not given
        show_default=False,
        help=f"{setting.description}{shown}",
        group=_HEADINGS[mark.heading],
    )
    # the forms of numbers are checked with the option
    forms = [part for part in setting.metadata if isinstance(part, Numbers)]
    entry = field(default=None, metadata={"path": path, "option": name, "read": read})
    return Annotated[kind | None, parameter, *forms], entry


def every_setting(
    model: type[BaseModel] = RunConfig, prefix: str = ""
) -> Iterator[tuple[str, FieldInfo]]:
    """Yield each setting with its path, such as ``planner.depth``, in the order of the tables."""
    for name, setting in model.model_fields.items():
        kind = setting.annotation
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            yield from every_setting(kind, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", setting


def settings_named(name: str) -> list[tuple[str, str]]:
    """Return section and key of the settings with a name, which may include its section, as in ``planner.depth``."""
    wanted = name.replace("-", "_")
    paths = [path.rpartition(".") for path, _ in every_setting()]
    return [(section, key) for section, _, key in paths if wanted in (key, f"{section}.{key}")]


def annotated_toml(sections: Sequence[str] = ()) -> str:
    """Return the settings as TOML, with descriptions and commented defaults ready to be uncommented.

    Args:
        sections: Sections such as ``measurements.quality``; all when empty.

    Raises:
        ConfigError: There is no such section.
    """
    tables: dict[str, list[str]] = {}
    for path, setting in every_setting():
        section, _, key = path.rpartition(".")
        default = setting.get_default(call_default_factory=True)
        value = "" if default is None else json.dumps(default, default=str)
        about = textwrap.wrap(setting.description or "", 100, break_on_hyphens=False)
        tables.setdefault(section, []).extend(
            [*(f"# {line}" for line in about), f"#{key} = {value}"]
        )
    if unknown := [section for section in sections if section not in tables]:
        raise ConfigError(f"config: expected sections of {', '.join(tables)}, got {unknown[0]}")
    return "\n".join(
        "\n".join([f"[{section}]", *lines, ""])
        for section, lines in tables.items()
        if section in (sections or tables)
    )
