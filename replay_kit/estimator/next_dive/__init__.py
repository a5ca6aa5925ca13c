"""The mean current of a vehicle's next dive, and so where it surfaces, from the dives before it."""
