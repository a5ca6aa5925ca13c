"""Where a vehicle may not go: areas, the bottom, the edge of the forecast."""
