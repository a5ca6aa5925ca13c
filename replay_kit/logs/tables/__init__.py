"""Messages of a topic as tables of rows in SI units."""
