"""Every effect of the catalogue: its edit is what it says it is, wherever it can act."""

from __future__ import annotations

import copy
import functools
import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sim2real_rigs import CART, NOISE, RIGS, RK4, STRENGTH, prepared, record, sweep

from dipc_gym import mjcf, physics
from dipc_gym.mjcf.edit import Document
from dipc_gym.recording import Recording
from dipc_gym.sim2real import effects
from dipc_gym.sim2real.effects import Effect, catalogue
from dipc_gym.sim2real.effects.friction_hysteresis import Hysteresis
from dipc_gym.sim2real.effects.friction_hysteresis_law import HysteresisOfAnyLaw
from dipc_gym.sim2real.effects.friction_load_law import UnderLoadOfAnyLaw
from dipc_gym.sim2real.effects.friction_resting_law import RestingOfAnyLaw
from dipc_gym.sim2real.effects.load_creeping import _stretch
from dipc_gym.sim2real.effects.load_creeping_law import CreepingSpringOfAnyLaw
from dipc_gym.sim2real.effects.load_swinging_law import SwingingLoadOfAnyLaw
from dipc_gym.sim2real.effects.load_tilt import Tilt
from dipc_gym.sim2real.effects.motor_map import CommandMap
from dipc_gym.sim2real.effects.motor_sag_law import SagOfAnyLaw
from dipc_gym.sim2real.effects.sensor_map import ScaleMap
from dipc_gym.sim2real.effects.shared.base import Evidence, Parameter
from dipc_gym.sim2real.effects.shared.drives import drive_of
from dipc_gym.sim2real.effects.shared.law import Law
from dipc_gym.sim2real.effects.shared.surfaces import Surface
from dipc_gym.sim2real.effects.shared.waves import waves
from dipc_gym.sim2real.effects.unknown_force import UnknownForce
from dipc_gym.sim2real.effects.unknown_product import UnknownProduct
from dipc_gym.sim2real.effects.unknown_recent import UnknownRecent
from dipc_gym.sim2real.estimation import unexplained
from dipc_gym.sim2real.estimation.fit import Fit, fit
from dipc_gym.sim2real.estimation.problem import predict
from dipc_gym.sim2real.estimation.segments import Prepared
from dipc_gym.sim2real.model.structure import Structure, Term
from dipc_gym.sim2real.simulation.batch import Stepping
from dipc_gym.sim2real.verdict.effect_words import place_units

# The ids of the project's contract, less those that are no effect of the catalogue: a wrong mass is a number of the
# model that a refit changes, and the unknown is what no effect explains.
CONTRACT = [
    "friction.coulomb",
    "friction.stribeck",
    "friction.viscous",
    "friction.asymmetric",
    "friction.position",
    "friction.load",
    "drag.quadratic",
    "load.constant",
    "load.tilt",
    "load.spring",
    "load.inertia",
    "load.position",
    "load.stop",
    "load.payload",
    "motor.deadzone",
    "motor.saturation",
    "motor.inductance",
    "motor.back_emf",
    "motor.cogging",
    "motor.thermal",
    "timing.delay",
    "timing.sensor_lag",
    "transmission.backlash",
    "transmission.compliance",
    "sensor.bias",
    "sensor.gain",
    "sensor.eccentric",
    "sensor.map",
    "disturbance.periodic",
    "disturbance.pulse",
    "friction.speed",
    "friction.time",
    "friction.resting",
    "friction.hysteresis",
    "load.swinging",
    "load.creeping",
    "motor.map",
    "motor.sag",
    "residual.force",
]
# Parameters with which an effect does nothing. A rotor of its own always adds inertia: see the transmissions below.
NEUTRAL: dict[str, Mapping[str, float]] = {
    "friction.asymmetric:viscous": {"drag": 0},
    "motor.saturation:torque": {"limit": 1e3},
    "disturbance.periodic": {"sine": 0, "cosine": 0, "frequency": 3},
    "disturbance.pulse": {"force": 0, "start": 1, "duration": 1},
    "drag.quadratic": {"coefficient": 0},
    "friction.asymmetric": {"forward": 0, "backward": 0},
    "friction.coulomb": {"level": 0},
    "friction.load": {"level": 0, "by_drive": 0, "by_weight": 0},
    "friction.load:stribeck": {"level": 0, "by_drive": 0, "by_weight": 0, "excess": 0, "velocity": 0.1},
    "friction.position": {"first": -1, "last": 1, **{f"level_{k}": 0.0 for k in range(1, 6)}},
    "friction.position:wave": {"level": 0, "sine": 0, "cosine": 0, "wavelength": 0.1},
    "friction.resting": {"level": 0, "rise": 0, "time": 0.1, "slow": 1e-3},
    "friction.stribeck": {"level": 0, "static": 0, "velocity": 0.1},
    "friction.stribeck:presliding": {"level": 0, "static": 0, "velocity": 0.1, "stiffness": 1e-6, "damping": 1e-9},
    "friction.viscous": {"coefficient": 0},
    "load.constant": {"force": 0},
    "load.inertia": {"inertia": 0},
    "load.payload": {"mass": 0, "inertia": 0, "x": 0.1, "y": 0.2, "z": 0.3},
    "load.position": {"sine": 0, "cosine": 0, "wavelength": 0.1},
    "load.spring": {"stiffness": 0, "rest": 0.3},
    "load.stop": {"low": -10, "high": 10, "contact_rate": 500, "contact_damping": 0.3},
    "load.tilt": {"about_x": 0, "about_y": 0},
    "motor.back_emf": {"coefficient": 0},
    "motor.cogging": {"sine": 0, "cosine": 0, "poles": 7},
    "motor.deadzone": {"width": 0},
    "motor.inductance": {"time_constant": 2e-4},
    "motor.sag": {"drop": 0, "time_constant": 1, "current": 3, "gain": 1, "back": 0},
    "motor.saturation": {"limit": 1e3},
    "motor.thermal": {"thermal_resistance": 1e-9, "time_constant": 10},
    "sensor.bias": {"bias": 0},
    "sensor.gain": {"gain": 1},
    "sensor.eccentric": {"sine": 0, "cosine": 0, "wavelength": 0.1},
    "load.creeping": {"stiffness": 1e-9, "relaxation_time": 0.5},
    "load.swinging": {"mass": 1e-9, "frequency": 5, "damping_ratio": 0.1},
    "timing.delay": {"delay": 0},
    "timing.sensor_lag": {"time_constant": 1e-4},
    "timing.sensor_lag:delay": {"delay": 0},
}
# Time constants cannot be zero: the shortest one still delays by this much, s.
SHORTEST = {"motor.inductance": 2.1e-4, "timing.sensor_lag": 1.1e-4}
ROTORS = {"transmission.backlash", "transmission.compliance"}
LOADS = {"load.swinging", "load.swinging:law"}  # likewise


@functools.cache
def recorded(rig: str) -> Recording:
    """A run of the rig with half as much damping again and some dry friction, so that something is unexplained."""
    text = RIGS[rig].replace('damping="21.4"', 'damping="32"').replace("<joint ", '<joint frictionloss="0.02" ', 1)
    start = (0.0, 0.4, -0.3) if rig == "hanging" else ()
    return record(physics.load(text), sweep(STRENGTH[rig]), noise=NOISE[rig], start=start)


@functools.cache
def whole(rig: str) -> Prepared:
    return prepared(RIGS[rig], [recorded(rig)], stepping=Stepping(0.001, RK4))


@functools.cache
def ready(rig: str) -> Prepared:
    return replace(whole(rig), problem=whole(rig).problem.pick(np.arange(0, 12, 3)))


@functools.cache
def as_it_is(rig: str) -> Fit:
    """What the rig's model leaves of the recording."""
    return fit(whole(rig).problem, whole(rig).structure, most=0)


@functools.cache
def places(effect: str, rig: str) -> list[str]:
    joints = ready(rig).structure.base
    return unexplained.places(catalogue()[effect], ready(rig).structure.model, joints, recorded(rig))


def shaped(effect: str, rig: str, at: str) -> tuple[Effect, list[Mapping[str, float]]]:
    """An effect with the shape that the evidence asks for, if its shape is free, and its guesses."""
    known = catalogue()[effect]
    scene = unexplained.scene(physics.load(RIGS[rig]), [recorded(rig)], ready(rig).motions)
    scene = replace(scene, fitted=(whole(rig).problem.windows, as_it_is(rig)))
    found = known.proposals(scene.at(known.place, at, {}))
    if not found:
        pytest.skip("nothing in this recording asks for it")
    first = found[0][0]
    return first, [dict(guess) for effect, guess in found if effect is first or not first.free]


def guesses(effect: Effect, rig: str, at: str) -> list[Mapping[str, float]]:
    return shaped(effect.id, rig, at)[1]


def neutral(effect: Effect) -> Mapping[str, float]:
    """Parameters with which an effect does nothing."""
    if isinstance(effect, CommandMap | ScaleMap):
        return dict(zip((p.name for p in effect.parameters), effect.knots, strict=True))
    # A stiffness, a bound or a time constant is never none; what goes by ratios of it is next to nothing.
    if not effect.free:
        return NEUTRAL[effect.id]
    held = effect.first if isinstance(effect, SagOfAnyLaw | UnderLoadOfAnyLaw | RestingOfAnyLaw) else {}
    return {p.name: held[p.name] if p.fixed else max(p.low, 1e-9) if p.log else 0.0 for p in effect.parameters}


def added(rig: str, effect: Effect, at: str, values: Mapping[str, float]) -> Structure:
    return ready(rig).structure.with_term(Term(effect, at, values))


def predicted(rig: str, structure: Structure, everywhere: bool = False) -> np.ndarray:
    problem = whole(rig).problem if everywhere else ready(rig).problem
    return predict(problem, structure, [structure.first], problem.initial[None])[0]


def units(effect: Effect) -> dict[str, str]:
    return {p.name: p.unit for p in effect.parameters}


CASES = [(rig, effect, at) for rig in RIGS for effect in sorted(catalogue()) for at in places(effect, rig)]
each = pytest.mark.parametrize(("rig", "effect", "at"), CASES, ids=["-".join(case) for case in CASES])


# The catalogue


def test_ids_are_those_of_the_contract() -> None:
    assert {effect.name for effect in catalogue().values()} == set(CONTRACT)


def test_every_effect_can_act_on_some_rig() -> None:
    assert {effect for _, effect, _ in CASES} == set(catalogue())


@pytest.mark.parametrize("effect", catalogue().values(), ids=lambda e: e.id)
def test_an_effect_is_well_formed(effect: Effect) -> None:
    assert re.fullmatch(r"[a-z]+\.[a-z_]+(:[a-z]+)?", effect.id)
    assert effect.id.startswith(effect.name)
    assert ":" not in effect.name
    known = set(catalogue())
    assert set(effect.rivals) <= known - {effect.id}
    assert set(effect.contains) <= known - {effect.id}
    names = [p.name for p in effect.parameters]
    assert len(set(names)) == len(names)
    assert effect.free != any(not p.fixed for p in effect.parameters)  # a law has parameters once it has a shape
    for p in effect.parameters:
        assert p.low < p.high
        assert not p.log or p.low >= 0
    assert (effect.__doc__ or "").strip()


# What elaborates dry friction may take the place of what the model has.
ONCE = ("friction.coulomb", "friction.viscous", "load.spring", "motor.thermal", "motor.inductance")


@pytest.mark.parametrize("name", ONCE)
def test_nothing_is_offered_twice(name: str) -> None:
    """An effect that the model has already is not proposed again."""
    places = [(rig, at) for rig, one, at in CASES if one == name]
    assert places
    for rig, at in places:
        effect = catalogue()[name]
        structure = added(rig, effect, at, guesses(effect, rig, at)[0])
        assert not effect.fits(structure.physics(structure.first).model, at), name


@pytest.mark.parametrize("effect", ["load.creeping", "load.creeping:law"])
def test_springs_that_creep_fast_are_asked_for_whatever_forces_say(effect: str) -> None:
    """A refitted mass and damping do nearly what they do, and may leave a force that seems to push."""
    scene = unexplained.scene(physics.load(RIGS["cart"]), [recorded("cart")], ready("cart").motions)
    evidence = scene.at("joint", "cart", {})
    for time in (0.03, 0.1, 0.3, 1.0):
        pushes = replace(evidence, force=-10.0 * _stretch(time, evidence))
        found = catalogue()[effect].proposals(pushes)
        assert len(found) >= 3
        for law, guess in found[-3:]:
            values = dict(guess)
            stiffness = values.pop("stiffness")
            fastest = values.get("relaxation_time") or law.furthest / sum(values.values())
            assert fastest == pytest.approx(0.1, rel=2.5)
            assert 0 < stiffness * fastest < 50.0  # N s/m, of the damper behind the spring


# Every effect at every place of every rig


@each
def test_guesses_are_within_bounds(rig: str, effect: str, at: str) -> None:
    known, found = shaped(effect, rig, at)
    assert found
    for guess in found:
        assert set(guess) == {p.name for p in known.parameters}
        for p in known.parameters:
            assert math.isfinite(guess[p.name])
            assert p.low <= guess[p.name] <= p.high
            assert guess[p.name] > 0 or not p.log


@pytest.mark.parametrize(("rig", "effect", "at"), [case for case in CASES if case[1] not in ROTORS | LOADS])
def test_the_neutral_value_changes_nothing(rig: str, effect: str, at: str) -> None:
    known, found = shaped(effect, rig, at)
    structure = added(rig, known, at, found[0])
    nothing = structure.without(f"{effect}@{at}").with_term(replace(structure.terms[-1], guess=neutral(known)))
    before, after = predicted(rig, ready(rig).structure), predicted(rig, nothing)
    fastest = np.abs(ready(rig).motions[0].velocity).max()
    assert after == pytest.approx(before, abs=1e-6 + SHORTEST.get(effect, 0.0) * fastest)


@each
def test_the_guess_changes_predictions(rig: str, effect: str, at: str) -> None:
    known, found = shaped(effect, rig, at)
    once = known.once
    before = predicted(rig, ready(rig).structure, everywhere=once)
    noise = ready(rig).problem.windows.noise
    moved = [
        np.abs((predicted(rig, added(rig, known, at, guess), everywhere=once) - before) / noise).max()
        for guess in found
    ]
    assert max(moved) > 0.5


@each
def test_what_is_written_is_what_was_fitted(rig: str, effect: str, at: str) -> None:
    """The text, read as a user's file would be, predicts what the structure did to the last bit; MuJoCo loads it."""
    known, found = shaped(effect, rig, at)
    structure = added(rig, known, at, found[-1])
    z = structure.first + 0.01
    text = structure.write(z).text()
    mujoco.MjModel.from_xml_string(text)
    source = mjcf.from_text(text)
    loaded = physics.from_model(mjcf.compile(source))
    assert bool(loaded.extras) == known.needs_loader
    assert mjcf.controls(loaded.model) == mjcf.controls(structure.model)
    problem = ready(rig).problem
    fitted = predict(problem, structure, [z], problem.initial[None])
    # With steps and warm-up of the same length, the file alone says everything.
    again = Structure(Document(source), loaded.model, structure.base)
    stepping = replace(problem.stepping, timestep=min(problem.stepping.timestep, structure.finest))
    other = replace(problem, stepping=stepping)
    if known.warm:
        assert again.warm == structure.warm
    elif again.warm:  # a winding's temperature is known at any time, and so need not settle
        structure = replace(structure, terms=(replace(structure.terms[0], effect=_settling(known)),))
        fitted = predict(problem, structure, [z], problem.initial[None])
    assert np.array_equal(predict(other, again, [again.first], problem.initial[None]), fitted)


def _settling(effect: Effect) -> Effect:
    """The same effect, simulated for a while before each window."""
    return type("Settling", (type(effect),), {"warm": 0.06})()  # type: ignore[no-any-return]


@each
def test_the_sentence_says_what_where_and_how_much(rig: str, effect: str, at: str) -> None:
    known, found = shaped(effect, rig, at)
    said = known.sentence(at, found[0], units(known))
    assert said.endswith(".")
    assert "\n" not in said
    assert said[0].isupper() or said.startswith(at)
    if known.place != "world":
        assert at in said
    assert re.search(r"\d", said.replace(at, ""))
    own = {p.unit for p in known.parameters if p.unit and not p.fixed}
    assert not own or any(unit in said for unit in own | {"ms", "degrees"})


@pytest.mark.parametrize(
    ("drive", "sags"),
    [
        ('<dcmotor name="drive" joint="cart" motorconst="0.06" resistance="1.2"/>', True),
        ('<motor name="drive" joint="cart" gear="4"/>', True),
        ('<general name="drive" joint="cart" gainprm="4" biastype="affine" biasprm="0 0 -2"/>', True),
        ('<position name="drive" joint="cart" kp="50"/>', False),  # what is sent is a place
        ('<motor name="drive" joint="cart"/><motor name="other" joint="cart"/>', False),  # whose supply?
    ],
)
def test_a_supply_sags_where_a_command_is_a_voltage_or_a_force(drive: str, sags: bool) -> None:
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><worldbody><body><joint name="cart" type="slide"/><geom size="0.1"/></body></worldbody>
        <actuator>{drive}</actuator></mujoco>"""
    )
    assert catalogue()["motor.sag"].fits(model, "drive") == sags


@pytest.mark.parametrize("effect", ["friction.stribeck", "friction.stribeck:presliding", "friction.asymmetric:viscous"])
def test_what_a_drive_gives_is_told_apart_from_friction_beside_it(effect: str) -> None:
    """An actuator that stands for friction drives nothing, and takes no supply."""
    document = Document(
        mjcf.from_text(
            """<mujoco><worldbody><body><joint name="cart" type="slide"/>
            <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></worldbody>
            <actuator><motor name="drive" joint="cart" gear="2"/></actuator></mujoco>"""
        )
    )
    known = catalogue()[effect]
    known.edit(document, "cart", {p.name: 2.0 + k for k, p in enumerate(known.parameters)})
    model = mjcf.compile(document.text())
    assert drive_of(model, "drive") == (2.0, 0.0)
    assert catalogue()["motor.sag"].fits(model, "drive")


@pytest.mark.parametrize("delay", ["", 'delay="0.01" nsample="8"'])
def test_more_of_what_a_model_has_is_not_in_proportion_to_all_of_it(delay: str) -> None:
    model = mujoco.MjModel.from_xml_string(
        f"""<mujoco><worldbody><body><joint name="cart" type="slide"/><geom size="0.1"/></body></worldbody>
        <actuator><motor name="drive" joint="cart" {delay}/></actuator></mujoco>"""
    )
    time = np.linspace(0.0, 1.0, 100)
    still = np.zeros(100)
    seen = Evidence(model, still, time, time, still, time, np.sin(time), still, 1.0, 1.0, 0.01, at="drive")
    linear = {effect.linear for effect, _ in catalogue()["timing.delay"].proposals(seen)}
    assert linear == ({()} if delay else {("delay",)})


def test_a_saturation_stays_within_a_range_that_the_joint_gives() -> None:
    """`inheritrange` takes the joint's range for that of the command."""
    text = """<mujoco><worldbody><body><joint name="a" range="-1 1"/><geom size="0.1"/></body></worldbody>
        <actuator><position name="servo" joint="a" kp="9" inheritrange="1"/></actuator>
        <compiler angle="radian" autolimits="true"/></mujoco>"""
    model, time = mjcf.compile(text), np.linspace(0.0, 1.0, 100)
    still = np.zeros(100)
    seen = Evidence(model, still, time, time, still, time, 3 * np.sin(time), still, 1.0, 1.0, 0.01, at="servo")
    document, (known, _) = Document(mjcf.from_text(text)), catalogue()["motor.saturation"].proposals(seen)[0]
    known.edit(document, "servo", {"limit": 1.4})
    assert mjcf.compile(document.text()).actuator_ctrlrange[0] == pytest.approx([-1.0, 1.0])


@pytest.mark.parametrize(
    ("knots", "levels", "passive"),
    [([-1.0, 0.5], [1.0, -1.0], False), ([-1.0, 0.0, 0.5], [1.0, 0.0, -1.0], True), ([0.1, 0.5], [-1.0, -2.0], True)],
)
def test_a_law_is_called_passive_where_it_drives_at_no_speed(
    knots: list[float], levels: list[float], passive: bool
) -> None:
    law = UnknownForce(Surface(("velocity cart",), (np.array(knots),), np.array(levels)), 1.0, ("m/s",), "cart")
    (level, *_) = law.parameters
    assert law.law_of(law.first, {level.name: "N"})["passive"] is passive


# Rotors of their own


def _fine(base: Structure, armature: float = 0.0) -> Structure:
    """A structure whose file has a step of 0.25 ms, for which play is bounded as hard as can be; with armature."""
    document = base.document.copy()
    document.option(timestep=2.5e-4)
    document.set(document.joint(base.base[0]), armature=armature)
    return Structure(Document(mjcf.from_text(document.text())), base.model, base.base)


@pytest.mark.parametrize(("rig", "at"), [("cart", "motor"), ("hanging", "motor"), ("torque", "drive")])
@pytest.mark.parametrize("effect", sorted(ROTORS))
def test_a_stiff_coupling_changes_nothing(rig: str, at: str, effect: str) -> None:
    """The rotor was part of what the joint moves; held fast, it is again."""
    known = catalogue()[effect]
    base, inertia = ready(rig).structure, guesses(known, rig, at)[0]["rotor_inertia"]
    values = {"rotor_inertia": inertia}
    play = (
        {"gap": 1e-9, "contact_rate": 4e3, "contact_damping": 1.0}
        if effect == "transmission.backlash"
        else {"stiffness": inertia * 4e6, "damping": inertia * 400}
    )
    stiff = predicted(rig, _fine(base).with_term(Term(known, at, values | play)))
    rigid, heavier = predicted(rig, _fine(base)), predicted(rig, _fine(base, inertia))
    assert np.abs(stiff - rigid).max() < 0.05 * np.abs(heavier - rigid).max()


def test_play_lets_the_load_be_for_as_long_as_it_lasts() -> None:
    """A resting load does not feel the motor until the rotor has crossed half the play."""
    gap, inertia, volts = 0.01, 0.1, 4.0
    structure = added(
        "cart",
        catalogue()["transmission.backlash"],
        "motor",
        {"gap": gap, "rotor_inertia": inertia, "contact_rate": 1e3, "contact_damping": 0.3},
    )
    rig = structure.physics(structure.first)
    model = rig.model
    model.opt.timestep = 1e-4
    data = mujoco.MjData(model)
    while data.qpos[model.joint("motor_rotor").qposadr[0]] < gap / 2:
        assert data.qpos[model.joint("cart").qposadr[0]] == 0
        rig.step(data, np.array([volts]))
    # The rotor alone: inertia dv/dt = k (V - c v) with k = gear K / R and c = gear K.
    k, c = 78.7 * 0.06 / 1.2, 78.7 * 0.06
    rate, end = k * c / inertia, volts / c
    t = np.linspace(0, 0.2, 200_001)
    way = end * (t - (1 - np.exp(-rate * t)) / rate)
    assert data.time == pytest.approx(float(np.interp(gap / 2, way, t)), abs=2e-4)


# Single effects against their law


def force_at(effect: str, values: Mapping[str, float], q: float = 0.0, v: float = 0.0, rig: str = "cart") -> float:
    """Generalised force of an effect on the first joint, the command zero and the rest of the model taken off."""

    def force(model: mujoco.MjModel) -> float:
        data = mujoco.MjData(model)
        data.qpos[0], data.qvel[0] = q, v
        mujoco.mj_forward(model, data)
        return float(data.qfrc_actuator[0] + data.qfrc_passive[0] + data.qfrc_constraint[0] - data.qfrc_bias[0])

    base = ready(rig).structure
    structure = added(
        rig, catalogue()[effect], base.base[0] if catalogue()[effect].place == "joint" else "motor", values
    )
    return force(structure.physics(structure.first).model) - force(base.model)


@pytest.mark.parametrize("v", [-0.7, -0.1, 0.02, 0.3])
def test_forces_follow_their_laws(v: float) -> None:
    assert force_at("drag.quadratic", {"coefficient": 3.0}, v=v) == pytest.approx(-3 * v * abs(v))
    assert force_at("load.constant", {"force": -2.5}, v=v) == pytest.approx(-2.5)
    assert force_at("load.spring", {"stiffness": 30.0, "rest": 0.1}, q=v) == pytest.approx(-30 * (v - 0.1))
    wave = {"sine": 1.5, "cosine": -0.5, "wavelength": 0.05}
    k = 2 * np.pi / 0.05
    assert force_at("load.position", wave, q=v) == pytest.approx(1.5 * np.sin(k * v) - 0.5 * np.cos(k * v))
    cogging = {"sine": 0.01, "cosine": 0.02, "poles": 6.0}
    turn = 6 * 78.7 * v
    expected = 78.7 * (0.01 * np.sin(turn) + 0.02 * np.cos(turn))
    assert force_at("motor.cogging", cogging, q=v) == pytest.approx(expected)


@pytest.mark.parametrize("v", np.linspace(0.005, 0.4, 9))
def test_stribeck_friction_follows_its_curve(v: float) -> None:
    """Straight pieces stay within 0.7 % of the excess of level + (static - level) exp(-(v / vs)^2)."""
    level, static, speed = 3.0, 5.0, 0.1
    values = {"level": level, "static": static, "velocity": speed}
    curve = level + (static - level) * np.exp(-((v / speed) ** 2))
    for sign in (-1, 1):
        structure = added("cart", catalogue()["friction.stribeck"], "cart", values)
        model = structure.physics(structure.first).model
        data = mujoco.MjData(model)
        data.qvel[0] = sign * v
        mujoco.mj_forward(model, data)
        motor = model.actuator("motor").id
        passive = data.qfrc_actuator[0] - data.actuator_force[motor] * 78.7
        friction = model.dof_frictionloss[0] - sign * passive
        assert friction == pytest.approx(curve, abs=0.007 * (static - level))


def test_bristles_are_springs_until_they_slip() -> None:
    values = {"level": 3.0, "static": 5.0, "velocity": 0.05, "stiffness": 2e4, "damping": 200.0}
    structure = added("cart", catalogue()["friction.stribeck:presliding"], "cart", values)
    model = structure.physics(structure.first).model
    model.opt.timestep = 1e-5
    data = mujoco.MjData(model)
    forces = []
    for _ in range(20_000):  # 10 mm/s, as a drive that gives whatever it takes would move it
        data.qvel[0] = 0.01
        mujoco.mj_step(model, data)
        forces.append(-data.qfrc_actuator[0] - 78.7**2 * 0.06**2 / 1.2 * 0.01)
    limit = 3 + 2 * np.exp(-((0.01 / 0.05) ** 2))
    for k in (99, 999, 19_999):
        bend = limit / 2e4 * (1 - np.exp(-0.01 * (k + 1) * 1e-5 * 2e4 / limit))  # dz/dt = v (1 - stiffness z / limit)
        expected = 2e4 * bend + 200 * 0.01 * (1 - 2e4 * bend / limit)
        assert forces[k] == pytest.approx(expected, rel=2e-3)


@given(
    count=st.floats(2.0, 90.0),
    phase=st.floats(0.0, 6.28),
    along=st.booleans(),
    off=st.floats(-10.0, 10.0),
    seed=st.integers(0, 2**32 - 1),
)
@settings(max_examples=30, deadline=None)
def test_waves_are_found_under_noise_ten_times_as_large(
    count: float, phase: float, along: bool, off: float, seed: int
) -> None:
    """Over the whole of a recording; the direction of motion may carry them, and the inertia may be off."""
    rng = np.random.default_rng(seed)
    # Noise leaves a wave's count a standard error of sqrt(24 / n) / (2 pi) times itself over the wave (Cramer and Rao),
    # and the counts that are tried lie a tenth apart: of 40 s, a quarter is half of the one and five of the other.
    t = np.arange(40_000) * 1e-3
    x = 0.5 * np.sin(1.7 * t) + 0.5 * np.sin(0.61 * t + 1)
    v = np.gradient(x, t)
    seen = unexplained.scene(physics.load(CART), [recorded("cart")], ready("cart").motions)
    # So heavy a joint moves as it does whatever the force.
    still = np.zeros_like(x)
    scene = replace(seen.at("joint", "cart", {}), time=t, position=x, velocity=v, force=still, inertia=1e9)
    reach = float(np.ptp(x))
    carrier = -scene.direction if along else np.ones_like(x)
    wave = carrier * np.sin(2 * np.pi * count / reach * x + phase)
    scene = replace(scene, force=wave + off * np.gradient(v, t) + rng.normal(0, 10, len(x)))
    found = waves(scene, 0.5, carrier if along else None)
    assert reach / found[0]["wavelength"] == pytest.approx(count, abs=0.25)
    assert np.hypot(found[0]["sine"], found[0]["cosine"]) == pytest.approx(1.0, abs=0.6)


def test_back_emf_of_a_plain_motor_brakes_by_its_coefficient() -> None:
    structure = added("torque", catalogue()["motor.back_emf"], "drive", {"coefficient": 0.3})
    model = structure.physics(structure.first).model
    data = mujoco.MjData(model)
    data.qvel[0] = 2.0
    mujoco.mj_forward(model, data)
    assert data.qfrc_passive[0] + data.qfrc_actuator[0] == pytest.approx(-0.6)


# Hostile and unlucky names

HOSTILE = [
    'a"><script>alert(1)</script>',
    "&lt;&amp;&",
    "joint with spaces",
    "a:b:c",
    "{0} %s",
    "../../etc",
    "häß–👾",
    "'",
]


@pytest.mark.parametrize(
    ("actuator", "unit"),
    [
        ('<dcmotor name="m" joint="{joint}" resistance="1" motorconst="0.05"/>', "V"),
        ('<motor name="m" joint="slide"/>', "N"),
        ('<motor name="m" joint="hinge"/>', "N m"),
        ('<motor name="m" joint="hinge" gear="50"/>', ""),
        ('<position name="m" joint="hinge" kp="3"/>', "rad"),
        ('<position name="m" joint="hinge" kp="3" gear="2"/>', ""),
    ],
)
def test_a_dead_zone_is_told_in_the_unit_of_the_command(actuator: str, unit: str) -> None:
    body = '<body><joint name="{0}" type="{0}" axis="1 0 0"/><geom size="1" contype="0"/></body>'
    text = f"""<mujoco><worldbody>{body.format("slide")}{body.format("hinge")}</worldbody>
        <actuator>{actuator.format(joint="slide")}</actuator></mujoco>"""
    source = mjcf.from_text(text)
    effect = catalogue()["motor.deadzone"]
    term = Term(effect, "m", {"width": 0.25})
    units = place_units(Structure(Document(source), mjcf.compile(source), ("slide", "hinge")), term)
    assert units == {"width": unit}
    assert effect.sentence("m", term.guess, units).endswith(f"below {f'0.25 {unit}'.strip()} do nothing.")


def test_a_unit_is_translated_at_a_hinge_unless_it_says_that_it_stays() -> None:
    source = mjcf.from_text(
        '<mujoco><worldbody><body><joint name="elbow"/><geom size="1"/></body></worldbody></mujoco>'
    )
    effect = copy.copy(catalogue()["load.constant"])
    effect.parameters = (Parameter("inertia", "kg"), Parameter("mass", "kg", translated=False))
    structure = Structure(Document(source), mjcf.compile(source), ("elbow",))
    units = place_units(structure, Term(effect, "elbow", {"inertia": 1.0, "mass": 1.0}))
    assert units == {"inertia": "kg m^2", "mass": "kg"}


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_names_survive_every_effect(name: str) -> None:
    root = ET.fromstring(RIGS["cart"])
    for tag, attribute in (("joint", "name"), ("dcmotor", "name"), ("dcmotor", "joint"), ("jointpos", "name")):
        for element in root.iter(tag):
            element.set(attribute, name)
    for element in root.iter("jointpos"):
        element.set("joint", name)
    text = ET.tostring(root, encoding="unicode")
    source = mjcf.from_text(text)
    model = mjcf.compile(source)
    base = Structure(Document(source), model, (name,))
    for known in catalogue().values():
        at = "world" if known.place == "world" else name
        if not known.fits(model, at):
            continue
        first = 0.05 if isinstance(known, Hysteresis) else 0.0
        effect = type(known)((first, 0.1), (1.0, 2.0)) if isinstance(known, Law) else known
        if isinstance(known, UnknownForce):
            knots = np.array([0.0, 0.1])
            of = (f"position {name}", f"command {name}")
            effect = UnknownForce(Surface(of, (knots, knots), np.array([[1.0, 2.0], [3.0, 4.0]])))
        if isinstance(known, UnknownProduct):
            effect = UnknownProduct([0.0, 0.1], [1.0, 2.0], (f"position {name}", f"command {name}"))
        if isinstance(known, UnknownRecent):
            effect = UnknownRecent([0.0, 0.1], [1.0, 2.0], (f"velocity {name}",) * 2)
        if isinstance(known, CreepingSpringOfAnyLaw):
            effect = CreepingSpringOfAnyLaw(0.1, {"stiffness": 1.0, "faster_1": 0.1, "faster_2": 0.2})
        if isinstance(known, SwingingLoadOfAnyLaw):
            first = {"mass": 0.01, "small_swing_frequency": 2.0, "damping_ratio": 0.1, "slope_2": 0.5}
            effect = SwingingLoadOfAnyLaw((0.0, 0.01, 0.03), first)
        if isinstance(known, HysteresisOfAnyLaw):
            effect = HysteresisOfAnyLaw({"bound": 1.0, "fall_1": 0.1, "fall_2": 0.2})
        if isinstance(known, UnderLoadOfAnyLaw):
            held = {"level": 1.0, "by_drive": 0.1, "by_weight": 0.1, "fastest": 0.5}
            effect = UnderLoadOfAnyLaw({**held, "more_1": 0.1, "more_2": 0.2})
        if isinstance(known, RestingOfAnyLaw):
            effect = RestingOfAnyLaw({"level": 1.0, "longest": 0.5, "slow": 1e-3, "more_1": 0.1, "more_2": 0.2})
        if isinstance(known, SagOfAnyLaw):
            held = {"current": 1.0, "gain": 1.0, "back": 0.0}
            effect = SagOfAnyLaw({"time_constant": 1.0, "more_1": 0.1, "more_2": 0.2, **held})
        values = {p.name: max(p.low, 0.01) if p.name != "first" else -1.0 for p in effect.parameters}
        structure = base.with_term(Term(effect, at, values))
        written = structure.write(structure.first).text()
        loaded = physics.load(written)
        assert mjcf.controls(loaded.model) == [name], effect.id
        assert [extra.at for extra in loaded.extras] == [name] * len(loaded.extras)
        assert bool(loaded.extras) == effect.needs_loader
        if effect.place != "world":
            assert name in effect.sentence(at, values, units(effect))


def test_an_improved_model_can_be_improved_again() -> None:
    """Names and entries that an earlier diagnosis wrote do not stand in the way of the next one."""
    for known in catalogue().values():
        at = {"joint": "cart", "actuator": "motor", "sensor": "cart", "world": "world"}[known.place]
        if at not in places(known.id, "cart"):
            continue
        document = ready("cart").structure.document.copy()
        if known.id == "friction.hysteresis":  # nothing in the recording asks for it
            known = Hysteresis([0.01], [1.0])
            effect, values = known, known.guess
        else:
            effect, (values, *_) = shaped(known.id, "cart", at)
        effect.edit(document, at, values)
        once = mjcf.compile(document.text())
        less = {"rotor_inertia": values["rotor_inertia"] / 2} if known.id in ROTORS else {}  # of what is left
        effect.edit(document, at, {**values, **less})
        twice = mjcf.compile(document.text())
        assert mjcf.controls(once) == mjcf.controls(twice) == ["motor"], effect.id


@pytest.mark.parametrize("damping", [0.05, 0.3, 0.8])
def test_a_blow_at_the_end_of_play_takes_the_energy_that_its_damping_says(damping: float) -> None:
    """Rotor and load part at the speed of a damped oscillator at the moment its force has fallen to zero."""
    xml = """<mujoco><option timestep="1e-5" gravity="0 0 0"/>
      <worldbody><body><inertial pos="0 0 0" mass="1.5" diaginertia="1 1 1"/><joint name="load" type="slide"/>
      </body></worldbody>
      <actuator><motor name="drive" joint="load"/></actuator><sensor><jointpos joint="load"/></sensor></mujoco>"""
    document, rate, speed = Document(mjcf.from_text(xml)), 1000.0, 0.2
    values = {"gap": 1e-3, "rotor_inertia": 0.3, "contact_rate": rate, "contact_damping": damping}
    catalogue()["transmission.backlash"].edit(document, "drive", values)
    model = mujoco.MjModel.from_xml_string(document.text())
    data = mujoco.MjData(model)
    rotor, load = (int(model.joint(name).dofadr[0]) for name in ("drive_rotor", "load"))
    data.qvel[rotor] = speed
    mujoco.mj_step(model, data, 500)  # 5 ms: across half the gap in 2.5 ms, and in contact for pi ms at most
    while data.ncon or data.nefc:
        mujoco.mj_step(model, data)

    swing = rate * np.sqrt(1 - damping**2)
    t = np.linspace(0, np.pi / swing, 100_001)
    way = np.exp(-damping * rate * t) * np.sin(swing * t) / swing
    pace = np.gradient(way, t)
    pushing = rate**2 * way + 2 * damping * rate * pace > 0
    kept = -pace[np.flatnonzero(pushing)[-1]]
    assert (data.qvel[load] - data.qvel[rotor]) / speed == pytest.approx(kept, abs=0.02)
    assert 0.3 * data.qvel[rotor] + 1.2 * data.qvel[load] == pytest.approx(0.3 * speed, rel=1e-9)


def test_the_end_of_play_gives_way_to_what_presses_on_it() -> None:
    """Rotor and load under a constant force go as one, the contact between them pressed in as a spring is.

    The load feels F M / (m + M) through a stiffness of rate^2 m M / (m + M), so the rotor is F / (rate^2 m) ahead.
    """
    xml = """<mujoco><option timestep="1e-4" gravity="0 0 0"/>
      <worldbody><body><inertial pos="0 0 0" mass="1.5" diaginertia="1 1 1"/><joint name="load" type="slide"/>
      </body></worldbody>
      <actuator><motor name="drive" joint="load"/></actuator><sensor><jointpos joint="load"/></sensor></mujoco>"""
    document, force, gap, rotor, rate = Document(mjcf.from_text(xml)), 20.0, 1e-4, 0.3, 700.0
    values = {"gap": gap, "rotor_inertia": rotor, "contact_rate": rate, "contact_damping": 1.0}
    catalogue()["transmission.backlash"].edit(document, "drive", values)
    model = mujoco.MjModel.from_xml_string(document.text())
    data = mujoco.MjData(model)
    data.ctrl[0] = force
    mujoco.mj_step(model, data, 2000)
    ahead = data.qpos[int(model.joint("drive_rotor").qposadr[0])] - data.qpos[int(model.joint("load").qposadr[0])]
    assert ahead - gap / 2 == pytest.approx(force / (rate**2 * rotor), rel=1e-3)


@pytest.mark.parametrize("swings", [True, False])
def test_the_frequency_of_a_disturbance_that_a_controller_answers(swings: bool) -> None:
    """Where all motion is what the rig makes of the disturbance, the force goes with motion as friction does."""
    t = np.arange(0, 20, 0.002)
    angle = 2 * np.pi * 3.4 * t - 1.0
    other = 2 * np.pi * 0.7 * t
    noise = np.random.default_rng(0).standard_normal((4, len(t)))
    shaken = (np.sin(angle - 0.4), np.cos(angle - 0.4)) if swings else (np.sin(other), np.cos(other))
    seen = Evidence(
        model=mujoco.MjModel.from_xml_string(CART),
        force=0.3 * np.sin(angle) + 0.2 * noise[0] - 2.0 * shaken[1] * (not swings),
        velocity=0.1 * shaken[1] + 1e-3 * noise[1],
        position=0.005 * shaken[0] + 1e-5 * noise[2],
        load=shaken[0] + 0.01 * noise[3],
        time=t,
        command=np.zeros(0),
        reading=np.zeros(0),
        gear=0.0,
        inertia=1.0,
        period=0.002,
    )
    guesses = catalogue()["disturbance.periodic"].guesses(seen)
    near = [g for g in guesses if abs(g["frequency"] - 3.4) < 0.02]
    assert near
    assert max(math.hypot(g["sine"], g["cosine"]) for g in near) == pytest.approx(0.3, rel=0.1)


def test_a_slow_shaking_is_found_under_the_noise_of_accelerations() -> None:
    """The noise of a position, differentiated twice, is strongest where a force moves the rig least."""
    t = np.arange(0, 15, 0.002)
    angle = 2 * np.pi * 0.87 * t
    jitter = np.gradient(np.gradient(3e-5 * np.random.default_rng(0).standard_normal(len(t)), t), t)
    still = np.zeros(len(t))
    seen = Evidence(
        model=mujoco.MjModel.from_xml_string(CART),
        force=0.1 * np.sin(angle - 0.4) + jitter,
        velocity=still,
        position=still,
        load=still,
        time=t,
        command=np.zeros(0),
        reading=np.zeros(0),
        gear=0.0,
        inertia=1.0,
        period=0.002,
    )
    assert np.std(jitter) > 1.0
    guesses = catalogue()["disturbance.periodic"].guesses(seen)
    assert [g for g in guesses if abs(g["frequency"] - 0.87) < 0.02]


def test_a_catalogue_that_was_not_read_to_its_end_is_read_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C, or a module that cannot be imported, between two effects."""
    whole = list(catalogue())

    def breaks_off(name: str) -> object:
        if name.endswith("motor_map"):
            raise KeyboardInterrupt
        return real(name)

    real = effects.importlib.import_module
    monkeypatch.setattr(effects, "_effects", {})
    with monkeypatch.context() as patched:
        patched.setattr(effects.importlib, "import_module", breaks_off)
        with pytest.raises(KeyboardInterrupt):
            catalogue()
    assert list(catalogue()) == whole


def test_a_supply_loses_no_more_than_all_of_its_force_in_words_either() -> None:
    numbers = {"time_constant": 30.0, "more_1": 0.4, "more_2": 0.9, "current": 6.0, "gain": 1.0, "back": 0.0}
    said = SagOfAnyLaw(numbers).sentence("motor", numbers, {"current": "V"})
    assert "under a command of 3 V it comes to lose 40 % of its force, under 6 V 100 %" in said


@pytest.mark.parametrize(
    ("about", "angles", "said"), [("y", (-0.0524,), "-3 degrees about y"), ("xy", (0.03, -0.04), "2.9 degrees.")]
)
def test_a_tilt_says_which_way_where_one_axis_is_felt(about: str, angles: tuple[float, ...], said: str) -> None:
    values = {f"about_{axis}": angle for axis, angle in zip(about, angles, strict=True)}
    assert said in Tilt(about).sentence("world", values, {})
