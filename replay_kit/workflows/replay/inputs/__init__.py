"""Inputs of a replay: job, scanned logs, part of the forecast, estimator, and their record in the result."""
