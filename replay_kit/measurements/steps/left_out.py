"""Measurements that the settings leave out: their messages count as not used, for the rule's own reason."""

from collections.abc import Sequence

from replay_kit.config.without import rules_for
from replay_kit.core.observation import Observation, PathMean
from replay_kit.measurements.events import Event, Skipped, Used, left_out_reason


def without(events: Sequence[Event], rules: Sequence[str]) -> list[Event]:
    """Return the events of a message without the measurements that rules leave out.

    Args:
        events: Of the message.
        rules: As configured; without any, all events are kept.
    """
    kept = list(events)
    for event in events:
        if not isinstance(event, Observation | PathMean):
            continue
        applied = rules_for(
            rules, "profiles" if isinstance(event, Observation) else event.kind, event.dive
        )
        if not applied:
            continue
        kept = [other for other in kept if other is not event]
        used = next(
            (
                k
                for k, other in enumerate(kept)
                if isinstance(other, Used) and other.topic == event.source.topic
            ),
            None,
        )
        if used is not None:
            kept[used] = Skipped(event.source.topic, left_out_reason(applied))
    return kept
