"""What the tests share."""

import pytest

# A short insertion with the fast sensor: some seconds of computing become tenths.
QUICK = {"target.depth_mm": 15, "target.offset_mm": 0.5, "run.sensor": "shape"}


@pytest.fixture
def quick():
    return dict(QUICK)
