"""How estimates compare with a truth: errors, calibration, bounds, intervals of medians."""
