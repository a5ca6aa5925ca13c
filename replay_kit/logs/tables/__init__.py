"""A topic's messages to tables of rows in SI units."""
