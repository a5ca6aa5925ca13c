"""The names of what a mission may minimise; ``planners/mission/values.py`` says what each is."""

from typing import Literal, get_args

from replay_kit.core.extensions import names_of

ObjectiveName = Literal["time", "energy", "odds", "closest"]


def is_objective(name: str) -> bool:
    """Return whether an objective has a name."""
    return name in get_args(ObjectiveName) or name in names_of("objectives")


def objective_names() -> tuple[str, ...]:
    """Return the names of all objectives: the project's own, then those that installed packages add."""
    return (*get_args(ObjectiveName), *names_of("objectives"))
