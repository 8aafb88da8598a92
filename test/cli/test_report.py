"""`jointest evaluate --report`: what is in the page and beside it, and that the page needs nothing else."""

from __future__ import annotations

import csv
import json
import shutil
import sys
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import unquote

import numpy as np
import pytest

from jointest_ros.evaluation.report.kinds import KINDS, rows_of

plotly = pytest.importorskip("plotly.offline", reason="the extra 'report' is not installed")

Jointest = Callable[..., Any]


class Content(HTMLParser):
    """Elements, links, tables by id, and embedded data of a page."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.ids: set[str] = set()
        self.attributes: list[tuple[str, str, str]] = []
        self.tables: dict[str, list[list[str]]] = {}
        self.data: dict[str, str] = {}
        self.style, self.text = "", ""
        self._table: list[list[str]] = []
        self._in: list[str] = []
        self._id = ""
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.attributes += [(tag, name, value or "") for name, value in attrs]
        known = dict(attrs)
        if name := known.get("id"):
            self.ids.add(name)
        if tag == "table":
            self._table = self.tables[known.get("id") or ""] = []
        if tag == "tr":
            self._table.append([])
        if tag in ("td", "th"):
            self._table[-1].append("")
        if tag not in ("meta", "br"):
            self._in.append(tag)
        self._id = known.get("id") or ""

    def handle_endtag(self, tag: str) -> None:
        while self._in.pop() != tag:
            pass

    def handle_data(self, data: str) -> None:
        if self._in and self._in[-1] == "script":
            self.data[self._id] = self.data.get(self._id, "") + data
        elif self._in and self._in[-1] == "style":
            self.style += data
        else:
            self.text += data
            if self._table and self._table[-1] and {"td", "th"} & set(self._in):
                self._table[-1][-1] += data


class Report(NamedTuple):
    folder: Path
    page: Content
    document: Any


@pytest.fixture(scope="module")
def report(jointest: Jointest, shell: Path, tmp_path_factory: pytest.TempPathFactory) -> Report:
    """Of the exoshell, which has four estimators and a torso."""
    folder = tmp_path_factory.mktemp("report")
    out, figures = folder / "out", folder / "figures.json"
    result = jointest("evaluate", shell, "-c", f"{shell}.yaml", "--report", out, "--json", figures)
    assert result.code == 0
    assert result.err == f"{out / 'index.html'}: report\n"
    return Report(out, Content(out / "index.html"), json.loads(figures.read_text(encoding="utf-8")))


def test_the_page_names_nothing_outside_of_it(report: Report) -> None:
    for tag, name, value in report.page.attributes:
        assert name not in ("src", "srcset", "data", "action", "background"), (tag, value)
        assert name != "href" or value.startswith("#"), (tag, value)
        assert tag not in ("link", "iframe", "img", "object", "base")
    assert "url(" not in report.page.style
    assert "@import" not in report.page.style
    assert ("meta", "http-equiv", "Content-Security-Policy") in report.page.attributes
    (policy,) = (value for tag, name, value in report.page.attributes if name == "content" and "default-src" in value)
    assert "default-src 'none'" in policy
    assert "http" not in policy
    assert (report.folder / "index.html").stat().st_size < 8e6


def test_sections_and_their_plots_are_there(report: Report) -> None:
    sections = {"comparison", "joints", "velocities", "torso", "consistency", "input", "configuration"}
    assert sections <= report.page.ids
    links = {value[1:] for tag, name, value in report.page.attributes if (tag, name) == ("a", "href")}
    joints = {f"{kind}-joint_{number}" for kind in ("angle", "velocity") for number in range(1, 5)}
    assert links == sections | joints
    assert joints <= report.page.ids
    figures = json.loads(report.page.data["figures"])
    assert set(figures) <= report.page.ids
    assert {"comparison-bars", "angle-joint_1", "distribution-joint_4", "nis", "nees", "intervals"} <= set(figures)
    names = {trace["name"] for trace in figures["angle-joint_1"]["traces"]}
    assert names == {"truth", "kckf", "kf", "gyro", "hall"}


def test_the_figures_are_those_of_the_json(report: Report) -> None:
    assert json.loads(report.page.data["document"]) == report.document
    assert json.loads((report.folder / "figures.json").read_text(encoding="utf-8")) == report.document
    for kind in ("joints", "velocities", "torso"):
        head, *rows = report.page.tables[f"errors-{kind}"]
        wanted = [
            [name, part, *(f"{one[key]:.3f}" for key in ("rmse_deg", "bias_deg", "std_deg", "max_abs_deg"))]
            for name, table in report.document["estimators"].items()
            for part, one in table[kind].items()
        ]
        assert [row[:6] for row in rows] == wanted
        assert head[:6] == ["estimator", "of", "rmse", "bias", "std", "max"]
    bars = json.loads(report.page.data["figures"])["comparison-bars"]["traces"]
    for bar in bars:
        joints = report.document["estimators"][bar["name"]]["joints"]
        shown = dict(zip(bar["x"], bar["y"], strict=True))
        assert {joint: shown[joint] for joint in joints} == pytest.approx(
            {joint: one["rmse_deg"] for joint, one in joints.items()}, rel=1e-3
        )
    best = min(report.document["estimators"], key=lambda name: report.document["estimators"][name]["nees"] or 1e9)
    assert best in report.page.text


def test_the_series_give_the_figures(report: Report) -> None:
    for joint, one in report.document["estimators"]["kckf"]["joints"].items():
        rows = np.genfromtxt(report.folder / f"series/{joint}.csv", delimiter=",", names=True)
        error = rows["kckf_error_deg"]
        assert len(error) == one["samples"]
        assert np.sqrt(np.mean(error**2)) == pytest.approx(one["rmse_deg"], rel=1e-4)
        assert rows["kckf_estimate_deg"] - rows["truth_deg"] == pytest.approx(error, abs=1e-3)
        within = np.mean(np.abs(error) <= 2.0 * rows["kckf_std_deg"])
        (row,) = (row for row in report.page.tables["errors-joints"] if row[:2] == ["kckf", joint])
        assert row[6] == f"{100 * within:.1f} %"
    with (report.folder / "series/errors.csv").open(encoding="utf-8") as stream:
        written = {(row["estimator"], row["kind"], row["of"]): float(row["rmse_deg"]) for row in csv.DictReader(stream)}
    assert written == {
        (name, kind, part): one["rmse_deg"]
        for name, table in report.document["estimators"].items()
        for kind in KINDS
        for part, one in rows_of(table, kind).items()
    }


def test_pictures_lie_beside_the_page(report: Report) -> None:
    found = {file.name: file.read_bytes()[:4] for file in (report.folder / "plots").iterdir()}
    assert found == dict.fromkeys(
        ("angles_and_errors.png", "comparison.png", "consistency.png", "distribution.png"), b"\x89PNG"
    )


def test_input_configuration_and_versions_are_told(report: Report, shell: Path) -> None:
    topics = {row[0]: row[1:] for row in report.page.tables["topics"][1:]}
    counts = report.document["input"]["/imu/imu_1"]
    assert topics["/imu/imu_1"] == [str(counts["messages"]), str(counts["used"]), "none"]
    sensors = {row[0]: row for row in report.page.tables["sensors"][1:]}
    assert sensors["imu_3"][2] == "100.00"
    assert "hall voltages" in sensors
    assert Path(f"{shell}.yaml").read_text(encoding="utf-8") in report.page.text
    told = dict(report.page.tables["versions"][1:])
    assert told["numpy"] == np.__version__
    assert set(report.document["versions"]) <= set(told)
    assert ["kckf", "initial_angle_deg", "10.0"] in report.page.tables["parameters"]


def test_several_recordings_get_a_page_each_and_one_over_them(
    jointest: Jointest, finger: Path, finger_yaml: Path, tmp_path: Path
) -> None:
    odd = shutil.copytree(finger, tmp_path / "a <b> & c")
    absent = tmp_path / "absent"
    out = tmp_path / "out"
    result = jointest("evaluate", finger, odd, absent, "-c", finger_yaml, "--report", out, "--json", "-")
    assert result.code == 2
    index = Content(out / "index.html")
    pages = [value for tag, name, value in index.attributes if (tag, name) == ("a", "href")]
    assert [unquote(page) for page in pages] == ["run/index.html", "a <b> & c/index.html"]
    for page in pages:
        assert "errors-joints" in Content(out / unquote(page)).tables
    first, second = json.loads(result.out)
    rows = {row[0]: row for row in index.tables["recordings"][1:]}
    assert set(rows) == {str(finger), str(odd)}
    assert rows[str(odd)][2] == "pcf"
    assert f"{absent}: no such bag" in index.text
    assert json.loads((out / "figures.json").read_text(encoding="utf-8")) == [first, second]


# -------------------------------------------------------------------- what keeps a report from being made


def test_without_plotly(
    jointest: Jointest, finger: Path, finger_yaml: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "plotly.offline", None)
    result = jointest("evaluate", finger, "-c", finger_yaml, "--report", tmp_path / "out")
    assert result.refusal() == ("--report needs plotly, which is not installed: pip install 'jointest_ros[report]'")
    assert result.out == ""  # said before the work
    assert not (tmp_path / "out").exists()


def test_a_plotly_without_its_script(
    jointest: Jointest, finger: Path, finger_yaml: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def missing() -> str:
        raise FileNotFoundError("plotly.min.js")

    monkeypatch.setattr(plotly, "get_plotlyjs", missing)
    result = jointest("evaluate", finger, "-c", finger_yaml, "--report", tmp_path / "out")
    assert result.refusal() == "--report: the installed plotly lacks its plotly.js: pip install --upgrade plotly"


def test_a_folder_that_cannot_be_made(jointest: Jointest, finger: Path, finger_yaml: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("", encoding="utf-8")
    for target in (tmp_path / "file", tmp_path / "file/out"):
        result = jointest("evaluate", finger, "-c", finger_yaml, "--report", target)
        assert result.refusal().startswith(f"{target}: cannot be made: ")
        assert result.out == ""


@pytest.mark.parametrize("options", [("--namespace", "/nowhere"), ("--smooth",)])
def test_a_refusal_leaves_no_folder(
    options: tuple[str, ...], jointest: Jointest, finger: Path, finger_yaml: Path, tmp_path: Path
) -> None:
    jointest("evaluate", finger, "-c", finger_yaml, "--report", tmp_path / "out", *options).refusal()
    assert list(tmp_path.iterdir()) == []


def test_a_damaged_recording_is_called_so(jointest: Jointest, damaged: Path, finger_yaml: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = jointest("evaluate", damaged, "-c", finger_yaml, "--report", out, "--json", "-")
    assert result.code == 2
    assert "damaged after" in Content(out / "index.html").text
