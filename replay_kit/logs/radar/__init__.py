"""HF radar: total vectors on a grid, and radials of single stations."""
