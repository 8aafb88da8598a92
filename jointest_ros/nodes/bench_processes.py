"""Processes for `jointest bench`: one node each, as the executables have it, and each measures itself."""

from __future__ import annotations

import itertools
import math
import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from jointest_ros.benchmark.part import BenchError
from jointest_ros.core.errors import JointestError
from jointest_ros.nodes.spin import make_executor, spin

spawn = multiprocessing.get_context("spawn")  # a fork would inherit threads of the middleware that do not run in it
_LONGEST = 60.0  # s that a process may take to start or to end
_QUIET = 2  # looks without anything new, after which all has arrived
_numbers = itertools.count()


def namespace() -> str:
    """One that nothing else on this host has."""
    return f"/jointest_bench_{os.getpid()}_{next(_numbers)}"


class Meter:
    """CPU of this process, % of a core, from the first to the last look that found `count()` grown."""

    def __init__(self, count: Callable[[], int]) -> None:
        self._count, self._seen = count, 0
        self._first: tuple[float, float] | None = None
        self._last = (0.0, 0.0)
        self.idle = 0  # looks since then

    def look(self) -> None:
        """To be called now and then."""
        count = self._count()
        if count == self._seen:
            self.idle += 1
            return
        self._seen, self.idle = count, 0
        self._last = time.process_time(), time.monotonic()
        self._first = self._first or self._last

    @property
    def percent(self) -> float:
        """NaN where too little happened."""
        if self._first is None or self._last == self._first:
            return math.nan
        return 100.0 * (self._last[0] - self._first[0]) / (self._last[1] - self._first[1])


class Link:
    """What a process has of the one that started it.

    Attributes:
        told: set by its `Process.tell`.
        closed: set when it needs nothing more, or is gone.
    """

    def __init__(self, pipe: Connection) -> None:
        self._pipe, self.told, self.closed = pipe, threading.Event(), threading.Event()
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        with suppress(EOFError, OSError):
            while True:
                self._pipe.recv()
                self.told.set()
        self.told.set()
        self.closed.set()

    def work(
        self,
        node: Node,
        executor: str,
        meter: Meter,
        until: Callable[[], bool] | None = None,
        ready: Callable[[], bool] = lambda: True,
    ) -> None:
        """Spin a node; say when it is ready; until `until()`, or until told and nothing more arrives."""

        def over() -> bool:
            meter.look()
            return until() if until is not None else self.told.is_set() and meter.idle >= _QUIET

        spinner = make_executor(executor)
        spinner.add_node(node)
        spin(spinner, until=lambda: ready() or self.closed.is_set())
        self._pipe.send(None)
        spin(spinner, until=over)
        spinner.remove_node(node)


def _serve(pipe: Connection, role: Callable[..., Any], arguments: dict[str, Any]) -> None:
    """Body of a process: sends None when its node is there, then what `role` returns, or the text of its error."""
    rclpy.init(args=["--ros-args", "--log-level", "fatal"], signal_handler_options=SignalHandlerOptions.NO)
    link = Link(pipe)
    try:
        pipe.send(role(link, **arguments))
    except JointestError as error:
        pipe.send(str(error))
    except OSError:
        pass  # it is gone
    link.closed.wait()
    os._exit(0)  # the end of a node under load is not what is measured here


class Process:
    """Context manager around one process.

    Args:
        role: a function of a module, that is called there with a `Link` and the `arguments`.

    Raises:
        BenchError: its node cannot be made, or it ends or hangs.
    """

    def __init__(self, role: Callable[..., Any], **arguments: Any) -> None:
        self._pipe, theirs = spawn.Pipe()
        self._name = role.__name__
        self._process = spawn.Process(target=_serve, args=(theirs, role, arguments), daemon=True)
        self._theirs = theirs

    def __enter__(self) -> Process:
        # Ctrl-C reaches the whole group, while it imports as well: it is for who started it, who ends it then
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)
        try:
            self._process.start()
        finally:
            signal.signal(signal.SIGINT, before)
        self._theirs.close()
        return self

    def wait_until_ready(self) -> None:
        """Its node is there."""
        self._receive(_LONGEST)

    def tell(self) -> None:
        """What it waits for has come: it begins, or it ends once nothing more arrives, as its role has it."""
        self._pipe.send(None)

    def done(self) -> bool:
        """It has a result, or is gone."""
        return self._pipe.poll()

    def result(self, longest: float = _LONGEST) -> Any:
        """What the role returned, within `longest` s."""
        return self._receive(longest)

    def _receive(self, longest: float) -> Any:
        if not self._pipe.poll(longest):
            raise BenchError(f"the process '{self._name}' did not answer within {longest:.0f} s")
        try:
            answer = self._pipe.recv()
        except EOFError:
            raise BenchError(f"the process '{self._name}' ended too early") from None
        if isinstance(answer, str):
            raise BenchError(f"{self._name}: {answer}")
        return answer

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._pipe.close()
        self._process.terminate()
        self._process.join(1.0)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
