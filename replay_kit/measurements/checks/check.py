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
from replay_kit.core.observation import Flag, Reason
from replay_kit.measurements.checks import instrument, pairs, place, profile, sensors
from replay_kit.measurements.checks.fold import Found, Memory, Rows, rows_of
from replay_kit.measurements.checks.likelihood import (
    TURNED,
    explanation,
    undecided,
)
from replay_kit.measurements.checks.profile import EnsembleSpeeds
from replay_kit.measurements.checks.sensors import Series

# Mean currents in a row, equal to the last digit, which no two dives have.
_EQUAL = 3
_OF_DEPTHS = frozenset({profile.SURFACE, sensors.DEPTHS, sensors.CLOCK})

#: What is remembered of each check, by its name and the topic of its instrument; an empty one for the vehicle.
Memories = dict[tuple[str, str], Memory]


@dataclass(frozen=True, slots=True, eq=False)
class Checked:
    """What the checks remember of a log, arrays but for names.

    Attributes:
        memory: Of each check, by its name and the topic that it is of, empty for the vehicle.
        named: Names of what was found, by topic.
        distrusted: Topics whose profiles are not used.
        pings: Pings judged, and those that are not relative to a platform of unknown velocity.
        findings: What was found, in order.
    """

    memory: Memories = field(default_factory=dict)
    named: Mapping[str, frozenset[str]] = field(default_factory=dict)
    distrusted: frozenset[str] = frozenset()
    pings: tuple[int, int] = (0, 0)
    findings: tuple[Finding, ...] = ()

    @property
    def sources_contradict(self) -> bool:
        """Whether two sources of the current contradict each other, and none of them is known to be wrong."""
        return any(
            pairs.OF_SOURCES & names
            for topic, names in self.named.items()
            if topic and topic not in self.distrusted
        )

    @property
    def can_tell_directions(self) -> bool:
        """Whether anything in the log shows, or has shown, that directions are right or wrong."""
        return any(
            self.named.get(topic, frozenset()) & {pairs.COMPASS, *pairs.OF_SOURCES}
            or pairs.show_directions(self.memory, topic)
            for topic in self.topics
        )

    def without(self, topic: str) -> "Checked":
        """Return the state as if an instrument had not been there."""
        return replace(
            self,
            memory={key: value for key, value in self.memory.items() if key[1] != topic},
            named={key: value for key, value in self.named.items() if key != topic},
            distrusted=self.distrusted - {topic},
        )

    @property
    def topics(self) -> list[str]:
        """The topics of instruments."""
        return [topic for name, topic in self.memory if name == "dead"]


def check(
    state: Checked,
    block: Block,
    ensemble: EnsembleSpeeds | None = None,
    through_water: bool = False,
) -> tuple[Checked, Block, tuple[tuple[int, Finding], ...]]:
    """Return the state after a block, the block as it may be used, and what was found, each with the place of its event.

    Args:
        state: Before the block.
        block: Bins that must not be used are flagged in the one that is returned.
        ensemble: Speeds of the ensemble's currents; None compares none.
        through_water: Whether positions under water are dead-reckoned without a current.
    """
    flags = {name: block.ping[name].copy() for name in ("flags", "reasons")} if block.ping else {}
    new, start = list[tuple[int, Finding]](), 0
    for end, topic in [*_exchanged(state, block), (len(block.events), "")]:
        state, more = _checked(state, block, slice(start, end), (flags, ensemble, through_water))
        new += more
        # with other beams it is another instrument on the same topic, of which nothing is known yet
        state, start = (state.without(topic) if topic else state), end
    return state, replace(block, ping={**block.ping, **flags}), tuple(new)


def _exchanged(state: Checked, block: Block) -> list[tuple[int, str]]:
    """Return the events with which an instrument has another number of beams than before, each with its topic."""
    found = list[tuple[int, str]]()
    for number in np.unique(block.ping["topic"]).tolist() if block.ping else []:
        pings = rows_of(block, PING, topic=number)
        told = profile.has_texture(pings)
        beams = np.where(pings["along_beams"], pings["components"], 0)[told]
        before = state.memory.get(("beams", pings.topic), {}).get("number", beams[:1])
        changes = np.flatnonzero(np.diff(np.concatenate([before, beams])))
        changes = changes if len(before) else changes + 1
        found += [(event, pings.topic) for event in pings.event[told][changes].tolist()]
    return sorted(found)


_Context = tuple[Mapping[str, NDArray[Any]], EnsembleSpeeds | None, bool]


def _checked(
    state: Checked, block: Block, events: slice, context: _Context
) -> tuple[Checked, list[tuple[int, Finding]]]:
    """Return the state after some events of a block, and what was found; pings that must not be used are flagged in place."""
    (flags, ensemble, through_water), memory = context, dict(state.memory)
    positions, means = rows_of(block, POSITION, events), rows_of(block, MEAN, events)
    vehicle, unusable, of_vehicle = _of_vehicle(memory, positions, means, block.topics)
    found = [("", each) for each in of_vehicle]
    numbers = np.unique(block.ping["topic"]).tolist() if block.ping else []
    pings = [rows_of(block, PING, events, number) for number in numbers]
    with_pings = [each for each in pings if len(each)]
    wrong = list[tuple[Rows, NDArray[np.int32]]]()
    for each in with_pings:
        reasons, more = _of_pings(
            memory,
            each,
            means,
            vehicle,
            (ensemble, through_water, state.named.get(each.topic, frozenset())),
        )
        bad = unusable(each.event)
        reasons[bad] |= np.int32(Reason.INCONSISTENT)
        wrong.append((each, reasons))
        found += [(each.topic, one) for one in more]
    absent = [topic for topic in state.topics if topic not in {each.topic for each in with_pings}]
    for topic in absent:
        held = memory.get(("sources", topic), {})
        memory["sources", topic], more = pairs.beside_means(
            held, topic, None, means, through_water, state.named.get(topic, frozenset())
        )
        found += [(topic, one) for one in more]
    after, new, since = _named(replace(state, memory=memory), found)
    for each, reasons in wrong:
        if each.topic in since:
            reasons[each.event >= since[each.topic]] |= np.int32(Reason.INCONSISTENT)
        _mark(flags, each, reasons)
    absolute = sum(int(np.isfinite(each["common_std"]).sum()) for each in with_pings)
    number = sum(len(each) for each in with_pings)
    return replace(after, pings=(state.pings[0] + number, state.pings[1] + absolute)), new


def _mark(flags: Mapping[str, NDArray[Any]], pings: Rows, reasons: NDArray[np.int32]) -> None:
    """Fail usable bins of pings, shape (n, m), for reasons."""
    held = flags["flags"][pings.row]
    bad = np.isin(held, (Flag.GOOD, Flag.SUSPECT, Flag.NOT_EVALUATED)) & (reasons != 0)
    flags["flags"][pings.row] = np.where(bad, np.int8(Flag.FAIL), held)
    flags["reasons"][pings.row] |= np.where(bad, reasons, np.int32(0))


def _named(
    state: Checked, found: list[tuple[str, Found]]
) -> tuple[Checked, list[tuple[int, Finding]], dict[str, int]]:
    """Return the state with what is found for the first time and not explained, that, and from which event on a topic is not believed."""
    named, distrusted = dict(state.named), set(state.distrusted)
    new, since = list[tuple[int, Finding]](), dict.fromkeys(state.distrusted, -1)
    before, last = dict(named), -1
    for topic, each in sorted(found, key=lambda one: one[1].event):
        if each.event != last:
            before, last = dict(named), each.event
        known, name = named.get(topic, frozenset()), each.finding.name
        explained = each.unless & (before.get(topic, frozenset()) | named.get("", frozenset()))
        if name in known or explained or (each.of_believed and topic in distrusted):
            continue
        named[topic] = known | {name}
        new.append((each.event, each.finding))
        if each.finding.distrusts and topic not in distrusted:
            distrusted.add(topic)
            since[topic] = each.event
    findings = state.findings + tuple(finding for _, finding in new)
    return (
        replace(state, named=named, distrusted=frozenset(distrusted), findings=findings),
        new,
        since,
    )


def _of_vehicle(
    memory: Memories, positions: Rows, means: Rows, topics: Sequence[str]
) -> tuple[tuple[Series, Series], Callable[[NDArray[np.int64]], NDArray[np.bool_]], list[Found]]:
    """Return depths and places of the vehicle, at which events pings are not to be used, and what was found; memories become new."""
    depth = np.column_stack([positions["depth"], positions["dead_reckoned"]])
    where = np.column_stack([positions["longitude"], positions["latitude"]])
    depths = sensors.spaced(memory.get(("depths", ""), {}), positions, depth, changes=True)
    places = sensors.spaced(memory.get(("places", ""), {}), positions, where)
    memory["depths", ""], memory["places", ""] = (
        each.remembered(sensors.MOST_OF_VEHICLE) for each in (depths, places)
    )
    before = memory.get(("frozen", ""), {}).get("bad", np.zeros(1, np.bool_))
    of_frozen, found, bad = place.frozen(memory.get(("frozen", ""), {}), positions)
    bad = np.concatenate([before, bad])
    memory["frozen", ""] = {**of_frozen, "bad": bad[-1:]}
    for name, one in (("separate", place.separate), ("twice", instrument.duplicates)):
        if len(positions):
            memory[name, ""], more = one(memory.get((name, ""), {}), positions)
            found += more
    memory["means", ""], more = _of_means_alone(memory.get(("means", ""), {}), means, topics)

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
        if not means["drift"][at]:
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
    memory: Memories,
    pings: Rows,
    means: Rows,
    vehicle: tuple[Series, Series],
    context: tuple[EnsembleSpeeds | None, bool, frozenset[str]],
) -> tuple[NDArray[np.int32], list[Found]]:
    """Return for which reasons bins of an instrument must not be used, shape (n, m), and what was found; memories become new."""
    topic, (ensemble, through_water, named) = pings.topic, context

    def held(name: str) -> Memory:
        return memory.get((name, topic), {})

    reasons = np.zeros(pings["flags"].shape, np.int32)
    told = profile.has_texture(pings)
    if told.any():
        beams = np.where(pings["along_beams"], pings["components"], 0)[told]
        memory["beams", topic] = {"number": beams[-1:]}
    memory["dead", topic], (wrong, found) = instrument.dead(held("dead"), pings)
    reasons[wrong > 0] |= np.int32(Reason.DEAD)
    living = pings.take(wrong == 0)
    if not len(living):
        memory["sources", topic], more = pairs.beside_means(
            held("sources"), topic, None, means, through_water, named
        )
        return reasons, [*found, *more]
    memory["stuck", topic], more, stuck = instrument.stuck_cells(held("stuck"), living)
    of_stuck = np.where(stuck, np.int32(Reason.DEAD), np.int32(0))
    reasons[wrong == 0] |= of_stuck
    living = replace(living, columns={**living.columns, "reasons": living["reasons"] | of_stuck})
    found = [*found, *more]
    for name, (after, more) in {
        "surface": profile.above_surface(held("surface"), living),
        "speeds": profile.speeds(held("speeds"), living, ensemble),
        "twice": instrument.duplicates(held("twice"), living),
        "noise": profile.noise(held("noise"), living),
        "beam": instrument.beams(held("beam"), living),
        "shape": profile.one_shape(held("shape"), living, stuck),
    }.items():
        memory[name, topic] = after
        found += more
    near = pairs.near_means(living)
    if len(near.time):
        memory["moved", topic], more = pairs.moved(held("moved"), near, through_water, topic, named)
        found += more
    found += _of_sensors(memory, living, vehicle)
    memory["sources", topic], more = pairs.beside_means(
        held("sources"), topic, living, means, through_water, named
    )
    return reasons, [*found, *more]


def _of_sensors(memory: Memories, pings: Rows, vehicle: tuple[Series, Series]) -> list[Found]:
    """Return what an instrument's depths establish beside the vehicle's, or of a vehicle that does not dive its headings."""
    (vehicle_depths, places), own = vehicle, dict[str, Series]()
    for name, column in (("depth", "pressure_depth"), ("heading", "heading")):
        own[name] = sensors.spaced(
            memory.get((name, pings.topic), {}), pings, pings[column][:, None]
        )
        memory[name, pings.topic] = own[name].remembered(sensors.MOST_OF_PINGS)
    asked = {(int(each.event[k]), name) for name, each in own.items() for k in each.due.tolist()}
    for event, name in sorted(asked):
        depths = own["depth"].before(event, sensors.MOST_OF_PINGS)
        diving = vehicle_depths.before(event, sensors.MOST_OF_VEHICLE)
        if name == "depth":
            found = sensors.found_of_depths(depths, diving, pings.topic)
        elif sensors.can_compare(depths, diving):
            found = None
        else:
            headings = own["heading"].before(event, sensors.MOST_OF_PINGS)
            way = places.before(event, sensors.MOST_OF_VEHICLE)
            found = sensors.found_of_headings(headings, way, pings.topic)
        if found is not None:
            return [Found(event, found, _OF_DEPTHS)]
    return []


def unknowable(state: Checked) -> tuple[str, ...]:
    """Return which faults of the profiles nothing in a log shows, and what would, as sentences; none for a log without profiles."""
    if not state.topics:
        return ()
    said, current = list[str](), list[NDArray[np.float64]]()
    for topic in state.topics:
        of_topic = state.memory.get(("sources", topic), {}).get("current", np.empty((0, 6)))
        current += [of_topic] if len(of_topic) >= pairs.LEAST_MEANS else []
    names = frozenset().union(*(state.named.get(topic, frozenset()) for topic in state.topics))
    if not current:
        said.append(
            "an offset, a drift or a scale of the profiles (an offset cancels in profiles relative to the platform)"
            if not state.pings[1]
            else f"an offset, a drift or a scale of the profiles ({pairs.LEAST_MEANS} mean currents of dives beside them would tell)"
        )
    elif not (pairs.OF_SOURCES | {pairs.COMPASS}) & names:
        open_causes = min((undecided(each, pairs.CURRENT_FLOOR) for each in current), key=len)
        if open_causes:
            listed = ", ".join(f"{name} e^{gain:z.0f}" for name, gain in open_causes.items())
            said.append(
                f"some faults of the profiles (likelihood ratios to none by {max(map(len, current))} mean currents or "
                f"drifts: {listed}; more of them, or other currents, would tell)"
            )
    lag = min(_least_lag(state, topic) for topic in state.topics)
    if lag == np.inf:
        said.append(
            "the clock and the depth of the instrument (a pressure in its pings beside depths of a vehicle that dives would tell; "
            "headings beside a way with turns, the clock)"
        )
    else:
        said.append(f"a lag of the instrument's clock below {lag:.0f} s")
    if any(state.memory.get(("beam", topic)) for topic in state.topics):
        said.append(
            "directions across the heading (beams 1 and 2 exchanged, the sign of roll), along which the vehicle hardly moves"
        )
    return tuple(f"cannot be known here: {each}" for each in said)


def _least_lag(state: Checked, topic: str) -> float:
    """Return the least lag of an instrument's clock that would show [s]."""
    held = [("depth", topic), ("heading", topic), ("depths", ""), ("places", "")]
    if any(key not in state.memory for key in held):
        return np.inf
    return sensors.least_lag(*(sensors.series(state.memory[key]) for key in held))
