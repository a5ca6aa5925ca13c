"""The region, what lies in the way, and the search of a first route."""
