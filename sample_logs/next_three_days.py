"""Where to go in the next three days: python sample_logs/next_three_days.py RESULT.mcap LON,LAT,DEPTH...

A mission of dives to each goal, and how well the current is known there: an error of 0.1 m/s moves a glider by 26 km in three days.
"""

import sys

import replay_kit as rk

result = rk.open_result(sys.argv[1])
last, now, estimate = result.fixes.iloc[-1], result.fixes.index[-1], result.estimate
start = last["longitude"], last["latitude"], 0.0
settings = {
    "planner": {"kind": "mission", "depth": 300, "max_duration": 3 * 86400.0, "surface_time": 600}
}
print(f"{'goal':23} plan         hours  misses by [km]  steer [deg]  standard error there [m/s]")
for text in sys.argv[2:]:
    goal = tuple(float(number) for number in text.split(","))
    plan = rk.plan(estimate, start, goal, time=now, settings=settings)
    known = estimate.velocity_at(*goal)
    error = (0.5 * (known.u_standard_error**2 + known.v_standard_error**2)) ** 0.5
    miss = plan.closest_approach / 1e3
    print(
        f"{text:23} {plan.status:12} {plan.duration / 3600:5.1f}  {miss:14.1f}  {plan.heading_deg:11.0f}  {error:26.3f}"
    )
