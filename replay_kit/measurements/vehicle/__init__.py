"""The vehicle's position, depth and motion."""
