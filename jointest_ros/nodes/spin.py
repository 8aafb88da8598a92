"""Starts, spins and ends a node as a process: one line for a user's mistake, no traceback, a clean end on a signal."""

from __future__ import annotations

import sys
from collections.abc import Callable

import rclpy
from rclpy.context import Context
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node

from jointest_ros.core.errors import JointestError

BAD_INPUT = 2  # exit code


def make_executor(name: str = "events", context: Context | None = None) -> Executor:
    """`events`: the EventsExecutor (a fifth of the CPU) where rclpy has it; `single`: the SingleThreadedExecutor."""
    if name == "events":
        try:
            from rclpy.experimental import EventsExecutor
        except ImportError:
            pass
        else:
            return EventsExecutor(context=context)
    return SingleThreadedExecutor(context=context)


def spin(executor: Executor, until: Callable[[], bool] = lambda: False) -> None:
    """Spin until `until()` is true or ROS is shut down. Not `executor.spin()`: see DESIGN section 5."""
    while rclpy.ok() and not until():
        executor.spin_once(timeout_sec=0.2)


def main(make_node: Callable[[], Node], name: str, args: list[str] | None = None) -> int:
    """Body of every executable; returns its exit code."""
    rclpy.init(args=args)
    try:
        node = make_node()
    except JointestError as error:
        print(f"{name}: error: {error}", file=sys.stderr)
        rclpy.try_shutdown()
        return BAD_INPUT
    executor = make_executor(str(node.get_parameter("executor").value))
    try:
        executor.add_node(node)
        spin(executor, until=lambda: bool(getattr(node, "finished", False)))
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        executor.remove_node(node)
        node.destroy_node()
        rclpy.try_shutdown()
    return 0
