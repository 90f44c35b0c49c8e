"""Friction that grows at rest: what rests tell of it, and fits where a joint breaks away at one step or another."""

from __future__ import annotations

import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sim2real_rigs import CART, RK4, hidden_on_a_cart, prepared, record

from dipc_gym import mjcf, physics, recording
from dipc_gym.mjcf.edit import Document
from dipc_gym.physics import formulas
from dipc_gym.sim2real import catalogue
from dipc_gym.sim2real.effects.friction_resting import likely
from dipc_gym.sim2real.effects.friction_resting_law import RestingOfAnyLaw
from dipc_gym.sim2real.effects.shared.rests import Rests
from dipc_gym.sim2real.estimation import unexplained
from dipc_gym.sim2real.estimation.fit import fit
from dipc_gym.sim2real.model.structure import Term
from dipc_gym.sim2real.simulation.batch import Stepping

LEVEL, RISE, TIME, SLOW = 1.5, 2.0, 0.12, 3e-4
LONGEST, SOON = 0.5, 0.05


def law(rested: float, rises: list[float], speed: float = 0.0, slides: float = 0.0) -> float:
    now = replace(formulas.moment(0.0), speed=np.asarray(speed), memory=np.asarray(rested), slides=np.asarray(slides))
    return float(formulas.friction_rested_by_law(np.array([LEVEL, LONGEST, SOON, SLOW, *rises]), now))


@given(st.floats(0.0, 5.0), st.floats(0.0, 5.0), st.lists(st.floats(0.0, 1.0), min_size=1, max_size=8))
def test_it_never_falls_while_a_joint_rests(one: float, other: float, grows: list[float]) -> None:
    rises = [0.0, *np.cumsum(grows)]
    short, long = sorted((one, other))
    assert law(long, rises) >= law(short, rises) - 1e-12
    assert law(LONGEST, rises) == pytest.approx(LEVEL + rises[-1])
    assert law(100 * LONGEST, rises) == pytest.approx(LEVEL + rises[-1])


def test_what_rest_adds_is_gone_in_motion_and_at_once_where_a_joint_is_known_to_slide() -> None:
    assert law(LONGEST, [0.0, 1.0, 1.5]) == pytest.approx(LEVEL + 1.5)
    assert law(LONGEST * SOON / (LONGEST + 2 * SOON), [0.0, 1.0, 1.5]) == pytest.approx(LEVEL + 1.0)
    for speed in (SLOW, -SLOW, 1.0):
        assert law(LONGEST, [0.0, 1.0, 1.5], speed) == pytest.approx(LEVEL)
    assert law(LONGEST, [0.0, 1.0, 1.5], slides=1.0) == pytest.approx(LEVEL)
    data, now = np.array([LEVEL, RISE, TIME, SLOW]), replace(formulas.moment(0.0), memory=np.asarray(0.3))
    assert formulas.friction_rested(data, now) == pytest.approx(LEVEL + RISE * -np.expm1(-0.3 / TIME))
    assert formulas.friction_rested(data, replace(now, slides=np.asarray(1.0))) == pytest.approx(LEVEL)


def ramps(t: float) -> float:
    """Rests of several lengths, each ended by a voltage that grows; to and fro in between."""
    part, phase = divmod(t, 0.8)
    pause = 0.05 * 1.6 ** (part % 6)
    way = 1.0 if part % 2 else -1.0
    if phase < 0.25:
        return way * 4.5 * np.sin(np.pi * phase / 0.25)
    return way * 9.0 * max(phase - 0.25 - pause, 0.0)


def rig() -> physics.Physics:
    document = Document(mjcf.from_text(CART))
    values = {"level": LEVEL, "rise": RISE, "time": TIME, "slow": SLOW}
    catalogue()["friction.resting"].edit(document, "cart", values)
    return physics.load(document.text())


@pytest.fixture(scope="module")
def run() -> recording.Recording:
    return record(rig(), ramps, 20.0, noise=(1e-5,), step=1e-4)


@pytest.mark.parametrize("known", [False, True])
def test_rests_bound_what_holds_a_joint(run: recording.Recording, known: bool) -> None:
    """From below by what was withstood, and from above by what ended them; with friction that is known as without."""
    ready = prepared(CART, [run])
    document = Document(mjcf.from_text(CART))
    if known:
        catalogue()["friction.coulomb"].edit(document, "cart", {"level": LEVEL})
    scene = unexplained.scene(physics.load(document.text()), [run], ready.motions)
    found = Rests.of(scene.at("joint", "cart", {"cart": LEVEL} if known else {}))
    assert len(found.rested) >= 12
    assert found.level == pytest.approx(LEVEL, rel=0.05)

    def held(ages: np.ndarray) -> np.ndarray:
        return LEVEL + RISE * -np.expm1(-ages / TIME)

    assert np.mean(found.held < held(found.ages) + 0.1) > 0.97
    between = (found.before < held(found.rested) + 0.15) & (held(found.rested) < found.broke + 0.15)
    assert np.mean(between) > 0.7
    rise, time = likely(found)[0]
    assert held(np.array([0.1, 0.4])) == pytest.approx(LEVEL + rise * -np.expm1(-np.array([0.1, 0.4]) / time), rel=0.1)


def test_a_fit_searches_where_slopes_tell_nothing(run: recording.Recording) -> None:
    """A rise and a time that are off by half: readings change by steps, if at all."""
    ready = prepared(CART, [run], stepping=Stepping(0.001, RK4))
    begin = {"level": LEVEL, "rise": 0.7 * RISE, "time": 1.5 * TIME, "slow": SLOW}
    follows = copy.copy(catalogue()["friction.resting"])
    follows.by_steps = ()  # type: ignore[misc]
    found, stays = (
        fit(ready.problem, ready.structure.with_term(Term(effect, "cart", begin)))
        for effect in (catalogue()["friction.resting"], follows)
    )
    assert found.error < 2.0
    assert stays.error > 4 * found.error
    as_it_is = ready.structure.with_term(Term(catalogue()["friction.resting"], "cart", begin))
    assert np.array_equal(fit(ready.problem, as_it_is, most=0).z, as_it_is.first)  # what is only to be judged stays


def test_rests_that_tell_of_no_growth_make_a_guess_all_the_same() -> None:
    """Friction that is withstood up to its level and never beyond, and none at all."""
    ages = np.array([0.01, 0.1, 0.3])
    rests = Rests(LEVEL, ages, 0.5 + 0 * ages, ages, LEVEL + np.array([0.1, 0.2, 0.3]), 0.5 + 0 * ages)
    for rise, time in likely(rests):
        assert 0 <= rise < 1.0
        assert time > 0
    assert not rests._replace(level=0.0).tell
    assert not rests._replace(rested=ages[:2]).tell


def test_a_law_finds_what_the_exponential_cannot_say(tmp_path: Path) -> None:
    """Hidden by a simulator that is written apart: it grows by a stretched exponential, fast at first and for long."""
    ready, evidence = hidden_on_a_cart(tmp_path, "friction.resting")
    shaped, begin = catalogue()["friction.resting:law"].proposals(evidence)[0]
    found = fit(ready.problem, ready.structure.with_term(Term(shaped, "cart", begin)))
    plain = catalogue()["friction.coulomb"]
    without = min(
        (fit(ready.problem, ready.structure.with_term(Term(plain, "cart", one))) for one in plain.guesses(evidence)),
        key=lambda one: one.error,
    )
    assert found.error < 1.02 < 1.15 < without.error
    (term,) = found.structure.terms
    values = found.structure.term_values(found.z, term)
    assert isinstance(term.effect, RestingOfAnyLaw)
    assert "grows at rest by a law of its own" in term.effect.sentence("cart", values, {"level": "N"})
    table = term.effect.law_of(values, {"level": "N"})
    assert table["table"]["inputs"][0]["unit"] == "s"
    assert np.all(np.diff(table["table"]["levels"]) >= 0)
