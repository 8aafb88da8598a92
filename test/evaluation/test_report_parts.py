"""Parts of a report by themselves: the summary's words, the regularity of sensors, the size of the plots."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from jointest_ros.core.frame import Recording
from jointest_ros.evaluation.inspection.stream import Stream
from jointest_ros.evaluation.panels import Curve, Panel
from jointest_ros.evaluation.report import figures
from jointest_ros.evaluation.report.inputs import HALL, deliveries
from jointest_ros.evaluation.report.markup import Cell, page, table
from jointest_ros.evaluation.report.summary import overall, ranking, statements


def judged(rmse: float, samples: int = 100, coverage: float = 1.0, bias: float = 0.0) -> dict[str, Any]:
    std = float(np.sqrt(rmse**2 - bias**2))
    return {
        "rmse_deg": rmse,
        "bias_deg": bias,
        "std_deg": std,
        "max_abs_deg": 3 * rmse,
        "samples": samples,
        "coverage": coverage,
    }


NOTHING = {"rmse_deg": None, "bias_deg": None, "std_deg": None, "max_abs_deg": None, "samples": 0, "coverage": 0.0}


def estimator(nees: float | None = 1.0, **joints: dict[str, Any]) -> dict[str, Any]:
    return {"joints": joints, "velocities": {}, "torso": {}, "orientation": {}, "nis": None, "nees": nees}


def document(**estimators: dict[str, Any]) -> dict[str, Any]:
    counts = {"messages": 100, "used": 100, "refused": {}}
    return {"estimators": {name.replace("_", ":"): one for name, one in estimators.items()}, "input": {"/imu": counts}}


# -------------------------------------------------------------------- summary


def test_all_joints_are_pooled_by_their_samples() -> None:
    found = overall(estimator(a=judged(3.0, 100), b=judged(4.0, 300)))
    assert found is not None
    assert found.rmse_deg == pytest.approx(np.sqrt((100 * 9.0 + 300 * 16.0) / 400))
    assert (found.worst, found.max_abs_deg, found.coverage) == ("b", 12.0, 1.0)


def test_a_joint_without_estimate_lowers_the_coverage_and_the_rank() -> None:
    half = estimator(a=judged(1.0), b=NOTHING)
    found = overall(half)
    assert found is not None
    assert found.coverage == pytest.approx(0.5)
    assert [name for name, _ in ranking({"half": half, "whole": estimator(a=judged(2.0), b=judged(2.0))})] == [
        "whole",
        "half",
    ]
    assert overall(estimator(a=NOTHING)) is None


def test_inclinations_count_where_there_is_no_joint() -> None:
    one = estimator()
    one["orientation"] = {"imu": {"inclination": judged(0.4)}}
    found = overall(one)
    assert found is not None
    assert (found.kind, found.rmse_deg) == ("inclination", pytest.approx(0.4))


@pytest.mark.parametrize(
    ("nees", "level", "words"),
    [
        (1.0, "good", "as large as it states"),
        (9.0, "attention", "3 times"),
        (0.04, "attention", "0.2 times"),
        (14400.0, "attention", "120 times"),
    ],
)
def test_consistency_in_words(nees: float, level: str, words: str) -> None:
    cards = {card.title: card for card in statements(document(pcf=estimator(nees, a=judged(1.0))), [], "")}
    assert cards["Consistency"].level == level
    assert words in cards["Consistency"].text
    assert cards["Consistency"].figure == f"NEES {nees:g}"


def test_a_peer_that_is_nearer_is_named_first_but_not_judged() -> None:
    found = document(pcf=estimator(a=judged(2.0)), peer_vqf=estimator(None, a=judged(1.0)))
    cards = {card.title: card for card in statements(found, [], "")}
    assert cards["Smallest error"].text.startswith("peer:vqf: ")
    assert "Next: pcf with 2°" in cards["Smallest error"].text
    assert "pcf" in cards["Consistency"].text


def test_an_offset_and_lost_samples_are_told() -> None:
    cards = {
        card.title: card for card in statements(document(pcf=estimator(a=judged(1.0, coverage=0.7, bias=0.8))), [], "")
    }
    assert "without its mean 0.6°" in cards["Smallest error"].text
    assert cards["Coverage"].figure == "70.0 %"


def test_the_input_in_words() -> None:
    whole = document(pcf=estimator(a=judged(1.0)))
    assert statements(whole, [], "")[-1].level == "good"
    assert statements(whole, ["imu is frozen"], "")[-1].level == "attention"
    assert statements(whole, [], "damaged")[-1].level == "bad"
    whole["input"]["/hall"] = {"messages": 100, "used": 90, "refused": {"unpaired": 10}}
    card = statements(whole, [], "")[-1]
    assert (card.level, card.figure) == ("attention", "95 %")
    assert "/hall" in card.text


# -------------------------------------------------------------------- input


def test_rate_gaps_and_loss_of_a_sensor() -> None:
    stamps = np.arange(1000, dtype=np.int64) * 10_000_000
    gyro = np.zeros((1000, 3))
    gyro[[100, 500, 501, 502]] = np.nan
    hall = np.zeros((1000, 2))
    hall[1::2] = np.nan
    found = deliveries(Recording(stamps, {"imu": gyro}, {"imu": gyro}, hall=hall))
    imu = found["imu"]
    assert imu.rate_hz == pytest.approx(100.0)
    assert (imu.gaps, imu.longest_s) == (2, pytest.approx(0.04))
    assert imu.missing == pytest.approx(4 / 1000)
    assert imu.jitter_s == pytest.approx(0.0, abs=1e-12)
    assert found[HALL].rate_hz == pytest.approx(50.0)
    assert found[HALL].gaps == 0


def test_jitter_is_that_of_the_inspection() -> None:
    shaken = np.cumsum(10_000_000 + np.random.default_rng(3).normal(0.0, 300_000.0, 2000)).astype(np.int64)
    shaken[1000:] += 40_000_000  # a loss, which is none
    values = np.zeros((2000, 3))
    found = deliveries(Recording(shaken, {"imu": values}, {"imu": values}))["imu"].jitter_s
    assert found == Stream("/imu", "imu", shaken, shaken, values, values).jitter
    assert found == pytest.approx(3e-4, rel=0.1)  # of white jitter it is the standard deviation


def test_a_sensor_of_no_or_one_sample_and_a_clock_that_was_set_back() -> None:
    gyro = np.full((3, 3), np.nan)
    assert np.isnan(deliveries(Recording(np.arange(3), {"imu": gyro}, {}))["imu"].rate_hz)
    gyro[1] = 0.0
    assert deliveries(Recording(np.arange(3), {"imu": gyro}, {}))["imu"].longest_s == 0.0
    stamps = np.array([0, 10, 20, 0, 10, 20], dtype=np.int64) * 1_000_000
    imu = deliveries(Recording(stamps, {"imu": np.zeros((6, 3))}, {}))["imu"]
    assert (imu.rate_hz, imu.gaps) == (pytest.approx(100.0), 0)


# -------------------------------------------------------------------- plots and tables


def test_a_long_recording_stays_small_and_keeps_its_spike() -> None:
    count = 150_000  # 25 min at 100 Hz
    seconds = np.arange(count) * 0.01
    error = np.random.default_rng(1).normal(size=count)
    error[77_777] = 50.0
    curves = {name: Curve(seconds, error, error + 1.0, np.full(count, 2.0)) for name in ("a", "b", "c")}
    figure = figures.joint_figure(
        Panel("hinge", curves, (seconds, error)), {"a": 0, "b": 1, "c": 2}, figures.stretches(20)
    )
    assert len(json.dumps(figure)) < 2_000_000
    (shown,) = (t for t in figure["traces"] if t["name"] == "a" and t["yaxis"] == "y2" and "band" not in t)
    assert max(value for value in shown["y"] if value is not None) == 50.0
    assert shown["x"][shown["y"].index(50.0)] == 777.77


def test_many_lines_share_what_a_page_can_hold() -> None:
    assert figures.stretches(1) > figures.stretches(50) > figures.stretches(400)
    assert figures.stretches(50) * 50 * 2 <= 200_000
    assert figures.stretches(100_000) == figures.stretches(10_000)


def test_gaps_are_drawn_as_gaps_and_numbers_are_json() -> None:
    seconds = np.concatenate([np.arange(100) * 0.01, 5.0 + np.arange(100) * 0.01])
    figure = figures.joint_figure(Panel("hinge", {"a": Curve(seconds, np.zeros(200))}), {"a": 0}, 1000)
    (line,) = figure["traces"]
    assert line["y"][100] is None
    assert figure["errors"] == "yaxis"
    json.dumps(figure, allow_nan=False)


def test_what_a_recording_is_called_cannot_become_markup() -> None:
    name = "</script><script>alert(1)</script>"
    text = page(name, table([name], [[name], [Cell(name, True)]], name), {name: {}}, {"bag": name}, "library")
    assert "<script>alert" not in text
    assert text.count("</script>") == 4
