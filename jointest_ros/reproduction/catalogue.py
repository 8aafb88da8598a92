"""The tables and figures of the papers that can be computed anew, by name: what `jointest reproduce` lists."""

from __future__ import annotations

from jointest_ros.reproduction import kckf_drift, kckf_float32, kckf_human, kckf_observability, kckf_table1
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
        Reproduction("kckf-observability", "KCKF, section 3.3: rank of (21) for 2 to 8 joints", kckf_observability.run),
        Reproduction(
            "kckf-float32",
            "KCKF: float32 beside float64 over 3.6 million steps at 1 kHz",
            kckf_float32.run,
            ("seed", "duration_s"),
        ),
    )
}
