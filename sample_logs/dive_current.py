"""A dive's current against the estimate: python sample_logs/dive_current.py RESULT.mcap [DIVE]."""

import sys

import replay_kit as rk
from replay_kit.results.views.contents import Contents
from replay_kit.show.export import TABLES

contents = Contents(rk.open_result(sys.argv[1]))
dives = TABLES["dives"](contents, ()).dropna(subset="dac_eastward_measured")
number = int(sys.argv[2]) if len(sys.argv) > 2 else int(dives["dive"].iloc[-1])
if number not in (known := dives["dive"].tolist()):
    sys.exit(f"dive {number} has no mean current; choose one of {', '.join(map(str, known))}")
(dive,) = dives[dives["dive"] == number].itertuples()
bins = TABLES["section"](contents, ())
print(f"dive {number}, {dive.start:%Y-%m-%d %H:%M} to {dive.end:%H:%M} UTC: current [cm/s]")
for kind in ("measured", "estimated"):
    means = (getattr(dive, f"dac_{axis}_{kind}") for axis in ("eastward", "northward"))
    print(f"  depth average, {kind:9}", *(f"{100 * mean:7.1f}" for mean in means))
within = bins[(bins["time"] >= dive.start) & (bins["time"] <= dive.end)]
for depth, layer in within.groupby(within["depth"] // 100 * 100):
    values = " ".join(
        f"{100 * layer[f'{axis}_{kind}'].mean():7.1f}"
        for kind in ("measured", "estimated")
        for axis in "uv"
    )
    print(f"  {depth:3.0f} to {depth + 100:3.0f} m, measured and estimated {values}")
