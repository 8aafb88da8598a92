"""Fixtures that every test folder shares."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parent.parent

# For every test and the processes that it starts, before any ROS context is made: ROS stays on this host, in a domain
# of this process alone. Domains up to 101 have ports that no system takes for itself.
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_DOMAIN_ID"] = str(os.getpid() % 101 + 1)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What runs beside one another (pytest-xdist): files; but all that sends ROS messages is one lot."""
    for item in items:
        file = item.path.relative_to(PROJECT / "test")
        item.add_marker(pytest.mark.xdist_group("ros" if file.parts[0] in ("nodes", "launch") else str(file)))


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """The folder of public recordings; skips where it is not at hand."""
    folder = Path(os.environ.get("JOINTEST_SHARED", PROJECT.parent / "shared")) / "data"
    if not folder.is_dir():
        pytest.skip(f"no recordings in {folder} (set JOINTEST_SHARED)")
    return folder


@pytest.fixture(scope="session")
def finger_bag() -> Path:
    """15 s of the simulated finger at 100 Hz, shipped with the package."""
    return PROJECT / "bags" / "finger"


@pytest.fixture(scope="session")
def finger_config() -> Path:
    """The configuration of its robot."""
    return PROJECT / "config" / "finger.yaml"


@pytest.fixture(scope="session")
def gripper_config() -> Path:
    """The configuration of the simulated gripper."""
    return PROJECT / "config" / "softhand_gripper.yaml"
