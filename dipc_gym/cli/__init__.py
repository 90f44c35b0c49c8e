"""The command line: a file for every subcommand, or for two that belong together.

A subcommand is a dataclass: its fields are its options, `run` does the work. What it needs is imported when it runs, so
that help comes at once.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from typing import Protocol

import numpy as np
import tyro

from dipc_gym import __version__
from dipc_gym.cli.compare import Compare
from dipc_gym.cli.compensator import FromModel
from dipc_gym.cli.diagnose import Diagnose, Report
from dipc_gym.cli.export import Export
from dipc_gym.cli.options import check_choices
from dipc_gym.cli.plan import Plan
from dipc_gym.cli.record import Record, Render
from dipc_gym.cli.replay import Replay
from dipc_gym.cli.train import Train, TrainPolicy
from dipc_gym.cli.trial import Trial
from dipc_gym.safety.interrupts import as_ctrl_c
from dipc_gym.safety.naming import suggestion


class Command(Protocol):
    """What `main` asks of a subcommand."""

    def run(self) -> int:
        """Do it; the exit code."""


COMMANDS: dict[str, type[Command]] = {
    "compare": Compare,
    "train": Train,
    "train-policy": TrainPolicy,
    "plan": Plan,
    "record": Record,
    "replay": Replay,
    "diagnose": Diagnose,
    "report": Report,
    "compensator": FromModel,
    "export": Export,
    "trial": Trial,
    "render": Render,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; the exit code is 0, 1 if part of it failed, 2 for bad input, 130 after Ctrl-C or SIGTERM.

    It is 1 too if nobody reads what is printed, as after `| head`, or when `| tee` has ended with the same Ctrl-C.
    """
    try:
        code = _run(arguments)
        sys.stdout.flush()
    except BrokenPipeError:
        _print_to_nobody()
        return 1
    return code


def _run(arguments: Sequence[str] | None) -> int:
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    if arguments == ["--version"]:
        print(f"dipc-gym {__version__}")
        return 0
    if arguments and not arguments[0].startswith("-") and arguments[0] not in COMMANDS:
        named, near = ", ".join(COMMANDS), suggestion(arguments[0], COMMANDS)
        print(f"dipc-gym: there is no command {arguments[0]!r}; there are {named}{near}", file=sys.stderr)
        return 2
    try:
        if arguments and arguments[0] in COMMANDS:
            check_choices(COMMANDS[arguments[0]], arguments[1:])
        command = tyro.extras.subcommand_cli_from_dict(
            COMMANDS,  # type: ignore[arg-type]
            prog="dipc-gym",
            description=(
                "A double inverted pendulum on a cart with stick-slip friction: an environment, friction compensators, "
                "and a tool that names the physics a simulator leaves out. --version tells the version."
            ),
            args=arguments,
            config=(tyro.conf.FlagCreatePairsOff,),
        )
        with as_ctrl_c():
            return command.run()
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    except BrokenPipeError:
        raise
    except np.linalg.LinAlgError:  # a ValueError, but never what the package raises for input
        raise
    except MemoryError as error:
        print(f"dipc-gym: there is not enough memory for this ({error or 'none left'})", file=sys.stderr)
        return 2
    except (ValueError, OSError, ImportError) as error:  # what the package raises for input it cannot use
        print(f"dipc-gym: {error}", file=sys.stderr)
        return 2


def _print_to_nobody() -> None:
    """Let what is still to be printed vanish, so that Python ends without a complaint."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
