"""Files that a mission is planned on: no-go areas and the depth of the bottom."""

import json

import numpy as np
import pytest
import xarray as xr

from replay_kit.core.errors import ForecastError, PlanError
from replay_kit.workflows.planning.areas import read_areas
from replay_kit.workflows.planning.bathymetry import read_bathymetry
from tests.planners.flow_samples import still_flow


def test_files_that_hold_no_areas_or_depths(tmp_path):
    for text in (
        "{}",
        "[1]",
        '{"type": "Feature", "geometry": {"type": "Point", "coordinates": [1, 2]}}',
    ):
        path = tmp_path / "areas.geojson"
        path.write_text(text)
        with pytest.raises(PlanError, match="expected GeoJSON"):
            read_areas(path)
    path.write_bytes(b"\x89" + bytes(1000))
    with pytest.raises(PlanError, match="expected GeoJSON") as told:
        read_areas(path)
    assert len(str(told.value)) < 400
    polygon = {"type": "Polygon", "coordinates": [[[1, 2], [2, 2], [2, 3]]]}
    for value, below in ((True, True), (0, False), (None, False)):
        path.write_text(
            json.dumps(
                {"type": "Feature", "properties": {"surface_only": value}, "geometry": polygon}
            )
        )
        assert read_areas(path)[0].surface_only == below
    path.write_text(
        json.dumps(
            {"type": "Feature", "properties": {"surface_only": "false"}, "geometry": polygon}
        )
    )
    with pytest.raises(PlanError, match="neither true nor false"):
        read_areas(path)
    xr.Dataset({"speed": (("y", "x"), np.zeros((2, 2)))}).to_netcdf(
        tmp_path / "other.nc", engine="h5netcdf"
    )
    with pytest.raises(ForecastError, match="expected one of"):
        read_bathymetry(tmp_path / "other.nc", still_flow().grid)
    with pytest.raises(ForecastError, match="cannot read"):
        read_bathymetry(tmp_path / "missing.nc", still_flow().grid)
