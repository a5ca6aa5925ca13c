"""A result as files of other programs: NetCDF, CSV, KML and GeoJSON."""
