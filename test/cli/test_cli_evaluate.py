"""`jointest evaluate`: the tables, and the JSON that others read."""

from __future__ import annotations

import json
import pickle
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jointest_ros import config
from jointest_ros.bags.cdr import IMU, decode_joint_state
from jointest_ros.bags.cdr_encode import JointStateEncoder
from jointest_ros.bags.reader import BagReader
from jointest_ros.bags.writer import BagWriter
from jointest_ros.cli.evaluate_bag import Options, Task, evaluate_task

Jointest = Callable[..., Any]
JOINTS = ("finger_mcp", "finger_pip", "finger_dip")
FIGURES = {"rmse_deg", "bias_deg", "std_deg", "max_abs_deg", "samples", "coverage"}
ESTIMATOR = {"joints", "velocities", "torso", "orientation", "nis", "nees", "ns_per_frame", "frames"}


def strict(text: str) -> Any:
    """JSON as the standard has it: without NaN and infinity."""

    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    return json.loads(text, parse_constant=refuse)


def figures(jointest: Jointest, *arguments: object) -> Any:
    """The JSON of an evaluation."""
    result = jointest("evaluate", *arguments, "--json", "-")
    assert (result.code, result.err) == (0, "")
    return strict(result.out)


def copied(bag: Path, to: Path, change: Callable[[str, int, bytes], list[tuple[str, int, bytes]]]) -> Path:
    """A copy of a recording with its messages changed."""
    with BagReader(bag) as reader, BagWriter(to) as writer:
        for topic, kind in reader.topics.items():
            writer.add_topic(topic, kind)
        for message in reader.messages():
            for one in change(*message):
                writer.write(*one)
    return to


def test_the_keys_of_the_json_are_these(jointest: Jointest, finger: Path, finger_yaml: Path) -> None:
    document = figures(jointest, finger, "-c", finger_yaml)
    assert set(document) == {"schema", "bag", "duration_s", "estimators", "input", "settings", "versions"}
    assert set(document["settings"]) == {"skip_s", "moving", "namespace", "robot", "estimators"}
    assert document["settings"]["estimators"]["pcf"]["floor_deg"] == 0.05  # defaults included
    assert set(document["versions"]) == {"jointest_ros", "python", "numpy", "scipy"}
    assert (document["schema"], document["bag"]) == (1, str(finger))
    assert document["duration_s"] == pytest.approx(4.99)
    assert set(document["estimators"]) == {"pcf"}
    pcf = document["estimators"]["pcf"]
    assert set(pcf) == ESTIMATOR
    for table in ("joints", "velocities"):
        assert tuple(pcf[table]) == JOINTS
        for one in pcf[table].values():
            assert set(one) == FIGURES
            assert (one["samples"], one["coverage"]) == (500, 1.0)
            assert one["rmse_deg"] ** 2 == pytest.approx(one["bias_deg"] ** 2 + one["std_deg"] ** 2)
    assert (pcf["torso"], pcf["orientation"]) == ({}, {})
    assert pcf["nis"] > 0.0
    assert pcf["nees"] > 0.0
    assert pcf["frames"] == 500
    assert pcf["ns_per_frame"] > 0.0
    imus = [f"/imu/{link}" for link in ("palm", "proximal", "middle", "distal")]
    assert document["input"] == {topic: {"messages": 500, "used": 500, "refused": {}} for topic in imus}


def test_figures_are_those_of_the_published_estimates(
    jointest: Jointest, finger: Path, finger_yaml: Path, tmp_path: Path
) -> None:
    """Independently: from the CSV of `jointest estimate` and the truth in the recording, in numpy."""
    assert jointest("estimate", finger, "-c", finger_yaml, "-o", tmp_path / "angles.csv").code == 0
    rows = np.genfromtxt(tmp_path / "angles.csv", delimiter=",", names=True, dtype=None)
    with BagReader(finger) as reader:
        truth = [decode_joint_state(data) for *_, data in reader.messages(["/ground_truth/joint_states"])]
    true_positions = np.array([position for _, _, position, _ in truth])
    published = rows["stamp_ns"] >= truth[0][0] + 3_000_000_000
    tables = figures(jointest, finger, "-c", finger_yaml, "--skip", 3)["estimators"]["pcf"]["joints"]
    for column, joint in enumerate(JOINTS):
        error = np.degrees(rows[f"{joint}_rad"] - true_positions[:, column])[published]
        assert tables[joint] == {
            "rmse_deg": pytest.approx(np.sqrt(np.mean(error**2))),
            "bias_deg": pytest.approx(error.mean()),
            "std_deg": pytest.approx(error.std()),
            "max_abs_deg": pytest.approx(abs(error).max()),
            "samples": 200,
            "coverage": 1.0,
        }


def test_json_into_a_file(jointest: Jointest, finger: Path, finger_yaml: Path, tmp_path: Path) -> None:
    out = tmp_path / "figures.json"
    result = jointest("evaluate", finger, "-c", finger_yaml, "--json", out)
    assert (result.code, result.err) == (0, "")
    assert result.out.startswith(f"{finger}: 5.0 s, after 0 s\njoint angle errors, deg\n")
    assert result.out.endswith(f"{out}: figures\n")
    document = strict(out.read_text(encoding="utf-8"))
    cost = document["estimators"]["pcf"].pop("ns_per_frame")
    again = figures(jointest, finger, "-c", finger_yaml)
    assert cost > 0.0
    assert again["estimators"]["pcf"].pop("ns_per_frame") > 0.0
    assert document == again


def test_tables(jointest: Jointest, shell: Path) -> None:
    text = jointest("evaluate", shell, "-c", f"{shell}.yaml", "-e", "kf", "-e", "hall").out
    lines = [line for line in text.splitlines() if "joint_" in line]
    assert [line.split()[1] for line in lines] == (["kf"] * 4 + ["hall"] * 4) * 2
    assert all(line.split()[-3:-1] == ["100.0", "%"] for line in lines)
    assert "joint velocity errors, deg/s" in text
    assert "/hall_voltages" in text


def test_all_sections_unless_named(jointest: Jointest, shell: Path) -> None:
    every = figures(jointest, shell, "-c", f"{shell}.yaml")
    assert {"gyro", "hall", "kf", "kckf"} <= set(every["estimators"])
    chosen = figures(jointest, shell, "-c", f"{shell}.yaml", "-e", "kckf", "-e", "gyro", "-e", "kckf")
    assert list(chosen["estimators"]) == ["kckf", "gyro"]
    for name, one in chosen["estimators"].items():
        assert one["joints"] == every["estimators"][name]["joints"]
    torso = chosen["estimators"]["kckf"]["torso"]
    assert set(torso) == {"x", "y", "z", "geodesic"}
    assert all(set(one) == FIGURES for one in torso.values())


def test_an_estimator_without_a_section_runs_with_its_defaults(
    jointest: Jointest, finger: Path, finger_yaml: Path, tmp_path: Path
) -> None:
    bare = tmp_path / "bare.yaml"
    bare.write_text(finger_yaml.read_text(encoding="utf-8").split("estimators:")[0], encoding="utf-8")
    assert "no section under estimators" in jointest("evaluate", finger, "-c", bare).refusal()
    assert list(figures(jointest, finger, "-c", bare, "-e", "pcf")["estimators"]) == ["pcf"]


def test_the_digest_of_the_robot_changes_with_what_counts_and_not_with_comments(
    jointest: Jointest, finger: Path, finger_yaml: Path, tmp_path: Path
) -> None:
    text = finger_yaml.read_text(encoding="utf-8")
    digests = []
    for name, content in (
        ("same", text),
        ("comment", "# another comment\n" + text),
        ("other", text.replace("name:", "name: other #", 1)),
    ):
        path = tmp_path / f"{name}.yaml"
        path.write_text(content, encoding="utf-8")
        digests.append(figures(jointest, finger, "-c", path)["settings"]["robot"])
    assert digests[0] == digests[1] != digests[2]


def test_a_recording_can_be_evaluated_by_another_process(finger: Path, finger_yaml: Path) -> None:
    """What it needs and what it gives survive pickling, and are the same."""
    task = Task(finger, Options(config.load(finger_yaml), skip_s=1.0))
    here = evaluate_task(task)
    there = pickle.loads(pickle.dumps(evaluate_task(pickle.loads(pickle.dumps(task)))))
    for done in (here, there):
        del done.document["estimators"]["pcf"]["ns_per_frame"]
    assert here == there
    failed = evaluate_task(replace(task, bag=finger / "absent"))
    assert (failed.document, failed.error) == (None, f"{finger / 'absent'}: no such bag")


# -------------------------------------------------------------------- several recordings


def test_several_recordings_give_a_list(jointest: Jointest, finger: Path, finger_yaml: Path, tmp_path: Path) -> None:
    other = shutil.copytree(finger, tmp_path / "other")
    documents = figures(jointest, finger, other, "-c", finger_yaml)
    assert [document["bag"] for document in documents] == [str(finger), str(other)]
    one, two = (document["estimators"]["pcf"]["joints"] for document in documents)
    assert one == two  # no state is carried from one recording to the next


def test_a_recording_that_cannot_be_read_does_not_keep_the_others_from_it(
    jointest: Jointest, finger: Path, finger_yaml: Path, tmp_path: Path
) -> None:
    absent = tmp_path / "absent"
    result = jointest("evaluate", absent, finger, "-c", finger_yaml, "--json", tmp_path / "figures.json")
    assert result.refusal() == f"{absent}: no such bag"
    assert "finger_mcp" in result.out
    (document,) = strict((tmp_path / "figures.json").read_text(encoding="utf-8"))
    assert document["bag"] == str(finger)
    result = jointest("evaluate", absent, absent, "-c", finger_yaml, "--json", "-")
    assert (result.code, result.out, len(result.err.splitlines())) == (2, "", 2)


# -------------------------------------------------------------------- faults


def test_a_damaged_recording_gives_code_2_and_the_figures_of_its_sound_part(
    jointest: Jointest, damaged: Path, finger_yaml: Path
) -> None:
    result = jointest("evaluate", damaged, "-c", finger_yaml, "--json", "-")
    text = result.refusal()
    assert text.startswith(f"{damaged}: damaged after ")
    assert text.endswith("; the figures are of what came before")
    pcf = strict(result.out)["estimators"]["pcf"]
    for joint in JOINTS:
        assert pcf["joints"][joint]["samples"] > 1000
        assert pcf["joints"][joint]["rmse_deg"] < 1.0
    table = jointest("evaluate", damaged, "-c", finger_yaml)
    assert table.code == 2
    assert "finger_mcp" in table.out


def test_no_ground_truth(jointest: Jointest, finger: Path, finger_yaml: Path, tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    with BagReader(finger) as reader, BagWriter(bag) as writer:
        writer.add_topic("/imu/palm", IMU)
        for message in reader.messages(["/imu/palm"]):
            writer.write(*message)
    text = jointest("evaluate", bag, "-c", finger_yaml).refusal()
    assert text.startswith(f"{bag}: no ground truth (topics ground_truth/joint_states, ground_truth/imu_orientation)")


@pytest.mark.parametrize(("at", "asked", "hint"), [("/left", "", "/left"), ("", "/left", "/")])
def test_a_ground_truth_in_another_namespace_is_pointed_at(
    at: str, asked: str, hint: str, jointest: Jointest, finger: Path, finger_yaml: Path, tmp_path: Path
) -> None:
    bag = tmp_path / "bag"
    with BagReader(finger) as reader, BagWriter(bag) as writer:
        for topic, msgtype in reader.topics.items():
            writer.add_topic(f"{at}{topic}", msgtype)
        for topic, time, data in reader.messages():
            writer.write(f"{at}{topic}", time, data)
    text = jointest("evaluate", bag, "-c", finger_yaml, "--namespace", asked).refusal()
    assert text.endswith(f"; it has one with --namespace {hint}")
    assert jointest("evaluate", bag, "-c", finger_yaml, "--namespace", hint).code == 0


def test_a_ground_truth_of_something_else(jointest: Jointest, finger: Path, finger_yaml: Path, tmp_path: Path) -> None:
    knee = JointStateEncoder(["knee"])

    def rename(topic: str, time: int, data: bytes) -> list[tuple[str, int, bytes]]:
        return [(topic, time, knee.encode(time, [0.0]) if "truth" in topic else data)]

    bag = copied(finger, tmp_path / "knee", rename)
    text = jointest("evaluate", bag, "-c", finger_yaml).refusal()
    assert text == f"{bag}: no estimate matches the ground truth (of knee) after 0 s"

    def spoil(topic: str, time: int, data: bytes) -> list[tuple[str, int, bytes]]:
        return [(topic, time, b"" if "truth" in topic else data)]

    bag = copied(finger, tmp_path / "spoilt", spoil)
    result = jointest("evaluate", bag, "-c", finger_yaml)
    assert (result.code, result.out) == (2, "")
    reason, error = result.err.splitlines()
    assert reason.startswith(f"warning: {bag}: 500 ground truth")
    assert error.endswith(f"{bag}: no estimate matches the ground truth (of nothing that can be read) after 0 s")


def test_skipping_everything(jointest: Jointest, finger: Path, finger_yaml: Path) -> None:
    text = jointest("evaluate", finger, "-c", finger_yaml, "--skip", 100).refusal()
    assert text == f"{finger}: no estimate matches the ground truth (of {', '.join(JOINTS)}) after 100 s"


@pytest.mark.parametrize("seconds", ["-1", "nan", "inf"])
def test_skips_that_are_none(seconds: str, jointest: Jointest, finger: Path, finger_yaml: Path) -> None:
    text = jointest("evaluate", finger, "-c", finger_yaml, f"--skip={seconds}").refusal()
    assert text == f"--skip: {float(seconds)} is not allowed; give 0 or more seconds"


def test_an_imu_that_falls_silent(jointest: Jointest, finger: Path, finger_yaml: Path, tmp_path: Path) -> None:
    """Its joint is no longer covered once it is stale; the others are; no figure is NaN."""

    def silence(topic: str, time: int, data: bytes) -> list[tuple[str, int, bytes]]:
        return [] if topic == "/imu/distal" and time > 3_500_000_000 else [(topic, time, data)]

    bag = copied(finger, tmp_path / "bag", silence)
    joints = figures(jointest, bag, "-c", finger_yaml)["estimators"]["pcf"]["joints"]
    assert joints["finger_dip"]["coverage"] == pytest.approx((2.5 + 0.5) / 5.0, abs=0.03)
    assert joints["finger_mcp"]["coverage"] == 1.0
    never = copied(finger, tmp_path / "never", lambda *message: [] if message[0] == "/imu/distal" else [message])
    result = jointest("evaluate", never, "-c", finger_yaml, "--json", "-")
    assert result.code == 0
    dip = strict(result.out)["estimators"]["pcf"]["joints"]["finger_dip"]
    assert (dip["rmse_deg"], dip["samples"], dip["coverage"]) == (None, 0, 0.0)
    assert "-" in jointest("evaluate", never, "-c", finger_yaml).out


def test_refused_messages_are_counted_by_cause(
    jointest: Jointest, finger: Path, finger_yaml: Path, tmp_path: Path
) -> None:
    def spoil(topic: str, time: int, data: bytes) -> list[tuple[str, int, bytes]]:
        return [(topic, time, data), (topic, time, data[:50])] if topic == "/imu/palm" else [(topic, time, data)]

    bag = copied(finger, tmp_path / "bag", spoil)
    counts = figures(jointest, bag, "-c", finger_yaml)["input"]["/imu/palm"]
    assert counts == {"messages": 1000, "used": 500, "refused": {"undecodable": 500}}
    assert "500 undecodable" in jointest("evaluate", bag, "-c", finger_yaml).out


def test_figures_that_cannot_be_written(jointest: Jointest, finger: Path, finger_yaml: Path, tmp_path: Path) -> None:
    for target in (tmp_path / "absent" / "figures.json", tmp_path):
        result = jointest("evaluate", finger, "-c", finger_yaml, "--json", target)
        assert result.refusal().startswith(f"{target}: cannot be written: ")
        assert "finger_mcp" in result.out


def test_a_namespace(jointest: Jointest, finger: Path, finger_yaml: Path, tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    with BagReader(finger) as reader, BagWriter(bag) as writer:
        for topic, kind in reader.topics.items():
            writer.add_topic(f"/left{topic}", kind)
        for topic, time, data in reader.messages():
            writer.write(f"/left{topic}", time, data)
    one = figures(jointest, bag, "-c", finger_yaml, "--namespace", "left")
    two = figures(jointest, finger, "-c", finger_yaml)
    assert one["estimators"]["pcf"]["joints"] == two["estimators"]["pcf"]["joints"]
    assert "/left/imu/palm" in one["input"]


# -------------------------------------------------------------------- pictures


def test_a_picture(jointest: Jointest, finger: Path, finger_yaml: Path, tmp_path: Path) -> None:
    for suffix, magic in ((".svg", b"<?xml"), (".PDF", b"%PDF")):
        result = jointest("evaluate", finger, "-c", finger_yaml, "--plot", tmp_path / f"run{suffix}")
        assert result.code == 0
        assert (tmp_path / f"run{suffix}").read_bytes().startswith(magic)


def test_a_picture_for_each_recording(jointest: Jointest, finger: Path, finger_yaml: Path, tmp_path: Path) -> None:
    same, other = shutil.copytree(finger, tmp_path / "a/run"), shutil.copytree(finger, tmp_path / "other.bag")
    result = jointest("evaluate", finger, same, other, "-c", finger_yaml, "--plot", tmp_path / "errors.png")
    assert result.code == 0
    drawn = sorted(file.name for file in tmp_path.glob("*.png"))
    assert drawn == ["errors_other.bag.png", "errors_run_1.png", "errors_run_2.png"]
    assert all((tmp_path / name).read_bytes().startswith(b"\x89PNG") for name in drawn)


def test_pictures_that_cannot_be_drawn(jointest: Jointest, finger: Path, finger_yaml: Path, tmp_path: Path) -> None:
    for name, suffix in (("run.bmp", ".bmp"), ("run", "")):
        result = jointest("evaluate", finger, "-c", finger_yaml, "--plot", tmp_path / name)
        assert result.refusal() == (
            f"{tmp_path / name}: the suffix '{suffix}' is not allowed; give one of .png, .svg, .pdf"
        )
        assert result.out == ""  # said before the work, not after
    target = tmp_path / "absent" / "run.png"
    result = jointest("evaluate", finger, "-c", finger_yaml, "--plot", target)
    assert result.refusal() == f"{target}: cannot be written: No such file or directory"
