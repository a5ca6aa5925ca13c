"""Profiles of the current in gliders' files without a real sample: the field that was written comes back, on true axes."""

import numpy as np
import pytest

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.observation import Observation, PathMean
from replay_kit.logs import merge, open_log, open_logs
from replay_kit.logs.netcdf.adcp import _BEAMS
from replay_kit.measurements import observations
from tests.logs.netcdf import glider_samples as made


def test_absolute_profiles_of_spray_come_back_with_depth_first(tmp_path):
    log = open_log(made.spray(tmp_path / "a.nc"))
    profiles = [
        event
        for event in observations(log.messages(), MeasurementConfig())
        if isinstance(event, Observation)
    ]
    assert [profile.dive for profile in profiles] == [1, 2]
    for dive, profile in enumerate(profiles):
        east, north = made.current(made.DEPTHS, dive)
        if dive == 1:
            east[-1] = north[-1] = np.nan
        np.testing.assert_allclose(profile.depth, made.DEPTHS)
        np.testing.assert_allclose(profile.velocity, np.column_stack([east, north]), atol=5.1e-5)
        assert (profile.reference, profile.time_ns) == (
            "earth",
            round(made.middles()[dive, 0]) * 10**9,
        )
        assert (profile.longitude, profile.latitude) == pytest.approx(
            tuple(made.middles()[dive, 1:]), abs=1e-9
        )
    # the same water does not count twice
    assert not [
        event
        for event in observations(log.messages(), MeasurementConfig())
        if isinstance(event, PathMean)
    ]


VELOCITY = np.array([0.3, -0.1, 0.05])


def test_velocities_of_a_midas_export_come_back_on_true_axes(tmp_path):
    export = made.midas(tmp_path / "sea063_M22.ad2cp.nc", VELOCITY, _BEAMS)
    track = made.bodc(tmp_path / "track.nc")
    logs = open_logs([export, track])
    assert [log.format for log in logs] == ["midas", "og1"]
    config = MeasurementConfig(magnetic_declination=5.0, without=("dac",))
    pings = [
        event for event in observations(merge(logs, 1.0), config) if isinstance(event, Observation)
    ]
    assert [ping.reference for ping in pings] == ["platform", "platform"]
    for ping, heading in zip(pings, (35.0, 45.0), strict=True):
        # x points along the heading, y to its left, for an instrument that looks up
        along, left = VELOCITY[:2]
        angle = np.deg2rad(90.0 - heading)
        east, north = (
            along * np.cos(angle) - left * np.sin(angle),
            along * np.sin(angle) + left * np.cos(angle),
        )
        np.testing.assert_allclose(ping.velocity, np.tile([east, north], (5, 1)), atol=1e-5)
    # up from 33 dbar
    np.testing.assert_allclose(pings[0].depth, 32.7 - np.arange(2.0, 12.0, 2.0), atol=0.2)
    assert any("looks up by its accelerometer" in note for note in logs[0].report().notes)
