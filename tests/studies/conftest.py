"""A forecast that several studies leave members out of."""

import pytest

from tests import synthetic


@pytest.fixture(scope="module")
def ensemble(tmp_path_factory):
    path = tmp_path_factory.mktemp("ocean") / "ensemble.nc"
    synthetic.dataset(n_members=5, shape=(5, 6)).to_netcdf(path, engine="h5netcdf")
    return path
