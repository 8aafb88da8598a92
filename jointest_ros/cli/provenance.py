"""How figures came about: the command line, the files that were read, and a digest of the robot."""

from __future__ import annotations

import hashlib
import json
import shlex
import sys
from datetime import datetime
from pathlib import Path

import yaml

from jointest_ros.config import Configuration
from jointest_ros.evaluation.report.content import Origin


def origin(configuration: Configuration) -> Origin:
    """Of this call."""
    words = ["jointest", *sys.argv[1:]]
    date = datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %Z")
    return Origin(shlex.join(words), date, tuple((str(path), text) for path, text in _files(configuration)))


def digest(configuration: Configuration) -> str:
    """Of what the configuration and the calibration file say of robot, sensors and timing, comments apart."""
    found = hashlib.sha256()
    for _, text in _files(configuration):
        content = yaml.safe_load(text)
        content.pop("estimators", None)  # their parameters are told one by one
        found.update(json.dumps(content, sort_keys=True, default=str).encode())
    return found.hexdigest()[:16]


def _files(configuration: Configuration) -> list[tuple[Path, str]]:
    """Configuration and calibration, as far as they are there."""
    paths = [path for path in (configuration.path, configuration.calibration_file) if path and path.exists()]
    return [(path, path.read_text(encoding="utf-8")) for path in paths]
