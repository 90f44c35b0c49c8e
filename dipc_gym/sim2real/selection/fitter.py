"""Fits of structures to the windows of a partition: to a subset first, and to all if that is worth it."""

from __future__ import annotations

import math
import weakref
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf
from dipc_gym.sim2real.effects.shared.law import BENT
from dipc_gym.sim2real.estimation.fit import Fit, fit
from dipc_gym.sim2real.estimation.problem import Problem
from dipc_gym.sim2real.estimation.shooting import mean_loss
from dipc_gym.sim2real.model.structure import Structure, Term, carry, names
from dipc_gym.sim2real.selection.progress import Partition
from dipc_gym.sim2real.selection.score import compare
from dipc_gym.sim2real.selection.scorer import Scorer, earned
from dipc_gym.sim2real.selection.settings import SCORE, SEARCH
from dipc_gym.sim2real.side_by_side import side_by_side

Array = NDArray[np.float64]
T = TypeVar("T")

# A sketch: what it begins at, as text, what is free, steps and run-up, the windows, and whether it is a rival's.
_Asked = tuple[int, str, tuple[str, ...], tuple[float, float], bytes, bool]
# A full fit: what its sketch begins at, which fit that is and which it competes with, the windows, and what follows it.
_AskedFully = tuple[weakref.ref[Fit], weakref.ref[Fit] | None, str, tuple[str, ...], bytes, bytes, bool, str]


@dataclass(frozen=True)
class Fitter:
    """Fits structures.

    Attributes:
        scorer: compares them; its partition has the windows.
    """

    scorer: Scorer
    _kept: dict[tuple[frozenset[str], bytes], Fit] = field(default_factory=dict, repr=False)
    _begun: dict[_Asked, tuple[Fit, Fit | None]] = field(default_factory=dict, repr=False)
    _staying: list[tuple[Fit, Fit, bytes]] = field(default_factory=list, repr=False)
    _made: dict[_AskedFully, Fit | None] = field(default_factory=dict, repr=False)

    def over(self, partition: Partition) -> Fitter:
        """The same to other windows; full fits that were kept stay for when these windows come back."""
        if partition is self.partition:
            return self
        return Fitter(self.scorer.over(partition), self._kept, self._begun, self._staying, self._made)

    @property
    def partition(self) -> Partition:
        """Which windows serve for what."""
        return self.scorer.partition

    @property
    def problem(self) -> Problem:
        """The windows that are fitted."""
        return self.partition.problem

    @property
    def subset(self) -> NDArray[np.intp]:
        """Those of them that are sketched on."""
        return self.partition.subset

    def stays(self, fitted: Fit, begin: Fit) -> bool:
        """Whether these windows name no law of no kind in a fit, see `let_stay`."""
        here = self._all_windows()
        return any(fitted is one and begin is other and here == there for one, other, there in self._staying)

    def let_stay(self, fitted: Fit, begin: Fit) -> None:
        """Remember that all kinds were asked in the place of a fit's laws of no kind, and none does as well.

        Args:
            fitted: to these windows.
            begin: the fit without effects, against which what laws gain is counted.
        """
        self._staying.append((fitted, begin, self._all_windows()))

    def _all_windows(self) -> bytes:
        """Which windows are fitted, sketched and compared on."""
        return self._windows() + self.subset.tobytes() + self.partition.comparison.labels.tobytes()

    def slow(self, term: Term) -> bool:
        """Whether an effect has to be simulated in finer steps than the others."""
        return term.effect.finest < self.problem.stepping.timestep

    def sketch(self, base: Fit, structure: Structure, *, rival: bool = False) -> Fit | None:
        """Fit a structure to a subset of the windows, from the parameters of `base`; None where it cannot be
        simulated.

        Args:
            base: a fit to all windows.
            structure: to be fitted.
            rival: whether it is to predict as well as `base`: one that cannot come near is not fitted on.
        """
        z, initial = carry(base.structure, base.z, structure), base.initial[self.subset]
        # A search that begins anew lays the same hypotheses over the same fit without effects. What is written tells
        # two shapes of a law apart: both begin with the same parameters, at their guesses.
        free = tuple(slot.key for slot in structure.slots)
        steps, windows = (structure.finest, structure.warm), self._windows() + self.subset.tobytes()
        asked = (id(base), structure.write(z).text(), free, steps, windows, rival)
        for known in (asked, (*asked[:-1], False)):  # a rival's may be one that was given up
            if known in self._begun:
                return self._begun[known][1]
        try:
            hopeless = mean_loss(base.mse[self.subset], 1.0) + SEARCH.hopeless if rival else math.inf
            sketch = self._rough(structure, z, initial, hopeless)
            if _stuck(sketch, base, self.subset):
                sketch = min(sketch, self._rough(structure, _from_nothing(structure, z), initial, hopeless), key=_left)
        except (mjcf.MjcfError, np.linalg.LinAlgError):
            sketch = None
        self._keep({asked: (base, sketch and sketch.result())})
        return sketch

    def _keep(self, begun: dict[_Asked, tuple[Fit, Fit | None]]) -> None:
        """Keep sketches, dozens of each fit that they begin at: of that without effects, which a search comes back to,
        and of the latest one, over which a new phase lays the same laws of no kind.
        """
        latest = {id(base) for base, _ in begun.values() if base.structure.terms}
        if latest:
            gone = [k for k, (base, _) in self._begun.items() if base.structure.terms and id(base) not in latest]
            for asked in gone:
                del self._begun[asked]
        self._begun.update(begun)

    @contextmanager
    def side_by_side(self, tasks: Sequence[Callable[[], T]], bases: Sequence[Fit]) -> Iterator[Callable[[int], T]]:
        """Tasks that fit, on all cores, and how to get the result of each by its number; see `side_by_side`.

        Args:
            tasks: which change nothing but what this remembers.
            bases: fits that they begin at; what is in these is not copied.
        """
        structures = [base.structure for base in bases]
        shared: list[object] = [*bases, *structures]
        for structure in structures:
            effects = [term.effect for term in structure.terms]
            shared += [structure.document, structure.model, *structure.model_parameters, *effects]

        def remembering(task: Callable[[], T]) -> tuple[T, dict[_Asked, tuple[Fit, Fit | None]]]:
            before = set(self._begun)
            found = task()
            return found, {asked: self._begun[asked] for asked in self._begun if asked not in before}

        with side_by_side([partial(remembering, task) for task in tasks], self.problem.threads, shared) as result:

            def found(k: int) -> T:
                what, begun = result(k)
                self._keep(begun)
                return what

            yield found

    @contextmanager
    def sketched(self, asked: Sequence[tuple[Fit, Structure]]) -> Iterator[Callable[[int], Fit | None]]:
        """Sketches of several structures, each from the parameters of a fit, on all cores; see `sketch`."""

        def sketch(base: Fit, structure: Structure) -> Fit | None:
            made = self.sketch(base, structure)
            return made and made.result()

        with self.side_by_side([partial(sketch, *each) for each in asked], [base for base, _ in asked]) as result:
            yield result

    @contextmanager
    def fitted(
        self, asked: Sequence[tuple[Fit, Fit, Fit | None]], then: Callable[[Fitter, Fit], Fit] | None = None
    ) -> Iterator[Callable[[int], Fit | None]]:
        """Full fits, compared, on all cores; see `full`. What an earlier phase asked for beside the same fit is made
        once.

        Args:
            asked: base, sketch, and what each has to earn its place beside.
            then: what else is done with each fit: a function of a module, by whose name fits that are made are known.
        """

        def compared(base: Fit, sketch: Fit, current: Fit | None) -> tuple[Fit, Array] | None:
            made = self.full(base, sketch, current)
            if made is None:
                return None
            made = then(self, made) if then else made
            return made.result(), self.scorer.comparison_mse(made)

        name = then.__qualname__ if then else ""
        called = [self._asked_fully(*each, name) for each in asked]
        new = [k for k, one in enumerate(called) if one not in self._made]
        bases = [fit for k in new for fit in (asked[k][0], asked[k][2]) if fit is not None]
        with self.side_by_side([partial(compared, *asked[k]) for k in new], bases) as result:

            def fitted(k: int) -> Fit | None:
                if called[k] not in self._made:
                    found = result(new.index(k))
                    if found is not None:
                        self.scorer.know(*found)
                    self._made[called[k]] = found and found[0]
                return self._made[called[k]]

            yield fitted

    def _asked_fully(self, base: Fit, sketch: Fit, current: Fit | None, then: str) -> _AskedFully:
        structure, z = sketch.structure, sketch.z
        free, windows = tuple(slot.key for slot in structure.slots), self.problem.labels.tobytes() + self._all_windows()
        beside = None if current is None else weakref.ref(current)
        return weakref.ref(base), beside, structure.write(z).text(), free, z.tobytes(), windows, self.scorer.small, then

    def _rough(self, structure: Structure, z: Array, initial: Array, hopeless: float = math.inf) -> Fit:
        some = self.problem.pick(self.subset)
        return fit(some, structure, z, initial, most=SEARCH.sketch_steps, tolerance=SEARCH.rough, hopeless=hopeless)

    def full(self, base: Fit, sketch: Fit, current: Fit | None = None) -> Fit | None:
        """Fit all windows from where a sketch came to; None where it cannot be simulated.

        A sketch that had not converged and is not at the noise goes on first, on the subset: a step there costs a
        third, and on all windows a fit sticks where a gap or a contact is far from its place. None as well if it then
        does not earn its place beside `current` on the subset. A fit that comes near the noise goes on until nothing
        changes, and is begun anew if it stays above it: the last steps may be slow, and they decide the name.
        """
        try:
            subset = self.partition.known_to(sketch)
            if not sketch.converged and sketch.error > SCORE.at_floor:
                sketch = fit(
                    self.problem.pick(subset), sketch.structure, sketch.z, sketch.initial, most=SEARCH.onward_steps
                )
            if current is not None and not earned(sketch.mse, current.mse[subset], small=self.scorer.small):
                return None
            fitted = fit(self.problem, sketch.structure, sketch.z, base.initial, tolerance=SEARCH.rough)
            if SCORE.at_floor < fitted.error < SEARCH.in_reach:
                fitted = self.anew(
                    fit(self.problem, fitted.structure, fitted.z, fitted.initial, most=SEARCH.onward_steps)
                )
            return fitted
        except (mjcf.MjcfError, np.linalg.LinAlgError):
            return None

    def anew(self, fitted: Fit) -> Fit:
        """A fit of several effects, or what comes of their first guesses and nominal parameters if that predicts
        better.

        An effect may be stuck at parameters that made up for another one while that was missing.
        """
        structure = fitted.structure
        if fitted.error <= SCORE.at_floor or len(structure.terms) < 2:
            return fitted
        sketch = fit(self.problem.pick(self.subset), structure, most=SEARCH.anew_steps)
        gained = compare(sketch.mse, fitted.mse[self.subset], self.problem.blocks[self.subset])
        if gained.gain < SCORE.worth:
            return fitted
        again = fit(self.problem, structure, sketch.z)
        return min(fitted, again, key=lambda one: mean_loss(one.mse, 1.0))

    def near(self, current: Fit, structure: Structure) -> Fit | None:
        """A full fit of a structure, unless its sketch tells that it is far from predicting as `current` does."""
        sketch = self.sketch(current, structure)
        return None if sketch is None or self.behind(sketch, current) else self.full(current, sketch)

    def behind(self, sketch: Fit, fitted: Fit) -> bool:
        """Whether a sketch is so much worse than a full fit that fitting on would not bring it close."""
        subset = self.partition.known_to(sketch)
        return compare(fitted.mse[subset], sketch.mse, self.problem.blocks[subset]).gain > SCORE.large

    def polish(self, fitted: Fit) -> Fit:
        """Fit on until nothing changes."""
        if fitted.converged and fitted.whole:
            return fitted
        return fit(
            self.problem,
            fitted.structure,
            fitted.z,
            fitted.initial,
            most=0 if fitted.converged else SEARCH.polish_steps,
        )

    def whole(self, fitted: Fit) -> Fit:
        """The same fit with its residuals and Jacobians, see `Fit.result`."""
        if fitted.whole:
            return fitted
        again = fit(self.problem, fitted.structure, fitted.z, fitted.initial, most=0)
        return replace(again, steps=fitted.steps, converged=fitted.converged)

    def as_it_is(self, current: Fit, structure: Structure) -> Fit:
        """A structure with the parameters of a fit, which is not fitted on; what the fit lacks is at its guess."""
        return fit(self.problem, structure, carry(current.structure, current.z, structure), current.initial, most=0)

    def without(self, current: Fit, *keys: str, hopeless: float = math.inf) -> Fit:
        """Refit with one effect less, and so on, from the parameters that it has now: the fit before may have been
        stuck.

        Args:
            current: a fit.
            keys: of the effects.
            hopeless: mean log square error, by which a fit that stays behind is not carried on.
        """
        for key in keys:
            structure, limit = current.structure.without(key), _left(current) + hopeless
            z = carry(current.structure, current.z, structure)
            current = fit(self.problem, structure, z, current.initial, hopeless=limit)
        return current

    def roughly_without(self, current: Fit, key: str) -> Fit:
        """A sketch with one effect less: enough to tell how much is lost without it."""
        structure = current.structure.without(key)
        return self._rough(structure, carry(current.structure, current.z, structure), current.initial[self.subset])

    def remember(self, fitted: Fit) -> None:
        """Keep a full fit, so that it need not be made again while the windows are the same."""
        self._kept[self._called(fitted.structure)] = fitted.result()

    def remembered(self, structure: Structure) -> Fit | None:
        """The fit of a structure to these windows, if one was kept."""
        return self._kept.get(self._called(structure))

    def _called(self, structure: Structure) -> tuple[frozenset[str], bytes]:
        return frozenset(names(structure.terms)), self._windows()

    def _windows(self) -> bytes:
        """What tells the fitted windows from others."""
        windows = self.problem.windows
        return windows.source.tobytes() + windows.start.tobytes()


def _left(fitted: Fit) -> float:
    return mean_loss(fitted.mse, 1.0)


def _stuck(sketch: Fit, base: Fit, subset: NDArray[np.intp]) -> bool:
    """Whether a law predicts worse than nothing: its first shape was so far off that a few steps did not mend it."""
    effect = sketch.structure.newest.effect
    return effect.free and bool(effect.linear) and _left(sketch) > mean_loss(base.mse[subset], 1.0)


def _from_nothing(structure: Structure, z: Array) -> Array:
    """Mapped parameters with those of the last effect that it grows by at zero, but for what gives ramps a slope to fit
    by.
    """
    begin, term = z.copy(), structure.newest
    grown = {f"{term.key}.{name}" for name in term.effect.linear}
    zero = [i for i, slot in enumerate(structure.slots) if slot.key in grown and slot.may_vanish]
    for count, i in enumerate(zero):
        begin[i] = structure.slots[i].mapped(0.0) + BENT * (count % 2)
    return begin
