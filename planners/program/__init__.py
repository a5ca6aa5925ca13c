"""Nonlinear program of a mission: initial guesses, CasADi graph, half-planes and outer iterations."""
