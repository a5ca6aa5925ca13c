"""Checks of a log during reading: from a state and a block to a state, the flagged block and findings.

Checks are causal and do not use the estimate. An instrument is a topic, in all logs of a mission.
"""

from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from replay_kit.core.errors import Finding
from replay_kit.core.extensions import additions
from replay_kit.core.observation import Flag, Reason, usable
from replay_kit.core.observation.table import MEAN, PING, POSITION, Block
from replay_kit.measurements.checks import instrument, pairs, place, profile, sensors
from replay_kit.measurements.checks.causes import COMPASS, CURRENT, OF_SOURCES, UNUSED
from replay_kit.measurements.checks.fold import Context, Fold, Found, Memory, Rows, rows_of
from replay_kit.measurements.checks.likelihood import KINDS, causes
from replay_kit.measurements.checks.profile import EnsembleSpeeds

# Logarithm of the odds of a cause to none below which it is excluded.
_EXCLUDED = -1.0

#: The checks of pings that are neither dead nor stale, by name, in the order in which findings are reported: to add one is to write its
#: fold and its line here.
CHECKS: Mapping[str, Fold] = {
    "surface": profile.above_surface,
    "speeds": profile.speeds,
    "twice": instrument.duplicates,
    "noise": profile.noise,
    "beams": instrument.beams,
    "shape": profile.one_shape,
    "sensors": sensors.against_vehicle,
    "means": pairs.against_references,
}
# Of positions, and of mean currents.
_OF_POSITIONS: Mapping[str, Callable[..., Any]] = {
    "vehicle": sensors.vehicle_history,
    "frozen": place.frozen,
    "separate": place.separate,
    "twice": instrument.duplicates,
}


@dataclass(frozen=True, slots=True, eq=False)
class Checked:
    """State of the checks of a log.

    Attributes:
        memory: Memory of each check, by name of the check and instrument, empty for the vehicle.
        instruments: Empty rows of each instrument by name: a topic, and another one for other beams.
        named: Names of findings by instrument, with ``UNUSED`` if its profiles are excluded; an empty name for the vehicle.
        pings: Number of pings checked, and of absolute ones.
        findings: Findings in order.
    """

    memory: Mapping[tuple[str, str], Memory] = field(default_factory=dict)
    instruments: Mapping[str, Rows] = field(default_factory=dict)
    named: Mapping[str, frozenset[str]] = field(default_factory=dict)
    pings: tuple[int, int] = (0, 0)
    findings: tuple[Finding, ...] = ()

    @property
    def doubts_directions(self) -> bool:
        """Whether findings state that an instrument's profiles are rotated or contradict another source."""
        told = OF_SOURCES | {COMPASS}
        return any(told & names for instrument, names in self.named.items() if instrument)

    @property
    def can_tell_directions(self) -> bool:
        """Whether the log can show, or has shown, errors of directions."""
        shown = (pairs.show_directions(self.memory, name) for name in self.instruments)
        return self.doubts_directions or any(shown)


def check(
    state: Checked,
    block: Block,
    ensemble: EnsembleSpeeds | None = None,
    through_water: bool = False,
) -> tuple[Checked, Block, tuple[tuple[int, Finding, bool], ...]]:
    """Return the state after a block, the block with flags, and findings.

    Each finding has the index of its event, and whether it states a contradiction of two sources of the current.

    Args:
        state: State before the block.
        block: Block; in the returned one unusable bins are flagged.
        ensemble: Speeds of the ensemble's currents; None for no comparison.
        through_water: Whether dead reckoning assumes no current.
    """
    memory, found = defaultdict[Any, Memory](dict, state.memory), list[tuple[str, Found]]()

    def run(name: str, fold: Callable[..., Any], rows: Rows, *more: Any) -> Any:
        """Run a check of an instrument or the vehicle, and return its marks."""
        key = name, rows.instrument
        memory[key], new, *marks = fold(memory[key], rows, *more)
        found.extend((rows.instrument, each) for each in new)
        return marks and marks[0]

    positions, means = rows_of(block, POSITION), rows_of(block, MEAN)
    vehicle, frozen, *_ = [run(name, fold, positions) for name, fold in _OF_POSITIONS.items()]
    if len(means):
        # profiles may have been computed from a mean current
        means = means.take(means["beside_profiles"] == 0)
        run("of means", pairs.means_against_motion, means)
    for order, finding in block.findings:
        # with the first event of the message that tells
        found.append(("", Found(int(np.searchsorted(block.events[:, 0], order)), finding)))
    instruments, (number, absolute) = _instruments(block, state.instruments), state.pings
    wrong = np.zeros_like(block.ping["reasons"] if block.ping else np.empty((0, 0), np.int32))
    for name, pings in instruments.items():
        if not len(pings) and not len(means):
            continue
        known = state.named.get(name, frozenset())
        context = Context(ensemble, through_water, vehicle, means, known)
        dead = run("dead", instrument.dead, pings)
        living = pings.take(~dead)
        stuck = run("stuck", instrument.stuck_cells, living)
        row, cell = np.nonzero(stuck)
        wrong[pings["row"][dead]] = wrong[living["row"][row], cell] = Reason.DEAD
        living = living.having(reasons=living["reasons"] | stuck * np.int32(Reason.DEAD))
        for check_name, fold in {**CHECKS, **added_checks()}.items():
            run(check_name, fold, living, context)
        number += len(pings)
        absolute += int(np.isfinite(pings["common_std"]).sum())
    named, new, since = _new_findings(state.named, found)
    for name, pings in instruments.items():
        # by the position before
        bad = frozen[np.searchsorted(positions.event, pings.event)]
        bad |= pings.event >= since.get(name, len(block.events))
        wrong[pings["row"][bad]] |= np.int32(Reason.INCONSISTENT)
    if block.ping:
        flags, why = block.ping["flags"], block.ping["reasons"]
        bad = usable(flags) & (wrong != 0)
        marked = {"flags": np.where(bad, np.int8(Flag.FAIL), flags), "reasons": why | wrong * bad}
        block = replace(block, ping={**block.ping, **marked})
    none = {name: pings.take(np.empty(0, np.intp)) for name, pings in instruments.items()}
    findings = state.findings + tuple(finding for _, finding, _ in new)
    after = Checked(dict(memory), none, named, (number, absolute), findings)
    return after, block, tuple(new)


def _instruments(block: Block, known: Mapping[str, Rows]) -> dict[str, Rows]:
    """Return the pings of each instrument by name, including instruments without a ping in the block."""
    found = dict(known)
    if block.ping:
        pings = rows_of(block, PING)
        beams = np.where(pings["along_beams"], pings["components"], 0)
        for topic, number in sorted({*zip(pings["topic"].tolist(), beams.tolist(), strict=True)}):
            name = block.topics[topic]
            of_instrument = pings.take((pings["topic"] == topic) & (beams == number))
            instrument = f"{name} along {number} beams" if number else name
            found[instrument] = replace(of_instrument, topic=name, instrument=instrument)
    return found


def _new_findings(
    named: Mapping[str, frozenset[str]], found: list[tuple[str, Found]]
) -> tuple[dict[str, frozenset[str]], list[tuple[int, Finding, bool]], dict[str, int]]:
    """Return the names of findings, the new unexplained findings, and the first event without each excluded instrument.

    Args:
        named: Names before the block, by instrument.
        found: Findings of the block with their instruments.
    """
    after, new = dict(named), list[tuple[int, Finding, bool]]()
    since = {source: -1 for source, names in named.items() if UNUSED in names}
    for source, (event, finding, unless) in sorted(found, key=lambda one: one[1].event):
        known = after.get(source, frozenset())
        if finding.name in known or not (known | after.get("", frozenset())).isdisjoint(unless):
            continue
        after[source] = known | {finding.name}
        if finding.distrusts:
            after[source] |= {UNUSED}
            since.setdefault(source, event)
        believed = (names for one, names in after.items() if one and UNUSED not in names)
        new.append((event, finding, any(OF_SOURCES & names for names in believed)))
    return after, new, since


def added_checks() -> dict[str, Fold]:
    """Return the checks of pings in installed packages, by name."""
    return dict(additions("checks", callable, "a check"))


def unknowable(state: Checked) -> tuple[str, ...]:
    """Return sentences on faults of the profiles that the log cannot show, and how to show them; empty without profiles."""
    if not state.instruments:
        return ()
    said, possible = list[str](), list[dict[str, float]]()
    for name in state.instruments:
        current = state.memory["means", name].get("current", np.empty((0, 6)))
        if len(current) >= CURRENT.least:
            odds = causes(current, CURRENT, KINDS, by_fit=True)
            # what is neither established nor excluded
            possible.append({one: gain for one, gain in odds.items() if gain > _EXCLUDED})
    if not possible:
        why = "an offset cancels in profiles relative to the platform"
        if state.pings[1]:
            why = f"{CURRENT.least} mean currents of dives would show them"
        said.append(f"an offset, a drift or a scale of the profiles ({why})")
    elif (left := min(possible, key=len)) and not state.doubts_directions:
        listed = ", ".join(f"{name} e^{gain:z.0f}" for name, gain in left.items())
        said.append(
            f"some faults of the profiles (odds by mean currents or drifts: {listed}; more of them, or other currents, would show them)"
        )
    vehicle = state.memory["vehicle", ""]
    lag = min(
        sensors.least_lag(state.memory["sensors", instrument], vehicle)
        for instrument in state.instruments
    )
    said.append(
        f"a lag of the instrument's clock below {lag:.0f} s"
        if np.isfinite(lag)
        else "the clock and the depth of the instrument (pressure in its pings and depths of a diving vehicle would show both; "
        "headings on a track with turns, the clock)"
    )
    if any("along" in name for name in state.instruments):
        said.append(
            "directions across the heading (beams 1 and 2 exchanged, the sign of roll), along which the vehicle hardly moves"
        )
    return tuple(f"cannot be known here: {each}" for each in said)
