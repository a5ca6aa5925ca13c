"""The values of a forecast's depth axis in metres, by the unit that the file states."""

import gsw
import numpy as np
import xarray as xr

from replay_kit.core.arrays import Array
from replay_kit.core.errors import ForecastError

# Names of units in any case, symbols as UDUNITS has them: there "M" and "K" begin other units. A foot is the international one.
_NAMES = {
    **dict.fromkeys(("metre", "metres", "meter", "meters"), 1.0),
    **dict.fromkeys(("kilometre", "kilometres", "kilometer", "kilometers"), 1e3),
    **dict.fromkeys(("centimetre", "centimetres", "centimeter", "centimeters"), 1e-2),
    **dict.fromkeys(("foot", "feet"), 0.3048),
}
_SYMBOLS = {"m": 1.0, "km": 1e3, "cm": 1e-2, "ft": 0.3048}
_PRESSURES = ("dbar", "dbars", "decibar", "decibars")
# Units and standard names (CF conventions, appendix D) of axes that number or scale the levels and hold no depth.
_DIMENSIONLESS = ("1", "level", "levels", "layer", "layers", "sigma", "sigma_level", "model_level", "model_levels")
_PARAMETRIC = (
    "model_level_number",
    "ocean_sigma_coordinate",
    "ocean_sigma_z_coordinate",
    "ocean_double_sigma_coordinate",
    "ocean_s_coordinate",
    "ocean_s_coordinate_g1",
    "ocean_s_coordinate_g2",
)
_WANTED = "expected m, km, cm, ft or dbar"
_CONVERT = "convert the axis to metres, and set its attribute units to m"


def in_metres(axis: xr.DataArray, latitude: float, where: str) -> tuple[Array, tuple[str, ...]]:
    """Return the values of a depth axis in metres, with the file's own sign, and what a user should know of how they were read.

    Args:
        axis: The coordinate, shape (Z,). Pressures are converted with TEOS-10 (``gsw.z_from_p``); an axis without a unit is taken to be
            in metres.
        latitude: Of the region's middle [degrees north], for pressures.
        where: The file, for messages.

    Raises:
        ForecastError: The unit is not known, or the axis numbers levels, or scales them to the water's depth.
    """
    values = axis.values.astype(np.float64)
    unit = str(axis.attrs.get("units", "")).strip()
    length = _SYMBOLS.get(unit, _NAMES.get(unit.lower()))
    if length is not None:
        return values * length, ()
    if unit.lower() in _PRESSURES:
        # a file that counts upwards has negative pressures; TEOS-10 counts heights
        depths = np.sign(values) * np.abs(gsw.z_from_p(np.abs(values), latitude))
        note = f"coordinate {axis.name} is in {unit}: converted to metres with TEOS-10 at latitude {latitude:.2f}"
        return np.asarray(depths, dtype=np.float64), (note,)
    standard_name = str(axis.attrs.get("standard_name", ""))
    if unit.lower() in _DIMENSIONLESS or standard_name in _PARAMETRIC or (not unit and "formula_terms" in axis.attrs):
        stated = f"units '{unit}'" if unit else "no units"
        if standard_name:
            stated += f" and standard name {standard_name}"
        raise ForecastError(
            f"{where}: coordinate {axis.name} has {stated}, so it holds model levels and no depths; {_WANTED}: interpolate the current to "
            "fixed depths in metres"
        )
    if unit:
        raise ForecastError(f"{where}: coordinate {axis.name} is in '{unit}'; {_WANTED}: {_CONVERT}")
    return values, (f"coordinate {axis.name} states no unit and was taken to be in metres",)
