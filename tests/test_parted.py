"""Friction that depends on direction as two effects, and as one again."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_diagnose import NOMINAL, run

from dipc_gym import mjcf
from dipc_gym.sim2real.effects import catalogue
from dipc_gym.sim2real.estimation.fit import Fit, fit
from dipc_gym.sim2real.estimation.problem import Problem
from dipc_gym.sim2real.model.parameters import Wishes
from dipc_gym.sim2real.model.structure import Structure, Term, carry, names
from dipc_gym.sim2real.selection.case import part
from dipc_gym.sim2real.selection.parted import joined, parted
from dipc_gym.sim2real.verdict.withheld import gather

EFFECTS = list(catalogue().values())


@pytest.fixture(scope="module")
def uneven() -> tuple[Problem, Fit]:
    """A cart with 4 N of friction forwards and 2 N backwards."""
    given, _ = gather(mjcf.from_text(NOMINAL), [run(1, 12, 3.0)], (), Wishes())
    prepared = part(given, threads=1).prepared
    problem = prepared.problem.pick(np.arange(0, len(prepared.problem.windows), 4))
    term = Term(catalogue()["friction.asymmetric"], "cart", {"forward": 4.0, "backward": 2.0})
    return problem, fit(problem, prepared.structure.with_term(term), most=0)


def as_it_is(problem: Problem, fitted: Fit, structure: Structure) -> Fit:
    """A structure with the parameters of a fit."""
    return fit(problem, structure, carry(fitted.structure, fitted.z, structure), fitted.initial, most=0)


def test_parted_and_joined_it_predicts_the_same(uneven: tuple[Problem, Fit]) -> None:
    problem, fitted = uneven
    apart = as_it_is(problem, fitted, parted(fitted, EFFECTS)[0])
    assert names(apart.structure.terms) == ["friction.coulomb@cart", "load.constant@cart"]
    values = apart.structure.values(apart.z)
    assert values["friction.coulomb@cart.level"] == pytest.approx(3.0)
    assert values["load.constant@cart.force"] == pytest.approx(-1.0)
    assert apart.mse == pytest.approx(fitted.mse, rel=1e-6)
    again = as_it_is(problem, apart, joined(apart, ["cart"], EFFECTS))
    assert again.structure.values(again.z) == pytest.approx(fitted.structure.values(fitted.z))


def test_what_was_elaborated_or_not_asked_for_stays(uneven: tuple[Problem, Fit]) -> None:
    problem, fitted = uneven
    assert parted(fitted, [catalogue()["friction.asymmetric"]])[0] is fitted.structure
    apart = as_it_is(problem, fitted, parted(fitted, EFFECTS)[0])
    rests = Term(catalogue()["friction.resting"], "cart", {"level": 3.0, "rise": 1.0, "time": 0.1, "slow": 1e-3})
    structure = apart.structure.without("friction.coulomb@cart").with_term(rests)
    elaborated = fit(problem, structure, most=0)
    assert joined(elaborated, ["cart"], EFFECTS) is elaborated.structure
    pulled = replace(
        apart.structure, terms=(Term(apart.structure.terms[0].effect, "cart", {"level": 0.5}), apart.structure.terms[1])
    )
    assert joined(fit(problem, pulled, most=0), ["cart"], EFFECTS).terms == pulled.terms
