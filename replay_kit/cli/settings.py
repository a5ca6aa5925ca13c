"""Options made from the settings: names, permitted values, defaults and help are those of ``RunConfig``."""

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field, fields, make_dataclass
from functools import reduce
from pathlib import Path
from types import FunctionType, NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, cast, get_args, get_origin

from cyclopts import Group, Parameter
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from replay_kit.cli.options import CHOICES, INPUTS, OUTPUTS, ConfigFile
from replay_kit.config.option import Numbers, Option
from replay_kit.config.run import RunConfig, load_config
from replay_kit.core.errors import ConfigError

_Mark = TypeVar("_Mark")
_Command = TypeVar("_Command", bound=Callable[..., int])
_HEADINGS = {
    group.name: group for group in (INPUTS, OUTPUTS, CHOICES, Group("Settings", sort_key=4))
}


@dataclass(frozen=True)
class Settings:
    """Settings given as options.

    The class that ``takes_settings`` makes for a command has one field for each setting, None when its option is not given, and the file of
    ``--config``. A field's metadata hold the path of its setting and the function that reads the option's text.
    """

    @property
    def file(self) -> Path | None:
        """The file of ``--config``; None without."""
        return vars(self).get("config")

    def words(self) -> list[str]:
        """Return the options that give these settings again, without those of the file."""
        found = []
        for entry in fields(self):
            value = vars(self)[entry.name]
            if not entry.metadata or value is None:
                continue
            section, _, key = entry.metadata["path"].replace("_", "-").rpartition(".")
            if isinstance(value, bool):
                found.append(f"--{section}.{'' if value else 'no-'}{key}")
            else:
                found += [
                    f"--{section}.{key}={one}"
                    for one in (value if isinstance(value, list) else [value])
                ]
        return found

    def load(self, **sections: Mapping[str, object]) -> RunConfig:
        """Return the settings: options over the file of ``--config`` over the defaults.

        Args:
            sections: Tables of settings that the command has options of its own for; None for those not given.

        Raises:
            ConfigError: The file or a value is wrong.
        """
        given: dict[str, Any] = {section: dict(values) for section, values in sections.items()}
        for entry in fields(self):
            value = vars(self)[entry.name]
            if entry.metadata and value is not None:
                *sections, key = entry.metadata["path"].split(".")
                table = reduce(
                    lambda within, section: within.setdefault(section, {}), sections, given
                )
                table[key] = entry.metadata["read"](value)
        return load_config(self.file, given)


def takes_settings(
    *paths: str, without: Collection[str] = (), short: str = "", file: bool = True
) -> Callable[[_Command], _Command]:
    """Return the decorator that gives the parameter ``settings`` of a command the options of settings.

    Args:
        paths: Sections such as ``forecast`` and settings such as ``estimator.modes`` that the command uses.
        without: Settings of these sections that it does not use.
        short: Section whose settings have their keys as short names, ``--depth`` for ``planner.depth``.
        file: Whether it has ``--config`` too.
    """
    entries: list[tuple[str, Any, Any]] = (
        [("config", ConfigFile, field(default=None))] if file else []
    )
    known = dict(_settings(RunConfig))
    for wanted in paths:
        assert any(f"{path}.".startswith(f"{wanted}.") for path in known), (
            f"{wanted} is neither a section nor a setting"
        )
    for path, setting in known.items():
        if path not in without and any(f"{path}.".startswith(f"{wanted}.") for wanted in paths):
            kind, read = _option_type(setting)
            entry = field(default=None, metadata={"path": path, "read": read})
            # the forms of numbers are checked with the option
            marks = _parameter(path, setting, short), *_marks(setting, Numbers)
            entries.append((path.replace(".", "__"), Annotated[kind, *marks], entry))
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
        ConfigError: One is not such a pair, or an old name is given twice.
    """
    names = [pair.partition("=") for pair in pairs]
    if not all(old and new for old, _, new in names) or len({old for old, _, _ in names}) < len(
        names
    ):
        raise ConfigError(f"{option}: expected OLD=NEW, each old name once, got {' '.join(pairs)}")
    return {old: new for old, _, new in names}


def _settings(model: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, FieldInfo]]:
    """Yield each setting with its path; a list of tables has no option."""
    for name, setting in model.model_fields.items():
        kind = setting.annotation
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            yield from _settings(kind, f"{prefix}{name}.")
        elif name != "map":
            yield f"{prefix}{name}", setting


def _marks(setting: FieldInfo, kind: type[_Mark]) -> list[_Mark]:
    """Return the marks of a kind in a setting's annotation."""
    return [part for part in setting.metadata if isinstance(part, kind)]


def _option_type(setting: FieldInfo) -> tuple[Any, Callable[[Any], object]]:
    """Return the type of a setting's option, and the function that reads its value.

    Switches and words are checked with the option; other text is checked by the settings' model, as a TOML file is.
    """
    annotation: Any = setting.annotation
    if any(mark.repeats for mark in _marks(setting, Option)):
        return list[str] | None, list
    members = (
        get_args(annotation) if get_origin(annotation) in (Union, UnionType) else (annotation,)
    )
    kinds = [member for member in members if member is not NoneType]
    (first, *others), origin = kinds, get_origin(kinds[0])
    if first is bool or (origin is Literal and not others):
        return first | None, lambda value: value
    if origin is dict:
        return list[str] | None, lambda pairs: remapped(pairs, _marks(setting, Option)[0].name)
    return str | None, (lambda text: text.split(",")) if origin is tuple else str


def _parameter(path: str, setting: FieldInfo, short: str) -> Parameter:
    """Return the option of a setting: ``--section.key``, after its short name where it has one."""
    section, _, key = path.replace("_", "-").rpartition(".")
    mark = next(iter(_marks(setting, Option)), None)
    if section == short:
        mark = Option(f"--{key}")
    long = f"--{section}.{key}"
    names = (long,) if mark is None else (mark.name, long)
    if mark is not None and mark.heading != "Settings":
        names = (mark.name,)
    return Parameter(
        # cyclopts looks at no other name after one that the text begins with, as --planner.kind begins with --planner
        name=names[::-1] if long.startswith(f"{names[0]}.") else names,
        # a switch that is on by default needs a name that turns it off
        negative=f"--{section}.no-{key}" if setting.default is True else "",
        metavar=(mark and mark.metavar) or _metavar(setting.annotation),
        allow_leading_hyphen=bool(mark and mark.metavar),
        allow_repeating=True if setting.annotation is bool else None,
        # the option's own default is that it is not given
        show_default=False,
        help=f"{setting.description}{_default_in_words(setting.default)}",
        group=Group(f"Section {section} of the settings", sort_key=5)
        if mark is None
        else _HEADINGS[mark.heading],
    )


def _metavar(annotation: Any) -> str | None:
    """Return the form of a setting's value: of one number what it counts, of several that commas are between them; None for words."""
    text = str(annotation)
    forms = (
        ("tuple", "V1,V2,..."),
        ("Literal", None),
        ("float", "NUMBER"),
        ("int", "COUNT"),
        ("str", "TEXT"),
    )
    return next((form for name, form in forms if name in text), None)


def _default_in_words(default: object) -> str:
    """Return a default that is one value in the form of the command line's help; the description states others."""
    if isinstance(default, bool):
        return " [default: on]" if default else ""
    shown = f"{default:g}" if isinstance(default, float) else default
    return f" [default: {shown}]" if isinstance(shown, int | str) else ""
