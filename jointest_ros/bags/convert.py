"""The public recordings that can be turned into rosbag2 recordings with ground truth, by name of the format."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple, Protocol

from jointest_ros.bags.conversion import ConversionSummary, Progress, no_progress
from jointest_ros.bags.convert_broad import convert_broad
from jointest_ros.bags.convert_song import convert_song
from jointest_ros.bags.writer import StorageName


class Converter(Protocol):
    """What each converter is: a function from a downloaded file to a bag. Raises `BagError`."""

    def __call__(
        self,
        src: Path,
        destination: Path,
        storage: StorageName = "mcap",
        progress: Progress = no_progress,
        overwrite: bool = False,
    ) -> ConversionSummary: ...


class ConvertFormat(NamedTuple):
    """One entry of `FORMATS`."""

    description: str
    function: Converter


FORMATS: dict[str, ConvertFormat] = {
    "song": ConvertFormat("two MPU6050 and a shaft encoder on a hinge, raw_*.mat (Song et al. 2022)", convert_song),
    "broad": ConvertFormat("one IMU with optical orientation, *.hdf5 (BROAD, Laidig et al. 2021)", convert_broad),
}
