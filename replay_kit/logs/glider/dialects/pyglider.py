"""pyglider's time series, L0."""

from replay_kit.logs.glider.dialect import Dialect

DIALECT = Dialect(
    "pyglider",
    "pyglider time series (L0)",
    "time latitude longitude profile_index|profile_num|dive_num",
    {
        "time": "time",
        "longitude": "longitude",
        "latitude": "latitude",
        "depth": "depth",
        "pressure": "pressure",
        "heading": "heading",
        "pitch": "pitch",
        "roll": "roll",
        "declination": "declination",
        "dive": "dive_num",
        "dead_reckoning": "dead_reckoning",
        "nav_state": "nav_state",
        "dac_east": "water_velocity_eastward u",
        "dac_north": "water_velocity_northward v",
    },
)
