"""Twin experiments: logs of simulated vehicles in a known current, and the synthetic ensemble of the samples."""
