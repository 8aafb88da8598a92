"""Faults over DDS, for every estimator node: it lives, and is as good as ever two seconds after the data are."""

from __future__ import annotations

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from fault_bench import SEED, FaultBench, faultless, good_from, simulation
from faults import FAULTS, MS, RIGS, changes, rms, since
from ros_bench import Bench, queue, received

from jointest_ros.bags.intake import HALL_TOPIC
from jointest_ros.nodes import diagnostics
from jointest_ros.nodes.estimator_node import EstimatorNode
from jointest_ros.nodes.messages import CLASSES

NEWEST = -100 * MS  # ns, from the end: the last frames wait for what does not come any more

# Fault and rig, but for faults of Hall sensors where there are none.
CASES = [
    (fault, rig)
    for rig, kind in RIGS.items()
    for fault in FAULTS
    if "Hall" not in fault or any(topic == HALL_TOPIC for _, topic, _ in simulation(rig).messages[:20])
]


def assert_consistent(node: EstimatorNode, published: dict[str, int]) -> None:
    """Messages in = used + refused by cause, on every topic, and none was lost."""
    node.intake.flush()
    for topic in node.intake.topics:
        counts = node.intake.counts(topic)
        assert counts["messages"] == published.get(topic, 0) == counts["used"] + sum(counts["refused"].values())


@pytest.mark.parametrize(("fault", "rig"), CASES)
def test_recovery(fault: str, rig: str, bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    one = FaultBench(bench, rig, monkeypatch)
    stream = FAULTS[fault](one.made.messages, one.rig, np.random.default_rng(SEED))
    drivers = 2 if fault in ("two publishers", "an old bag beside the hardware", "two robots on the same topics") else 1
    one.play(stream, drivers, restarted=fault == "all die")
    begin, newest = good_from(one.rig, stream), max(one.made.truth) + NEWEST
    for estimator, node in one.nodes.items():
        found = since(one.errors(estimator, newest), begin)
        free = since(faultless(rig, estimator), begin)
        assert len(found) > 0.97 * len(free)  # whole states again, all the time
        if estimator == "gyro":  # nothing tells where it is: what it lost is lost, but it says so, and loses no more
            assert rms(changes(found)) < 2.0 * rms(changes(free))
            deviations = np.sqrt(np.diag(node.estimator.covariance()))
            assert (np.abs(found[max(found)]) < 4.0 * deviations).all()
        else:
            assert rms(found) < 2.0 * rms(free)
        published = {topic: sum(other == topic for _, other, _ in stream) for topic in node.intake.topics}
        assert_consistent(node, published)


@pytest.mark.parametrize("rig", RIGS)
def test_qos_that_does_not_match(rig: str, bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing arrives, the diagnostics name the reason and the cure; once a publisher suits, all is well."""
    monkeypatch.setattr(diagnostics, "PERIOD", 0.1)
    one = FaultBench(bench, rig, monkeypatch, reliability="reliable")
    topic, kind = next(iter(next(iter(one.nodes.values())).intake.topics.items()))
    unsuited = bench.probe.create_publisher(CLASSES[kind], topic, queue())
    for estimator, node in one.nodes.items():
        unsuited.publish(one.made.messages[0][2])
        reports = bench.diagnostics(node)
        report = reports.until(lambda found: "QoS" in found[f"input {bench.namespace}/{topic}"].message)
        status = report[f"input {bench.namespace}/{topic}"]
        assert status.level == DiagnosticStatus.ERROR, estimator
        assert "best_effort" in status.message and "reliable" in status.message
        assert received(node) == 0
    bench.probe.destroy_publisher(unsuited)
    one.play(one.made.messages, reliable=True)
    newest = max(one.made.truth) + NEWEST
    for estimator in one.nodes:
        found, free = one.errors(estimator, newest), faultless(rig, estimator)
        assert len(found) > 0.97 * len(free)
        np.testing.assert_allclose(list(found.values()), [free[stamp] for stamp in found], rtol=0.0, atol=1e-9)
