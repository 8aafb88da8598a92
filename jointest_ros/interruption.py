"""Ctrl-C while a program still loads, which takes a second: no traceback from the middle of an import."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def ended_by_ctrl_c(text: str = "", code: int = 0) -> Iterator[None]:
    """SIGINT ends the process at once, with `text` on standard error and this exit code.

    Not by an exception: C code that is being imported turns one into an ImportError. Only where SIGINT would raise
    KeyboardInterrupt: who ignores or handles it goes on doing so.
    """

    def leave(*_: Any) -> None:
        os.write(2, text.encode())
        os._exit(code)

    ours = threading.current_thread() is threading.main_thread()
    if not ours or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    signal.signal(signal.SIGINT, leave)
    try:
        yield
    finally:
        if signal.getsignal(signal.SIGINT) is leave:
            signal.signal(signal.SIGINT, signal.default_int_handler)
