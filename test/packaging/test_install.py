"""What `pip install`, `colcon build` and `colcon build --symlink-install` give: one layout, and commands that start."""

from __future__ import annotations

import os
import runpy
import shutil
import subprocess
import sys
import tarfile
import venv
from pathlib import Path
from typing import Any
from unittest import mock
from xml.etree import ElementTree

import pytest

import jointest_ros

PROJECT = Path(__file__).resolve().parents[2]
# where this environment has its packages, but for an installed jointest_ros
OTHER_PACKAGES = [p for p in sys.path if p.endswith("-packages") and not Path(p, "jointest_ros").exists()]
WHERE = "import jointest_ros; print(jointest_ros.__file__)"


def run(*command: str | Path, cwd: Path, **variables: str) -> str:
    """The output of a command in an environment in which neither this Python nor its packages are at hand."""
    passed_on = {name: value for name, value in os.environ.items() if name.startswith(("LC_", "LANG"))}
    environment = {"PATH": "/usr/bin:/bin", "HOME": str(cwd), **passed_on, **variables}
    done = subprocess.run(command, cwd=cwd, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"{command} failed:\n{done.stdout}\n{done.stderr}"
    return done.stdout


def run_setup() -> dict[str, Any]:
    """The names that setup.py defines, and under `arguments` what it hands to setuptools."""
    with mock.patch("setuptools.setup") as setup:
        names = runpy.run_path(str(PROJECT / "setup.py"))
    return {**names, "arguments": setup.call_args.kwargs}


SETUP = run_setup()
COMMANDS = sorted(SETUP["COMMANDS"])
DATA = SETUP["DATA"]


def copy_project(to: Path) -> Path:
    """A copy to build in, because builds leave files beside the sources."""
    for name in ("jointest_ros", "resource", "scripts", *DATA):
        if (PROJECT / name).is_dir():
            shutil.copytree(PROJECT / name, to / name, ignore=shutil.ignore_patterns("__pycache__"))
    for name in ("setup.py", "setup.cfg", "pyproject.toml", "package.xml", "LICENSE", "README.md", "MANIFEST.in"):
        shutil.copy(PROJECT / name, to)
    return to


def check_layout(prefix: Path) -> None:
    """ROS finds the package, its executables and every data file in an installation."""
    assert (prefix / "share/ament_index/resource_index/packages/jointest_ros").is_file()
    assert (prefix / "share/jointest_ros/package.xml").is_file()
    executables = [file.name for file in (prefix / "lib/jointest_ros").iterdir() if os.access(file, os.X_OK)]
    assert sorted(executables) == COMMANDS
    files = [file for top in DATA for file in (PROJECT / top).rglob("*") if file.is_file() and file.suffix != ".pyc"]
    data = [file.relative_to(PROJECT) for file in files]
    assert not [file for file in data if not (prefix / "share/jointest_ros" / file).exists()]


def colcon_build(workspace: Path, *arguments: str) -> Path:
    """Builds a copy of the project in a new workspace; returns where it is installed."""
    pytest.importorskip("colcon_core", reason="colcon is not installed")
    if " " in sys.executable:
        pytest.skip("colcon cannot install commands for a Python in a folder with a space in its name")
    copy_project(workspace / "src/jointest_ros")
    colcon = "import sys; from colcon_core.command import main; sys.exit(main())"
    run(sys.executable, "-c", colcon, "build", *arguments, cwd=workspace, PYTHONPATH=os.pathsep.join(OTHER_PACKAGES))
    return workspace / "install/jointest_ros"


def pip_install(folder: Path, *arguments: str, archive: Path | None = None) -> tuple[Path, Path]:
    """Installs a copy of the project, or an archive, into a new environment; returns it and its site-packages."""
    pytest.importorskip("setuptools", minversion="70.1", reason="an older setuptools builds no wheel by itself")
    prefix, source = folder / "venv", archive or copy_project(folder / "source")
    venv.create(prefix, symlinks=True)
    python = prefix / "bin/python"
    site = Path(run(python, "-c", "import sysconfig; print(sysconfig.get_path('purelib'))", cwd=folder).strip())
    # what jointest_ros needs, and setuptools, come from this environment
    (site / "this.pth").write_text("\n".join(OTHER_PACKAGES), encoding="utf-8")
    offline = ("--no-index", "--no-deps", "--no-build-isolation", "--disable-pip-version-check")
    run(sys.executable, "-m", "pip", "--python", python, "install", *offline, *arguments, source, cwd=folder)
    return prefix, site


def start_after_sourcing(prefix: Path, command: str) -> str:
    """The output of a command in a shell that has sourced the workspace."""
    workspace = prefix.parents[1]
    return run("sh", "-c", f". install/local_setup.sh && {command}", cwd=workspace)


def test_pip_install_gives_the_commands_in_bin_and_for_ros2_run(tmp_path: Path) -> None:
    prefix, site = pip_install(tmp_path)

    check_layout(prefix)
    sources = {file.relative_to(PROJECT) for file in (PROJECT / "jointest_ros").rglob("*.py")}
    assert not {file for file in sources if not (site / file).is_file()}
    for folder in ("bin", "lib/jointest_ros"):
        assert "jointest" in run(prefix / folder / "jointest", "--help", cwd=tmp_path)


def test_pip_install_editable_gives_the_same_and_follows_edits(tmp_path: Path) -> None:
    prefix, _ = pip_install(tmp_path, "--editable")

    check_layout(prefix)
    assert "jointest" in run(prefix / "lib/jointest_ros/jointest", "--help", cwd=tmp_path)
    where = run(prefix / "bin/python", "-c", WHERE, cwd=tmp_path)
    assert Path(where.strip()) == tmp_path / "source/jointest_ros/__init__.py"


def test_wheel_made_from_the_source_archive_brings_all_that_a_user_needs(tmp_path: Path) -> None:
    pytest.importorskip("build")
    pytest.importorskip("setuptools", minversion="70.1", reason="an older setuptools builds no wheel by itself")
    source = copy_project(tmp_path / "copy")
    path = os.pathsep.join(OTHER_PACKAGES)
    run(sys.executable, "-m", "build", "--no-isolation", cwd=source, PYTHONPATH=path)  # the wheel from the sdist
    (archive,) = (source / "dist").glob("*.tar.gz")
    with tarfile.open(archive) as tar:
        names = {name.partition("/")[2] for name in tar.getnames()}
    assert {"README.md", "LICENSE", "setup.py", "scripts/jointest", "config/finger.yaml"} <= names
    (wheel,) = (source / "dist").glob("*.whl")

    prefix, _ = pip_install(tmp_path, archive=wheel)

    check_layout(prefix)
    share = prefix / "share/jointest_ros"
    bag, config = share / "bags/finger", share / "config/finger.yaml"
    printed = run(prefix / "bin/jointest", "evaluate", bag, "--config", config, "-e", "pcf", cwd=tmp_path)
    assert "finger_mcp" in printed


def test_colcon_build_gives_the_commands_on_the_path_and_for_ros2_run(tmp_path: Path) -> None:
    prefix = colcon_build(tmp_path)

    check_layout(prefix)
    assert "jointest" in start_after_sourcing(prefix, "jointest --help")
    assert "jointest" in start_after_sourcing(prefix, f"'{prefix}/lib/jointest_ros/jointest' --help")


def test_colcon_symlink_install_gives_the_same_and_follows_edits(tmp_path: Path) -> None:
    prefix = colcon_build(tmp_path, "--symlink-install")

    check_layout(prefix)
    assert "jointest" in start_after_sourcing(prefix, "jointest --help")
    assert "jointest" in start_after_sourcing(prefix, f"'{prefix}/lib/jointest_ros/jointest' --help")
    source = tmp_path / "src/jointest_ros"
    assert (prefix / "share/jointest_ros/package.xml").resolve() == source / "package.xml"
    where = start_after_sourcing(prefix, f"'{sys.executable}' -c '{WHERE}'")
    assert Path(where.strip()).resolve() == source / "jointest_ros/__init__.py"


def test_every_command_has_its_script_for_ros2_run() -> None:
    scripts = {file.name: file for file in (PROJECT / "scripts").iterdir()}
    assert sorted(scripts) == COMMANDS
    assert len({file.read_bytes() for file in scripts.values()}) == 1
    assert all(os.access(file, os.X_OK) for file in scripts.values())


def test_the_version_is_the_same_everywhere() -> None:
    package_xml = ElementTree.parse(PROJECT / "package.xml").getroot()
    versions = {package_xml.findtext("version"), SETUP["arguments"]["version"], jointest_ros.__version__}
    assert len(versions) == 1


def test_make_installs_anew_when_a_data_folder_changes() -> None:
    assert runpy.run_path(str(PROJECT / "tools/environment.py"))["DATA"] == DATA
