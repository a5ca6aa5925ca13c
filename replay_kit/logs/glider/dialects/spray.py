"""Spray: dives in bins, as CUGN publishes them."""

from replay_kit.logs.glider.dialect import Dialect
from replay_kit.logs.glider.dialects.gliderdac import UV

DIALECT = Dialect(
    "spray",
    "Spray, binned (CUGN)",
    "time lat lon depth u|u_depth_mean u_depth_mean|mission_name|mission_profile|trajectory_index",
    {
        "time": "time",
        "longitude": "lon",
        "latitude": "lat",
        "profile_depth": "depth",
        "profile_east": "u",
        "profile_north": "v",
        **UV,
        "dac_east": "u_depth_mean",
        "dac_north": "v_depth_mean",
        "dac_flag": "",
    },
    ascent_share=0.75,
)
