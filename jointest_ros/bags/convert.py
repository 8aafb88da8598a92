"""The public recordings that can be turned into rosbag2 recordings with ground truth, by name of the format."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from jointest_ros.bags.conversion import ConversionSummary
from jointest_ros.bags.convert_broad import convert_broad
from jointest_ros.bags.convert_multiarm import convert_multiarm
from jointest_ros.bags.convert_song import convert_song
from jointest_ros.core.params import Params
from jointest_ros.sim.pendulum import PendulumOptions


class ConvertFormat(NamedTuple):
    """One entry of `FORMATS`.

    Attributes:
        function: function(src, destination, storage, progress, overwrite, **options) makes a bag of a downloaded file;
            all but the first two are optional. Raises `BagError`.
        options: what can be chosen; its fields are the keyword arguments `options`.
    """

    description: str
    function: Callable[..., ConversionSummary]
    options: type[Params] = Params


FORMATS: dict[str, ConvertFormat] = {
    "song": ConvertFormat("two MPU6050 and a shaft encoder on a hinge, raw_*.mat (Song et al. 2022)", convert_song),
    "broad": ConvertFormat("one IMU with optical orientation, *.hdf5 (BROAD, Laidig et al. 2021)", convert_broad),
    "multiarm": ConvertFormat(
        "semi-synthetic: accelerometers computed on a real double pendulum, Double*.mat (Kaheman et al. 2023)",
        convert_multiarm,
        PendulumOptions,
    ),
}
