"""What the water does as a log comes in: python sample_logs/as_it_comes.py LOG FORECAST LON,LAT,DEPTH.

A robot's own loop feeds its messages instead of those of a log. At the surface, every three hours, it asks where to go next.
"""

import sys

import replay_kit as rk

log, goal = sys.argv[1], tuple(map(float, sys.argv[3].split(",")))
now, due_ns = rk.live(sys.argv[2]), 0
with rk.open_log(log) as reader:
    for message in reader.messages():
        now.feed([message])
        at = now.position
        if at is None or at.depth > 1.0 or message.time_ns < due_ns:
            continue
        due_ns = message.time_ns + 3 * 3600 * 10**9
        current = now.estimate.velocity_at(at.longitude, at.latitude, 100.0)
        plan = now.plan(goal)
        print(
            f"{at.longitude:8.3f} {at.latitude:7.3f}  at 100 m {current.u:+.2f} {current.v:+.2f} m/s  "
            f"steer {plan.heading_deg:3.0f} degrees ({plan.status})"
        )
for finding in now.findings:
    print(finding)
