"""A signal while a program still loads, which takes a second: no traceback from the middle of an import."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

_BY_DEFAULT: dict[signal.Signals, Any] = {
    signal.SIGINT: signal.default_int_handler,
    signal.SIGTERM: signal.SIG_DFL,
}  # of Python


@contextmanager
def ended_by(*numbers: signal.Signals, text: str = "", code: int = 0) -> Iterator[None]:
    """SIGINT or SIGTERM ends the process at once, with `text` on standard error and this exit code.

    Not by an exception: C code that is being imported turns one into an ImportError. Only where the signal has Python's
    own handler: who ignores or handles it goes on doing so.
    """

    def leave(*_: Any) -> None:
        os.write(2, text.encode())
        os._exit(code)

    main = threading.current_thread() is threading.main_thread()
    ours = [number for number in numbers if main and signal.getsignal(number) is _BY_DEFAULT[number]]
    for number in ours:
        signal.signal(number, leave)
    try:
        yield
    finally:
        for number in ours:
            if signal.getsignal(number) is leave:
                signal.signal(number, _BY_DEFAULT[number])
