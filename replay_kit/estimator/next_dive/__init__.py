"""Mean current and surfacing of a vehicle's next dive, predicted from earlier dives."""
