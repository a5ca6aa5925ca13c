"""Values that flow from a log to a plan, and the geometry and statistics that all stages share."""
