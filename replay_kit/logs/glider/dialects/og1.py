"""OceanGliders OG1, as of seagliderOG1, VOTO, BODC and Spray."""

from replay_kit.logs.glider.dialect import Dialect

DIALECT = Dialect(
    "og1",
    "OceanGliders OG1",
    "time latitude longitude profile_number|divenum|dive_number phase|trajectory",
    {
        "time": "time",
        "longitude": "longitude",
        "latitude": "latitude",
        # not depth_z, which has the standard name of a depth and the sign of a height
        "depth": "depth glider_depth",
        "pressure": "pres pressure",
        "heading": "heading glider_heading",
        "pitch": "pitch glider_pitch",
        "roll": "roll glider_roll",
        "dive": "dive_number divenum",
        "gps_time": "time_gps",
        "gps_longitude": "longitude_gps",
        "gps_latitude": "latitude_gps",
        "end_time": "time_gps_end",
        "end_longitude": "longitude_gps_end",
        "end_latitude": "latitude_gps_end",
        "end_flag": "gps_end_qc",
        "gps_flag": "gps_start_qc latitude_gps_qc",
        "dac_east": "davg_curr_east watercurrents_u wcur_x water_velocity_eastward",
        "dac_north": "davg_curr_north watercurrents_v wcur_y water_velocity_northward",
        "dac_time": "time_uv",
        "dac_longitude": "longitude_uv",
        "dac_latitude": "latitude_uv",
        "dac_flag": "davg_curr_east_qc wcur_qc watercurrents_u_qc",
    },
    convention="OG-1",
    heading="magnetic",
)
