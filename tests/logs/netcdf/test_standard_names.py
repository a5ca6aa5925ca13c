"""Mean currents by their standard names, which state a direction, before the names of variables, in each dialect."""

import re

import h5py
import numpy as np
import pytest

from tests import synthetic
from tests.command import run_command
from tests.logs.netcdf import glider_samples as made
from tests.logs.netcdf.test_known_mission import DIALECTS
from tests.logs.said import read

TO = ("eastward_sea_water_velocity", "northward_sea_water_velocity")


def _stated(form, tmp_path, standard, renamed=None):
    """Return the files of a form whose mean currents have other standard names, and perhaps names."""
    written = DIALECTS[form].written(tmp_path / "a.nc")
    paths = written if isinstance(written, list) else [written]
    words = " ".join(read(paths).report.notes)
    names = [re.search(rf"mean current {to}: (\w+)", words)[1] for to in ("east", "north")]
    for path in paths:
        with h5py.File(path, "a") as file:
            for name, stated, to in zip(names, standard, renamed or names, strict=True):
                if to != name:
                    file.move(name, to)
                file[to].attrs.pop("standard_name", None)
                if stated is not None:
                    file[to].attrs["standard_name"] = stated
    return paths


def _means(said):
    return [(mean["dac_eastward"], mean["dac_northward"]) for mean in said.of("/dac")]


@pytest.mark.parametrize("form", DIALECTS)
@pytest.mark.parametrize("stated", [TO[::-1], (TO[1], None), (None, TO[0])])
def test_standard_names_that_contradict_names_decide(tmp_path, form, stated):
    said = read(_stated(form, tmp_path, stated))
    assert _means(said) == [pytest.approx(made.mean(k)[::-1], abs=1e-12) for k in (0, 1)]
    assert said.noted("read as their standard names state")


@pytest.mark.parametrize("form", ["bodc", "gliderdac", "erddap", "slocum-glide", "slocum"])
def test_unlisted_names_are_known_by_their_standard_names(tmp_path, form):
    said = read(_stated(form, tmp_path, TO, ("final_a", "final_b")))
    assert _means(said) == [pytest.approx(made.mean(k), abs=1e-12) for k in (0, 1)]


def test_unlisted_names_without_standard_names_are_candidates(tmp_path):
    _stated("bodc", tmp_path, (None, None), ("final_a", "final_b"))
    synthetic.dataset(3, 8, (6, 10), np.array([5.0, 100.0]), west=-30.1, south=39.9).to_netcdf(
        tmp_path / "ensemble.nc", engine="h5netcdf"
    )
    info = run_command(tmp_path, "info a.nc")
    replayed = run_command(tmp_path, "replay a.nc --ensemble ensemble.nc -o out.mcap")
    assert replayed.returncode == 3
    for words in ("final_a, final_b may be them", "--dead-reckoning through_water"):
        assert words in info.stdout
        assert words in replayed.stderr
