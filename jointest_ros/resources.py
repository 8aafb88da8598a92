"""Finds the configurations and recordings that come with the package, wherever it was installed."""

from __future__ import annotations

import os
import site
import sys
from pathlib import Path

from jointest_ros.core.errors import ConfigurationError


def find(relative: str) -> Path:
    """Path of a shipped file or folder, such as "config/finger.yaml".

    Looked for in the source tree, in the environment's `share/jointest_ros` (pip) and in those of the sourced ROS
    workspaces (colcon).

    Raises:
        ConfigurationError: it is in none of them.
    """
    prefixes = [
        sys.prefix,
        site.getuserbase(),
        *filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)),
    ]
    roots = [Path(__file__).resolve().parent.parent, *(Path(p) / "share" / "jointest_ros" for p in prefixes)]
    for root in roots:
        if (root / relative).exists():
            return root / relative
    raise ConfigurationError(f"{relative}: not found in {', '.join(map(str, roots))}; reinstall the package")
