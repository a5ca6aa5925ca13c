"""Which cause explains profiles by the mean currents beside them: all hypotheses of each, compared with those of the others.

What explains the vectors relative to the vehicle (a compass, a mounting) is a rival of what explains the currents themselves (axes, a unit,
an offset). Where heading and current hardly change, several explain the pairs: nothing is then excluded, and the odds of all are given.
"""

import math

import numpy as np

from replay_kit.core.errors import Finding
from replay_kit.core.observation import PathMean
from replay_kit.measurements.consistency import findings
from replay_kit.measurements.consistency.pairs import (
    SCALES,
    Explanation,
    PairStatistics,
    odds,
)
from replay_kit.measurements.consistency.sources import SourceStatistics
from replay_kit.measurements.consistency.usual_faults import CAUSES, KINDS, SCALE_CAUSE, kinds_of

#: Pairs before which nothing is said: of mean currents, of dives relative to the vehicle, of the platform's motion.
LEAST_MEANS, LEAST_DIVES, LEAST_MOTIONS = 3, 2, 4
# The same of gross units: one wrong dive is none.
_LEAST_UNITS = 2
# Log-likelihood ratio of a turn relative to the vehicle, and the probability that the named cause has among all. Pairs after which a
# contradiction is named without a cause, but with the odds of all.
_TURN_GAIN, _LIKELY, _ENOUGH = 7.0, 0.98, 6
#: Kinds of hypotheses of directions.
TURNED = ("turn", "mirror")
_UNIT = ("unit",)
# Relative to the vehicle an offset and small scales are also those of its way.
_RELATIVE, _ANY = (*TURNED, "unit"), KINDS
_ADDED = (CAUSES["offset"], CAUSES["drift"])
_OF_VEHICLE = " relative to the vehicle"


def cause_of_pairs(
    sources: SourceStatistics, current: PairStatistics, mean: PathMean, topic: str
) -> Finding | None:
    """Return what a mean current established: of all causes the likeliest, once it is likely enough or there are many pairs."""
    blocks = sources.blocks.explanation(TURNED, LEAST_MOTIONS)
    if blocks is not None:
        return findings.turned(blocks, findings.OF_VEHICLE, mean.time_ns, topic)
    causes = current.causes(_ANY, LEAST_MEANS)
    for cause, gain in sources.vehicle.causes(_RELATIVE, LEAST_DIVES).items():
        # a scale is one, whatever it is relative to
        name = cause if cause == SCALE_CAUSE else f"{cause}{_OF_VEHICLE}"
        causes[name] = float(np.logaddexp(causes.get(name, -math.inf), gain))
    rivals = odds(causes)
    if not rivals:
        return None
    cause, share = rivals[0]
    if cause in _ADDED:
        # what excludes a scale must hold where the current hardly changes, too
        rivals = _beside(causes, current.causes(SCALES, LEAST_MEANS, of_one_current=True))
    best = None
    if cause == SCALE_CAUSE:
        scales = (
            current.explanation(_UNIT, _LEAST_UNITS),
            current.explanation(SCALES, LEAST_MEANS),
            sources.vehicle.explanation(_UNIT, LEAST_MEANS),
        )
        best = max((each for each in scales if each), key=lambda each: each.gain, default=None)
        if best is None or best.fault.kind not in _UNIT or not best.fault.unit:
            # what excludes an offset must be how it fits, not that its size is not known before; no offset is a unit again and again
            rivals = _beside(causes, current.added_by_fit(LEAST_MEANS))
    elif cause.endswith(_OF_VEHICLE):
        best = sources.vehicle.explanation(TURNED, LEAST_DIVES, _TURN_GAIN)
        # what excludes an instrument must be certain
        if best is not None and share >= _LIKELY:
            return findings.turned(best, findings.OF_VEHICLE, mean.time_ns, topic)
    else:
        best = current.explanation(kinds_of(cause, _ANY), LEAST_MEANS)
    share = dict(rivals)[cause]
    if best is None or (share < _LIKELY and best.pairs < _ENOUGH):
        return None
    if share < _LIKELY:
        return findings.undecided(best, rivals, mean, topic)
    return findings.of_sources(best, rivals, mean, topic)


def _beside(causes: dict[str, float], alike: dict[str, float]) -> list[tuple[str, float]]:
    """Return the odds of causes where some count at least as much as another comparison has it."""
    return odds({one: max(gain, alike.get(one, gain)) for one, gain in causes.items()})


def scale_of_motion(track: PairStatistics) -> Explanation | None:
    """Return the scale of a stated motion beside that of positions, once it is likelier than all else; positions may lack the current."""
    explained = track.explanation(SCALES, LEAST_MOTIONS)
    if explained is None:
        return None
    cause, share = odds(track.causes(_ANY, LEAST_MOTIONS))[0]
    return explained if cause == SCALE_CAUSE and share >= _LIKELY else None
