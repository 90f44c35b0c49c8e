"""Write what was found back as MJCF, with parameters that hold at the step at which the file is simulated, if any
do.
"""

from __future__ import annotations

import contextlib
import re
from dataclasses import replace

import mujoco
import numpy as np

from dipc_gym import mjcf, physics
from dipc_gym.recording.units import of_sensor
from dipc_gym.sim2real.effects.base import is_dcmotor, joint_of
from dipc_gym.sim2real.estimation.fit import Fit, fit
from dipc_gym.sim2real.estimation.problem import Problem
from dipc_gym.sim2real.estimation.segments import Prepared
from dipc_gym.sim2real.model.structure import Structure, Term
from dipc_gym.sim2real.result import Errors
from dipc_gym.sim2real.selection.settings import SCORE
from dipc_gym.sim2real.simulation.batch import Stepping, is_stiff
from dipc_gym.sim2real.verdict import judge
from dipc_gym.sim2real.verdict.settings import VERDICT


def improved_model(
    source: mjcf.Source,
    given: physics.Physics,
    prepared: Prepared,
    final: Fit,
    errors: Errors,
) -> tuple[str, str]:
    """Text of the improved model, refitted at its own step where that makes up for it, and a note on what it costs."""
    structure = final.structure
    if not structure.model_parameters and not structure.terms:
        return source.text, ""
    own = Stepping(given.model.opt.timestep, None)
    coarse = replace(prepared.problem, stepping=own)
    count = len(coarse.windows)
    some = coarse.pick(np.unique(np.linspace(0, count - 1, min(36, count)).round().astype(np.intp)))
    written, enough = final, SCORE.at_floor * max(errors.improved, 1.0)
    error = judge.error_on(some, final)
    note = ""
    if error > enough:
        # Parameters that make up for a step are wrong at any other; they are worth having where they do make up for it.
        with contextlib.suppress(mjcf.MjcfError, np.linalg.LinAlgError):
            again = fit(some, structure, final.z, most=4)
            if (refitted := judge.error_on(some, again)) <= enough:
                written, error = again, refitted
    if error > enough:
        note = (
            f"At the model's own step of {1e3 * own.timestep:g} ms and with its integrator the improved model predicts "
            f"to {error:.3g} times the noise, with a converged step to {errors.improved:.3g}, and no parameters make "
            f"up for that: a shorter step is worth more than any further physics. {_advice(some, own, final, enough)}"
        ).strip()
    z = written.z
    document = structure.write(z)
    lines = [t.effect.sentence(t.at, structure.term_values(z, t), place_units(structure, t)) for t in structure.terms]
    loaders = [t.key for t in structure.terms if t.effect.needs_loader]
    if structure.model_parameters:
        moved = {
            n.key: abs(change) >= VERDICT.negligible for n, change in zip(structure.model_parameters, z, strict=False)
        }
        lines.append("Refitted: " + ", ".join(key if far else f"{key} (hardly)" for key, far in moved.items()) + ".")
    if written is not final:
        lines.append(
            f"Parameters are what this file's step of {1e3 * own.timestep:g} ms and its integrator need to predict the "
            "recordings; those that fine steps need are in diagnosis.json."
        )
    if loaders:
        lines.append(f"Stock MuJoCo leaves out {', '.join(loaders)}; dipc_gym.physics.load applies what <custom> says.")
    document.comment("Changed by dipc-gym diagnose.", *lines)
    return document.text(), note


def _advice(some: Problem, own: Stepping, final: Fit, enough: float) -> str:
    """The longest of a few shorter steps at which a model predicts well enough, in words; nothing if none does."""
    stiff = is_stiff(final.structure.physics(final.z).model).any()
    some = some.pick(np.arange(0, len(some.windows), 3))  # the shortest steps take longest, and a factor of two is told
    for shorter in VERDICT.shorter:
        step = own.timestep / shorter
        error = judge.error_on(replace(some, stepping=Stepping(step, None)), final)
        if error <= enough:
            also = f" and each solreffriction {shorter} times shorter as well" if stiff else ""
            return f"With a timestep of {1e3 * step:g} ms{also} it predicts to {error:.3g} times the noise."
    return ""


def place_units(structure: Structure, term: Term) -> dict[str, str]:
    """Unit of each parameter of an effect, in terms of its joint's kind."""
    model = structure.model
    joint = term.at if term.effect.place == "joint" else ""
    if term.effect.place == "actuator":
        joint = joint_of(model, term.at) or ""
    hinge = bool(joint) and mjcf.is_hinge(model, joint)
    units = {}
    for p in term.effect.parameters:
        unit = p.unit
        if hinge and term.effect.id != "motor.cogging":
            unit = _angular(unit)
        if unit == "reading":
            unit = of_sensor(model, term.at)
        units[p.name] = _command_unit(model, term.at, hinge) if unit == "command" else unit
    return units


def _angular(unit: str) -> str:
    """A unit of a slide's parameter as that of a hinge's: N s/m becomes N m s/rad."""
    if "N m" in unit:
        return unit
    return re.sub(r"\bkg\b", "kg m^2", re.sub(r"\bN\b", "N m", re.sub(r"\bm\b", "rad", unit)))


def _command_unit(model: mujoco.MjModel, actuator: str, hinge: bool) -> str:
    """Unit of what is sent to an actuator; none where its gear makes a force of a number of its own."""
    if is_dcmotor(model, actuator):
        return "V"
    i = model.actuator(actuator).id
    force = model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_JOINT and model.actuator_gear[i, 0] == 1
    if force and model.actuator_gaintype[i] == mujoco.mjtGain.mjGAIN_FIXED and model.actuator_gainprm[i, 0] == 1:
        return "N m" if hinge else "N"
    return ""
