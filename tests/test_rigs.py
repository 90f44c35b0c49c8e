"""Rigs as machine code: what they agree with, and what they refuse."""

from __future__ import annotations

import copy
import ctypes
import dataclasses
import pickle
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence
from hypothesis import given, settings
from hypothesis import strategies as st
from llvmlite import ir

import dipc_gym
from dipc_gym import mjcf
from dipc_gym.engine import check, machine, program
from dipc_gym.engine.code import Code
from dipc_gym.engine.ensemble import WIDTH
from dipc_gym.engine.values import POINTER, exp, sin_cos
from dipc_gym.env import DoublePendulumEnv
from dipc_gym.mjcf.edit import Document
from dipc_gym.plant import Plant, PlantError
from dipc_gym.randomise import PlantFamily
from dipc_gym.rigs.numbers import PlantNumbers
from dipc_gym.rigs.rig import Rig
from dipc_gym.sim2real.effects.shared.tables import force_of_position
from dipc_gym.vector import DIPCFrictionVectorEnv

DRAWN = {
    "friction": {
        "coulomb": {"uniform": [4.0, 9.0]},
        "static": {"uniform": [7.0, 14.0]},
        "viscous": {"normal": [20, 2]},
        "bristle_stiffness": {"uniform": [1e4, 2e4]},
    },
    "motor": {"resistance": {"normal": [1.2, 0.05]}, "pulley_radius": {"uniform": [0.012, 0.013]}},
    "masses": {"cart": {"uniform": [0.4, 0.8]}, "pole1": {"uniform": [0.5, 0.6]}, "pole2": {"uniform": [0.1, 0.15]}},
    "delay": {"uniform": [0.0, 0.012]},
}
TEXT = DoublePendulumEnv().source.text


def stepped(tmp_path: Path, timestep: float, laws: str = "") -> Path:
    """The rig with another physics step, and with laws under `<custom>`."""
    path = tmp_path / f"rig-{timestep:g}.xml"
    text = TEXT.replace('timestep="0.001"', f'timestep="{timestep!r}"')
    path.write_text(text.replace("<keyframe>", f"<custom>{laws}</custom><keyframe>") if laws else text)
    return path


def edited(tmp_path: Path, was: str, becomes: str) -> Path:
    assert was in TEXT
    path = tmp_path / "rig.xml"
    path.write_text(TEXT.replace(was, becomes))
    return path


def motion(volts: np.ndarray, **kwargs: Any) -> np.ndarray:
    """States under voltages, (periods, 6)."""
    env = DoublePendulumEnv(exact_state=True, **kwargs)
    env.reset(options={"state": [0, 0.01, -0.01, 0, 0, 0]})
    return np.array([env.step(np.array([u]))[0] for u in volts])


# ---------------------------------------------------------------------------------------------- beside MuJoCo


@pytest.mark.parametrize("seed", range(4))
def test_mujoco_converges_to_it_with_the_step(seed: int, tmp_path: Path) -> None:
    """MuJoCo's error falls in proportion to its step: two fine ones tell where it goes."""
    rng = np.random.default_rng(seed)
    plant = PlantFamily.of(DRAWN).draw(rng)
    volts = np.repeat(rng.uniform(-15, 15, 15), 4)
    coarse, fine = (motion(volts, plant=plant, model=stepped(tmp_path, h)) for h in (1 / 8000, 1 / 16000))
    limit = 2 * fine - coarse
    size = np.abs(limit).max(axis=0)
    compiled, mujoco = (motion(volts, plant=plant, engine=engine) for engine in ("compiled", "mujoco"))
    ours, theirs = (np.abs((found - limit) / size).max() for found in (compiled, mujoco))
    assert ours < 2e-3
    assert ours < 0.03 * theirs


LAWS = (
    '<numeric name="dipc_gym:residual.force:pole1" data="20 3 2 -0.1 0 0.1 -2 2 0.3 -0.2 0.1 0.4 -0.3 -0.1"/>'
    '<text name="dipc_gym:input:1:residual.force:pole1" data="position pole1"/>'
    '<text name="dipc_gym:input:2:residual.force:pole1" data="velocity cart"/>'
    '<numeric name="dipc_gym:disturbance.periodic:cart" data="3 7.3 0.4"/>'
)


def test_mujoco_converges_to_it_with_laws_under_custom_too(tmp_path: Path) -> None:
    volts = np.repeat(np.random.default_rng(5).uniform(-15, 15, 15), 4)
    coarse, fine = (motion(volts, model=stepped(tmp_path, h, LAWS)) for h in (1 / 8000, 1 / 16000))
    limit = 2 * fine - coarse
    size = np.abs(limit).max(axis=0)
    model = stepped(tmp_path, 0.001, LAWS)
    compiled, mujoco = (motion(volts, model=model, engine=engine) for engine in ("compiled", "mujoco"))
    ours, theirs = (np.abs((found - limit) / size).max() for found in (compiled, mujoco))
    assert ours < 2e-3
    assert ours < 0.1 * theirs  # a table has corners, at which no method is of fourth order
    assert np.abs((motion(volts) - limit) / size).max() > 0.1


def test_friction_holds_the_cart_and_lets_it_go() -> None:
    env = DoublePendulumEnv(engine="compiled")
    down = [0.0, np.pi, np.pi, 0.0, 0.0, 0.0]
    for volts, moves in ((1.5, False), (3.5, True)):  # 6 and 14 N; it holds up to 11
        env.reset(options={"state": down})
        for _ in range(40):
            info = env.step(np.array([volts]))[4]
        assert bool(abs(env.state[0]) > 0.002) is moves
        if not moves:
            assert info["friction"] == pytest.approx(-4.0 * volts, rel=0.05)


def test_a_blow_moves_it_as_it_moves_mujoco() -> None:
    states = []
    for engine in ("mujoco", "compiled"):
        env = DoublePendulumEnv(engine=engine, plant={"friction": {"coulomb": 0.0, "static": 0.0}})
        env.reset(options={"state": [0.0] * 6})
        env.strike(1.0)
        env.step(np.zeros(1))
        states.append(env.state)
    np.testing.assert_allclose(states[1], states[0], rtol=0.05)
    assert abs(states[1][3]) > 0.3


def test_commands_arrive_late_by_the_delay() -> None:
    env = DoublePendulumEnv(engine="compiled", plant={"delay": 0.0125})
    env.reset(options={"state": [0.0] * 6})
    for _ in range(2):
        env.step(np.array([24.0]))
        assert env.state[3] == 0.0
    env.step(np.array([24.0]))
    assert env.state[3] > 0.01


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_numbers_of_plants_are_those_that_reading_the_model_gives(seed: int) -> None:
    source = DoublePendulumEnv().source
    family = PlantFamily.of(DRAWN)
    rig = Rig.of(source, dataclasses.replace(family.base, delay=family.longest_delay))
    structure, nominal = program.read([rig.endless])
    plant = family.draw(np.random.default_rng(seed))
    known, read = program.read([Rig.of(source, plant).endless])
    assert np.array_equal(structure.codes, known.codes)
    np.testing.assert_allclose(PlantNumbers(rig, structure, nominal[0]).of([plant])[0], read[0], rtol=1e-12, atol=1e-15)


def written_as_read(env: DoublePendulumEnv, plant: Plant) -> None:
    """Numbers of another plant that are written over those of a model are those that reading it anew gives."""
    structure, nominal = program.read([env.rig.endless])
    _, read = program.read([Rig.of(env.source, plant).endless])
    assert not np.array_equal(nominal, read)
    found = PlantNumbers(env.rig, structure, nominal[0]).of([plant])[0]
    np.testing.assert_allclose(found, read[0], rtol=1e-12, atol=1e-15)


def test_a_geared_motor_s_damping_and_armature_change_with_the_pulley(tmp_path: Path) -> None:
    model = edited(tmp_path, '<dcmotor name="motor"', '<dcmotor name="motor" armature="1e-5" damping="1e-4"')
    env = DoublePendulumEnv(model=model)
    plant = dataclasses.replace(env.plant, motor=dataclasses.replace(env.plant.motor, pulley_radius=0.02))
    written_as_read(env, plant)


@pytest.mark.parametrize("more", ["winding", 1, 2, 3])
def test_numbers_of_plants_go_where_reading_a_model_that_says_more_puts_them(more: str | int, tmp_path: Path) -> None:
    """A winding's time constant and the torque of a current follow from the motor; a law's ramps are one element."""
    document = Document(DoublePendulumEnv().source)
    if more == "winding":
        document.set(document.actuator("motor"), inductance="0.003 0", saturation="0 12 0")
    else:
        knots = np.linspace(-0.3, 0.3, int(more) + 1)
        force_of_position(document, "law", "cart", knots.tolist(), np.sin(9 * knots).tolist())
    model = tmp_path / "rig.xml"
    model.write_text(document.text())
    env = DoublePendulumEnv(model=model, engine="compiled")
    own = env.plant
    assert own.motor is not None
    assert own.friction is not None
    plant = dataclasses.replace(
        own,
        motor=dataclasses.replace(own.motor, resistance=1.7, constant=0.05, pulley_radius=0.011),
        friction=dataclasses.replace(own.friction, coulomb=5.0, static=7.0),
    )
    written_as_read(env, plant)


def test_a_supply_that_drives_one_way_is_refused(tmp_path: Path) -> None:
    with pytest.raises(PlantError, match=r"ctrlrange is 0 24; .* write as much below 0 as above"):
        DoublePendulumEnv(model=edited(tmp_path, 'ctrlrange="-24 24"', 'ctrlrange="0 24"'))


def test_code_that_says_something_else_than_mujoco_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    DoublePendulumEnv(engine="compiled")
    monkeypatch.setattr(check, "TOLERANCE", 0.0)  # rounding then counts as a difference
    with pytest.raises(mjcf.MjcfError, match=r"engine 'compiled' is refused for .* differ from MuJoCo's"):
        DoublePendulumEnv(engine="compiled")


# ------------------------------------------------------------------------------------------- beside one another


@pytest.mark.parametrize("count", [1, 7, 8, 9, 130])
def test_any_count_gives_what_a_part_of_it_gives(count: int) -> None:
    many = DIPCFrictionVectorEnv(130, engine="compiled", plant=DRAWN)
    few = DIPCFrictionVectorEnv(count, engine="compiled", plant=DRAWN)
    assert np.array_equal(many.reset(seed=2)[0][:count], few.reset(seed=2)[0])
    volts = np.random.default_rng(0).uniform(-24, 24, (20, 130, 1))
    for u in volts:
        theirs, ours = many.step(u), few.step(u[:count])
        assert all(np.array_equal(a[:count], b) for a, b in zip(theirs[:4], ours[:4], strict=True))


@pytest.mark.parametrize("clone", [copy.deepcopy, lambda env: pickle.loads(pickle.dumps(env))])
@pytest.mark.parametrize("many", [False, True])
def test_a_copy_goes_on_bit_for_bit(clone: Any, many: bool) -> None:
    kwargs: dict[str, Any] = {"engine": "compiled", "plant": {**DRAWN, "encoders": {"noise": 0.3}}}
    env: Any = DIPCFrictionVectorEnv(9, **kwargs) if many else DoublePendulumEnv(**kwargs)
    volts = np.random.default_rng(1).uniform(-24, 24, (40, *env.action_space.shape))
    env.reset(seed=4)
    for u in volts[:20]:
        env.step(u)
    twin = clone(env)
    for u in volts[20:]:
        assert data_equivalence(env.step(u), twin.step(u), exact=True)
    assert data_equivalence(env.reset(), twin.reset(), exact=True)


def test_what_was_given_out_stays_as_it_was() -> None:
    env = DIPCFrictionVectorEnv(9, engine="compiled")
    env.reset(seed=0)
    first = env.step(np.full((9, 1), 5.0))
    kept = copy.deepcopy(first)
    env.step(np.full((9, 1), -5.0))
    env.reset()
    assert data_equivalence(first, kept, exact=True)


# ------------------------------------------------------------------------------------------------- what is refused


@pytest.mark.parametrize("many", [False, True])
@pytest.mark.parametrize(
    ("was", "becomes", "says"),
    [
        ('name="cart" type="slide"', 'name="cart" type="slide" frictionloss="3"', "frictionloss"),
        ('name="pole1" type="hinge"', 'name="pole1" type="hinge" range="-1 1"', "range of joint 'pole1'"),
        ('<jointpos name="cart"', '<jointpos delay="0.002" nsample="4" name="cart"', "delay"),
        (
            "<keyframe>",
            '<custom><numeric name="dipc_gym:motor.deadzone:motor" data="0.4"/></custom><keyframe>',
            "<custom>",
        ),
    ],
)
def test_what_the_engine_leaves_out_is_named(was: str, becomes: str, says: str, many: bool, tmp_path: Path) -> None:
    model, kind = edited(tmp_path, was, becomes), DIPCFrictionVectorEnv if many else DoublePendulumEnv
    DoublePendulumEnv(model=model)
    with pytest.raises(mjcf.MjcfError, match=rf"rig\.xml: .*does not simulate .*{says}.*engine='mujoco'"):
        kind(model=model, engine="compiled")


@pytest.mark.parametrize("kind", [DoublePendulumEnv, DIPCFrictionVectorEnv])
@pytest.mark.parametrize("name", ["compile", "jax", None, ["mujoco"]])
def test_an_unknown_engine_is_told_which_there_are(kind: Any, name: Any) -> None:
    with pytest.raises(ValueError, match=r"engine is .*; it can be 'mujoco' or 'compiled'"):
        kind(engine=name)


def test_the_engine_is_part_of_the_spec() -> None:
    env = gymnasium.make(dipc_gym.ENV_ID, engine="compiled")
    assert env.spec is not None
    again: Any = gymnasium.make(type(env.spec).from_json(env.spec.to_json())).unwrapped
    assert again.engine == "compiled"


# --------------------------------------------------------------------------------------------- elementary functions


def elementary() -> Any:
    """Exponential, sine and cosine of eight numbers."""
    module = ir.Module("elementary")
    code = Code(module, "three", [POINTER] * 2, width=WIDTH)
    x, out = (code.numbers(argument) for argument in code.function.args)
    out[0] = exp(x[0])
    out[1], out[2] = sin_cos(x[0])
    code.finish()
    library = machine.load([str(module)], ["three"])
    function = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)(library.addresses["three"])

    def three(numbers: np.ndarray) -> np.ndarray:
        assert library
        out = np.zeros((3, WIDTH))
        function(np.ascontiguousarray(numbers).ctypes.data, out.ctypes.data)
        return out

    return three


THREE = elementary()


@settings(max_examples=300, deadline=None)
@given(st.lists(st.floats(-1e5, 1e5), min_size=WIDTH, max_size=WIDTH), st.sampled_from([1e-3, 1e-2, 1.0]))
def test_elementary_functions_are_right_to_the_last_bits(numbers: list[float], scale: float) -> None:
    x = np.array(numbers) * scale
    e, s, c = THREE(x)
    inside = np.abs(x) < 700
    np.testing.assert_allclose(e[inside], np.exp(x[inside]), rtol=4e-16)
    np.testing.assert_allclose(s, np.sin(x), rtol=0, atol=3e-16)
    np.testing.assert_allclose(c, np.cos(x), rtol=0, atol=3e-16)


def test_exponentials_far_out_stay_numbers_and_what_is_none_stays_none() -> None:
    e, s, _ = THREE(np.array([-1e300, -800.0, 710.0, np.nan, 0.0, -np.inf, np.nan, 0.0]))
    assert (e[[0, 1, 5]] < 1e-300).all()
    assert (e[[0, 1, 5]] >= 0).all()
    assert np.isfinite(e[2])
    assert np.isnan(e[[3, 6]]).all()
    assert np.isnan(s[[3, 6]]).all()
    assert e[4] == 1.0
    assert s[4] == 0.0
