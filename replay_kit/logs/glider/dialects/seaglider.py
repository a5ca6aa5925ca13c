"""Seaglider: the files of its basestation, with or without an ADCP."""

from replay_kit.logs.glider.dialect import Dialect
from replay_kit.logs.glider.seaglider import seaglider_pings

DIALECT = Dialect(
    "seaglider",
    "Seaglider basestation",
    "log_gps_time log_gps_lat log_gps_lon",
    {
        "time": "ctd_time time",
        "longitude": "longitude",
        "latitude": "latitude",
        "depth": "ctd_depth depth",
        "declination": "magnetic_variation",
        "gps_time": "log_gps_time",
        "gps_longitude": "log_gps_lon",
        "gps_latitude": "log_gps_lat",
        "gps_error": "log_gps_hpe",
        "gps_flag": "log_gps_qc",
        "dac_east": "depth_avg_curr_east",
        "dac_north": "depth_avg_curr_north",
        "dac_error": "depth_avg_curr_error",
        "dac_flag": "depth_avg_curr_qc",
    },
    flag_meanings="3 QC_PROBABLY_BAD 4 QC_BAD 6 QC_UNSAMPLED 9 QC_MISSING",
    heading="magnetic",
    beside=("ad2cp_", "log_dive"),
    dac_kind="hydrodynamic_model",
    pings=seaglider_pings,
)
