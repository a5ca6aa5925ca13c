"""Fastest routes around obstacles, and lower bounds of a mission's time."""
