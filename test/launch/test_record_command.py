"""`jointest record` as a process: its ends, and what each leaves behind."""

from __future__ import annotations

import resource
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from processes import TIMEOUT, Process, finish, run, start

from jointest_ros.bags.errors import BagError
from jointest_ros.bags.reader import BagReader

Launch = Callable[..., Process]


@pytest.fixture(scope="module")
def robot() -> Iterator[None]:
    """A simulated finger at 1 kHz, without end."""
    parameters = ("source:=finger", "rate_hz:=1000.0", "loop:=true", "duration_s:=20.0", "wait_for_subscribers:=0")
    process = start("sim_hardware_node", "--ros-args", *(word for p in parameters for word in ("-p", p)))
    yield
    process.terminate()
    finish(process)


def wait(condition: Callable[[], bool], process: Process) -> None:
    end = time.monotonic() + TIMEOUT
    while not condition():
        assert time.monotonic() < end
        assert process.poll() is None, process.communicate()
        time.sleep(0.02)


def record(launch: Launch, bag: Path, config: Path, *arguments: str) -> Process:
    """A recording that has some chunks on the disk."""
    process = launch("jointest", "record", "-o", str(bag), "--config", str(config), *arguments)
    file = bag / f"{bag.name}.mcap"
    wait(lambda: file.exists() and file.stat().st_size > 300_000, process)
    return process


def read(bag: Path) -> tuple[int, str]:
    """Messages that can be read, and the damage."""
    count = 0
    with BagReader(bag) as reader:
        try:
            for _ in reader.messages():
                count += 1
        except BagError:
            assert reader.damage
        return count, reader.damage


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.usefixtures("robot")
def test_signals(number: int, launch: Launch, tmp_path: Path, finger_config: Path) -> None:
    bag = tmp_path / "run"
    process = record(launch, bag, finger_config)
    process.send_signal(number)
    done = finish(process)
    assert (done.returncode, done.stderr) == (0, "")
    *topics, total, following = done.stdout.splitlines()
    assert [line.split()[0] for line in topics] == [
        f"/imu/{name}:" for name in ("palm", "proximal", "middle", "distal")
    ]
    assert following == f"next: jointest inspect {bag} --config {finger_config}"
    count, damage = read(bag)
    assert damage == ""
    assert total.startswith(f"{bag}: {count} messages, ")
    assert sorted(file.name for file in bag.iterdir()) == ["metadata.yaml", "run.mcap"]


@pytest.mark.usefixtures("robot")
def test_a_kill(launch: Launch, tmp_path: Path, finger_config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # what a killed process leaves in shared memory keeps later ones from hearing others, about once in ten (Fast DDS)
    monkeypatch.setenv("FASTDDS_BUILTIN_TRANSPORTS", "UDPv4")
    bag = tmp_path / "run"
    process = record(launch, bag, finger_config)
    process.kill()
    finish(process)
    count, damage = read(bag)
    assert "end of the file is missing" in damage
    assert count > 1000


@pytest.mark.usefixtures("robot")
def test_duration(tmp_path: Path, finger_config: Path) -> None:
    bag = tmp_path / "run"
    done = run("jointest", "record", "-o", str(bag), "--config", str(finger_config), "--duration", "1.5")
    assert done.returncode == 0, done.stderr
    with BagReader(bag) as reader:
        assert reader.duration_s == pytest.approx(1.5, abs=0.5)


@pytest.mark.usefixtures("robot")
def test_no_room(tmp_path: Path, finger_config: Path) -> None:
    """A file that must not grow further, as on a full disk."""
    bag, room = tmp_path / "run", 400_000
    process = start("jointest", "record", "-o", str(bag), "--config", str(finger_config))
    resource.prlimit(process.pid, resource.RLIMIT_FSIZE, (room, room))
    done = finish(process)
    assert done.returncode == 2
    count, damage = read(bag)
    assert damage == ""
    assert count > 1000
    assert (bag / "run.mcap").stat().st_size <= room
    line = f"cannot be written: File too large; what fitted, {count} messages, is a sound recording"
    assert done.stderr.splitlines()[-1] == f"jointest record: error: {bag}: {line}"


def test_nothing_came(launch: Launch, tmp_path: Path, finger_config: Path) -> None:
    bag = tmp_path / "run"
    process = launch("jointest", "record", "-o", str(bag), "--config", str(finger_config), "--namespace", "/nowhere")
    wait(bag.exists, process)
    process.terminate()
    done = finish(process)
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line.startswith(
        f"jointest record: error: {bag}: nothing is recorded: no message came on /nowhere/imu/palm, "
    )
    assert not bag.exists()
