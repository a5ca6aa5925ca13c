"""Real raw ADCP files: against MHKiT's own rotation, bottom track against GPS, and damaged."""

import contextlib
import io
import warnings

import numpy as np
import pytest

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.observation import Flag
from replay_kit.logs import open_log
from replay_kit.measurements import observations
from tests.logs.adcp.raw_adcp_samples import adcp_messages, write
from tests.measurements.turned import turned
from tests.places import DATA, needs

ADCP = DATA / "adcp"
real = needs(ADCP)


def _by_mhkit(path):
    from mhkit import dolfyn

    with contextlib.redirect_stdout(io.StringIO()), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        dataset = dolfyn.read(str(path), userdata=False)
        if dataset.coord_sys != "earth":
            dolfyn.rotate2(dataset, "earth")
    return dataset


@real
@pytest.mark.parametrize(
    ("name", "size", "atol"),
    [
        ("RDI_withBT.000", 60_000, 1e-6),
        ("vmdas01_wh.ENX", 60_000, 1e-6),
        ("winriver01.PD0", 120_000, 5e-6),  # MHKiT's matrices are 32-bit
        ("winriver02_transect.PD0", 120_000, 5e-6),
        (
            "BenchFile01.ad2cp",
            100_000,
            1e-3,
        ),  # the file rounds the beams' matrix to four digits, ours are unit vectors
    ],
)
def test_velocities_turn_to_earth_as_mhkit_turns_them(tmp_path, name, size, atol):
    path = tmp_path / name
    path.write_bytes((ADCP / name).read_bytes()[:size])
    pings, _ = adcp_messages(path)
    assert sorted(tmp_path.iterdir()) == [path]
    theirs = _by_mhkit(path).vel.values[:2].transpose(2, 1, 0)
    config = MeasurementConfig()
    # as MHKiT does: no declination but what the file applied, no bin mapping, relative to the platform
    plain = {
        "declination_applied": True,
        "bin_mapped": True,
        "reference": "earth",
        "bottom_track": None,
        "platform_velocity": None,
    }
    ours = [turned({**m.payload, **plain}, config).velocity[:, :2] for m in pings[: len(theirs)]]
    assert len(ours) >= 30
    for mine, other in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(mine, other, atol=atol)


@real
@pytest.mark.parametrize(
    ("name", "size", "agree"),
    [("winriver01.PD0", None, 0.35), ("winriver02_transect.PD0", 300_000, 0.1)],
)
def test_bottom_track_and_gps_agree_on_the_river(tmp_path, name, size, agree):
    """Water over ground by bottom track and by GPS are independent; in winriver01 the compass is 7 degrees off at 2 m/s."""
    whole = list(open_log(write(tmp_path, (ADCP / name).read_bytes()[:size])).messages())
    # every fifth ping is enough for a median
    messages = [m for k, m in enumerate(whole) if m.topic != "/adcp" or k % 5 == 0]
    blind = [
        m._replace(
            payload={**m.payload, "bottom_track": {**m.payload["bottom_track"], "velocity": None}}
        )
        if m.payload.get("bottom_track")
        else m
        for m in messages
    ]
    by_bottom, by_gps = (
        _median_current(list(observations(source))) for source in (messages, blind)
    )
    assert np.hypot(*(by_bottom - by_gps)) < agree
    assert 0.4 < np.hypot(*by_bottom) < 1.5


def _median_current(profiles):
    return np.median(np.concatenate([p.velocity[p.flags == Flag.GOOD] for p in profiles]), axis=0)
