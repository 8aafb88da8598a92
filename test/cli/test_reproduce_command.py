"""`jointest reproduce` as a user meets it."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from jointest_ros.reproduction.catalogue import REPRODUCTIONS

Jointest = Callable[..., Any]


def test_without_a_name_it_lists_all(jointest: Jointest) -> None:
    result = jointest("reproduce")
    assert result.code == 0
    assert all(name in result.out for name in REPRODUCTIONS)


def test_it_prints_the_table_and_writes_plot_and_figures(jointest: Jointest, tmp_path: Path) -> None:
    folder = tmp_path / "new" / "folder"
    names = ("kckf-observability", "kckf-human")
    result = jointest("reproduce", *names, "-o", folder, "--runs", 1, "--duration", 10)
    assert result.code == 0
    assert all(text in result.out for text in ("paper", "ours", "Conditions", str(folder / "kckf-human.png")))
    assert {path.name for path in folder.iterdir()} == {f"{name}.{kind}" for name in names for kind in ("json", "png")}
    assert (folder / "kckf-human.png").read_bytes().startswith(b"\x89PNG")
    document = json.loads((folder / "kckf-human.json").read_text(encoding="utf-8"))
    assert document["schema"] == 1 and document["name"] == "kckf-human"
    assert document["options"] == {"seed": 0, "runs": 1, "duration_s": 10.0}
    assert document["tables"][0]["rows"][0]["method"] == "gyro"


def test_an_unknown_name_is_refused_with_the_names(jointest: Jointest, tmp_path: Path) -> None:
    text = jointest("reproduce", "kckf-observability", "kckf-tabel1", "-o", tmp_path / "none").refusal()
    assert "kckf-tabel1" in text and all(name in text for name in REPRODUCTIONS)
    assert not (tmp_path / "none").exists()


def test_an_option_without_effect_is_refused(jointest: Jointest, tmp_path: Path) -> None:
    text = jointest("reproduce", "kckf-observability", "--runs", 3, "-o", tmp_path).refusal()
    assert "--runs" in text and "kckf-table1" in text


def test_bad_options_are_refused(jointest: Jointest, tmp_path: Path) -> None:
    assert "duration_s: 1 " in jointest("reproduce", "kckf-drift", "--duration", 1, "-o", tmp_path).refusal()
    missing = tmp_path / "none.npz"
    result = jointest("reproduce", "kckf-table1", "--data", missing, "-o", tmp_path)
    assert str(missing) in result.refusal() and not result.out


def test_an_output_that_cannot_be_written_is_refused_before_the_work(jointest: Jointest, tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("")
    for target in (file, file / "below"):
        assert str(target) in jointest("reproduce", "all", "-o", target).refusal()
    if os.geteuid():  # root may write anywhere
        tmp_path.chmod(0o500)
        assert "cannot be written" in jointest("reproduce", "all", "-o", tmp_path).refusal()
        tmp_path.chmod(0o700)
