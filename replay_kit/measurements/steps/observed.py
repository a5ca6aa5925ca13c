"""Pings with their places to observations: the profiles of a block of messages are made and tested together."""

from collections.abc import Iterator, Sequence

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.observation import Observation
from replay_kit.measurements.events import Event, Used
from replay_kit.measurements.ping.earth import added_velocity
from replay_kit.measurements.ping.profile import profiles_of
from replay_kit.measurements.quality.ping import PingBlock, checks, flags_of, is_nortek
from replay_kit.measurements.steps.position_matching import PlacedPing


def observed(blocks: Sequence[Sequence[Event | PlacedPing]], config: MeasurementConfig) -> list[list[Event]]:
    """Return the events of messages, with two for each ping: that its message was used, with the tests' results, and the observation.

    Args:
        blocks: The events of each message.
        config: How pings become observations.
    """
    placed = [event for events in blocks for event in events if isinstance(event, PlacedPing)]
    made = iter(_in_order(placed, config))
    return [[event for given in events for event in (next(made) if isinstance(given, PlacedPing) else (given,))] for events in blocks]


def _in_order(placed: Sequence[PlacedPing], config: MeasurementConfig) -> Sequence[tuple[Used, Observation]]:
    """Return the events of pings; those of as many cells and of one convention are tested together."""
    alike: dict[tuple[int, bool], list[int]] = {}
    for i, each in enumerate(placed):
        alike.setdefault((len(each.waiting.ping.velocity), is_nortek(each.waiting.ping)), []).append(i)
    found = {i: events for at in alike.values() for i, events in zip(at, _together([placed[i] for i in at], config), strict=True)}
    return [found[i] for i in range(len(placed))]


def _together(placed: Sequence[PlacedPing], config: MeasurementConfig) -> Iterator[tuple[Used, Observation]]:
    pings = [each.waiting.ping for each in placed]
    profiles = profiles_of(pings, [each.transducer_depth for each in placed], config)
    tested = PingBlock(pings, profiles, [each.waiting.depth for each in placed], [each.waiting.dive for each in placed])
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
        yield Used(source.topic, tuple(check.of(i) for check in found)), observation
