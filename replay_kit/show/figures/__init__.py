"""Figures as data, and the back end that draws them for pages and papers."""
