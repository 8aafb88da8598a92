"""`jointest`: one file a sub-command. Exit code 0: done; 2: bad input or a bad configuration, said in one line."""

from __future__ import annotations

import argparse
import os
import sys

from jointest_ros import __version__
from jointest_ros.cli import bound, calibrate, convert, demo, estimate, evaluate, reproduce, simulate
from jointest_ros.cli.common import complain
from jointest_ros.core.errors import JointestError

BAD_INPUT = 2
INTERRUPTED = 130

_DESCRIPTION = """Joint angles without encoders: from link-mounted IMUs to angles, on recordings and live.

First steps:
  jointest demo                                        estimates beside the truth, live, on a shipped recording
  jointest simulate finger -o my_bag                   a recording with ground truth, and its configuration my_bag.yaml
  jointest evaluate my_bag --config my_bag.yaml        errors in degrees
  jointest estimate my_bag --config my_bag.yaml -o angles.csv

`jointest COMMAND --help` tells more about each."""


def make_parser() -> argparse.ArgumentParser:
    """The whole command line."""
    parser = argparse.ArgumentParser(
        "jointest", description=_DESCRIPTION, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--version", action="version", version=f"jointest {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    for module in (demo, simulate, convert, estimate, evaluate, calibrate, bound, reproduce):
        module.add_parser(commands)
    return parser


def main(args: list[str] | None = None) -> int:
    """Run one command; its exit code. Raises SystemExit for `--help` and for arguments that are none, with code 2."""
    parser = make_parser()
    args = sys.argv[1:] if args is None else args
    if not args:
        parser.print_help()
        return 0
    parsed = parser.parse_args(args)
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
