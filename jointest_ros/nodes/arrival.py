"""When messages arrived, although a busy executor takes them late."""

from __future__ import annotations

import time

_PAUSE = 200_000  # ns without a callback, after which the next message has only just come
_LONGEST = 20_000_000  # ns that a burst may last: beyond it the time goes on in any case


class ArrivalClock:
    """Messages that are taken one after the other without a pause had been waiting: they count as arrived together.

    Hall messages are paired with frames by arrival. What the executor did in between (a timer, another node, the
    garbage collector) must not part what was sent together; that the EventsExecutor of rclpy 7.1 cannot pass on when a
    message was sent or received leaves this. One clock serves all nodes of a process.

    Attributes:
        began: when the latest callback began, monotonic ns.
    """

    def __init__(self) -> None:
        self.began = 0
        self._arrival = 0
        self._busy_until = 0

    def now(self) -> int:
        """Arrival of the message whose callback begins, monotonic ns."""
        now = self.began = time.monotonic_ns()
        if now - self._busy_until > _PAUSE or now - self._arrival > _LONGEST:
            self._arrival = now
        return self._arrival

    def done(self) -> int:
        """A callback ends, now: monotonic ns."""
        now = self._busy_until = time.monotonic_ns()
        return now


arrivals = ArrivalClock()
