"""Baselines: other estimators with the estimator's own interface, to compare with and to replay with."""
