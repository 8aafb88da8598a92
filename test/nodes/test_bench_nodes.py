"""`jointest bench nodes` and `soak`: short runs with processes, and what soak makes of figures that must not be."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from jointest_ros.benchmark.part import BenchError, Options
from jointest_ros.core.pcf.pcf import Pcf
from jointest_ros.nodes import bench, bench_roles, soak
from jointest_ros.nodes.bench_processes import Process
from jointest_ros.nodes.soak_roles import Sent, Taken

NOTHING = np.empty(0)


def ignore(_done: int, _total: int) -> None:
    """Progress."""


# ----------------------------------------------------------------- nodes


def test_nodes(monkeypatch: pytest.MonkeyPatch) -> None:
    """At a rate at which nothing may be lost, whatever else the machine does."""
    monkeypatch.setattr(bench, "CASES", (bench.EXOSHELL,))
    monkeypatch.setattr(bench, "QUICK_RATES_HZ", (100.0,))
    monkeypatch.setattr(bench, "QUICK_SECONDS", 0.5)
    result = bench.run(Options(quick=True), ignore)
    nodes, hardware, budget = (table.document()["rows"] for table in result.tables)
    kckf, *plain = nodes
    assert [one["node"] for one in nodes] == ["kckf_node", *bench.PLAIN]
    assert (kckf["imus"], kckf["hz"], kckf["s"]) == (5, 100, 2.5)
    assert (kckf["sent"], kckf["lost"], kckf["refused"]) == (1500, 0, 0)
    assert 0.0 < kckf["p50_ms"] <= kckf["p99_ms"]
    assert 0.0 < kckf["end_to_end_p50_ms"] <= kckf["end_to_end_p99_ms"]
    for one in plain:
        assert (one["sent"], one["lost"], one["p50_ms"]) == (300, 0, None)
    assert all(0.0 < one["cpu_percent"] < 200.0 for one in (*nodes, *hardware))
    assert [(one["item"], one["budget"]) for one in budget] == [
        ("messages lost", 0),
        ("cpu_percent", 35.0),
        ("p99_ms", 3.0),
    ]
    assert not result.failures


def test_part_of_a_robot() -> None:
    robot = bench.TWO_FINGERS.robot()
    assert len(robot.sensors) == 5
    assert Pcf(robot).joints == ("left_mcp", "left_pip", "left_dip", "right_mcp")


def test_process_tells_why_it_cannot_start() -> None:
    with Process(bench_roles.estimator, namespace="/nowhere", name="pcf", config="missing.yaml") as process:  # noqa: SIM117
        with pytest.raises(BenchError, match=r"estimator: missing\.yaml: "):
            process.wait_until_ready()


# ----------------------------------------------------------------- soak


def test_soak() -> None:
    seconds, rate = 72.0, round(soak.RATE_HZ)
    kckf, pcf = soak.soak(soak.CASES, seconds, ignore)
    assert [one.failures for one in (kckf, pcf)] == [[], []]
    for one, imus in ((kckf, 5), (pcf, 4)):
        frames = round(seconds) * rate
        assert one.taken.estimates == frames
        counts = [c for topic, c in one.taken.counts.items() if topic.startswith("imu/")]
        assert len(counts) == imus
        faults = frames // 1000
        for count in counts:
            assert count["used"] == frames
            assert count["refused"] == {"repeated stamp": faults, "undecodable": faults}
    assert [row[0] for row in kckf.errors()] == ["joint_1", "joint_2", "joint_3", "joint_4", "sum of all"]
    assert [row[0] for row in pcf.errors()] == ["finger_mcp", "finger_pip", "finger_dip"]


def outcome(
    case: soak.Case = soak.CASES[0],
    errors: Any = 0.1,
    received: int = 100,
    used: int = 98,
    faults: int = 2,
    memory: tuple[float, ...] = (100.0, 104.0),
) -> soak.Outcome:
    """Two hours; `errors` in degrees, by minute."""
    rows = np.radians(np.broadcast_to(errors, 120))[:, None] * np.ones(3)
    sent = Sent({"imu": 100}, {"undecodable": 2}, 98, ("a", "b", "sum of all"), rows, rows, np.abs(rows), NOTHING)
    counts = {"imu": {"messages": received, "used": used, "refused": {"undecodable": faults}}}
    return soak.Outcome(case, sent, Taken(counts, 98, np.array(memory)))


PCF = soak.CASES[1]


def test_all_is_well() -> None:
    assert outcome().failures == []
    assert outcome(case=PCF, errors=0.09).failures == []


@pytest.mark.parametrize(
    ("figures", "complaint"),
    [
        ({"received": 99, "used": 97}, "kckf_node: imu: 100 messages sent, 99 received"),
        ({"used": 97}, "kckf_node: imu: 100 messages received, 99 used or refused"),
        (
            {"used": 97, "faults": 3},
            "kckf_node: messages refused: {'undecodable': 3}, to be refused: {'undecodable': 2}",
        ),
        ({"errors": 1.4}, "kckf_node: sum of all: error of 1.40 deg, at most 1.3 is allowed"),
        ({"errors": np.linspace(0.0, 0.4, 120)}, "kckf_node: a: drifts by 0.202 deg/h, less than 0.15 is allowed"),
        (
            {"case": PCF, "errors": 0.11},
            "pcf_node: a: rms error in the last tenth 0.110 deg, at most 0.1 is allowed",
        ),
        ({"memory": (100.0, 106.0, 101.0)}, "kckf_node: memory of kckf_node: grew by 6.0 %, less than 5 % is allowed"),
    ],
)
def test_what_must_not_be_is_told(figures: dict[str, Any], complaint: str) -> None:
    assert outcome(**figures).failures[0] == complaint
