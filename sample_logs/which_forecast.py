"""Which forecast explains the mission: python sample_logs/which_forecast.py LOG ENSEMBLE...

The best one makes the measurements the most probable: its log-likelihood is the highest.
"""

import sys
from pathlib import Path

import replay_kit as rk
from replay_kit.estimator import build_estimator
from replay_kit.forecast import read_ensemble

log, forecasts, config = sys.argv[1], sys.argv[2:], rk.RunConfig()
found = []
for path in forecasts:
    estimator = build_estimator(read_ensemble(Path(path), config.forecast), config.estimator)
    measurements = [event for event in rk.observations(rk.open_log(log).messages()) if estimator.usable(event)]
    steps = [innovation for _, innovation in estimator.steps(estimator.initial(), measurements)]
    bins = sum(step.dof for step in steps)
    found.append((sum(step.log_likelihood for step in steps) / bins, sum(step.nis for step in steps) / bins, path))
print("log-likelihood a value   NIS per degree of freedom   forecast")
for likelihood, nis, path in sorted(found, reverse=True):
    print(f"{likelihood:22.3f}   {nis:25.2f}   {path}")
