"""Which parameters of a model are said to be wrong: the fewest, and never against what its owner knows."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from test_diagnose import NOMINAL, run

from dipc_gym import mjcf
from dipc_gym.sim2real import diagnosis
from dipc_gym.sim2real.effects import catalogue
from dipc_gym.sim2real.estimation.fit import Fit
from dipc_gym.sim2real.model.parameters import Wishes
from dipc_gym.sim2real.selection.baseline import baseline
from dipc_gym.sim2real.selection.case import part
from dipc_gym.sim2real.selection.search import Searched
from dipc_gym.sim2real.selection.stop import Stop
from dipc_gym.sim2real.verdict import sparse
from dipc_gym.sim2real.verdict.settings import VERDICT
from dipc_gym.sim2real.verdict.withheld import gather


@pytest.fixture(scope="module")
def heavy() -> tuple[Searched, Fit]:
    """A cart with dry friction, of which the owner knows that it weighs more than the model says.

    Mass, damping and gear scale together, so that nothing in the recording speaks for any mass.
    """
    wishes = Wishes(prior={"cart.mass": (1.5, 0.05)})
    case = part(gather(mjcf.from_text(NOMINAL), [run(3, 20, 4.0)], (), wishes)[0], threads=1)
    search, _ = diagnosis.begin_search(case, baseline(case), [catalogue()["friction.coulomb"]], Stop(print))
    found = search.run()
    assert found.error < 1.05
    return search.outcome, found


def test_what_is_put_back_to_nominal_is_foretold(heavy: tuple[Searched, Fit]) -> None:
    """The others go no further than they may, and as far as a refit takes them."""
    search, found = heavy
    reduced = sparse._Reduced(search, found)
    for count in range(1, reduced.count + 1):
        for free in itertools.combinations(range(reduced.count), count):
            again = reduced.refitted(free)
            assert again is not None
            loss = np.mean(np.log1p(again.mse))
            assert reduced.foretold(free)[0] == pytest.approx(loss, rel=0.1), free


def test_what_the_owner_knows_is_not_put_back_to_nominal(heavy: tuple[Searched, Fit]) -> None:
    fewest = sparse.fewest_parameters(*heavy)
    values = fewest.structure.values(fewest.z)
    assert values["cart.mass"] == pytest.approx(1.5, abs=0.1)
    assert fewest.error < 1.05
    for other in sparse.other_parameters(*heavy, fewest):
        assert "cart.mass" in other.structure.values(other.z)


@pytest.mark.parametrize("chosen", [(1,), (0, 2), (0, 1, 2, 4)])
def test_every_other_choice_of_as_many_is_thought_of(chosen: tuple[int, ...]) -> None:
    thought_of = list(sparse._exchanged([i in chosen for i in range(6)]))
    assert sorted(thought_of) == [free for free in itertools.combinations(range(6), len(chosen)) if free != chosen]


@pytest.mark.parametrize(("count", "chosen"), [(24, 12), (60, 20), (400, 100)])
def test_where_choices_are_millions_those_that_share_most_are_taken(count: int, chosen: int) -> None:
    """A table of them would take hours."""
    thought_of = list(sparse._exchanged([i < chosen for i in range(count)]))
    assert all(len(free) == chosen for free in thought_of)
    assert len(set(thought_of)) == len(thought_of) >= chosen * (count - chosen)
    assert len(thought_of) <= max(VERDICT.choices, chosen * (count - chosen))
