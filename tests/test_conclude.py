"""What a search comes to: what validation data strike off, and what takes the place of what was found."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dipc_gym.sim2real.effects import catalogue
from dipc_gym.sim2real.estimation.fit import Fit
from dipc_gym.sim2real.selection.settings import SCORE
from dipc_gym.sim2real.verdict import conclude, judge, judgement, sparse
from dipc_gym.sim2real.verdict.conclude import Conclusion


class _Searched:
    """A search that has run, its fits told apart by names alone."""

    interrupted = False
    question = None

    def __init__(self, *path: str) -> None:
        self.progress = SimpleNamespace(path=[_fitted(name) for name in path], current=_fitted(path[-1]))
        self.partition = SimpleNamespace(validation=None)
        self.scorer = self.fitter = self
        self.errors: dict[str, float] = {}

    def tell(self, line: str) -> None:
        """Nobody listens."""

    def replace_last(self, better: SimpleNamespace) -> None:
        """Another search found nothing to add."""
        self.progress = SimpleNamespace(path=[*self.progress.path[:-1], better], current=better)

    def comparison_error(self, fitted: SimpleNamespace) -> float:
        """The same as on validation data."""
        return self.errors[fitted.name]

    def alike(self, best: SimpleNamespace, other: SimpleNamespace, _: SimpleNamespace) -> bool:
        """What has the best in its name predicts alike."""
        return "best" in best.name and "best" in other.name

    def compare(self, new: SimpleNamespace, old: SimpleNamespace) -> SimpleNamespace:
        """Whether one predicts as well as the other, by their names."""
        return SimpleNamespace(alike="worse" not in old.name)

    def without(self, fitted: SimpleNamespace, key: str) -> SimpleNamespace:
        """A fit with one effect less."""
        return _fitted(" ".join(term.key for term in fitted.structure.terms if term.key != key))


def _fitted(name: str) -> SimpleNamespace:
    """A push happens once, heat is a trend; what is plain has one parameter, everything else two."""
    ids = {"push": "disturbance.pulse", "heat": "motor.thermal"}
    like = [catalogue()[ids.get(key, "friction.coulomb")] for key in name.split()]
    kinds = [
        {"once": one.once, "leaves": one.leaves, "needs_loader": False, "place": "joint", "of_no_kind": False}
        for one in like
    ]
    terms = [
        SimpleNamespace(key=key, effect=SimpleNamespace(**kind)) for key, kind in zip(name.split(), kinds, strict=True)
    ]
    count = sum(1 if term.key == "plain" else 2 for term in terms)
    return SimpleNamespace(name=name, structure=SimpleNamespace(terms=terms), z=np.zeros(count))


def _conclude(
    monkeypatch: pytest.MonkeyPatch,
    search: _Searched,
    errors: dict[str, float],
    better: dict[str, list[str]],
    same: dict[str, list[str]] | None = None,
) -> tuple[conclude.Conclusion, list[str]]:
    """Conclude a search given errors on validation data, and the rivals of each effect that predict better or that are
    the same model; also what was asked.
    """
    asked: list[str] = []

    def rivals(_: object, full: SimpleNamespace, term: SimpleNamespace) -> list[judge.Rival]:
        asked.append(f"{term.key} in {full.name}")
        alike, ahead = (same or {}).get(term.key, []), better.get(term.key, [])
        return [
            judge.Rival(_fitted(name).structure.terms[0], _fitted(name), name in alike, False, name in ahead)
            for name in ("worse", *alike, *ahead)
        ]

    monkeypatch.setattr(judge, "rivals", rivals)
    monkeypatch.setattr(sparse, "fewest_parameters", lambda _, fit: fit)
    monkeypatch.setattr(sparse, "other_parameters", lambda *_: [])
    search.errors = errors
    monkeypatch.setattr(judge, "error_on", lambda _, fit: errors[fit.name])

    def apart(_: object, new: SimpleNamespace, old: SimpleNamespace) -> SimpleNamespace:
        gain = 2 * math.log(errors.get(old.name, errors[""]) / errors[new.name])
        return SimpleNamespace(gain=gain, error=0.0)

    monkeypatch.setattr(judge, "apart", apart)
    return conclude.conclude(search), asked  # type: ignore[arg-type]


def test_a_rival_that_predicts_better_takes_the_place(monkeypatch: pytest.MonkeyPatch) -> None:
    """The best of them does, and is asked in its turn what could stand in for it."""
    errors = {"": 19.0, "first": 4.0, "good": 3.0, "best": 2.0}
    found, asked = _conclude(monkeypatch, _Searched("", "first"), errors, {"first": ["good", "best"]})
    assert found.fitted.name == "best"  # type: ignore[attr-defined]
    assert asked == ["first in first", "best in best"]
    assert [rival.better for rival in found.rivals["best"]] == [False]
    assert found.notes == []


def test_of_rivals_that_predict_better_alike_the_simplest_takes_the_place(monkeypatch: pytest.MonkeyPatch) -> None:
    errors = {"": 19.0, "first": 4.0, "good": 3.0, "best": 2.01, "best elaborated": 2.0}
    better = ["good", "best elaborated", "best"]
    found, _ = _conclude(monkeypatch, _Searched("", "first"), errors, {"first": better})
    assert found.fitted.name == "best"  # type: ignore[attr-defined]


def test_what_validation_data_strike_off_is_not_asked_for_rivals(monkeypatch: pytest.MonkeyPatch) -> None:
    """Neither is it added again, though a rival of what is left would predict better."""
    errors = {"": 19.0, "first": 4.0, "first second": 5.0, "best": 2.0}
    search = _Searched("", "first", "first second")
    found, asked = _conclude(monkeypatch, search, errors, {"first": ["best"]})
    assert found.fitted.name == "first"  # type: ignore[attr-defined]
    assert asked == ["first in first"]
    assert len(found.notes) == 1
    assert found.notes[0].startswith("second would explain")


def test_effects_that_validation_data_strike_off_altogether(monkeypatch: pytest.MonkeyPatch) -> None:
    """Then nothing is named."""
    errors = {"": 4.0, "first": 5.0, "first second": 6.0}
    found, asked = _conclude(monkeypatch, _Searched("", "first", "first second"), errors, {})
    assert found.fitted.name == ""
    assert asked == []
    assert len(found.notes) == 2


@pytest.mark.parametrize(
    ("chosen", "same", "stays"),
    [
        ("first", ["second", "plain"], "plain"),  # one parameter for two
        ("first", ["second"], "first"),  # as many parameters: nothing says which
        ("plain", ["first"], "plain"),
    ],
)
def test_of_names_for_one_model_the_plainer_one_stays(
    monkeypatch: pytest.MonkeyPatch, chosen: str, same: list[str], stays: str
) -> None:
    """What was accepted as one of a pair was never compared with what would do in its place."""
    errors = dict.fromkeys(("first", "second", "plain"), 1.0) | {"": 9.0}
    found, _ = _conclude(monkeypatch, _Searched("", chosen), errors, {}, {chosen: same})
    assert found.fitted.name == stays  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("idle", "stays"),
    [
        ({"zero spring bias": "zero spring"}, "zero spring"),
        ({"zero spring bias": "zero worse"}, "force spring bias"),  # pruning may be content with less
        ({}, "force spring bias"),
    ],
)
def test_a_name_that_needs_nothing_beside_it_goes_before_two(
    monkeypatch: pytest.MonkeyPatch, idle: dict[str, str], stays: str
) -> None:
    """A constant force and another sensor's bias may together be what one biased sensor is alone."""
    names = ("force spring bias", "zero spring bias", "zero spring")
    errors = dict.fromkeys(names, 1.0) | {"": 9.0, "worse": 2.0}
    monkeypatch.setattr(conclude, "prune", lambda _question, _fitter, fit, _tell: _fitted(idle.get(fit.name, fit.name)))
    same = {"force": ["zero spring bias"]}
    found, _ = _conclude(monkeypatch, _Searched("", "force spring bias"), errors, {}, same)
    assert found.fitted.name == stays  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("accepted", "alone", "left", "named", "struck_off"),
    [
        ("first push", 1.6, 1.1, "first push", []),
        ("first push", 1.6, 1.5, "first", ["push"]),  # one of several windows that stand out could always be a push
        ("first push", 7.0, 1.5, "first", ["push"]),  # it helps, however much is left beside it
        ("first push", 12.0, 1.5, "", ["push", "first would explain"]),  # without it, validation data speak against it
        ("first second", 7.5, 4.0, "first second", []),
        ("first second", 4.1, 4.0, "first second", ["second improves"]),  # by too little to have a name
    ],
)
def test_what_only_stands_in_for_what_is_left_is_not_named(
    monkeypatch: pytest.MonkeyPatch, accepted: str, alone: float, left: float, named: str, struck_off: list[str]
) -> None:
    """The error is 9 times the noise without any effect."""
    errors = {"": 9.0, "first": alone, accepted: left}
    found, _ = _conclude(monkeypatch, _Searched("", "first", accepted), errors, {})
    assert found.fitted.name == named  # type: ignore[attr-defined]
    assert len(found.notes) == len(struck_off)
    assert all(note.startswith(words) for note, words in zip(found.notes, struck_off, strict=True))


@pytest.mark.parametrize(
    ("alone", "left", "named", "struck_off"),
    [
        (40.0, 2.5, "first heat", []),
        (20.0, 4.0, "first", ["heat"]),  # whatever else drifts, as a load that changes, may pass for heat
        (40.0, 4.0, "first", ["heat"]),
    ],
)
def test_a_trend_is_named_only_where_next_to_nothing_is_left(
    monkeypatch: pytest.MonkeyPatch, alone: float, left: float, named: str, struck_off: list[str]
) -> None:
    """The error is 90 times the noise without any effect."""
    errors = {"": 90.0, "first": alone, "first heat": left}
    found, _ = _conclude(monkeypatch, _Searched("", "first", "first heat"), errors, {})
    assert found.fitted.name == named  # type: ignore[attr-defined]
    assert len(found.notes) == len(struck_off)
    assert all(note.startswith(words) for note, words in zip(found.notes, struck_off, strict=True))


def test_ctrl_c_while_effects_are_judged_keeps_them(monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(*_: object) -> SimpleNamespace:
        raise KeyboardInterrupt

    search = _Searched("", "first")
    monkeypatch.setattr(sparse, "fewest_parameters", stopped)
    found = conclude.conclude(search)  # type: ignore[arg-type]
    assert found.fitted.name == "first"  # type: ignore[attr-defined]
    assert found.rivals == {"first": []}
    assert search.interrupted


@given(st.lists(st.floats(0.9, 1e4), min_size=4, max_size=4))
def test_what_is_concluded_predicts_validation_data_no_worse_than_what_was_there(errors: list[float]) -> None:
    """Found, the same in coarse steps, recalibrated, as given; at the noise all are as good."""
    found, *others = (_fitted(name) for name in ("a", "a", "", ""))
    known = {id(fitted): error for fitted, error in zip((found, *others), errors, strict=True)}
    search: Any = SimpleNamespace(partition=SimpleNamespace(validation=None))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(judge, "error_on", lambda _, fitted: known[id(fitted)])
        best = judgement._best(search, Conclusion(cast("Fit", found)), cast("list[Fit]", others))
    reached = known[id(best.fitted)]
    assert reached <= max(min(errors), SCORE.at_floor)
    assert (best.fitted is found) == (errors[0] <= max(min(errors), SCORE.at_floor))
    dropped = bool(found.structure.terms) and not best.fitted.structure.terms
    assert bool(best.notes) == dropped
