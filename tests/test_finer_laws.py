"""A law of any shape made finer: it begins as it was, and is as fine in the end as predictions ask for."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import sim2real_rigs
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import RegularGridInterpolator
from sim2real_rigs import CART, prepared, record, sweep

from dipc_gym import mjcf, physics
from dipc_gym.mjcf.edit import Document
from dipc_gym.recording import Recording
from dipc_gym.sim2real import catalogue, diagnose
from dipc_gym.sim2real.effects.friction_hysteresis import Hysteresis
from dipc_gym.sim2real.effects.friction_position_law import FrictionOfPosition
from dipc_gym.sim2real.effects.friction_speed import FrictionOfSpeed
from dipc_gym.sim2real.effects.friction_time import FrictionOfTime
from dipc_gym.sim2real.effects.load_position_law import ForceOfPosition
from dipc_gym.sim2real.effects.motor_map import CommandMap
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence
from dipc_gym.sim2real.effects.shared.law import BENT
from dipc_gym.sim2real.effects.shared.settings import LAWS
from dipc_gym.sim2real.effects.shared.surfaces import Surface, surfaces
from dipc_gym.sim2real.effects.unknown_force import UnknownForce
from dipc_gym.sim2real.estimation.fit import fit
from dipc_gym.sim2real.model.structure import Term
from dipc_gym.sim2real.selection.resolution import _passed as passed
from dipc_gym.sim2real.selection.resolution import within_data
from dipc_gym.sim2real.selection.scorer import Scorer

AS_IT_COMES = 1e-6  # s, a width that leaves every sample alone

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
    off = times * BENT * max(law.first) if kind is FrictionOfSpeed else 0.0  # see the test after this one
    if kind is not CommandMap:
        np.testing.assert_allclose(
            np.interp(at, begun.knots, begun.first), np.interp(at, law.knots, law.first), rtol=1e-12, atol=1e-12 + off
        )
    assert np.diff(begun.knots).min() > 0
    old = [p for p, knot in zip(begun.parameters, begun.knots, strict=True) if knot in law.knots]
    assert all(p.sigma >= max(q.sigma for q in begun.parameters) for p in old)  # what is new holds on to where it was


@given(bend=st.floats(-0.2, 0.2), slope=st.floats(-3.0, 3.0), knots=st.lists(st.floats(0.02, 0.98), max_size=6))
def test_a_map_is_a_curve(bend: float, slope: float, knots: list[float]) -> None:
    """Straight where its values are; parabolas wherever they lie on one, but at its ends, where neighbours lack."""
    x = 7.0 * np.unique(np.round([-0.5, -0.25, 0.0, *knots, 1.0, 1.25, 1.5], 2))
    straight, bent = (CommandMap(x.tolist(), (slope * x + b * x**2).tolist()) for b in (0.0, bend))
    at, levels = straight.written(straight.guess)
    np.testing.assert_allclose(levels, slope * at, atol=1e-12)
    at, levels = bent.written(bent.guess)
    inside = (at >= x[1]) & (at <= x[-2])
    np.testing.assert_allclose(levels[inside], (slope * at + bend * at**2)[inside], atol=1e-10)


def test_a_bent_map_is_finer_where_it_was() -> None:
    """New values lie on the curve through the old ones, and `off` finds them there."""
    law = CommandMap([-9.0, -2.0, 0.5, 3.0, 8.0], [-4.0, -2.5, 1.0, 2.0, 2.5])
    [(finer, guess)] = law.finer(law.guess)
    assert isinstance(finer, CommandMap)
    new = ~np.isin(finer.knots, law.knots)
    assert np.count_nonzero(new) == 4
    np.testing.assert_allclose(finer.off(new) @ finer.values(guess), 0.0, atol=1e-12)
    middle = np.array(finer.values(guess))[new]
    assert np.abs(middle - np.interp(np.array(finer.knots)[new], law.knots, law.first)).max() > 0.05  # not on lines


@given(
    low=st.floats(-2.0, 0.1),
    high=st.floats(0.3, 3.0),
    kind=st.sampled_from(["friction", "map"]),
    size=st.floats(0.1, 9),
)
def test_a_law_that_goes_farther_begins_as_it_was(low: float, high: float, kind: str, size: float) -> None:
    """Constant from its ends on, or parallel to its input; a table that is long enough stays."""
    law = (FrictionOfPosition if kind == "friction" else CommandMap)([0.0, 0.1, 0.2], [size, 2 * size, 0.5 * size])
    found = law.reaching(law.guess, [(low, high)])
    if found is None:
        assert low > -0.01
        assert high < 0.21
        return
    longer, guess = found
    assert set(law.knots) <= set(longer.knots)
    assert longer.knots[0] <= min(low, 0.0) + 0.01
    assert longer.knots[-1] >= max(high, 0.2) - 0.01
    assert len(longer.knots) <= 3 + 2 * 8 + 2
    values = np.array(longer.values(guess))
    outside = np.array(longer.knots) > 0.2
    goes_on = np.array(longer.knots)[outside] - 0.2 if kind == "map" else 0.0
    np.testing.assert_allclose(values[outside], 0.5 * size + goes_on, rtol=1e-2)
    assert np.all(
        np.diff(values[outside], prepend=0.5 * size) - np.diff(goes_on * np.ones(outside.sum()), prepend=0.0) > 0
    )


@given(
    ends=st.lists(st.floats(0.0, 3.0), min_size=4, max_size=4),
    levels=st.lists(st.floats(-5.0, 5.0), min_size=6, max_size=6),
)
def test_a_law_of_no_kind_goes_farther_along_either_input(ends: list[float], levels: list[float]) -> None:
    """It is what it was where it had data, and on as it ended there; it drives as fast as the joint was seen to go."""
    knots = np.array([-0.5, 0.0, 0.5]), np.array([-1.0, 1.0])
    inputs = ("position cart", "velocity cart")
    law = UnknownForce(Surface(inputs, knots, np.reshape(levels, (3, 2))), 1.2, ("m", "m/s"), "cart")
    spans = [(-ends[0], ends[1]), (-ends[2], ends[3])]
    found = law.reaching(law.first, spans)
    if found is None:
        assert max(ends[:2]) <= 0.53
        assert max(ends[2:]) <= 1.05
        return
    longer, guess = found
    assert isinstance(longer, UnknownForce)
    assert longer.shape is not None
    table = np.reshape([guess[name] for name in longer.first], [len(axis) for axis in longer.shape.knots])
    assert table.size <= LAWS.most_levels
    at = np.random.default_rng(0).uniform(-3, 3, (200, 2))
    was = RegularGridInterpolator(knots, np.reshape(levels, (3, 2)))(np.clip(at, [-0.5, -1.0], [0.5, 1.0]))
    low, high = np.array([[axis[0], axis[-1]] for axis in longer.shape.knots]).T
    np.testing.assert_allclose(
        RegularGridInterpolator(longer.shape.knots, table)(np.clip(at, low, high)), was, atol=1e-9
    )
    assert longer.speed >= max(1.2, 1.2 * max(ends[2:]) - 1e-9)


def test_friction_over_time_is_told_to_the_end_of_the_recordings() -> None:
    """Windows of the last fifth choose nothing of the law's shape, but what is fitted last goes on over them."""
    grows = np.linspace(2.0, 6.0, 41)
    entry = f'<custom><numeric name="dipc_gym:friction.time:cart" data="0 20 {" ".join(map(str, grows))}"/></custom>'
    dry = CART.replace("<joint ", '<joint frictionloss="2" ', 1).replace("</mujoco>", f"{entry}</mujoco>")
    settings = {"noise": sim2real_rigs.NOISE["cart"], "step": 2e-4, "integrator": sim2real_rigs.RK4}
    run, other = (record(physics.load(dry), sweep(strength), 20.0, **settings) for strength in (6.0, 5.0))
    names = ("friction.coulomb", "friction.time")
    found = diagnose(mjcf.from_text(CART), [run], [other], effects=[catalogue()[one] for one in names])
    missing = found.missing[0]  # MuJoCo's friction creeps a little, which something unknown stands for beside it
    assert missing.effect == "friction.time"
    (along,), levels = missing.law["table"]["inputs"], missing.law["table"]["levels"]
    assert along["knots"][-1] > 19.5
    assert np.interp([4.0, 12.0, 19.0], along["knots"], levels) == pytest.approx([2.8, 4.4, 5.8], abs=0.15)


def test_new_knots_of_friction_over_speed_bend_a_little() -> None:
    """A bend is a ramp with a limit. Of a ramp that is nothing no derivative says what more of it would do."""
    law = FrictionOfSpeed([0.0, 0.2, 0.8], [3.0, 2.0, 4.0])
    ((finer, _),) = law.finer(law.guess)
    bends = np.diff(np.diff(finer.first) / np.diff(finer.knots))
    new = np.isin(finer.knots[1:-1], law.knots, invert=True)
    assert np.all(bends[new] < 0)
    assert np.all(np.abs(bends[new]) < 1e-3)


@given(st.lists(st.floats(1e-3, 1.0), min_size=2, max_size=30), st.floats(0.1, 100.0))
def test_a_law_is_held_as_brownian_motion_goes_however_fine_it_is(steps: list[float], size: float) -> None:
    """Off the line between two places it goes by one standard deviation, whatever knots lie there."""
    knots = np.append(0.0, np.cumsum(steps))
    law = ForceOfPosition(knots.tolist(), np.full(len(knots), size).tolist())
    values = size * LAWS.walks * np.sqrt(1 / knots[-1])  # standard deviation after unit way
    covariance = (values / law.parameters[0].step) ** 2 * np.minimum.outer(knots, knots)
    np.testing.assert_allclose(np.diag(law.bends @ covariance @ law.bends.T), 1.0)
    np.testing.assert_allclose(law.bends @ (3.0 + knots), 0.0, atol=1e-9 * np.abs(law.bends).max() * knots[-1])


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
    kinds = ("friction.coulomb", "friction.position", "load.position", "residual")
    likely = [one for one in catalogue().values() if one.id.startswith(kinds)]
    found = diagnose(mjcf.from_text(sim2real_rigs.RAIL), runs, effects=likely)
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


def test_a_table_goes_on_where_nearly_no_samples_are() -> None:
    """A drive that is stronger here than there, whose largest commands never came where it is strongest."""
    rng = np.random.default_rng(0)
    time = np.arange(0.0, 40.0, 0.005)
    place, command = rng.uniform(-0.2, 0.2, len(time)), rng.uniform(-6, 6, len(time))
    command[place > 0.1] /= 4
    found, *_ = surfaces(
        {"command motor": command, "position cart": place}, 3 * command * (place + 0.3), time, AS_IT_COMES
    )
    assert found.inputs == ("command motor", "position cart")
    corner, largest, farthest = found.levels[-1, -1], found.knots[0][-1], found.knots[1][-1]
    assert corner == pytest.approx(3 * largest * (farthest + 0.3), rel=0.3)


def test_inputs_that_tell_nearly_as_much_are_asked_as_well() -> None:
    """A motor that turns nearly as its command says: a drag along the way and a drive that varies look alike."""
    rng = np.random.default_rng(2)
    time = np.arange(0.0, 40.0, 0.005)
    place, command = rng.uniform(-0.2, 0.2, len(time)), rng.uniform(-6, 6, len(time))
    inputs = {"command motor": command, "position cart": place, "velocity cart": command + rng.normal(size=len(time))}
    found = surfaces(inputs, command * np.sin(20 * place), time, AS_IT_COMES)
    assert [set(one.inputs) for one in found[:2]] == [
        {"command motor", "position cart"},
        {"velocity cart", "position cart"},
    ]


def test_a_table_stays_within_what_it_says_of_data() -> None:
    """A force that grows with speed and place, of a joint that is never fast and far: the corners are no wilder."""
    rng = np.random.default_rng(3)
    time = np.arange(0.0, 40.0, 0.005)
    place = rng.uniform(-1, 1, len(time))
    speed = rng.uniform(-1, 1, len(time)) * (1 - np.abs(place))
    force = 5 * place * np.exp(speed)
    found, *_ = surfaces({"velocity cart": speed, "position cart": place}, force, time, AS_IT_COMES)
    assert np.abs(found.levels).max() < 1.3 * np.abs(force).max()


def test_a_joints_own_motion_is_tried_beside_what_tells_most() -> None:
    """Under feedback the command goes with the motion, and tells a force of the motion as well as this does."""
    model = mjcf.compile(mjcf.from_text(sim2real_rigs.CART))
    rng = np.random.default_rng(1)
    time = np.arange(0.0, 40.0, 0.005)
    position, velocity = 0.2 * np.sin(1.3 * time), 0.26 * np.cos(1.3 * time) + 0.3 * np.sin(4 * time)
    inputs = {
        "position cart": position + 1e-3 * rng.normal(size=len(time)),
        "velocity cart": velocity + 0.02 * rng.normal(size=len(time)),
        "command motor": velocity * (1 + 5 * position),
    }
    force, nothing = -3 * velocity * (1 + 5 * position), np.zeros(0)
    evidence = Evidence(
        model,
        force,
        velocity,
        position,
        np.abs(force),
        time,
        nothing,
        nothing,
        0.0,
        1.0,
        0.005,
        at="cart",
        inputs=inputs,
    )
    tried = [effect.shape.inputs for effect, _ in UnknownForce().proposals(evidence)]
    assert "command motor" in tried[0]
    assert set(tried[-1]) == {"position cart", "velocity cart"}


FEW = ("friction.coulomb", "friction.speed", "friction.time", "drag.quadratic")


def warming() -> list[Recording]:
    """Two recordings of a cart whose friction rises by 2.5 N with a time constant of 5 s, in each anew."""
    stamps = np.linspace(0.0, 20.0, 41)
    document = Document(mjcf.from_text(CART))
    hidden = FrictionOfTime(stamps.tolist(), (2.0 + 2.5 * (1 - np.exp(-stamps / 5.0))).tolist())
    hidden.edit(document, "cart", hidden.guess)
    rig = physics.from_model(mjcf.compile(document.text()))
    return [record(rig, sweep(strength), 20.0, noise=(5e-5,)) for strength in (4.0, 5.0)]


def test_friction_over_time_is_known_no_further_than_it_was_seen() -> None:
    """Without a recording that is held out, the ends are: what they show is foretold by no law, and told by a fit."""
    found = diagnose(mjcf.from_text(CART), warming(), effects=[catalogue()[name] for name in FEW])
    assert [(one.effect, one.at) for one in found.missing] == [("friction.time", "cart")], found.sentence
    assert found.verdict == "explained"
    assert found.held_out is not None
    # The last quarter warms up less than the law has it that ends where the fitted data do.
    assert "no law of time foretells" in found.sentence


def test_friction_that_warms_up_is_named_with_its_formula() -> None:
    runs, few = warming(), [catalogue()[name] for name in FEW]
    found = diagnose(mjcf.from_text(CART), runs[:1], runs[1:], effects=few)
    assert [(one.effect, one.at) for one in found.missing if one.effect != "unknown"] == [("friction.time", "cart")]
    law = found.missing[0].law
    assert law is not None
    assert law["of"] == ["time"]
    (term,) = law["formula"]["terms"]
    assert term["kind"] == "exponential"
    assert term["scale"] == pytest.approx(5.0, rel=0.1)
    assert term["factors"][0] == pytest.approx(-2.5, rel=0.05)
    (along,), levels = law["table"]["inputs"], law["table"]["levels"]
    said = law["formula"]["constant"] + term["factors"][0] * np.exp(-np.array(along["knots"]) / term["scale"])
    np.testing.assert_allclose(levels, said, rtol=1e-6)  # what is written is what is said
    assert found.held_out is not None
    assert found.held_out.improved < 1.2 < 0.05 * found.held_out.recalibrated
    assert found.to_dict()["needs_dipc_gym"]
    assert bool(found.needs_loader) == bool(physics.load(found.improved).extras)


@given(
    told=st.lists(st.booleans(), min_size=6, max_size=6),
    kind=st.sampled_from(sorted(ALONG, key=lambda one: one.__name__)),
)
def test_a_law_without_ends_that_no_data_tell_is_the_same_between_them(told: list[bool], kind: type) -> None:
    law = kind(np.linspace(*ALONG[kind], 6).tolist(), [1.0, 3.0, 2.0, 5.0, 4.0, 9.0])
    found = law.shortened(law.guess, np.array(told))
    known = [k for k in range(6) if told[k] or (k == 0 and kind is FrictionOfSpeed)]  # friction begins at rest
    if len(known) < 2 or known[-1] - known[0] == 5:
        assert found is None
        return
    shorter, begin = found
    assert shorter.knots == law.knots[known[0] : known[-1] + 1]
    assert shorter.values(begin) == list(law.first[known[0] : known[-1] + 1])


def test_a_table_ends_where_data_do() -> None:
    """Whatever it was guessed to say beyond: there it stays as it is where data end."""
    document = Document(mjcf.from_text(CART))
    catalogue()["friction.coulomb"].edit(document, "cart", {"level": 3.0})
    run = record(physics.from_model(mjcf.compile(document.text())), sweep(6.0), noise=(1e-5,))
    ready = prepared(CART, [run])
    moved = ready.motions[0].position[:, 0]
    knots = [*np.linspace(moved.min(), moved.max(), 4), moved.max() + 1.0, moved.max() + 2.0]
    law = FrictionOfPosition(knots, [3.0, 3.0, 3.0, 3.0, 3.0, 9.0])
    fitted = fit(ready.problem, ready.structure.with_term(Term(law, "cart", law.guess)), most=0)
    structure, z = within_data(fitted)
    (term,) = structure.terms
    assert term.effect.knots == pytest.approx(knots[:4])
    assert fit(ready.problem, structure, z, most=0).error == pytest.approx(fitted.error, rel=1e-6)
    assert within_data(fit(ready.problem, structure, z, most=0)) is None


def test_few_windows_where_the_rig_seldom_was_make_a_law_finer(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two of forty windows tell of a law that the others do not reach; what helps them at others' cost is no such."""
    blocks = np.arange(40) // 2
    monkeypatch.setattr(Scorer, "mse", lambda _, fitted: fitted.mse)
    scorer = Scorer(SimpleNamespace(blocks=blocks))  # type: ignore[arg-type]
    before = SimpleNamespace(mse=np.append(np.full(38, 1.0), [400.0, 90.0]))
    finer = SimpleNamespace(mse=np.append(np.full(38, 1.02), [4.0, 2.0]))
    elsewhere = SimpleNamespace(mse=np.concatenate([[9.0, 9.0], np.full(36, 1.0), [4.0, 2.0]]))
    far = SimpleNamespace(mse=np.append(np.full(38, 9.0), [400.0, 90.0]))
    assert scorer.follows(finer, before)  # type: ignore[arg-type]
    assert not scorer.follows(elsewhere, before)  # type: ignore[arg-type]
    assert not scorer.follows(before, before)  # type: ignore[arg-type]
    assert not scorer.follows(finer, far)  # type: ignore[arg-type]


def test_knots_lie_where_windows_stand_out_that_a_law_is_too_coarse_for() -> None:
    """The nearest ones to where such windows pass; none where all are predicted alike."""
    ready = prepared(CART, [record(physics.load(CART), sweep(4.0))])
    law = ForceOfPosition(np.linspace(-1.0, 1.0, 41).tolist(), [0.1] * 41)
    term = Term(law, "cart", law.guess)
    fitted = fit(ready.problem, ready.structure.with_term(term), ready.structure.with_term(term).first, most=0)
    windows, even = ready.problem.windows, np.ones(len(ready.problem.windows))
    assert not passed(replace(fitted, mse=even), term, windows).any()
    mse = even.copy()
    mse[3] = 1e4
    found = np.array(law.knots)[passed(replace(fitted, mse=mse), term, windows)]
    place = windows.observed[3, :, 0]
    assert len(found)
    assert np.all(np.abs(found[:, None] - place).min(axis=1) < 0.5 * 0.05 + 1e-3)
    assert np.all(np.abs(place[:, None] - found).min(axis=1) < 0.5 * 0.05 + 1e-3)
    assert len(found) < len(law.knots)
