"""Where the files are that tests read: the project itself, its samples, and the real data that may lie beside it."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SAMPLES = ROOT / "sample_logs"
#: real data; tests that need them skip, with a reason, where they are absent
DATA = ROOT.parent / "shared" / "data"
