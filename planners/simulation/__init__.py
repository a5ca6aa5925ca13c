"""Simulated flights of a vehicle in one or more currents."""
