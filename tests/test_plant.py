"""Plants: files, MJCF, and everything that cannot be."""

from __future__ import annotations

import dataclasses
import json
from importlib import resources
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dipc_gym import ENV_ID
from dipc_gym.mjcf import MjcfError
from dipc_gym.plant import RANGES, Encoders, Friction, Masses, Motor, Plant, PlantError, physics_steps
from dipc_gym.randomise import PlantFamily

RIG = resources.files("dipc_gym").joinpath("rig.xml").read_text()

positive = st.floats(1e-3, 10.0)
plants = st.builds(
    lambda motor, coulomb, above, rest, supply: Plant(
        motor=Motor(resistance=motor[0], constant=motor[1], pulley_radius=motor[2]),
        friction=Friction(
            coulomb=coulomb,
            static=coulomb + above,
            stribeck_velocity=rest[0],
            bristle_stiffness=rest[1],
            bristle_damping=rest[2],
            viscous=rest[3],
        ),
        supply=supply,
    ),
    st.tuples(positive, positive, positive),
    positive,
    positive,
    st.tuples(positive, positive, positive, positive),
    positive,
)


def test_default_plant_is_what_the_rig_says() -> None:
    assert Plant.from_mjcf(RIG) == Plant()


@given(plants)
def test_mjcf_holds_a_plant(plant: Plant) -> None:
    again = Plant.from_mjcf(plant.to_mjcf(RIG))
    assert again.friction == plant.friction
    assert again.supply == plant.supply
    assert again.motor is not None
    assert plant.motor is not None
    # The file holds the gear, one over the radius: the last bit may differ.
    assert again.motor.pulley_radius == pytest.approx(plant.motor.pulley_radius, rel=1e-15)
    assert dataclasses.replace(again.motor, pulley_radius=1.0) == dataclasses.replace(plant.motor, pulley_radius=1.0)


@given(plants)
def test_dictionary_holds_a_plant(plant: Plant) -> None:
    assert Plant.from_dict(json.loads(json.dumps(plant.to_dict()))) == plant


def test_file_holds_a_plant(tmp_path: Path) -> None:
    plant = Plant(motor=None, encoders=Encoders(noise=0.5), control_period=0.01)
    plant.write(tmp_path / "plant.json")
    assert Plant.read(tmp_path / "plant.json") == plant


def test_dictionary_changes_only_what_it_names() -> None:
    base = Plant(supply=12.0, friction=Friction(coulomb=3.0, static=4.0))
    changed = Plant.from_dict({"friction": {"static": 5}}, base)
    assert changed == Plant(supply=12.0, friction=Friction(coulomb=3.0, static=5.0))


def test_no_dry_friction_removes_the_element() -> None:
    text = Plant(friction=Friction(coulomb=0.0, static=0.0, viscous=7.0)).to_mjcf(RIG)
    assert "lugre" not in text
    assert 'damping="7.0"' in text


def test_none_leaves_the_model_alone() -> None:
    text = Plant(motor=None, friction=None).to_mjcf(RIG)
    assert Plant.from_mjcf(text) == Plant()


@pytest.mark.parametrize(
    ("data", "says"),
    [
        ({"friction": {"coulomb": -1.0}}, "friction.coulomb is -1"),
        ({"friction": {"static": 1.0}}, "friction.static is 1 N, below friction.coulomb"),
        ({"friction": {"coulomb": 50}}, "below friction.coulomb 50 N; set friction.static as well"),
        ({"friction": {"coulomb": 0.0}}, "friction.coulomb is 0 while"),
        ({"friction": {"stribeck_velocity": 0.0}}, "friction.stribeck_velocity is 0"),
        ({"friction": {"wet": 1.0}}, "unknown field 'friction.wet'"),
        ({"friction": 3}, "friction must be an object"),
        ({"motor": {"resistance": "1.2"}}, "motor.resistance must be a number"),
        ({"motor": {"constant": float("nan")}}, "motor.constant is nan"),
        ({"encoders": None}, "encoders must be an object"),
        ({"encoders": {"noise": float("inf")}}, "encoders.noise is inf"),
        ({"supply": True}, "supply must be a number"),
        ({"voltage": 24}, "unknown field 'voltage'"),
        ({"schema": "dipc-gym/plant/2"}, "this version reads"),
        ([1, 2], "a plant is a JSON object"),
    ],
)
def test_impossible_plants_are_refused(data: Any, says: str, tmp_path: Path) -> None:
    with pytest.raises(PlantError, match=says.replace(".", r"\.")):
        Plant.from_dict(data)
    file = tmp_path / "plant.json"
    file.write_text(json.dumps(data))
    with pytest.raises(PlantError, match=r"plant\.json: "):
        Plant.read(file)


ABSURD = {
    "supply": (1e300, 0.0, -1.0, 10**400, 1e-300),
    "control_period": (1e9, 1e-300, float("nan")),
    "delay": (1.5, -0.1, 10**400),
    "motor.resistance": (1e-300, 1e300),
    "motor.pulley_radius": (1e-300, 1e9),
    "friction.coulomb": (1e300,),
    "friction.bristle_stiffness": (1e300, 0.0),
    "encoders.cart": (1e-300, 1e300),
    "encoders.noise": (1e300, -1.0),
    "masses.pole1": (1e-300, 1e300, 0.0),
}


@pytest.mark.parametrize(("name", "value"), [(name, value) for name in ABSURD for value in ABSURD[name]])
def test_numbers_of_no_rig_are_refused_with_their_range(name: str, value: float) -> None:
    least, most, unit = RANGES[name]
    part, _, field = name.rpartition(".")
    data = {part: {field: value}} if part else {field: value}
    with pytest.raises(
        PlantError, match=rf"{name} is .*; it must be from {least:g} to {most:g} {unit}".replace("+", ".")
    ):
        Plant.from_dict(data)
    for spread in ({"uniform": [value, value]}, {"normal": [value, 0.0]}):
        drawn = {part: {field: spread}} if part else {field: spread}
        with pytest.raises(PlantError, match=name):
            PlantFamily.of(drawn)


def test_every_number_has_a_range_and_the_default_rig_is_well_within() -> None:
    plant = Plant(masses=Masses(cart=1.0, pole1=0.1, pole2=0.1)).to_dict()
    flat = {name: value for name, value in plant.items() if not isinstance(value, dict)}
    flat |= {f"{part}.{name}": v for part in plant if isinstance(plant[part], dict) for name, v in plant[part].items()}
    assert flat.keys() == RANGES.keys()
    assert all(RANGES[name][0] <= value <= RANGES[name][1] for name, value in flat.items())


@settings(deadline=None, max_examples=60)
@given(st.data())
def test_whatever_plant_is_allowed_starts_with_finite_numbers(data: st.DataObject) -> None:
    """What a reset gives is finite, and so is the space of actions, even at the ends of all ranges."""
    numbers = {
        name: data.draw(st.one_of(st.sampled_from((least, most)), st.floats(least, most)), label=name)
        for name, (least, most, _) in RANGES.items()
        if name not in ("control_period", "delay")
    }
    numbers["control_period"] = data.draw(st.sampled_from((1e-3, 5e-3, 1.0)), label="control_period")
    numbers["friction.static"] = max(numbers["friction.static"], numbers["friction.coulomb"])
    nested: dict[str, Any] = {}
    for name, value in numbers.items():
        part, _, field = name.rpartition(".")
        (nested.setdefault(part, {}) if part else nested)[field] = value
    try:
        env = gymnasium.make(ENV_ID, plant=nested)
    except (PlantError, MjcfError):  # refused in words: no dry friction with a static one, no inertia to speak of
        return
    observation, info = env.reset(seed=1)
    assert np.isfinite(observation).all()
    assert np.isfinite(env.action_space.high).all()
    assert all(np.isfinite(value) for value in info.values())


def test_a_control_period_of_very_many_steps_is_refused() -> None:
    assert physics_steps(0.005, 0.001) == 5
    with pytest.raises(PlantError, match=r"1e\+06 physics steps of 1e-06 s; take 1,000 at most"):
        physics_steps(1.0, 1e-6)
    with pytest.raises(PlantError, match="is not a whole number of physics steps"):
        physics_steps(0.005, 0.002)


@pytest.mark.parametrize("content", [b"", b"\x00\xff\xfe", b'{"supply": 24', b"[" * 100_000])
def test_broken_files_are_refused(content: bytes, tmp_path: Path) -> None:
    file = tmp_path / "plant.json"
    file.write_bytes(content)
    with pytest.raises(PlantError, match=r"plant\.json: (not JSON|is empty)"):
        Plant.read(file)


def test_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(PlantError, match=r"none\.json: cannot be read \(No such file"):
        Plant.read(tmp_path / "none.json")


def test_model_without_the_names_is_refused() -> None:
    with pytest.raises(PlantError, match="no actuator named 'motor'"):
        Plant().to_mjcf("<mujoco/>")
    with pytest.raises(PlantError, match="no joint named 'cart'"):
        Plant().to_mjcf('<mujoco><actuator><dcmotor name="motor"/></actuator></mujoco>')
    with pytest.raises(PlantError, match="is a <motor>, not a <dcmotor>"):
        Plant().to_mjcf('<mujoco><actuator><motor name="motor"/></actuator></mujoco>')


@pytest.mark.parametrize("attribute", ["resistance", "motorconst", "gear"])
@pytest.mark.parametrize("value", ["", "x", "0x10"])
def test_a_motor_without_its_numbers_is_refused_in_words(attribute: str, value: str) -> None:
    numbers = {"resistance": "1.2", "motorconst": "0.06", "gear": "80"} | {attribute: value}
    text = " ".join(f'{name}="{number}"' for name, number in numbers.items())
    with pytest.raises(PlantError, match=rf"<dcmotor name='motor'>: {attribute} is '{value}'; it must be one number"):
        Plant.from_mjcf(f'<mujoco><actuator><dcmotor name="motor" {text}/></actuator></mujoco>')


def changed(**attributes: str) -> str:
    """The rig without its friction, and with other attributes of the cart's joint."""
    text = Plant(friction=Friction(coulomb=0.0, static=0.0)).to_mjcf(RIG)
    for name, value in attributes.items():
        text = text.replace('<joint name="cart"', f'<joint {name}="{value}" name="cart"')
    return text


def sliding(path: Path, **friction: float) -> float:
    """Friction of a cart that 8 V push towards +x, N, with a plant's friction in place of the model's."""
    plant = {"friction": friction} if friction else None
    env = gymnasium.make(ENV_ID, model=path, plant=plant, exact_state=True)
    env.reset(seed=0, options={"state": [-0.3, 0, 0, 0, 0, 0]})
    for _ in range(60):
        info = env.step([8.0])[4]
    return float(info["friction"])


def test_friction_takes_the_place_of_whatever_motor_has_the_models(tmp_path: Path) -> None:
    """A diagnosis calls it by another name; both together would brake twice."""
    path = tmp_path / "improved.xml"
    path.write_text(RIG.replace('dcmotor name="friction"', 'dcmotor name="cart_bristles"'))
    assert Plant.from_mjcf(path.read_text()).friction == Friction()
    assert sliding(path) == pytest.approx(-8.0, abs=0.1)
    assert sliding(path, coulomb=5.0, static=6.0) == pytest.approx(-5.0, abs=0.1)
    assert sliding(path, coulomb=0.0, static=0.0) == pytest.approx(0.0, abs=1e-9)


def test_rigs_of_a_batch_have_the_friction_that_is_drawn_for_them(tmp_path: Path) -> None:
    path = tmp_path / "improved.xml"
    path.write_text(RIG.replace('dcmotor name="friction"', 'dcmotor name="cart_bristles"'))
    drawn = {"friction": {"coulomb": {"uniform": [5.0, 9.0]}, "static": {"uniform": [9.0, 14.0]}}}
    for engine in ("mujoco", "compiled"):
        envs = gymnasium.make_vec(ENV_ID, 3, "vector_entry_point", model=path, plant=drawn, engine=engine)
        envs.reset(seed=0, options={"state": [-0.3, 0, 0, 0, 0, 0]})
        for _ in range(60):
            friction = envs.step(np.full((3, 1), 8.0))[4]["friction"]
        wanted = [-plant.friction.coulomb for plant in envs.unwrapped.plants]
        assert friction == pytest.approx(wanted, abs=0.2)


def test_frictionloss_is_replaced_and_not_added_to(tmp_path: Path) -> None:
    path = tmp_path / "own.xml"
    path.write_text(changed(frictionloss="8"))
    assert Plant.from_mjcf(path.read_text()).friction is None
    assert sliding(path) == pytest.approx(-8.0, abs=0.1)
    assert sliding(path, coulomb=5.0, static=6.0, viscous=20.8) == pytest.approx(-5.0, abs=0.1)
    with pytest.raises(PlantError, match=r"frictionloss.*give friction\.viscous as well"):
        sliding(path, coulomb=5.0, static=6.0)


def test_damping_that_is_not_changed_stays_the_models(tmp_path: Path) -> None:
    path = tmp_path / "own.xml"
    path.write_text(changed().replace('damping="20.8"', 'damping="5"'))
    env: Any = gymnasium.make(ENV_ID, model=path, plant={"friction": {"coulomb": 5.0, "static": 6.0}}).unwrapped
    assert env.model.joint("cart").damping[0] == 5.0


def test_friction_beside_a_law_of_friction_is_refused(tmp_path: Path) -> None:
    path, law = tmp_path / "own.xml", "dipc_gym:friction.wave:cart"
    entry = f'<custom><numeric name="{law}" data="8 2 0 0.1"/></custom>'
    path.write_text(changed().replace("</mujoco>", f"{entry}</mujoco>"))
    gymnasium.make(ENV_ID, model=path)
    with pytest.raises(PlantError, match=f"{law}.*take it out"):
        gymnasium.make(ENV_ID, model=path, plant={"friction": Friction()})


def test_numpys_numbers_are_numbers() -> None:
    plant = Plant.from_dict({"friction": {"coulomb": np.int64(4), "static": np.float32(12.5)}})
    assert plant.to_dict()["friction"]["static"] == 12.5
    json.dumps(plant.to_dict())
    assert (
        PlantFamily.of({"supply": np.float64(20.0), "delay": {"uniform": np.array([0.0, 0.004])}}).longest_delay
        == 0.004
    )
