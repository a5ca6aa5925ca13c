"""How a setting is called on the command line when it has a name besides ``--section.key``."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Option:
    """Mark of a setting in its annotation, ``Annotated[type, Option(...)]``; the command line reads it, pydantic does not.

    Attributes:
        name: Short name of the option, such as ``--modes``.
        metavar: Form of its value in the help, such as ``W,S,E,N``; None for the type's own.
    """

    name: str
    metavar: str | None = None
