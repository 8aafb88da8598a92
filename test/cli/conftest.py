"""The command line called in this process, and small recordings for it."""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest
from bag_copies import cut

from jointest_ros.cli.main import main


class Result(NamedTuple):
    """What a call gave."""

    code: int
    out: str
    err: str

    def refusal(self) -> str:
        """The text of the one line with which it was refused."""
        assert self.code == 2
        (line,) = self.err.splitlines()
        assert line.startswith("jointest ")
        return line.split(": error: ", 1)[1]


def call(*arguments: object) -> Result:
    """`jointest` with these arguments."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        try:
            code = main([str(argument) for argument in arguments])
        except SystemExit as end:
            assert isinstance(end.code, int)
            code = end.code
    return Result(code, out.getvalue(), err.getvalue())


@pytest.fixture(scope="session")
def jointest() -> Callable[..., Result]:
    """A function that runs `jointest` with its arguments."""
    return call


@pytest.fixture(scope="session")
def finger(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of 5 s of the finger; its configuration lies beside it. Not to be changed."""
    path = tmp_path_factory.mktemp("finger") / "run"
    result = call(
        "simulate", "finger", "-o", path, "--rate", 100, "--duration", 5, "--zero-pose", 2, "--scenario", "PC"
    )
    assert result.code == 0
    return path


@pytest.fixture(scope="session")
def finger_yaml(finger: Path) -> Path:
    """The configuration of `finger`."""
    return finger.with_name("run.yaml")


@pytest.fixture(scope="session")
def shell(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of 2 s of the exoshell, which several estimators understand."""
    path = tmp_path_factory.mktemp("exoshell") / "shell"
    assert call("simulate", "exoshell", "-o", path, "--rate", 100, "--duration", 2).code == 0
    return path


@pytest.fixture(scope="session")
def published(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, str], Path]:
    """A function that converts a file of a public data set, once: the recording. Not to be changed."""
    folder = tmp_path_factory.mktemp("published")

    def converted(form: str, source: str) -> Path:
        bag = folder / form / Path(source).stem
        if not bag.exists():
            assert call("convert", form, shared_data / form / source, "-o", bag).code == 0
        return bag

    return converted


@pytest.fixture
def damaged(tmp_path: Path) -> Path:
    """A recording of 40 s that broke off; its configuration is that of `finger`."""
    path = tmp_path / "damaged"
    assert call("simulate", "finger", "-o", path, "--rate", 100, "--duration", 40, "--zero-pose", 2).code == 0
    return cut(path, 0.6)
