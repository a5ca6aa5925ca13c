"""NetCDF files of gliders."""
