"""One IMU with magnetometer under optical tracking: BROAD (Laidig, Caruso, Cereatti, Seel, Data 6(7), 2021).

The recordings (github.com/dlaidig/broad, *.hdf5) give gyro in rad/s, accelerometer in m/s^2, magnetometer in uT and the
optical orientation (w, x, y, z) of the sensor in an east-north-up frame, NaN where the tracking was lost, one row a
sample at the rate in the attribute `sampling_rate`; `movement` marks the rows that count for errors.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from jointest_ros.bags.cdr import BOOL, IMU, MAGNETIC_FIELD, QUATERNION_STAMPED
from jointest_ros.bags.cdr_encode import ImuEncoder, encode_bool, encode_magnetic_field, encode_quaternion_stamped
from jointest_ros.bags.conversion import ConversionSummary, check_source, row_slices
from jointest_ros.bags.errors import BagError
from jointest_ros.bags.writer import BagWriter, StorageName
from jointest_ros.core.frame import FloatArray
from jointest_ros.core.progress import Progress, no_progress

_IMU, _MAG = "/imu/imu", "/mag/imu"
_ORIENTATION, _MOVEMENT = "/ground_truth/imu_orientation", "/ground_truth/movement"
_FRAME_ID = "imu"
_WIDTHS = {"imu_gyr": 3, "imu_acc": 3, "imu_mag": 3, "opt_quat": 4}


def convert_broad(
    src: Path,
    destination: Path,
    storage: StorageName = "mcap",
    progress: Progress = no_progress,
    overwrite: bool = False,
) -> ConversionSummary:
    """Write a trial as a recording of /imu/imu, /mag/imu (tesla) and, as ground truth, orientation and movement.

    /ground_truth/imu_orientation (QuaternionStamped, frame id = sensor) is the rotation sensor to world, z up, without
    the rows that have none; /ground_truth/movement (Bool) is written whenever it changes. The first row has stamp 0.

    Raises:
        BagError: h5py is not installed, `src` is not such a file, or `destination` cannot be written.
    """
    table, movement, rate = _load(src)
    stamps = np.rint(np.arange(len(movement)) * (1e9 / rate)).astype(np.int64)
    orientation = table["opt_quat"][:, [1, 2, 3, 0]]
    tracked = np.isfinite(orientation.sum(axis=1))
    changed = np.append(True, movement[1:] != movement[:-1])
    values = (stamps, table["imu_gyr"], table["imu_acc"], table["imu_mag"] * 1e-6, orientation)
    columns = (*values, tracked, movement, changed)
    imu = ImuEncoder(_FRAME_ID)
    with BagWriter(destination, storage, overwrite) as bag:
        bag.add_topic(_IMU, IMU, "sensor")
        bag.add_topic(_MAG, MAGNETIC_FIELD, "sensor")
        bag.add_topic(_ORIENTATION, QUATERNION_STAMPED)
        bag.add_topic(_MOVEMENT, BOOL)
        for rows in row_slices(len(stamps), progress):
            for row in zip(*(column[rows].tolist() for column in columns), strict=True):
                stamp, gyro, accel, mag, quaternion, is_tracked, moves, is_changed = row
                bag.write(_IMU, stamp, imu.encode(stamp, gyro, accel))
                bag.write(_MAG, stamp, encode_magnetic_field(stamp, _FRAME_ID, mag))
                if is_tracked:
                    bag.write(_ORIENTATION, stamp, encode_quaternion_stamped(stamp, _FRAME_ID, quaternion))
                if is_changed:
                    bag.write(_MOVEMENT, stamp, encode_bool(moves))
        counts = bag.counts
    lost = int((~tracked).sum())
    notes = (f"{lost} rows have no optical orientation; their ground truth is left out",) if lost else ()
    return ConversionSummary(destination, float(np.ptp(stamps)) * 1e-9, counts, notes)


def _load(src: Path) -> tuple[dict[str, FloatArray], NDArray[np.bool_], float]:
    """The columns by name, each (T, 3 or 4), the mask `movement` (T,) and the sampling rate, Hz."""
    try:
        import h5py  # an extra, which only this format needs
    except ImportError:
        raise BagError("reading BROAD needs h5py: pip install 'jointest_ros[convert]'") from None
    check_source(src)
    try:
        with h5py.File(src, "r") as file:
            table = {name: np.asarray(file[name], dtype=np.float64) for name in _WIDTHS}
            movement = np.asarray(file["movement"], dtype=np.bool_)
            rate = float(file.attrs["sampling_rate"])
    except (OSError, KeyError, TypeError, ValueError, RuntimeError) as error:
        raise BagError(f"{src}: not a trial of the set 'broad': {error}") from None
    shapes_fit = all(table[name].shape == (*movement.shape, width) for name, width in _WIDTHS.items())
    if not movement.size or not shapes_fit or not 0.0 < rate < np.inf:
        raise BagError(f"{src}: not a trial of the set 'broad': empty, or of shapes or a sampling_rate that do not fit")
    return table, movement, rate
