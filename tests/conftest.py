"""What several tests share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


@pytest.fixture
def data_dir() -> Path:
    """Return the folder of recorded drives, or skip where there is none."""
    if "FGLOC_DATA" not in os.environ:
        pytest.skip("FGLOC_DATA is not set: recorded drives are not available")
    return Path(os.environ["FGLOC_DATA"])
