"""Two MPU6050 and a shaft encoder on a motorised hinge: Song, Pei, Hsiao-Wecksler, IEEE Sensors Journal 2022.

The recordings (github.com/ssong47/compute_relative_angle_between_two_IMUs, raw_*.mat) give time in s, gyros in deg/s,
accelerometers in g and the encoder in deg, one row a sample, in one clock. Rows keep their stamps, repeated ones too.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from jointest_ros.bags.cdr import IMU, JOINT_STATE
from jointest_ros.bags.cdr_encode import ImuEncoder, JointStateEncoder
from jointest_ros.bags.conversion import ConversionSummary, load_matlab, row_slices
from jointest_ros.bags.errors import BagError
from jointest_ros.bags.writer import BagWriter, StorageName
from jointest_ros.core.frame import FloatArray
from jointest_ros.core.progress import Progress, no_progress
from jointest_ros.core.robot import STANDARD_GRAVITY

_IMU_1, _IMU_2, _TRUTH = "/imu/imu_1", "/imu/imu_2", "/ground_truth/joint_states"
_VARIABLES = [
    "all_time",
    "all_encoder",
    *(f"all_{field}_{number}_{axis}" for field in ("gyro", "accel") for number in (1, 2) for axis in "xyz"),
]


def convert_song(
    src: Path,
    destination: Path,
    storage: StorageName = "mcap",
    progress: Progress = no_progress,
    overwrite: bool = False,
) -> ConversionSummary:
    """Write a raw_*.mat as a recording of /imu/imu_1, /imu/imu_2 and /ground_truth/joint_states (joint `shaft`).

    Raises:
        BagError: `src` is not such a file, or `destination` cannot be written.
    """
    table = _load(src)
    stamps = np.rint(table["all_time"] * 1e9).astype(np.int64)
    angle = np.radians(table["all_encoder"])
    gyro_1, gyro_2 = (np.radians(_vectors(table, f"all_gyro_{n}")) for n in (1, 2))
    accel_1, accel_2 = (_vectors(table, f"all_accel_{n}") * STANDARD_GRAVITY for n in (1, 2))
    imu_1, imu_2, truth = ImuEncoder("imu_1"), ImuEncoder("imu_2"), JointStateEncoder(["shaft"])
    with BagWriter(destination, storage, overwrite) as bag:
        bag.add_topic(_IMU_1, IMU, "sensor")
        bag.add_topic(_IMU_2, IMU, "sensor")
        bag.add_topic(_TRUTH, JOINT_STATE)
        for rows in row_slices(len(stamps), progress):
            columns = (stamps, gyro_1, accel_1, gyro_2, accel_2, angle)
            for stamp, w1, f1, w2, f2, q in zip(*(column[rows].tolist() for column in columns), strict=True):
                bag.write(_IMU_1, stamp, imu_1.encode(stamp, w1, f1))
                bag.write(_IMU_2, stamp, imu_2.encode(stamp, w2, f2))
                bag.write(_TRUTH, stamp, truth.encode(stamp, (q,)))
        counts = bag.counts
    return ConversionSummary(destination, float(np.ptp(stamps)) * 1e-9, counts)


def _vectors(table: dict[str, FloatArray], name: str) -> FloatArray:
    return np.column_stack([table[f"{name}_{axis}"] for axis in "xyz"])


def _load(src: Path) -> dict[str, FloatArray]:
    """The columns of the file, each (T,), in its own units."""
    contents = load_matlab(src, _VARIABLES, "a raw recording of the set 'song'")
    try:
        table = {name: np.asarray(contents[name], dtype=np.float64).ravel() for name in _VARIABLES}
    except (TypeError, ValueError) as error:
        raise BagError(f"{src}: not a raw recording of the set 'song': {error}") from None
    time = table["all_time"]
    if not len(time) or any(len(column) != len(time) for column in table.values()):
        raise BagError(f"{src}: not a raw recording of the set 'song': its columns are empty or of different lengths")
    if not np.isfinite(time).all() or time.min() < 0.0:
        raise BagError(f"{src}: all_time holds values that are no time")
    return table
