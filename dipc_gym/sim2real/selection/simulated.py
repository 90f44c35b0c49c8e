"""Whether recordings are a simulation's: MuJoCo's, with the model's own integrator at its own step.

Who tries a diagnosis hides something in a model, lets MuJoCo simulate it, and gives the rest. What a step costs, and
how soft MuJoCo's dry friction is, are in such recordings like all else; no physics of a rig explains them, and what
comes nearest (bristles, a load that swings) is not there.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dipc_gym.sim2real.effects.shared.base import Effect
from dipc_gym.sim2real.estimation.fit import Fit, fit
from dipc_gym.sim2real.estimation.problem import Problem
from dipc_gym.sim2real.estimation.shooting import common_error
from dipc_gym.sim2real.estimation.steps import controlled
from dipc_gym.sim2real.model.structure import Structure, Term, carry
from dipc_gym.sim2real.selection.score import compare
from dipc_gym.sim2real.selection.settings import SCORE, SEARCH, WINDOWS
from dipc_gym.sim2real.simulation.batch import Stepping

Array = NDArray[np.float64]

COULOMB = "friction.coulomb"
ELABORATED = {COULOMB, "friction.stribeck"}


def look_simulated(problem: Problem, fitted: Fit, coulomb: Effect | None = None, *, at_noise: bool = False) -> bool:
    """Whether the model's own steps predict to the noise, and clearly better than those that a structure was fitted in.

    Dry friction is asked for as MuJoCo has it: what was accepted may be what made up for that. Far from the noise every
    third window tells; near it, all of them.

    Args:
        problem: windows.
        fitted: to these.
        coulomb: dry friction of a constant level, where that is asked for.
        at_noise: whether to ask that also where fine steps are at the noise: parameters fitted in these may make up for
            what steps cost, and then predict other windows worse.
    """
    structure, z = with_coulomb(fitted, coulomb)
    near_enough = fitted.error <= SCORE.at_noise and structure is fitted.structure
    if problem.stepping.integrator is None or (near_enough and not at_noise):
        return False
    if not _by_mujoco_alone(structure):
        return False
    some = np.arange(0, len(problem.windows), WINDOWS.every if fitted.error > SEARCH.in_reach else 1)
    few, before = problem.pick(some), fitted.mse[some]
    simulated = fit(in_own_steps(few, structure), as_simulated(structure), z, most=SEARCH.sketch_steps)
    if common_error(simulated.mse) > SCORE.at_floor or not _told(simulated.mse, before, few.blocks):
        return False
    # A model may have finer steps than the search, which a fast rig asks for: those are no simulation's.
    finest = controlled(few, fitted.structure, fitted.z)
    if finest is few:
        return True
    after = fit(finest, fitted.structure, fitted.z, fitted.initial[some], most=SEARCH.sketch_steps).mse
    return _told(simulated.mse, after, few.blocks)


def steps_cost(problem: Problem, fitted: Fit) -> bool:
    """Whether a fit predicts otherwise in the model's own steps, by enough to be taken for physics.

    Args:
        problem: windows.
        fitted: to these.
    """
    if problem.stepping.integrator is None or not _by_mujoco_alone(fitted.structure):
        return False
    own = fit(in_own_steps(problem, fitted.structure), as_simulated(fitted.structure), fitted.z, fitted.initial, most=0)
    return abs(own.error - fitted.error) > SEARCH.steps_cost


def _by_mujoco_alone(structure: Structure) -> bool:
    """Whether MuJoCo simulates all that acts in a structure; what changes readings may have been done to its output."""
    return not any(term.effect.needs_loader and not term.effect.moves_readings for term in structure.terms)


def _told(simulated: Array, fine: Array, blocks: NDArray[np.intp]) -> bool:
    """Whether the model's own steps, which predict to the noise, predict clearly better than fine ones do.

    Short recordings hold too few seconds for a standard error to say so. There it is told by fine steps that do not
    come to the noise, and lose in every second.

    Args:
        simulated: mean square errors in the model's own steps, (n,).
        fine: in fine ones, (n,).
        blocks: second of each window, (n,).
    """
    gained = compare(simulated, fine, blocks)
    return gained.clear or (common_error(fine) > SCORE.at_floor and gained.worst > 0)


def in_own_steps(problem: Problem, structure: Structure) -> Problem:
    """Windows in the steps and with the integrator of a model's file."""
    return replace(problem, stepping=Stepping(structure.document.timestep), halved=None)


def as_simulated(structure: Structure) -> Structure:
    """A structure whose dry friction is as soft as MuJoCo makes it."""
    return replace(structure, document=structure.document.of_a_simulation())


def with_coulomb(fitted: Fit, coulomb: Effect | None) -> tuple[Structure, Array]:
    """A structure with Coulomb friction in the place of what elaborates it, and its mapped parameters (p,); the very
    same if nothing does. Friction that holds more than that, as a steady force or a drag, stays.
    """
    structure, terms = fitted.structure, list[Term]()
    for term in structure.terms:
        if coulomb is not None and coulomb.id in term.effect.contains and {*term.effect.contains} <= ELABORATED:
            values = structure.term_values(fitted.z, term)
            level = float(np.mean([values[name] for name in term.effect.levels]))
            terms.append(Term(coulomb, term.at, {"level": level}))
        else:
            terms.append(term)
    if tuple(terms) == structure.terms:
        return structure, fitted.z
    plain = replace(structure, terms=tuple(terms))
    return plain, carry(structure, fitted.z, plain)
