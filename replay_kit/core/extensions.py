"""Entry points of installed packages, in groups named ``replay_kit.KIND``; and the names of all objectives.

A package adds a value of a kind under a name of its choice, loaded when first needed. A package that cannot be loaded ends the run: a
result must not depend on it silently.
"""

import ast
from collections.abc import Callable, Mapping
from functools import cache
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, get_args

from replay_kit.core.errors import ConfigError

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint


#: ``logs``: ``LogFormat``, a row of the table of log formats.
#: ``dialects``: ``Dialect`` of files of columns: gliders, HF radars, drifters.
#: ``estimators``: function of an ``Ensemble`` and the ``EstimatorConfig`` that returns an
#: ``Estimator``; its name is that of ``--estimator``. ``checks``: ``PingCheck`` or ``PositionCheck``. ``sections``: function of the
#: report's ``Contents`` that returns a ``Section``. ``objectives``: ``Objective`` of missions; its name is that of ``--objective``.
#: ``sensors``: function of a message's payload that returns a
#: ``LinearMeasurement``, or in words why there is none; its name is that of the messages' schema.
Kind = Literal["logs", "dialects", "sensors", "estimators", "checks", "sections", "objectives"]


def names_of(kind: Kind) -> tuple[str, ...]:
    """Return the names of the additions of a kind without loading them."""
    return tuple(point.name for point in _points(kind))


def additions(kind: Kind, fits: Callable[[Any], bool], expected: str) -> Mapping[str, Any]:
    """Return the additions of a kind by name.

    Args:
        kind: Kind of the additions.
        fits: Returns whether a value is of the kind.
        expected: Description of the kind in the error.

    Raises:
        ConfigError: A package cannot be loaded, or adds something else, or a name that another one adds.
    """
    found: dict[str, Any] = {}
    for point in _points(kind):
        value = _loaded(point)
        if not fits(value):
            raise ConfigError(
                f"{_words(point)}: expected {expected}, got {type(value).__name__}; correct the package, or uninstall it"
            )
        if point.name in found:
            raise ConfigError(
                f"{_words(point)}: another package adds this name too; uninstall one of them"
            )
        found[point.name] = value
    return MappingProxyType(found)


@cache
def _points(kind: Kind) -> "tuple[EntryPoint, ...]":
    """Return the entry points of a kind, sorted, as the order of installed packages varies."""
    # here, because it takes as long to load as the whole command line
    from importlib.metadata import entry_points

    found = entry_points(group=f"replay_kit.{kind}")
    return tuple(sorted(found, key=lambda point: (point.name, point.value)))


@cache
def _loaded(point: "EntryPoint") -> Any:
    try:
        return point.load()
    # a module may raise anything while it is imported
    except Exception as error:
        words = " ".join(str(error).split())[:200]
        raise ConfigError(
            f"{_words(point)}: cannot be imported: {type(error).__name__}: {words}; correct the package, or uninstall it"
        ) from error


def _words(point: "EntryPoint") -> str:
    package = (
        "" if point.dist is None else f" of the package {point.dist.name} {point.dist.version}"
    )
    return f"{point.group}: {point.name} = {point.value}{package}"


ObjectiveName = Literal["time", "energy", "odds", "closest"]


def objective_names() -> tuple[str, ...]:
    """Return the names of all objectives: the project's own, then additions."""
    return (*get_args(ObjectiveName), *names_of("objectives"))


def on_demand(package: str, file: str) -> Callable[[str], object]:
    """Return the function ``__getattr__`` of a package that imports on demand.

    Args:
        package: Its ``__name__``.
        file: Its ``__file__``; each import below ``if TYPE_CHECKING`` is executed when its name is first used.
    """

    @cache
    def places() -> Mapping[str, tuple[str, str]]:
        # when a name is asked for: commands import the package and ask for none
        return {
            name.asname or name.name: (str(line.module), name.name)
            for block in ast.parse(Path(file).read_text(encoding="utf-8")).body
            if isinstance(block, ast.If)
            for line in block.body
            if isinstance(line, ast.ImportFrom)
            for name in line.names
        }

    def get(name: str) -> object:
        """Return the object of a name.

        Raises:
            AttributeError: The package has no such name.
        """
        if name not in places():
            raise AttributeError(
                f"module {package!r} has no attribute {name!r}; it has {', '.join(sorted(places()))}"
            )
        module, there = places()[name]
        return getattr(import_module(module), there)

    return get
