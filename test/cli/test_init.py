"""`jointest init`: what it writes can be read at once, explains each key, and is the robot that was described."""

from __future__ import annotations

import builtins
import dataclasses
import io
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from inspect_bags import Message, rewrite

from jointest_ros import config
from jointest_ros.core.params import Params
from jointest_ros.core.pcf.params import PcfParams
from jointest_ros.core.rotation import log, rotate
from jointest_ros.core.timing import Timing

Jointest = Callable[..., Any]
PROJECT = Path(__file__).resolve().parents[2]
LEG = ("knee:thigh:shank:y", "ankle:shank:foot:-y:0,0,-0.43:-40..50")

ARM = """<robot name="arm">
  <link name="base"><visual/></link>
  <link name="base_imu"/>
  <link name="upper"><visual/></link>
  <link name="fore"><visual/></link>
  <link name="fore_imu"/>
  <link name="tool"/>
  <joint name="base_to_imu" type="fixed">
    <parent link="base"/><child link="base_imu"/><origin xyz="0.01 0 0.02" rpy="0 0 1.5707963267948966"/>
  </joint>
  <joint name="shoulder" type="revolute">
    <parent link="base"/><child link="upper"/><origin xyz="0 0 0.1" rpy="1.5707963267948966 0 0"/>
    <axis xyz="0 0 1"/><limit lower="-1.5707963267948966" upper="0.7853981633974483" effort="1" velocity="1"/>
  </joint>
  <joint name="elbow" type="continuous">
    <parent link="upper"/><child link="fore"/><origin xyz="0 0.3 0"/><axis xyz="0 0 -2"/>
  </joint>
  <joint name="wrist" type="fixed"><parent link="fore"/><child link="tool"/><origin xyz="0 0.2 0"/></joint>
  <joint name="tool_to_imu" type="fixed"><parent link="tool"/><child link="fore_imu"/><origin xyz="0 0.05 0"/></joint>
</robot>
"""


@pytest.fixture
def arm(tmp_path: Path) -> Path:
    """A URDF whose frames are turned against each other, with two frames of IMUs."""
    path = tmp_path / "arm.urdf"
    path.write_text(ARM, encoding="utf-8")
    return path


@pytest.fixture
def leg(jointest: Jointest, tmp_path: Path) -> Path:
    """A configuration from a few words."""
    path = tmp_path / "leg.yaml"
    result = jointest("init", "-o", path, "--joints", *LEG)
    assert (result.code, result.err) == (0, "")
    return path


def test_from_a_few_words(leg: Path) -> None:
    configuration = config.load(leg)
    robot = configuration.robot
    assert (robot.name, robot.links) == ("leg", ("thigh", "shank", "foot"))
    knee, ankle = robot.joints
    assert (knee.parent, knee.child, knee.axes, knee.limits) == ("thigh", "shank", ((0.0, 1.0, 0.0),), None)
    assert (ankle.axes, ankle.origin) == (((0.0, -1.0, 0.0),), (0.0, 0.0, -0.43))
    assert ankle.limits == (pytest.approx((math.radians(-40), math.radians(50))),)
    assert [(s.name, s.link, s.topic) for s in robot.sensors] == [(n, n, f"imu/{n}") for n in robot.links]
    assert configuration.estimators == {"pcf": PcfParams(zero_at_start=True)}
    assert configuration.calibration_file == leg.with_name("leg_calibration.yaml")


@pytest.mark.parametrize("axes", ["y,-x", "y-x"])
@pytest.mark.parametrize(("limits", "expected"), [("-20..110,-40..30", (-20, 110, -40, 30)), ("-9..9", (-9, 9) * 2)])
def test_two_axes_in_a_word(
    axes: str, limits: str, expected: tuple[float, ...], jointest: Jointest, tmp_path: Path
) -> None:
    path = tmp_path / "hip.yaml"
    assert jointest("init", "-o", path, "--joints", f"hip:pelvis:thigh:{axes}:0,0.1,0:{limits}").code == 0
    (hip,) = config.load(path).robot.joints
    assert (hip.axes, hip.origin) == (((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0)), (0.0, 0.1, 0.0))
    assert [math.degrees(v) for pair in hip.limits or () for v in pair] == pytest.approx(expected)


@pytest.mark.parametrize("kind", [config.SensorSettings, Timing, PcfParams])
def test_every_parameter_is_explained(kind: type[Params], leg: Path) -> None:
    """With its declared description, and nothing but its default where it does not count."""
    lines = leg.read_text(encoding="utf-8").splitlines()
    together = " ".join(line.strip().lstrip("#").strip() for line in lines)
    for spec in dataclasses.fields(kind):
        (line,) = [one for one in lines if one.strip().removeprefix("# ").startswith(f"{spec.name}: ")]
        assert spec.metadata["description"].split()[0] in line
    for key in ("axis: ", "origin: ", "limits_deg: ", "link: ", "topic: ", "position: ", "mounting: "):
        assert f"# {key}" in "\n".join(lines)
    assert "All link frames coincide in orientation at the zero pose" in together


def test_the_comments_can_be_switched_on(leg: Path) -> None:
    """A line without its # is the default."""
    text = leg.read_text(encoding="utf-8").replace("    # kp: 1.0", "    kp: 1.0").replace("  # max_gap:", "  max_gap:")
    changed = config.parse(text)
    assert (changed.estimators, changed.timing) == (config.load(leg).estimators, config.load(leg).timing)


def test_what_nobody_measured_is_marked_and_inspected(leg: Path, jointest: Jointest) -> None:
    marked = [line for line in leg.read_text(encoding="utf-8").splitlines() if "MEASURE" in line]
    assert len(marked) == 4  # the origin of the knee, and three sensors
    assert "4 lines marked MEASURE" in jointest("inspect", "-c", leg).out


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("position: [0, 0, 0]}  # MEASURE position", "position: [0, 0, 0]}", ""),
        ("position: [0, 0, 0]", "position: [0, 0, -250]", "position: is 250 m long"),
        ("origin: [0, 0, 0]", "origin: [0, 0, -430]", "origin: is 430 m long"),
    ],
)
def test_millimetres_are_told(old: str, new: str, told: str, leg: Path, jointest: Jointest) -> None:
    text = leg.read_text(encoding="utf-8")
    leg.write_text(text.replace(old, new, 1), encoding="utf-8")
    out = jointest("inspect", "-c", leg).out
    assert told in out if told else " m long" not in out
    assert ("250 mm is 0.25" in out) is bool(told)


def test_what_to_do_next(jointest: Jointest, tmp_path: Path) -> None:
    out = jointest("init", "-o", tmp_path / "leg.yaml", "--joints", *LEG).out
    for command in ("jointest inspect BAG", "jointest calibrate axis BAG", "jointest estimate BAG", "pcf_node"):
        assert command in out


def test_calibrations_by_hinges_are_only_named_where_there_is_one(jointest: Jointest, tmp_path: Path) -> None:
    out = jointest("init", "-o", tmp_path / "arm.yaml", "--joints", "wrist:fore:hand:zy").out
    assert "jointest calibrate" not in out and "jointest estimate BAG" in out


@pytest.mark.parametrize("kind", ["of another robot", "no calibration at all"])
def test_a_calibration_that_exists_is_told(kind: str, jointest: Jointest, tmp_path: Path) -> None:
    path, found = tmp_path / "leg.yaml", tmp_path / "leg_calibration.yaml"
    found.write_text("mountings: {lid: {rpy_deg: [0, 0, 5]}}" if "other" in kind else "[", encoding="utf-8")
    result = jointest("init", "-o", path, "--joints", *LEG)
    assert result.code == 0 and path.exists()
    assert result.err.startswith(f"warning: {found} exists and takes precedence; it does not fit: ")
    assert result.err.count("\n") == 1
    found.write_text("", encoding="utf-8")
    assert jointest("init", "-o", tmp_path / "arm.yaml", "--joints", *LEG).err == ""  # it has one of its own


def test_a_second_root_is_told(jointest: Jointest, tmp_path: Path) -> None:
    result = jointest("init", "-o", tmp_path / "leg.yaml", "--joints", LEG[0], "ankle:shnk:foot:y")
    assert result.code == 0
    assert result.err == "warning: 'shnk' is a second root, no joint moves it; did you mean 'shank'?\n"


def test_the_default_hall_curve_is_to_be_measured(jointest: Jointest, tmp_path: Path) -> None:
    """Until a calibration replaces it."""
    path = tmp_path / "leg.yaml"
    assert jointest("init", "-o", path, "--joints", LEG[0], "--sensors", "gyro+hall").code == 0
    told = "hall: the curve is that of the paper's sensor"
    assert told in jointest("inspect", "-c", path).out
    curve = "curve: {a_deg: 0.08, b: 2.9, c_deg: 200000.0, d: 8.4}"
    entries = ", ".join(
        f"{{joint: knee, mirrored: {mirrored}, noise_v: 0.03, offset_v: 0, {curve}}}" for mirrored in ("false", "true")
    )
    (tmp_path / "leg_calibration.yaml").write_text(f"hall: [{entries}]", encoding="utf-8")
    calibrated = jointest("inspect", "-c", path)
    assert calibrated.code == 0 and told not in calibrated.out


@pytest.mark.parametrize(("kind", "estimator", "sensors"), [("accel", "accel_ekf", 6), ("gyro+hall", "kckf", 3)])
def test_other_sensors(kind: str, estimator: str, sensors: int, jointest: Jointest, tmp_path: Path) -> None:
    path = tmp_path / "leg.yaml"
    assert jointest("init", "-o", path, "--joints", *LEG, "--sensors", kind).code == 0
    configuration = config.load(path)
    assert list(configuration.estimators) == [estimator]
    assert len(configuration.robot.sensors) == sensors
    assert len(configuration.robot.hall) == (4 if kind == "gyro+hall" else 0)
    assert jointest("inspect", "-c", path).code == 0


def test_topics_by_a_pattern(jointest: Jointest, tmp_path: Path) -> None:
    path = tmp_path / "leg.yaml"
    assert jointest("init", "-o", path, "--joints", *LEG, "--topic", "/leg/{link}/data").code == 0
    assert config.load(path).robot.sensors[0].topic == "/leg/thigh/data"
    assert jointest("init", "-o", path, "--joints", *LEG, "--topic", "/imu", "--force").code == 0
    assert {(s.topic, s.frame_id) for s in config.load(path).robot.sensors} == {
        ("/imu", name) for name in ("thigh", "shank", "foot")
    }


def test_from_a_urdf(arm: Path, jointest: Jointest, tmp_path: Path) -> None:
    """Frames are turned into that of the root; what is fixed together is one link, at the frame of its joint."""
    path = tmp_path / "robot.yaml"
    result = jointest("init", "-o", path, "--urdf", arm)
    assert result.code == 0
    assert "no frame of an IMU on upper: one at the origin of each is assumed" in result.err
    robot = config.load(path).robot
    assert (robot.name, robot.links) == ("arm", ("base", "upper", "fore"))
    shoulder, elbow = robot.joints
    assert shoulder.axes[0] == pytest.approx((0.0, -1.0, 0.0))  # z of a frame that was turned about x
    assert shoulder.limits == (pytest.approx((-math.pi / 2, math.pi / 4)),)
    assert elbow.axes[0] == pytest.approx((0.0, 1.0, 0.0)) and elbow.continuous
    assert elbow.origin == pytest.approx((0.0, 0.0, 0.3))
    base, fore, upper = robot.sensors
    assert (base.name, base.link, base.position) == ("base_imu", "base", pytest.approx((0.01, 0.0, 0.02)))
    assert log(base.mounting) == pytest.approx((0.0, 0.0, math.pi / 2))
    assert (fore.link, fore.position) == ("fore", pytest.approx((0.0, 0.0, 0.25)))
    assert rotate(fore.mounting, (0.0, 1.0, 0.0)) == pytest.approx((0.0, 0.0, 1.0))
    assert upper.link == "upper"


@pytest.mark.parametrize("rpy_deg", [(0, 90, 0), (0, 120, 0), (180, 0, 0), (30, -100, 10)])
def test_a_mounting_keeps_its_angles(
    rpy_deg: tuple[float, float, float], arm: Path, jointest: Jointest, tmp_path: Path
) -> None:
    """Of two (roll, pitch, yaw) for one rotation the one of the smaller angles stays; URDFs have few digits."""
    turn = " ".join(f"{math.radians(angle):.4f}" for angle in rpy_deg)
    arm.write_text(ARM.replace('rpy="0 0 1.5707963267948966"', f'rpy="{turn}"'), encoding="utf-8")
    path = tmp_path / "robot.yaml"
    assert jointest("init", "-o", path, "--urdf", arm).code == 0
    written = yaml.safe_load(path.read_text(encoding="utf-8"))["sensors"]["base_imu"]["mounting"]["rpy_deg"]
    assert [abs(angle) if abs(angle) > 179.9 else angle for angle in written] == pytest.approx(rpy_deg, abs=0.01)


def test_named_frames_of_imus(arm: Path, jointest: Jointest, tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    options = [word for link in ("base_imu", "upper", "tool") for word in ("--imu", link)]
    result = jointest("init", "-o", path, "--urdf", arm, *options)
    assert (result.code, result.err) == (0, "")
    assert {(s.name, s.link) for s in config.load(path).robot.sensors} == {
        ("base_imu", "base"),
        ("upper", "upper"),
        ("tool", "fore"),
    }
    text = jointest("init", "-o", path, "--urdf", arm, "--imu", "head", "--force").refusal()
    assert "'head' is not a link; known: base, base_imu" in text


@pytest.mark.parametrize(
    ("urdf", "words"),
    [
        ("<robot", "no valid XML"),
        ("<sdf/>", "no URDF"),
        ('<robot name="r"><link/></robot>', "has no name"),
        (ARM.replace('<child link="fore"/>', '<child link="far"/>'), "'far' is not a link"),
        (ARM.replace('<child link="fore"/>', '<child link="base"/>'), "joints"),
        (ARM.replace('xyz="0 0 -2"', 'xyz="0 0 0"'), "its axis has no length"),
        (ARM.replace('xyz="0 0 0.1"', 'xyz="0 zero 0.1"'), "give a number"),
        (ARM.replace("<robot", '<robot xmlns:xacro="x"').replace("0.3", "${length}"), "xacro"),
        ('<robot name="r"><link name="a"/></robot>', "no joint that turns"),
        ('<robot name="r"/>', "no links"),
        (ARM.replace('<link name="tool"/>', '<link name="upper"/>'), "link 'upper' is given twice"),
        (ARM.replace('name="wrist"', 'name="elbow"'), "joint 'elbow' is given twice"),
        (ARM.replace('type="revolute"', 'type="revolut"'), "'shoulder': type 'revolut' is not allowed; give one of"),
        (ARM.replace("<axis", '<mimic multiplier="2"/><axis', 1), '<mimic joint="..."/> is missing'),
    ],
)
def test_a_bad_urdf_is_refused_in_one_line(urdf: str, words: str, jointest: Jointest, tmp_path: Path) -> None:
    path = tmp_path / "bad.urdf"
    path.write_text(urdf, encoding="utf-8")
    assert words in jointest("init", "-o", tmp_path / "robot.yaml", "--urdf", path).refusal()
    assert not (tmp_path / "robot.yaml").exists()


def test_a_urdf_in_another_encoding_is_refused_as_such(jointest: Jointest, tmp_path: Path) -> None:
    path = tmp_path / "bad.urdf"
    path.write_bytes('<robot name="für"/>'.encode("latin-1"))
    text = jointest("init", "-o", tmp_path / "robot.yaml", "--urdf", path).refusal()
    assert text == f"{path}: cannot be read as a URDF: it is not a text in UTF-8"


def test_a_mimic_is_told_on_the_screen_and_in_the_file(arm: Path, jointest: Jointest, tmp_path: Path) -> None:
    arm.write_text(ARM.replace("-2", '-2"/><mimic joint="shoulder" multiplier="0.5" offset="-0.1'), encoding="utf-8")
    path = tmp_path / "robot.yaml"
    result = jointest("init", "-o", path, "--urdf", arm)
    assert "'elbow' mimics one (0.5 shoulder - 0.1 rad): that is not used" in result.err
    above, entry = path.read_text(encoding="utf-8").split("    elbow:")[0].splitlines()[-2:]
    assert "elbow mimics another in the URDF (0.5 shoulder - 0.1 rad)" in above and "fore" in entry
    assert config.load(path).robot.coordinates == ("shoulder", "elbow")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('lower="-1.5707963267948966"', 'lower="-90"', "more than two turns; are they in deg?"),
        ('lower="-1.5707963267948966"', 'lower="1"', "in the wrong order; left out"),
        ('type="continuous"', 'type="planar"', "is planar: 'fore' begins a tree of its own"),
        ('type="continuous"', 'type="floating"', "IMU 'fore_imu' is on no link of a joint that turns: left out"),
        ('<link name="tool"/>', '<link name="tool"/><link name="stand"/>', "'stand' is a second root"),
    ],
)
def test_doubts_about_a_urdf_are_told(
    old: str, new: str, words: str, arm: Path, jointest: Jointest, tmp_path: Path
) -> None:
    arm.write_text(ARM.replace(old, new), encoding="utf-8")
    result = jointest("init", "-o", tmp_path / "robot.yaml", "--urdf", arm)
    assert result.code == 0 and words in result.err


def test_names_that_topics_cannot_have(arm: Path, jointest: Jointest, tmp_path: Path) -> None:
    """Links keep their names; the sensor's name, which makes its topic, is made fit."""
    arm.write_text(ARM.replace('"upper"', '"upper arm/2"').replace('"fore_imu"', '"fore imu"'), encoding="utf-8")
    for kind in ("imu", "gyro+hall", "accel"):
        assert jointest("init", "-o", tmp_path / "robot.yaml", "--urdf", arm, "--sensors", kind, "--force").code == 0
        sensors = {sensor.link: sensor.topic for sensor in config.load(tmp_path / "robot.yaml").robot.sensors}
        assert sensors["upper arm/2"].startswith("imu/upper_arm_2")


def test_what_xacro_made_is_no_xacro_file(arm: Path, jointest: Jointest, tmp_path: Path) -> None:
    """Its output keeps the comments and the name space of its input."""
    kept = '<!-- <xacro:old length="${x}"/> --><robot xmlns:xacro="http://www.ros.org/wiki/xacro"'
    arm.write_text(ARM.replace("<robot", kept), encoding="utf-8")
    assert jointest("init", "-o", tmp_path / "robot.yaml", "--urdf", arm).code == 0


def test_three_revolutes_through_bare_frames_are_one_joint(jointest: Jointest, tmp_path: Path) -> None:
    urdf = PROJECT / "urdf" / "softhand_gripper.urdf"
    result = jointest("init", "-o", tmp_path / "robot.yaml", "--urdf", urdf)
    assert result.code == 0
    robot = config.load(tmp_path / "robot.yaml").robot
    shipped = config.load(PROJECT / "config" / "softhand_gripper.yaml").robot
    assert robot.world == "world"
    assert robot.joints[0].coordinates == ("palm_z", "palm_y", "palm_x") == shipped.joints[0].coordinates
    assert robot.joints[0].axes == shipped.joints[0].axes


HIP = """<robot name="leg">
  <link name="pelvis"/> <link name="cross"/> <link name="thigh"/> <link name="shank"/>
  <link name="pelvis_imu"/> <link name="thigh_imu"/> <link name="shank_imu"/>
  <joint name="hip_abduction" type="revolute"> <parent link="cross"/> <child link="thigh"/>
    <axis xyz="1 0 0"/> <limit lower="-0.3" upper="0.7"/> </joint>
  <joint name="hip_flexion" type="revolute"> <parent link="pelvis"/> <child link="cross"/> <origin xyz="0 0.1 0"/>
    <axis xyz="0 1 0"/> <limit lower="-2" upper="0.5"/> </joint>
  <joint name="knee" type="revolute"> <parent link="thigh"/> <child link="shank"/> <origin xyz="0 0 -0.4"/>
    <axis xyz="0 1 0"/> <limit lower="0" upper="2"/> </joint>
  <joint name="a" type="fixed"> <parent link="pelvis"/> <child link="pelvis_imu"/> </joint>
  <joint name="b" type="fixed"> <parent link="thigh"/> <child link="thigh_imu"/> </joint>
  <joint name="c" type="fixed"> <parent link="shank"/> <child link="shank_imu"/> </joint>
</robot>"""


def test_joints_through_a_bare_frame_are_one_whatever_their_names(jointest: Jointest, tmp_path: Path) -> None:
    """A URDF has no joint of two axes: a hip goes through a link that bears nothing. Its angles keep their names."""
    urdf, path = tmp_path / "leg.urdf", tmp_path / "robot.yaml"
    urdf.write_text(HIP, encoding="utf-8")
    result = jointest("init", "-o", path, "--urdf", urdf)
    assert result.code == 0 and "one joint 'hip' of 2 axes" in result.err and "(cross)" in result.err
    robot = config.load(path).robot
    assert robot.links == ("pelvis", "thigh", "shank") and len(robot.sensors) == 3
    assert robot.coordinates == ("hip_flexion", "hip_abduction", "knee")
    hip = robot.joints[0]
    assert (hip.name, hip.axes, hip.origin) == ("hip", ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0)), (0.0, 0.1, 0.0))
    assert hip.limits == (pytest.approx((-2.0, 0.5), abs=1e-4), pytest.approx((-0.3, 0.7), abs=1e-4))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('<link name="cross"/>', '<link name="cross"><inertial/></link>'),
        ('<link name="cross"/>', '<link name="cross"/> <link name="cross_imu"/>'),
        ('<child link="thigh"/>', '<child link="thigh"/> <origin xyz="0 0 -0.05"/>'),
        ('<axis xyz="1 0 0"/>', '<axis xyz="0 1 0"/>'),
    ],
    ids=["a body", "an IMU", "a length", "parallel axes"],
)
def test_joints_about_something_between_them_stay_two(old: str, new: str, jointest: Jointest, tmp_path: Path) -> None:
    urdf, path = tmp_path / "leg.urdf", tmp_path / "robot.yaml"
    fixed = '<joint name="d" type="fixed"> <parent link="cross"/> <child link="cross_imu"/> </joint> </robot>'
    text = HIP.replace(old, new)
    urdf.write_text(text.replace("</robot>", fixed) if "cross_imu" in new else text, encoding="utf-8")
    assert jointest("init", "-o", path, "--urdf", urdf).code == 0
    assert [len(joint.axes) for joint in config.load(path).robot.joints] == [1, 1, 1]


def test_topics_of_a_recording(jointest: Jointest, tmp_path: Path) -> None:
    """Several sensors on one topic, told apart by frame ids that name their links."""

    def together(message: Message, _time: float) -> Message:
        name = message.topic.rpartition("/")[2]
        return dataclasses.replace(message, topic="/hand/imus", frame_id=f"finger_{name}_link")

    bag = rewrite(PROJECT / "bags" / "finger", tmp_path / "bag", together)
    path = tmp_path / "robot.yaml"
    joints = ("mcp:palm:proximal:x", "pip:proximal:middle:x", "dip:middle:distal:x")
    result = jointest("init", "-o", path, "--joints", *joints, "--from-bag", bag)
    assert (result.code, result.err) == (0, "")
    assert {(s.name, s.topic, s.frame_id) for s in config.load(path).robot.sensors} == {
        (name, "/hand/imus", f"finger_{name}_link") for name in ("palm", "proximal", "middle", "distal")
    }
    assert jointest("inspect", bag, "-c", path).code == 0
    other = jointest("init", "-o", path, "--joints", *LEG, "--from-bag", bag, "--force")
    assert "sensor 'foot': no topic of the recording has its name" in other.err


def test_nothing_is_replaced_without_force(leg: Path, jointest: Jointest) -> None:
    before = leg.read_bytes()
    assert "exists already" in jointest("init", "-o", leg, "--joints", *LEG).refusal()
    assert leg.read_bytes() == before
    assert "1 joint angle, 2 sensors, pcf" in jointest("init", "-o", leg, "--joints", LEG[0], "--force").out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--joints", "knee:thigh:shank"), "give NAME:PARENT:CHILD:AXES"),
        (("--joints", "knee:thigh:shank:w"), "axes 'w'"),
        (("--joints", "knee:thigh:shank:y:0,0"), "neither an origin X,Y,Z (m) nor limits LOW..HIGH (deg)"),
        (("--joints", "knee:thigh:shank:y:90..10"), "neither an origin"),
        (("--joints", "knee:thigh:shank:y:0,0,1:0,0,2"), "'0,0,2': a second origin;"),
        (("--joints", "knee:thigh:shank:y:0..1:0..2"), "'0..2': second limits;"),
        (("--joints", "hip:pelvis:thigh:y,x:0..90,0..10,0..20"), "one or one for each axis"),
        (("--joints", "hip:pelvis:thigh:y,"), "axes 'y,'"),
        (("--joints", "knee:thigh:shank:y:nan,0,0"), "neither an origin"),
        (("--joints", "knee:thigh:shank:y:0..inf"), "neither an origin"),
        (("--joints", "knee:thigh:thigh:y"), "its own ancestor"),
        (("--joints", LEG[0], "--imu", "a"), "--imu: names links of a URDF"),
        (("--joints", LEG[0], "--topic", "two words"), "give a topic"),
        (("--joints", LEG[0], "--from-bag", "none"), "no such bag"),
        (("--urdf", "none.urdf"), "no such URDF file"),
    ],
)
def test_mistakes_are_told_in_one_line(
    arguments: tuple[str, ...], words: str, jointest: Jointest, tmp_path: Path
) -> None:
    path = tmp_path / "robot.yaml"
    assert words in jointest("init", "-o", path, *arguments).refusal()
    assert not path.exists()


def test_it_never_asks_without_a_terminal(jointest: Jointest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO())
    text = jointest("init", "-o", tmp_path / "robot.yaml").refusal()
    assert text.startswith("give --urdf FILE or --joints")


class Terminal:
    """A standard input that is one."""

    def isatty(self) -> bool:
        return True


def test_questions_on_a_terminal(jointest: Jointest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Wrong answers are asked for again; an empty one takes the default."""
    answers = iter(["my_arm", "base upper fore", "", "shoulder", "w", "zy", "base", "", "x", "imu", "/arm/{sensor}"])
    asked: list[str] = []

    def answer(question: str) -> str:
        asked.append(question)
        return next(answers)

    monkeypatch.setattr("sys.stdin", Terminal())
    monkeypatch.setattr(builtins, "input", answer)
    path = tmp_path / "robot.yaml"
    assert jointest("init", "-o", path).code == 0
    robot = config.load(path).robot
    assert robot.name == "my_arm"
    assert [(j.name, j.parent, j.child, len(j.axes)) for j in robot.joints] == [
        ("shoulder", "base", "upper", 2),
        ("fore_joint", "base", "fore", 1),
    ]
    assert robot.sensors[2].topic == "/arm/fore"
    assert len(asked) == 11


def test_names_of_links_are_asked_for_until_they_are_fit(
    jointest: Jointest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One link is too few; commas part the names, so that no name is taken apart at its blank."""
    links = ["arm", "upper arm, forearm", "arm arm", "arm,", "upper_arm, forearm"]
    answers = iter(["", *links, "", "my elbow", "elbow", "", "", ""])
    monkeypatch.setattr("sys.stdin", Terminal())
    monkeypatch.setattr(builtins, "input", lambda _question: next(answers))
    path = tmp_path / "robot.yaml"
    result = jointest("init", "-o", path)
    assert result.code == 0 and next(answers, None) is None
    assert "'upper arm': give a name without blanks" in result.out and "two or more" in result.out
    (elbow,) = config.load(path).robot.joints
    assert (elbow.name, elbow.parent, elbow.child) == ("elbow", "upper_arm", "forearm")


def test_answers_that_end_write_nothing(jointest: Jointest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def end(_question: str) -> str:
        raise EOFError

    monkeypatch.setattr("sys.stdin", Terminal())
    monkeypatch.setattr(builtins, "input", end)
    path = tmp_path / "robot.yaml"
    assert jointest("init", "-o", path).refusal() == "the answers ended; nothing was written"
    assert not path.exists()
