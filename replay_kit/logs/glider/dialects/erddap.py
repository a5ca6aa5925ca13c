"""GliderDAC's profiles, aggregated by ERDDAP."""

from replay_kit.logs.glider.dialect import Dialect
from replay_kit.logs.glider.dialects.gliderdac import DIALECT as GLIDERDAC

DIALECT = Dialect(
    "erddap",
    "GliderDAC aggregated by ERDDAP",
    "time latitude longitude profile_id depth|precise_time",
    {
        **GLIDERDAC.names,
        # time, latitude and longitude are those of the profile, repeated at each of its samples
        "time": "precise_time time",
        "longitude": "precise_lon longitude",
        "latitude": "precise_lat latitude",
        "dac_longitude": "longitude_uv lon_uv",
        "dac_latitude": "latitude_uv lat_uv",
    },
)
