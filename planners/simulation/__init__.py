"""Flights of a vehicle in one current or in many."""
