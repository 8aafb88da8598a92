"""Where the shipped configurations and recordings are looked for."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from jointest_ros import resources
from jointest_ros.core.errors import ConfigurationError


def installed(prefix: Path) -> Path:
    file = prefix / "share/jointest_ros/config/only_there.yaml"
    file.parent.mkdir(parents=True)
    file.touch()
    return file


def test_the_source_tree_comes_first() -> None:
    source_tree = Path(resources.__file__).resolve().parents[1]
    assert resources.find("config/finger.yaml") == source_tree / "config/finger.yaml"


def test_what_pip_installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    file = installed(tmp_path)
    assert resources.find("config/only_there.yaml") == file


def test_what_colcon_installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = installed(tmp_path / "workspace")
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"/opt/other:{tmp_path / 'workspace'}")
    assert resources.find("config/only_there.yaml") == file


def test_what_is_nowhere(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("AMENT_PREFIX_PATH", raising=False)
    with pytest.raises(ConfigurationError, match=r"config/absent.yaml: not found in .*share/jointest_ros.*reinstall"):
        resources.find("config/absent.yaml")
