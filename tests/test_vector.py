"""Many environments in one batch: the same as single ones to the last bit, and what is refused."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np
import pytest
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AutoresetMode, SyncVectorEnv
from hypothesis import given, settings
from hypothesis import strategies as st
from mujoco import batch as mjbatch

import dipc_gym
from dipc_gym import mjcf
from dipc_gym.compensators import Ideal, StaticGain
from dipc_gym.env import DoublePendulumEnv
from dipc_gym.plant import Friction, Masses, Motor, Plant, PlantError
from dipc_gym.randomise import Normal, PlantFamily, Uniform
from dipc_gym.rigs.batch import MujocoRigs
from dipc_gym.vector import DIPCFrictionVectorEnv
from dipc_gym.wrappers import ForceCommand, RecordRun, VectorForceCommand, VectorRecordRun

N = 5
RANDOM = {
    "friction": {
        "coulomb": {"uniform": [4.0, 9.0]},
        "static": {"uniform": [7.0, 14.0]},
        "viscous": {"normal": [20, 2]},
    },
    "motor": {"resistance": {"normal": [1.2, 0.05]}, "pulley_radius": {"uniform": [0.012, 0.013]}},
    "masses": {"cart": {"uniform": [0.4, 0.8]}, "pole2": {"uniform": [0.1, 0.15]}},
    "delay": {"uniform": [0.0, 0.004]},
    "encoders": {"noise": {"uniform": [0.0, 0.5]}, "velocity_filter": {"uniform": [0.0, 0.02]}},
}
WILD = [0.0, 0.0, 0.0, 0.0, 1e4, -1e4]  # two turns a step: no integrator follows that


ENGINES = ("mujoco", "compiled")


def batched(num_envs: int = N, **kwargs: Any) -> DIPCFrictionVectorEnv:
    env = gymnasium.make_vec(
        dipc_gym.ENV_ID, num_envs=num_envs, vectorization_mode="vector_entry_point", **kwargs
    ).unwrapped
    assert isinstance(env, DIPCFrictionVectorEnv)
    return env


def test_a_batch_wants_a_reset_before_its_first_step() -> None:
    ours = batched()
    with pytest.raises(gymnasium.error.ResetNeeded):
        ours.step(np.zeros((N, 1), dtype=np.float32))
    ours.reset(seed=1)
    ours.step(np.zeros((N, 1), dtype=np.float32))


def one_by_one(
    autoreset_mode: str = "NextStep", wrap: Any = lambda env: env, n: int = N, **kwargs: Any
) -> SyncVectorEnv:
    return SyncVectorEnv(
        [lambda: wrap(gymnasium.make(dipc_gym.ENV_ID, **kwargs)) for _ in range(n)], autoreset_mode=autoreset_mode
    )


def same(a: Any, b: Any) -> bool:
    """Equal to the last bit, whatever the order of keys."""
    if isinstance(a, dict):
        return isinstance(b, dict) and a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, tuple):
        return len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, np.ndarray) and a.dtype == object:
        return b.dtype == object and all(
            x is y is None or (x is not None and data_equivalence(x, y, exact=True)) for x, y in zip(a, b, strict=True)
        )
    return bool(data_equivalence(a, b, exact=True))


def drive(ours: Any, theirs: Any, mode: str, steps: int, size: float = 24.0, **reset: Any) -> dict[str, int]:
    """Step both with the same seeds and actions; how often what happened."""
    rng = np.random.default_rng(0)
    assert same(ours.reset(seed=3, **reset), theirs.reset(seed=3, **reset))
    seen = dict.fromkeys(("terminated", "truncated", "diverged"), 0)
    for _ in range(steps):
        actions = rng.uniform(-size, size, (ours.num_envs, 1)).astype(np.float32)
        mine, other = ours.step(actions), theirs.step(actions)
        assert same(mine, other)
        _, _, terminated, truncated, infos = mine
        ended = terminated | truncated
        seen["terminated"] += int(terminated.sum())
        seen["truncated"] += int(truncated.sum())
        seen["diverged"] += int(infos.get("final_info", infos)["diverged"].sum())
        if mode == "Disabled" and ended.any():
            again = [{"reset_mask": ended.copy()} for _ in range(2)]
            assert same(ours.reset(options=again[0]), theirs.reset(options=again[1]))
    return seen


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("mode", ["NextStep", "SameStep", "Disabled"])
@pytest.mark.parametrize("plant", [None, {"encoders": {"noise": 0.5}}, RANDOM], ids=["home", "noise", "random"])
def test_equals_single_environments_to_the_last_bit(mode: str, plant: Any, engine: str) -> None:
    kwargs = {"plant": plant, "max_episode_steps": 40, "engine": engine}
    seen = drive(batched(autoreset_mode=mode, **kwargs), one_by_one(mode, **kwargs), mode, 200)
    assert seen["truncated"] > 5
    if plant is None:
        ours, theirs = batched(autoreset_mode=mode, engine=engine), one_by_one(mode, engine=engine)
        assert drive(ours, theirs, mode, 150, 200.0)["terminated"] > 2


@pytest.mark.parametrize("engine", ENGINES)
@pytest.mark.parametrize("mode", ["NextStep", "SameStep", "Disabled"])
@pytest.mark.parametrize("exact_state", [False, True])
def test_equals_where_simulations_diverge(
    mode: str, exact_state: bool, engine: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    kwargs = {"exact_state": exact_state, "plant": {"encoders": {"noise": 0.2}}, "engine": engine}
    ours, theirs = batched(autoreset_mode=mode, **kwargs), one_by_one(mode, **kwargs)
    seen = drive(ours, theirs, mode, 20, options={"state": WILD})
    assert seen["diverged"] == N
    assert not list(tmp_path.iterdir())  # no MUJOCO_LOG.TXT


@pytest.mark.parametrize(
    "options", [{"start": "hanging"}, {"state": [0.1, 0.5, 0, 0, 1, 0]}, {"plant": {"delay": 0.0}}]
)
@pytest.mark.parametrize("engine", ENGINES)
def test_equals_with_options_and_exact_state(options: dict[str, Any], engine: str) -> None:
    kwargs = {"plant": RANDOM, "exact_state": True, "engine": engine}
    drive(batched(**kwargs), one_by_one(**kwargs), "NextStep", 40, options=options)


@pytest.mark.parametrize("engine", ENGINES)
def test_threads_do_not_matter(engine: str) -> None:
    one, more = (batched(300, threads=threads, plant=RANDOM, engine=engine) for threads in (1, 3))
    drive(one, more, "NextStep", 20)


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
@pytest.mark.parametrize("compensator", [StaticGain(newtons_per_volt=4.0), Ideal(newtons_per_volt=4.0), "llnf"])
def test_force_command_equals_single_ones(mode: str, compensator: Any, request: pytest.FixtureRequest) -> None:
    if compensator == "llnf":
        compensator = request.getfixturevalue("llnf")
    kwargs = {"max_episode_steps": 25, "plant": {"encoders": {"noise": 0.3}}}
    ours = VectorForceCommand(batched(autoreset_mode=mode, **kwargs), compensator)
    theirs = one_by_one(mode, lambda env: ForceCommand(env, compensator), **kwargs)
    assert ours.single_action_space == theirs.single_action_space
    drive(ours, theirs, mode, 70, size=40.0)


@pytest.fixture(scope="module")
def llnf() -> Any:
    from dipc_gym.compensators import RigConstants, Samples, fit

    rng = np.random.default_rng(1)
    force, velocity = rng.uniform(-100, 100, 400), rng.uniform(-2, 2, 400)
    volts = force / 4 + 2 * np.sign(velocity)
    samples = Samples(force, velocity, velocity, volts, np.arange(400) % 2 == 0)
    return fit("llnf", samples, RigConstants(newtons_per_volt=4.0, viscous=40.0, supply_voltage=24.0))


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_recordings_equal_single_ones(mode: str, tmp_path: Path) -> None:
    ours = VectorRecordRun(batched(2, autoreset_mode=mode, max_episode_steps=20), tmp_path / "ours")
    folders = iter((tmp_path / "0", tmp_path / "1"))
    theirs = one_by_one(mode, lambda env: RecordRun(env, next(folders)), 2, max_episode_steps=20)
    drive(ours, theirs, mode, 50)
    ours.close()
    theirs.close()
    files = sorted(path.name for path in (tmp_path / "ours").iterdir())
    assert files == [f"run-{row}-{episode}.csv" for row in range(2) for episode in range(3)]
    for row in range(2):
        for episode in range(3):
            mine = (tmp_path / "ours" / f"run-{row}-{episode}.csv").read_text()
            assert mine == (tmp_path / str(row) / f"run-{episode}.csv").read_text()
    with pytest.raises(FileExistsError, match="choose another folder"):
        VectorRecordRun(batched(2), tmp_path / "ours")


def test_spec_and_metadata() -> None:
    envs = batched(3)
    assert envs.max_episode_steps == 2_000
    assert envs.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
    assert envs.observation_space.shape == (3, 6)
    assert len({id(rng) for rng in envs.np_random}) == 3
    envs.reset(seed=[5, 9, 5])
    assert envs.np_random_seed == (5, 9, 5)
    assert np.array_equal(envs.state[0], envs.state[2])


# --------------------------------------------------------------------------------------------------- families

SPREADS = st.sampled_from(["uniform", "normal"])


@pytest.mark.parametrize("winding", ["", 'inductance="0.003 0" saturation="0 12 0" '])
@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_numbers_written_are_those_that_compiling_gives(
    winding: str, tmp_path_factory: pytest.TempPathFactory, seed: int
) -> None:
    text = DoublePendulumEnv().source.text.replace('<dcmotor name="motor" ', f'<dcmotor name="motor" {winding}')
    assert winding in text
    model = tmp_path_factory.mktemp("wound") / "rig.xml"
    model.write_text(text)
    envs = DIPCFrictionVectorEnv(2, model=model, plant=RANDOM)
    envs.reset(seed=seed)
    rigs = envs._rigs
    assert isinstance(rigs, MujocoRigs)
    source = rigs.rig.source
    longest = envs._family.longest_delay
    for row, plant in enumerate(envs.plants):
        written = rigs.sims.get_model(row)
        layout = dataclasses.replace(plant, delay=longest)
        compiled = mjcf.compile(source.edited(layout.to_mjcf(source.text)), trusted=True)
        assert written.actuator_delay[0] == plant.delay
        for name in mjbatch.MODEL_FIELDS - {"actuator_delay"}:
            if not name.startswith("opt."):
                np.testing.assert_array_equal(getattr(written, name), getattr(compiled, name), err_msg=name)


def test_single_environment_draws_too() -> None:
    env = DoublePendulumEnv(plant=RANDOM)
    env.reset(seed=1)
    first = env.plant
    env.reset()
    assert env.plant != first
    env.reset(seed=1)
    assert env.plant == first
    assert first.friction is not None
    assert 4.0 <= first.friction.coulomb <= first.friction.static <= 14.0


def test_draws_follow_their_distributions() -> None:
    rng = np.random.default_rng(0)
    family = PlantFamily.of({"motor": {"resistance": {"uniform": [1, 2]}}, "masses": {"cart": {"normal": [0.6, 0.1]}}})
    plants = [family.draw(rng) for _ in range(4_000)]
    resistance = np.array([plant.motor.resistance for plant in plants if plant.motor])
    cart = np.array([plant.masses.cart for plant in plants])
    assert 1 <= resistance.min() < 1.01 < 1.99 < resistance.max() <= 2
    assert resistance.std() == pytest.approx(1 / 12**0.5, rel=0.05)
    assert cart.mean() == pytest.approx(0.6, abs=0.01)
    assert 0.3 <= cart.min() < cart.max() <= 0.9
    assert abs(np.corrcoef(resistance, cart)[0, 1]) < 0.06


def test_masses_and_delay_reach_the_model() -> None:
    plain, heavy = DoublePendulumEnv(), DoublePendulumEnv(plant={"masses": {"pole1": 1.14318}, "delay": 0.01})
    ratio = heavy.model.body("pole1").inertia / plain.model.body("pole1").inertia
    np.testing.assert_allclose(ratio, 2.0, rtol=1e-12)
    for env in (plain, heavy):
        env.reset(options={"state": [0.0] * 6})
    plain.step([24.0])
    assert not np.any(heavy.step([24.0])[4]["clipped"])
    assert abs(plain.state[3]) > 0.01  # the voltage has acted
    assert heavy.state[3] == 0.0  # and here has not arrived
    heavy.step([24.0])
    heavy.step([24.0])
    assert heavy.state[3] > 0.01


def test_plants_with_masses_and_delay_go_through_files(tmp_path: Path) -> None:
    plant = Plant(masses=Masses(cart=0.7), delay=0.002, motor=Motor(resistance=2.0), friction=Friction(viscous=3.0))
    plant.write(tmp_path / "plant.json")
    assert Plant.read(tmp_path / "plant.json") == plant


@pytest.mark.parametrize(
    ("plant", "says"),
    [
        ({"friction": {"coulomb": {"uniform": [9, 5]}}}, r"friction\.coulomb: uniform \[9, 5\] has its low end above"),
        ({"masses": {"cart": {"uniform": [-1, 1]}}}, r"masses\.cart: uniform \[-1, 1\] reaches -1.*must be positive"),
        ({"masses": {"cart": {"normal": [0.5, 0.2]}}}, r"masses\.cart: normal .* reaches -0\.1"),
        ({"masses": {"cart": -0.5}}, r"masses\.cart is -0\.5"),
        ({"masses": {"wheel": {"uniform": [1, 2]}}}, r"unknown field 'masses\.wheel'"),
        ({"frction": {"coulomb": 5.0}}, "unknown field 'frction'.*did you mean 'friction'"),
        ({"delay": {"uniform": [0.0, 1.5]}}, r"delay: uniform \[0, 1\.5\] reaches 1\.5 s; it can be 1 s at most"),
        ({"delay": {"normal": [0.001, 0.001]}}, "delay: normal .* must not be negative"),
        ({"delay": -0.001}, "delay is -0.001"),
        ({"supply": {"uniform": [12, 24]}}, "supply is the same for all episodes"),
        ({"motor": {"resistance": {"normal": [1, -1]}}}, "negative standard deviation"),
        ({"motor": {"resistance": {"normal": [1]}}}, r"takes two finite numbers \[mean, sd\]"),
        ({"motor": {"resistance": {"uniform": [1, float("inf")]}}}, "takes two finite numbers"),
        ({"motor": {"resistance": {"uniform": [True, 2]}}}, "takes two finite numbers"),
        ({"motor": {"resistance": {"gamma": [1, 2]}}}, r"motor\.resistance is .*write a number"),
        ({"friction": {"static": {"uniform": [1, 2]}}}, "friction.static is 1.5 N, below"),
        ([1], "a plant is a JSON object"),
    ],
)
def test_impossible_distributions_are_refused(plant: Any, says: str, tmp_path: Path) -> None:
    with pytest.raises(PlantError, match=says):
        PlantFamily.of(plant)
    file = tmp_path / "plant.json"
    file.write_text(json.dumps(plant))
    with pytest.raises(PlantError, match=r"plant\.json: .*" + says):
        batched(2, plant=file)


@pytest.mark.parametrize(
    ("kwargs", "says"),
    [
        ({"num_envs": 0}, "num_envs is 0"),
        ({"num_envs": -3}, "num_envs is -3"),
        ({"num_envs": 2.0}, "num_envs is 2.0"),
        ({"max_episode_steps": 0}, "max_episode_steps is 0"),
        ({"threads": -1}, "threads is -1"),
        ({"autoreset_mode": "sometimes"}, "sometimes"),
    ],
)
def test_impossible_batches_are_refused(kwargs: dict[str, Any], says: str) -> None:
    with pytest.raises(ValueError, match=says):
        DIPCFrictionVectorEnv(**kwargs)


def test_misuse_is_named() -> None:
    envs = batched(2, autoreset_mode="Disabled", max_episode_steps=1)
    envs.reset(seed=0)
    with pytest.raises(ValueError, match=r"\(2, 1\), the voltage of each"):
        envs.step(np.zeros(2))
    with pytest.raises(ValueError, match="voltage of row 1 is nan"):
        envs.step(np.array([[0.0], [np.nan]]))
    envs.step(np.zeros((2, 1)))
    with pytest.raises(RuntimeError, match="episode of row 0 is over"):
        envs.step(np.zeros((2, 1)))
    with pytest.raises(ValueError, match="unknown reset options"):
        envs.reset(options={"speed": 1})
    with pytest.raises(ValueError, match="3 seeds for 2"):
        envs.reset(seed=[1, 2, 3])
    with pytest.raises(ValueError, match="selects no environment"):
        envs.reset(options={"reset_mask": np.zeros(2, dtype=bool)})
    for plant, says in (
        ({"supply": 12.0}, "supply"),
        ({"delay": 0.01}, "delay of up to"),
        ({"friction": {"coulomb": 0.0, "static": 0.0}}, "actuator"),
    ):
        with pytest.raises(PlantError, match=says):
            envs.reset(options={"plant": plant})


def test_models_that_the_batch_cannot_do_are_refused(tmp_path: Path) -> None:
    text = DoublePendulumEnv().source.text
    biased = tmp_path / "biased.xml"
    entry = '<custom><numeric name="dipc_gym:sensor.bias:pole1" data="0.1"/></custom>'
    biased.write_text(text.replace("<keyframe>", f"{entry}<keyframe>"))
    with pytest.raises(mjcf.MjcfError, match="vectorization_mode='sync'"):
        batched(2, model=biased)


LAWS = {
    "a force of two joints": (
        '<numeric name="dipc_gym:residual.force:pole1" data="20 3 2 -1 0 1 -2 2 0.3 -0.2 0.1 0.4 -0.3 -0.1"/>'
        '<text name="dipc_gym:input:1:residual.force:pole1" data="position pole1"/>'
        '<text name="dipc_gym:input:2:residual.force:pole1" data="velocity cart"/>'
    ),
    "a force of a command": (
        '<numeric name="dipc_gym:residual.force:cart" data="5 3 1 -20 0 20 0 -4 1 3"/>'
        '<text name="dipc_gym:input:1:residual.force:cart" data="command motor"/>'
    ),
    "a bent amplifier": '<numeric name="dipc_gym:motor.map:motor" data="-10 0 10 -7 0.5 9"/>',
    "forces of time": (
        '<numeric name="dipc_gym:disturbance.periodic:cart" data="2 1.3 0.4"/>'
        '<numeric name="dipc_gym:disturbance.pulse:pole2" data="0.02 0.1 0.2"/>'
    ),
    "forces of what went before": (
        '<numeric name="dipc_gym:load.creeping:cart" data="80 0.05 0 0.02 0.1"/>'
        '<numeric name="dipc_gym:friction.hysteresis:cart" data="2 900 800 300 0"/>'
        '</custom><size nuserdata="2"/><custom>'
    ),
    "force that a supply which sags takes off": (
        '<text name="dipc_gym:input:1:motor.sag:cart" data="command motor"/>'
        '<numeric name="dipc_gym:motor.sag:cart" data="4 4 0.05 0.2"/>'
        '</custom><size nuserdata="1"/><custom>'
    ),
}
ROUGH = {
    "friction that grows at rest": (
        "<keyframe>",
        '<numeric name="dipc_gym:friction.resting:cart" data="2 3 0.1 1e-3"/></custom><size nuserdata="1"/><custom>',
    ),
    "friction that grows at rest by a law": (
        "<keyframe>",
        '<numeric name="dipc_gym:friction.rested_by_law:cart" data="2 0.5 0.05 1e-3 0 1 1.5"/></custom>'
        '<size nuserdata="1"/><custom>',
    ),
    "frictionloss": ('name="cart" type="slide"', 'name="cart" type="slide" frictionloss="3" solreffriction="0.002 1"'),
    "friction along the way": ("<keyframe>", '<numeric name="dipc_gym:friction.position:cart" data="-0.4 0.4 2 5 1"/>'),
    "friction under load": ("<keyframe>", '<numeric name="dipc_gym:friction.load:cart" data="2 0.1 0.05"/>'),
    "friction under load that weakens with speed": (
        "<keyframe>",
        '<numeric name="dipc_gym:friction.load_stribeck:cart" data="2 0.1 0.05 0.5 0.02"/>',
    ),
    "friction under load that weakens with speed by a law": (
        "<keyframe>",
        '<numeric name="dipc_gym:friction.load_by_speed:cart" data="2 0.1 0.05 0.4 0.04 0.5 0.2 0"/>',
    ),
}


def written(folder: Path, was: str, becomes: str) -> Path:
    if was == "<keyframe>":
        becomes = f"<custom>{becomes}</custom><keyframe>"
    text = DoublePendulumEnv().source.text
    assert was in text
    (folder / "improved.xml").write_text(text.replace(was, becomes))
    return folder / "improved.xml"


FORCES = [law for law in LAWS if "force" in law]  # what the compiled engine has


@pytest.mark.parametrize(
    ("law", "engine"), [*((law, "mujoco") for law in LAWS), *((law, "compiled") for law in FORCES)]
)
def test_laws_under_custom_run_in_the_batch(law: str, engine: str, tmp_path: Path) -> None:
    model = written(tmp_path, "<keyframe>", LAWS[law])
    kwargs = {"engine": engine, "plant": {"encoders": {"noise": 0.2}}, "model": model, "max_episode_steps": 60}
    ours = batched(**kwargs)
    seen = drive(ours, one_by_one(**kwargs), "NextStep", 150)
    assert seen["terminated"] + seen["truncated"] > 2
    still = batched(**{**kwargs, "model": None})
    for one in (ours, still):
        one.reset(seed=1)
    actions = np.full((N, 1), 4.0, dtype=np.float32)
    gaps = [np.abs(ours.step(actions)[0] - still.step(actions)[0]).max() for _ in range(30)]
    assert max(gaps) > 1e-3  # they do something


@pytest.mark.parametrize("kind", ROUGH)
def test_dry_friction_by_frictionloss_runs_in_the_batch(kind: str, tmp_path: Path) -> None:
    kwargs: dict[str, Any] = {"model": written(tmp_path, *ROUGH[kind])}
    assert mujoco.MjModel.from_xml_path(str(kwargs["model"])).nv == 3
    ours, theirs = batched(**kwargs), one_by_one(**kwargs)
    drive(ours, theirs, "NextStep", 200, options={"start": "hanging"})
    for one in (ours, theirs):
        one.reset(seed=1, options={"state": [0.43, np.pi, np.pi, 2.0, 0.0, 0.0]})
    rng, ended = np.random.default_rng(0), 0
    while ended < N:
        actions = rng.uniform(-24, 24, (N, 1)).astype(np.float32)
        mine, other = ours.step(actions), theirs.step(actions)
        stopped = mine[2]
        ended += int(stopped.sum())
        for infos in (mine[4], other[4]):
            infos["friction"] = np.where(stopped, 0.0, infos["friction"])
        assert same(mine, other)  # but for the friction beside the stop's push


@pytest.mark.parametrize(
    ("name", "spread", "says"),
    [
        ("friction.coulomb", Uniform(12.0, 13.0), r"friction\.static is 11 N, below"),  # every draw would be
        ("friction.coulomb", Uniform(5.0, 9.0), r"other numbers than the centres of friction\.coulomb"),
        ("friction.coulomb", Normal(8.0, 4.0), "reaches -4"),
        ("friction.coulomb", Uniform(float("nan"), 9.0), "is not of finite numbers"),
        ("supply", Uniform(12.0, 36.0), "supply is the same for all episodes"),
        ("friction.colour", Uniform(1.0, 2.0), "unknown field"),
    ],
)
def test_a_family_made_by_hand_is_checked_as_one_from_a_file(name: str, spread: Any, says: str) -> None:
    with pytest.raises(PlantError, match=says):
        PlantFamily(Plant(), ((name, spread),))


def test_a_batch_that_is_to_draw_is_refused_in_words() -> None:
    with pytest.raises(ValueError, match="render_mode is 'rgb_array'; the batch draws nothing"):
        batched(2, render_mode="rgb_array")
    batched(2, render_mode=None)


@pytest.mark.parametrize("engine", ["mujoco", "compiled"])
def test_springs_that_yield_are_unbent_where_an_episode_begins(engine: str, tmp_path: Path) -> None:
    """MuJoCo has them unbent at 0, from where a cart that begins elsewhere is thrown."""
    slips = (
        '<tendon><fixed stiffness="3000 0 0" springlength="0" springyield="0.001"><joint joint="cart" coef="1"/>'
        "</fixed></tendon><keyframe>"
    )
    text = DoublePendulumEnv().source.text
    assert "<keyframe>" in text
    model = tmp_path / "improved.xml"
    model.write_text(text.replace("<keyframe>", slips))
    begin = {"state": (0.2, 0.0, 0.0, 0.0, 0.0, 0.0)}
    env = DoublePendulumEnv(model=model, engine=engine)
    env.reset(seed=0, options=begin)
    env.step([0.0])
    envs = DIPCFrictionVectorEnv(2, model=model, engine=engine)
    envs.reset(seed=0, options=begin)
    envs.step(np.zeros((2, 1)))
    for x, *_, v, _, _ in (env.state, *envs.state):
        assert (x, v) == (pytest.approx(0.2, abs=1e-4), pytest.approx(0.0, abs=1e-3))


def test_every_row_is_reset_before_the_first_step() -> None:
    envs = gymnasium.make_vec(dipc_gym.ENV_ID, 3, "vector_entry_point", autoreset_mode="Disabled")
    envs.reset(seed=0, options={"reset_mask": np.array([True, False, True])})
    with pytest.raises(gymnasium.error.ResetNeeded, match="row 1 was never reset"):
        envs.step(np.zeros((3, 1)))
    envs.reset(options={"reset_mask": np.array([False, True, False])})
    envs.step(np.zeros((3, 1)))
