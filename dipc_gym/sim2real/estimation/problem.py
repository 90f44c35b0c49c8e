"""Windows to predict, and what a structure predicts for them, in units of noise."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym.engine import Uncovered
from dipc_gym.engine.program import parameters_of, read
from dipc_gym.physics import Physics
from dipc_gym.sim2real.estimation.settings import ESTIMATION
from dipc_gym.sim2real.estimation.slopes import Near, Slopes, maps_of, with_maps
from dipc_gym.sim2real.model.structure import Structure
from dipc_gym.sim2real.side_by_side import cores
from dipc_gym.sim2real.simulation.batch import Stepping, grid_step, simulate
from dipc_gym.sim2real.simulation.compiled import Compiled, begins_alike, changes, compiled, derivatives
from dipc_gym.sim2real.simulation.memory import behind
from dipc_gym.sim2real.simulation.windows import Windows

Array = NDArray[np.float64]

_RK4 = mujoco.mjtIntegrator.mjINT_RK4


@dataclass(frozen=True)
class Problem:
    """Windows to predict, and what is known of their initial states.

    Attributes:
        windows: what to predict.
        initial: estimated positions and velocities at each window's start, (n, 2 nb).
        spread: standard deviation of the estimated initial states, (2 nb,).
        stepping: of the simulation.
        threads: 0 for all cores.
        halved: how often the steps of each window are halved beyond what structures need, (n,); None is never.
    """

    windows: Windows
    initial: Array
    spread: Array
    stepping: Stepping
    threads: int = 0
    halved: NDArray[np.intp] | None = None

    def pick(self, which: NDArray[np.intp] | NDArray[np.bool_]) -> Problem:
        """Some of the windows."""
        halved = None if self.halved is None else self.halved[which]
        return replace(self, windows=self.windows.pick(which), initial=self.initial[which], halved=halved)

    def join(self, other: Problem) -> Problem:
        """These windows and others of the same recordings."""
        plain = self.halved is None and other.halved is None
        return replace(
            self,
            windows=self.windows.join(other.windows),
            initial=np.append(self.initial, other.initial, 0),
            halved=None if plain else np.append(self.halvings, other.halvings),
        )

    def halved_by(self, times: int | NDArray[np.intp]) -> Problem:
        """The same windows in steps halved so often, all alike or each for itself, (n,)."""
        return replace(self, halved=self.halvings + times)

    @property
    def halvings(self) -> NDArray[np.intp]:
        """How often the steps of each window are halved, (n,)."""
        return np.zeros(len(self.windows), dtype=np.intp) if self.halved is None else self.halved

    @property
    def labels(self) -> Array:
        """What tells windows, and the steps that they take, from others: recording, start and halvings, (n, 3)."""
        return np.column_stack([self.windows.source, self.windows.start, self.halvings])

    def by_step(self) -> list[tuple[NDArray[np.intp], Problem, int]]:
        """The windows of each length of step: which, these alone, and how often it is halved."""
        if self.halved is None:
            return [(np.arange(len(self.windows)), self, 0)]
        each = [(np.flatnonzero(self.halved == times), int(times)) for times in np.unique(self.halved)]
        return [(which, self if len(each) == 1 else self.pick(which), times) for which, times in each]

    @property
    def counts(self) -> Array:
        """Readings in each window, (n,); sensors that never change say nothing and do not count."""
        return self.windows.valid.sum(axis=1) * float(np.isfinite(self.windows.noise).sum())

    @property
    def moved(self) -> Array:
        """How far readings moved since the window began, in units of noise, 0 where nothing was read, (n, m, ns)."""
        w = self.windows
        return np.where(w.valid[..., None], (w.observed - w.observed[:, :1]) / w.noise, 0.0)

    @functools.cached_property
    def motion(self) -> float:
        """Root mean square of how far readings move within a window, in units of noise."""
        return float(np.sqrt(np.sum(self.moved**2) / self.counts.sum()))

    @property
    def blocks(self) -> NDArray[np.intp]:
        """A number for each window; windows within a second of one recording share it."""
        second = np.floor(self.windows.start / ESTIMATION.block).astype(np.intp)
        _, block = np.unique(np.stack([self.windows.source, second], axis=1), axis=0, return_inverse=True)
        return block.ravel()


def predict(problem: Problem, structure: Structure, Z: Sequence[Array], initial: Array) -> Array:
    """Readings (variants, n, m, ns) of a structure under several sets of parameters."""
    variants = [structure.physics(z) for z in Z]
    return predict_with(problem, structure, variants, initial)


def predict_with(
    problem: Problem, structure: Structure, variants: Sequence[Physics], initial: Array, *, as_read: bool = True
) -> Array:
    """Readings (variants, n, m, ns) of models that have this structure; for `as_read` see `batch.simulate`."""
    warm, found = structure.warm, list[Array]()
    for which, part, halved in problem.by_step():
        windows = part.windows
        found.append(
            simulate(
                variants,
                windows,
                initial if part is problem else initial[:, which],
                _stepping(problem.stepping, structure, halved),
                base=structure.base,
                warm=warm,
                approach=_approach(windows, warm, variants[0], structure.base),
                threads=cores(problem.threads),
                as_read=as_read,
            )
        )
    return _in_order(problem, found)


def sensitivities(
    problem: Problem, structure: Structure, z: Array, probes: Sequence[Array], initial: Array
) -> tuple[Array, Array, Array] | None:
    """What a structure predicts, and how that changes with its parameters and its initial states.

    Args:
        problem: windows to predict.
        structure: of the model.
        z: its mapped parameters, (p,).
        probes: for each parameter all of them, that one a little larger or smaller; how a model's parameters follow
            from them is a smooth map, for which a difference will do.
        initial: (n, 2 nb).

    Returns:
        Readings (n, m, ns) of the engine, whatever the problem's integrator, their change per unit of each parameter
        (p, n, m, ns), and per unit of each initial state (2 nb, n, m, ns); None where the engine does not simulate
        the model or its change.
    """
    warm, found = structure.warm, list[tuple[Array, Array, Array]]()
    steps = np.array([probe[i] - z[i] for i, probe in enumerate(probes)])
    try:
        for which, part, halved in problem.by_step():
            windows = part.windows
            step = grid_step(windows, _stepping(replace(problem.stepping, integrator=_RK4), structure, halved))
            of, change, apart = _with_changes(structure, z, probes, steps, windows, step)
            here = initial if part is problem else initial[which]
            approach = _approach(windows, warm, of.variants[0], structure.base)
            found.append(derivatives(of, change, steps, apart, here, warm, approach, cores(problem.threads)))
    except Uncovered:
        return None
    readings, *changes = zip(*found, strict=True)
    by_parameter, by_state = (_in_order(problem, each) for each in changes)
    return _in_order(problem, [each[None] for each in readings])[0], by_parameter, by_state


def _approach(windows: Windows, warm: float, variant: Physics, base: Sequence[str]) -> Array | None:
    """Positions and velocities of the base joints where each stretch of the `warm` seconds before windows begins, (k,
    n, 2 nb), which are told later where a variant's sensors lag.
    """
    if not warm:
        return None
    before = np.linspace(warm, 0.0, math.ceil(warm / ESTIMATION.stretch - 1e-9), endpoint=False)
    return np.stack([windows.begun(one, [behind(variant, windows, joint) for joint in base]) for one in before])


def _in_order(problem: Problem, parts: Sequence[Array]) -> Array:
    """Arrays (k, windows of one length of step, ...) as one, in the order of a problem's windows, (k, n, ...)."""
    if len(parts) == 1:
        return parts[0]
    out = np.empty((len(parts[0]), len(problem.windows), *parts[0].shape[2:]))
    for (which, _, _), part in zip(problem.by_step(), parts, strict=True):
        out[:, which] = part
    return out


def _with_changes(
    structure: Structure, z: Array, probes: Sequence[Array], steps: Array, windows: Windows, step: float
) -> tuple[Compiled, Array, NDArray[np.intp]]:
    """What the engine simulates at z, and at probes that change more than its parameters; how these change with z, (p,
    k); and the variant of each probe, 0 for those left out, (p,).

    Args:
        structure: of the model.
        z: its mapped parameters, (p,).
        probes: as `sensitivities` takes them.
        steps: how far each is from z, (p,).
        windows: to simulate.
        step: in which they are, s.
    """
    here, values, count = structure.physics(z), structure.all_values(z), len(probes)
    maps = maps_of(here)
    apart = [structure.all_values(probe) - values for probe in probes]
    by_step = np.array([moved[i] / steps[i] for i, moved in enumerate(apart)])
    alone = count > 0 and all(np.count_nonzero(moved) == 1 and moved[i] for i, moved in enumerate(apart))

    def made(variants: Sequence[Physics]) -> Compiled:
        return compiled((here, *variants), windows, structure.base, step)

    known, held = None, np.zeros(count, dtype=bool)
    if alone:
        known, held = _known(structure, here, z, steps, lambda one: bool(begins_alike(made([one])).all()))
    asked = np.flatnonzero(~held)
    of = made([structure.physics(probes[int(i)]) for i in asked])
    of_maps = np.array([maps_of(variant) - maps for variant in of.variants[1:]]).reshape(len(asked), len(maps))
    change = np.append(changes(of, steps[asked]), of_maps / steps[asked, None], axis=1)
    if known is not None:
        found, change = change, by_step[:, None] * known.by_value
        change[asked] = found
    before = structure.worked_out.get(Slopes)
    if alone and (len(asked) or known is not before):
        there, alike = np.append(of.parameters[0], maps), held.copy()
        if known is not None and known is before:
            alike = known.alike
        else:
            alike[asked] = begins_alike(of)[1:]
        structure.worked_out[Slopes] = Slopes(
            of.program, values, there, change / by_step[:, None], by_step * steps, structure.tables, alike
        )
    own = of.parameters.shape[1]
    mapped = np.flatnonzero(held & change[:, own:].any(axis=1))
    which = np.zeros(count, dtype=np.intp)
    which[asked], which[mapped] = 1 + np.arange(len(asked)), 1 + len(asked) + np.arange(len(mapped))
    others = [with_maps(here, maps + change[i, own:] * steps[i]) for i in mapped]
    beside = np.repeat(of.parameters[:1], len(mapped), axis=0)
    of = replace(of, variants=(*of.variants, *others), parameters=np.append(of.parameters, beside, axis=0))
    return of, change[:, :own], which


def _known(
    structure: Structure, here: Physics, z: Array, steps: Array, alike: Callable[[Physics], bool]
) -> tuple[Slopes | None, NDArray[np.bool_]]:
    """Slopes that were found before, or that tables tell at once; and which of them hold at z, (p,).

    Args:
        structure: of the model.
        here: the model at z.
        z: mapped parameters, (p,).
        steps: of these that are small, (p,).
        alike: whether simulations of a model begin at the same states as here.
    """
    known, maps = structure.worked_out.get(Slopes), maps_of(here)
    if isinstance(known, Slopes):
        parameters = parameters_of(known.program, here)
        if parameters is None:
            return None, np.zeros(len(z), dtype=bool)
        near = Near(structure, known.program, z, steps, np.append(parameters, maps))
        held, sure = known.told(structure.all_values(z), near.parameters)
        return known, held & (sure or near.confirms(known, held))
    what, (parameters, *_) = read([here])
    return Near(structure, what, z, steps, np.append(parameters, maps)).in_groups(alike)


def normalised_residual(problem: Problem, readings: Array) -> Array:
    """(observed - readings) / noise, zero where nothing was observed."""
    scaled = (problem.windows.observed - readings) / problem.windows.noise
    scaled = np.nan_to_num(np.clip(scaled, -ESTIMATION.blown_up, ESTIMATION.blown_up), nan=ESTIMATION.blown_up)
    return np.where(problem.windows.valid[..., None], scaled, 0.0)


def _stepping(given: Stepping, structure: Structure, halved: int) -> Stepping:
    """As fine as the structure needs; a model that is to be simulated as it is keeps its own step."""
    finest = math.inf if given.integrator is None else min(structure.finest, structure.own_finest)
    return replace(given, timestep=min(given.timestep, finest) / 2**halved)
