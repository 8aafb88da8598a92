"""Starts, spins and ends a node as a process: one line for a user's mistake, no traceback, a clean end on a signal."""

from __future__ import annotations

import dataclasses
import faulthandler
import gc
import os
import re
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TypeVar

import rclpy
from rclpy.context import Context
from rclpy.exceptions import ParameterException
from rclpy.executors import Executor, ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from jointest_ros.core.errors import ConfigurationError, JointestError
from jointest_ros.core.params import Params, allowed_text

NodeT = TypeVar("NodeT", bound=Node)

BAD_INPUT = 2  # exit code
_LOOK = 0.2  # s
_PATIENCE = 3.0  # s between a signal and the end of the process, whatever keeps it


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
    """Spin until `until()` is true, which is looked at a few times a second, or ROS is shut down.

    Not `executor.spin()`, see DESIGN section 5; nor `spin_until_future_complete`, of which every call leaves 32 bytes
    behind in rclpy 7.1.
    """
    gc.freeze()  # what is there now stays: a collection that went through all of it would take 50 ms
    try:
        while executor.context.ok() and not until():
            end = time.monotonic() + _LOOK
            while time.monotonic() < end:  # comes back for every message: nothing else is done here, for speed
                executor.spin_once(timeout_sec=_LOOK)
    except ExternalShutdownException:
        pass


@contextmanager
def caught_signals() -> Iterator[list[int]]:
    """SIGINT and SIGTERM as they come, who do nothing else meanwhile.

    So no callback is interrupted in the middle, and none publishes after the shutdown that the handlers of rclpy do.
    """
    received: list[int] = []
    before = {n: signal.signal(n, lambda number, _: received.append(number)) for n in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield received
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def ended_by_signals(code: Callable[[], int] = lambda: 0) -> Iterator[list[int]]:
    """`caught_signals` for a whole process: it ends soon after one, even if rclpy does not come back, by `code()`.

    About once in twenty runs under load, `spin_once` or the destruction of an EventsExecutor of rclpy 7.1 hangs then.
    """
    ended = threading.Event()
    devnull = open(os.devnull, "w")  # noqa: SIM115 - until the process ends
    reader, writer = os.pipe()
    os.set_blocking(writer, False)

    def insist() -> None:
        os.read(reader, 1)  # a byte comes with a signal, also while the main thread is busy
        # a thread of C does it where rclpy hangs with Python's lock in its hands
        faulthandler.dump_traceback_later(_PATIENCE + 1.0, exit=True, file=devnull)
        if not ended.wait(_PATIENCE):
            os._exit(0)

    threading.Thread(target=insist, daemon=True).start()
    before = signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    try:
        with caught_signals() as signals:
            yield signals
    finally:
        signal.set_wakeup_fd(before)
        ended.set()
        if signals:  # all is shut down: the end of the interpreter, with what is left of an executor, adds only risk
            sys.stdout.flush()
            sys.stderr.flush()
            os._exit(code())


def main(
    make_node: Callable[[], Node],
    name: str,
    text: str,
    sections: Mapping[str, type[Params]],
    args: list[str] | None = None,
) -> int:
    """Body of every executable; returns its exit code.

    Args:
        make_node: its node's parameter `executor` is obeyed; the node's attribute `finished`, if any, ends the process.
        name: of the executable.
        text: what `--help` says before the parameters.
        sections: heading -> parameters, for `--help`.
        args: command line without the program's name.
    """
    with ended_by_signals() as signals:
        try:
            args = sys.argv[1:] if args is None else args
            init(args)
            others = remove_ros_args(args)
            if {"-h", "--help"} & set(others):
                print(_usage(name, text, sections))
                return 0
            if others:
                advice = "parameters are given as --ros-args -p NAME:=VALUE"
                raise ConfigurationError(f"unknown argument '{others[0]}'; {advice}")
            _run(made(make_node), until=lambda: bool(signals))
        except (JointestError, ParameterException) as error:  # the latter: use_sim_time with a wrong type
            print(f"{name}: error: {error}", file=sys.stderr)
            return BAD_INPUT
        finally:
            rclpy.try_shutdown()
    return 0


def init(args: list[str], context: Context | None = None) -> None:
    """Start ROS, without its signal handlers. Raises ConfigurationError where it cannot."""
    try:
        rclpy.init(args=args, context=context, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:
        raise _refused(error) from None


def made(make_node: Callable[[], NodeT]) -> NodeT:
    """The node. Raises ConfigurationError where ROS does not let it be, besides what its constructor raises."""
    try:
        return make_node()
    except rclpy_implementation.RCLError as error:  # security without its libraries, for one
        raise _refused(error) from None


def _refused(error: RuntimeError) -> ConfigurationError:
    text = " ".join(re.sub(r", at \S+:\d+", "", str(error)).split())  # without the lines of its source
    if type(error).__name__ == "UnknownROSArgsError":
        text = f"unknown arguments {text}"
    return ConfigurationError(f"ROS cannot start: {text.removeprefix('failed to initialize rcl: ')}")


def _run(node: Node, until: Callable[[], bool]) -> None:
    executor = make_executor(str(node.get_parameter("executor").value))
    try:
        executor.add_node(node)
        spin(executor, until=lambda: until() or bool(getattr(node, "finished", False)))
    finally:
        executor.remove_node(node)
        node.destroy_node()


def _usage(name: str, text: str, sections: Mapping[str, type[Params]]) -> str:
    lines = [
        f"usage: {name} --ros-args [-p NAME:=VALUE]... [-r __ns:=/NAMESPACE] [--params-file FILE]",
        "",
        text.strip(),
    ]
    for heading, kind in sections.items():
        lines += ["", f"{heading}:"]
        for spec in dataclasses.fields(kind):
            default = str(spec.default).lower() if isinstance(spec.default, bool) else repr(spec.default)
            lines += [
                f"  {spec.name}: {allowed_text(spec)}; default {default}",
                f"      {spec.metadata['description']}",
            ]
    return "\n".join(lines)
