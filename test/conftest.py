"""Fixtures that every test folder shares."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of public recordings; skips where it is not at hand."""
    folder = Path(os.environ.get("JOINTEST_SHARED", PROJECT.parent / "shared")) / "data"
    if not folder.is_dir():
        pytest.skip(f"no recordings in {folder} (set JOINTEST_SHARED)")
    return folder
