"""Files of gliders that are cut, that lack variables or hold nonsense: read as far as they go, or refused with an error of ours."""

import contextlib

import numpy as np
import pytest

from replay_kit.config.run import MeasurementConfig
from replay_kit.core.errors import LogError
from replay_kit.core.observation import PathMean
from replay_kit.logs import open_log
from replay_kit.measurements import observations
from tests.logs.netcdf import glider_samples as made
from tests.logs.netcdf.test_known_mission import DIALECTS, changed
from tests.logs.said import read


def _other_beams(variables):
    return variables | {"VelocityBeam2": (("time", "other"), np.zeros((2, 4)), {})}


def _no_time(variables):
    return {"LATITUDE": variables["LATITUDE"]}


def _filled(variables):
    dims, time, attributes = variables["TIME"]
    return variables | {"TIME": (dims, np.full_like(time, -1.0), attributes)}


def _no_variables(variables):
    return {"lat": (("n",), np.zeros(3), {})}


def _field(variables):
    about = {"standard_name": "eastward_sea_water_velocity"}
    return {"time": variables["time"], "uo": (("time", "y", "x"), np.zeros((118, 3, 3)), about)}


@pytest.mark.parametrize(
    ("write", "change", "words"),
    [
        (made.midas, _other_beams, r"same cells at each of 2 times, got VelocityBeam1 \(2, 5\)"),
        (made.bodc, _no_time, r"OceanGliders OG1: expected a variable time, got .*LATITUDE"),
        (made.bodc, _filled, "TIME: expected units"),
        (made.erddap, _no_variables, r"NetCDF with times .*; got lat"),
        (made.slocum_glide, _field, r"on a grid: time, .*uo; a forecast is given with --ensemble"),
    ],
)
def test_a_file_that_cannot_be_used_says_why(tmp_path, write, change, words):
    path = changed(write, change, tmp_path / "a.nc")
    with pytest.raises(LogError, match=words):
        open_log(path)


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

    write = DIALECTS[form].write if form in DIALECTS else made.midas
    given = changed(write, damaged, tmp_path / "a.nc")
    found = []
    with contextlib.suppress(LogError):
        found = list(observations(read(given).messages, MeasurementConfig()))
    # nothing that is not finite leaves the reader, and no error but our own
    assert all(np.isfinite(event.velocity).all() for event in found if isinstance(event, PathMean))
