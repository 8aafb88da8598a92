"""Small recordings to read, to damage and to compare with."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from jointest_ros.bags.cdr import FLOAT32_MULTIARRAY, IMU
from jointest_ros.bags.cdr_encode import ImuEncoder, encode_float32_multiarray
from jointest_ros.bags.writer import BagWriter, StorageName

Message = tuple[str, int, bytes]


@pytest.fixture(params=["mcap", "sqlite3"])
def storage(request: pytest.FixtureRequest) -> StorageName:
    """Both kinds of storage, one after the other."""
    name: StorageName = request.param
    return name


@pytest.fixture(scope="session")
def samples() -> Callable[..., Iterator[Message]]:
    """A function that yields `count` messages from number `first` on, 10 ms apart: /imu/palm, /hall_voltages, ..."""

    def generate(count: int, first: int = 0) -> Iterator[Message]:
        imu = ImuEncoder("palm")
        for k in range(first, first + count):
            time = 1_000_000_000 + k * 10_000_000
            if k % 2:
                yield "/hall_voltages", time, encode_float32_multiarray((float(k), 0.5))
            else:
                yield "/imu/palm", time, imu.encode(time, (float(k), 0.0, 0.0), (0.0, 0.0, 9.81))

    return generate


@pytest.fixture
def make_bag(tmp_path: Path, samples: Callable[..., Iterator[Message]]) -> Callable[..., Path]:
    """A function that writes `samples` into a bag and returns its path."""

    def make(
        storage: StorageName, count: int = 1000, first: int = 0, name: str = "run", compress: bool = False
    ) -> Path:
        with BagWriter(tmp_path / name, storage, compress=compress) as bag:
            bag.add_topic("/imu/palm", IMU, "sensor")
            bag.add_topic("/hall_voltages", FLOAT32_MULTIARRAY, "sensor")
            for message in samples(count, first):
                bag.write(*message)
        return tmp_path / name

    return make


@pytest.fixture(scope="session")
def data_file() -> Callable[[Path], Path]:
    """A function that returns the one data file of a bag."""

    def find(bag: Path) -> Path:
        (file,) = (path for path in bag.iterdir() if path.name != "metadata.yaml")
        return file

    return find
