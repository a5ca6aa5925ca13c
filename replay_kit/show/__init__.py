"""Presentation of results: reports, status, figures, exports and the notebook interface."""
