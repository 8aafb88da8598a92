"""Semi-synthetic: accelerometer readings computed on the real motion of a double pendulum (see `sim.pendulum`).

DoublePendulumDataForParameterEstimation.mat (github.com/dynamicslab/MultiArm-Pendulum) holds one recording of 80 s at
1 kHz in consecutive pieces: cells Y_id, then Y_vad, each with rows theta_1, theta_2 (rad, from the vertical, upward 0)
and their rates; Time_id and Time_vad, s. The rates, which the authors filtered, are not used: they lag 0.9 and 0.6 ms
behind those of the angles, and differ from them by 0.02 and 0.06 rad/s rms besides.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from jointest_ros.bags import synthetic
from jointest_ros.bags.cdr import JOINT_STATE
from jointest_ros.bags.conversion import ConversionSummary, load_matlab
from jointest_ros.bags.errors import BagError
from jointest_ros.bags.writer import BagWriter, StorageName
from jointest_ros.core.frame import FloatArray
from jointest_ros.core.progress import Progress, no_progress
from jointest_ros.sim.pendulum import PendulumOptions, pendulum, smooth, stretches

_WHAT = "a recording of the double pendulum of the set 'multiarm'"
_ARMS = 2
_LEAST = 100  # samples
SEMI_SYNTHETIC = (
    "semi-synthetic: the motion is that of a real double pendulum (encoders), the accelerometer readings are computed"
)


def convert_multiarm(
    src: Path,
    destination: Path,
    storage: StorageName = "mcap",
    progress: Progress = no_progress,
    overwrite: bool = False,
    **options: Any,
) -> ConversionSummary:
    """Write /imu/arm_1_upper, ... (two an arm) and /ground_truth/joint_states (joint `elbow`: arm 2 relative to arm 1).

    `options` are the fields of `sim.pendulum.PendulumOptions`. The metadata of the bag say that it is semi-synthetic.

    Raises:
        BagError: `src` is not such a file, or `destination` cannot be written.
        ConfigurationError: an option that is unknown or not allowed.
    """
    chosen = PendulumOptions.from_mapping(options)
    angles, period = _load(src)
    motion, duration = smooth(angles, period), period * (len(angles) - 1)
    topics = synthetic.topics(pendulum(chosen))
    total = round(duration * chosen.rate_hz) * len(topics)
    with BagWriter(destination, storage, overwrite) as bag:
        bag.note("semi_synthetic", SEMI_SYNTHETIC)
        for topic, msgtype in topics.items():
            bag.add_topic(f"/{topic}", msgtype, "reliable" if msgtype == JOINT_STATE else "sensor")
        for done, (stamp, topic, data) in enumerate(synthetic.messages(stretches(motion, duration, chosen))):
            bag.write(f"/{topic}", stamp, data)
            if done % 10000 == 0:
                progress(done, total)
        counts = bag.counts
    off = np.degrees(np.sqrt(np.mean((motion(period * np.arange(len(angles))) - angles) ** 2)))
    notes = (
        SEMI_SYNTHETIC,
        f"the motion follows the encoders within {off:.4f} deg rms; places of the sensors are assumed",
    )
    return ConversionSummary(destination, duration, counts, notes)


def _load(src: Path) -> tuple[FloatArray, float]:
    """The angles of both arms (T, 2), rad, and their period, s."""
    contents = load_matlab(src, ("Y_id", "Y_vad", "Time_id", "Time_vad"), _WHAT)
    try:
        table = np.hstack([np.asarray(piece, dtype=np.float64) for piece in _pieces(contents, "Y")])
        time = np.hstack([np.asarray(piece, dtype=np.float64).ravel() for piece in _pieces(contents, "Time")])
    except (TypeError, ValueError) as error:
        raise BagError(f"{src}: not {_WHAT}: {error}") from None
    if table.ndim != 2 or len(table) != 2 * _ARMS or time.shape != table.shape[1:] or len(time) < _LEAST:
        raise BagError(f"{src}: not {_WHAT}: {table.shape} values for {time.shape} times; 4 rows are needed")
    period = float(np.median(np.diff(time)))
    if not np.isfinite(table).all() or not np.abs(np.diff(time) - period).max() < 0.01 * period:
        raise BagError(f"{src}: its pieces are not consecutive, or hold values that are no numbers")
    return table[:_ARMS].T, period


def _pieces(contents: dict[str, Any], name: str) -> list[Any]:
    """What the cells hold, in the order of time."""
    return [*np.ravel(contents[f"{name}_id"]), *np.ravel(contents[f"{name}_vad"])]
