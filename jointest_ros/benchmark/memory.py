"""Memory of this process."""

from __future__ import annotations

import resource
import sys
from pathlib import Path


def memory(what: str = "VmRSS") -> float:
    """MB (1e6 bytes): `VmRSS`, resident now, or `VmHWM`, the most so far; where there is no /proc always the latter."""
    try:
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    except OSError:
        unit = 1 if sys.platform == "darwin" else 1024
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6
    (line,) = (line for line in lines if line.startswith(what))
    return int(line.split()[1]) * 1024 / 1e6
