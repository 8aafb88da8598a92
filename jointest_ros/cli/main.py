"""`jointest`: one file a sub-command. Exit code 0: done; 2: bad input or a bad configuration, said in one line."""

from __future__ import annotations

import argparse
import itertools
import os
import signal
import sys
from importlib import import_module
from typing import Any

from jointest_ros import __version__
from jointest_ros.interruption import ended_by

BAD_INPUT = 2
INTERRUPTED = 130

# command -> the module in this folder that declares it, what it does; a module is imported when its command is chosen,
# which takes a second
COMMANDS = {
    "demo": ("demo", "estimates beside the truth, live, on a shipped recording or your own"),
    "init": ("init_config", "write a commented configuration for your own robot"),
    "inspect": ("inspect_bag", "what a recording holds, whether a configuration is sound, whether the two fit"),
    "simulate": ("simulate", "write a synthetic rosbag2 recording with ground truth"),
    "convert": ("convert", "turn a public recording into a rosbag2 with ground truth"),
    "estimate": ("estimate", "joint angles of a recording, to rosbag2 or CSV"),
    "evaluate": ("evaluate", "errors of estimators against the ground truth of recordings"),
    "calibrate": ("calibrate", "fit sensors to a recording, write the calibration file"),
    "bound": ("bound", "the error that accelerometer arrays allow, and the best places for them"),
    "reproduce": ("reproduce", "the papers' tables and figures beside ours"),
    "bench": ("bench", "what a step, a node and an evaluation cost here, beside the peers"),
    "view": ("view", "write the URDF of a robot and a Foxglove layout for it"),
    "record": ("record", "record the topics of a configuration into a rosbag2 (mcap)"),
}

_DESCRIPTION = """Joint angles without encoders: from link-mounted IMUs to angles, on recordings and live.

First steps:
  jointest demo                                        estimates beside the truth, live, on a shipped recording
  jointest simulate finger -o my_bag                   a recording with ground truth, and its configuration my_bag.yaml
  jointest evaluate my_bag --config my_bag.yaml        errors in degrees
  jointest estimate my_bag --config my_bag.yaml -o angles.csv

`jointest COMMAND --help` tells more about each."""


class _Parser(argparse.ArgumentParser):
    """Asks after a misspelt option or command; argparse would name what is missing in its stead, or a long list."""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        if self._subparsers is None:  # the options of a command, not those before or after its name
            known = self._option_string_actions
            for word in itertools.takewhile("--".__ne__, args):
                option = word.split("=")[0]
                if option.startswith("--") and not any(name.startswith(option) for name in known):
                    self.error(f"unrecognized arguments: {option}{_hint(option, known)}")
        return super().parse_known_args(args, namespace)


def _hint(word: str, known: Any) -> str:
    """The end of a message about a word that is not known. "" where nothing is like it."""
    from jointest_ros.core.errors import did_you_mean  # not before Ctrl-C is taken care of

    hint = did_you_mean(word, known)
    return f"; {hint}" if hint else ""


def make_parser(chosen: str) -> argparse.ArgumentParser:
    """The command line: all commands by name, the one that is chosen with its arguments."""
    parser = _Parser("jointest", description=_DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--version", action="version", version=f"jointest {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for name, (module, text) in COMMANDS.items():
        if name == chosen:
            import_module(f"jointest_ros.cli.{module}").add_parser(commands)
        else:
            commands.add_parser(name, help=text)
    if chosen and not chosen.startswith("-") and chosen not in COMMANDS:
        meant = _hint(chosen, COMMANDS) or f" (choose from {', '.join(COMMANDS)})"
        parser.error(f"argument COMMAND: invalid choice: '{chosen}'{meant}")
    return parser


def main(args: list[str] | None = None) -> int:
    """Run one command; its exit code. Raises SystemExit for `--help` and for arguments that are none, with code 2."""
    args = sys.argv[1:] if args is None else args
    with ended_by(signal.SIGINT, text="jointest: interrupted\n", code=INTERRUPTED):
        parser = make_parser(args[0] if args else "")
        if not args:
            parser.print_help()
            return 0
        parsed = parser.parse_args(args)
        from jointest_ros.cli.common import complain
        from jointest_ros.core.errors import JointestError
    try:
        return int(parsed.run(parsed))
    except JointestError as error:
        complain(parsed.command, error)
        return BAD_INPUT
    except KeyboardInterrupt:
        print(f"jointest {parsed.command}: interrupted", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:  # the reader of our output went away, as `| head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for what Python writes when it ends
        return 0
