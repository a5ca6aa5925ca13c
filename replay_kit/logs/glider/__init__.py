"""Gliders' NetCDF files."""
