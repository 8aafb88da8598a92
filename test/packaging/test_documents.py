"""What the documents tell a user to write works as it stands there."""

from __future__ import annotations

import ast
import dataclasses
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from jointest_ros.core.catalogue import ESTIMATORS

ROOT = Path(__file__).parents[2]


def test_estimator_of_ones_own(tmp_path: Path) -> None:
    """The class of docs/own_estimator.md, installed beside this package, is evaluated beside `pcf`."""
    code = re.search(r"```python\n(.*?)```", (ROOT / "docs/own_estimator.md").read_text(encoding="utf-8"), re.DOTALL)
    assert code
    (tmp_path / "tilt.py").write_text(code[1], encoding="utf-8")
    installed = tmp_path / "tilt-1.0.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text("Metadata-Version: 2.1\nName: tilt\nVersion: 1.0\n", encoding="utf-8")
    entry = "[jointest_ros.estimators]\ntilt = tilt:Tilt\nbroken = tilt:Missing\npcf = tilt:Tilt\n"
    (installed / "entry_points.txt").write_text(entry, encoding="utf-8")

    done = _jointest(tmp_path, "evaluate", "bags/finger", "--config", "config/finger.yaml", "--skip", "3", "-e", "tilt")

    assert done.returncode == 0, done.stderr
    joints = json.loads((tmp_path / "out.json").read_text())["estimators"]["tilt"]["joints"]
    assert all(0.0 < joint["rmse_deg"] < 5.0 and joint["coverage"] == 1.0 for joint in joints.values())
    assert "broken = tilt:Missing is left out: AttributeError" in done.stderr
    assert "pcf = tilt:Tilt is left out: it must be an Estimator, named 'pcf' as no other is" in done.stderr


def test_package_of_ones_own() -> None:
    """The setup.py of docs/own_estimator.md is Python that says where its estimator and its node are."""
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs/own_estimator.md").read_text(encoding="utf-8"), re.DOTALL)
    (text,) = (block for block in blocks if "entry_points" in block)
    (call,) = (node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Call))
    assert isinstance(call.func, ast.Name)
    assert call.func.id == "setup"
    (value,) = (keyword.value for keyword in call.keywords if keyword.arg == "entry_points")
    assert ast.literal_eval(value) == {
        "jointest_ros.estimators": ["tilt = my_package.tilt:Tilt"],
        "console_scripts": ["tilt_node = my_package.tilt_node:main"],
    }


def test_documentation_builds_without_a_warning(tmp_path: Path) -> None:
    """`make docs`, with every link between the pages and every parameter's table."""
    pytest.importorskip("sphinx")
    pytest.importorskip("rclpy", reason="the tables of the nodes' parameters")
    command = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-b", "html", "docs", str(tmp_path)]
    done = subprocess.run(command, check=False, cwd=ROOT, capture_output=True, text=True, timeout=240)

    assert done.returncode == 0, done.stderr
    page = (tmp_path / "parameters.html").read_text(encoding="utf-8")
    for name, kind in ESTIMATORS.items():
        assert f"<h2>{name}<" in page
        assert all(f">{field.name}<" in page for field in dataclasses.fields(kind.Params))


def _jointest(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """The command with what is installed in `folder`, writing out.json there."""
    code = "from jointest_ros.cli.main import main; raise SystemExit(main())"
    return subprocess.run(
        [sys.executable, "-c", code, *arguments, "--json", str(folder / "out.json")],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(folder), str(ROOT)])},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
