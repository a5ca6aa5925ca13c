"""A radial of an HF radar: the current's component along one direction, at one point near the surface."""

import numpy as np

from replay_kit.core.observation import Flag, Label, LinearMeasurement, Reason, Source


def radial(
    source: Source,
    place: tuple[float, float],
    heading: float,
    speed: float,
    error_std: float,
    depth: float,
    good: bool = True,
) -> LinearMeasurement:
    """Return a radial as an estimator takes it.

    Args:
        source: The record that it came from, with its time.
        place: Longitude and latitude [degrees].
        heading: Direction of a positive speed, clockwise from true north [degrees].
        speed: Of the current along it [m/s].
        error_std: Of the speed [m/s].
        depth: Down to which the radar averages, about [m].
        good: Whether the radar's own checks let it pass.
    """
    angle = np.deg2rad(heading)
    return LinearMeasurement(
        time_ns=source.time_ns,
        point_time_ns=np.array([source.time_ns]),
        longitude=np.array(place[:1]),
        latitude=np.array(place[1:]),
        depth=np.array([depth]),
        weights=None,
        value=np.array([[speed]]),
        error_std=np.array([error_std]),
        flags=np.array([Flag.GOOD if good else Flag.FAIL], np.int8),
        reasons=np.array([Reason.NONE if good else Reason.ERROR_VELOCITY], np.int32),
        label=Label(0, source),
        components=np.array([[np.sin(angle), np.cos(angle)]]),
    )
