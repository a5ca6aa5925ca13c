"""Variables of a Seaglider basestation NetCDF file as float64 arrays in SI units, one file a dive.

What the files do not state, and how it was determined:

* ``ad2cp_velX, velY, velZ`` are not along the instrument's axes: the basestation takes them as east, north and up as the
  instrument reports them, and on real dives velZ equals the vertical speed from pressure at pitches of 35 degrees. East and
  north are by the instrument's own compass: they lag the track by the declination, which is thus not applied.
* The first cell's centre is one blanking and one cell from the instrument, which looks up.
* ``ad2cp_soundspeed`` is in tenths of m/s and ``ad2cp_temperature`` in tenths of a degree, whatever their units attribute states.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray
from scipy.io import netcdf_file

from replay_kit.core.arrays import Array
from replay_kit.core.errors import LogError

_EXPECTED = ("log_gps_time", "log_gps_lat", "log_gps_lon")
_EPOCHS = ("seconds since 1970-1-1 00:00:00", "seconds since 1970-01-01 00:00:00", "seconds since 1970-01-01t00:00:00z")
_METRES = {"m": 1.0, "meter": 1.0, "meters": 1.0, "cm": 0.01, "mm": 0.001}
_FASTEST_SOUND = 2000.0  # m/s; more than this is stated in tenths


# A file holds a thousand variables of the vehicle's engineering; these are read.
_WANTED = ("log_gps_", "log_dive", "ad2cp_", "ctd_time", "ctd_depth", "latitude", "longitude", "depth_avg_curr_", "magnetic_variation")
_ATTRIBUTES = ("units", "_FillValue", "missing_value")
_NO_VARIABLE = "This is a netCDF dimension but not a netCDF variable"  # what NetCDF names a dataset that holds a dimension's length alone


@dataclass(frozen=True, slots=True, eq=False)
class Stored:
    """A variable as stored: nothing decoded, nothing masked.

    Attributes:
        values: Of any shape and type.
        attributes: By name; those of ``_ATTRIBUTES`` that there are, and maybe more.
    """

    values: NDArray[Any]
    attributes: Mapping[str, Any]


@dataclass(frozen=True, slots=True, eq=False)
class DiveFile:
    """The variables of one dive.

    Attributes:
        path: The file.
        variables: Those that a log needs, by name.
        dive_number: As the file's attributes state; None when they do not.
    """

    path: Path
    variables: Mapping[str, Stored]
    dive_number: int | None

    @property
    def dive(self) -> int:
        """Number of the dive; 0 when the file does not state it."""
        return self.dive_number if self.dive_number is not None else int(np.nan_to_num(self.scalar("log_dive")))

    def has(self, *names: str) -> bool:
        """Return whether all these variables are in the file."""
        return all(name in self.variables for name in names)

    def array(self, name: str) -> Array:
        """Return a variable as stored, NaN where it has its fill value."""
        variable = self.variables[name]
        values = np.array(variable.values, dtype=np.float64)
        fill = variable.attributes.get("_FillValue", variable.attributes.get("missing_value"))
        if fill is not None:
            values[values == float(np.ravel(fill)[0])] = np.nan
        return values

    def scalar(self, name: str) -> float:
        """Return a number; NaN when the file has none."""
        if not self.has(name):
            return float("nan")
        values = self.array(name).ravel()
        return float(values[0]) if values.size else float("nan")

    def time_ns(self, name: str) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Return times to the millisecond [ns, UTC], and whether each is known.

        Raises:
            LogError: The variable's unit is not seconds since 1970.
        """
        units = self._text_attribute(name, "units")
        if units.lower() not in _EPOCHS:
            raise LogError(f"{self.path}: {name}: expected units '{_EPOCHS[0]}', got '{units}'; process the dive again")
        seconds = self.array(name)
        known = np.isfinite(seconds) & (seconds > 0.0)
        milliseconds = np.round(np.where(known, seconds, 0.0) * 1000.0).astype(np.int64)
        return milliseconds * 1_000_000, known

    def metres(self, name: str) -> float:
        """Return a length [m], converted from the unit that the file states.

        Raises:
            LogError: The unit is no length.
        """
        units = self._text_attribute(name, "units")
        if units not in _METRES:
            raise LogError(f"{self.path}: {name}: expected units of {', '.join(_METRES)}, got '{units}'; process the dive again")
        return self.scalar(name) * _METRES[units]

    def quality(self, name: str, count: int) -> list[int]:
        """Return quality flags of the basestation (1 good ... 4 bad, 9 missing); 0 where the file has none."""
        if not self.has(name):
            return [0] * count
        text = b"".join(np.ravel(self.variables[name].values).astype("S1").tolist()).decode("ascii", "replace")
        return [int(character) if character.isdigit() else 0 for character in text.ljust(count, "0")]

    def tenths(self) -> float:
        """Return the factor that turns the AD2CP's sound speed and temperature into m/s and degrees."""
        return 0.1 if self.scalar("ad2cp_soundspeed") > _FASTEST_SOUND else 1.0

    def _text_attribute(self, name: str, attribute: str) -> str:
        value: Any = self.variables[name].attributes.get(attribute, "")
        return value.decode() if isinstance(value, bytes) else str(value)


def open_dive(path: Path) -> DiveFile:
    """Return a dive's variables, loaded.

    Raises:
        LogError: The file cannot be read as NetCDF, or is no Seaglider's.
    """
    try:
        with open(path, "rb") as file:
            classic = file.read(3) == b"CDF"
        dive = _read_classic(path) if classic else _read_hdf5(path)
    except (OSError, ValueError, KeyError, TypeError, RuntimeError, IndexError) as error:
        raise LogError(f"{path}: cannot be read as NetCDF: {error}; is the file whole?") from error
    missing = [name for name in _EXPECTED if name not in dive.variables]
    if missing:
        raise LogError(
            f"{path}: expected a Seaglider basestation file with {', '.join(_EXPECTED)}, it lacks {', '.join(missing)}; "
            "a forecast is given with --ensemble, not as a log"
        )
    return dive


def _read_hdf5(path: Path) -> DiveFile:
    # neither through xarray nor through h5netcdf, which look up the dimensions of each of the thousand variables: ten times as long
    with h5py.File(path, "r") as file:
        stored = {name: file[name] for name in file if name.startswith(_WANTED)}
        variables = {
            name: Stored(np.asarray(variable[...]), {key: _plain(variable.attrs[key]) for key in _ATTRIBUTES if key in variable.attrs})
            for name, variable in stored.items()
            if isinstance(variable, h5py.Dataset) and not str(_plain(variable.attrs.get("NAME", ""))).startswith(_NO_VARIABLE)
        }
        number = file.attrs.get("dive_number")
    return DiveFile(path, variables, None if number is None else int(_plain(number)))


def _plain(value: Any) -> Any:
    """Return an attribute of HDF5 as NetCDF means it: an array of one is that one, and bytes are text."""
    value = np.ravel(value)[0] if np.size(value) == 1 else value
    return value.decode() if isinstance(value, bytes) else value


def _read_classic(path: Path) -> DiveFile:
    # the private mapping is the only one that tells attributes from methods
    with netcdf_file(path, "r", mmap=False) as file:
        stored = {name: variable for name, variable in file.variables.items() if name.startswith(_WANTED)}
        variables = {name: Stored(np.array(variable.data), dict(variable._attributes)) for name, variable in stored.items()}
        number = file._attributes.get("dive_number")
    return DiveFile(path, variables, None if number is None else int(number))
