"""Basis flows of an ensemble and the weights of its members."""
