"""The rules of the house: who may import whom, and what no file may name."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[2]
PACKAGE = PROJECT / "jointest_ros"

BASE = {"core", "sim", "evaluation"}
MAY_IMPORT = {
    "core": {"core"},
    "sim": {"core", "sim"},
    "evaluation": BASE,
    "reproduction": BASE | {"reproduction"},
    "benchmark": BASE | {"config", "bags", "reproduction", "resources", "benchmark"},
    "config": BASE | {"config"},
    "bags": BASE | {"bags"},
    "resources": {"core"},
    "threads": set(),
    "interruption": set(),
    "view": BASE | {"config", "resources", "view"},
    "nodes": BASE | {"config", "bags", "benchmark", "nodes", "threads", "interruption"},
    "cli": BASE
    | {"config", "bags", "benchmark", "nodes", "reproduction", "resources", "view", "cli", "threads", "interruption"},
}
ROS = re.compile(r"(rclpy|rpyutils|rosidl_\w+|\w+_(msgs|srvs|interfaces))$")


def imports(file: Path) -> Iterator[str]:
    """The full names of all modules that a file imports, wherever in it the import stands."""
    package = file.relative_to(PROJECT).parent.parts
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"), str(file))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            module = ".".join([*base, *([node.module] if node.module else [])])
            # `from jointest_ros import core` imports the part, not only the package
            yield from (f"{module}.{alias.name}" for alias in node.names) if module == PACKAGE.name else (module,)


def part_of(file: Path) -> str:
    """The first level below jointest_ros: core, sim, config, ..."""
    return file.relative_to(PACKAGE).parts[0].removesuffix(".py")


SOURCES = [file for file in sorted(PACKAGE.rglob("*.py")) if part_of(file) != "__init__"]


def test_core_imports_only_the_standard_library_numpy_and_scipy() -> None:
    allowed = sys.stdlib_module_names | {"numpy", "scipy", PACKAGE.name}
    foreign = {
        f"{file.relative_to(PROJECT)} imports {module}"
        for file in SOURCES
        if part_of(file) == "core"
        for module in imports(file)
        if module.split(".")[0] not in allowed
    }
    assert not foreign


def test_ros_is_imported_under_nodes_alone() -> None:
    ros = {
        f"{file.relative_to(PROJECT)} imports {module}"
        for file in SOURCES
        if part_of(file) != "nodes"
        for module in imports(file)
        if ROS.match(module.split(".")[0])
    }
    assert not ros


def test_imports_between_the_parts_go_one_way() -> None:
    wrong = {
        f"{file.relative_to(PROJECT)} imports {module}"
        for file in SOURCES
        for module in imports(file)
        if module.startswith(f"{PACKAGE.name}.")
        and module.split(".")[1] not in MAY_IMPORT[part_of(file)] | {"__version__"}
    }
    assert not wrong


def test_no_file_names_a_machine_path_or_a_registry_host() -> None:
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=PROJECT, capture_output=True, check=False)
    if listed.returncode:
        pytest.skip("not a git checkout")
    forbidden = re.compile(rb"(?:^|[^\w.])/(?:root|work|farm)/|(?:pypi|pythonhosted|npmjs)\.org", re.MULTILINE)
    named = {
        f"{name}: {match.group().decode()}"
        for name in filter(None, listed.stdout.decode().split("\0"))
        if (PROJECT / name).is_file() and (match := forbidden.search((PROJECT / name).read_bytes()))
    }
    assert not named
