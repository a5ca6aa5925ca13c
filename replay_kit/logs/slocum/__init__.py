"""Slocum's binary files: a header, a list of sensors and cycles; raw or compressed."""
