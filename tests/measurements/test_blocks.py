"""Messages cut into blocks: the events, and their bits, are those of one message after the other."""

import numpy as np
import pytest

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.observation import Observation
from replay_kit.measurements.observed import begun
from tests.measurements.samples import finish, fix, interpret_block, ping


def _log():
    """Return messages of pings of all sorts: of different cells, with and without beams, up and down, bad ones, in dives and not."""
    rng = np.random.default_rng(3)
    messages = [fix(0.0, depth=0.0)]
    for k in range(1, 90):
        n = int(rng.choice([3, 6, 7]))
        velocity = rng.normal(0.0, 0.4, (n, 3)).tolist()
        changes = {
            "n_cells": n,
            "velocity": velocity,
            "velocity_std": 0.05,
            "cell_size": 4.0,
            "bin0_distance": 6.0,
        }
        for name, low in (("correlation", 20.0), ("amplitude", 5.0), ("percent_good", 15.0)):
            if rng.random() < 0.5:
                changes[name] = rng.uniform(low, 100.0, (n, int(rng.choice([1, 4])))).tolist()
        if rng.random() < 0.3:
            changes |= {
                "attitude_convention": "nortek",
                "pitch": float(rng.normal(0.0, 20.0)),
                "roll": 2.0,
            }
        if rng.random() < 0.3:
            changes |= {"orientation": "up", "transducer_depth": 20.0}
        if rng.random() < 0.2:
            changes |= {
                "bottom_track": {"velocity": [], "distance": [25.0, 30.0]},
                "reference": "platform",
            }
        if rng.random() < 0.1:
            changes["velocity"] = changes["velocity"][:-1]
        messages.append(ping(10.0 * k, **changes))
        if k % 4 == 0:
            messages.append(
                fix(10.0 * k + 1.0, 152.0 + 1e-4 * k, depth=float(rng.choice([0.0, 40.0])))
            )
    return messages


def _values(event):
    """Return an event as something that compares bit for bit."""
    if isinstance(event, Observation):
        arrays = (event.depth, event.velocity, event.error_std, event.flags, event.reasons)
        rest = (
            event.time_ns,
            event.longitude,
            event.latitude,
            event.dive,
            event.common_std,
            event.position_std,
        )
        return tuple((part.dtype.str, part.tobytes()) for part in arrays) + rest
    return repr(event)


def _interpreted(size, config):
    state, events = begun(), []
    messages = _log()
    for start in range(0, len(messages), size):
        state, steps = interpret_block(state, messages[start : start + size], config)
        events += [[_values(event) for event in of_message] for of_message in steps]
    return [*events, [_values(event) for event in finish(state, config)]]


@pytest.mark.parametrize(
    "config", [MeasurementConfig(), MeasurementConfig(use_relative=False, surface_depth=3.0)]
)
def test_events_are_the_same_however_messages_are_cut_into_blocks(config):
    one_by_one = _interpreted(1, config)
    assert (
        sum(
            isinstance(event, tuple) and len(event) > 2 for events in one_by_one for event in events
        )
        > 40
    )
    for size in (7, 1000):
        assert _interpreted(size, config) == one_by_one
