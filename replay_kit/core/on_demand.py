"""Lazy imports of a package's public names, so that one of them does not load the libraries of all."""

from collections.abc import Callable, Mapping
from importlib import import_module


def on_demand(names: dict[str, object], places: Mapping[str, str]) -> Callable[[str], object]:
    """Return the function ``__getattr__`` of a package.

    Args:
        names: ``globals()`` of the package, to which each name is added when it is first asked for.
        places: Name to the module that has it, relative to the package; ``module:name`` where it has another name there.
    """
    package = str(names["__name__"])

    def get(name: str) -> object:
        """Return the value of a name.

        Raises:
            AttributeError: The package has no such name.
        """
        if name not in places:
            raise AttributeError(
                f"module {package!r} has no attribute {name!r}; it has {', '.join(sorted(places))}"
            )
        module, _, there = places[name].partition(":")
        names[name] = value = getattr(import_module(f"{package}.{module}"), there or name)
        return value

    return get
