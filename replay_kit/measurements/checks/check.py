"""The checks of a log as it is read: what is remembered and a block in; what is remembered, the block as it may be used, and findings out.

Nothing here looks ahead or at an estimate. An instrument is a topic, in all logs of a mission.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from replay_kit.core.block import MEAN, PING, POSITION, Block
from replay_kit.core.errors import Finding
from replay_kit.core.extensions import additions
from replay_kit.core.observation import Flag, Reason
from replay_kit.measurements.checks import instrument, pairs, place, profile, sensors
from replay_kit.measurements.checks.fold import Context, Fold, Found, Memory, Rows, rows_of
from replay_kit.measurements.checks.likelihood import KINDS, TURNED, causes, explanation
from replay_kit.measurements.checks.profile import EnsembleSpeeds

# Mean currents in a row, equal to the last digit, which no two dives have.
_EQUAL = 3
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
    "motion": pairs.moved,
    "sensors": sensors.of_sensors,
    "means": pairs.beside_means,
}
#: What is remembered of each check, by its name and the topic of its instrument; an empty one for the vehicle.
Memories = dict[tuple[str, str], Memory]


@dataclass(frozen=True, slots=True, eq=False)
class Checked:
    """What the checks remember of a log, arrays but for names.

    Attributes:
        memory: Of each check, by its name and the topic that it is of, empty for the vehicle.
        instruments: Topic of each instrument, by its name.
        named: Names of what was found, by instrument; an empty one for the vehicle.
        distrusted: Instruments whose profiles are not used.
        pings: Pings judged, and those that are not relative to a platform of unknown velocity.
        findings: What was found, in order.
    """

    memory: Memories = field(default_factory=dict)
    instruments: Mapping[str, str] = field(default_factory=dict)
    named: Mapping[str, frozenset[str]] = field(default_factory=dict)
    distrusted: frozenset[str] = frozenset()
    pings: tuple[int, int] = (0, 0)
    findings: tuple[Finding, ...] = ()

    @property
    def can_tell_directions(self) -> bool:
        """Whether anything in the log shows, or has shown, that directions are right or wrong."""
        return any(
            self.named.get(topic, frozenset()) & {pairs.COMPASS, *pairs.OF_SOURCES}
            or pairs.show_directions(self.memory, topic)
            for topic in self.instruments
        )


def check(
    state: Checked,
    block: Block,
    ensemble: EnsembleSpeeds | None = None,
    through_water: bool = False,
) -> tuple[Checked, Block, tuple[tuple[int, Finding, bool], ...]]:
    """Return the state after a block, the block as it may be used, and what was found.

    That comes with the place of its event, and with whether two sources of the current contradict each other since.

    Args:
        state: Before the block.
        block: Bins that must not be used are flagged in the one that is returned.
        ensemble: Speeds of the ensemble's currents; None compares none.
        through_water: Whether positions under water are dead-reckoned without a current.
    """
    memory, found = dict(state.memory), list[tuple[str, Found]]()
    positions, means = rows_of(block, POSITION), rows_of(block, MEAN)
    # profiles may have been computed from a mean current
    means = means.take(~means["beside_profiles"].astype(np.bool_)) if len(means) else means
    vehicle, unusable, of_vehicle = _of_vehicle(memory, positions, means, block.topics)
    found += [("", each) for each in of_vehicle]
    for order, finding in block.findings:
        # with the first event of the message that tells
        found.append(("", Found(int(np.searchsorted(block.events[:, 0], order)), finding)))
    pings, wrong = _instruments(block), list[NDArray[np.int32]]()
    context = Context(ensemble, through_water, vehicle, means, state.named)
    for each in pings:
        reasons, more = _of_pings(memory, each, context)
        reasons[unusable(each.event)] |= np.int32(Reason.INCONSISTENT)
        wrong.append(reasons)
        found += [(each.instrument, one) for one in more]
    for one in set(state.instruments) - {each.instrument for each in pings}:
        held = memory.get(("means", one), {})
        memory["means", one], more = pairs.beside_means(
            held, None, context, (one, state.instruments[one])
        )
        found += [(one, each) for each in more]
    after, new, since = _named(replace(state, memory=memory), found)
    flags = {name: block.ping[name].copy() for name in ("flags", "reasons")} if pings else {}
    for each, reasons in zip(pings, wrong, strict=True):
        if each.instrument in since:
            reasons[each.event >= since[each.instrument]] |= np.int32(Reason.INCONSISTENT)
        _mark(flags, each, reasons)
    number = state.pings[0] + sum(map(len, pings))
    absolute = state.pings[1] + sum(int(np.isfinite(each["common_std"]).sum()) for each in pings)
    checked = replace(block, ping={**block.ping, **flags})
    known = {**state.instruments, **{each.instrument: each.topic for each in pings}}
    return replace(after, instruments=known, pings=(number, absolute)), checked, tuple(new)


def _instruments(block: Block) -> list[Rows]:
    """Return the pings of each instrument: of a topic, and with other beams it is another one."""
    if not block.ping:
        return []
    beams = np.where(block.ping["along_beams"], block.ping["components"], 0)
    keys = np.unique(np.column_stack([block.ping["topic"], beams]), axis=0)
    found = list[Rows]()
    for topic, number in keys.tolist():
        pings = rows_of(block, PING, topic)
        own = pings.take(np.where(pings["along_beams"], pings["components"], 0) == number)
        found.append(
            replace(own, instrument=f"{own.topic} along {number} beams" if number else own.topic)
        )
    return found


def _mark(flags: Mapping[str, NDArray[Any]], pings: Rows, reasons: NDArray[np.int32]) -> None:
    """Fail usable bins of pings, shape (n, m), for reasons."""
    held = flags["flags"][pings.row]
    bad = np.isin(held, (Flag.GOOD, Flag.SUSPECT, Flag.NOT_EVALUATED)) & (reasons != 0)
    flags["flags"][pings.row] = np.where(bad, np.int8(Flag.FAIL), held)
    flags["reasons"][pings.row] |= np.where(bad, reasons, np.int32(0))


def _named(
    state: Checked, found: list[tuple[str, Found]]
) -> tuple[Checked, list[tuple[int, Finding, bool]], dict[str, int]]:
    """Return the state with what is found for the first time and not explained, that, and from which event on a topic is not believed."""
    named, distrusted = dict(state.named), set(state.distrusted)
    new, since = list[tuple[int, Finding, bool]](), dict.fromkeys(state.distrusted, -1)
    before, last = dict(named), -1
    for topic, each in sorted(found, key=lambda one: one[1].event):
        if each.event != last:
            before, last = dict(named), each.event
        known, name = named.get(topic, frozenset()), each.finding.name
        explained = each.unless & (before.get(topic, frozenset()) | named.get("", frozenset()))
        if name in known or explained or (each.of_believed and topic in distrusted):
            continue
        named[topic] = known | {name}
        if each.finding.distrusts and topic not in distrusted:
            distrusted.add(topic)
            since[topic] = each.event
        believed = (names for one, names in named.items() if one and one not in distrusted)
        new.append((each.event, each.finding, any(pairs.OF_SOURCES & names for names in believed)))
    findings = state.findings + tuple(finding for _, finding, _ in new)
    return (
        replace(state, named=named, distrusted=frozenset(distrusted), findings=findings),
        new,
        since,
    )


def _of_vehicle(
    memory: Memories, positions: Rows, means: Rows, topics: Sequence[str]
) -> tuple[tuple[Rows, Rows], Callable[[NDArray[np.int64]], NDArray[np.bool_]], list[Found]]:
    """Return depths and places of the vehicle, at which events pings are not to be used, and what was found; memories become new."""
    depth = np.column_stack([positions["depth"], positions["dead_reckoned"]])
    where = np.column_stack([positions["longitude"], positions["latitude"]])
    depths, places = (
        sensors.spaced(memory.get((name, ""), {}), positions.having(value=value), name == "depths")
        for name, value in (("depths", depth), ("places", where))
    )
    memory["depths", ""], memory["places", ""] = sensors.latest(depths), sensors.latest(places)
    before = memory.get(("frozen", ""), {}).get("bad", np.zeros(1, np.bool_))
    of_frozen, found, bad = place.frozen(memory.get(("frozen", ""), {}), positions)
    bad = np.concatenate([before, bad])
    memory["frozen", ""] = {**of_frozen, "bad": bad[-1:]}
    for name, one in (("separate", place.separate), ("twice", instrument.duplicates)):
        if len(positions):
            memory[name, ""], more = one(memory.get((name, ""), {}), positions)
            found += more
    memory["alone", ""], more = _of_means_alone(memory.get(("alone", ""), {}), means, topics)

    def unusable(event: NDArray[np.int64]) -> NDArray[np.bool_]:
        return np.asarray(bad[np.searchsorted(positions.event, event)])

    return (depths, places), unusable, [*found, *more]


def _of_means_alone(
    memory: Memory, means: Rows, topics: Sequence[str]
) -> tuple[Memory, list[Found]]:
    """Return that mean currents are equal to the last digit, which no two dives have, or have a slip beside dead reckoning.

    Positions that were reckoned with a current, of which dead reckoning tells less, differ in other ways, which are not named.

    Args:
        memory: ``last`` (2,), the last mean current of a dive [m/s]; ``since`` (2,), time of the first that equals it [ns, UTC], and how
            many do; ``reckoned`` (up to 128, 6), pairs.
        means: Mean currents.
        topics: Names of topics.
    """
    last = memory.get("last", np.full(2, np.nan))
    since_ns, number = memory.get("since", np.zeros(2, np.int64)).tolist()
    pairs_held, found = memory.get("reckoned", np.empty((0, 6))), list[Found]()
    for at in range(len(means)):
        velocity, topic = means["velocity"][at], topics[int(means["topic"][at])]
        time_ns, event = means.time(at), int(means.event[at])
        number = number + 1 if (velocity == last).all() else 1
        since_ns = since_ns if number > 1 else time_ns
        last = velocity
        if number == _EQUAL:
            east, north = velocity
            finding = Finding(
                pairs.MEANS,
                since_ns,
                f"{topic}: {number} dives in a row have the mean current {east:g} east, {north:g} north m/s",
                "a mean current that was never computed, and is logged as zero or as the last one",
                "withhold them (--without dac), or compute them from dead reckoning",
            )
            found.append(Found(event, finding))
        reckoned = means["reckoned"][at]
        if np.isfinite(reckoned).all() and (reckoned != velocity).any():
            began = means["path_time"][at, :1]
            new = pairs.pairs_of(
                velocity[:1] + 1j * velocity[1:], reckoned[:1] + 1j * reckoned[1:], 1.0, began
            )
            pairs_held = np.concatenate([pairs_held, new])[-pairs.MOST :]
            explained = explanation(pairs_held, pairs.VEHICLE_FLOOR, TURNED, pairs.LEAST_MEANS)
            if explained is not None and explained.slip:
                found.append(
                    Found(event, pairs.of_reckoning(explained, pairs_held, time_ns, topic))
                )
    since = np.array([since_ns, number], np.int64)
    return {"last": last, "since": since, "reckoned": pairs_held}, found


def _of_pings(
    memory: Memories, pings: Rows, context: Context
) -> tuple[NDArray[np.int32], list[Found]]:
    """Return for which reasons bins of an instrument must not be used, shape (n, m), and what was found; memories become new."""
    name = pings.instrument
    reasons = np.zeros(pings["flags"].shape, np.int32)
    memory["dead", name], (wrong, found) = instrument.dead(memory.get(("dead", name), {}), pings)
    reasons[wrong > 0] |= np.int32(Reason.DEAD)
    living = pings.take(wrong == 0)
    memory["stuck", name], more, stuck = instrument.stuck_cells(
        memory.get(("stuck", name), {}), living
    )
    reasons[wrong == 0] |= np.where(stuck, np.int32(Reason.DEAD), np.int32(0))
    living = replace(
        living, columns={**living.columns, "reasons": living["reasons"] | reasons[wrong == 0]}
    )
    found = [*found, *more]
    for check_name, one in {**CHECKS, **added_checks()}.items():
        memory[check_name, name], more = one(memory.get((check_name, name), {}), living, context)
        found += more
    return reasons, found


def added_checks() -> dict[str, Fold]:
    """Return the checks of pings that installed packages add, by name."""
    return dict(additions("checks", callable, "a check"))


def unknowable(state: Checked) -> tuple[str, ...]:
    """Return which faults of the profiles nothing in a log shows, and what would, as sentences; none for a log without profiles."""
    if not state.instruments:
        return ()
    said, current = list[str](), list[dict[str, float]]()
    for topic in state.instruments:
        of_topic = state.memory.get(("means", topic), {}).get("current", np.empty((0, 6)))
        if len(of_topic) >= pairs.LEAST_MEANS:
            current.append(
                causes(of_topic, pairs.CURRENT_FLOOR, KINDS, pairs.LEAST_MEANS, by_fit=True)
            )
    names = frozenset().union(*(state.named.get(topic, frozenset()) for topic in state.instruments))
    if not current:
        said.append(
            "an offset, a drift or a scale of the profiles (an offset cancels in profiles relative to the platform)"
            if not state.pings[1]
            else f"an offset, a drift or a scale of the profiles ({pairs.LEAST_MEANS} mean currents of dives beside them would tell)"
        )
    elif not (pairs.OF_SOURCES | {pairs.COMPASS}) & names:
        # what is neither established nor excluded
        open_causes = min(
            ({name: gain for name, gain in each.items() if gain > _EXCLUDED} for each in current),
            key=len,
        )
        if open_causes:
            listed = ", ".join(f"{name} e^{gain:z.0f}" for name, gain in open_causes.items())
            said.append(
                f"some faults of the profiles (odds to none by mean currents or drifts: {listed}; more of them, or other currents, would tell)"
            )
    lag = min(_least_lag(state, topic) for topic in state.instruments)
    if lag == np.inf:
        said.append(
            "the clock and the depth of the instrument (a pressure in its pings beside depths of a vehicle that dives would tell; "
            "headings beside a way with turns, the clock)"
        )
    else:
        said.append(f"a lag of the instrument's clock below {lag:.0f} s")
    if any(state.memory.get(("beams", topic)) for topic in state.instruments):
        said.append(
            "directions across the heading (beams 1 and 2 exchanged, the sign of roll), along which the vehicle hardly moves"
        )
    return tuple(f"cannot be known here: {each}" for each in said)


def _least_lag(state: Checked, instrument_name: str) -> float:
    """Return the least lag of an instrument's clock that would show [s]."""
    own = state.memory["sensors", instrument_name]
    depths, headings = (sensors.remembered(own, name) for name in ("depth", "heading"))
    return sensors.least_lag(
        depths, headings, state.memory["depths", ""], state.memory["places", ""]
    )
