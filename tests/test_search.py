"""The rules by which a search goes on, ends, and chooses; what it finds is in test_diagnose.py."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from dipc_gym.sim2real.effects import catalogue
from dipc_gym.sim2real.model.structure import Term
from dipc_gym.sim2real.selection import data, fitter, hypotheses, pairs, screen, sketches
from dipc_gym.sim2real.selection.fitter import Fitter
from dipc_gym.sim2real.selection.hypotheses import Phase, Question
from dipc_gym.sim2real.selection.progress import Partition
from dipc_gym.sim2real.selection.score import compare
from dipc_gym.sim2real.selection.scorer import Scorer, earned, enough
from dipc_gym.sim2real.selection.screen import Tried


@pytest.mark.parametrize(
    ("before", "now", "terms", "ends"),
    [
        (300.0, 1.1, 1, True),  # a third of a percent may be owed to the law of friction
        (10.0, 1.1, 1, False),  # a twentieth may not
        (300.0, 1.3, 1, False),  # not at the noise
        (1.02, 1.02, 0, False),  # nothing was found yet
        (5.0, 0.99, 2, True),
    ],
)
def test_a_search_ends_where_laws_may_leave_what_is_left(before: float, now: float, terms: int, ends: bool) -> None:
    def fitted(error: float, count: int) -> SimpleNamespace:
        return SimpleNamespace(error=error, structure=SimpleNamespace(terms=("friction",) * count))

    assert enough(fitted(before, 0), fitted(now, terms)) is ends  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("small", "before", "after", "stays"),
    [
        (False, 10.0, 7.0, True),  # a third of what is left
        (False, 10.0, 8.5, True),  # a sixth
        (False, 10.0, 9.4, False),  # a fifteenth
        (True, 10.0, 2.0, False),  # small beside the motion: all or nothing
        (True, 10.0, 1.1, True),
        (False, 1.3, 1.1, True),
    ],
)
def test_what_earns_its_place(small: bool, before: float, after: float, stays: bool) -> None:
    """Errors in units of noise."""
    windows = np.ones(9)
    assert earned(after**2 * windows, before**2 * windows, small=small) is stays


@pytest.mark.parametrize(
    ("after", "tried"),
    [
        ({"gap drag": 6.0}, ["gap drag", "rub drag"]),  # a quarter of what was predicted: no gap beside others either
        ({"gap drag": 2.0}, ["gap drag", "gap load", "rub drag"]),  # as predicted
        ({"rub drag": 6.0}, ["gap drag", "gap load", "rub drag"]),  # what takes no fine steps is tried anyway
    ],
)
def test_a_gap_that_fell_short_beside_one_effect_is_not_tried_beside_others(
    after: dict[str, float], tried: list[str]
) -> None:
    """The mean square error is 8 before and 1 after, where nothing else is said; the predicted gain of each pair is
    1.0.
    """
    said: list[str] = []

    def sketch(base: SimpleNamespace, structure: SimpleNamespace) -> SimpleNamespace:
        said.append(name := " ".join(term.key for term in structure.terms))
        return SimpleNamespace(mse=np.full(9, after.get(name, 1.0)), error=2.0)

    fits = SimpleNamespace(subset=np.arange(9), sketch=sketch, slow=lambda term: term.key == "gap")
    asked: list[Any] = []
    for name in ("gap drag", "gap load", "rub drag"):
        terms = [SimpleNamespace(key=key) for key in name.split()]
        both = SimpleNamespace(terms=terms, slots=terms, elaborates=lambda _: False)
        asked.append((1.0, SimpleNamespace(), both))
    pairs.sketched(fits, asked, SimpleNamespace(mse=np.full(9, 8.0)))  # type: ignore[arg-type]
    assert said == tried


@pytest.mark.parametrize(("after", "stays"), [(1.0, True), (1.3, False)])
def test_a_push_not_yet_found_does_not_speak_against_what_explains_the_rest(after: float, stays: bool) -> None:
    before, now = np.full(40, 1.5**2), np.full(40, after**2)
    before[7] = now[7] = 60.0**2
    assert earned(now, before, small=False) is stays


@pytest.mark.parametrize(
    ("plain", "elaborate", "kept"),
    [
        (40.0, 20.0, ["friction.coulomb"]),  # the plain one brings three quarters: it goes first
        (70.0, 20.0, ["friction.coulomb", "friction.stribeck"]),  # less than half
        (40.0, 2.0, ["friction.coulomb", "friction.stribeck"]),  # the other may yet come down to the noise
    ],
)
def test_what_elaborates_waits_for_the_plain_one(plain: float, elaborate: float, kept: list[str]) -> None:
    """Errors of sketches, in units of noise; without either it is 100."""
    errors = {"friction.coulomb": plain, "friction.stribeck": elaborate}
    sketched = [
        (Tried(Term(catalogue()[name], "cart", {}), 1.0, SimpleNamespace(error=error)), None)  # type: ignore[arg-type]
        for name, error in errors.items()
    ]
    left = sketches.plain_first(sketched, 100.0)  # type: ignore[arg-type]
    assert [tried.term.effect.id for tried, _ in left] == kept


@pytest.mark.parametrize(
    ("share", "lag_leaves", "asked"),
    [
        (0.7, 1.0, {"timing.sensor_lag", "transmission.compliance"}),  # it keeps up
        (0.4, 9.0, {"timing.sensor_lag", "transmission.compliance"}),  # nothing else will do
        (0.4, 1.0, {"timing.sensor_lag"}),
        (0.2, 9.0, {"timing.sensor_lag"}),
    ],
)
def test_what_takes_fine_steps_and_gains_less_waits_for_the_others(
    share: float, lag_leaves: float, asked: set[str]
) -> None:
    """The predicted gain of a coupling is a share of that of a lag, and the lag's sketch leaves so many times the
    noise.
    """

    gains = {"timing.sensor_lag": 2.0, "transmission.compliance": 2.0 * share}
    left = {"timing.sensor_lag": lag_leaves, "transmission.compliance": 5.0}

    class Structure(SimpleNamespace):
        def with_term(self, term: Term) -> Structure:
            return Structure(terms=[term], term_values=lambda *_: {}, elaborates=lambda _: False)

    class Fits:
        subset = np.arange(9)

        def slow(self, term: Term) -> bool:
            return term.effect.id == "transmission.compliance"

        def sketch(self, base: Any, structure: Structure) -> SimpleNamespace:
            error = left[structure.terms[0].effect.id]
            return SimpleNamespace(error=error, mse=np.full(9, error**2), structure=structure, z=np.zeros(0))

    base = SimpleNamespace(structure=Structure())
    ranked: list[Any] = [(Tried(Term(catalogue()[name], "at", {}), worth), base) for name, worth in gains.items()]
    current: Any = SimpleNamespace(error=50.0, mse=np.full(9, 2500.0))
    sketched = sketches.in_turn(Fits(), ranked, {one.key: [(one, on)] for one, on in ranked}, current)  # type: ignore[arg-type]
    assert {tried.term.effect.id for tried, _ in sketched} == asked


@pytest.mark.parametrize(("error", "tried"), [(1.1, True), (2.0, False)])
def test_what_happened_once_is_looked_for_at_the_noise(
    monkeypatch: pytest.MonkeyPatch, error: float, tried: bool
) -> None:
    """Elsewhere a push in the right moment takes up a little of everything."""
    push = catalogue()["disturbance.pulse"]
    monkeypatch.setattr("dipc_gym.sim2real.selection.hypotheses.places", lambda *_: ["cart"])
    model = SimpleNamespace(dof_frictionloss=np.zeros(1))
    scene = SimpleNamespace(model=model, recordings=[None], at=lambda *_: None)
    question = Question([push], (), lambda *_: scene)  # type: ignore[arg-type, return-value]
    current = SimpleNamespace(mse=np.full(9, error**2), structure=SimpleNamespace(terms=(), model=model))
    monkeypatch.setattr(type(push), "guesses", lambda *_: [{}])
    found = hypotheses.hypotheses(question, Phase.FORMULAS, current, scene)  # type: ignore[arg-type]
    assert bool(found) is tried


@pytest.mark.parametrize(
    ("scale", "worse", "better", "shows"),
    [
        (1.0, 3, 0, True),
        (1.0, 2, 0, False),  # may be chance
        (1.0, 3, 1, False),  # they contradict each other
        (9.0, 3, 0, False),  # away from the noise errors differ for many reasons
    ],
)
def test_a_few_windows_tell_at_the_noise(scale: float, worse: int, better: int, shows: bool) -> None:
    """An effect that acts in three of eighty windows, as break-away does, is there: ten times the error without it."""
    new, old = np.full(80, scale), np.full(80, scale)
    old[:worse] *= 100.0
    new[worse : worse + better] *= 100.0
    difference = compare(new, old, np.arange(80))
    assert difference.shows is shows
    assert difference.clear is shows
    assert difference.alike is not shows


@pytest.mark.parametrize(
    ("others", "after", "stands_out"),
    [
        (1.0, (1.0, 1.0), True),  # a limit that is met in two windows, and explains both
        (1.0, (1.0, 60.0), False),  # one of them is left: a push would do as well
        (9.0, (9.0, 9.0), False),  # where most windows are far off, two say little
    ],
)
def test_what_acts_seldom_stands_out_where_it_leaves_nothing(
    others: float, after: tuple[float, float], stands_out: bool
) -> None:
    """Two of 72 windows are predicted badly, the others at the noise or not."""
    before = np.append(np.full(70, others), [400.0, 90.0])

    class OnFitted(Scorer):
        def comparison_mse(self, fitted: Any) -> np.ndarray:
            return np.zeros(0)

    scorer = OnFitted(SimpleNamespace(blocks=np.arange(72)))  # type: ignore[arg-type]
    term = SimpleNamespace(effect=SimpleNamespace(once=False))
    fits = [SimpleNamespace(mse=mse) for mse in (np.append(np.full(70, others), after), before)]
    assert not scorer.compare(*fits).clear  # type: ignore[arg-type]  # by a standard error, two windows never are
    assert scorer.stands_out(term, *fits) is stands_out  # type: ignore[arg-type]


def test_windows_of_other_recordings_at_the_time_of_an_outlier_are_left_aside() -> None:
    windows = SimpleNamespace(
        start=np.array([0.0, 1.0, 2.0, 3.0] * 2), source=np.repeat([0, 1], 4), times=np.linspace(0, 0.25, 5)[None]
    )
    mse = np.ones(8)
    assert data.without_echoes(windows, mse).all()  # type: ignore[arg-type]
    mse[2] = 1000.0
    assert np.flatnonzero(~data.without_echoes(windows, mse)).tolist() == [6]  # type: ignore[arg-type]


def test_sketches_know_windows_that_stood_out_before_them() -> None:
    """What stands out later is added at the end, and older sketches are compared on what they know."""
    partition = Partition(*[None] * 4, np.array([4, 7, 9, 2]))  # type: ignore[arg-type]
    old = SimpleNamespace(mse=np.ones(3))
    assert partition.known_to(old).tolist() == [4, 7, 9]  # type: ignore[arg-type]


def test_windows_beside_an_outlier_are_taken_in() -> None:
    """They tell when it began and ended; those of another recording do not."""
    fitted = SimpleNamespace(start=np.arange(9) / 2, source=np.zeros(9, dtype=int))

    class Aside(SimpleNamespace):
        def __len__(self) -> int:
            return len(self.start)

    start, source = np.array([0.25, 0.75, 1.5, 0.25]), np.array([0, 0, 0, 1])
    aside = Aside(start=start, source=source, times=np.linspace(0, 0.25, 5)[None])
    found = data.eventful(fitted, np.where(fitted.start == 0.5, 90.0, 1.0), aside, np.ones(4))  # type: ignore[arg-type]
    assert found.tolist() == [True, True, False, False]
    found = data.eventful(fitted, np.ones(9), aside, np.array([1.0, 1.0, 90.0, 1.0]))  # type: ignore[arg-type]
    assert found.tolist() == [False, False, True, False]
    many = Aside(start=np.arange(9.0), source=np.zeros(9, dtype=int), times=aside.times)
    assert not data.eventful(fitted, np.ones(9), many, np.full(9, 90.0)).any()  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("everywhere", "among_subset", "luck"),
    [
        (0.0, 0.1, 0.1),
        (0.2, 0.5, 0.3),
        (0.2, 0.1, 0.0),
        (-4.2, 0.1, 0.1),  # a step cut short along a null space does harm; parameters may as well stay where they are
    ],
)
def test_what_model_parameters_gain_on_a_subset_by_chance(
    monkeypatch: pytest.MonkeyPatch, everywhere: float, among_subset: float, luck: float
) -> None:
    gains = {9: everywhere, 3: among_subset}

    class Windows(int):
        def pick(self, subset: np.ndarray) -> Windows:
            return Windows(len(subset))

    monkeypatch.setattr(
        screen, "_Overlay", lambda count, *_: SimpleNamespace(predicted_gain=lambda *_, beside: (gains[count], []))
    )
    found = screen._luck(Windows(9), Windows(9), np.arange(3))  # type: ignore[arg-type]
    assert found == pytest.approx(luck)


@pytest.mark.parametrize(
    ("stays", "terms", "subset", "whole", "kept"),
    [
        (1.5, 2, 1.0, 1.0, 1.0),  # another valley leads to the noise
        (1.5, 2, 1.4999, 1.0, 1.5),  # hardly better on the subset: the whole is not asked
        (1.5, 2, 1.0, 1.6, 1.5),  # the subset foretold too much
        (1.5, 1, 1.0, 1.0, 1.5),  # what is alone was begun from nominal parameters already
        (1.1, 2, 1.0, 1.0, 1.1),  # at the noise
    ],
)
def test_several_effects_that_stay_above_the_noise_are_begun_anew(
    monkeypatch: pytest.MonkeyPatch, stays: float, terms: int, subset: float, whole: float, kept: float
) -> None:
    """Errors in units of noise: where the fit stays, and what comes of a new one on the subset and on all windows."""

    def fitted(error: float, count: int) -> SimpleNamespace:
        structure = SimpleNamespace(terms=("",) * terms)
        return SimpleNamespace(mse=np.full(count, error**2), error=error, structure=structure, z=np.zeros(1))

    problem = SimpleNamespace(blocks=np.arange(60), windows=range(60))
    problem.pick = lambda which: SimpleNamespace(windows=which)
    monkeypatch.setattr(
        fitter,
        "fit",
        lambda some, *_, **__: fitted(whole if some is problem else subset, len(some.windows)),
    )
    partition = Partition(problem, *[None] * 3, np.arange(0, 60, 3))  # type: ignore[arg-type]
    assert Fitter(Scorer(partition)).anew(fitted(stays, 60)).error == kept  # type: ignore[arg-type]
