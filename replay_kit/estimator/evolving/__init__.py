"""The estimate through time: a forecast's own evolution, forgetting, oscillations and biases of the instrument."""
