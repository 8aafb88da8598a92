"""Nodes inside of a user's process: any executor, several of them, gone without a trace, and made again."""

from __future__ import annotations

import gc
import os
import re
import subprocess
import sys
import threading
import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import Executor, MultiThreadedExecutor, SingleThreadedExecutor
from rclpy.node import Node
from ros_bench import DEPTH, Bench
from without_ros import assert_same, estimate, simulated

from jointest_ros.nodes.estimator_node import EstimatorNode
from jointest_ros.nodes.sim_hardware_node import SimHardwareNode

PROJECT = Path(__file__).resolve().parents[2]
# rclpy 7.1 never frees this service of any node: 0.1 MB a node
WITHOUT_LEAK: dict[str, Any] = {"start_type_description_service": False}
MOVING = simulated(scenario="PC", rate_hz=100.0, duration_s=3.0, zero_pose_s=2.0)


def events(context: Context) -> Executor:
    return pytest.importorskip("rclpy.experimental").EventsExecutor(context=context)


def single(context: Context) -> Executor:
    return SingleThreadedExecutor(context=context)


def multi(context: Context) -> Executor:
    return MultiThreadedExecutor(num_threads=4, context=context)


class UsersBench(Bench):
    """A bench on an executor of the user's own."""

    def __init__(self, make: Callable[[Context], Executor]) -> None:
        super().__init__("single")
        self._make = make

    def __enter__(self) -> UsersBench:
        super().__enter__()
        self.executor.remove_node(self.probe)
        self.executor = self._make(self.context)
        self.executor.add_node(self.probe)
        return self


# ------------------------------------------------------------------ executors


@pytest.mark.parametrize("make", [single, multi, events])
def test_any_executor(make: Callable[[Context], Executor], finger_config: Path) -> None:
    """Two estimators with parameters of their own in one executor, and each gives what it gives offline."""
    chosen: dict[str, dict[str, Any]] = {"first": {"kp": 1}, "second": {"formulation": "relative", "kp": 0.5}}
    with UsersBench(make) as bench:
        states = {name: bench.listen(f"{name}/joint_states") for name in chosen}
        nodes = [
            bench.estimator(finger_config, namespace=name, sensor_namespace=bench.namespace, **chosen[name])
            for name in chosen
        ]
        bench.send(nodes[0], MOVING)
        for name, received in states.items():
            bench.until(lambda received=received: len(received) == 300, "300 states")
            assert_same(received, estimate(MOVING, finger_config, **chosen[name]))
        if isinstance(bench.executor, MultiThreadedExecutor):
            bench.executor.shutdown()


def test_two_of_one_estimator_by_name_alone(bench: Bench, finger_config: Path) -> None:
    """In one namespace: services and parameters are apart; topics are joined unless they are remapped."""
    left, right = (
        bench.add(
            EstimatorNode(
                "pcf",
                node_name=name,
                namespace=bench.namespace,
                context=bench.context,
                config=str(finger_config),
                kp=kp,
                depth=DEPTH,
            )
        )
        for name, kp in (("left", 1.0), ("right", 2.0))
    )
    assert [node.get_parameter("kp").value for node in (left, right)] == [1.0, 2.0]
    bench.send(left, MOVING)
    bench.until(lambda: right.estimates == left.estimates == 300, "300 estimates of each")
    before = right.estimator.get_state()
    assert bench.trigger(left, "reset") == (True, "started afresh")
    assert right.estimator.get_state() == before != left.estimator.get_state()


def test_the_default_context(finger_config: Path) -> None:
    """As in a script: `rclpy.init()`, the node, an executor."""
    rclpy.init(args=[])
    try:
        node = EstimatorNode("pcf", config=finger_config, kp=2.0)
        assert node.context is rclpy.get_default_context()
        assert node.estimator.params.kp == 2.0
        node.destroy_node()
    finally:
        rclpy.shutdown()


# ------------------------------------------------------------------ life


@contextmanager
def nothing_stays() -> Iterator[None]:
    """What is opened in between is closed in between: files, sockets, threads."""

    def held() -> tuple[int, int]:
        gc.collect()
        return len(os.listdir("/proc/self/fd")), threading.active_count()

    if not os.path.isdir("/proc/self/fd"):
        pytest.skip("no /proc")
    before = held()
    yield
    assert held() == before


def _services(bench: Bench) -> list[str]:
    """Those of estimator and hardware."""
    names = [name for name, _ in bench.probe.get_service_names_and_types()]
    return [name for name in names if "pcf_node" in name or "sim_hardware_node" in name]


def test_made_and_destroyed_fifty_times(bench: Bench, finger_config: Path, finger_bag: Path) -> None:
    """No subscription, publisher, service, file, thread or object of it stays."""
    gone: list[weakref.ref[Node]] = []

    def once() -> None:
        node = bench.estimator(finger_config, kp=2.0, **WITHOUT_LEAK)
        hardware = bench.hardware(bag=str(finger_bag), paused=True, **WITHOUT_LEAK)
        assert bench.probe.count_subscribers("imu/palm") == bench.probe.count_publishers("imu/palm") == 1
        gone.extend([weakref.ref(node), weakref.ref(hardware)])
        bench.remove(hardware)
        bench.remove(node)

    once()  # what is made once a process
    with nothing_stays():
        for _ in range(50):
            once()
    bench.executor.spin_once(timeout_sec=0.0)  # what an executor did last it holds until it does the next
    gc.collect()
    assert not [number for number, node in enumerate(gone) if node() is not None]
    bench.until(lambda: not bench.probe.count_subscribers("imu/palm"), "the end of the subscriptions")
    for topic in ("imu/palm", "joint_states", "biases", "joint_covariance"):
        bench.until(lambda topic=topic: not bench.probe.count_publishers(topic), "the end of the publishers")
    bench.until(lambda: not _services(bench), "the end of the services")
    states = bench.listen()  # and one more works as the first
    bench.send(bench.estimator(finger_config), MOVING)
    bench.until(lambda: len(states) == 300, "300 states")
    assert_same(states, estimate(MOVING, finger_config))


def test_contexts_come_and_go(finger_config: Path) -> None:
    """A context for each test of a user's suite, with all that is in it."""

    def once() -> None:
        with Bench("events") as bench:
            bench.estimator(finger_config)
            bench.add(SimHardwareNode(namespace=bench.namespace, context=bench.context, source="finger"))

    once()
    with nothing_stays():
        for _ in range(5):
            once()


# ------------------------------------------------------------------ the document


def test_the_example_of_the_document(tmp_path: Path) -> None:
    """docs/testing.md: a file for pytest that a user copies."""
    text = (PROJECT / "docs" / "testing.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"<!-- [^>]* runs this block -->\n```python\n(.*?)```", text, flags=re.DOTALL)
    file = tmp_path / "test_angles.py"
    file.write_text(example, encoding="utf-8")
    path = os.pathsep.join(filter(None, [str(PROJECT), os.environ.get("PYTHONPATH", "")]))
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--rootdir", str(tmp_path), str(file)],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
        timeout=100,
    )
    assert "1 passed" in done.stdout, done.stdout + done.stderr
