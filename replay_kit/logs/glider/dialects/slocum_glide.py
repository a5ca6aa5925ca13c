"""slocum-glide's L2."""

from replay_kit.logs.glider.dialect import Dialect
from replay_kit.logs.glider.dialects.gliderdac import DIALECT as GLIDERDAC

DIALECT = Dialect(
    "slocum-glide",
    "slocum-glide (L2)",
    "time lat lon dive_id climb_id state",
    {
        **GLIDERDAC.names,
        "pitch": "pitch",
        "roll": "roll",
        "gps_time": "time_gps",
        "gps_longitude": "lon_gps",
        "gps_latitude": "lat_gps",
    },
)
