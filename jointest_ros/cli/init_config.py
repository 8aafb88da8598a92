"""`jointest init`: a commented configuration for one's own robot."""

from __future__ import annotations

import argparse
import re
import shlex
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from jointest_ros import config
from jointest_ros.bags.reader import BagReader
from jointest_ros.bags.survey import imu_sources
from jointest_ros.cli.common import OutputError, Parsers, out, progress, warn, write_text
from jointest_ros.config.draft import (
    JOINT,
    KINDS,
    draft,
    links_of,
    parse_joint,
    second_roots,
    with_sources,
    with_topics,
)
from jointest_ros.config.soundness import MEASURE
from jointest_ros.config.template import Draft, template
from jointest_ros.config.urdf import UrdfRobot, load_urdf
from jointest_ros.core.catalogue import ESTIMATORS
from jointest_ros.core.errors import ConfigurationError, counted
from jointest_ros.core.robot import Robot
from jointest_ros.evaluation.joint_pairs import hinge_pairs

_EPILOG = f"""\
joints by --joints, parents before children, no spaces in one: {JOINT}
  AXES: one to three of x, y, z, -x, -y, -z; then, if known, the origin of the joint in the parent's frame, m, and its
  limits, deg:  --joints hip:pelvis:thigh:y,x:0,0.1,0:-20..110,-40..30 knee:thigh:shank:y ankle:shank:foot:y:0,0,-0.43
sensors: {"; ".join(f"{kind}: {text}" for kind, text in KINDS.items())}
topics: {{sensor}} and {{link}} stand for names; a topic without either is shared by all, told apart by frame_id

Without --urdf and --joints, on a terminal, a few questions are asked."""


def add_parser(commands: Parsers[Any]) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "init",
        description="Write a commented configuration for your own robot: from a URDF, from a few words, or from "
        "answers. Everything in it can be changed by hand; every key is explained there.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    robot = Path("robot.yaml")
    parser.add_argument("-o", "--output", type=Path, default=robot, metavar="YAML", help="default: %(default)s")
    source = parser.add_mutually_exclusive_group()
    source.add_argument("--urdf", type=Path, metavar="FILE", help="links, joints, limits, and the frames of IMUs in it")
    source.add_argument("--joints", nargs="+", metavar="JOINT", help="the joints, see below")
    parser.add_argument(
        "--imu",
        action="append",
        default=[],
        metavar="LINK",
        help="a link of the URDF that is an IMU's frame; may be repeated (default: those with 'imu' in their name)",
    )
    parser.add_argument("--name", metavar="NAME", help="of the robot (default: that of the URDF, or of the file)")
    parser.add_argument("--sensors", choices=tuple(KINDS), default="imu", help="default: %(default)s")
    parser.add_argument("--topic", metavar="PATTERN", help="topics of the sensors (default: imu/{sensor})")
    parser.add_argument("--from-bag", type=Path, metavar="BAG", help="a recording whose topics and frame_ids to use")
    parser.add_argument("--force", action="store_true", help="replace a file that exists")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Body of the command."""
    output: Path = arguments.output
    if output.exists() and not arguments.force:
        raise OutputError(f"{output}: exists already; remove it, choose another name or give --force")
    if arguments.imu and arguments.urdf is None:
        raise ConfigurationError("--imu: names links of a URDF; give --urdf FILE")
    if arguments.topic and arguments.from_bag:
        raise ConfigurationError("--topic and --from-bag: give one of them; the recording has its topics")
    if arguments.urdf is None and not arguments.joints:
        _ask(arguments)
    made, notes = _made(arguments)
    for name in made.estimators:
        ESTIMATORS[name](made.robot)  # what does not suit it is told before anything is written
    calibration = output.with_name(f"{output.stem}_calibration.yaml")
    text = template(made, _heading(arguments), calibration.name)
    damage = config.parse(text, output, tolerant=True).calibration_damage
    write_text(output, text)
    if calibration.exists():
        unfit = f"; it does not fit: {damage.removeprefix(f'{calibration}: ')}" if damage else ""
        notes.append(f"{calibration} exists and takes precedence{unfit}")
    for note in notes:
        warn(note)
    _show(output, made, arguments)
    return 0


def _made(arguments: argparse.Namespace) -> tuple[Draft, list[str]]:
    """What the arguments describe, and what a user should know of it, one line each."""
    notes: list[str] = []
    if arguments.urdf is not None:
        urdf = load_urdf(arguments.urdf, arguments.imu)
        made = replace(_from_urdf(urdf, arguments, notes), mimics=urdf.mimics)
    else:
        joints = [parse_joint(text) for text in arguments.joints]
        notes += second_roots(joints)
        made = draft(arguments.name or arguments.output.stem, joints, arguments.sensors)
    if arguments.topic:
        made = with_topics(made, arguments.topic)
    if arguments.from_bag is not None:
        with BagReader(arguments.from_bag) as reader, progress(f"read {arguments.from_bag}") as report:
            sources = imu_sources(reader, report)
        if not sources:
            raise ConfigurationError(f"--from-bag: {arguments.from_bag} has no topic of sensor_msgs/Imu")
        made, unplaced = with_sources(made, sources)
        notes += unplaced
    return made, notes


def _from_urdf(urdf: UrdfRobot, arguments: argparse.Namespace, notes: list[str]) -> Draft:
    notes += urdf.warnings
    if not urdf.joints:
        raise ConfigurationError(f"{arguments.urdf}: no joint that turns")
    jointed = [link for link in urdf.links if link in links_of(urdf.joints)]
    notes += [
        f"IMU '{one.name}' is on no link of a joint that turns: left out"
        for one in urdf.sensors
        if one.link not in jointed
    ]
    made = draft(
        arguments.name or urdf.name,
        urdf.joints,
        arguments.sensors,
        jointed,
        [sensor for sensor in urdf.sensors if sensor.link in jointed],
        urdf.world,
        places_known=True,
    )
    bearing = {sensor.link for sensor in urdf.sensors}
    assumed = [link for link in made.robot.links if link not in bearing and link != urdf.world]
    if assumed and arguments.sensors != "accel":
        notes.append(
            f"no frame of an IMU on {', '.join(assumed)}: one at the origin of each is assumed (or --imu LINK)"
        )
    return made


def _heading(arguments: argparse.Namespace) -> str:
    options = ["-o", arguments.output.name]
    if arguments.urdf is not None:
        options += ["--urdf", arguments.urdf.name, *(word for link in arguments.imu for word in ("--imu", link))]
    else:
        options += ["--joints", *arguments.joints]
    options += ["--sensors", arguments.sensors] if arguments.sensors != "imu" else []
    options += ["--topic", arguments.topic] if arguments.topic else []
    options += ["--from-bag", arguments.from_bag.name] if arguments.from_bag is not None else []
    options += ["--name", arguments.name] if arguments.name else []
    return (
        f"Made by: jointest init {shlex.join(options)}\n"
        f"Change it as you like. Does it fit a recording? jointest inspect BAG --config {arguments.output.name}"
    )


def _show(output: Path, made: Draft, arguments: argparse.Namespace) -> None:
    """What was written, and what to do next."""
    robot = made.robot
    estimators = ", ".join(made.estimators)
    angles, sensors = counted(len(robot.coordinates), "joint angle"), counted(len(robot.sensors), "sensor")
    out.print(f"{output}: {angles}, {sensors}, {estimators}")
    for sensor in robot.sensors:
        own = f" frame_id {sensor.frame_id}" if sensor.frame_id else ""
        out.print(f"  {sensor.name} on {sensor.link}: {sensor.topic}{own}")
    if robot.hall:
        out.print(f"  {counted(len(robot.hall), 'Hall sensor')}: hall_voltages")
    if made.measure:
        where = "put your lengths (m) there" + (", for lever_arms" if "pcf" in made.estimators else "")
        out.print(f"{counted(len(made.measure), 'line')} marked {MEASURE}: {where}")
    kind = "hall" if robot.hall else "accel" if arguments.sensors == "accel" else "axis" if _has_hinge(robot) else ""
    then = "  # mountings, by motion; then: zero" if kind == "axis" else ""
    bag = arguments.from_bag or "BAG"
    out.print("next, with a recording that begins at rest in the zero pose and then moves every joint:", style="bold")
    out.print(f"  jointest inspect {bag} --config {output}")
    if kind:
        out.print(f"  jointest calibrate {kind} {bag} --config {output}{then}")
    out.print(f"  jointest estimate {bag} --config {output} -o angles.csv")
    out.print(f"  ros2 run jointest_ros {next(iter(made.estimators))}_node --ros-args -p config:={output}")


def _has_hinge(robot: Robot) -> bool:
    """There is a joint that calibrate axis and zero can take."""
    try:
        return bool(hinge_pairs(robot)[0])
    except ConfigurationError:
        return False


# ---------------------------------------------------------------- questions


def _ask(arguments: argparse.Namespace) -> None:
    """Fill `arguments` by a few questions. Raises ConfigurationError where nobody can answer."""
    if not sys.stdin.isatty():
        raise ConfigurationError("give --urdf FILE or --joints NAME:PARENT:CHILD:AXES ... (questions need a terminal)")
    out.print("A few questions; Enter takes what is in [brackets].")
    arguments.name = arguments.name or _answer("name of the robot", arguments.output.stem)
    links = _links()
    arguments.joints = [_joint(number, links) for number in range(1, len(links))]
    arguments.sensors = _choice("sensors", tuple(KINDS), arguments.sensors)
    if not arguments.topic and arguments.from_bag is None:
        arguments.topic = _answer("topics of the sensors", "imu/{sensor}")


def _links() -> list[str]:
    """The names of the links, parted by commas, or else by blanks."""
    while True:
        given = _answer("links, from the root on", "base link")
        links = [link.strip() for link in given.split(",")] if "," in given else given.split()
        if len(set(links)) < max(2, len(links)):
            out.print("  two or more, each once")
        elif all(_is_name(link) for link in links):
            return links


def _is_name(text: str) -> bool:
    """It can stand in a word of --joints; if not, that is told."""
    if re.fullmatch(r"[^\s:,]+", text):
        return True
    out.print(f"  '{text}': give a name without blanks, colons and commas, such as upper_arm")
    return False


def _joint(number: int, links: Sequence[str]) -> str:
    """The joint that moves a link, as --joints has it."""
    child = links[number]
    parent = _choice(f"{child}: hangs on", tuple(links[:number]), links[number - 1])
    while not _is_name(name := _answer(f"{child}: name of its joint", f"{child}_joint")):
        pass
    while True:
        text = f"{name}:{parent}:{child}:{_answer(f'{child}: turns about (x, y, z, -x, ..., zyx)', 'y')}"
        try:
            parse_joint(text)
            return text
        except ConfigurationError as error:
            out.print(f"  {error}")


def _answer(question: str, default: str) -> str:
    try:
        return input(f"{question} [{default}]: ").strip() or default
    except EOFError:
        raise ConfigurationError("the answers ended; nothing was written") from None


def _choice(question: str, choices: tuple[str, ...], default: str) -> str:
    while (given := _answer(f"{question} ({', '.join(choices)})", default)) not in choices:
        out.print(f"  one of {', '.join(choices)}")
    return given
