"""The tables and figures of the papers that can be computed anew, by name: what `jointest reproduce` lists."""

from __future__ import annotations

from jointest_ros.reproduction import (
    accel_count,
    accel_multiples,
    accel_placement,
    accel_table2,
    accel_table3,
    kckf_drift,
    kckf_float32,
    kckf_human,
    kckf_observability,
    kckf_table1,
    pcf_disk,
)
from jointest_ros.reproduction.result import Reproduction

REPRODUCTIONS: dict[str, Reproduction] = {
    entry.name: entry
    for entry in (
        Reproduction(
            "kckf-table1",
            "KCKF, Table 1: RMSE of every sensor and filter in cyclic motion",
            kckf_table1.run,
            ("seed", "runs", "duration_s", "data"),
        ),
        Reproduction(
            "kckf-drift",
            "KCKF, Fig. 7: drift of the torso over an hour at 100 Hz and 1 kHz",
            kckf_drift.run,
            ("seed", "duration_s"),
        ),
        Reproduction(
            "kckf-human",
            "KCKF, Fig. 8: a user bends by 30 deg, the sensors shift",
            kckf_human.run,
            ("seed", "runs", "duration_s"),
        ),
        Reproduction(
            "pcf-disk",
            "PCF, Table I: radius of three disks from the gripper's posture",
            pcf_disk.run,
            ("seed", "runs"),
        ),
        Reproduction("kckf-observability", "KCKF, section 3.3: rank of (21) for 2 to 8 joints", kckf_observability.run),
        Reproduction(
            "kckf-float32",
            "KCKF: float32 beside float64 over 3.6 million steps at 1 kHz",
            kckf_float32.run,
            ("seed", "duration_s"),
        ),
        Reproduction(
            "accel-table2",
            "Accelerometer arrays, Table II: errors by distance of the sensors, as distributions",
            accel_table2.run,
            ("seed", "runs"),
        ),
        Reproduction(
            "accel-table3",
            "Accelerometer arrays, Table III: the arm in four movements with three sensors",
            accel_table3.run,
            ("seed", "runs", "duration_s"),
        ),
        Reproduction(
            "accel-bound",
            "Accelerometer arrays: filters in multiples of the Cramér-Rao bound, seven motions",
            accel_multiples.run,
            ("seed", "runs"),
        ),
        Reproduction(
            "accel-count",
            "Accelerometer arrays, Fig. 5: error by number of sensors",
            accel_count.run,
            ("seed", "runs"),
        ),
        Reproduction(
            "accel-placement",
            "Accelerometer arrays, Figs. 6, 7: error by places of the sensors",
            accel_placement.run,
            ("seed", "runs"),
        ),
    )
}
