"""The command line: a file for every subcommand, or for two that belong together.

A subcommand is a dataclass: its fields are its options, `run` does the work. What it needs is imported when it runs, so
that help comes at once.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Protocol

import numpy as np
import tyro

from dipc_gym.cli.compare import Compare
from dipc_gym.cli.compensator import FromModel
from dipc_gym.cli.diagnose import Diagnose
from dipc_gym.cli.export import Export
from dipc_gym.cli.record import Record, Render
from dipc_gym.cli.replay import Replay
from dipc_gym.cli.train import Train, TrainPolicy
from dipc_gym.cli.trial import Trial


class Command(Protocol):
    """What `main` asks of a subcommand."""

    def run(self) -> int:
        """Do it; the exit code."""


COMMANDS: dict[str, type[Command]] = {
    "compare": Compare,
    "train": Train,
    "train-policy": TrainPolicy,
    "record": Record,
    "replay": Replay,
    "diagnose": Diagnose,
    "compensator": FromModel,
    "export": Export,
    "trial": Trial,
    "render": Render,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; the exit code is 0, 1 if part of it failed, 2 for bad input, 130 after Ctrl-C."""
    command = tyro.extras.subcommand_cli_from_dict(
        COMMANDS,  # type: ignore[arg-type]
        prog="dipc-gym",
        description=(
            "A double inverted pendulum on a cart with stick-slip friction: an environment, friction compensators, "
            "and a tool that names the physics a simulator leaves out."
        ),
        args=arguments,
        config=(tyro.conf.FlagCreatePairsOff,),
    )
    try:
        return command.run()
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    except np.linalg.LinAlgError:  # a ValueError, but never what the package raises for input
        raise
    except (ValueError, OSError, ImportError) as error:  # what the package raises for input it cannot use
        print(f"dipc-gym: {error}", file=sys.stderr)
        return 2
