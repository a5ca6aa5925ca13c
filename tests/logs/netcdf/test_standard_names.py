"""Mean currents by their standard names, which state a direction, before the names of variables, in each dialect."""

import re

import h5py
import numpy as np
import pytest

from replay_kit.logs import open_logs
from tests import synthetic
from tests.command import run_command
from tests.logs.netcdf import glider_samples as made
from tests.logs.netcdf.test_dialects import DACS

TO = ("eastward_sea_water_velocity", "northward_sea_water_velocity")


def _read(paths):
    (log,) = open_logs(paths)
    means = [m.payload for m in log.messages() if m.topic == "/dac"]
    return log.report().notes, [(m["dac_eastward"], m["dac_northward"]) for m in means]


def _files(form, tmp_path):
    written = DACS[form][1](tmp_path)
    paths = written if isinstance(written, list) else [written]
    words = " ".join(_read(paths)[0])
    names = [re.search(rf"mean current {to}: (\w+)", words)[1] for to in ("east", "north")]
    return paths, names


def _state(paths, names, standard, renamed=None):
    for path in paths:
        with h5py.File(path, "a") as file:
            for name, stated, to in zip(names, standard, renamed or names, strict=True):
                if to != name:
                    file.move(name, to)
                if stated is None:
                    file[to].attrs.pop("standard_name", None)
                else:
                    file[to].attrs["standard_name"] = stated


@pytest.mark.parametrize("form", DACS)
@pytest.mark.parametrize("stated", [TO[::-1], (TO[1], None), (None, TO[0])])
def test_standard_names_that_contradict_names_decide(tmp_path, form, stated):
    paths, names = _files(form, tmp_path)
    _state(paths, names, stated)
    notes, found = _read(paths)
    assert found == [pytest.approx(made.mean(dive)[::-1], abs=1e-12) for dive in (0, 1)]
    assert any("read as their standard names state" in note for note in notes)


@pytest.mark.parametrize("form", ["bodc", "gliderdac", "erddap", "slocum-glide", "slocum"])
def test_unlisted_names_are_known_by_their_standard_names(tmp_path, form):
    paths, names = _files(form, tmp_path)
    _state(paths, names, TO, ("final_a", "final_b"))
    assert _read(paths)[1] == [pytest.approx(made.mean(dive), abs=1e-12) for dive in (0, 1)]


def test_unlisted_names_without_standard_names_are_candidates(tmp_path):
    paths, names = _files("bodc", tmp_path)
    _state(paths, names, (None, None), ("final_a", "final_b"))
    done = run_command(tmp_path, "info a.nc")
    for words in ("final_a, final_b may be them", "measurements.dead-reckoning through_water"):
        assert words in done.stdout
    synthetic.dataset(3, 8, (6, 10), np.array([5.0, 100.0]), west=-30.1, south=39.9).to_netcdf(
        tmp_path / "ensemble.nc", engine="h5netcdf"
    )
    done = run_command(tmp_path, "replay a.nc --ensemble ensemble.nc -o out.mcap")
    assert done.returncode == 3
    assert "final_a, final_b may be them" in done.stderr
    assert "measurements.dead-reckoning through_water" in done.stderr
