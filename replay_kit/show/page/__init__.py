"""Sections of text and figures as one HTML page, for the reports of results and of studies alike."""
