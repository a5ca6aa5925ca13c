"""Files of gliders that are cut, that lack variables or hold nonsense: read as far as they go, or refused with an error of ours."""

import contextlib
import gzip

import h5py
import numpy as np
import pytest

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.errors import LogError
from replay_kit.core.observation import PathMean
from replay_kit.logs import open_log
from replay_kit.logs.netcdf.adcp import _BEAMS
from replay_kit.measurements import observations
from tests.logs.netcdf import glider_samples as made
from tests.logs.netcdf.test_known_mission import DIALECTS, VELOCITY, changed
from tests.logs.said import read


@pytest.mark.parametrize("damage", ["cut", "flipped"])
def test_a_damaged_compressed_file_is_an_error_of_ours(tmp_path, damage):
    first, _ = made.seaexplorer(tmp_path / "raw")
    data = bytearray(gzip.compress(first.read_bytes(), mtime=0))
    path = tmp_path / "sea063.22.gli.sub.9.gz"
    path.write_bytes(bytes(data))
    assert len(read(path).messages) == 13
    # cut in the middle, or with one bit of its checksum changed
    data[-6] ^= 1
    path.write_bytes(bytes(data[: len(data) // 2]) if damage == "cut" else bytes(data))
    with pytest.raises(LogError, match="is the file complete"):
        open_log(path)


def _other_beams(path):
    with h5py.File(made.midas(path, VELOCITY, _BEAMS), "r+") as file:
        del file["Data/Average/VelocityBeam2"]
        file["Data/Average/VelocityBeam2"] = np.zeros((2, 4))


def _no_time(path):
    variables = {"LATITUDE": (("N",), np.zeros(3), {})}
    made.write(path, variables, {"Conventions": "OG-1.0"})


def _filled(path):
    with h5py.File(made.bodc(path), "r+") as file:
        file["TIME"][...] = -1.0


@pytest.mark.parametrize(
    ("write", "words"),
    [
        (_other_beams, r"beams with the same cells at each of 2 times, got VelocityBeam1 \(2, 5\)"),
        (_no_time, r"OceanGliders OG1: expected a variable time with .* got .*LATITUDE"),
        (_filled, "TIME: expected units"),
    ],
)
def test_a_file_that_cannot_be_used_says_why(tmp_path, write, words):
    write(tmp_path / "a.nc")
    with pytest.raises(LogError, match=words):
        open_log(tmp_path / "a.nc")


@pytest.mark.parametrize("form", [*DIALECTS, "midas"])
@pytest.mark.parametrize("seed", range(6))
def test_files_that_lack_variables_or_hold_nonsense_are_read_or_refused(tmp_path, form, seed):
    """One variable each is left out, emptied, reversed, made large, cut to half on a dimension of its own, or of an impossible unit."""
    rng = np.random.default_rng([seed, *form.encode()])

    def damaged(variables):
        name = str(rng.choice(list(variables)))
        dims, values, attributes = variables.pop(name)
        values = np.asarray(values)
        number, long = values.dtype.kind == "f", values.ndim > 0
        if seed == 4:
            variables = {k: v for k, v in variables.items() if not (long and k in dims)}
        own = tuple(f"own{k}" for k in range(values.ndim))
        nonsense = [
            None,
            (dims, np.full(values.shape, np.nan) if number else values, attributes),
            (dims, values[::-1] if long else values, attributes),
            (dims, values * 1e30 if number else values, attributes),
            (own, values[: len(values) // 2] if long else values, attributes),
            (dims, values, attributes | {"units": "days since 2000-13-45"}),
        ][seed]
        return variables | ({} if nonsense is None else {name: nonsense})

    write = DIALECTS[form].write if form in DIALECTS else _midas
    given = changed(write, damaged, tmp_path / "a.nc")
    found = []
    with contextlib.suppress(LogError):
        found = list(observations(read(given).messages, MeasurementConfig()))
    # nothing that is not finite leaves the reader, and no error but our own
    assert all(np.isfinite(event.velocity).all() for event in found if isinstance(event, PathMean))


def _midas(path):
    return made.midas(path, VELOCITY, _BEAMS)
