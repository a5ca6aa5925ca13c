"""Where the files are that tests read: the project itself, its samples, and the real data that may lie beside it."""

from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SAMPLES = ROOT / "sample_logs"
#: real data; tests that need them skip, with a reason, where they are absent
DATA = ROOT.parent / "shared" / "data"


def needs(path: Path) -> pytest.MarkDecorator:
    """Return the mark of tests that read a file or folder of the real data, and skip where it is absent."""
    return pytest.mark.skipif(not path.exists(), reason=f"{path} is not there")
