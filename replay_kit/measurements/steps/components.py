"""Components of velocities that wait for each other."""

from dataclasses import replace

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.observation import Source
from replay_kit.measurements.events import Event, Skipped
from replay_kit.measurements.messages.joined import Component, joined
from replay_kit.measurements.steps.pings import take_stated_ping
from replay_kit.measurements.steps.state import MeasurementState, Step

_ALONE = "one component of a velocity without the other within join_within"


def take_component(
    state: MeasurementState, part: Component, source: Source, config: MeasurementConfig
) -> Step:
    """Return the state after one component, and the events of the velocity that it completes."""
    assert part.entry is not None, "it has just come"
    key = (source.topic, str(part.entry.east), str(part.entry.north))
    waiting = dict(state.components)
    other = waiting.pop(key, None)
    if other is None or not part.fits(other):
        after = replace(state, components=waiting | {key: replace(part, entry=None)})
        return after, [] if other is None else [Skipped(source.topic, _ALONE)]
    state, stated = replace(state, components=waiting), joined(part, other)
    return (
        (state, [Skipped(source.topic, stated)] * 2)
        if isinstance(stated, str)
        else take_stated_ping(state, stated, source, config, 2)
    )


def alone(state: MeasurementState) -> list[Event]:
    """Return the events of components that still wait when the log ends."""
    return [Skipped(topic, _ALONE) for topic, _, _ in state.components]
