"""Figures as values, and the two backends that draw them: on a page with plotly, in print with matplotlib."""
