"""`jointest inspect`: every mistake made on purpose is named, and what is sound raises no alarm."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from inspect_bags import Message, exchanged, inspected, not_ok, only, readings, rewrite
from scipy.spatial.transform import Rotation

from jointest_ros.bags.reader import BagReader

Jointest = Callable[..., Any]
PROJECT = Path(__file__).resolve().parents[2]
BAGS, CONFIGURATIONS = PROJECT / "bags", PROJECT / "config"
FINGER, FINGER_YAML = BAGS / "finger", CONFIGURATIONS / "finger.yaml"
DEGREES = 180.0 / math.pi


def turned(axis: str, degrees: float, sensor: str = "middle") -> Any:
    """The readings of a sensor that is mounted so."""
    matrix = Rotation.from_euler(axis, degrees, degrees=True).as_matrix()
    return readings(sensor, matrix, matrix)


@pytest.fixture
def changed(tmp_path: Path) -> Callable[[Callable[[Any], None]], Path]:
    """The configuration of the finger, changed by a function of its document."""

    def write(change: Callable[[Any], None]) -> Path:
        document = yaml.safe_load(FINGER_YAML.read_text(encoding="utf-8"))
        change(document)
        path = tmp_path / "changed.yaml"
        path.write_text(yaml.safe_dump(document, sort_keys=False), encoding="utf-8")
        return path

    return write


# ---------------------------------------------------------------- sound ones


@pytest.mark.parametrize("robot", ["finger", "softhand_gripper", "two_link_accel", "exoshell"])
def test_shipped_recordings_are_sound(robot: str, jointest: Jointest, tmp_path: Path) -> None:
    code, findings = inspected(jointest, tmp_path, BAGS / robot, "--config", CONFIGURATIONS / f"{robot}.yaml")
    told = [("look", "calibration_file", "calibration")] if robot == "exoshell" else []  # it is made by calibrate hall
    assert (code, not_ok(findings)) == (0, told)


@pytest.mark.parametrize(
    ("rig", "options"),
    [
        ("finger", "--scenario PA --zero-pose 3"),
        ("finger", "--scenario PD --zero-pose 3"),
        ("finger", "--scenario PE --zero-pose 3"),
        ("gripper", "--scenario palm --zero-pose 3"),
        ("slider_crank", ""),
    ],
)
def test_simulated_recordings_raise_no_alarm(rig: str, options: str, jointest: Jointest, tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    chosen = ("--rate", 100, "--duration", 12, "--seed", 3, *options.split())
    assert jointest("simulate", rig, "-o", bag, *chosen).code == 0
    code, findings = inspected(jointest, tmp_path, bag, "--config", tmp_path / "bag.yaml")
    assert (code, not_ok(findings)) == (0, [])


@pytest.mark.parametrize(
    ("form", "source", "configuration", "told"),
    [
        ("song", "raw_roll_medium.mat", "song_roll.yaml", {"order", "frozen"}),
        ("broad", "16_undisturbed_fast_translation_B.hdf5", "broad.yaml", set()),
    ],
)
def test_real_recordings(
    form: str,
    source: str,
    configuration: str,
    told: set[str],
    jointest: Jointest,
    published: Callable[[str, str], Path],
    tmp_path: Path,
) -> None:
    """In the first one stamps are repeated, and imu_1 on the base says the same from 765 s to the end."""
    if form == "broad":
        pytest.importorskip("h5py")
    bag = published(form, source)
    code, findings = inspected(jointest, tmp_path, bag, "--config", CONFIGURATIONS / configuration)
    assert {kind for _, _, kind in not_ok(findings)} == told
    assert code == int("frozen" in told)
    if "frozen" in told:
        (frozen,) = [finding for finding in findings if finding["kind"] == "frozen"]
        assert frozen["subject"] == "imu_1" and "for 735.1 s from 764.8 s on" in frozen["text"]
        with BagReader(bag) as reader:  # and so it is
            said = [data[20:] for _, _, data in reader.messages(("/imu/imu_1",))]
        assert len(set(said[-70_000:])) == 1 and len(set(said[:70_000])) > 10_000


# ---------------------------------------------------------------- mistakes in recordings


def silent(message: Message, time: float) -> Message | None:
    return None if 8.0 < time < 9.5 else message


def every_other() -> Callable[[Message, float], Message | None]:
    """Leaves out every second message."""
    seen: dict[str, int] = {}

    def change(message: Message, _time: float) -> Message | None:
        seen[message.topic] = seen.get(message.topic, 0) + 1
        return message if seen[message.topic] % 2 else None

    return change


def frozen(*fields: str) -> Callable[[Message, float], Message]:
    """Repeats one reading for two seconds."""
    held: dict[str, Message] = {}

    def change(message: Message, time: float) -> Message:
        if not 8.0 < time < 10.0:
            return message
        first = held.setdefault(message.topic, message)
        return replace(message, **{field: getattr(first, field) for field in fields})

    return change


def copied(message: Message, time: float) -> Iterator[Message] | Message | None:
    """The topic of the middle link brings what the palm's sensor says, with noise of its own."""
    if message.topic == "/imu/middle":
        return None
    if message.topic == "/imu/palm":
        noise = 1e-3 * np.sin(1e5 * time * np.array([1.0, 2.0, 3.0]))
        return iter([message, replace(message, topic="/imu/middle", gyro=message.gyro + noise)])
    return message


ALL = {"palm", "proximal", "middle", "distal"}
MISTAKES: dict[str, tuple[Any, set[str], str, str]] = {  # change, subjects, kind, words of the text
    "accelerometers in g": (readings("*", accel=1.0 / 9.80665), ALL, "units", "in g, not in m/s^2"),
    "one in mg": (readings("middle", accel=1000.0 / 9.80665), {"middle"}, "units", "in mg, not in m/s^2"),
    "gyros in deg/s": (readings("*", gyro=DEGREES), ALL, "units", "in deg/s, not in rad/s"),
    "half the full scale": (readings("middle", gyro=0.5), {"middle"}, "scale", "reads 1 / 2.0"),
    "gyro x reversed": (readings("middle", gyro=[-1, 1, 1]), {"middle"}, "polarity", "x is its -x"),
    "gyro y reversed": (readings("middle", gyro=[1, -1, 1]), {"middle"}, "polarity", "y is its -y"),
    "accel z reversed": (readings("middle", accel=[1, 1, -1]), {"middle"}, "polarity", "accelerometer z is"),
    "gyro x, y exchanged": (
        readings("middle", gyro=[[0, 1, 0], [1, 0, 0], [0, 0, 1]]),
        {"middle"},
        "polarity",
        "x is its y",
    ),
    "left-handed frame": (readings("middle", [1, -1, 1], [1, -1, 1]), {"middle"}, "polarity", "left-handed"),
    "mounting turned about z": (turned("z", 90), {"middle"}, "mounting", "turned by 90 deg"),
    "mounted the other way round": (turned("z", 180), {"middle"}, "mounting", "the other way round"),
    "the one before it the other way round": (
        turned("z", 180, "proximal"),
        {"proximal"},
        "mounting",
        "the other way round",
    ),
    "neighbours exchanged": (exchanged("proximal", "middle"), {"proximal"}, "exchanged", "'proximal' and 'middle'"),
    "first and last exchanged": (exchanged("palm", "distal"), {"palm"}, "exchanged", "'palm' and 'distal'"),
    "sensor on another link": (copied, {"middle"}, "body", "as one with 'palm'"),
    "frozen": (only("middle", frozen("gyro", "accel")), {"middle"}, "frozen", "for 2.0 s from 8.0 s on"),
    "accelerometer frozen": (only("middle", frozen("accel")), {"middle"}, "frozen", "accel repeats"),
    "clock at half speed": (lambda m, t: replace(m, stamp=m.stamp // 2), ALL, "clock", "0.500 s in a second"),
    "no stamps": (lambda m, t: replace(m, stamp=0), ALL, "clock", "all stamps are 0 s"),
    "sent twice": (only("middle", lambda m, t: iter([m, m])), {"middle"}, "order", "repeat the stamp"),
    "gyro of NaN": (only("middle", lambda m, t: replace(m, gyro=m.gyro * math.nan)), {"middle"}, "finite", "in all of"),
    "topic renamed": (
        only("middle", lambda m, t: replace(m, topic="/imu/medial")),
        {"middle"},
        "topic",
        "not in the rec",
    ),
    "in a namespace": (
        lambda m, t: replace(m, topic=f"/left{m.topic}"),
        {"topics"},
        "topic",
        "all of them are under '/left'",
    ),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_wrong_and_named(mistake: str, jointest: Jointest, tmp_path: Path) -> None:
    change, subjects, kind, words = MISTAKES[mistake]
    bag = rewrite(FINGER, tmp_path / "bag", change)
    code, findings = inspected(jointest, tmp_path, bag, "--config", FINGER_YAML)
    wrong = [finding for finding in findings if finding["level"] == "wrong"]
    assert code == 1
    assert {finding["subject"] for finding in wrong} == subjects
    assert {finding["kind"] for finding in wrong} == {kind}
    assert all(words in finding["text"] and finding["action"] for finding in wrong)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (only("middle", silent), ("look", "middle", "gap")),
        (only("middle", every_other()), ("look", "middle", "rate")),
        (only("middle", lambda m, t: replace(m, stamp=m.stamp - 50_000_000)), ("look", "middle", "clock")),
        (only("middle", lambda m, t: replace(m, stamp=m.stamp + 10**12)), ("look", "middle", "clock")),
        (readings("middle", accel=1.08), ("look", "middle", "calibration")),
        (turned("z", 10), ("look", "middle", "mounting")),
        (turned("x", 90), ("look", "finger_pip", "zero")),
    ],
)
def test_what_may_be_meant_is_only_shown(
    change: Any, told: tuple[str, str, str], jointest: Jointest, tmp_path: Path
) -> None:
    bag = rewrite(FINGER, tmp_path / "bag", change)
    code, findings = inspected(jointest, tmp_path, bag, "--config", FINGER_YAML)
    assert told in not_ok(findings)
    if told[2] != "clock" or "ahead" not in str(findings):
        assert code == 0


def test_clipped_gyros_are_told_without_a_known_full_scale(jointest: Jointest, tmp_path: Path) -> None:
    limit = math.radians(125.0)
    bag = rewrite(FINGER, tmp_path / "bag", lambda m, t: replace(m, gyro=np.clip(m.gyro, -limit, limit)))
    findings = inspected(jointest, tmp_path, bag)[1]
    told = {finding["subject"] for finding in findings if finding["kind"] == "saturated"}
    assert told == {"/imu/middle", "/imu/distal"}


def test_a_recording_without_rest_cannot_take_its_zero_pose(jointest: Jointest, tmp_path: Path) -> None:
    bag = rewrite(FINGER, tmp_path / "bag", lambda m, t: m if t > 5.0 else None)
    code, findings = inspected(jointest, tmp_path, bag, "--config", FINGER_YAML)
    assert code == 1 and ("wrong", "start", "still") in not_ok(findings)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda d: d["robot"]["joints"]["finger_pip"].update(axis="y"), ("wrong", "finger_pip", "axis")),
        (lambda d: d["robot"]["joints"]["finger_pip"].update(axis="-x"), ("wrong", "finger_pip", "truth")),
        (lambda d: d["sensors"]["middle"].update(mounting={"rpy_deg": [0, 0, 90]}), ("wrong", "middle", "mounting")),
        (lambda d: d["sensors"]["middle"].update(topic="/imu/median"), ("wrong", "middle", "topic")),
        (lambda d: d["sensors"]["middle"].update(frame_id="mid"), ("wrong", "middle", "frame_id")),
        (lambda d: d["timing"].update(max_gap=0.01), ("wrong", "palm", "timing")),
        (lambda d: d["sensors"].pop("distal"), ("wrong", "estimators.pcf", "estimator")),
        (lambda d: d["sensors"]["middle"].pop("position"), ("look", "position", "geometry")),
        (lambda d: d.update(calibration_file="none.yaml"), ("look", "calibration_file", "calibration")),
        (lambda d: d.pop("estimators"), ("look", "estimators", "estimator")),
    ],
)
def test_mistakes_in_a_configuration(
    change: Any, told: tuple[str, str, str], jointest: Jointest, tmp_path: Path, changed: Callable[..., Path]
) -> None:
    code, findings = inspected(jointest, tmp_path, FINGER, "--config", changed(change))
    assert told in not_ok(findings)
    assert code == (told[0] == "wrong")


def holding() -> Callable[[Message, float], Message]:
    """The first reading of each topic, with a little noise, throughout."""
    held: dict[str, Message] = {}
    generator = np.random.default_rng(7)

    def change(message: Message, _time: float) -> Message:
        first = held.setdefault(message.topic, message)
        if message.volts is not None:
            return replace(message, volts=first.volts + 0.01 * generator.standard_normal(len(first.volts)))
        gyro, accel = (scale * generator.standard_normal(3) for scale in (1e-3, 1e-2))
        return replace(message, gyro=first.gyro + gyro, accel=first.accel + accel)

    return change


@pytest.mark.parametrize("robot", ["finger", "exoshell", "two_link_accel"])
def test_a_recording_in_which_nothing_moves(robot: str, jointest: Jointest, tmp_path: Path) -> None:
    bag, chosen = rewrite(BAGS / robot, tmp_path / "bag", holding()), CONFIGURATIONS / f"{robot}.yaml"
    for arguments in ((bag,), (bag, "-c", chosen)):
        code, findings = inspected(jointest, tmp_path, *arguments)
        assert code == 0 and ("look", "recording", "motion") in not_ok(findings)


def test_joints_that_are_not_judged_are_named(jointest: Jointest, tmp_path: Path, changed: Callable[..., Path]) -> None:
    def two_axes(document: Any) -> None:
        joint = document["robot"]["joints"]["finger_mcp"]
        joint["axes"] = [joint.pop("axis"), "z"]
        joint.pop("limits_deg", None)
        document.pop("estimators")

    told = not_ok(inspected(jointest, tmp_path, FINGER, "--config", changed(two_axes))[1])
    assert ("look", "finger_mcp_z", "motion") in told
    brief = rewrite(FINGER, tmp_path / "brief", lambda m, t: m if t < 1.0 else None)
    told = not_ok(inspected(jointest, tmp_path, brief, "--config", FINGER_YAML)[1])
    assert ("look", "finger_pip", "unjudged") in told


def test_hall_sensors_in_another_order(jointest: Jointest, tmp_path: Path) -> None:
    def swapped(message: Message, _time: float) -> Message:
        return message if message.volts is None else replace(message, volts=message.volts[[2, 3, 0, 1, 5, 4, 6, 7]])

    bag = rewrite(BAGS / "exoshell", tmp_path / "bag", swapped)
    code, findings = inspected(jointest, tmp_path, bag, "--config", CONFIGURATIONS / "exoshell.yaml")
    told = {(f["subject"], f["kind"]) for f in findings if f["level"] == "wrong"}
    assert code == 1
    assert told == {(f"hall[{n}]", "order") for n in range(4)} | {(f"hall[{n}]", "sign") for n in (4, 5)}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (exchanged("a1", "b2"), "look exchanged"),
        (exchanged("b1", "b2"), "negative square"),
        (readings("b1", accel=[[0, 1, 0], [-1, 0, 0], [0, 0, 1]]), "'b1' looks turned"),
    ],
)
def test_arrays_that_contradict_each_other(change: Any, words: str, jointest: Jointest, tmp_path: Path) -> None:
    bag = rewrite(BAGS / "two_link_accel", tmp_path / "bag", change)
    code, findings = inspected(jointest, tmp_path, bag, "--config", CONFIGURATIONS / "two_link_accel.yaml")
    (found,) = [finding for finding in findings if finding["kind"] == "array"]
    assert code == 1 and found["level"] == "wrong"
    assert words in found["text"] + found["action"]


# ---------------------------------------------------------------- advice


def test_advice_on_noise_lowers_the_error(jointest: Jointest, tmp_path: Path, changed: Callable[..., Path]) -> None:
    generator = np.random.default_rng(5)

    def noisier(message: Message, _time: float) -> Message:
        return replace(message, gyro=message.gyro + 0.02 * generator.standard_normal(3))

    bag, figures = rewrite(FINGER, tmp_path / "bag", noisier), tmp_path / "figures.json"

    def errors(chosen: Path) -> tuple[list[dict[str, str]], list[float], float]:
        assert jointest("inspect", bag, "-c", chosen, "--json", figures).code == 0
        advice = json.loads(figures.read_text(encoding="utf-8"))["advice"]
        assert jointest("evaluate", bag, "-c", chosen, "--skip", 4, "--json", figures).code == 0
        pcf = json.loads(figures.read_text(encoding="utf-8"))["estimators"]["pcf"]
        return advice, [joint["rmse_deg"] for joint in pcf["joints"].values()], pcf["nees"]

    def loose(document: Any) -> None:
        document["estimators"]["pcf"].update(still_gyro_dps=5.0)

    advice, before, overconfident = errors(changed(loose))
    (one,) = advice
    assert one["key"] == "sensor_defaults.gyro_noise_dps"
    assert float(one["value"]) == pytest.approx(math.degrees(0.02) / 10.0, rel=0.1)  # of 100 Hz

    def advised(document: Any) -> None:
        loose(document)
        document["sensor_defaults"]["gyro_noise_dps"] = float(one["value"])

    advice, after, honest = errors(changed(advised))
    assert advice == []
    assert sum(after) < 0.7 * sum(before)
    assert 0.3 < honest < 2.0 < overconfident


# ---------------------------------------------------------------- the command


def test_a_recording_alone(jointest: Jointest) -> None:
    result = jointest("inspect", FINGER)
    assert (result.code, result.err) == (0, "")
    assert "/imu/middle" in result.out and "nothing wrong found, 0 to look at" in result.out


def test_a_configuration_alone(jointest: Jointest) -> None:
    result = jointest("inspect", "--config", FINGER_YAML)
    assert (result.code, result.err) == (0, "")
    assert "3 joint angles, 4 sensors; pcf can be made of it" in result.out


def test_neither_is_refused(jointest: Jointest, tmp_path: Path) -> None:
    assert jointest("inspect").refusal() == "give a recording, --config YAML, or both"
    assert "no such bag" in jointest("inspect", tmp_path / "none").refusal()
    assert "no such configuration" in jointest("inspect", FINGER, "-c", tmp_path / "none.yaml").refusal()


def test_json_on_standard_output(jointest: Jointest) -> None:
    document = json.loads(jointest("inspect", FINGER, "-c", FINGER_YAML, "--json", "-").out)
    assert document["schema"] == 1 and document["level"] == "ok"
    assert document["still_start_s"] == pytest.approx(3.0, abs=0.1)
    assert document["sensors"]["middle"]["rate_hz"] == pytest.approx(100.0)
    assert document["joints"]["finger_pip"]["off_deg"] == pytest.approx([0.0, 0.0], abs=0.1)


def test_a_damaged_recording_is_inspected_as_far_as_it_goes(
    jointest: Jointest, damaged: Path, finger_yaml: Path
) -> None:
    result = jointest("inspect", damaged, "-c", finger_yaml)
    assert result.code == 2
    assert "the findings rest on what came before" in result.err and "gyro and accelerometer agree" in result.out
