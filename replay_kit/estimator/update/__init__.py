"""Update of the estimate by observations."""
