"""Commands keep numpy's matrix products to one thread; the estimators in a user's own program change nothing."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[1]


@pytest.mark.parametrize(
    ("imports", "given", "expected"),
    [
        ("jointest_ros.cli.main", None, "1"),
        ("jointest_ros.nodes", None, "1"),
        ("jointest_ros.nodes", "3", "3"),  # the user knows better
        ("numpy, jointest_ros.nodes", None, "None"),  # too late to be of use, and others would inherit it
        ("jointest_ros.core.catalogue", None, "None"),
    ],
)
def test_one_thread_for_matrices(imports: str, given: str | None, expected: str) -> None:
    environment = os.environ | {"PYTHONPATH": str(PROJECT)}
    environment.pop("OPENBLAS_NUM_THREADS", None)
    if given:
        environment["OPENBLAS_NUM_THREADS"] = given
    code = f"import {imports}, os; print(os.environ.get('OPENBLAS_NUM_THREADS'))"
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == expected
