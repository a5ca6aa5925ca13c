"""Basis flows, and what an observation measures of them."""
