"""Twin logs with a fault planted in their messages, as a careless logger would have written them."""

import numpy as np
import xarray as xr

DECLINATION = 14.0


def _turned(degrees):
    """Return the matrix that turns a velocity (east, north) clockwise."""
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return [c, s], [-s, c]


def _ping(matrix=((1, 0), (0, 1)), **more):
    """Return a fault of a ping: a matrix on its velocities, other fields."""

    def changed(payload):
        velocity = [
            [None] * 3 if cell[0] is None else [*(np.array(matrix) @ cell[:2]).tolist(), None]
            for cell in payload["velocity"]
        ]
        return {**payload, "velocity": velocity, **more}

    return changed


PINGS = {
    "sound": _ping(),
    "east and north are exchanged": _ping([[0, 1], [1, 0]]),
    "the sign of east is wrong": _ping([[-1, 0], [0, 1]]),
    "the sign of north is wrong": _ping([[1, 0], [0, -1]]),
    "both signs are wrong": _ping([[-1, 0], [0, -1]]),
    "the declination was not applied": _ping(_turned(-DECLINATION)),
    "the declination was applied twice": _ping(_turned(DECLINATION)),
    "speeds are in cm/s": _ping([[100, 0], [0, 100]]),
    "the sign of depth is wrong: pressure": lambda p: {
        **p,
        "pressure": -p["pressure"],
        "orientation": "up",
    },
    "the sign of depth is wrong: orientation": _ping(orientation="up"),
}
NAMES = {name: name.split(":")[0].split(",")[0] for name in PINGS}
NAMES["both signs are wrong"] = "turned by +180 degrees clockwise, both signs wrong"


def in_centimetres(ensemble, out):
    """Write a forecast whose speeds are in cm/s although it says m/s."""
    with xr.open_dataset(ensemble) as ds:
        scaled = ds.copy()
        for name, values in ds.data_vars.items():
            if values.ndim >= 3:
                scaled[name] = (100.0 * values).assign_attrs(values.attrs)
        scaled.to_netcdf(out, engine="h5netcdf")


def planted(messages, fault):
    """Yield a twin's messages with a fault planted in its pings, which all state the declination."""
    for message in messages:
        if message.schema == "replay_kit.AdcpPing":
            payload = {**message.payload, "magnetic_declination": DECLINATION}
            yield message._replace(payload=PINGS[fault](payload))
        else:
            yield message
