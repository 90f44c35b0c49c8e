"""Names beside laws of no kind, on a cart with friction."""

from __future__ import annotations

import numpy as np
import pytest
from test_diagnose import run
from test_search import begun

from dipc_gym.sim2real.effects import catalogue
from dipc_gym.sim2real.effects.shared.surfaces import Surface
from dipc_gym.sim2real.effects.unknown_force import UnknownForce
from dipc_gym.sim2real.estimation.fit import Fit, fit
from dipc_gym.sim2real.model.structure import Term, names
from dipc_gym.sim2real.selection import beside
from dipc_gym.sim2real.selection.hypotheses import Phase
from dipc_gym.sim2real.selection.score import compare
from dipc_gym.sim2real.selection.search import Search
from dipc_gym.sim2real.selection.settings import SEARCH
from dipc_gym.sim2real.verdict import sentences
from dipc_gym.sim2real.verdict.conclude import conclude, divided_over

DRY = 3.0  # N
VELOCITIES = np.array([-0.4, -2e-3, 2e-3, 0.4])


@pytest.fixture(scope="module")
def search() -> Search:
    """One that has not begun, of friction that is uneven along the way."""
    return begun([run(3, 20, DRY, uneven=(0.5, 0.02))], ("friction.coulomb", "residual.force"))


def shared(search: Search, *, dry: float, tabled: float, over: str = "velocity cart") -> Fit:
    """A fit in which friction and a table over velocity begin with these parts of it, N."""
    bare = search.progress.path[0]
    shape = Surface((over,), (VELOCITIES,), -tabled * np.sign(VELOCITIES))
    law = UnknownForce(shape, 1.0, ("m/s",), "cart")
    structure = bare.structure.with_term(Term(law, "cart", law.first))
    if dry:
        structure = structure.with_term(Term(catalogue()["friction.coulomb"], "cart", {"level": dry}))
    return fit(search.partition.problem, structure, None, bare.initial)


def parts(fitted: Fit) -> tuple[float, float]:
    """Level of friction, and the largest of the table, N."""
    values = fitted.structure.values(fitted.z)
    table = [abs(value) for key, value in values.items() if key.startswith("residual")]
    return values["friction.coulomb@cart.level"], max(table)


def test_a_table_beside_friction_does_only_what_friction_does_not(search: Search) -> None:
    """It begins with half of it, and a fit leaves it about that: data say the same of any proportion."""
    bare, both = search.progress.path[0], shared(search, dry=DRY / 2, tabled=DRY / 2)
    assert parts(both)[1] > DRY / 4
    told = list[str]()
    least = beside.least(search.question, search.fitter, both, bare, told.append)
    assert len(told) == 1
    friction, table = parts(least)
    assert friction == pytest.approx(DRY, rel=0.1)
    assert table < DRY / 6
    assert search.scorer.comparison_error(least) < 1.1 * search.scorer.comparison_error(both)


def test_without_a_name_or_without_a_law_there_is_nothing_to_share(search: Search) -> None:
    bare = search.progress.path[0]
    table = shared(search, dry=0.0, tabled=DRY)
    named = search.fitter.without(shared(search, dry=DRY / 2, tabled=DRY / 2), "residual.force@cart")
    for one in (table, named):
        assert beside.names_alone(search.fitter, one, bare) is None
        assert beside.least(search.question, search.fitter, one, bare, print) is one


def test_a_name_that_leaves_most_of_it_does_not_go_before_a_law() -> None:
    """On a stiff spring friction is a small part of what is missing."""
    stiff = begun([run(3, 20, 0.3, spring=400.0)], ("friction.coulomb", "residual.force"))
    bare, places = stiff.progress.path[0], np.array([-0.5, 0.5])
    law = UnknownForce(Surface(("position cart",), (places,), -400.0 * places), 1.0, ("m",), "cart")
    structure = bare.structure.with_term(Term(law, "cart", law.first))
    structure = structure.with_term(Term(catalogue()["friction.coulomb"], "cart", {"level": 0.3}))
    both = fit(stiff.partition.problem, structure, None, bare.initial)
    assert beside.names_alone(stiff.fitter, both, bare) is None


def friction_found(friction: float, forward: float, uneven: float) -> tuple[Search, tuple[Fit, ...]]:
    """A search in which formulas came to dry friction, and their path."""
    run_1 = run(3, 20, friction, forward=forward, uneven=(uneven, 0.02))
    search = begun([run_1], ("friction.coulomb", "residual.force"))
    bare = search.progress.path[0]
    structure = bare.structure.with_term(Term(catalogue()["friction.coulomb"], "cart", {"level": friction}))
    formulas = (bare, fit(search.partition.problem, structure, None, bare.initial))
    search.phase = Phase.NO_KIND
    search.journal.go_back(formulas)
    return search, formulas


def modelled(friction: float, forward: float, uneven: float) -> list[str]:
    """What a search ends with if no law earns its place beside friction; only those that stand alone are asked."""
    search, formulas = friction_found(friction, forward, uneven)
    add, alone = search._add, list[Fit]()

    def only_alone(most: int, **named: bool) -> Fit:
        if search.progress.path[1:]:
            return search.progress.current
        alone.append(add(most, **named))
        return alone[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(search, "_add", only_alone)
        end = search._modelled([search.progress.path], formulas)
    assert len(alone) == 1
    assert end is search.progress.current
    assert search.scorer.comparison_error(end) <= search.scorer.comparison_error(formulas[-1])
    return names(end.structure.terms)


def test_names_stand_before_laws_that_leave_far_less_alone() -> None:
    """Friction explains most, and the law beside it drag in forward motion; how uneven friction is, neither says."""
    assert modelled(DRY, 0.4, uneven=0.1) == ["friction.coulomb@cart", "residual.force@cart"]


def test_laws_stand_alone_where_names_explain_little() -> None:
    assert modelled(0.1, 20.0, uneven=0.0) == ["residual.force@cart"]


def test_names_stand_alone_where_laws_leave_as_much() -> None:
    """How uneven friction is, a table without a name does not say any better."""
    assert modelled(DRY, 0.0, uneven=0.5) == ["friction.coulomb@cart"]


def test_what_was_found_is_not_lost_where_laws_are_asked_without_it(monkeypatch: pytest.MonkeyPatch) -> None:
    search, formulas = friction_found(DRY, 0.4, uneven=0.1)

    def broken(most: int, **named: bool) -> Fit:
        if search.progress.path[1:]:
            return search.progress.current
        raise ValueError("math domain error")

    monkeypatch.setattr(search, "_add", broken)
    with pytest.raises(ValueError, match="math domain"):
        search._modelled([search.progress.path], formulas)
    assert names(search.progress.current.structure.terms) == ["friction.coulomb@cart"]


def test_friction_keeps_its_name_beside_a_table_that_could_do_the_same(search: Search) -> None:
    """Without it the table does what it did, and nothing is lost."""
    bare, both = search.progress.path[0], shared(search, dry=DRY / 2, tabled=DRY / 2)
    assert search.scorer.compare(both, search.fitter.without(both, "friction.coulomb@cart")).gain < 0.1
    alone = search.fitter.without(both, "residual.force@cart")
    outcome = begun([run(3, 20, DRY, uneven=(0.5, 0.02))], ("friction.coulomb", "residual.force"))
    outcome.journal.accept(alone)
    outcome.journal.accept(both)
    assert bare.error > 2 * alone.error
    concluded = conclude(outcome.outcome)[1]
    assert "friction.coulomb@cart" not in concluded.unnamed


@pytest.mark.parametrize(
    ("after", "divided"),
    [
        ([50.0, 50.0, 50.0, 50.0], False),  # better throughout
        ([100.0, 100.0, 20.0, 100.0], False),  # where it acts, and nowhere else
        ([150.0, 60.0, 140.0, 50.0], True),  # better here and worse there
        ([150.0, 140.0, 130.0, 160.0], True),
        ([100.0, 100.0, 100.0, 100.0], False),
    ],
)
def test_a_law_without_a_name_goes_where_validation_data_are_divided_over_it(after: list[float], divided: bool) -> None:
    """Mean square errors of three windows in each of four seconds, 100 without the law."""
    blocks = np.repeat(np.arange(4), 3)
    gained = compare(np.repeat(after, 3), np.full(12, 100.0), blocks)
    assert divided_over(gained) is divided


@pytest.mark.parametrize(("gain", "words"), [(0.1, "by 5 % better"), (-0.2, "no better")])
def test_the_note_says_how_divided_they_are(gain: float, words: str) -> None:
    law = UnknownForce(Surface(("velocity cart",), (VELOCITIES,), VELOCITIES), 1.0, ("m/s",), "cart")
    said = sentences.divided(Term(law, "cart", law.first), gain)
    assert said.startswith("residual.force@cart would explain more")
    assert words in said


@pytest.mark.parametrize(("drag", "kept"), [(20.0, "residual.force@cart"), (0.0, "friction.coulomb@cart")])
def test_laws_of_a_kind_are_given_up_where_one_of_no_kind_alone_leaves_far_less(
    drag: float, kept: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two of a kind are taken to have come to what dry friction alone leaves, more of them would be asked for then."""
    search, formulas = friction_found(0.1 if drag else DRY, drag, uneven=0.0 if drag else 0.5)
    add, asked = search._add, list[int]()

    def of_a_kind(most: int = SEARCH.most_effects, **named: bool) -> Fit:
        if search.phase == Phase.NO_KIND:
            return add(most, **named)
        asked.append(most)
        if len(asked) == 1:
            search.journal.accept(formulas[-1])
            search.journal.accept(formulas[-1])
        return search.progress.current

    monkeypatch.setattr(search, "_add", of_a_kind)
    end = search._with_laws(formulas)
    assert asked[0] == SEARCH.kinds_lead
    assert len(asked) == (1 if drag else 3)  # more laws, and laws beside formulas
    assert kept in names(end.structure.terms)
