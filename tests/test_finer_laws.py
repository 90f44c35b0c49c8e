"""A law of any shape made finer: it begins as it was, and is as fine in the end as predictions ask for."""

from __future__ import annotations

import numpy as np
import pytest
import sim2real_rigs
from hypothesis import given, settings
from hypothesis import strategies as st

from dipc_gym import mjcf
from dipc_gym.sim2real import catalogue, diagnose
from dipc_gym.sim2real.effects.base import Effect
from dipc_gym.sim2real.effects.friction_hysteresis import Hysteresis
from dipc_gym.sim2real.effects.friction_position_law import FrictionOfPosition
from dipc_gym.sim2real.effects.friction_speed import FrictionOfSpeed
from dipc_gym.sim2real.effects.load_position_law import ForceOfPosition
from dipc_gym.sim2real.effects.motor_map import CommandMap
from dipc_gym.sim2real.effects.surfaces import Surface
from dipc_gym.sim2real.effects.unknown_force import UnknownForce

ALONG = {
    FrictionOfPosition: (-0.3, 0.2),
    ForceOfPosition: (-1.0, 3.0),
    FrictionOfSpeed: (0.0, 0.8),
    CommandMap: (-9.0, 7.0),
}


@settings(max_examples=40, deadline=None)
@given(data=st.data(), kind=st.sampled_from(sorted(ALONG, key=lambda one: one.__name__)), times=st.integers(1, 6))
def test_a_law_made_finer_is_the_same_law(data: st.DataObject, kind: type, times: int) -> None:
    low, high = ALONG[kind]
    inner = data.draw(st.lists(st.floats(0.05, 0.95), max_size=4, unique_by=lambda x: round(x, 2)))
    knots = low + (high - low) * np.array([0.0, *sorted(inner), 1.0])
    law = kind(knots.tolist(), data.draw(st.lists(st.floats(0.1, 5.0), min_size=len(knots), max_size=len(knots))))
    begun = law
    for _ in range(times):
        for finer, _ in begun.finer(begun.guess):
            begun = finer
    assert set(law.knots) <= set(begun.knots)
    assert len(begun.knots) <= 2**times * len(knots)
    at = np.linspace(low, high, 301)
    np.testing.assert_allclose(np.interp(at, begun.knots, begun.first), np.interp(at, law.knots, law.first), atol=1e-12)
    assert np.diff(begun.knots).min() > 0
    old = [p for p, knot in zip(begun.parameters, begun.knots, strict=True) if knot in law.knots]
    assert all(p.sigma >= max(q.sigma for q in begun.parameters) for p in old)  # what is new holds on to where it was


@pytest.mark.parametrize("shape", [(3,), (3, 4)])
def test_an_unknown_force_is_made_finer_along_either_input(shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(0)
    names, knots = (
        ("position cart", "velocity cart")[: len(shape)],
        tuple(np.sort(rng.uniform(-1, 1, n)) for n in shape),
    )
    law = UnknownForce(Surface(names, knots, rng.normal(size=shape)), 1.0, ("m", "m/s"), "cart")
    found = law.finer(law.first)
    assert [finer.shape.levels.shape for finer, _ in found] == [(5,)] if len(shape) == 1 else [(5, 4), (3, 7)]
    for axis, (finer, values) in enumerate(found):
        assert isinstance(finer, UnknownForce)
        assert finer.shape is not None
        kept = np.isin(finer.shape.knots[axis], knots[axis])
        np.testing.assert_array_equal(np.compress(kept, finer.shape.levels, axis=axis), law.shape.levels)
        assert list(values.values()) == finer.shape.levels.ravel().tolist()


def test_elements_that_are_added_bear_nothing_yet() -> None:
    law = Hysteresis([0.01, 0.1], [2.0, 3.0])
    ((finer, values),) = law.finer(law.guess)
    assert isinstance(finer, Hysteresis)
    along = np.linspace(0, 0.5, 200)
    np.testing.assert_allclose(
        np.interp(along, *finer.curve(values)), np.interp(along, *law.curve(law.guess)), atol=1e-12
    )
    (finest,) = (one for one, _ in finer.finer(values))
    assert not finest.finer(finest.guess)  # a dozen are enough


def test_what_has_no_shape_has_no_finer_one() -> None:
    plain: list[Effect] = [effect for effect in catalogue().values() if not effect.free]
    assert all(not effect.finer({p.name: 1.0 for p in effect.parameters}) for effect in plain)


def test_a_stiff_spot_two_centimetres_wide_is_named_and_modelled() -> None:
    """Forces from an encoder show it far wider; the windows do not."""
    runs = [sim2real_rigs.rail(sim2real_rigs.StiffSpot(), seed) for seed in (1, 2)]
    found = diagnose(mjcf.from_text(sim2real_rigs.RAIL), runs)
    named = [(effect.effect, effect.at) for effect in found.missing if effect.effect != "unknown"]
    assert named == [("friction.position", "cart")], found.sentence
    assert found.held_out is not None
    assert found.held_out.recalibrated > 100, found.sentence
    assert found.held_out.improved < 3, found.sentence
    law = next(effect.law for effect in found.missing if effect.effect == "friction.position")
    assert law is not None
    (along,), levels = [one["knots"] for one in law["table"]["inputs"]], law["table"]["levels"]
    assert along[int(np.argmax(levels))] == pytest.approx(0.05, abs=0.005)
    assert max(levels) == pytest.approx(8.0, abs=1.0)
    assert np.median(levels) == pytest.approx(2.0, abs=0.2)


def test_friction_with_memory_is_made_finer_where_it_is_hidden() -> None:
    """Bouc and Wen's operator, of which elements that slip are an approximation: more of them, a better one."""
    runs = [sim2real_rigs.rail(sim2real_rigs.Hysteresis(6.0, 4e-3), seed) for seed in (1, 2)]
    found = diagnose(mjcf.from_text(sim2real_rigs.RAIL), runs, effects=[catalogue()["friction.hysteresis"]])
    assert [effect.effect for effect in found.missing if effect.effect != "unknown"] == ["friction.hysteresis"]
    assert not any("could not be worked out" in note for note in found.notes), found.notes
    assert found.held_out is not None
    assert found.held_out.improved < 0.2 * found.held_out.recalibrated, found.sentence
