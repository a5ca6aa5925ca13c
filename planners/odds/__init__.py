"""Odds of a plan, from simulated flights in samples of the estimate."""
