"""Pings with their places to observations: the profiles of a block of messages are made and tested together."""

from collections.abc import Iterator, Sequence

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.observation import Observation
from replay_kit.measurements.events import Event, Skipped, Used
from replay_kit.measurements.ping.earth import added_velocity
from replay_kit.measurements.ping.profile import profiles_of, transducer_depths
from replay_kit.measurements.quality.ping import PingBlock, checks, flags_of, is_nortek
from replay_kit.measurements.steps.position_matching import PlacedPing


def observed(
    blocks: Sequence[Sequence[Event | PlacedPing]], config: MeasurementConfig
) -> list[list[Event]]:
    """Return the events of messages, with those of each ping in its place.

    These are that its messages were used, with the tests' results, and the observation; or that they were skipped.

    Args:
        blocks: The events of each message.
        config: How pings become observations.
    """
    placed = [event for events in blocks for event in events if isinstance(event, PlacedPing)]
    if not placed:
        return [
            [event for event in events if not isinstance(event, PlacedPing)] for events in blocks
        ]
    pings = [each.waiting.ping for each in placed]
    tops = transducer_depths(
        pings, [each.vehicle_depth for each in placed], [each.position[1] for each in placed]
    )
    alike: dict[tuple[int, bool], list[int]] = {}
    for i, (ping, top) in enumerate(zip(pings, tops, strict=True)):
        if not isinstance(top, str):
            alike.setdefault((len(ping.velocity), is_nortek(ping)), []).append(i)
    made: dict[int, list[Event]] = {
        i: [Skipped(each.waiting.source.topic, top)] * each.waiting.n_messages
        for i, (each, top) in enumerate(zip(placed, tops, strict=True))
        if isinstance(top, str)
    }
    for at in alike.values():
        made |= zip(
            at,
            _together([placed[i] for i in at], [float(tops[i]) for i in at], config),
            strict=True,
        )
    in_order = iter([made[i] for i in range(len(placed))])
    return [
        [
            event
            for given in events
            for event in (next(in_order) if isinstance(given, PlacedPing) else (given,))
        ]
        for events in blocks
    ]


def _together(
    placed: Sequence[PlacedPing], tops: Sequence[float], config: MeasurementConfig
) -> Iterator[list[Event]]:
    """Yield the events of pings of as many cells and of one convention."""
    pings = [each.waiting.ping for each in placed]
    profiles = profiles_of(pings, tops, config)
    tested = PingBlock(
        pings,
        profiles,
        [each.waiting.depth for each in placed],
        [each.waiting.dive for each in placed],
    )
    found = checks(tested, config)
    flags, reasons = flags_of(profiles, found, config.quality.use_suspect)
    for i, each in enumerate(placed):
        waiting, ping, source = each.waiting, each.waiting.ping, each.waiting.source
        platform_velocity, common_std = added_velocity(ping, config)
        observation = Observation(
            source.time_ns,
            *each.position,
            profiles.depth[i],
            profiles.velocity[i],
            profiles.error_std[i],
            ping.reference,
            flags[i],
            reasons[i],
            waiting.dive,
            source,
            common_std,
            ping.correlation_depth if ping.correlation_depth >= 0.0 else config.correlation_depth,
            platform_velocity,
            raw=waiting.raw,
            position_std=each.position_std,
        )
        carriers = [Used(source.topic)] * (waiting.n_messages - 1)
        yield [*carriers, Used(source.topic, tuple(check.of(i) for check in found)), observation]
