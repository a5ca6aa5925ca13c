"""Files of gliders that are cut, that lack variables or hold nonsense: read as far as they go, or refused with an error of ours."""

import contextlib
import gzip
from typing import Any

import h5py
import numpy as np
import pytest

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.errors import LogError
from replay_kit.core.observation import PathMean
from replay_kit.logs import merge, open_log, open_logs
from replay_kit.logs.netcdf.adcp import _BEAMS
from replay_kit.measurements import observations
from tests.logs.netcdf import glider_samples as made
from tests.logs.netcdf.test_dialects import DACS

VELOCITY = np.array([0.3, -0.1, 0.05])


@pytest.mark.parametrize("form", [*DACS, "midas"])
@pytest.mark.parametrize("seed", range(6))
def test_files_that_lack_variables_or_hold_nonsense_are_read_or_refused(
    tmp_path, monkeypatch, form, seed
):
    """One variable each is left out, emptied, reversed, made large, cut to half on a dimension of its own, or of an impossible unit."""
    rng = np.random.default_rng([seed, *form.encode()])
    write = made.write

    def damaged(path, variables, *rest: Any, **named: Any):
        name = str(rng.choice(list(variables)))
        dims, values, attributes = variables[name]
        values = np.asarray(values)
        number = values.dtype.kind == "f"
        changed = [
            None,
            (dims, np.full(values.shape, np.nan) if number else values, attributes),
            (dims, values[::-1] if values.ndim else values, attributes),
            (dims, values * 1e30 if number else values, attributes),
            (
                tuple(f"own{k}" for k in range(values.ndim)),
                values[: len(values) // 2] if values.ndim else values,
                attributes,
            ),
            (dims, values, attributes | {"units": "days since 2000-13-45"}),
        ][seed]
        kept = {
            key: value
            for key, value in variables.items()
            if key != name and not (values.ndim and key in dims and seed == 4)
        }
        return write(path, kept | ({} if changed is None else {name: changed}), *rest, **named)

    monkeypatch.setattr(made, "write", damaged)
    given = (
        made.midas(tmp_path / "a.nc", VELOCITY, _BEAMS)
        if form == "midas"
        else DACS[form][1](tmp_path)
    )
    found = []
    with contextlib.suppress(LogError):
        found = list(
            observations(
                merge(open_logs(given if isinstance(given, list) else [given]), 1.0),
                MeasurementConfig(),
            )
        )
    # nothing that is not finite leaves the reader, and no error but our own
    assert all(np.isfinite(event.velocity).all() for event in found if isinstance(event, PathMean))


def test_beams_of_other_cells_are_refused(tmp_path):
    path = made.midas(tmp_path / "a.nc", VELOCITY, _BEAMS)
    with h5py.File(path, "r+") as file:
        del file["Data/Average/VelocityBeam2"]
        file["Data/Average/VelocityBeam2"] = np.zeros((2, 4))
    with pytest.raises(
        LogError,
        match=r"expected beams with the same cells at each of 2 times, got VelocityBeam1 \(2, 5\), VelocityBeam2",
    ):
        open_log(path)


def test_times_of_fixes_that_are_all_fill_do_not_cost_the_file(tmp_path):
    path = made.bodc(tmp_path / "a.nc")
    with h5py.File(path, "r+") as file:
        file["TIME_GPS"][...] = -1.0
    log = open_log(path)
    # the rows' own times stand for them
    assert [message.time_ns for message in log.messages() if message.topic == "/vehicle/fix"] == [
        round(made.START + seconds) * 10**9 for seconds in made.FIXES[:, 0]
    ]
    assert "TIME_GPS: holds no plausible times, not used" in log.report().notes
    with h5py.File(path, "r+") as file:
        file["TIME_GPS"][0] = made.START + 5.0
    assert [
        message.time_ns - round(made.START) * 10**9
        for message in open_log(path).messages()
        if message.topic == "/vehicle/fix"
    ] == [seconds * 10**9 for seconds in (5, 3600, 4200, 7800)]
    with h5py.File(path, "r+") as file:
        file["TIME"][...] = -1.0
    with pytest.raises(LogError, match="TIME: expected units"):
        open_log(path)


@pytest.mark.parametrize("damage", ["cut", "flipped"])
def test_a_damaged_compressed_file_is_an_error_of_ours(tmp_path, damage):
    first, _ = made.seaexplorer(tmp_path / "raw")
    data = bytearray(gzip.compress(first.read_bytes(), mtime=0))
    path = tmp_path / "sea063.22.gli.sub.9.gz"
    path.write_bytes(bytes(data))
    assert len(list(open_log(path).messages())) == 13
    # cut in the middle, or with one bit of its checksum changed
    data[-6] ^= 1
    path.write_bytes(bytes(data[: len(data) // 2]) if damage == "cut" else bytes(data))
    with pytest.raises(LogError, match="is the file whole"):
        open_log(path)
