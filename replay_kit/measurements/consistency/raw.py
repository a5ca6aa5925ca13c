"""Values as the instrument gave them: dead when they are all zero or all equal, stale when a ping repeats an earlier one.

Noise makes both impossible for a living instrument. They are judged before any rotation, after which equal values differ.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from replay_kit.core.arrays import Array
from replay_kit.core.observation import NO_RAW_VALUES, Observation, RawValues

# Fewer equal cells say little, as those of a current meter or of a coarse resolution may repeat; zeros in two cells are enough.
_LEAST_CELLS, _LEAST_ZEROS = 5, 2
# Pings with which one is compared, the pings judged together, and the share and the run of bad ones from which the instrument is named.
_COMPARED, _WINDOW, _SHARE, _RUN = 16, 32, 0.25, 5
_WORDS = {
    "zero": "all zero",
    "constant": "equal in all cells",
    "stale": "equal to an earlier ping's",
}


def raw_values(velocities: Array, along_beams: bool = False) -> list[RawValues]:
    """Return what is remembered of pings' velocities, shape (s, n, k), NaN where missing; the depth of their pressure comes later."""
    textures, living = np.diff(velocities, 2, axis=1), np.zeros(len(velocities), np.bool_)
    if velocities.shape[1] >= _LEAST_CELLS:
        # as of all pings of a living instrument but a few
        known = np.isfinite(velocities[..., :2]).all(axis=(1, 2))
        living = known & (velocities[:, 0, 0] != velocities[:, 1, 0])
    return [
        RawValues("varied", _digest(velocity), texture, along_beams)
        if is_living
        else _odd_values(velocity, texture, along_beams)
        for velocity, texture, is_living in zip(velocities, textures, living.tolist(), strict=True)
    ]


def _odd_values(velocity: Array, texture: Array, along_beams: bool) -> RawValues:
    """Return what is remembered of a ping's velocities, shape (n, k), that may be dead."""
    known = velocity[:, :2]
    known = known[np.isfinite(known).all(axis=1)]
    zero = len(known) >= _LEAST_ZEROS and not known.any()
    if len(known) < _LEAST_CELLS and not zero:
        return NO_RAW_VALUES
    kind: Literal["varied", "constant", "zero"] = (
        "constant" if (known == known[0]).all() else "varied"
    )
    shape = texture if len(velocity) >= _LEAST_CELLS else None
    return RawValues("zero" if zero else kind, _digest(velocity), shape, along_beams)


def _digest(velocity: Array) -> bytes:
    return hashlib.blake2b(velocity.tobytes(), digest_size=8).digest()


@dataclass(frozen=True, slots=True)
class RawHistory:
    """The latest pings.

    Attributes:
        digests: Time [ns, UTC] and digest of the latest ones, oldest first.
        latest: What was wrong with each of the latest ones, oldest first; empty for a sound one.
        run: Number of bad ones in a row.
    """

    digests: tuple[tuple[int, bytes], ...] = ()
    latest: tuple[str, ...] = ()
    run: int = 0

    def after(self, time_ns: int, raw: RawValues) -> "tuple[RawHistory, str]":
        """Return the history after a ping, and what is wrong with it; empty for a sound one."""
        if not raw.digest:
            return self, ""
        # the same ping from two logs is a duplicate, which the estimator drops
        stale = {ns for ns, digest in self.digests if digest == raw.digest} - {time_ns}
        wrong = _WORDS.get(raw.kind, _WORDS["stale"] if stale else "")
        digests = (*self.digests, (time_ns, raw.digest))[-_COMPARED:]
        return RawHistory(
            digests, (*self.latest, wrong)[-_WINDOW:], self.run + 1 if wrong else 0
        ), wrong

    def quietly(self, pings: Sequence[Observation]) -> "RawHistory | None":
        """Return the history after pings, if none of them is bad and the instrument is not dead."""
        after, wrong = self, "dead" if self.is_dead else ""
        for ping in pings:
            if wrong:
                return None
            after, wrong = after.after(ping.time_ns, ping.raw)
        return None if wrong else after

    @property
    def is_dead(self) -> bool:
        """Whether so many are bad that the instrument is."""
        return self.run >= _RUN or sum(map(bool, self.latest)) >= _SHARE * _WINDOW

    @property
    def evidence(self) -> str:
        """What is wrong, with the number of pings."""
        bad = [wrong for wrong in self.latest if wrong]
        return f"the velocities of {len(bad)} of the last {len(self.latest)} pings are {max(set(bad), key=bad.count) if bad else 'sound'}"
