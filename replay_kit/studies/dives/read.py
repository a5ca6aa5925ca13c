"""Dives of logs: the measurements that the estimator is given of each, and those that its predictions are scored on."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import numpy as np

from replay_kit.config.run import RunConfig
from replay_kit.core.errors import MeasurementError
from replay_kit.core.message import Message
from replay_kit.core.observation import Measurement, Observation, PathMean
from replay_kit.logs import merge
from replay_kit.measurements import Event, events_of
from replay_kit.workflows.replay.inputs.scan import open_readers


@dataclass(frozen=True, slots=True, eq=False)
class Dive:
    """One dive.

    Attributes:
        number: As the log counts.
        given: Measurements that the settings give the estimator, in order of time.
        profiles: Absolute profiles, in order of time, whether the estimator is given them or not.
        mean: Its depth-averaged current; None where the log has none.
    """

    number: int
    given: tuple[Measurement, ...]
    profiles: tuple[Observation, ...]
    mean: PathMean | None

    @property
    def legs(self) -> tuple[tuple[Observation, ...], tuple[Observation, ...]]:
        """The profiles on the way down and on the way up: those of the first half of its time, and the rest."""
        if not self.profiles:
            return (), ()
        middle = 0.5 * (self.profiles[0].time_ns + self.profiles[-1].time_ns)
        down = tuple(profile for profile in self.profiles if profile.time_ns <= middle)
        return down, self.profiles[len(down) :]


def read_dives(logs: Sequence[Path], config: RunConfig) -> tuple[Dive, ...]:
    """Return the dives of logs, in order.

    Raises:
        LogError: A log cannot be opened.
        MeasurementError: There are fewer than two dives, or nothing in them to predict.
    """
    # decoding takes longer than interpreting
    messages = list(
        merge(
            open_readers(logs, config),
            config.logs.reorder_window,
            config.logs.start_ns,
            config.logs.end_ns,
        )
    )
    given = [
        event
        for event in _events(messages, config)
        if isinstance(event, Measurement) and not _beside_profiles(event)
    ]
    inverted, sources = (_events(messages, _using(config, inverted=use)) for use in (True, False))
    profiles = [
        event
        for event in inverted
        if isinstance(event, Observation) and np.isfinite(event.common_std)
    ]
    means = {
        event.dive: event
        for event in sources
        if isinstance(event, PathMean) and event.kind == "dac"
    }
    numbers = sorted({event.dive for event in (*given, *profiles, *means.values())} - {0})
    dives = tuple(
        Dive(
            number,
            tuple(event for event in given if event.dive == number),
            tuple(profile for profile in profiles if profile.dive == number),
            means.get(number),
        )
        for number in numbers
    )
    if len(dives) < 2:
        names = ", ".join(str(path) for path in logs)
        raise MeasurementError(
            f"{names}: expected at least two dives with profiles or mean currents, got {len(dives)}; give more logs"
        )
    return dives


def _beside_profiles(event: Measurement) -> bool:
    """Return whether a measurement is a mean current beside profiles that were computed from it."""
    return isinstance(event, PathMean) and event.beside_profiles


def _using(config: RunConfig, *, inverted: bool) -> RunConfig:
    """Return settings with which a log gives its absolute profiles, or its mean currents."""
    measurements = config.measurements.model_copy(update={"use_inverted": inverted})
    return config.model_copy(update={"measurements": measurements})


def _events(messages: Iterable[Message], config: RunConfig) -> Iterator[Event]:
    """Return the events that the measurement step finds in messages."""
    return chain.from_iterable(events_of(messages, config.measurements, config.logs.system))
