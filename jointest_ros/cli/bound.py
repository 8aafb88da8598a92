"""`jointest bound`: the error that a robot's accelerometer arrays allow, and where its sensors should sit."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import Any

from rich.table import Table

from jointest_ros import config
from jointest_ros.cli.common import Parsers, err, out, write_json
from jointest_ros.core.accel.array import JointArrays, joint_arrays, plane
from jointest_ros.core.errors import ConfigurationError
from jointest_ros.core.frame import Vec3
from jointest_ros.core.robot import STANDARD_GRAVITY, Robot
from jointest_ros.core.rotation import norm, unit
from jointest_ros.evaluation import bound_plot, plots
from jointest_ros.evaluation.accel_advice import SPANS, Advice, advise, bounds_by_span, direction
from jointest_ros.evaluation.accel_motion import TYPICAL, Course, Swing, course

SCHEMA = 1
SLOWEST_HZ = 0.05

_DESCRIPTION = """\
The error to expect from the accelerometer arrays of a robot in typical motions: the Cramér-Rao bound, which no
unbiased estimator beats. And the places of the sensors that make it smallest."""

_EPILOG = """\
columns:
  gravity   what of it lies across the joint's axis, m/s²
  sample    angle from every sample by itself, as accel_analytical without a window gives it, deg
  filter    bound of the angle for estimates that know what came before, deg
  smoother  the same for those that know the whole recording, deg
  biases    the same for filters that have to find a constant bias of every channel too (--bias-mg), deg
  rates     bound for filters of the angular velocities of parent and child about the joint's axis, deg/s
  All are root mean squares over time, without the first second.
  -: the sensors do not tell the angle; nothing at the joint has an acceleration or weight.

assumed: white noise of the data sheet (accel_noise_ug) over half the rate; places, mountings and scales exactly known;
no sample lost. Where there is nothing but noise, accel_ekf comes within 10 % of the bound. What calibration leaves
costs more: 20 mg, 1 % of scale, 2 mm and 1 deg of misplacement together 1 to 2 deg.
The rates of links that rest, or turn slowly together, are hardly measured; they start as known to 6 deg/s.

Robots without accelerometer arrays (pairs of IMUs, Hall sensors) have no bound here; compare their estimators on a
recording, by jointest evaluate."""


def add_parser(commands: Parsers[Any]) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "bound",
        description=_DESCRIPTION,
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("config", type=Path, metavar="YAML", help="the robot's configuration")
    parser.add_argument("--rate", type=float, default=100.0, metavar="HZ", help="of the samples (default: 100)")
    parser.add_argument(
        "--motion",
        action="append",
        metavar="DEG,HZ[,DEG,HZ]",
        help="swing of the child against the parent, and that of the parent about the origin of its frame (default: "
        f"clamped); may be repeated (default: {', '.join(f'[{swing}]' for swing in TYPICAL)})",
    )
    parser.add_argument(
        "--up",
        metavar="X,Y,Z",
        help="direction upward in the frame of the parent (while it does not swing); gravity counts as far as it lies "
        "across the joint's axis (default: all of it, then none of it)",
    )
    parser.add_argument(
        "--bias-mg",
        type=float,
        default=20.0,
        metavar="MG",
        help="standard deviation of the biases in that column; 0: without (default: 20)",
    )
    parser.add_argument(
        "--link-length",
        action="append",
        default=[],
        metavar="LINK=M",
        help="how far from the joint sensors can sit on a link; may be repeated (default: as far as the farthest does)",
    )
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw bound over span: *.png, *.svg or *.pdf")
    parser.add_argument("--json", metavar="FILE", help="write the figures as JSON, '-': to standard output")
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Body of the command."""
    if arguments.plot:
        plots.check_suffix(arguments.plot)
    rate = _within("--rate", arguments.rate, 10.0, 2000.0, "Hz")
    bias = 1e-3 * STANDARD_GRAVITY * _within("--bias-mg", arguments.bias_mg, 0.0, 1000.0, "mg")
    swings = [_swing(text, rate) for text in arguments.motion] if arguments.motion else list(TYPICAL)
    up = _up(arguments.up) if arguments.up else None
    robot = config.load(arguments.config).robot
    lengths = _lengths(arguments.link_length, robot)
    try:
        joints = [advise(one, _courses(one, swings, up, rate), bias, lengths) for one in joint_arrays(robot)]
    except ConfigurationError as error:
        raise ConfigurationError(f"{arguments.config}: no joint has accelerometer arrays: {error}") from None
    if arguments.json != "-":
        for joint in joints:
            _show(joint, rate, arguments.bias_mg)
    if arguments.plot:
        title = f"{arguments.config.name}, {rate:g} Hz"
        bound_plot.draw(arguments.plot, title, [_curves(joint) for joint in joints])
        err.print(f"{arguments.plot}: picture")
    if arguments.json:
        documents = {joint.arrays.joint.name: _document(joint) for joint in joints}
        document = {"schema": SCHEMA, "config": str(arguments.config), "rate_hz": rate, "joints": documents}
        write_json(arguments.json, document)
    return 0


def _within(flag: str, value: float, low: float, high: float, unit_: str) -> float:
    if not low <= value <= high:
        raise ConfigurationError(f"{flag}: {value:g} is not allowed; give {low:g} to {high:g} {unit_}")
    return value


def _swing(text: str, rate_hz: float) -> Swing:
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in (2, 4) or not all(map(math.isfinite, numbers)):
        raise ConfigurationError(f"--motion: '{text}' is not allowed; give DEG,HZ or DEG,HZ,DEG,HZ")
    for frequency in filter(None, numbers[1::2]):
        _within(f"--motion: '{text}': frequency", frequency, SLOWEST_HZ, rate_hz / 10.0, "Hz")
    return Swing(*(number if k % 2 else math.radians(number) for k, number in enumerate(numbers)))


def _courses(arrays: JointArrays, swings: list[Swing], up: Vec3 | None, rate_hz: float) -> list[Course]:
    """Gravity as given, or all of it across a child that lies level, and then none of it."""
    x, y = direction(arrays.child).tolist()
    level = tuple(([-y, x] @ plane(arrays.joint.axes[0])).tolist())
    ups = [up] if up else [level, arrays.joint.axes[0]]
    return [course(arrays.joint, swing, one, rate_hz) for one in ups for swing in swings]


def _up(text: str) -> Vec3:
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        x = y = z = 0.0
    if not 0.0 < norm((x, y, z)) < math.inf:
        raise ConfigurationError(f"--up: '{text}' is not allowed; give a direction X,Y,Z in the parent's frame")
    return unit((x, y, z))


def _lengths(texts: list[str], robot: Robot) -> dict[str, float]:
    lengths = {}
    for text in texts:
        link, _, metres = text.partition("=")
        try:
            lengths[link] = float(metres)
        except ValueError:
            raise ConfigurationError(f"--link-length: '{text}' is not allowed; give LINK=METRES") from None
        if link not in robot.links:
            raise ConfigurationError(f"--link-length: '{link}' is no link; give one of {', '.join(robot.links)}")
        _within(f"--link-length: {link}", lengths[link], 1e-3, 100.0, "m")
    return lengths


def _show(joint: Advice, rate_hz: float, bias_mg: float) -> None:
    arrays = joint.arrays
    number = f"{len(arrays.parent.sensors)} + {len(arrays.child.sensors)} accelerometers"
    noise = f"noise {joint.noise:.3g} m/s² a sample at {rate_hz:g} Hz"
    title = f"{arrays.joint.name}: {number}, {noise}\nerrors to expect of the angle, deg, and of the rates, deg/s"
    table = Table(title=title, title_justify="left")
    table.add_column("motion")
    for heading in ("gravity", "sample", "filter", "smoother", *(["biases"] if bias_mg else []), "rates"):
        table.add_column(heading, justify="right", no_wrap=True)
    for motion, one in zip(joint.courses, joint.now, strict=True):
        angles = [one.one_sample_deg, one.angle_deg, one.smoothed_deg, *([one.biased_deg] if bias_mg else [])]
        cells = [f"{value:.3g}" if one.observable else "-" for value in angles]
        rates = ", ".join(f"{rate:.3g}" for rate in one.rates_dps)
        table.add_row(str(motion.swing), f"{motion.gravity:.3g}", *cells, rates)
    out.print(table)
    _show_places(joint)


def _show_places(joint: Advice) -> None:
    table = Table(title="the same sensors at the ends of the links", title_justify="left")
    for heading in ("sensor", "link", "position now, m", "best position, m"):
        table.add_column(heading)
    for sensor, position in joint.positions():
        table.add_row(sensor.name, sensor.link, _vector(sensor.position), _vector(position))
    out.print(table)
    names = joint.arrays.joint.parent, joint.arrays.joint.child
    out.print("to " + ", ".join(f"{length:g} m on {name}" for name, length in zip(names, joint.lengths, strict=True)))
    for motion, now, improved in zip(joint.courses, joint.now, joint.improved_deg, strict=True):
        if now.observable:
            change = f"filter {now.angle_deg:.3g} -> {improved:.3g} deg"
            out.print(f"{_condition(motion)}: {change}, {100.0 * (1.0 - improved / now.angle_deg):.0f} % less")


def _condition(motion: Course) -> str:
    return f"{motion.swing}, gravity {motion.gravity:.3g}"


def _vector(position: tuple[float, ...]) -> str:
    return f"[{', '.join(f'{round(part, 4) + 0.0:g}' for part in position)}]"


def _curves(joint: Advice) -> bound_plot.SpanCurves:
    told = [(motion, one.angle_deg) for motion, one in zip(joint.courses, joint.now, strict=True) if one.observable]
    return bound_plot.SpanCurves(
        joint.arrays.joint.name,
        SPANS,
        {_condition(motion): bounds_by_span(joint, motion) for motion, _ in told},
        {_condition(motion): angle for motion, angle in told},
    )


def _document(joint: Advice) -> dict[str, Any]:
    """Of one joint; figures of an angle that cannot be observed are null."""
    motions = []
    for motion, one, improved in zip(joint.courses, joint.now, joint.improved_deg, strict=True):
        angles = {
            "one_sample_deg": one.one_sample_deg,
            "angle_deg": one.angle_deg,
            "smoothed_deg": one.smoothed_deg,
            "with_biases_deg": one.biased_deg,
            "best_places_angle_deg": improved,
        }
        motions.append(
            {
                "motion": str(motion.swing),
                "gravity": motion.gravity,
                "observable": one.observable,
                **{name: value if one.observable else None for name, value in angles.items()},
                "parent_rate_dps": one.rates_dps[0],
                "child_rate_dps": one.rates_dps[1],
            }
        )
    places = {sensor.name: list(position) for sensor, position in joint.positions()}
    return {"noise": joint.noise, "motions": motions, "best_places": places}
