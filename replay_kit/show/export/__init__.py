"""Export of results to NetCDF, CSV, KML and GeoJSON."""
