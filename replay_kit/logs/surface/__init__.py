"""Currents at the surface: HF radar, total vectors on a grid and radials of single stations; and drifters."""
