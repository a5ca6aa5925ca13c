"""Files as others give them, made from the samples: python sample_logs/make_example_data.py FOLDER.

``forecast/`` has one file a day and no members, ``bottom.nc`` the depth of a bottom that rises to an island, ``dives/`` telemetry with a
file a day, ``og1.nc`` the same mission as a glider's file without an ADCP, ``ocean_a.nc``, ``ocean_b.nc``, ``ocean_c.nc`` three forecasts.
"""

import sys
from pathlib import Path

import numpy as np
import xarray as xr

import replay_kit as rk

SAMPLES = Path(__file__).parent
EPOCH = "seconds since 1970-01-01T00:00:00Z"
WEST, EAST, SOUTH, NORTH = 152.14, 152.19, -40.33, -40.31  # an island that rises from the bottom


def forecast(folder: Path) -> None:
    """Write the members as fields of 40 days, with land at the island."""
    folder.mkdir()
    fields = xr.open_dataset(SAMPLES / "ensemble.nc").drop_vars("time")[["uo", "vo"]]
    wet = (abs(fields["longitude"] - 152.18) > 0.05) | (abs(fields["latitude"] + 40.32) > 0.05)
    for k in range(fields.sizes["member"]):
        day = np.datetime64("2018-10-28", "ns") + np.timedelta64(k, "D")
        one = fields.isel(member=k, drop=True).where(wet).expand_dims(time=[day])
        one.to_netcdf(folder / f"ocean_{np.datetime_as_string(day, 'D')}.nc", engine="h5netcdf")


def bottom(path: Path) -> None:
    """Write a bottom at 900 m that rises by 100 m a kilometre to the island."""
    lon, lat = np.arange(151.4, 153.6, 0.02), np.arange(-40.5, -39.5, 0.02)
    off_east = 85.0 * np.maximum(np.maximum(WEST - lon, lon - EAST), 0.0)
    off_north = 111.0 * np.maximum(np.maximum(SOUTH - lat, lat - NORTH), 0.0)
    depth = np.minimum(900.0, 100.0 * np.hypot(off_east[None], off_north[:, None]))
    attributes = {"units": "m", "standard_name": "sea_floor_depth_below_geoid"}
    grid = xr.Dataset(
        {"deptho": (("latitude", "longitude"), depth, attributes)},
        {"longitude": lon, "latitude": lat},
    )
    grid.to_netcdf(path, engine="h5netcdf")


def dives(folder: Path) -> None:
    """Write the telemetry log in files of a day: its entries are 8 bytes of microseconds and a frame that states its length."""
    folder.mkdir()
    log, at, days = (SAMPLES / "glider.tlog").read_bytes(), 0, dict[int, bytes]()
    while at < len(log):
        end = at + 8 + 12 + log[at + 9]
        day = int.from_bytes(log[at : at + 8], "big") // 86_400_000_000
        days[day] = days.get(day, b"") + log[at:end]
        at = end
    for k, entries in enumerate(days.values(), start=1):
        (folder / f"day_{k}.tlog").write_bytes(entries)


def og1(path: Path) -> None:
    """Write fixes, track and mean currents of the dives in the form of OceanGliders."""
    rows = [
        (
            float(message.time_ns) / 1e9,
            message.payload["longitude"],
            message.payload["latitude"],
            -message.payload["altitude"],
        )
        for message in rk.open_log(SAMPLES / "glider.mcap").messages()
        if message.schema == "foxglove.LocationFix"
    ]
    time, longitude, latitude, depth = np.array(rows).T
    fixes, truth = depth == 0.0, xr.open_dataset(SAMPLES / "truth.nc")
    dive = np.cumsum(np.diff(fixes.astype(int), prepend=1) < 0)
    mean = {axis: np.full(time.size, np.nan) for axis in "uv"}
    for number in np.unique(dive[~fixes]):
        within = (dive == number) & ~fixes
        names = zip(
            ("longitude", "latitude", "depth"),
            (longitude, latitude, np.maximum(depth, 5.0)),
            strict=True,
        )
        where = {name: xr.DataArray(values[within], dims="row") for name, values in names}
        for axis in "uv":
            mean[axis][within] = float(truth[f"{axis}o"].interp(where).mean())
    only = np.where(fixes, 1.0, np.nan)
    columns = {
        "TIME": (time, EPOCH),
        "LONGITUDE": (longitude, "degrees_east"),
        "LATITUDE": (latitude, "degrees_north"),
        "DEPTH": (depth, "m"),
        "TIME_GPS": (time * only, EPOCH),
        "LONGITUDE_GPS": (longitude * only, "degrees_east"),
        "LATITUDE_GPS": (latitude * only, "degrees_north"),
        "DIVE_NUMBER": (dive.astype(np.float64), "1"),
        "WATERCURRENTS_U": (mean["u"], "m s-1"),
        "WATERCURRENTS_V": (mean["v"], "m s-1"),
    }
    variables = {
        name: (("N_MEASUREMENTS",), values, {"units": units})
        for name, (values, units) in columns.items()
    }
    xr.Dataset(variables, attrs={"Conventions": "CF-1.10, OG-1.0", "id": "walk"}).to_netcdf(
        path, engine="h5netcdf"
    )


def oceans(folder: Path) -> None:
    """Write three forecasts: a good one, one with half its currents, and one that lies 40 km too far west."""
    fields = xr.open_dataset(SAMPLES / "ensemble.nc")
    fields.to_netcdf(folder / "ocean_a.nc", engine="h5netcdf")
    (0.5 * fields).assign_attrs(fields.attrs).to_netcdf(folder / "ocean_b.nc", engine="h5netcdf")
    fields.roll(longitude=-4).to_netcdf(folder / "ocean_c.nc", engine="h5netcdf")


if __name__ == "__main__":
    where = Path(sys.argv[1])
    where.mkdir()
    forecast(where / "forecast")
    bottom(where / "bottom.nc")
    dives(where / "dives")
    og1(where / "og1.nc")
    oceans(where)
