"""`jointest record`: records the topics of a configuration, without rosbag2."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.live import Live
from rich.text import Text

from jointest_ros import config
from jointest_ros.bags.intake import Intake
from jointest_ros.bags.reader import absolute_name
from jointest_ros.cli.common import Parsers, complain, err, needs_ros, out, warn
from jointest_ros.core.errors import ConfigurationError, counted

if TYPE_CHECKING:
    from jointest_ros.nodes.recorder import Progress, Recorder

ALSO = ("outputs", "truth", "diagnostics")
_INCOMPLETE = 2  # exit code
_SILENT = 3  # s after which a topic without messages is told of
_LINE = 5  # s between lines where there is no terminal

_EPILOG = """what is recorded:
  the inputs that the configuration names (imu/<sensor>, mag/<sensor>, hall_voltages), and with --also
  outputs      joint_states, torso_angle and torso_orientation of estimators, in any namespace
  truth        all under ground_truth/, as sim_hardware_node sends it
  diagnostics  /diagnostics

examples:
  jointest record -o monday --config robot.yaml                     until Ctrl-C
  jointest record -o monday --config robot.yaml --duration 60       a minute from the first message on
  jointest record -o monday --config robot.yaml --also outputs diagnostics --topics /gripper/command
  jointest estimate monday --config robot.yaml -o angles.csv        or inspect, evaluate, calibrate, ros2 bag play, ...

Bytes are recorded as they come, with the time of their receipt. Ctrl-C and SIGTERM end the recording; so does a full
disk: what fitted is a sound recording. After a kill all but about the last second can be read."""


def add_parser(commands: Parsers[Any]) -> None:
    """Declare the command."""
    parser = commands.add_parser(
        "record",
        description="Record the topics of a configuration into a rosbag2 (mcap). It needs no rosbag2.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument(
        "-o", "--output", required=True, type=Path, metavar="BAG", help="directory of the new recording"
    )
    parser.add_argument("--config", "-c", required=True, type=Path, metavar="YAML", help="the robot's configuration")
    parser.add_argument("--namespace", default="", metavar="NS", help="namespace of the sensors' topics")
    parser.add_argument(
        "--also", nargs="+", choices=ALSO, default=[], metavar="WHAT", help=f"some of {', '.join(ALSO)}"
    )
    parser.add_argument("--topics", nargs="+", default=[], metavar="TOPIC", help="other topics, by name")
    parser.add_argument(
        "--duration", type=float, default=0.0, metavar="S", help="from the first message on (default: 0, no end)"
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Body of the command."""
    if not 0.0 <= arguments.duration < float("inf"):
        raise ConfigurationError(f"--duration: {arguments.duration:g} is not allowed; give seconds, or 0 for no end")
    configuration = config.load(arguments.config)
    names = Intake(configuration.robot, configuration.timing).topics
    inputs = {absolute_name(topic, arguments.namespace): msgtype for topic, msgtype in names.items()}
    others = [absolute_name(topic, arguments.namespace) for topic in arguments.topics]
    with needs_ros(on_this_host=False):
        from jointest_ros.nodes.recorder import Wanted, record
    wanted = Wanted(inputs, others, arguments.also)
    with Live(Text(""), console=err, auto_refresh=False, transient=True) as live:
        report = _Report(live, [*inputs, *others], arguments.config)
        return record(arguments.output, wanted, arguments.duration, report.show, report.finish)


class _Report:
    """What is told of a recording: a live line on standard error, and the result at its end."""

    def __init__(self, live: Live, expected: list[str], configuration: Path) -> None:
        self._live, self._expected, self._configuration = live, expected, configuration
        self._seconds, self._told = 0, set[str]()

    def show(self, recorder: Recorder, progress: Progress) -> None:
        """Once a second."""
        self._seconds += 1
        rates = "  ".join(f"{topic.lstrip('/')} {rate:.0f}/s" for topic, rate in progress.rates.items())
        line = f"{progress.seconds:.0f} s  {_megabytes(progress.size)}  {rates}"
        if err.is_terminal:
            self._live.update(Text(line), refresh=True)
        elif self._seconds % _LINE == 0:
            err.print(line)
        troubles = dict(recorder.problems)
        if self._seconds >= _SILENT:
            silent = [topic for topic in self._expected if not recorder.received.get(topic)]
            troubles |= {f"silent {topic}": recorder.silent(topic) for topic in silent}
        for key, text in troubles.items():
            if key not in self._told:
                warn(text)
        self._told |= troubles.keys()

    def finish(self, recorder: Recorder) -> int:
        """At the end; the exit code."""
        self._live.stop()
        path, counts, failure = recorder.writer.path, recorder.writer.counts, recorder.failure
        total = sum(counts.values())
        if not total:
            recorder.writer.discard()
            complain("record", failure or f"{path}: nothing is recorded: no message came on {', '.join(counts)}")
            return _INCOMPLETE
        for topic, count in counts.items():
            out.print(f"  {topic}: {counted(count, 'message')}")
        out.print(f"{path}: {counted(total, 'message')}, {_megabytes(recorder.writer.size)}")
        if failure is not None:
            complain("record", f"{failure}; what fitted, {counted(total, 'message')}, is a sound recording")
            return _INCOMPLETE
        out.print(f"next: jointest inspect {path} --config {self._configuration}")
        return 0


def _megabytes(size: int) -> str:
    return f"{size / 1e6:.1f} MB"
