"""SeaExplorer: raw files of the glider and its payload."""

from replay_kit.logs.glider.ad2cp import seaexplorer_pings
from replay_kit.logs.glider.dialect import Dialect

DIALECT = Dialect(
    "seaexplorer",
    "SeaExplorer raw",
    "timestamp|pld_realtimeclock lat|nav_latitude lon|nav_longitude",
    {
        "time": "timestamp pld_realtimeclock",
        "longitude": "lon nav_longitude",
        "latitude": "lat nav_latitude",
        "depth": "depth nav_depth",
        "heading": "heading",
        "pitch": "pitch",
        "roll": "roll",
        "declination": "declination",
        "dead_reckoning": "deadreckoning",
        "nav_state": "navstate nav_resource",
    },
    units={
        **dict.fromkeys(("longitude", "latitude"), "nmea"),
        **dict.fromkeys(("heading", "pitch", "roll", "declination"), "degrees"),
        "depth": "m",
    },
    beside=("ad2cp_",),
    pings=seaexplorer_pings,
    in_parts=True,
)
