"""Zarr stores, and those that declare more than they hold."""

import tracemalloc

import numpy as np
import pytest

from replay_kit.config.run import ForecastConfig
from replay_kit.core.errors import ForecastError
from replay_kit.core.progress import shown_by
from replay_kit.forecast import files, read_ensemble
from replay_kit.forecast.describe import describe_ensemble
from tests import synthetic
from tests.forecast.forms import read_with, unwritten_stores


def refused_early(paths, message, config=None):
    """Assert that stores are refused, and that little of what they declare was made."""
    tracemalloc.start()
    try:
        with pytest.raises(ForecastError, match=message):
            describe_ensemble(paths, config or ForecastConfig())
        assert tracemalloc.get_traced_memory()[1] < 3e7
    finally:
        tracemalloc.stop()


def test_coordinates_that_were_never_written_are_refused_before_currents_are_read(tmp_path):
    # 17 GB of currents; coordinates of 106 MB each in 77 KB, and of 2 MB
    (tmp_path / "large").mkdir()
    declared = (
        r"U\.zarr: its coordinates cannot be read: it claims 212 MB of values in a file of "
        r"0\.00. MB, more than 100 times its bytes; "
    )
    whole = r"were its values written\? give the whole file; its arrays take 8\.7 GB in memory, of which --region reads a part$"
    refused_early(unwritten_stores(tmp_path / "large", (80, 3059, 4322)), declared + whole)
    size = r"; its arrays take 16\.9 GB in memory, of which --region reads a part$"
    written = r"U\.zarr: glamt is 0 at every point; were the coordinates written\? give the file of the grid with --ensemble"
    refused_early(unwritten_stores(tmp_path, (4400, 400, 601)), written + size)
    # a small one is refused too, before it was taken for water at rest
    refused_early(unwritten_stores(tmp_path, (8, 40, 60)), written + "$")
    x, y = np.meshgrid(np.linspace(10.0, 16.0, 60), np.linspace(40.0, 44.0, 40))
    refused_early(
        unwritten_stores(tmp_path, (8, 40, 60), x, 0.0 * y + 5.0), r"gphit is 5 at every point"
    )


def test_currents_that_were_never_written_are_refused_before_they_are_made(tmp_path):
    x, y = np.meshgrid(np.linspace(10.0, 16.0, 600), np.linspace(40.0, 44.0, 400))
    paths = unwritten_stores(tmp_path, (4400, 400, 600), x, y)
    refused_early(
        paths,
        r"its currents cannot be read: it claims 16896 MB of values in .*; choose less with --region and --levels, or mend the file",
    )
    # of a small part all of its chunk is unpacked
    refused_early(
        paths,
        r"vozocrtx cannot be read: it claims 839 MB of values in a file of 0\.02. MB",
        ForecastConfig(region=(11.0, 41.0, 11.1, 41.1), levels=(10.0, 20.0)),
    )


@pytest.mark.parametrize("zarr_format", [2, 3])
def test_a_store_is_read_in_both_formats(tmp_path, zarr_format):
    synthetic.dataset().to_zarr(
        tmp_path / "e.zarr", zarr_format=zarr_format, consolidated=zarr_format == 2
    )
    read = read_with(tmp_path / "e.zarr")
    np.testing.assert_array_equal(read.velocity, synthetic.ensemble().velocity)
    assert read.notes == ()


def test_the_size_of_a_large_forecast_is_said_before_it_is_read_and_after(tmp_path, monkeypatch):
    synthetic.dataset().to_netcdf(tmp_path / "e.nc", engine="h5netcdf")
    whole = read_with(tmp_path / "e.nc")
    assert whole.notes == ()
    # 2 GB stand for the eight members of 4 levels x 5 x 6 points
    monkeypatch.setattr(files, "_LARGE", whole.velocity.nbytes - 1)
    said = []
    with shown_by(lambda done, total, what: said.append(what)):
        read = read_with(tmp_path / "e.nc")
        for less in (
            ForecastConfig(levels=(5.0, 60.0)),
            ForecastConfig(region=(152.0, -40.0, 152.3, -39.5)),
        ):
            assert read_ensemble(tmp_path / "e.nc", less).notes == ()
    assert read.notes == (
        "the forecast is large; its arrays take 0.0 GB in memory, of which --region reads a part",
    )
    assert said == [
        "reading the forecast; its arrays take 0.0 GB in memory, of which --region reads a part"
    ]
