"""Twin experiments: logs of simulated vehicles in a known current, and the synthetic ensemble that the samples come from."""
