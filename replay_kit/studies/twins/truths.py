"""Which truth an experiment withholds: one of its own, or a member left out of the ensemble."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from replay_kit.core.errors import ConfigError
from replay_kit.core.grid import Ensemble


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """A truth and the ensemble that does not know it.

    Attributes:
        member: Position of the member left out; None when the truth is another file.
        truth: An ensemble of one.
        ensemble: The members that are left.
    """

    member: int | None
    truth: Ensemble
    ensemble: Ensemble


def leave_out(ensemble: Ensemble, member: int) -> Case:
    """Return the case in which a member, by its position from 0, is the truth.

    Raises:
        ConfigError: There is no such member, or too few would be left.
    """
    if not 0 <= member < ensemble.n_members:
        raise ConfigError(
            f"--leave-out: expected 0 to {ensemble.n_members - 1}, got {member}; the ensemble has {ensemble.n_members} members"
        )
    if ensemble.n_members < 3:
        raise ConfigError(
            f"--leave-out: an ensemble of at least 3 members is needed, got {ensemble.n_members}"
        )
    left = np.delete(ensemble.velocity, member, axis=0)
    truth = Ensemble(
        ensemble.grid,
        ensemble.velocity[member : member + 1],
        ensemble.time_ns,
        f"{ensemble.source}#{member}",
    )
    return Case(member, truth, replace(ensemble, velocity=left, members=()))


def members_named(text: str, n_members: int) -> tuple[int, ...]:
    """Return the positions that ``--leave-out`` names: several with commas between them, or ``all``.

    Raises:
        ConfigError: It names none, or one twice.
    """
    if text == "all":
        return tuple(range(n_members))
    names = [name.strip() for name in text.split(",")]
    if not all(name.isdecimal() for name in names) or len(set(names)) < len(names):
        raise ConfigError(
            f"--leave-out: expected positions from 0 with commas between them, each once, all or most-distant, got '{text}'"
        )
    return tuple(int(name) for name in names)


def most_distant(ensemble: Ensemble) -> int:
    """Return the position of the member that is farthest, in RMS over wet points, from the mean of the others."""
    anomalies = (ensemble.velocity - ensemble.velocity.mean(axis=0))[:, :, ensemble.grid.wet]
    # the distance from the mean of the others is the distance from the mean of all times E / (E - 1)
    return int(np.argmax(np.sum(anomalies**2, axis=(1, 2))))


def cases(ensemble: Ensemble, truth: Ensemble | None, which: str | None) -> Iterator[Case]:
    """Yield the cases of an experiment.

    Args:
        ensemble: All members.
        truth: A truth of its own; None to leave members out.
        which: ``all``, ``most-distant`` or members' positions from 0 with commas between them; None with a truth.

    Raises:
        ConfigError: Both or none are given, or the member does not exist.
    """
    if (truth is None) == (which is None):
        raise ConfigError("accuracy: give one of --truth and --leave-out")
    if truth is not None:
        yield Case(None, truth, ensemble)
    elif which == "most-distant":
        yield leave_out(ensemble, most_distant(ensemble))
    elif which is not None:
        yield from (
            leave_out(ensemble, member) for member in members_named(which, ensemble.n_members)
        )
