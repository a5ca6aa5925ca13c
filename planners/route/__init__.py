"""The region, what lies in the way, and the flow in a table."""
