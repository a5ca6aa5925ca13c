"""Global forecasts that are free, in the forms that their producers publish, as the members of one ensemble."""

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from tests.forecast import forms
from tests.forecast.forms import noted, read_with, true_components

#: Spacing [degrees], type of values, days, deepest level, names of the axes, first day.
PRODUCTS = {
    "glo12": (1 / 12, "f4", 10, 743.6, ("latitude", "longitude"), 3),
    "langya": (1 / 12, "f4", 7, 541.1, ("latitude", "longitude"), 3),
    "glonet": (1 / 20, "f8", 10, 1245.0, ("lat", "lon"), 3),
    "hclimrep": (1 / 20, "f4", 10, 541.1, ("latitude", "longitude"), 3),
    "langya_earlier": (1 / 12, "f4", 7, 541.1, ("latitude", "longitude"), 1),
}
_LEVELS = (0.494, 47.37, 92.33, 155.85, 318.13, 541.1)
DAY = 5


def strength(number, day):
    """The factor of the known field in a product on a day."""
    return (0.5 + 0.3 * number) * (1.0 + 0.1 * day * (1 + number % 2))


def test_products_and_an_earlier_start_of_one_are_members_on_the_grid_of_the_first(tmp_path):
    means, now, paths = [], [], []
    for k, (name, (step, kind, days, deepest, axes, first)) in enumerate(PRODUCTS.items()):
        at = forms.lonlat(-21.5, 36.0, (round(1.2 / step), round(1.5 / step)), step)
        levels = np.unique([*_LEVELS, deepest]).astype("f4")
        one = forms.known(at, levels).isel(member=0, drop=True)
        dates = range(first, first + days)
        ds = forms.in_turn(
            [one * strength(k, day) for day in dates],
            np.array([f"2024-01-{day:02d}" for day in dates], "M8[ns]"),
        )
        ds = ds.rename(dict(zip(("latitude", "longitude"), axes, strict=True))).astype(kind)
        paths.append(tmp_path / f"{name}.{'zarr' if k == 3 else 'nc'}")
        if k == 3:
            ds.to_zarr(paths[-1], consolidated=True, zarr_format=2)
        else:
            ds.to_netcdf(paths[-1], engine="h5netcdf")
        means.append(np.mean([strength(k, day) for day in dates]))
        now.append(strength(k, DAY))
    read = read_with(paths, members="models", time=f"2024-01-{DAY:02d}")
    assert read.made_from == "models"
    assert [name.split(".")[0] for name in read.members] == [*PRODUCTS]
    # half of the products end above the last level of the first
    assert_array_equal(read.grid.wet.any(axis=(1, 2)), read.grid.levels < 600.0)
    assert noted(read, f"over its times was replaced by that of all {len(PRODUCTS)} models")
    factors = (np.array(now) - means + np.mean(means))[:, None, None, None]
    inner = np.s_[:, :-1, 2:-2, 2:-2]
    depth = read.grid.levels[:, None, None]
    known = forms.truth(read.grid.longitude, read.grid.latitude, depth)
    for component, expected in zip(true_components(read), known, strict=True):
        assert_allclose(component[inner], (factors * expected)[inner], atol=2e-3)
