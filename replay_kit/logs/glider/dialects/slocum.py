"""Slocum: NetCDF with the glider's own names, as of dbd2netcdf and xarray-dbd."""

from replay_kit.logs.glider.dialect import Dialect

DIALECT = Dialect(
    "slocum",
    "Slocum, exported with the glider's own names",
    "m_present_time|sci_m_present_time m_lat|m_gps_lat",
    {
        "time": "m_present_time sci_m_present_time",
        "longitude": "m_lon",
        "latitude": "m_lat",
        "depth": "m_depth",
        "pressure": "sci_water_pressure m_pressure",
        "heading": "m_heading",
        "pitch": "m_pitch",
        "roll": "m_roll",
        "declination": "m_gps_mag_var",
        "gps_longitude": "m_gps_lon",
        "gps_latitude": "m_gps_lat",
        "dac_east": "m_final_water_vx m_water_vx m_initial_water_vx",
        "dac_north": "m_final_water_vy m_water_vy m_initial_water_vy",
    },
    units={
        **dict.fromkeys(("longitude", "latitude", "gps_longitude", "gps_latitude"), "nmea"),
        **dict.fromkeys(("heading", "pitch", "roll", "declination"), "rad"),
        "pressure": "bar",
    },
)
