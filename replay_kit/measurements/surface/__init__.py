"""Currents at the surface by radars and drifters, and what they show beyond an estimate."""
