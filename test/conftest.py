"""Fixtures that every test folder shares."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

PROJECT = Path(__file__).resolve().parent.parent

# For every test and the processes that it starts, before any ROS context is made: ROS stays on this host, in a domain
# of this process alone. Domains up to 101 have ports that no system takes for itself.
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ["ROS_DOMAIN_ID"] = str(os.getpid() % 101 + 1)
# Small matrices gain nothing by threads, which would take the cores from the other test process.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Property tests draw the same examples at every run, and may take what time a busy machine needs.
settings.register_profile("repeatable", derandomize=True, deadline=None)
settings.load_profile("repeatable")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """What runs beside one another (pytest-xdist): files; but all that sends ROS messages is one lot, and the first."""
    files = {item: item.path.relative_to(PROJECT / "test") for item in items}
    ros = {item: file.parts[0] in ("nodes", "launch") for item, file in files.items()}
    items.sort(key=lambda item: not ros[item])
    for item in items:
        item.add_marker(pytest.mark.xdist_group("ros" if ros[item] else str(files[item])))


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


@pytest.fixture(scope="session")
def cluster() -> Iterator[str]:
    """Address of a Dask cluster of two worker processes, which find this package and test/evaluation/parallel_jobs."""
    distributed = pytest.importorskip("distributed")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", os.pathsep.join(map(str, (PROJECT, PROJECT / "test" / "evaluation"))))
        with distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, host="127.0.0.1"
        ) as made:
            yield made.scheduler_address
