"""What is written back, judged as its owner will run it: by MuJoCo, with the file's own integrator at its own step.

What predicts best in fine steps need not do so there: bristles may be too stiff for the step, a peak of friction
shorter than it. So every effect that MJCF can say in several ways is written in the one whose file predicts best, and
no file is written that predicts worse than the one that was given. MuJoCo's Euler integrators move positions by the
velocity at the end of a step, half a step ahead of time: on a fast axis that may cost more than what was missing. Where
it keeps what was found from being written, the file asks for Runge-Kutta at the same step.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf
from dipc_gym.sim2real.estimation.fit import Fit, begun, fit, simulated
from dipc_gym.sim2real.estimation.problem import Problem
from dipc_gym.sim2real.estimation.shooting import rms
from dipc_gym.sim2real.model.structure import Structure, Term, carry
from dipc_gym.sim2real.result import AsWritten, Errors, FinerSteps
from dipc_gym.sim2real.selection.partitioning import evenly
from dipc_gym.sim2real.selection.progress import Partition
from dipc_gym.sim2real.selection.settings import SCORE
from dipc_gym.sim2real.simulation.batch import Stepping
from dipc_gym.sim2real.verdict.settings import VERDICT

Array = NDArray[np.float64]

EXACT = "RK4"
"""MuJoCo's integrator whose error falls with the fourth power of the step; four times the work of a step."""


@dataclass(frozen=True)
class Option:
    """A model that may be written.

    Attributes:
        structure: in which form each effect is.
        z: its mapped parameters, (p,).
        error: on validation data at the file's own step, in units of noise.
        refitted: whether the parameters make up for the step.
        forms: elements in words, by key of each effect that is in another form than it was fitted in.
    """

    structure: Structure
    z: Array
    error: float
    refitted: bool = False
    forms: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True)
class Predictor:
    """Predicts windows as the owner of a file will.

    Attributes:
        fine: windows, in the steps of the diagnosis.
        own: the same in those of the file.
    """

    fine: Problem
    own: Problem
    _begun: dict[tuple[int, bytes], tuple[Structure, tuple[Array, Array]]] = field(default_factory=dict, repr=False)

    def error(self, structure: Structure, z: Array) -> float:
        """Root mean square error of a structure, in units of noise; infinite where it does not compile."""
        return rms(self.mse(structure, z))

    def mse(self, structure: Structure, z: Array, which: NDArray[np.intp] | None = None) -> Array:
        """Mean square error of each window, or of some, in units of noise; infinite where it does not compile.

        Where a window begins is told by fine steps, once for all others.
        """
        key, some = (id(structure), z.tobytes()), np.arange(len(self.own.windows)) if which is None else which
        try:
            if key not in self._begun:
                self._begun[key] = structure, begun(self.fine, structure, z)
            initial, sensitivity = self._begun[key][1]
            problem = self.own if which is None else self.own.pick(which)
            return simulated(problem, structure, z, (initial[some], sensitivity[some]))
        except (mjcf.MjcfError, np.linalg.LinAlgError):
            return np.full(len(some), np.inf)

    def at(self, step: float) -> Predictor:
        """The same windows in other steps of the model's own integrator, s."""
        return replace(self, own=replace(self.fine, stepping=Stepping(step), halved=None))


def choose(
    physical: Sequence[Option],
    refitted: Sequence[Option],
    exact: Sequence[Option],
    plainer: Sequence[Option],
    enough: float,
) -> Option:
    """Which model is written.

    Parameters that make up for a step are wrong at any other: they are worth having only where they do make up for it,
    or for most of it where every other file would predict worse than a plainer one does. Where the step costs more than
    what is missing does, which file predicts better at it is chance; the rig's own parameters are right at any other.
    Another integrator takes four times as long, and is asked for only where a plainer model would be written else.

    Args:
        physical: with the rig's own parameters; the first in the forms that were fitted.
        refitted: with parameters that make up for the step.
        exact: with the rig's own parameters and another integrator.
        plainer: the model as given, with its own parameters refitted, and with fewer effects.
        enough: error that fine steps allow.

    Returns:
        One that predicts no worse than the plainer ones, or as well as noise allows; where the step costs most, one
        that predicts hardly worse.
    """
    least = max(VERDICT.worse * min(option.error for option in plainer), SCORE.at_floor)
    for options in (physical[:1], physical, refitted):
        best = min(options, key=lambda option: option.error, default=None)
        if best is not None and best.error <= min(enough, least):
            return best
    best = min(physical, key=lambda option: option.error)
    if best.error <= least:
        return best
    for option in exact:
        if option.error <= min(enough, least):
            return option
    if best.error <= _allowed(enough, best.error, 1.0) * least:
        return best
    made_up = [option for option in refitted if option.error < VERDICT.made_up * least]
    return min([*physical, *made_up, *plainer], key=lambda option: option.error)


def _allowed(enough: float, error: float, usual: float = VERDICT.worse) -> float:
    """Times the error of another file that one may have: more where the step costs most of what a file comes to.

    Args:
        enough: error that fine steps allow.
        error: at the file's own step.
        usual: where the step costs less.
    """
    return VERDICT.coarse if enough < VERDICT.costs * error else usual


def written(
    timestep: float, partition: Partition, test: Problem, fits: tuple[Fit, Fit, Fit], last: Fit
) -> tuple[Option, AsWritten]:
    """Choose what is written, and judge it on windows that nothing was chosen by.

    Args:
        timestep: of the file, s.
        partition: windows to refit to, and to choose by.
        test: windows to judge by.
        fits: the model as given, recalibrated, and what was found.
        last: what was found, fitted to the windows to judge by as well; the same where it was not.
    """
    chosen_by = partition.validation if len(partition.validation.windows) else partition.comparison
    finely = Predictor(chosen_by, chosen_by), Predictor(test, test)
    validation, held_out = (predictor.at(timestep) for predictor in finely)
    nominal, recalibrated, final = fits
    plainer = [Option(one.structure, one.z, validation.error(one.structure, one.z)) for one in (nominal, recalibrated)]
    here, there = (predictor.error(final.structure, final.z) for predictor in finely)
    enough, told = (SCORE.at_floor * max(error, 1.0) for error in (here, there))
    as_found = Option(final.structure, final.z, validation.error(final.structure, final.z))
    physical, refitted, exact, fewer = [as_found], list[Option](), list[Option](), list[Option]()
    if as_found.error > enough:
        exact = [_exactly(as_found, validation)] if _integrator(final.structure) != EXACT else []
        physical += _in_other_forms(as_found, validation)
        some = evenly(len(partition.problem.windows), VERDICT.refit)
        fewer = _with_one_less(final, partition.problem.pick(some), some, validation)
        to_refit = replace(partition.problem.pick(some), stepping=Stepping(timestep), halved=None)
        best = min(physical, key=lambda option: option.error)
        # A form that predicts hardly better is no reason to refit it as well.
        for option in [as_found] if as_found.error <= VERDICT.worse * best.error else [best, as_found]:
            refitted += _made_up(option, to_refit, validation)
    taken = choose(physical, refitted, exact, [*plainer, *fewer], enough)
    errors = [held_out.error(one.structure, one.z) for one in (nominal, recalibrated, taken)]
    # What is said of the step is said by test data; which shorter one would do is chosen like all else.
    costs = taken.error > enough or errors[-1] > told
    said = AsWritten(
        timestep=timestep,
        integrator=_integrator(taken.structure),
        held_out=Errors(*errors),
        validation=Errors(*(option.error for option in (*plainer, taken))),
        fine=there,
        forms=dict(taken.forms),
        refitted=taken.refitted,
        exact=_integrator(taken.structure) != _integrator(final.structure),
        finer=_finer(taken, exact, validation, held_out, enough) if costs else None,
    )
    further = None if last is final else _to_the_end(taken, last)
    if further is None:
        return taken, said
    after, fine = (predictor.error(further.structure, further.z) for predictor in (held_out, finely[1]))
    if after <= _allowed(SCORE.at_floor * max(fine, 1.0), after) * errors[-1]:
        return further, replace(said, to_the_end=True)
    return taken, said


def _to_the_end(option: Option, last: Fit) -> Option | None:
    """An option with the parameters of a fit to more windows; None where it has other effects, or makes up for a
    step.
    """
    as_option = {term.key: term for term in option.structure.terms}
    if option.refitted or as_option.keys() != {term.key for term in last.structure.terms}:
        return None
    terms = tuple(term if term.effect.free else as_option[term.key] for term in last.structure.terms)
    structure = replace(last.structure, terms=terms, document=option.structure.document)
    return replace(option, structure=structure, z=carry(last.structure, last.z, structure))


def _with_one_less(found: Fit, problem: Problem, which: NDArray[np.intp], validation: Predictor) -> list[Option]:
    """A model without one of several effects, of those that take fine steps.

    A contact, or a stiff coupling, that is worth little may keep a file from predicting at all.

    Args:
        found: what was found, fitted to all windows.
        problem: some of these windows, in the steps of the diagnosis.
        which: of all.
        validation: windows to choose by.
    """
    options = list[Option]()
    for term in found.structure.terms:
        if len(found.structure.terms) < 2 or term.effect.finest == np.inf:
            continue
        structure = found.structure.without(term.key)
        begin = carry(found.structure, found.z, structure)
        with contextlib.suppress(mjcf.MjcfError, np.linalg.LinAlgError):
            z = fit(problem, structure, begin, found.initial[which], most=VERDICT.refit_steps).z
            options.append(Option(structure, z, validation.error(structure, z)))
    return options


def _in_other_forms(found: Option, validation: Predictor) -> list[Option]:
    """A model with each of its effects in turn in the form that predicts best beside those chosen before it."""
    options, best = list[Option](), found
    for k, term in enumerate(found.structure.terms):
        for structure, words in _forms(best, k):
            z = carry(best.structure, best.z, structure)
            after = validation.error(structure, z)
            options.append(Option(structure, z, after, forms=(*best.forms, (term.key, words))))
        best = min([best, *options], key=lambda option: option.error)
    return options


def _forms(option: Option, k: int) -> Iterator[tuple[Structure, str]]:
    """A structure with one of its effects in each of its other forms, and what that is written as."""
    structure, terms = option.structure, option.structure.terms
    values = structure.term_values(option.z, terms[k])
    for form in terms[k].effect.forms():
        term = Term(form, terms[k].at, values)
        yield replace(structure, terms=(*terms[:k], term, *terms[k + 1 :])), form.element


def _made_up(option: Option, problem: Problem, validation: Predictor) -> list[Option]:
    """A model with parameters that make up for the step, if it can be fitted there."""
    with contextlib.suppress(mjcf.MjcfError, np.linalg.LinAlgError):
        again = fit(problem, option.structure, option.z, most=VERDICT.refit_steps)
        after = validation.error(again.structure, again.z)
        return [replace(option, z=again.z, error=after, refitted=True)]
    return []


def _integrator(structure: Structure) -> str:
    """That a model's file asks for, as MJCF names it."""
    return structure.document.get_option("integrator")


def _exactly(option: Option, validation: Predictor) -> Option:
    """A model in the same steps of Runge-Kutta."""
    document = option.structure.document.copy()
    document.option(integrator=EXACT)
    structure = replace(option.structure, document=document)
    return replace(option, structure=structure, error=validation.error(structure, option.z))


def _finer(
    option: Option,
    tried: Sequence[Option],
    validation: Predictor,
    held_out: Predictor,
    enough: float,
) -> FinerSteps | None:
    """How a model would be simulated to predict validation data well enough; None if nothing that is tried does.

    Runge-Kutta at the same step costs as much as a quarter of it, and no script of the owner's has to count otherwise.
    Else it is the longest of a few shorter steps. Errors fall no faster than with the square of the step: what that
    foretells to be too coarse is not tried.

    Args:
        option: the model.
        tried: models in steps of Runge-Kutta.
        validation: windows to choose by.
        held_out: windows to judge by.
        enough: error that fine steps allow.
    """
    own, least = validation.own.stepping.timestep, 0.0
    if _integrator(option.structure) != EXACT and not option.refitted:
        exact = next((one for one in tried if one.z is option.z), None) or _exactly(option, validation)
        if exact.error <= enough:
            return FinerSteps(own, EXACT, held_out.error(exact.structure, exact.z))
    # Steps that are tried cost the more the shorter they are, and most of them do not do: the windows that are worst at
    # the model's own step tell that alone.
    before = validation.mse(option.structure, option.z)
    worst = np.argsort(-before)[: math.ceil(len(before) * VERDICT.worst)]
    for shorter in VERDICT.shorter:
        if shorter < least:
            continue
        predictor = validation.at(own / shorter)
        after = math.sqrt(float(np.sum(predictor.mse(option.structure, option.z, worst))) / len(before))
        if after <= enough:
            after = predictor.error(option.structure, option.z)
        if after <= enough:
            step = own / shorter
            return FinerSteps(step, _integrator(option.structure), held_out.at(step).error(option.structure, option.z))
        floor = enough / SCORE.at_floor
        least = shorter * math.sqrt((after - floor) / (enough - floor))
    return None
