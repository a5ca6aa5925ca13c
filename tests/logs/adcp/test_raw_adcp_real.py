"""Real raw ADCP files: against MHKiT's own rotation, bottom track against GPS, and damaged."""

import contextlib
import io
import warnings

import numpy as np
import pytest

from replay_kit.config.run import MeasurementConfig
from tests.logs.adcp.raw_adcp_samples import adcp_messages
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
