"""Global forecasts that are free, in the forms that their producers publish, as the members of one ensemble."""

import numpy as np
import pytest
import xarray as xr

from tests.forecast.forms import noted, read_with, true_components

LATITUDES, LONGITUDES, START = (36.0, 37.5), (-21.5, -19.5), np.datetime64("2024-01-03", "ns")
# of these the first, the last and some between are kept: a form is more than its number of levels
_LEVELS = (0.494, 47.37, 92.33, 155.85, 318.13, 541.1)
#: Spacing [degrees], type of values, days, further levels, names of the coordinates.
FORMS = {
    "glo12": (1 / 12, "f4", 10, (643.6, 1245.0), ("latitude", "longitude")),
    "langya": (1 / 12, "f4", 7, (), ("latitude", "longitude")),
    "glonet": (1 / 4, "f8", 10, (643.6, 1245.0), ("lat", "lon")),
    "hclimrep": (1 / 4, "f4", 10, (), ("latitude", "longitude")),
}


def current(amplitude, day, depth, latitude, longitude):
    """A current that turns with the days, linear in longitude so that a coarse grid has it whole."""
    angle = amplitude + 0.3 * day
    strength = 0.3 * amplitude * (1.0 - depth / 2000.0) * (longitude + 20.0) + 0.0 * latitude
    return strength * np.cos(angle), strength * np.sin(angle)


def made(name, amplitude):
    """A product of some days as its producer lays it out."""
    step, kind, days, deeper, (north, east) = FORMS[name]
    coordinates = {
        "time": START + np.arange(days) * np.timedelta64(1, "D"),
        "depth": np.array([*_LEVELS, *deeper], "f4"),
        north: np.arange(LATITUDES[0], LATITUDES[1] + 1e-6, step),
        east: np.arange(LONGITUDES[0], LONGITUDES[1] + 1e-6, step),
    }
    grid = np.meshgrid(
        np.arange(days), *(coordinates[key] for key in ("depth", north, east)), indexing="ij"
    )
    both = zip(("uo", "vo"), current(amplitude, *grid), strict=True)
    fields = {
        key: (("time", "depth", north, east), values.astype(kind), {"units": "m/s"})
        for key, values in both
    }
    fields["zos"] = (("time", north, east), np.zeros((days, *grid[0].shape[2:]), kind))
    return xr.Dataset(fields, coordinates, {"challenger": name, "Conventions": "CF-1.8"})


@pytest.fixture(scope="module")
def products(tmp_path_factory):
    """Two starts a week apart of a form as files, of the others one, the last as a Zarr store."""
    folder = tmp_path_factory.mktemp("free")
    paths = []
    for k, name in enumerate(FORMS):
        paths.append(folder / f"{name}_20240103.{'zarr' if name == 'hclimrep' else 'nc'}")
        product = made(name, 0.5 + 0.3 * k)
        if paths[-1].suffix == ".zarr":
            product.to_zarr(paths[-1], consolidated=True, zarr_format=2)
        else:
            product.to_netcdf(paths[-1], engine="h5netcdf")
    earlier = made("langya", 0.7)
    earlier["time"] = earlier["time"] - np.timedelta64(3, "D")
    earlier.to_netcdf(folder / "langya_20231231.nc", engine="h5netcdf")
    return [*paths, folder / "langya_20231231.nc"]


def test_products_and_an_earlier_start_of_one_are_members_on_the_grid_of_the_first(products):
    read = read_with(products, members="models", time="2024-01-05")
    assert read.made_from == "models"
    assert [name.split("_")[0] for name in read.members] == [*FORMS, "langya"]
    # HClimRep and LangYa end above the last level of the first
    assert read.grid.wet.any(axis=(1, 2)).tolist() == [True] * 7 + [False]
    assert noted(read, "over its times was replaced by that of all 5 models")
    j, i = 7, 5
    latitude, longitude = read.grid.latitude[j, i], read.grid.longitude[j, i]
    depth = float(read.grid.levels[1])
    amplitudes = [*(0.5 + 0.3 * k for k in range(len(FORMS))), 0.7]
    days = [range(FORMS[name][2]) for name in [*FORMS, "langya"]]
    means = np.array(
        [
            np.mean([current(a, day, depth, latitude, longitude) for day in of], axis=0)
            for a, of in zip(amplitudes, days, strict=True)
        ]
    )
    now = [2] * len(FORMS) + [5]
    expected = np.array(
        [
            current(a, day, depth, latitude, longitude)
            for a, day in zip(amplitudes, now, strict=True)
        ]
    )
    np.testing.assert_allclose(
        np.stack(true_components(read), axis=1)[:, :, 1, j, i],
        expected - means + means.mean(axis=0),
        atol=2e-4,
    )
