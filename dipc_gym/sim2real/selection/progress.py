"""Where a search stands: which windows serve for what, the fits that it accepted, and what it tried."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dipc_gym.sim2real.estimation.fit import Fit, fit
from dipc_gym.sim2real.estimation.problem import Problem
from dipc_gym.sim2real.estimation.steps import controlled
from dipc_gym.sim2real.selection import beginnings, ranking
from dipc_gym.sim2real.selection.screen import Tried

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Partition:
    """Which windows serve for what.

    Attributes:
        problem: windows to fit.
        comparison: windows to compare on, between those.
        aside: windows left aside; `events.attend` takes in those that matter later.
        first: at the beginnings of recordings that begin at rest, which only laws of the past are fitted to.
        borders: times in each recording from which windows that are left aside validate what a search comes to, s.
        subset: the windows of `problem` that are sketched on; what stands out later comes at the end, and older
            sketches know only those before.
    """

    problem: Problem
    comparison: Problem
    aside: Problem
    first: Problem
    borders: Array
    subset: NDArray[np.intp]

    @property
    def validation(self) -> Problem:
        """Windows later than all that are fitted or compared on, without those in which something happened once, which
        are fitted.

        Where recordings are too short to hold any, the windows compared on.
        """
        windows = self.aside.windows
        late = windows.start >= self.borders[windows.source]
        return self.aside.pick(late) if late.any() else self.comparison

    @property
    def blocks(self) -> NDArray[np.intp]:
        """Of the fitted windows, then of the comparison windows; windows of both within one second share a block."""
        return self.problem.join(self.comparison).blocks

    def known_to(self, sketch: Fit) -> NDArray[np.intp]:
        """The windows that a sketch was fitted to."""
        return self.subset[: len(sketch.mse)]

    def controlled(self, fitted: Fit) -> Partition:
        """The same windows in steps as fine as a fit asks for, see `steps.controlled`; this one if none are finer."""
        parts = self.problem, self.comparison, self.aside, self.first
        finer = [controlled(part, fitted.structure, fitted.z) for part in parts]
        if all(new is old for new, old in zip(finer, parts, strict=True)):
            return self
        problem, comparison, aside, first = finer
        return replace(self, problem=problem, comparison=comparison, aside=aside, first=first)

    @property
    def spare(self) -> NDArray[np.bool_]:
        """Which of the windows left aside do not validate."""
        windows = self.aside.windows
        return np.asarray(windows.start < self.borders[windows.source])

    def whole(self, fitted: Fit) -> Partition:
        """All windows that a model may be fitted to; those compared on, and those that validate, among them."""
        problem = self.problem.join(self.comparison).join(self.aside)
        if beginnings.have_a_law(fitted) and beginnings.foretold(fitted):
            problem = problem.join(self.first)
        return replace(self, problem=problem)

    def to_the_end(self, end: Problem) -> Partition:
        """The windows at the ends of recordings fitted as well; see `Searched.to_the_end`."""
        problem, kept = self.problem, end.windows
        windows = replace(problem.windows, recordings=kept.recordings, motions=kept.motions)
        return replace(self, problem=replace(problem, windows=windows).join(end))


@dataclass(frozen=True)
class Progress:
    """How far a search has come.

    Attributes:
        partition: which windows serve for what.
        path: the fits that were accepted one after another, the first without effects.
        anchor: the model with its parameters free but at their nominal values. Refitted without an effect that
            matters they can be far off, and an effect tried on top of such parameters looks worse than it is.
        rounds: hypotheses of each round, the best first.
    """

    partition: Partition
    path: tuple[Fit, ...]
    anchor: Fit | None = None
    rounds: tuple[Sequence[Tried], ...] = ()

    @property
    def current(self) -> Fit:
        """The fit that was accepted last."""
        return self.path[-1]

    def taking_in(self, new: Problem) -> Progress:
        """With some more windows to fit; the fits that are kept are evaluated on them as well."""
        if not len(new.windows):
            return self

        def informed(fitted: Fit) -> Fit:
            there = fit(new, fitted.structure, fitted.z, most=0)
            return fitted.join(there if fitted.whole else there.result())

        return replace(
            self,
            partition=replace(self.partition, problem=self.partition.problem.join(new)),
            path=tuple(informed(fitted) for fitted in self.path),
            anchor=self.anchor and informed(self.anchor),
            rounds=tuple(
                [replace(tried, fitted=tried.fitted and informed(tried.fitted)) for tried in hypotheses]
                for hypotheses in self.rounds
            ),
        )

    def informed(self, path: Sequence[Fit]) -> tuple[Fit, ...]:
        """Fits that were accepted before, on the present windows and in their steps: some may have come, or gone."""
        problem = self.partition.problem
        return tuple(one if one.of(problem) else fit(problem, one.structure, one.z, most=0) for one in path)

    def with_spare(self) -> Progress:
        """With all windows to fit that neither compare nor validate: a table of dozens of values needs them."""
        spare, aside = self.partition.spare, self.partition.aside
        left = replace(self, partition=replace(self.partition, aside=aside.pick(~spare)))
        return left.taking_in(aside.pick(spare))

    def with_first(self) -> Progress:
        """With the windows at the beginnings of recordings to fit."""
        first = self.partition.first
        none = first.pick(np.zeros(0, dtype=np.intp))
        return replace(self, partition=replace(self.partition, first=none)).taking_in(first)

    def keeping(self, keep: NDArray[np.bool_]) -> Progress:
        """With some of the windows only, of the fitted and then of the comparison windows."""
        if keep.all():
            return self
        old, count = self.partition, len(self.partition.problem.windows)
        which, subset = np.flatnonzero(keep[:count]), np.flatnonzero(keep[old.subset])
        return Progress(
            replace(
                old,
                problem=old.problem.pick(which),
                comparison=old.comparison.pick(keep[count:]),
                subset=np.searchsorted(which, old.subset[subset]),
            ),
            tuple(fitted.pick(which) for fitted in self.path),
            self.anchor and self.anchor.pick(which),
            tuple([tried.pick(which, subset) for tried in hypotheses] for hypotheses in self.rounds),
        )


@dataclass
class Journal:
    """Where a search stands, written down as it goes on: Ctrl-C or a failure may end it at any moment.

    Attributes:
        progress: how far it has come.
        tell: called with a line about progress.
    """

    progress: Progress
    tell: Callable[[str], None] = lambda line: None

    def go_back(self, path: tuple[Fit, ...]) -> None:
        """Go on from fits that were accepted before; what was tried since then stays known."""
        self.progress = replace(self.progress, path=self.progress.informed(path))

    def begin(self, tried: Sequence[Tried]) -> None:
        """Note the hypotheses of a new round; of earlier rounds only the results are kept."""
        before = [[one.result() for one in earlier] for earlier in self.progress.rounds]
        self.progress = replace(self.progress, rounds=(*before, tried))

    def update(self, news: Sequence[Tried]) -> None:
        """Note what became of some of them."""
        *before, last = self.progress.rounds
        self.progress = replace(self.progress, rounds=(*before, ranking.updated(last, news)))

    def together(self, news: Sequence[Tried]) -> None:
        """Note what became of several that were accepted together, as another round."""
        self.begin(ranking.updated(self.progress.rounds[-1], news))

    def accept(self, fitted: Fit) -> None:
        """Note a fit that was accepted."""
        self.progress = replace(self.progress, path=(*self.progress.path, fitted))

    def correct(self, fitted: Fit) -> None:
        """Note a fit in the place of the one that was accepted last."""
        self.progress = replace(self.progress, path=(*self.progress.path[:-1], fitted))
