"""From files to files: the parts of a loop, found by name, and what is written of it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

import dipc_gym
from dipc_gym import compensators, controllers, estimators
from dipc_gym.compensators import Compensator, StaticGain
from dipc_gym.compensators.memory import check_period
from dipc_gym.controllers import Controller
from dipc_gym.dataflow import Program
from dipc_gym.env import DoublePendulumEnv
from dipc_gym.estimators.differences import FilteredDifference
from dipc_gym.export import c, onnx
from dipc_gym.export.parts import READINGS, Estimator, Loop
from dipc_gym.plant import Plant
from dipc_gym.policy import FORMAT, SCHEMA, Policy
from dipc_gym.safety.files import write_whole

Array = NDArray[np.float64]

PERIODS = 400  # of the test vectors: two seconds, in which every memory has been filled and emptied
TOLERANCE = 1e-12
"""V; how far the C code may be from Python in double precision. Rounding alone makes a hundredth of it."""
INPUTS = {
    "cart": "position of the cart, m",
    "pole1": "angle of the first pole from upright, rad",
    "pole2": "angle of the second pole relative to the first, rad",
}


@dataclass(frozen=True)
class Bundle:
    """A loop and the words that go with it.

    Attributes:
        loop: what is exported.
        plant: rig that it is made for.
        about: what it consists of, in lines.
        model: MJCF file of the rig; None is the package's.
    """

    loop: Loop
    plant: Plant
    about: tuple[str, ...]
    model: str | None = None


def bundle(
    file: str | Path,
    plant: Plant,
    *,
    controller: str | None = None,
    compensator: str | None = None,
    model: str | None = None,
    estimator: str | None = None,
    force_limit: float | None = None,
) -> Bundle:
    """The loop around a saved compensator or policy.

    Args:
        file: of a compensator, or of a policy (`.json`).
        plant: encoders, control period, motor and supply.
        controller: with a compensator: `lqr`, which is the default, a design by name, or the file of a policy.
        compensator: with a policy that commands force: the file of the compensator that it was trained with.
        model: MJCF file of the rig; None is the package's.
        estimator: the file of an estimator; by default it is filtered differences, as the environment has them.
        force_limit: largest force either way, N; by default what the blocked motor exerts at full supply.

    Raises:
        ValueError: a file is refused, parts do not go together, or the motor is not known and no limit is given.
    """
    content = FORMAT.read(file)
    is_policy = isinstance(content, dict) and content.get("schema") == SCHEMA
    brain: Controller
    if is_policy:
        if controller is not None:
            raise ValueError(f"{file} is a policy, so it is the controller; leave out --controller {controller}")
        brain = Policy.load(file)
        if brain.swings_up:
            raise ValueError(f"{file}: the policy swings up, and what sees the poles swing has no exported form yet")
        part, source = _behind(brain, compensator)
    else:
        part, source = compensators.load(file), str(file)
        if compensator is not None:
            raise ValueError(f"{file} is a compensator; leave out --compensator {compensator}")
        brain = controllers.balancing(controller or "lqr")
        if isinstance(brain, Policy):
            brain.require(part.name)
    supply = plant.supply if part.supply is None else min(plant.supply, part.supply)
    if force_limit is None:
        if plant.motor is None:
            raise ValueError("the model's motor is not known, so the largest force is not; say --force-limit")
        force_limit = plant.motor.force_per_volt * supply
    if not 0 < force_limit < np.inf:
        raise ValueError(f"--force-limit {force_limit:g}: give a positive number of newtons")
    filtered = FilteredDifference(plant.encoders.velocity_filter, plant.control_period)
    seeing: Estimator = filtered
    sight = f"differences of the readings through a low-pass of {1000 * filtered.time_constant:g} ms"
    named: str | None = None
    if estimator is not None:
        seeing, named = _seeing(estimator, plant)
        sight = f"{named} of {estimator}"
    if isinstance(brain, Policy):
        brain.require_estimator(named)
    check_period(part, plant.control_period)
    about = (
        f"Call it every {1000 * plant.control_period:g} ms.",
        "",
        f"Estimator: {sight}.",
        f"Controller: {_brain(brain)}.",
        f"Compensator: {part.name}{f' of {source}' if source else ''}{_trained(part)}.",
        f"Limits: {force_limit:g} N, {supply:g} V.",
        "",
        "A reading that is not a number, or larger than 1000 m or rad, makes the voltage 0 for that period, and the",
        "estimate goes on without it. A state that is no longer finite is reset. No input gives more than the supply.",
        "",
        f"Written by dipc-gym {dipc_gym.__version__}.",
    )
    part = part.behind(supply)  # what it remembers of voltages is what this rig's amplifier lets through
    return Bundle(Loop(seeing, brain, part, force_limit, supply, plant.control_period), plant, about, model)


def write_c(found: Bundle, path: Path) -> tuple[Program, Path]:
    """Write the header, and beside it `STEM_test.c`, which checks it.

    Returns:
        The program and the path of the check.

    Raises:
        program.NoForm: a part cannot be written in C.
        OSError: a file cannot be written.
    """
    program = found.loop.program()
    words = c.Header(prefix(path), f"{path.stem}: encoder readings in, motor voltage out.", found.about, INPUTS,
                     "the motor voltage, V.")  # fmt: skip
    beside = checker(path)
    text = c.header(program, words)
    rows = vectors(program, found.plant, found.model)
    test = c.check(program, words, header_name=path.name, file_name=beside.name, vectors=rows, tolerance=TOLERANCE)
    write_whole(path, text.encode())
    write_whole(beside, test.encode())
    return program, beside


def write_onnx(found: Bundle, path: Path) -> Program:
    """Write the ONNX graph.

    Raises:
        program.NoForm: a part cannot be written so.
        ImportError: onnx is not installed.
        OSError: the file cannot be written.
    """
    program = found.loop.program()
    write_whole(path, onnx.graph(program, about="\n".join(found.about)))
    return program


def prefix(path: Path) -> str:
    """What stands before the names in a header of that path.

    Example:
        >>> prefix(Path("runs/My rig-2.h"))
        'my_rig_2'
    """
    name = re.sub(r"[^a-z0-9]+", "_", path.stem.lower()).strip("_")
    return name if name[:1].isalpha() else f"loop_{name}".rstrip("_")


def checker(path: Path) -> Path:
    """Where the check of a header stands.

    Example:
        >>> checker(Path("rig.h")).name
        'rig_test.c'
    """
    return path.with_name(f"{path.stem}_test.c")


def vectors(program: Program, plant: Plant, model: str | None = None) -> Array:
    """Readings of a rig under the program's voltages, some of them broken, and those voltages.

    The loop is closed: to a filter that knows the rig, readings that its voltages did not cause are a huge disturbance,
    and nearly all that one would see are the limits.

    Returns:
        (periods, 5): 1 to reset first, three readings, the voltage.
    """
    env = DoublePendulumEnv(plant=plant, model=model)
    broken = {PERIODS // 4: (1, 1e30), PERIODS // 3: (2, -1e30), PERIODS // 2 + 3: (3, 2e3)}
    table, ended = np.zeros((PERIODS, 5)), True
    for k, row in enumerate(table):
        if ended:
            env.reset(seed=k)
        if ended or k == PERIODS // 2:
            row[0], memory = 1.0, program.memory()
        row[1:4] = env.encoders
        if k in broken:
            place, value = broken[k]
            row[place] = value
        outputs, memory = program.run({name: row[i + 1 : i + 2] for i, name in enumerate(READINGS)}, memory)
        row[4] = outputs["voltage"][0, 0]
        ended = env.step(row[4:])[2]
    env.close()
    return table


def _seeing(file: str, plant: Plant) -> tuple[Estimator, str]:
    """An estimator from its file, for a loop of this period, and its name."""
    estimator = estimators.load(file)
    if not np.isclose(estimator.rig.period, plant.control_period, rtol=1e-9, atol=0.0):
        raise ValueError(
            f"{file}: the estimator is for a control period of {1000 * estimator.rig.period:g} ms, and the plant's is "
            f"{1000 * plant.control_period:g} ms; fit it again with --plant"
        )
    return cast(Estimator, estimator), estimator.name  # `Loop` refuses those that have no form


def _behind(policy: Policy, compensator: str | None) -> tuple[Compensator, str]:
    """The compensator that stands behind a policy, and its file."""
    if policy.commands == "voltage":
        if compensator is not None:
            raise ValueError(f"policy {policy.name!r} commands voltage; leave out --compensator {compensator}")
        return StaticGain(newtons_per_volt=policy.newtons_per_volt), ""
    if compensator is None:
        raise ValueError(
            f"policy {policy.name!r} commands force through the compensator {policy.compensator!r}; say --compensator "
            "FILE.json (train-policy wrote it beside the policy)"
        )
    part = compensators.load(compensator)
    policy.require(part.name)
    return part, compensator


def _brain(brain: Controller) -> str:
    if isinstance(brain, Policy):
        return f"policy {brain.name}, {brain.parameters:,} numbers, seed {brain.seed}"
    gain: Sequence[float] = getattr(brain, "gain", np.zeros(0)).tolist()
    return f"{brain.name}, gain {', '.join(f'{x:g}' for x in gain)}" if gain else brain.name


def _trained(part: Compensator) -> str:
    if not part.ranges:
        return ""
    force, velocity = part.ranges[:2]
    return f", trained for {force.low:.3g} to {force.high:.3g} N at {velocity.low:.3g} to {velocity.high:.3g} m/s"
