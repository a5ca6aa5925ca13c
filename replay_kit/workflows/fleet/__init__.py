"""Fleets: a table of missions in, one result each and a common table and page out, on one machine or a cluster."""
