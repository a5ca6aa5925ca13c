"""The currents that a glider is flown in, its legs, and a pilot who corrects them."""
