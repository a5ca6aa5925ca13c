"""The checks of a log as it is read: a frozen state and an event in; the state, the event as it may be used, and what was found out.

Nothing here looks ahead or at an estimate. An instrument is a topic, in
all logs of a mission.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from replay_kit.core.arrays import replace
from replay_kit.core.errors import Finding
from replay_kit.core.observation import Flag, Observation, PathMean, Reason, VehicleState
from replay_kit.measurements.consistency import checks, findings
from replay_kit.measurements.consistency.causes import (
    LEAST_DIVES,
    LEAST_MEANS,
    LEAST_MOTIONS,
    TURNED,
    Positions,
    cause_of_pairs,
    found_of_headings,
    least_lag_of_headings,
    scale_of_motion,
    with_position,
)
from replay_kit.measurements.consistency.depths import (
    Depth,
    DepthRecord,
    can_compare,
    found_of_depths,
    least_lag,
)
from replay_kit.measurements.consistency.instrument import Beams
from replay_kit.measurements.consistency.pairs import Pair, PairStatistics
from replay_kit.measurements.consistency.position_checks import steady
from replay_kit.measurements.consistency.raw import RawHistory
from replay_kit.measurements.consistency.sources import SourceStatistics, reckoned_pairs
from replay_kit.measurements.consistency.summary import EnsembleSpeeds, PingSummary, summaries

# After any of these the instrument's depth is known to be wrong, or its time.
_OF_DEPTHS = {findings.DEPTH, findings.DEPTHS, findings.CLOCK}

#: What is checked.
Checked = VehicleState | Observation | PathMean


@dataclass(frozen=True, slots=True, eq=False)
class Instrument:
    """What is remembered of one ADCP.

    Attributes:
        raw: Of its raw values.
        sources: Of its profiles and other measurements of the current.
        pings: What each check of pings remembers.
        depths: By its pressure.
        headings: Headings [degrees] in place of depths.
        is_believed: Whether its profiles are used.
        named: Names of what was found.
        beams: Number of beams along which its velocities are, 0 for true or other axes; None while no ping has told.
    """

    raw: RawHistory = field(default_factory=RawHistory)
    sources: SourceStatistics = field(default_factory=SourceStatistics)
    pings: tuple[checks.PingCheck, ...] = field(
        default_factory=lambda: (*checks.PING_CHECKS, *checks.added_checks(of_positions=False))
    )
    depths: DepthRecord = field(default_factory=DepthRecord)
    headings: DepthRecord = field(default_factory=DepthRecord)
    is_believed: bool = True
    named: frozenset[str] = frozenset()
    beams: int | None = None


def _beams(ping: Observation) -> int | None:
    """Return along how many beams a ping's velocities are, 0 for true or other axes; None where it does not tell."""
    texture = ping.raw.texture
    return None if texture is None else texture.shape[1] * ping.raw.along_beams


@dataclass(frozen=True, slots=True, eq=False)
class ConsistencyState:
    """What is remembered of a log.

    Attributes:
        instruments: By topic.
        positions: What each check of positions remembers.
        depths: Of the vehicle, at its positions.
        places: Its latest positions.
        named: Names of what was found of the positions.
        equal_means: The last mean current of a dive, and since when and how often it has come without another between.
        reckoned: Pairs of the stated mean currents of dives and those by their dead reckoning.
        pings: Pings judged.
        absolute_pings: Number of those that are not relative to a platform of unknown velocity.
        findings: What was found, in order.
    """

    instruments: Mapping[str, Instrument] = field(default_factory=dict)
    positions: tuple[checks.PositionCheck, ...] = field(
        default_factory=lambda: (*checks.POSITION_CHECKS, *checks.added_checks(of_positions=True))
    )
    depths: DepthRecord = field(default_factory=DepthRecord)
    places: Positions = ()
    named: frozenset[str] = frozenset()
    equal_means: tuple[tuple[float, float], int, int] = ((math.nan, math.nan), 0, 0)
    reckoned: PairStatistics = field(default_factory=reckoned_pairs)
    pings: int = 0
    absolute_pings: int = 0
    findings: tuple[Finding, ...] = ()

    @property
    def sources_contradict(self) -> bool:
        """Whether two sources of the current contradict each other, and none of them is known to be wrong."""
        believed = [
            instrument for instrument in self.instruments.values() if instrument.is_believed
        ]
        return any(findings.OF_SOURCES & instrument.named for instrument in believed)

    @property
    def can_tell_directions(self) -> bool:
        """Whether anything in the log shows, or has shown, that directions are right or wrong."""
        return any(
            instrument.named & {findings.COMPASS, *findings.OF_SOURCES}
            or _tell_directions(instrument.sources)
            for instrument in self.instruments.values()
        )


def unknowable(state: ConsistencyState) -> tuple[str, ...]:
    """Return which faults of the profiles nothing in a log shows, and what would, as sentences; none for a log without profiles."""
    instruments = list(state.instruments.values())
    if not instruments:
        return ()
    found = []
    sources = [instrument.sources for instrument in instruments]
    compared = [one.current for one in sources if len(one.current.pairs) >= LEAST_MEANS]
    if not compared:
        found.append(
            "an offset, a drift or a scale of the profiles (an offset cancels in profiles relative to the platform)"
            if not state.absolute_pings
            else f"an offset, a drift or a scale of the profiles ({LEAST_MEANS} mean currents of dives beside them would tell)"
        )
    elif not any((findings.OF_SOURCES | {findings.COMPASS}) & each.named for each in instruments):
        undecided = min((each.undecided() for each in compared), key=len)
        if undecided:
            listed = ", ".join(f"{name} e^{gain:z.0f}" for name, gain in undecided.items())
            found.append(
                f"some faults of the profiles (likelihood ratios to none by {max(len(each.pairs) for each in compared)} mean currents or "
                f"drifts: {listed}; more of them, or other currents, would tell)"
            )
    lag = min(
        min(
            least_lag(instrument.depths, state.depths),
            least_lag_of_headings(instrument.headings, state.places),
        )
        for instrument in instruments
    )
    if lag == math.inf:
        found.append(
            "the clock and the depth of the instrument (a pressure in its pings beside depths of a vehicle that dives would tell; "
            "headings beside a way with turns, the clock)"
        )
    else:
        found.append(f"a lag of the instrument's clock below {lag:.0f} s")
    if any(isinstance(each, Beams) and each.variances for one in instruments for each in one.pings):
        found.append(
            "directions across the heading (beams 1 and 2 exchanged, the sign of roll), along which the vehicle hardly moves"
        )
    return tuple(f"cannot be known here: {each}" for each in found)


def _tell_directions(sources: SourceStatistics) -> bool:
    means = sources.current.tell_directions(LEAST_MEANS)
    motions = any(
        each.tell_directions(LEAST_MOTIONS)
        for each in (sources.blocks, sources.motion, sources.track)
    )
    return means or motions or sources.vehicle.tell_directions(LEAST_DIVES)


def check(
    state: ConsistencyState,
    event: Checked,
    ensemble: EnsembleSpeeds | None = None,
    through_water: bool = False,
    summary: PingSummary | None = None,
) -> tuple[ConsistencyState, Checked]:
    """Return the state after an event, and the event as it may be used: bins that must not be are flagged.

    Args:
        state: Before the event.
        event: A position or a measurement.
        ensemble: Speeds of the ensemble's currents; None compares none.
        through_water: Whether positions under water are dead-reckoned without a current.
        summary: What ``summaries`` gives of a ping, with others in less time; None makes it.
    """
    if isinstance(event, VehicleState):
        return _after_position(state, event), event
    if isinstance(event, PathMean):
        state = _after_reckoned(_after_equal_mean(state, event), event)
        for topic, instrument in state.instruments.items():
            after, found = _after_mean(instrument, event, topic)
            if not (found and findings.MEANS in state.named):
                state = _with(state, topic, after, found)
        return state, event
    return _after_ping(state, event, summary or summaries([event], ensemble)[0], through_water)


def check_quiet(
    state: ConsistencyState, run: Sequence[tuple[VehicleState | Observation, PingSummary | None]]
) -> ConsistencyState | None:
    """Return the state after positions and pings that are used as they are, as ``check`` gives it; None where one may show anything.

    Args:
        state: Before them.
        run: In the order of the log; of each ping what ``summaries`` gives.
    """
    track = [event for event, _ in run if isinstance(event, VehicleState)]
    positions = checks.quiet(state.positions, track) if track else state.positions
    by_topic: dict[str, list[tuple[Observation, PingSummary]]] = {}
    for event, known in run:
        if isinstance(event, Observation) and known is not None:
            by_topic.setdefault(event.source.topic, []).append((event, known))
    instruments = dict(state.instruments)
    for topic, own in by_topic.items():
        after = _after_quiet(instruments[topic], own) if topic in instruments else None
        if after is None:
            return None
        instruments[topic] = after
    if positions is None or not steady(track) or any(each.is_unusable for each in positions):
        return None
    absolute = [isinstance(event, Observation) and event.common_std < math.inf for event, _ in run]
    return replace(
        _with_places(state, track),
        instruments=instruments,
        positions=positions,
        pings=state.pings + len(run) - len(track),
        absolute_pings=state.absolute_pings + sum(absolute),
    )


def _after_quiet(
    before: Instrument, run: Sequence[tuple[Observation, PingSummary]]
) -> Instrument | None:
    """Return an instrument after pings in a row; None where one may show anything."""
    pings, known = zip(*run, strict=True)
    if not {*map(_beams, pings)} <= {None, before.beams}:
        return None
    raw = before.raw.quietly(pings) if before.is_believed else None
    checked = None if raw is None else checks.quiet(before.pings, pings, known)
    if raw is None or checked is None:
        return None
    after = replace(_sensed(before, run), raw=raw, pings=checked)
    # what is judged now and then, and may have grown past that
    for old, new in (
        (before.sources.motion, after.sources.motion),
        (before.sources.track, after.sources.track),
        (before.depths, after.depths),
        (before.headings, after.headings),
    ):
        if new is not old and (new.is_due or new.number > old.number + 1):
            return None
    return after


def _after_equal_mean(state: ConsistencyState, mean: PathMean) -> ConsistencyState:
    """Return the state after a mean current, which no two dives have to the last digit."""
    if mean.kind != "dac":
        return state
    velocity, since_ns, number = state.equal_means
    number = number + 1 if velocity == mean.velocity else 1
    since_ns = since_ns if number > 1 else mean.time_ns
    state = replace(state, equal_means=(mean.velocity, since_ns, number))
    if number < LEAST_MEANS or findings.MEANS in state.named:
        return state
    found = findings.equal_means(mean, since_ns, number)
    return replace(state, named=state.named | {found.name}, findings=(*state.findings, found))


def _after_reckoned(state: ConsistencyState, mean: PathMean) -> ConsistencyState:
    """Return the state after a mean current that dead reckoning tells, too: a slip of axes or signs shows between the two.

    Positions that were reckoned with a current, of which dead reckoning tells less, differ in other ways, which are not named.
    """
    if mean.reckoned is None or mean.reckoned == mean.velocity:
        return state
    pairs = state.reckoned.with_pair(
        Pair(*mean.velocity, *mean.reckoned, 1.0, int(mean.path_time_ns[0]))
    )
    state = replace(state, reckoned=pairs)
    found = pairs.explanation(TURNED, LEAST_MEANS)
    if found is None or not found.fault.is_slip or findings.RECKONED in state.named:
        return state
    named = findings.of_reckoning(found, mean)
    return replace(state, named=state.named | {named.name}, findings=(*state.findings, named))


def _with(
    state: ConsistencyState, topic: str, instrument: Instrument, found: tuple[Finding, ...]
) -> ConsistencyState:
    return replace(
        state,
        instruments={**state.instruments, topic: instrument},
        findings=state.findings + found if found else state.findings,
    )


def _after_position(state: ConsistencyState, vehicle: VehicleState) -> ConsistencyState:
    positions = tuple([each.after(vehicle) for each in state.positions])
    found = _new([each.found(vehicle, state.named) for each in positions], state.named)
    return replace(
        _with_places(state, [vehicle]),
        positions=positions,
        named=state.named.union(each.name for each in found) if found else state.named,
        findings=state.findings + found if found else state.findings,
    )


def _with_places(state: ConsistencyState, track: Iterable[VehicleState]) -> ConsistencyState:
    """Return the state with the depths and places of positions."""
    depths, places = state.depths, state.places
    for vehicle in track:
        depths = depths.after(Depth(vehicle.time_ns, vehicle.depth, vehicle.dead_reckoned))
        places = with_position(places, vehicle)
    return replace(state, depths=depths, places=places)


def _new(found: Iterable[Finding | None], named: frozenset[str]) -> tuple[Finding, ...]:
    """Return what was found and has not been named before."""
    return tuple([one for one in found if one is not None and one.name not in named])


def _after_ping(
    state: ConsistencyState, ping: Observation, summary: PingSummary, through_water: bool
) -> tuple[ConsistencyState, Observation]:
    topic = ping.source.topic
    instrument, beams = state.instruments.get(topic), _beams(ping)
    if instrument is None or (beams is not None and instrument.beams not in (None, beams)):
        # with other beams it is another instrument on the same topic, of which nothing is known yet
        instrument = Instrument(sources=SourceStatistics(through_water=through_water))
    if beams is not None and instrument.beams is None:
        instrument = replace(instrument, beams=beams)
    raw, wrong = instrument.raw.after(ping.time_ns, ping.raw)
    found: list[Finding] = []
    if raw.is_dead and findings.DEAD not in instrument.named:
        found.append(findings.dead(raw, ping))
    if wrong:
        instrument = replace(instrument, raw=raw)
    else:
        before, instrument = instrument, _measured(instrument, raw, ping, summary)
        found += _of_ping(instrument, before.sources, ping)
        if not instrument.named & _OF_DEPTHS:
            late = _of_sensors(instrument, before, state, topic)
            found += [] if late is None else [late]
    if found:
        named = frozenset(finding.name for finding in found)
        distrusted = any(finding.distrusts for finding in found)
        instrument = replace(
            instrument,
            named=instrument.named | named,
            is_believed=instrument.is_believed and not distrusted,
        )
    reason = Reason.DEAD if wrong else Reason.NONE
    if not instrument.is_believed or any(each.is_unusable for each in state.positions):
        reason |= Reason.INCONSISTENT
    absolute = state.absolute_pings + math.isfinite(ping.common_std)
    state = replace(
        state,
        instruments={**state.instruments, topic: instrument},
        pings=state.pings + 1,
        absolute_pings=absolute,
        findings=(*state.findings, *found) if found else state.findings,
    )
    return state, unused(ping, reason) if reason else ping


def _of_sensors(
    instrument: Instrument, before: Instrument, state: ConsistencyState, topic: str
) -> Finding | None:
    """Return what a ping's depth established, or of a vehicle that does not dive its heading, beside the vehicle's own."""
    if instrument.depths is not before.depths and instrument.depths.is_due:
        found = found_of_depths(instrument.depths, state.depths, topic)
        if found is not None:
            return found
    headings = instrument.headings
    if headings is before.headings or not headings.is_due:
        return None
    if can_compare(instrument.depths, state.depths):
        return None
    return found_of_headings(headings, state.places, topic)


def _measured(
    instrument: Instrument, raw: RawHistory, ping: Observation, summary: PingSummary
) -> Instrument:
    """Return an instrument after a ping that is neither dead nor stale, and the history of its raw values."""
    after = tuple([each.after(ping, summary) for each in instrument.pings])
    return replace(_sensed(instrument, [(ping, summary)]), raw=raw, pings=after)


def _sensed(instrument: Instrument, run: Iterable[tuple[Observation, PingSummary]]) -> Instrument:
    """Return an instrument with what is compared with other sources, and with the vehicle's depth and course."""
    sources, depths, headings = instrument.sources, instrument.depths, instrument.headings
    for ping, summary in run:
        sources = sources if summary.near is None else sources.after_ping(summary.near)
        depths = depths.after_ping(ping.time_ns, ping.raw.depth)
        headings = headings.after_ping(ping.time_ns, ping.raw.heading)
    return replace(instrument, sources=sources, depths=depths, headings=headings)


def _of_ping(instrument: Instrument, before: SourceStatistics, ping: Observation) -> list[Finding]:
    """Return what a ping established about its instrument, whose sources were others before it."""
    named = instrument.named
    found = list(_new([each.found(ping, named) for each in instrument.pings], named))
    sources, topic = instrument.sources, ping.source.topic
    moves = sources.track is not before.track and sources.track.is_due
    if findings.COMPASS not in instrument.named:
        for statistics, is_due, what in (
            (
                sources.motion,
                sources.motion is not before.motion and sources.motion.is_due,
                findings.OF_MOTION,
            ),
            (sources.track, moves, findings.OF_TRACK),
        ):
            explanation = statistics.explanation(TURNED, LEAST_MOTIONS) if is_due else None
            if explanation is not None:
                return [*found, findings.turned(explanation, what, ping.time_ns, topic)]
    if moves and not findings.OF_SOURCES & instrument.named:
        scale = scale_of_motion(sources.track)
        found += [] if scale is None else [findings.scaled_motion(scale, ping.time_ns, topic)]
    return found


def _after_mean(
    instrument: Instrument, mean: PathMean, topic: str
) -> tuple[Instrument, tuple[Finding, ...]]:
    """Return an instrument after a mean current, and what that established."""
    sources = instrument.sources.after_mean(mean)
    instrument = replace(instrument, sources=sources)
    if not instrument.is_believed:
        return instrument, ()
    finding = cause_of_pairs(sources, sources.current, mean, topic)
    # that something is wrong may come before what it is
    known = (findings.OF_SOURCES - {findings.UNDECIDED}) | {findings.COMPASS}
    if finding is None or finding.name in instrument.named or known & instrument.named:
        return instrument, ()
    believed = not finding.distrusts
    named = instrument.named | {finding.name}
    return replace(instrument, is_believed=believed, named=named), (finding,)


def unused(ping: Observation, reason: Reason) -> Observation:
    """Return a ping whose usable bins are failed for a reason."""
    bad = (
        (ping.flags == Flag.GOOD)
        | (ping.flags == Flag.SUSPECT)
        | (ping.flags == Flag.NOT_EVALUATED)
    )
    flags, reasons = ping.flags.copy(), ping.reasons.copy()
    flags[bad] = Flag.FAIL
    reasons[bad] |= np.int32(reason)
    return replace(ping, flags=flags, reasons=reasons)
