"""Currents as speed and direction, as some products state them: read as components, value by value as they are asked for."""

from typing import Any

import numpy as np
import xarray as xr
from xarray.backends import BackendArray
from xarray.core import indexing

from replay_kit.core.quantities import metres_per_second

_SPEEDS = ("sea_water_speed", "sea_water_velocity_magnitude")
# where the current goes to, and where it comes from; the first is the older name of the second
_TO = ("sea_water_velocity_to_direction", "direction_of_sea_water_velocity")
_FROM = ("sea_water_velocity_from_direction",)
#: Standard names of the components that are made.
EAST, NORTH = "eastward_sea_water_velocity", "northward_sea_water_velocity"


class _Component(BackendArray):
    """A component of the current, computed of the part that is read."""

    def __init__(self, speed: xr.Variable, direction: xr.Variable, turn: float) -> None:
        """Remember the variables, of one shape; ``turn`` [degrees] is added to the direction, of which the cosine counts."""
        self._speed, self._direction, self._turn = speed, direction, turn
        self.shape, self.dtype = speed.shape, np.dtype(np.float64)

    def __getitem__(self, key: Any) -> Any:
        """Return a part, as xarray asks for it."""
        return indexing.explicit_indexing_adapter(
            key, self.shape, indexing.IndexingSupport.OUTER, self._part
        )

    def _part(self, key: tuple[Any, ...]) -> Any:
        speed, direction = (
            np.asarray(each[key].values, np.float64) for each in (self._speed, self._direction)
        )
        return speed * np.cos(np.deg2rad(direction + self._turn))


def with_components(ds: xr.Dataset) -> xr.Dataset:
    """Return a dataset with the components of a current that it states as speed and direction alone; else as it is."""
    stated = {
        str(variable.attrs.get("standard_name")): name for name, variable in ds.variables.items()
    }
    speed = next((stated[name] for name in _SPEEDS if name in stated), None)
    direction = next((stated[name] for name in (*_TO, *_FROM) if name in stated), None)
    if speed is None or direction is None or {EAST, NORTH} & stated.keys():
        return ds
    of, angle = ds[speed].variable, ds[direction].variable
    unit = str(angle.attrs.get("units", "degree")).lower()
    if (
        of.dims != angle.dims
        or not unit.startswith("deg")
        or metres_per_second(str(of.attrs.get("units", "m s-1"))) is None
    ):
        return ds
    back = 180.0 if angle.attrs["standard_name"] in _FROM else 0.0
    made = {}
    for name, turn in ((EAST, back - 90.0), (NORTH, back)):
        lazy = indexing.LazilyIndexedArray(_Component(of, angle, turn))
        about = {"standard_name": name, "units": of.attrs.get("units", "m s-1")}
        made[name] = xr.Variable(of.dims, lazy, about)
    return ds.assign(made).assign_attrs(replay_kit_polar=f"{speed} and {direction}")
