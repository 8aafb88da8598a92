"""The configuration reader: what it understands, and that whatever is wrong is said in one line."""

from __future__ import annotations

import copy
import math
import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from jointest_ros import config
from jointest_ros.core.errors import ConfigurationError
from jointest_ros.core.robot import STANDARD_GRAVITY

CONFIGURATIONS = Path(__file__).resolve().parents[2] / "config"
ARM: dict[str, Any] = {
    "robot": {
        "name": "arm",
        "links": ["upper", "lower", "hand"],
        "joints": {
            "elbow": {"parent": "upper", "child": "lower", "axis": "-y", "limits_deg": [0, 150]},
            "wrist": {
                "parent": "lower",
                "child": "hand",
                "axes": ["x", [0, 3, 4]],
                "limits_deg": [[-80, 80], [-20, 30]],
            },
        },
    },
    "sensor_defaults": {"gyro_noise_dps": 0.01, "accel_noise_ug": 300},
    "sensors": {
        "upper": {"position": [0, 0.1, 0], "mounting": {"rpy_deg": [0, 0, 90]}, "gyro_range_dps": 1000},
        "lower": {"mounting": {"quaternion": [0, 0, 0, 1]}, "delay_ms": 5, "accel_range_g": 16},
        "back": {"link": "hand", "topic": "/hand/imu_2", "frame_id": "chip", "mag": True, "gyro_noise_dps": 0.02},
    },
    "hall_defaults": {"hall_range": [0.3, 1.7]},
    "hall": [{"joint": "elbow", "mirrored": True, "noise_v": 0.02}],
    "timing": {"max_gap": 0.1},
    "estimators": {"pcf": {"formulation": "relative", "kp": 2}, "kckf": None},
}
GONE = object()


def changed(path: str, value: Any) -> str:
    """ARM as YAML, with another value at a path such as "robot.links" (GONE: without it)."""
    document = copy.deepcopy(ARM)
    *parents, last = path.split(".")
    section: Any = document
    for key in parents:
        section = section[int(key)] if isinstance(section, list) else section[key]
    key = int(last) if isinstance(section, list) else last
    if value is GONE:
        del section[key]
    else:
        section[key] = value
    return yaml.safe_dump(document, sort_keys=False)


def refusal(text: str) -> str:
    with pytest.raises(ConfigurationError) as raised:
        config.parse(text)
    assert len(str(raised.value).splitlines()) == 1
    assert len(str(raised.value)) < 500
    return str(raised.value)


def test_everything_is_si_once_it_is_read() -> None:
    read = config.parse(yaml.safe_dump(ARM, sort_keys=False))
    robot = read.robot
    elbow, wrist = robot.joints
    assert (robot.name, robot.links) == ("arm", ("upper", "lower", "hand"))
    assert robot.coordinates == ("elbow", "wrist_x", "wrist_2")
    assert (elbow.parent, elbow.child, elbow.axes) == ("upper", "lower", ((0.0, -1.0, 0.0),))
    assert elbow.limits == ((0.0, math.radians(150.0)),)
    assert wrist.axes[1] == pytest.approx((0.0, 0.6, 0.8))
    assert wrist.limits is not None
    assert wrist.limits[1] == pytest.approx((math.radians(-20), math.radians(30)))
    upper, lower, back = robot.sensors
    assert upper.mounting == pytest.approx((0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)))
    assert upper.position == (0.0, 0.1, 0.0)
    assert upper.gyro_noise == pytest.approx(math.radians(0.01))
    assert upper.accel_noise == pytest.approx(300e-6 * STANDARD_GRAVITY)
    assert (upper.gyro_range, upper.accel_range) == (pytest.approx(math.radians(1000)), math.inf)
    assert (lower.delay, lower.accel_range) == (pytest.approx(0.005), pytest.approx(16 * STANDARD_GRAVITY))
    assert (lower.topic, lower.mag_topic, lower.mag) == ("imu/lower", "mag/lower", False)
    assert (back.link, back.topic, back.frame_id, back.mag) == ("hand", "/hand/imu_2", "chip", True)
    assert back.gyro_noise == pytest.approx(math.radians(0.02))
    (hall,) = robot.hall
    assert (hall.joint, hall.mirrored, hall.noise, hall.hall_range) == ("elbow", True, 0.02, (0.3, 1.7))
    assert read.timing.max_gap == 0.1
    assert list(read.estimators) == ["pcf", "kckf"]
    assert vars(read.estimators["pcf"])["kp"] == 2.0


@pytest.mark.parametrize("path", sorted(CONFIGURATIONS.glob("*.yaml")), ids=lambda path: path.stem)
def test_shipped_configurations(path: Path) -> None:
    read = config.load(path)
    assert read.path == path
    assert read.estimators
    assert read.robot.sensors


def test_a_robot_is_all_that_must_be_given() -> None:
    read = config.parse("robot: {links: [imu]}\nsensors:\nestimators:\n")
    assert read.robot.links == ("imu",)
    assert read.estimators == {}


def test_yaml_conveniences() -> None:
    text = """
    robot: {links: [a, b], joints: {j: &hinge {parent: a, child: b, axis: z}}}
    sensors:
      a: &imu {accel_noise_ug: 2e2, gyro_noise_dps: 1e-2}
      b: {<<: *imu, gyro_noise_dps: .5}
    """
    a, b = config.parse(text).robot.sensors
    assert (a.accel_noise, b.accel_noise) == (pytest.approx(200e-6 * STANDARD_GRAVITY),) * 2
    assert (a.gyro_noise, b.gyro_noise) == (pytest.approx(math.radians(0.01)), pytest.approx(math.radians(0.5)))


WRONG: list[tuple[str, Any, str]] = [
    # path, value, what the error must say (a regular expression)
    ("robot", GONE, "robot: missing"),
    ("robot", [1], r"robot: \[1\] is not allowed; give keys"),
    ("robot.links", GONE, "robot.links: None is not allowed; give a list"),
    ("robot.links", [], r"robot.links: \[\] .* at least one name"),
    ("robot.links", "upper", "robot.links: 'upper'"),
    ("robot.links", ["upper", 3], r"robot.links: \['upper', 3\]"),
    ("robot.links", ["upper", "lower", "hand", "hand"], "links: 'hand' is given twice"),
    ("robot.name", [1], r"robot.name: \[1\] is not allowed; give a text"),
    ("robot.world", [1], r"robot.world: \[1\] is not allowed; give the name of a link"),
    ("robot.world", "floor", "world: 'floor' is not a link; did you mean 'lower'?"),
    ("robot.world", "hand", "world: 'hand' moves on 'lower'; the world link has no parent"),
    ("robot.world", "upper", "sensor 'upper'.link: 'upper' is the world, which stands still; sensors belong on links"),
    ("robot.joints.elbow.roll_link", "long", "robot.joints.elbow.roll_link: 'long'"),
    ("robot.joints.elbow.roll_link", [0, 0.01, 0], "'elbow'.roll_link: .*perpendicular"),
    ("robot.joints.wrist.roll_link", [0, 0, 0.01], "'wrist'.roll_link: .*one axis"),
    ("robot.joint", {}, "robot.joint: unknown key; did you mean 'joints'?"),
    ("robot.joints", ["elbow"], "robot.joints: .*give keys"),
    ("robot.joints.elbow", None, "robot.joints.elbow.parent: None"),
    ("robot.joints.elbow.parent", GONE, "robot.joints.elbow.parent: None .*name of a link"),
    ("robot.joints.elbow.parent", "uper", "'elbow'.parent: 'uper' is not a link; did you mean 'upper'?"),
    ("robot.joints.elbow.child", "foot", "'elbow'.child: 'foot' is not a link; known: upper, lower, hand"),
    ("robot.joints.elbow.child", 5, "robot.joints.elbow.child: 5"),
    ("robot.joints.elbow.child", "hand", "'hand' has the parent 'upper' already"),
    ("robot.joints.elbow.child", "upper", "'upper' is its own ancestor"),
    ("robot.joints.wrist.child", "upper", "'upper' is its own ancestor"),
    ("robot.joints.elbow.axis", GONE, "robot.joints.elbow: give either axis .* or axes"),
    ("robot.joints.elbow.axes", ["x"], "robot.joints.elbow: give either axis .* or axes"),
    ("robot.joints.elbow.axis", "w", "robot.joints.elbow.axis: 'w' .*x, y, z, -x, -y, -z or three numbers"),
    ("robot.joints.elbow.axis", [1, 0], r"robot.joints.elbow.axis: \[1, 0\] .*three numbers"),
    ("robot.joints.elbow.axis", [1, 0, 0, 0], r"robot.joints.elbow.axis: \[1, 0, 0, 0\]"),
    ("robot.joints.elbow.axis", [0, 0, 0], "robot.joints.elbow.axis: .*not all zero"),
    ("robot.joints.elbow.axis", [1, "x", 0], r"robot.joints.elbow.axis: \[1, 'x', 0\]"),
    ("robot.joints.elbow.axis", [1, math.nan, 0], r"robot.joints.elbow.axis: \[1, nan, 0\]"),
    ("robot.joints.elbow.axis", [math.inf, 0, 0], r"robot.joints.elbow.axis: \[inf, 0, 0\]"),
    ("robot.joints.elbow.axis", [1e300, 0, 0], "robot.joints.elbow.axis"),
    ("robot.joints.elbow.axis", [True, 0, 0], r"robot.joints.elbow.axis: \[True, 0, 0\]"),
    ("robot.joints.elbow.limits", [0, 1], "robot.joints.elbow.limits: unknown key; did you mean 'limits_deg'?"),
    ("robot.joints.elbow.limits_deg", [150, 0], r"robot.joints.elbow.limits_deg: \[150, 0\] .*low below high"),
    ("robot.joints.elbow.limits_deg", [10, 10], "robot.joints.elbow.limits_deg"),
    ("robot.joints.elbow.limits_deg", 150, "robot.joints.elbow.limits_deg: 150"),
    ("robot.joints.elbow.limits_deg", [0, math.inf], "robot.joints.elbow.limits_deg"),
    ("robot.joints.elbow.continuous", "yes, please", "robot.joints.elbow.continuous: .*true or false"),
    ("robot.joints.wrist.axes", [], r"robot.joints.wrist.axes: \[\] .*one to three axes"),
    ("robot.joints.wrist.axes", ["x"] * 4, "robot.joints.wrist.axes: .*one to three axes"),
    ("robot.joints.wrist_x", {"parent": "hand", "child": "upper", "axis": "x"}, "'wrist_x' is given twice"),
    ("robot.joints.wrist.axes", ["x", "w"], r"robot.joints.wrist.axes\[1\]: 'w'"),
    ("robot.joints.elbow.axis", ["y", "x"], r"robot.joints.elbow.axis: .*one axis; several are axes: \[y, x\]"),
    ("robot.joints.wrist.axes", ["x", "-x"], "joint 'wrist'.axes: .*parallel"),
    ("robot.joints.wrist.names", "flexion", "robot.joints.wrist.names: 'flexion' .*a name for each axis"),
    ("robot.joints.wrist.names", ["flexion"], "robot.joints.wrist.names: .*a name for each axis"),
    ("robot.joints.wrist.names", ["flexion", 2], r"robot.joints.wrist.names\[1\]: 2"),
    ("robot.joints.wrist.limits_deg", [-80, 80], "robot.joints.wrist.limits_deg: .*for each axis"),
    ("robot.joints.wrist.limits_deg", [[-80, 80]], "robot.joints.wrist.limits_deg: .*for each axis"),
    ("sensors", ["upper"], "sensors: .*give keys"),
    ("sensors", {1: {}}, "sensors: the key: 1 is not allowed; give a name, in quotes"),
    ("sensors", {"": {}}, "sensors: the key: '' is not allowed"),
    ("sensors.upper.link", "upperr", "'upper'.link: 'upperr' is not a link; did you mean 'upper'?"),
    ("sensors.palm", {}, "'palm'.link: 'palm' is not a link; known: upper, lower, hand"),
    ("sensors.upper.link", [], r"sensors.upper.link: \[\]"),
    ("sensors.upper.positon", [0, 0, 0], "sensors.upper.positon: unknown key; did you mean 'position'?"),
    ("sensors.upper.position", [0, 0], r"sensors.upper.position: \[0, 0\] .*3 numbers \(m\)"),
    ("sensors.upper.position", [0, 0, ".inf"], "sensors.upper.position"),
    ("sensors.upper.position", [0, 0, math.nan], "sensors.upper.position: .*nan"),
    ("sensors.upper.position", "0 0 0", "sensors.upper.position: '0 0 0'"),
    ("sensors.upper.mounting", [0, 0, 0], "sensors.upper.mounting: .*give keys"),
    ("sensors.upper.mounting", {"rpy": [0, 0, 0]}, "sensors.upper.mounting.rpy: unknown key; did you mean 'rpy_deg'?"),
    ("sensors.upper.mounting.rpy_deg", [0, 0], r"sensors.upper.mounting.rpy_deg: \[0, 0\] .*3 numbers"),
    ("sensors.upper.mounting.quaternion", [0, 0, 0, 1], "sensors.upper.mounting: give either"),
    ("sensors.lower.mounting.quaternion", [0, 0, 1], "sensors.lower.mounting.quaternion: .*4 numbers"),
    ("sensors.lower.mounting.quaternion", [0, 0, 0, 2], "sensors.lower.mounting.quaternion: .*of length 1"),
    ("sensors.lower.mounting.quaternion", [0, 0, 0, 0], "sensors.lower.mounting.quaternion: .*of length 1"),
    ("sensors.lower.topic", "", "sensors.lower.topic: '' .*give a topic"),
    ("sensors.lower.topic", "imu//lower", "sensors.lower.topic"),
    ("sensors.lower.topic", "imu/2nd", "sensors.lower.topic: .*none begins with a digit"),
    ("sensors.lower.topic", 7, "sensors.lower.topic: 7"),
    ("sensors.lower.mag_topic", "mag lower", "sensors.lower.mag_topic"),
    ("sensors.left arm", {"link": "hand"}, "sensors.left arm.topic: 'imu/left arm' is not allowed"),
    ("sensors.lower.topic", "imu/upper", "'lower'.topic: 'imu/upper' is that of 'upper' too; give each .*frame_id"),
    ("sensors.back.mag_topic", "imu/upper", "'back'.topic: 'imu/upper' is that of 'upper' too"),
    ("sensors.lower.gyro", 1, "sensors.lower.gyro: 1 is not allowed; give true or false"),
    ("sensors.lower.gyro_noise_dps", -1, "sensors.lower.gyro_noise_dps: -1 is not allowed; give 0 to 10 deg/s"),
    ("sensors.lower.gyro_noise_dps", "low", "sensors.lower.gyro_noise_dps: 'low'"),
    ("sensors.lower.accel_noise_ug", math.nan, "sensors.lower.accel_noise_ug: nan"),
    ("sensors.lower.delay_ms", [5], r"sensors.lower.delay_ms: \[5\]"),
    ("sensor_defaults.gyro_noise_dps", True, "sensor_defaults.gyro_noise_dps: True"),
    ("sensor_defaults.link", "hand", "sensor_defaults.link: unknown key"),
    ("hall", {"joint": "elbow"}, "hall: .*give a list"),
    ("hall.0.joint", "elbw", r"hall\[0\].joint: 'elbw' is no joint coordinate; did you mean 'elbow'?"),
    ("hall.0.joint", GONE, r"hall\[0\].joint: None"),
    ("hall.0.noise_v", 0, r"hall\[0\].noise_v: 0"),
    ("hall.0.hall_range", [1.7, 0.3], r"hall\[0\].*hall_range"),
    ("hall.0.curve", {"volts": [1, 0], "angles_deg": [0, 1]}, r"hall\[0\].*volts.*rise"),
    ("hall_defaults.noise", 1, "hall_defaults.noise: unknown key; did you mean 'noise_v'?"),
    ("timing", 5, "timing: 5"),
    ("timing.max_gap", 0, r"timing.max_gap: 0 is not allowed; give 0.001 to 60 s"),
    ("timing.max_gap", "long", "timing.max_gap: 'long'"),
    ("timing.hall_per_frame", "no", "timing.hall_per_frame: 'no'"),
    ("timing.maxgap", 0.2, "timing.maxgap: unknown key; did you mean 'max_gap'?"),
    ("estimators", ["pcf"], "estimators: .*give keys"),
    ("estimators.pfc", {}, "estimators.pfc: unknown key; did you mean 'pcf'?"),
    ("estimators.pcf", "hinge", "estimators.pcf: 'hinge' is not allowed; give keys"),
    ("estimators.pcf.kp", 1000, "estimators.pcf.kp: 1000 is not allowed; give 0 to 100 1/s"),
    ("estimators.pcf.formulation", "hing", "estimators.pcf.formulation: 'hing' .*one of hinge, relative, absolute"),
    ("estimators.pcf.zero_at_start", "yes", "estimators.pcf.zero_at_start: 'yes' .*true or false"),
    ("sensor", {}, "sensor: unknown key; did you mean 'sensors'?"),
]


@pytest.mark.parametrize(("path", "value", "expected"), WRONG, ids=[f"{p}={str(v)[:20]}" for p, v, _ in WRONG])
def test_a_wrong_value_is_named_with_what_is_allowed(path: str, value: Any, expected: str) -> None:
    assert re.search(expected, refusal(changed(path, value)))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "robot: missing"),
        ("# nothing\n", "robot: missing"),
        ("just a text", "configuration: 'just a text' is not allowed"),
        ("[]", r"configuration: \[\] is not allowed"),
        ("robot: {links: [a], links: [b]}", "line 1: the key 'links' is given twice"),
        ("robot: {links: [a]}\nsensors:\n  a: {}\n  a: {}\n", "line 4: the key 'a' is given twice"),
        ("robot:\n\tlinks: [a]", "line 2: no valid YAML"),
        ("robot: {links: [a]", "no valid YAML"),
        ("robot: a: b", "line 1: no valid YAML"),
        ("robot: {links: [a]}\n---\nrobot: {links: [b]}", "no valid YAML: but found another document"),
        ("robot: *nothing", "no valid YAML"),
        ("robot: \x00", "no valid YAML"),
        ("{[1]: 2}", "no valid YAML"),
        ("[" * 700, "no valid YAML"),
        ("robot: 2001-99-99", "no valid YAML"),
        ("robot: !!int ''", "no valid YAML"),
        ("robot: !!bool maybe", "no valid YAML"),
        ("robot: !!python/object/apply:os.system [ls]", "no valid YAML"),
        ("robot: {links: [a]}\ntiming: {max_gap: 1" + "0" * 400 + "}", "line 2: .*up to 9223372036854775808"),
        ("robot: {links: [a]}\ntiming: {max_gap: 0x" + "f" * 9000 + "}", "line 2: .*up to 9223372036854775808"),
        ("robot: &a {links: *a}", "robot.links"),
        ("on: 1", "configuration: the key: True is not allowed"),
        ('"a\\nb": 1', "unknown key"),
    ],
)
def test_text_that_is_no_configuration(text: str, expected: str) -> None:
    assert re.search(expected, refusal(text))


def test_a_value_that_would_fill_the_screen_is_shortened() -> None:
    bomb = "a: &a [x, x, x, x, x, x, x, x, x]\n"
    for name, inner in zip("bcdefghi", "abcdefgh", strict=True):
        bomb += f"{name}: &{name} [{', '.join([f'*{inner}'] * 9)}]\n"
    assert "robot.links" in refusal(f"robot:\n  links: [{', '.join(['1'] * 10000)}]")
    assert "unknown key" in refusal(bomb + "robot: *i\n")
    anchored = f"robot: {{links: [a], joints: {{j: {{parent: a, child: {bomb.splitlines()[0][3:]}}}}}}}"
    assert "robot.joints.j.child: ['x', 'x'" in refusal(anchored)


# -------------------------------------------------------------------- files


def refused_file(path: Path) -> str:
    with pytest.raises(ConfigurationError) as raised:
        config.load(path)
    assert len(str(raised.value).splitlines()) == 1
    assert str(raised.value).startswith(f"{path}: ")
    return str(raised.value).removeprefix(f"{path}: ")


def test_files_that_are_no_configuration(tmp_path: Path) -> None:
    assert refused_file(tmp_path / "absent.yaml") == "no such configuration file"
    assert "directory" in refused_file(tmp_path).lower()
    assert "directory" in refused_file(Path("/dev/null/robot.yaml")).lower()
    for name, content in {"empty": b"", "binary": bytes(range(256)), "latin": "robot: Käfer".encode("latin-1")}.items():
        (tmp_path / name).write_bytes(content)
        assert refused_file(tmp_path / name)
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text(changed("timing.max_gap", 0), encoding="utf-8")
    assert refused_file(wrong) == "timing.max_gap: 0 is not allowed; give 0.001 to 60 s"


# -------------------------------------------------------------------- whatever comes

SCALARS = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.floats()
    | st.text(max_size=5)
    | st.dates()
    | st.binary(max_size=3)
    | st.sampled_from(["x", "upper", "lower", "elbow", "hinge", 1e300, -1e300, 10**400])
)
KEYS = st.sampled_from(["robot", "links", "joints", "sensors", "axis", "curve", "volts"]) | st.text(max_size=3)
VALUES = st.recursive(
    SCALARS,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(KEYS | st.integers(), inner, max_size=4),
    max_leaves=12,
)
QUICK = settings(max_examples=120)


def paths(value: Any, prefix: str = "") -> list[str]:
    """Of everything in a document."""
    if not isinstance(value, (dict, list)):
        return []
    items = value.items() if isinstance(value, dict) else enumerate(value)
    return [path for key, one in items for path in (f"{prefix}{key}", *paths(one, f"{prefix}{key}."))]


def parse_or_refuse(text: str) -> None:
    try:
        config.parse(text)
    except ConfigurationError as error:
        assert len(str(error).splitlines()) == 1


@QUICK
@given(st.text() | st.text(alphabet="robtlinks:{}[],&*!|>-#'\"? \n\t0123456789.e~%<@`"))
def test_any_text_is_read_or_refused(text: str) -> None:
    parse_or_refuse(text)


@QUICK
@given(st.dictionaries(st.sampled_from(sorted(ARM)), VALUES))
def test_any_document_is_read_or_refused(document: dict[str, Any]) -> None:
    parse_or_refuse(yaml.safe_dump(document))


@QUICK
@given(st.sampled_from(paths(ARM)), VALUES)
def test_any_value_anywhere_is_read_or_refused(path: str, value: Any) -> None:
    parse_or_refuse(changed(path, value))
