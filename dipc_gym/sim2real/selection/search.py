"""Find the effects that a model lacks, one or two at a time, by what they do to predictions of windows not fitted.

Screening costs one simulation a hypothesis: its response at a first guess, laid over the residual beside everything
that is free already. The best few are sketched, that is fitted to a third of the windows, and those that keep up are
fitted fully. Two at a time are tried where together their predicted gain is far above that of any one, or where no
single one stands out. What decides is the error of other windows than those that were fitted, as a mean of
logarithms, so that each window counts alike and its standard error means something.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf
from dipc_gym.sim2real.effects.base import LEAVES, Effect, dof
from dipc_gym.sim2real.estimation.fit import Fit, evaluate, fit
from dipc_gym.sim2real.estimation.problem import Problem
from dipc_gym.sim2real.estimation.shooting import common_error, mean_loss
from dipc_gym.sim2real.estimation.unexplained import Scene, places
from dipc_gym.sim2real.model.structure import Structure, Term, carry, names
from dipc_gym.sim2real.selection import data, groups, pairs, ranking, screen
from dipc_gym.sim2real.selection.events import attend, quiet
from dipc_gym.sim2real.selection.prune import prune
from dipc_gym.sim2real.selection.score import Improvement, compare
from dipc_gym.sim2real.selection.screen import Tried, excludes
from dipc_gym.sim2real.selection.settings import SCORE, SEARCH

Array = NDArray[np.float64]


@dataclass
class Search:
    """One diagnosis in progress.

    Attributes:
        problem: windows to fit.
        comparison: windows to compare on, between those.
        aside: windows left aside; `attend` takes in those that matter later.
        late: times in each recording from which windows that are left aside validate what the search comes to, s.
        effects: the catalogue.
        joints: base joints.
        look: gives the evidence for a fit, and with it the times, s, at which outlier windows begin.
        rounds: hypotheses of each round, the best first.
        small: whether the mismatch is so small and shapeless that only what explains all of it counts.
        anchor: the model with its parameters free but at their nominal values. Refitted without an effect that
            matters they can be far off, and an effect tried on top of such parameters looks worse than it is.
        tell: called with a line about progress.
        subset: the windows of `problem` that are sketched on; what stands out later comes at the end, and older
            sketches know only those before.
        interrupted: whether Ctrl-C ended the search.
        shapes: whether laws of any shape are asked as well: where no formula comes down to the noise.
        last: whether laws of no kind are asked, and nothing else: where no law of a kind comes down to the noise.
        path: the fits that were accepted one after another, the first without effects.
        screened: hypotheses of the last round, by what they were laid over and how much worse that is than the
            present fit.
    """

    problem: Problem
    comparison: Problem
    aside: Problem
    late: Array
    effects: Sequence[Effect]
    joints: tuple[str, ...]
    look: Callable[..., Scene]
    small: bool = False
    anchor: Fit | None = None
    tell: Callable[[str], None] = lambda line: None
    subset: NDArray[np.intp] = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    rounds: list[list[Tried]] = field(default_factory=list)
    interrupted: bool = False
    shapes: bool = False
    last: bool = False
    path: list[Fit] = field(default_factory=list)
    screened: list[tuple[Fit, float, list[Tried]]] = field(default_factory=list)
    _known: dict[int, tuple[Fit, Array]] = field(default_factory=dict)
    _fits: dict[tuple[frozenset[str], bytes], Fit] = field(default_factory=dict)

    @property
    def validation(self) -> Problem:
        """Windows later than all that are fitted or compared on, but for those in which something odd happened once.

        Of recordings too short to hold any, the windows compared on.
        """
        windows = self.aside.windows
        late = windows.start >= self.late[windows.source]
        return self.aside.pick(late) if late.any() else self.comparison

    def compare_on(self, comparison: Problem) -> None:
        """Compare on other windows from here on, or on the same in other steps."""
        self.comparison = comparison
        self._known.clear()

    def comparison_mse(self, fitted: Fit) -> Array:
        """Mean square error of each comparison window, in units of noise, (n,)."""
        if id(fitted) not in self._known:
            mse, _ = evaluate(self.comparison, fitted.structure, fitted.z)
            self._known[id(fitted)] = (fitted, mse)
        return self._known[id(fitted)][1]

    def mse(self, fitted: Fit) -> Array:
        """Mean square errors of the fitted windows, then of the comparison windows."""
        return np.append(fitted.mse, self.comparison_mse(fitted))

    def compare(self, new: Fit, old: Fit) -> Improvement:
        """How much better `new` predicts than `old`, over fitted and comparison windows together.

        There are far fewer parameters than windows, so what fitting flatters is little; three times as many windows
        tell more. `confirmed` asks the comparison windows alone.
        """
        return compare(self.mse(new), self.mse(old), self._blocks)

    @property
    def _blocks(self) -> NDArray[np.intp]:
        """Of the fitted windows, then of the comparison windows; windows of both within one second share a block."""
        return self.problem.join(self.comparison).blocks

    def confirmed(self, new: Fit, old: Fit) -> bool:
        """Whether the comparison windows alone are better predicted too."""
        return (
            compare(self.comparison_mse(new), self.comparison_mse(old), self.comparison.blocks).gain > SCORE.worth / 2
        )

    # -------------------------------------------------------------------------------------------- one round

    def hypotheses(self, current: Fit, scene: Scene) -> list[Term]:
        """Every effect at every place it can act, with first guesses; what happens once only where all is quiet."""
        friction = {joint: float(scene.model.dof_frictionloss[dof(scene.model, joint)]) for joint in self.joints}
        levels = {joint: level for joint, level in friction.items() if level > 0}
        terms, found = current.structure.terms, []
        for effect in self.effects:
            if (effect.once and not quiet(current)) or (effect.free and not self.shapes):
                continue
            if effect.of_no_kind != self.last:
                continue
            for at in places(effect, current.structure.model, self.joints, scene.recordings[0]):
                if any(t.at == at and (t.effect.id == effect.id or excludes(t.effect, effect)) for t in terms):
                    continue
                evidence = scene.at(effect.place, at, levels)
                plain = self._plain(current, effect, at)
                found += [Term(shaped, at, {**guess, **plain}) for shaped, guess in effect.proposals(evidence)]
        return found

    @staticmethod
    def _plain(current: Fit, effect: Effect, at: str) -> dict[str, float]:
        """Parameters that an effect shares with plainer ones that are there and that it would replace."""
        shared: dict[str, float] = {}
        for term in current.structure.terms:
            if term.at == at and term.effect.id in effect.contains:
                values = current.structure.term_values(current.z, term)
                shared |= {p.name: values[p.name] for p in effect.parameters if p.name in values}
        return shared

    def sketch(self, base: Fit, structure: Structure) -> Fit | None:
        """Fit a structure to a subset of the windows, from the parameters of `base`; None where it cannot be
        simulated.
        """
        z = carry(base.structure, base.z, structure)
        try:
            return fit(
                self.problem.pick(self.subset), structure, z, base.initial[self.subset], most=5, tolerance=SEARCH.rough
            )
        except (mjcf.MjcfError, np.linalg.LinAlgError):
            return None

    def full(self, base: Fit, sketch: Fit, current: Fit | None = None) -> Fit | None:
        """Fit all windows from where a sketch came to; None where it cannot be simulated.

        A sketch that was still on its way, and not at the noise, goes on first: a step on a subset costs a third,
        and on all of them a gap or a contact far from its place holds a fit fast. None as well where it then does not
        earn its place beside `current` even on the subset. What comes near the noise goes on until nothing
        changes, and is begun anew where it stays there: the last stretch may be a long valley, at whose end a name is
        decided, or a wrong one.
        """
        try:
            subset = self.known_to(sketch)
            if not sketch.converged and sketch.error > SCORE.at_floor:
                sketch = fit(self.problem.pick(subset), sketch.structure, sketch.z, sketch.initial, most=15)
            if current is not None and not self._earned(sketch.mse, current.mse[subset]):
                return None
            fitted = fit(self.problem, sketch.structure, sketch.z, base.initial, most=8, tolerance=SEARCH.rough)
            if SCORE.at_floor < fitted.error < SEARCH.in_reach:
                fitted = self._anew(fit(self.problem, fitted.structure, fitted.z, fitted.initial, most=15))
            return fitted
        except (mjcf.MjcfError, np.linalg.LinAlgError):
            return None

    def _anew(self, fitted: Fit) -> Fit:
        """A fit of several effects, or what comes of their first guesses and nominal parameters if that predicts
        better.

        What an effect took on while another was missing may hold it fast where it is.
        """
        structure = fitted.structure
        if fitted.error <= SCORE.at_floor or len(structure.terms) < 2:
            return fitted
        sketch = fit(self.problem.pick(self.subset), structure, most=SEARCH.most_anew)
        if compare(sketch.mse, fitted.mse[self.subset], self.problem.blocks[self.subset]).gain < SCORE.worth:
            return fitted
        again = fit(self.problem, structure, sketch.z, most=8)
        return min(fitted, again, key=lambda one: mean_loss(one.mse, 1.0))

    def behind(self, sketch: Fit, fitted: Fit) -> bool:
        """Whether a sketch is so much worse than a full fit that fitting on would not bring it close."""
        subset = self.known_to(sketch)
        return compare(fitted.mse[subset], sketch.mse, self.problem.blocks[subset]).gain > SCORE.large

    def known_to(self, sketch: Fit) -> NDArray[np.intp]:
        """The windows that a sketch was fitted to."""
        return self.subset[: len(sketch.mse)]

    def near(self, current: Fit, structure: Structure) -> Fit | None:
        """A full fit of a structure, unless its sketch tells that it is far from predicting as `current` does."""
        sketch = self.sketch(current, structure)
        return None if sketch is None or self.behind(sketch, current) else self.full(current, sketch)

    def remember(self, fitted: Fit) -> None:
        """Keep a full fit, so that it need not be made again while the windows are the same."""
        self._fits[self._called(fitted.structure)] = fitted

    def remembered(self, structure: Structure) -> Fit | None:
        """The fit of a structure to these windows, if one was kept."""
        return self._fits.get(self._called(structure))

    def _called(self, structure: Structure) -> tuple[frozenset[str], bytes]:
        windows = self.problem.windows
        return frozenset(names(structure.terms)), windows.source.tobytes() + windows.start.tobytes()

    def round(self, current: Fit) -> Fit | None:
        """Try every hypothesis on top of `current`; the best fit if it is clearly better, else None."""
        by_key = self._by_key(current)
        ranked = sorted(
            (max(tries, key=ranking.predicted_gain) for tries in by_key.values()),
            key=ranking.predicted_gain,
            reverse=True,
        )
        most = ranking.predicted_gain(ranked[0]) if ranked else 0.0
        sketched = self._in_turn(ranked, by_key, current)
        self.rounds.append(ranking.updated([tried for tried, _ in ranked], [tried for tried, _ in sketched]))
        if len(self.joints) > 1 and not _at_noise(sketched):
            together = groups.best(self, ranked, [one.sketch for one, _ in sketched if one.sketch], current)
            if together is not None:
                return together
        both_gain = [] if _at_noise(sketched) or current.error < SCORE.at_floor else pairs.promising(self)
        # Where two gain far more than any one does, and come down to the noise, one by one would lead astray.
        early = [pair for pair in both_gain if pair[0] > most + SCORE.large]
        both = pairs.sketched(self, early, current)
        found = pairs.best(self, [pair for pair in both if pair[1].error < SCORE.at_floor], current)
        if found is not None:
            return found
        done: list[Tried] = []
        for tried, base in self._keeping_up(sketched, current):
            assert tried.sketch is not None
            fitted = self.full(base, tried.sketch, None if tried.term.effect.once else current)
            if fitted is not None:
                done.append(replace(tried, fitted=fitted))
                self.tell(f"{tried.key}: error {fitted.error:.3g} x noise (was {current.error:.3g})")
        done = self._scored(done)
        self.rounds[-1] = ranking.updated(self.rounds[-1], done)
        chosen = self.choose(current, done)
        if chosen is not None:
            return self.polish(chosen)
        return pairs.best(self, [*both, *pairs.sketched(self, both_gain[len(early) :], current)], current)

    def least(self, term: Term) -> float:
        """Share of the largest predicted gain from which a hypothesis is sketched; more for what takes fine steps."""
        return SEARCH.keeps_up if self.slow(term) else 0.1

    def slow(self, term: Term) -> bool:
        """Whether an effect has to be simulated in finer steps than the others."""
        return term.effect.finest < self.problem.stepping.timestep

    def _by_key(self, current: Fit) -> dict[str, list[tuple[Tried, Fit]]]:
        """Every hypothesis, by key: its predicted gain over `current` on top of each base, and that base."""
        self.screened = [self._screen(base, current) for base in self._bases(current)]
        by_key: dict[str, list[tuple[Tried, Fit]]] = {}
        for base, handicap, hypotheses in self.screened:
            for tried in hypotheses:
                by_key.setdefault(tried.key, []).append(
                    (replace(tried, predicted_gain=tried.predicted_gain - handicap), base)
                )
        return by_key

    def _in_turn(
        self, ranked: Sequence[tuple[Tried, Fit]], by_key: dict[str, list[tuple[Tried, Fit]]], current: Fit
    ) -> list[tuple[Tried, Fit]]:
        """Sketches of the most promising hypotheses; of what takes fine steps and gains less only if none of these
        comes to the noise, for a straight line through its first guess foretells little far from there.
        """
        shares = [
            ranking.predicted_gain(start) / max(ranking.predicted_gain(ranked[0]), SCORE.worth) for start in ranked
        ]
        worth = [
            (start, share)
            for start, share in zip(ranked, shares, strict=True)
            if start[0].predicted_gain > SCORE.worth / 2
        ]
        first = ranking.finalists(
            [start for start, share in worth if share > self.least(start[0].term)],
            SEARCH.finalists if current.error > SCORE.at_noise else SEARCH.finalists // 2,
        )
        # A law's shape is a guess from forces, right to a few per cent: where most windows are at the noise already,
        # such a guess gains nothing as it stands. Only its fit tells.
        laws = [start for start in ranked if start[0].term.effect.free and start not in first]
        sketched = self._sketches([*first, *laws[: SEARCH.shapes]], by_key, current)
        if _at_noise(sketched):
            return sketched
        slow = [
            start for start, share in worth if self.slow(start[0].term) and SEARCH.in_turn < share <= SEARCH.keeps_up
        ]
        return sketched + self._sketches(slow, by_key, current)

    def _sketches(
        self, first: Sequence[tuple[Tried, Fit]], by_key: dict[str, list[tuple[Tried, Fit]]], current: Fit
    ) -> list[tuple[Tried, Fit]]:
        """Sketches of several hypotheses, plain ones first, for what elaborates one that leaves nothing needs none."""
        sketched: list[tuple[Tried, Fit]] = []
        for finalist, base in sorted(first, key=lambda start: len(start[0].term.effect.parameters)):
            structure = base.structure.with_term(finalist.term)
            if not ranking.idle(structure, [tried.sketch for tried, _ in sketched if tried.sketch]):
                sketched += self._sketched(
                    sorted(by_key[finalist.key], key=ranking.predicted_gain, reverse=True), current
                )
        return sketched

    def _sketched(self, by_key: Sequence[tuple[Tried, Fit]], current: Fit) -> list[tuple[Tried, Fit]]:
        """The best sketch of one hypothesis, if any, from the largest predicted gain on.

        A fit that brings less than screening foretold is stuck, unless it leaves nothing; then the next start is tried
        as well.
        """
        sketches: list[tuple[Tried, Fit]] = []
        for tried, base in by_key:
            sketch = self.sketch(base, base.structure.with_term(tried.term))
            if sketch is None:
                continue
            sketches.append((replace(tried, term=ranking.as_fitted(sketch), sketch=sketch), base))
            if ranking.complete(sketch) or ranking.brought(sketch, current.mse[self.subset]) > max(
                tried.predicted_gain, SCORE.worth / 2
            ):
                break
        losses = ranking.losses([tried.sketch.mse for tried, _ in sketches if tried.sketch is not None])
        return [sketches[int(np.argmin(losses))]] if sketches else []

    def _keeping_up(self, sketched: Sequence[tuple[Tried, Fit]], current: Fit) -> list[tuple[Tried, Fit]]:
        """Those whose sketches come near the best one, and the plainer ones that these elaborate.

        What takes fine steps has to come nearer. Where the best is at the noise, what is far from it needs no more
        fitting, and nothing plainer goes first.
        """
        losses = ranking.losses(
            [current.mse[self.subset], *(t.sketch.mse for t, _ in sketched if t.sketch is not None)]
        )
        gains = {t.key: losses[0] - after for (t, _), after in zip(sketched, losses[1:], strict=True)}
        most = max(gains.values(), default=0.0)
        least = max(SEARCH.keeps_up * most, SCORE.worth / 2)
        closely = max(least, most - SCORE.large)
        if _at_noise(sketched):
            return [pair for pair in sketched if gains[pair[0].key] > closely]
        close = [t for t, _ in sketched if gains[t.key] > (closely if self.slow(t.term) else least)]
        near = sorted(close, key=lambda t: -gains[t.key])[: SEARCH.fully]
        wanted = {t.key for t in near} | {f"{inner}@{t.term.at}" for t in near for inner in t.term.effect.contains}
        return self._plain_first([pair for pair in sketched if pair[0].key in wanted], current)

    def _plain_first(self, sketched: Sequence[tuple[Tried, Fit]], current: Fit) -> list[tuple[Tried, Fit]]:
        """Without those far from the noise that elaborate one which would go before them (`core`)."""
        before = float(np.sqrt(np.mean(current.mse[self.subset])))
        brought = {tried.key: before - tried.sketch.error for tried, _ in sketched if tried.sketch is not None}

        def waits(tried: Tried) -> bool:
            plain = [brought.get(f"{inner}@{tried.term.at}", 0.0) for inner in tried.term.effect.contains]
            far = tried.sketch is not None and tried.sketch.error > SEARCH.in_reach
            return far and max(plain, default=0.0) > SEARCH.most * brought[tried.key]

        return [pair for pair in sketched if not waits(pair[0])]

    def _scored(self, done: Sequence[Tried]) -> list[Tried]:
        """Fitted hypotheses with their scores, the best first."""
        losses = ranking.losses([self.mse(tried.fitted) for tried in done if tried.fitted is not None])
        scored = [replace(tried, score=after) for tried, after in zip(done, losses, strict=True)]
        return sorted(scored, key=lambda tried: tried.score)

    def _bases(self, current: Fit) -> list[Fit]:
        """What effects are tried on top of: the present fit, and at first the nominal parameters where it left them.

        Parameters that made up for a formula are in the way of a law, so laws are tried on what was before it as well.
        """
        begin = self.path[0]
        before = [begin] if self.shapes and current.structure.terms else []
        if self.last or self.anchor is None or (current.structure.terms and not before):
            return [current]
        far = np.abs(begin.z - self.anchor.z).max(initial=0.0) >= 0.1
        return [current, *before, *([self.anchor] if far else [])]

    def _screen(self, base: Fit, current: Fit) -> tuple[Fit, float, list[Tried]]:
        """A base, by how much it is worse than `current`, and the predicted gains of hypotheses on top of it."""
        handicap = max(0.0, mean_loss(base.mse, 1.0) - mean_loss(current.mse, 1.0))
        outliers = self.problem.windows.start[data.outliers(base.mse)]
        hypotheses = self.hypotheses(base, self.look(base, outliers))
        return base, handicap, screen.screen(self.problem, base, hypotheses, self.subset)

    def polish(self, fitted: Fit) -> Fit:
        """Fit on until nothing changes."""
        if fitted.converged:
            return fitted
        return fit(self.problem, fitted.structure, fitted.z, fitted.initial, most=25)

    def choose(self, current: Fit, done: Sequence[Tried]) -> Fit | None:
        """The simplest of the hypotheses that predict best, if it is clearly better than `current`."""
        clear = [t for t in done if t.fitted is not None and self.stands_out(t.term, t.fitted, current)]
        if not clear:
            return None
        return self.core(self.simplest(clear, current), clear, current).fitted

    def simplest(self, done: Sequence[Tried], current: Fit) -> Tried:
        """The simplest of the fitted hypotheses, sorted by score, that predict as well as the first."""
        best = done[0].fitted
        assert best is not None
        alike = [t for t in done if t.fitted is not None and self.alike(best, t.fitted, current)]
        return min(alike, key=lambda t: (*ranking.cost(t.fitted), t.score))

    def core(self, chosen: Tried, clear: Sequence[Tried], current: Fit) -> Tried:
        """The plainer effect that a chosen one elaborates, where it alone brings most of the improvement.

        Friction that varies with position takes up some of what a lacking second effect leaves. What it adds to plain
        friction is asked again when the rest is in place.
        """
        assert chosen.fitted is not None
        if common_error(chosen.fitted.mse) < SCORE.at_floor:
            return chosen
        most = current.error - SEARCH.most * (current.error - chosen.fitted.error)
        plain = [
            t
            for t in clear
            if t.term.effect.id in chosen.term.effect.contains
            and t.term.at == chosen.term.at
            and t.fitted is not None
            and t.fitted.error < most
        ]
        return self.core(min(plain, key=lambda t: t.score), clear, current) if plain else chosen

    def stands_out(self, term: Term, fitted: Fit, current: Fit) -> bool:
        """Whether a fit with one more effect is clearly better.

        What happened once shows in a window or two, fitted or not; it is believed where all others are at the noise.
        """
        if term.effect.once:
            fall = np.log1p(self.mse(current)) - np.log1p(self.mse(fitted))
            return quiet(current) and float(np.sum(fall)) > SEARCH.once
        return self.settles(fitted, current) or (
            self.earns(fitted, current) and self.compare(fitted, current).clear and self.confirmed(fitted, current)
        )

    def settles(self, fitted: Fit, current: Fit) -> bool:
        """Whether a fit leaves none of the few windows standing out that do where all others are at the noise.

        What acts that seldom can be told from nothing by no mean over windows, and from a push by leaving none.
        """
        before, after = self.mse(current), self.mse(fitted)
        outliers = data.outliers(before)
        fall = np.log1p(before[outliers]) - np.log1p(after[outliers])
        return quiet(current) and float(np.sum(fall)) > SEARCH.once and not len(data.outliers(after, before))

    def earns(self, fitted: Fit, current: Fit) -> bool:
        """Whether a fit comes down to the noise, or takes a good part of what is left.

        Real recordings hold structure that no catalogue has, and the best of dozens of effects always takes up a
        little of it.
        """
        return self._earned(self.mse(fitted), self.mse(current))

    def _earned(self, after: Array, before: Array) -> bool:
        """The same of mean square errors of the same windows, (n,)."""
        now, then = (float(np.sqrt(np.mean(mse))) for mse in (before, after))
        return common_error(after) < SCORE.at_floor or (not self.small and now - then > SEARCH.earns * (now - 1))

    def enough(self, current: Fit) -> bool:
        """Whether what is left at the noise is so little beside what effects took away that their laws may leave it.

        No law is exact to the last percent: a contact is not a spring and a damper, a bristle not a bristle.
        """
        brought = math.sqrt(max(self.path[0].error ** 2 - current.error**2, 0.0))
        left = math.sqrt(max(current.error**2 - 1.0, 0.0))
        return bool(current.structure.terms) and current.error < SCORE.at_floor and left < SEARCH.laws * brought

    def alike(self, best: Fit, other: Fit, current: Fit) -> bool:
        """Whether `other` predicts as well as `best`, by the standard error or within a fiftieth of the gain."""
        return ranking.alike(self.compare(best, other), self.compare(best, current).gain)

    def run(self, start: Fit, most: int = SEARCH.most_effects) -> Fit:
        """Add effects until none earns its place, or Ctrl-C; take out those that later ones made idle."""
        self.subset, self.path = ranking.subset(start.mse), [start]
        named = self._add(most)
        if named.error <= SCORE.at_floor or self.small or self.interrupted:
            return named
        self.tell("no formula comes down to the noise; asking for laws of any shape")
        self.shapes = True
        self._without_clocks()
        named = self._add(most)
        if named.error <= SCORE.at_floor or self.interrupted:
            return named
        self.tell("no law of a kind comes down to the noise; modelling what is left")
        self.last = True
        return self._add(len(self.joints))

    def _without_clocks(self) -> None:
        """Take out what is told by when it acts alone: beside a law of the state it may have nothing to do."""
        current = self.path[-1]
        clocks = [term.key for term in current.structure.terms if term.effect.leaves < LEAVES]
        for key in clocks:
            current = self.without(current, key)
        if clocks:
            self.path.append(current)

    def replace_last(self, better: Fit) -> Fit:
        """Put a fit in the place of the one that `run` came to, and add what earns its place beside it."""
        self.path[-1] = self.polish(better)
        return self._add(SEARCH.most_effects - len(better.structure.terms))

    def _add(self, most: int) -> Fit:
        try:
            for _ in range(most):
                current = attend(self)
                if self.enough(current):
                    break
                better = self.round(current)
                if better is None:
                    break
                added = better.structure.terms[-1].key
                self.path.append(better)
                self.tell(f"added {', '.join(names(better.structure.terms[len(current.structure.terms) :])) or added}")
                better = self.path[-1] = prune(self, better)
                if added not in names(better.structure.terms) and not self.compare(better, current).clear:
                    break
        except KeyboardInterrupt:
            self.interrupted = True
            self.tell("interrupted; judging what was found so far (Ctrl-C again stops at once)")
        return self.path[-1]

    def refine(self, fitted: Fit) -> Fit:
        """Halve the steps, from here on, and fit a structure once more: what takes fine steps is off at any."""
        self.problem = replace(self.problem, finer=2)
        self.compare_on(replace(self.comparison, finer=2))
        return fit(self.problem, fitted.structure, fitted.z, fitted.initial, most=20)

    def without(self, current: Fit, key: str) -> Fit:
        """Refit with one effect less, from the parameters that it has now: the fit before may have been stuck."""
        structure = current.structure.without(key)
        return fit(self.problem, structure, carry(current.structure, current.z, structure), current.initial)


def _at_noise(sketched: Sequence[tuple[Tried, Fit]]) -> bool:
    """Whether any of several sketches leaves no more than the noise."""
    return any(tried.sketch is not None and tried.sketch.error < SCORE.at_floor for tried, _ in sketched)
