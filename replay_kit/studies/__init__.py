"""Studies of the estimator and the planners on simulated data with a known truth, and on the dives of real logs."""
