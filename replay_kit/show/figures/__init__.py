"""Figures as values, and the back end that draws them on pages and for papers."""
