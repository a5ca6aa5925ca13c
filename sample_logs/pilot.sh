# The block of PILOT.md: from the folder of the project, sh sample_logs/pilot.sh
set -e
python sample_logs/make_example_data.py walk
replay-kit info walk/dives --ensemble walk/forecast --members times:20d
replay-kit replay walk/dives --ensemble walk/forecast --members times:20d --bathymetry walk/bottom.nc --goal=152.06,-40.32,0 \
    --planner mission --depth 300 --samples 20 --levels 5,150,500 --modes 60 --follow --interval 1 --until-idle 1 -o walk/mission.mcap --report
replay-kit status walk/mission.mcap
replay-kit layout walk/mission.mcap -o walk/layout.json
