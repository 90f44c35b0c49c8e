"""Find the effects that a model lacks, one or two at a time, by what they do to predictions of windows not fitted.

Screening costs one simulation a hypothesis: its response at a first guess, laid over the residual beside everything
that is free already. The best few are sketched, that is fitted to a third of the windows, and those that keep up are
fitted fully. Two at a time are tried where together they gain far more than any one does, or where no single one stands
out. What decides is the error of other windows than those that were fitted, as a mean of logarithms, so that each
window counts alike and its standard error means something.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf
from dipc_gym.sim2real.effects import Effect
from dipc_gym.sim2real.effects.shared.settings import EFFECTS
from dipc_gym.sim2real.estimation.fit import Fit, fit
from dipc_gym.sim2real.estimation.problem import Problem
from dipc_gym.sim2real.estimation.settings import ESTIMATION
from dipc_gym.sim2real.model.structure import Structure, names
from dipc_gym.sim2real.selection import beginnings, beside, choice, kinds, rounds, simulated
from dipc_gym.sim2real.selection.events import attend
from dipc_gym.sim2real.selection.fitter import Fitter
from dipc_gym.sim2real.selection.hypotheses import Phase, Question
from dipc_gym.sim2real.selection.parted import joined, parted
from dipc_gym.sim2real.selection.progress import Journal, Partition, Progress
from dipc_gym.sim2real.selection.prune import prune
from dipc_gym.sim2real.selection.resolution import reaching, refined, within_data
from dipc_gym.sim2real.selection.scorer import Scorer, enough, near
from dipc_gym.sim2real.selection.screen import Tried
from dipc_gym.sim2real.selection.settings import SCORE, SEARCH
from dipc_gym.sim2real.selection.stop import Stop
from dipc_gym.sim2real.stages import StageEnd

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Searched:
    """What a search came to. Later stages ask it, and none changes it.

    Attributes:
        question: effects and places.
        fitter: fits to the windows that the search ended with.
        progress: how far it came.
        phase: what kinds of law it asked for in the end.
        stop: whether Ctrl-C ended it, or what came after.
    """

    question: Question
    fitter: Fitter
    progress: Progress
    phase: Phase
    stop: Stop

    @property
    def scorer(self) -> Scorer:
        """Compares fits."""
        return self.fitter.scorer

    @property
    def partition(self) -> Partition:
        """Which windows serve for what."""
        return self.fitter.partition

    def tell(self, line: str) -> None:
        """Pass on a line about progress."""
        self.stop.tell(line)

    def carried_on(self, better: Fit) -> Searched:
        """With a fit in the place of the one that it came to, and what earns its place beside it."""
        search = Search(self.question, self.scorer, Journal(self.progress, self.tell), self.stop, self.phase)
        search.replace_last(better)
        return search.outcome

    def refined(self, fitted: Fit) -> tuple[Searched, Fit]:
        """With steps as fine as a fit asks for, and its structure fitted in these."""
        partition = self.partition.controlled(fitted)
        if partition is self.partition:
            return self, fitted
        return self._fitted_over(partition, (fitted.structure, fitted.z), fitted.initial)

    def whole(self, fitted: Fit) -> tuple[Searched, Fit]:
        """With all windows to fit, and a structure fitted to them: a table of dozens of values lacks none of them.

        Tables go as far as these windows do, and no further than they tell.
        """
        return self._as_far_as(self.partition.whole(fitted), fitted)

    def to_the_end(self, fitted: Fit, end: Problem) -> tuple[Searched, Fit]:
        """The same with the windows at the ends of recordings, which nothing was fitted to before.

        Args:
            fitted: to all other windows.
            end: these; their recordings are whole.
        """
        return self._as_far_as(self.partition.to_the_end(end), fitted)

    def _as_far_as(self, partition: Partition, fitted: Fit) -> tuple[Searched, Fit]:
        over, whole = self._fitted_over(
            partition, reaching(fitted, partition.problem.windows), partition.problem.initial
        )
        shorter = within_data(whole)
        if shorter is not None:
            whole = fit(partition.problem, *shorter, whole.initial, most=0)
        # More windows may go where few did before; where those were at the noise, what a law lacks there is knots.
        for key in names(whole.structure.terms) if fitted.error < SCORE.at_floor else ():
            whole = refined(over.fitter, whole, key, self.tell)
        return over, whole

    def _fitted_over(
        self, partition: Partition, begin: tuple[Structure, Array], initial: Array
    ) -> tuple[Searched, Fit]:
        over = replace(self, fitter=self.fitter.over(partition), progress=replace(self.progress, partition=partition))
        return over, fit(partition.problem, *begin, initial, most=ESTIMATION.from_afar)


class Search:
    """A search in progress: the one thing of this stage that changes, step by step, so that an end at any moment keeps
    what was found.

    Args:
        question: effects and places.
        scorer: compares on the windows that the journal begins with.
        journal: has the fit without effects, and then where the search stands.
        stop: whether Ctrl-C ended it.
        phase: what kinds of law are asked for.
        asks_whence: whether what it finds is asked for whether a simulation made the recordings.

    Attributes:
        simulated: the fit that shows the recordings to be a simulation's, where one does; there it ended.
    """

    def __init__(
        self,
        question: Question,
        scorer: Scorer,
        journal: Journal,
        stop: Stop,
        phase: Phase = Phase.FORMULAS,
        *,
        asks_whence: bool = False,
    ) -> None:
        self.question, self.fitter, self.journal = question, Fitter(scorer), journal
        self.stop, self.phase, self._asks_whence = stop, phase, asks_whence
        self.simulated: Fit | None = None
        self._parted = set[str]()  # where friction that depends on direction was
        self._of_no_kind: tuple[Fit, ...] = ()  # a path to laws of no kind alone, once it is known

    @property
    def outcome(self) -> Searched:
        """What it has come to."""
        return Searched(self.question, self.fitter, self.progress, self.phase, self.stop)

    @property
    def scorer(self) -> Scorer:
        """Compares fits on the windows of the present partition."""
        return self.fitter.scorer

    @property
    def partition(self) -> Partition:
        """Which windows serve for what."""
        return self.fitter.partition

    @property
    def progress(self) -> Progress:
        """How far it has come."""
        return self.journal.progress

    def tell(self, line: str) -> None:
        """Pass on a line about progress."""
        self.journal.tell(line)

    def run(self) -> Fit:
        """Add effects until none earns its place, or Ctrl-C; take out those that later ones made idle.

        At last what the beginnings of recordings alone show, and whether all is better told by a simulation's steps.
        """
        self._run()
        self._instead(joined(self.progress.current, self._parted, self.question.effects))
        found = self._with_the_past(self.progress.current)
        if found.structure.terms and not self._ended:
            self._look(found, at_noise=True)
            self._look_at_less(found)
        return found

    def _look_at_others(self, found: Fit) -> None:
        """Note another fit of the last round that shows recordings to be a simulation's: what steps cost may be more
        than what tells two effects apart.
        """
        if not self._asks_whence or self._ended or not SCORE.at_noise < found.error < SEARCH.in_reach:
            return
        if not simulated.steps_cost(self.partition.problem, found):
            return
        fitted = [one.fitted for one in self.progress.rounds[-1] if one.fitted is not None]
        close = [one for one in fitted if one.error < SEARCH.as_near * found.error]
        for one in sorted(close, key=lambda one: one.error)[: SEARCH.finalists]:
            if not self._ended:
                self._look(one)

    def _look_at_less(self, found: Fit) -> None:
        """Note a fit without one of several effects that shows recordings to be a simulation's: the other may be what
        steps cost, of which a swing or a coupling takes up most.
        """
        several = len(found.structure.terms) > 1 and self._asks_whence
        if not several or self._ended or not simulated.steps_cost(self.partition.problem, found):
            return
        for term in found.structure.terms:
            if not self._ended:
                self._look(self.fitter.without(found, term.key), at_noise=True)

    def _look(self, found: Fit, *, at_noise: bool = False) -> None:
        """Note a fit that shows recordings to be a simulation's."""
        if not self._asks_whence:
            return
        if simulated.look_simulated(self.partition.problem, found, self._coulomb, at_noise=at_noise):
            self.simulated = found

    @property
    def _coulomb(self) -> Effect | None:
        """Dry friction of a constant level, where that is asked for."""
        return next((effect for effect in self.question.effects if effect.id == simulated.COULOMB), None)

    def carry_over(self, found: Fit, before: Sequence[Sequence[Tried]]) -> None:
        """Go on from what a search found that took fine steps, where recordings are a simulation's.

        Args:
            found: by that search.
            before: its rounds; what was fitted in them is fitted in these steps.

        Raises:
            MjcfError, LinAlgError: what was found cannot be simulated in these.
        """
        problem, begin = self.partition.problem, self.progress.path[0]
        document = begin.structure.document

        def here(structure: Structure, z: Array) -> Fit:
            return fit(problem, replace(structure, document=document), z, most=SEARCH.polish_steps)

        def again(other: Fit) -> Fit | None:
            with contextlib.suppress(mjcf.MjcfError, np.linalg.LinAlgError):
                return here(other.structure, other.z).result()
            return None

        fitted = here(*simulated.with_coulomb(found, self._coulomb))
        others = [one.fitted for each in before for one in each if one.fitted is not None]
        with self.fitter.side_by_side([partial(again, other) for other in others], [begin]) as result:
            fits = {id(other): result(k) for k, other in enumerate(others)}
        rounds_here = tuple([self._as_tried(one, fits.get(id(one.fitted))) for one in each] for each in before)
        self.journal.progress = replace(self.progress, path=(begin, fitted), rounds=rounds_here)
        self.journal.correct(prune(self.question, self.fitter, fitted, self.tell))

    def _as_tried(self, tried: Tried, again: Fit | None) -> Tried:
        """A hypothesis with the fit to these windows, in these steps, that stands for another."""
        if again is None:
            return replace(tried.result(), sketch=None, fitted=None, score=np.inf)
        (scored,) = choice.scored(self.scorer, [replace(tried.result(), fitted=again)])
        return replace(scored, sketch=again.pick(self.partition.subset))

    def _with_the_past(self, found: Fit) -> Fit:
        """A fit with what the beginnings of recordings alone show."""
        past = [effect for effect in self.question.effects if effect.of_the_past]
        if not past or self._ended or beginnings.left(self.partition.first, found) is None:
            return found
        self.tell("little is left but how recordings begin; asking for what goes with the past")
        scorer, journal = replace(self.scorer, small=False), Journal(self.progress.with_first(), self.tell)
        search = Search(replace(self.question, effects=past), scorer, journal, self.stop, Phase.NO_KIND)
        if beginnings.have_a_law(search._add(1)):
            self._go_on(search.progress)
        return self.progress.current

    def _run(self) -> Fit:
        """What all but the beginnings of recordings show."""
        found = self._add()
        if self._ended or self.scorer.small or not any(effect.free for effect in self.question.effects):
            return found
        if self._done(found):
            self.journal.correct(kinds.shaped(self.question, self.fitter, found, self.tell))
            return self.progress.current
        self.tell("no formula comes down to the noise; asking for laws of any shape, from the beginning")
        formulas = self.progress.path
        try:
            found = self._with_laws(formulas)
        except BaseException:  # whoever goes on without what failed, or after Ctrl-C, goes on from what was found
            self._best_of(formulas)
            raise
        return self._best_of(formulas) if self._ended else found

    def _best_of(self, formulas: tuple[Fit, ...]) -> Fit:
        """What formulas came to, or laws, which begin anew: where these did not come to their end, the better one."""
        ends = [self.progress.informed(path) for path in (formulas, self.progress.path)]
        self.journal.go_back(choice.of_ends(self.scorer, ends))
        return self.progress.current

    def _with_laws(self, formulas: tuple[Fit, ...]) -> Fit:
        """What laws of any shape show, from the beginning on and beside formulas; what is left then is modelled."""
        self.phase = Phase.SHAPES
        ends = self._of_a_kind(formulas)
        found = self.progress.current
        if self._done(found):
            if not self._ended:  # a law of no kind that came with another effect, or was coarse, may have one now
                self.journal.correct(self._named(found))
            return self.progress.current
        self.tell("no law of a kind comes down to the noise; modelling what is left")
        self.phase = Phase.NO_KIND
        found = self._modelled(ends, formulas)
        if self._ended:
            return found
        found = self._named(found)
        bare = self.progress.path[0]  # not an earlier one: what is left asked for more windows
        self.journal.correct(beside.least(self.question, self.fitter, found, bare, self.tell))
        return self.progress.current

    def _of_a_kind(self, formulas: tuple[Fit, ...]) -> list[tuple[Fit, ...]]:
        """Paths that lead on: the one where the search stands then, with laws of a kind from the beginning or beside
        formulas, and that of the formulas alone where they are not in it.
        """
        begin = self._laws_begin(formulas)
        self.journal.go_back(begin)
        self._go_on(self.progress.with_spare())
        found = self._add(SEARCH.kinds_lead)
        if self._leads_astray(begin):
            self.tell("laws of no kind alone leave far less than laws of a kind do; giving these up")
            self._back_to(formulas)
            return [self.progress.path]
        if self._since(begin) == SEARCH.kinds_lead:
            found = self._add(SEARCH.most_effects - SEARCH.kinds_lead)
        if self._done(found) or self.scorer.compare(found, self.progress.informed(formulas)[-1]).clear:
            return [self.progress.path, formulas]
        self.tell("laws predict no better than formulas; asking for laws beside these")
        self._back_to(formulas)
        self._add()
        return [self.progress.path]

    def _named(self, found: Fit) -> Fit:
        """A fit in which laws of a kind, where these do as well, stand in the place of one of no kind."""
        return kinds.named(self.question, self.fitter, found, self.progress.path[0], self.tell)

    def _modelled(self, ends: Sequence[Sequence[Fit]], formulas: tuple[Fit, ...]) -> Fit:
        """What is left beside the ends of several paths, modelled; of these one, see `choice.of_ends`.

        A law of a kind may fit better than formulas and stand in the way of what is left beside both; and so may all
        that was found, see `_alone`.
        """
        found: list[tuple[Fit, ...]] = []
        for end in ends:
            if end is not self.progress.path:
                self._back_to(end)
            self._add(len(self.question.joints))
            found.append(self.progress.path)
            if self._ended:
                break
        self.journal.go_back(choice.of_ends(self.scorer, [self.progress.informed(path) for path in found]))
        if not self._done(self.progress.current):
            begin = self._laws_begin(formulas)  # where an end began if nothing was found
            asked = [path for end, path in zip(ends, found, strict=True) if len(end) == len(begin)]
            laws = self._where_far_better(self.progress.informed(asked[0] if asked else self._alone(begin)))
            if laws is not None:
                self.journal.go_back(self._beside(laws, formulas))
        return self.progress.current

    def _where_far_better(self, laws: tuple[Fit, ...]) -> tuple[Fit, ...] | None:
        """A path to laws of no kind, with kinds where they have any, if it leaves far less than the present fit."""

        def better(path: tuple[Fit, ...]) -> bool:
            modelled = bool(path[-1].structure.unnamed) and not self._ended
            return modelled and choice.leaves_far_less(self.scorer, path[-1], self.progress.current)

        if not better(laws):
            return None
        named = (*laws[:-1], self._with_names(laws[-1]))  # asked for only where it matters what kind the laws have
        return named if better(named) else None

    def _with_names(self, found: Fit) -> Fit:
        """See `_named`; and without what is idle then."""
        named = self._named(found)
        return found if named is found else prune(self.question, self.fitter, named, self.tell)

    def _leads_astray(self, begin: tuple[Fit, ...]) -> bool:
        """Whether laws of a kind, of which there are several, leave far more than laws of no kind do alone. The third
        takes up what the others did wrong, and so on, each in more time than the one before.
        """
        found = self.progress.current
        if self._done(found) or self._since(begin) < SEARCH.kinds_lead or near(begin[0], found):
            return False
        alone = self._alone(begin)[-1]
        return not self._ended and choice.leaves_a_part(self.scorer, alone, found)

    def _since(self, begin: tuple[Fit, ...]) -> int:
        """How many rounds have added something to a path."""
        return len(self.progress.path) - len(begin)

    def _alone(self, begin: tuple[Fit, ...]) -> tuple[Fit, ...]:
        """A path to laws of no kind from the beginning, asked for once. The search stands where it stood, whatever
        happens.
        """
        if self._of_no_kind:
            return self._of_no_kind
        before, phase = self.progress, self.phase
        self.tell("asking for laws of no kind in the place of what was found")
        try:
            self.phase = Phase.NO_KIND
            self.journal.go_back(begin)
            self._add(len(self.question.joints), named=False)  # it is asked how far they come, and seldom for more
            self._of_no_kind = self.progress.path
            return self._of_no_kind
        finally:
            self.phase = phase
            self._go_on(before)

    def _beside(self, laws: tuple[Fit, ...], formulas: tuple[Fit, ...]) -> tuple[Fit, ...]:
        """A path to names and to laws of no kind for what they leave: to the names of the present fit or those that
        formulas came to, where these go before the laws, and both together predict as well. Else the path to the laws
        alone, or that of the present fit.
        """
        path, begin = self.progress.path, laws[0]
        present = self.fitter.without(path[-1], *names(path[-1].structure.unnamed))
        plain = self._without_clocks(self.progress.informed(formulas)[-1])
        both: list[tuple[Fit, ...]] = []
        for way, named in ((path, present), (formulas, plain)):
            if not named.structure.terms or not choice.goes_before(self.scorer, named, laws[-1], begin):
                continue
            end = beside.rest(self.question, self.fitter, named, laws[-1], begin, self.tell)
            if end is not None and choice.leaves_far_less(self.scorer, end, path[-1]):
                both.append((*way, end))
        return choice.of_ends(self.scorer, both or [path, laws])

    def _laws_begin(self, formulas: tuple[Fit, ...]) -> tuple[Fit, ...]:
        """Where laws are asked from the beginning: without what formulas came to, but for what a machine lacks at all
        its joints, which came first and would come first again.
        """
        return formulas[: 2 if self._everywhere(formulas[1:2]) else 1]

    def _back_to(self, path: Sequence[Fit]) -> None:
        """Go on from a path that was left, see `_without_clocks`."""
        self.journal.go_back(tuple(path))
        current = self._without_clocks(self.progress.current)
        if current is not self.progress.current:
            self.journal.accept(current)

    def _without_clocks(self, fitted: Fit) -> Fit:
        """A fit without what is told by when it acts alone: beside a law of the state it may have nothing to do."""
        clocks = [term.key for term in fitted.structure.terms if term.effect.leaves < EFFECTS.leaves]
        return self.fitter.without(fitted, *clocks)

    def _everywhere(self, accepted: Sequence[Fit]) -> bool:
        """Whether the first fit that was accepted has effects at all of several joints."""
        places = {term.at for fitted in accepted for term in fitted.structure.terms}
        return len(self.question.joints) > 1 and places >= set(self.question.joints)

    @property
    def _ended(self) -> bool:
        """Whether nothing more is to be tried, whatever is left."""
        return self.stop.asked or self.simulated is not None

    def _done(self, found: Fit) -> bool:
        return found.error <= SCORE.at_floor or self._ended

    def replace_last(self, better: Fit) -> Fit:
        """Put a fit in the place of the one that `run` came to, and add what earns its place beside it."""
        self.journal.correct(self.fitter.polish(better))
        return self._add(SEARCH.most_effects - len(better.structure.terms))

    def _add(self, most: int = SEARCH.most_effects, *, named: bool = True) -> Fit:
        """What rounds come to, as many as that at most; laws of no kind get kinds in each, unless that is left out."""
        try:
            for _ in range(most):
                if self._ended or not self._step(named=named):
                    break
        except KeyboardInterrupt:
            self.stop.ask("judging what was found so far")
        return self.progress.current

    def _step(self, *, named: bool) -> bool:
        """Add what a round accepts, and prune; whether there may be more to add."""
        known = len(self.partition.problem.windows)
        self._go_on(attend(self.progress, self.scorer))
        if len(self.partition.problem.windows) > known:  # they may ask for more of a law than those did that it had
            self.journal.correct(self._finer(self.progress.current))
        before = self.progress.current
        if enough(self.progress.path[0], before):
            return False
        apart, places = parted(before, self.question.effects)
        self._parted |= places
        before = self._instead(apart)
        better = rounds.addition(self.question, self.phase, self.fitter, self.journal)
        if better is None:
            return False
        if named:  # two laws of a kind, each alone far from the noise, are seen together as one of no kind
            better = self._named(better)
        self.journal.accept(better)
        added = better.structure.newest.key
        new = ", ".join(names(better.structure.terms[len(before.structure.terms) :])) or added
        self.tell(StageEnd(f"added {new}", "round"))
        pruned = prune(self.question, self.fitter, better, self.tell)
        if pruned.error > before.error and not self.scorer.compare(pruned, before).clear:
            pruned = better  # each of a group may be spared beside the others, and their gain is lost with one of them
        pruned = self._finer(pruned)
        self.journal.correct(pruned)
        self._look(pruned)
        self._look_at_others(pruned)
        return added in names(pruned.structure.terms) or self.scorer.compare(pruned, before).clear

    def _instead(self, structure: Structure) -> Fit:
        """The present fit with a structure that predicts the same."""
        current = self.progress.current
        if structure is not current.structure:
            self.journal.correct(self.fitter.as_it_is(current, structure))
        return self.progress.current

    def _finer(self, fitted: Fit) -> Fit:
        """A fit whose laws are as fine as its windows ask for, if little else can be missing then: a law that is finer
        before that takes up what something else does.
        """
        finer = fitted
        for key in names(fitted.structure.terms):
            finer = refined(self.fitter, finer, key, self.tell)
        return finer if near(self.progress.path[0], finer) else fitted

    def _go_on(self, progress: Progress) -> None:
        """Go on from here, on these windows."""
        self.fitter, self.journal.progress = self.fitter.over(progress.partition), progress
