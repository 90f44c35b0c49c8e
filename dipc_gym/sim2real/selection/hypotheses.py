"""What a round asks: every effect at every place that it can act at, laid over the residual of one fit or several."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import partial

import numpy as np

from dipc_gym.sim2real.effects.shared.base import Effect, dof
from dipc_gym.sim2real.effects.shared.settings import EFFECTS
from dipc_gym.sim2real.estimation.fit import Fit
from dipc_gym.sim2real.estimation.shooting import mean_loss
from dipc_gym.sim2real.estimation.unexplained import Scene, places
from dipc_gym.sim2real.model.structure import Term, carry
from dipc_gym.sim2real.selection import partitioning, ranking, screen
from dipc_gym.sim2real.selection.progress import Partition, Progress
from dipc_gym.sim2real.selection.ranking import Start
from dipc_gym.sim2real.selection.screen import Tried, excludes
from dipc_gym.sim2real.selection.settings import SEARCH
from dipc_gym.sim2real.side_by_side import side_by_side


class Phase(IntEnum):
    """What kinds of law are asked for; each phase begins where no law of the one before comes down to the noise."""

    FORMULAS = 1
    SHAPES = 2  # laws of any shape as well; laws of no kind compete with them
    NO_KIND = 3  # laws of no kind, and nothing else


@dataclass(frozen=True)
class Question:
    """What a search is about.

    Attributes:
        effects: the catalogue.
        joints: base joints.
        look: gives the scene of a fit, from which evidence is taken; times, s, at which outlier windows begin go along.
    """

    effects: Sequence[Effect]
    joints: tuple[str, ...]
    look: Callable[..., Scene]


@dataclass(frozen=True)
class Screened:
    """Hypotheses on top of a fit.

    Attributes:
        base: what they were laid over.
        handicap: how much worse that is than the present fit: difference of the mean log errors.
        tried: with their predicted gains.
    """

    base: Fit
    handicap: float
    tried: list[Tried]


def hypotheses(question: Question, phase: Phase, current: Fit, scene: Scene) -> list[Callable[[], list[Term]]]:
    """Every effect at every place it can act, each with its first guesses, once they are asked for; events only where
    most windows are at the noise.
    """
    terms, found = current.structure.terms, list[Callable[[], list[Term]]]()
    # Where few data are, a law of any shape is off, and windows stand out in which nothing happened.
    events = ranking.mostly_at_noise(current) and not any(term.effect.free for term in terms)
    for effect in question.effects:
        if (effect.once and not events) or (effect.free and phase < Phase.SHAPES):
            continue
        if phase == Phase.NO_KIND and not effect.of_no_kind:
            continue
        # No other recording shares a law of the clock: laws of the state go before it, down to near the noise.
        # What happened once is asked for only where all else is at the noise.
        clock = effect.leaves < EFFECTS.leaves and not effect.once
        if phase >= Phase.SHAPES and clock and current.error > SEARCH.in_reach:
            continue
        for at in places(effect, current.structure.model, question.joints, scene.recordings[0]):
            if any(t.at == at and excludes(t.effect, effect) for t in terms):
                continue
            found.append(partial(_guessed, question, current, scene, effect, at))
    return found


def _guessed(question: Question, current: Fit, scene: Scene, effect: Effect, at: str) -> list[Term]:
    """An effect at one place, with first guesses."""
    friction = {joint: float(scene.model.dof_frictionloss[dof(scene.model, joint)]) for joint in question.joints}
    levels = {joint: level for joint, level in friction.items() if level > 0}
    seen = _without_plainer(question, current, effect, at, scene) if effect.free else scene
    # A law has its guesses from forces without the plainer one, whose numbers may be those of another valley.
    plain = {} if effect.free else _plain(current, effect, at)
    proposals = effect.proposals(seen.at(effect.place, at, levels))
    return [Term(shaped, at, {**guess, **plain}) for shaped, guess in proposals]


def _without_plainer(question: Question, current: Fit, effect: Effect, at: str, scene: Scene) -> Scene:
    """The scene less what a law would replace, whose shape takes that on; levels of friction stay.

    So do what sensors make of their readings, for a scene says that by itself.
    """
    kept = current.structure
    for term in kept.terms:
        if term.at == at and term.effect.id in effect.contains and not (term.effect.levels or effect.moves_readings):
            kept = kept.without(term.key)
    if kept is current.structure:
        return scene
    return question.look(replace(current, structure=kept, z=carry(current.structure, current.z, kept)), scene.outliers)


def _plain(current: Fit, effect: Effect, at: str) -> dict[str, float]:
    """Parameters that an effect shares with plainer ones that are there and that it would replace."""
    shared: dict[str, float] = {}
    for term in current.structure.terms:
        if term.at == at and term.effect.id in effect.contains:
            values = current.structure.term_values(current.z, term)
            shared |= {p.name: values[p.name] for p in effect.parameters if p.name in values}
    return shared


def screened(question: Question, phase: Phase, progress: Progress) -> list[Screened]:
    """The predicted gains of all hypotheses, on top of each of the fits that effects are tried on."""
    current = progress.current
    return [_on_top(question, phase, progress.partition, base, current) for base in _bases(phase, progress)]


def _bases(phase: Phase, progress: Progress) -> list[Fit]:
    """What effects are tried on top of: the present fit, and at first the nominal parameters where it left them."""
    current, anchor = progress.current, progress.anchor
    if phase == Phase.NO_KIND or anchor is None or current.structure.terms:
        return [current]
    far = np.abs(current.z - anchor.z).max(initial=0.0) >= SEARCH.moved
    return [current, anchor] if far else [current]


def _on_top(question: Question, phase: Phase, partition: Partition, base: Fit, current: Fit) -> Screened:
    handicap = max(0.0, mean_loss(base.mse, 1.0) - mean_loss(current.mse, 1.0))
    outliers = partition.problem.windows.start[partitioning.outliers(base.mse)]
    scene = replace(question.look(base, outliers), fitted=(partition.problem.windows, base))
    asked = hypotheses(question, phase, base, scene)
    laid_over = screen.LaidOver(partition.problem, base, partition.subset)
    tasks = [partial(_screened, laid_over, guesses) for guesses in asked]
    with side_by_side(tasks, partition.problem.threads, question.effects) as result:
        tried = [one for k in range(len(tasks)) for one in result(k)]
    return Screened(base, handicap, sorted(tried, key=lambda one: -one.predicted_gain))


def _screened(laid_over: screen.LaidOver, guesses: Callable[[], list[Term]]) -> list[Tried]:
    """The best guess of each shape of an effect at one place."""
    return laid_over.tried(guesses())


def starts(found: Sequence[Screened]) -> dict[str, list[Start]]:
    """Each hypothesis, by key: its predicted gain over the present fit on top of each base, and that base."""
    by_key: dict[str, list[Start]] = {}
    for one in found:
        for tried in one.tried:
            net = replace(tried, predicted_gain=tried.predicted_gain - one.handicap)
            by_key.setdefault(tried.key, []).append(Start(net, one.base))
    return by_key
