"""The search for the best number of legs: the earliest arrival, routes, legs along them."""
