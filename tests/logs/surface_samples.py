"""Files of radars and drifters as tests need them: small, and wrong where asked."""

import numpy as np
import xarray as xr

_HEADER = """%CTF: 1.00
%FileType: LLUV rdls "RadialMap"
%Site: MADE ""
%TimeStamp: 2019 01 01  00 00 00
%TimeCoverage: 75.000 Minutes
%Origin:  {origin[1]}  {origin[0]}
%DopplerResolutionHzPerBin: 0.001953125
%TransmitCenterFreqMHz: 13.450000
%TableColumnTypes: {names}
%TableStart:
%%     (deg)       (deg)     (cm/s)   (cm/s)  (GridCode)  Quality  Quality (km)  (True)  ({unit})  (True)
"""
START = np.datetime64("2019-01-01T00:00:00", "ns")
_NAMES = "LOND LATD VELU VELV VFLG ESPC ETMP RNGE BEAR VELO HEAD"


def write_radials(path, current, origin=(152.0, -39.8), unit="cm/s", names=_NAMES, change=None):
    """Write the radials of a current, (east, north) [m/s], that a station sees on the eastern side; the last is over land.

    ``change`` takes the number of a radial and its columns, and returns columns that differ.
    """
    rows = []
    for k, (distance, bearing) in enumerate(np.ndindex(4, 21)):
        distance, bearing = 10.0 + 6.0 * distance, 40 + 5 * bearing
        angle, heading = np.deg2rad(bearing), (bearing + 180.0) % 360.0
        towards = np.deg2rad(heading)
        parallel = 111.32 * np.cos(np.deg2rad(origin[1]))
        row = {
            "LOND": origin[0] + distance * np.sin(angle) / parallel,
            "LATD": origin[1] + distance * np.cos(angle) / 111.0,
            "VELU": 0.0,
            "VELV": 0.0,
            "VFLG": 128 if k == 83 else 0,
            "ESPC": 999.0 if bearing == 40 else 4.0,
            "ETMP": 5.0,
            "RNGE": distance,
            "BEAR": bearing,
            "VELO": 100.0 * (current[0] * np.sin(towards) + current[1] * np.cos(towards)),
            "HEAD": heading,
        }
        row |= {} if change is None else change(k, row)
        rows.append(" " + " ".join(f"{row[name]:.10g}" for name in names.split()))
    head = _HEADER.format(origin=origin, unit=unit, names=names)
    path.write_text(head + "\n".join(rows) + "\n%TableEnd:\n%%\n%TableType: rads rad1\n")


def totals(current, hours=3, west=152.0, south=-40.0):
    """Return hourly totals of a current (east, north) [m/s], with one vector of questionable quality and one missing."""
    shape = (hours, 1, 12, 14)
    u, v = (np.full(shape, 100.0 * each) for each in current)
    error = np.full(shape, 0.25)
    error[:, :, 0, 0] = 0.9
    u[:, :, 0, 1] = np.nan
    dims = ("time", "z", "lat", "lon")
    held = {"u": (u, "cm/s"), "v": (v, "cm/s"), "u_err": (error, "1"), "v_err": (error, "1")}
    variables = {name: (dims, values, {"units": unit}) for name, (values, unit) in held.items()}
    parameters = "parameters", [300.0, 2.0, 3.0, 0.02, 10.0, 10.0, 400.0, 66.0]
    axes = {
        "time": START + np.arange(hours) * np.timedelta64(1, "h"),
        "lat": south + 0.03 * np.arange(12),
        "lon": west + 0.03 * np.arange(14),
    }
    about = {"platform": "HF Radar 13 MHz Network"}
    return xr.Dataset(variables | {"processing_parameters": parameters}, axes, about)


def drifters(velocity=(0.2, 0.0), lost_after=99, west=152.1, south=-39.8):
    """Return the six-hourly track of one drifter with a current (east, north) [m/s], and of one that has lost its drogue."""
    seconds = 21600.0 * np.arange(9)
    east, north = (seconds * each for each in velocity)
    longitude = west + east / (111.32e3 * np.cos(np.deg2rad(south)))
    lost = [START + np.timedelta64(int(6 * lost_after), "h"), START - np.timedelta64(1, "D")]
    time = START + seconds.astype("timedelta64[s]")
    held = {
        "rowsize": ("traj", [9, 9]),
        "ID": ("traj", np.array([101, 102])),
        "drogue_lost_date": ("traj", np.array(lost)),
        "longitude": ("obs", np.tile(longitude, 2)),
        "latitude": ("obs", np.tile(south + north / 111.2e3, 2)),
    }
    return xr.Dataset(held, {"time": ("obs", np.tile(time, 2))})
