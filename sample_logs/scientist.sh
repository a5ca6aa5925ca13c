# The first block of SCIENTIST.md: from the folder of the project, sh sample_logs/scientist.sh
set -e
python sample_logs/make_example_data.py year
replay-kit info year/og1.nc
replay-kit replay year/og1.nc --ensemble year/ocean_a.nc --against year/ocean_b.nc --against year/ocean_c.nc --modes 60 -o year/mission.mcap --report
replay-kit plot year/mission.mcap section -o year/section.pdf
replay-kit export year/mission.mcap --table track -o year/track.nc
replay-kit export year/mission.mcap --table dives -o year/dives.csv
