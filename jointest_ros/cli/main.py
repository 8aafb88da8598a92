"""`jointest`: one file a sub-command. Exit code 0: done; 2: bad input or a bad configuration, said in one line."""

from __future__ import annotations

import argparse
import sys

from jointest_ros import __version__
from jointest_ros.cli import convert, demo, estimate, evaluate, simulate
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
    for module in (demo, simulate, convert, estimate, evaluate):
        module.add_parser(commands)
    return parser


def main(args: list[str] | None = None) -> int:
    """Run one command; its exit code."""
    parsed = make_parser().parse_args(args)
    try:
        return int(parsed.run(parsed))
    except JointestError as error:
        print(f"jointest {parsed.command}: error: {error}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print(f"jointest {parsed.command}: interrupted", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:  # the reader of our output went away, as `| head` does
        sys.stderr.close()
        return 0
