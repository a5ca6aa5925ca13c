"""IOOS GliderDAC v2 and v3: a file a profile."""

from replay_kit.logs.glider.dialect import Dialect

#: A profile's means have one name in all files that follow the IOOS template.
UV = {
    "dac_east": "u",
    "dac_north": "v",
    "dac_time": "time_uv",
    "dac_longitude": "lon_uv",
    "dac_latitude": "lat_uv",
    "dac_flag": "u_qc",
}
DIALECT = Dialect(
    "gliderdac",
    "IOOS GliderDAC",
    "time lat lon profile_id profile_time|time_uv",
    {
        "time": "time",
        "longitude": "lon",
        "latitude": "lat",
        "depth": "depth",
        "pressure": "pressure",
        **UV,
    },
    in_parts=True,
)
