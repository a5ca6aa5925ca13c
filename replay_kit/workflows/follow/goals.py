"""The goal of a followed mission, which a file may move while it runs."""

from pathlib import Path

from replay_kit.core.errors import ConfigError
from replay_kit.core.plan import Place


def read_goal(path: Path) -> Place:
    """Return the goal in a file: its first line that is neither empty nor begins with #, ``LON,LAT,DEPTH`` [degrees, degrees, m].

    Raises:
        ConfigError: The file cannot be read, or holds no such line.
    """
    try:
        lines = [line.strip() for line in path.read_text(encoding="utf-8").splitlines()]
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: the goal cannot be read: {error}") from error
    text = next((line for line in lines if line and not line.startswith("#")), "")
    try:
        longitude, latitude, depth = (float(part) for part in text.split(","))
    except ValueError as error:
        raise ConfigError(
            f"{path}: expected a line LON,LAT,DEPTH, got '{text[:80]}'; write it so [degrees, degrees, m]"
        ) from error
    if not (abs(longitude) <= 360.0 and abs(latitude) <= 90.0 and depth >= 0.0):
        raise ConfigError(
            f"{path}: '{text[:80]}' is no place in the ocean; write LON,LAT,DEPTH [degrees, degrees, m]"
        )
    return Place(longitude, latitude, depth)


def with_goal(
    goals: tuple[tuple[int, Place], ...], goal: Place, since_ns: int
) -> tuple[tuple[int, Place], ...]:
    """Return the goals with another one from some time of the log on [ns, UTC]; unchanged where it is the last one."""
    if goals and goals[-1][1] == goal:
        return goals
    return (
        *(one for one in goals if one[0] < since_ns or one is goals[0]),
        (since_ns if goals else 0, goal),
    )
