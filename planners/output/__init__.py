"""Plans as tables, waypoint files and GeoJSON."""
