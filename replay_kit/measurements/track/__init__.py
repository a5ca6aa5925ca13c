"""The vehicle: positions, depths, dives and surfacings."""
