"""One known field on terrain-following levels, as ROMS and CROCO write it."""

import numpy as np
import pytest

from replay_kit.config.run import ForecastConfig
from replay_kit.core.errors import ForecastError
from replay_kit.forecast import read_ensemble
from tests.forecast import forms
from tests.forecast.forms import N_MEMBERS
from tests.forecast.test_forms import save, true_components


@pytest.mark.parametrize("transform", [1, 2])
@pytest.mark.parametrize("packed", [False, True])
def test_roms_at_44_degrees_on_terrain_following_levels(tmp_path, transform, packed):
    shape = (16, 18)
    at = forms.rotated(shape=shape, cell=0.02)
    made = [forms.roms(at, shape, member, transform, packed) for member in range(N_MEMBERS)]
    paths = [save(ds, tmp_path / f"his_mem{member:03d}.nc") for member, (ds, _) in enumerate(made)]
    levels = (5.0, 60.0, 150.0, 300.0)
    read = read_ensemble(paths, ForecastConfig(levels=levels))
    np.testing.assert_array_equal(read.grid.levels, levels)
    np.testing.assert_array_equal(read.grid.wet[0], made[0][1][1:-1, 1:-1] > 0.0)
    u, v = true_components(read)
    for member in range(N_MEMBERS):
        known = np.stack(
            forms.truth(
                read.grid.longitude, read.grid.latitude, read.grid.levels[:, None, None], member
            )
        )
        # away from land, where one face stands for two
        error = (np.stack([u[member], v[member]]) - known)[:, :, 4:, 5:]
        assert np.sqrt(np.mean(error**2)) < 0.01 * np.sqrt(np.mean(known**2))
    assert read.members == ("his_mem000.nc", "his_mem001.nc", "his_mem002.nc")


def test_levels_of_terrain_following_files_without_a_choice_are_those_of_the_deepest_column(
    tmp_path,
):
    shape = (8, 9)
    ds, _ = forms.roms(forms.rotated(shape=shape, cell=0.02), shape, 0)
    paths = [
        save(
            forms.roms(forms.rotated(shape=shape, cell=0.02), shape, k)[0], tmp_path / f"mem{k}.nc"
        )
        for k in (1, 2)
    ]
    read = read_ensemble(paths, ForecastConfig())
    s, c, h = ds["s_rho"].values, ds["Cs_r"].values, 400.0 + 10.0 * 7
    np.testing.assert_allclose(
        read.grid.levels, -np.sort(h * (20.0 * s + c * h) / (20.0 + h))[::-1]
    )
    with pytest.raises(
        ForecastError,
        match=r"s_rho numbers terrain-following levels, whose depths need hc, Vtransform too; give the file",
    ):
        read_ensemble(
            [
                save(ds.drop_vars(["hc", "Vtransform"]), tmp_path / f"r{k}_mem{k}.nc")
                for k in (1, 2)
            ],
            ForecastConfig(),
        )


def test_croco_without_an_epoch_and_with_zeros_on_land(tmp_path):
    shape = (10, 12)
    at = forms.rotated(20.0, shape=shape, cell=0.02)
    paths = []
    for member in range(2):
        ds, mask = forms.roms(at, shape, member)
        ds = ds.rename(Cs_r="Cs_rho", ocean_time="time").drop_vars(["mask_rho", "mask_u", "mask_v"])
        # CROCO has the rows of u and the columns of v on the centres' dimensions
        ds["u"] = ds["u"].rename(eta_u="eta_rho")
        ds["v"] = ds["v"].rename(xi_v="xi_rho")
        ds["Vtransform"] = 2.0
        ds["time"] = ("time", [86400.0], {"units": "second"})
        paths.append(save(ds, tmp_path / f"croco_mem{member}.nc"))
    read = read_ensemble(paths, ForecastConfig(levels=(60.0,)))
    np.testing.assert_array_equal(read.grid.wet[0], mask[1:-1, 1:-1] > 0.0)
    u, _ = true_components(read)
    east, _ = forms.truth(read.grid.longitude, read.grid.latitude, 60.0, 1)
    np.testing.assert_allclose(u[1, 0, 4:, 5:], east[4:, 5:], atol=2e-3)
    assert read.time_ns is None
    assert any("time has no dates (unit 'second')" in note for note in read.notes)
