"""What linear controllers are told of a rig: the same whatever delays its commands or hides its rotor."""

from __future__ import annotations

from importlib import resources

import numpy as np
import pytest

from dipc_gym import mjcf
from dipc_gym.controllers import lqr
from dipc_gym.identification.run import Cart, cart, cart_model
from dipc_gym.mechanics.rigid import Rigid
from dipc_gym.mjcf.edit import Document
from dipc_gym.plant import Plant
from dipc_gym.sim2real.effects import catalogue

RIG = mjcf.from_text((resources.files("dipc_gym") / "rig.xml").read_text())
CASES = {
    "timing.delay": {"delay": 0.004},
    "motor.inductance": {"time_constant": 0.002},
    "transmission.compliance": {"stiffness": 2000.0, "damping": 5.0, "rotor_inertia": 0.3},
    "transmission.backlash": {"gap": 0.001, "rotor_inertia": 0.3, "contact_rate": 400.0, "contact_damping": 0.5},
}


def told(source: mjcf.Source, plant: Plant) -> tuple[Cart, list[np.ndarray]]:
    """Mass, gain and friction of the locked rig, and the linear model of the whole one."""
    model = mjcf.compile(source.edited(plant.to_mjcf(source.text)))
    return cart(cart_model(source, plant)), list(lqr.linear_model(model))


@pytest.mark.parametrize("effect", CASES)
def test_lags_and_play_change_no_linear_model(effect: str) -> None:
    """The rig: 4 N/V (gear 80, 0.06 N m/A, 1.2 ohm), and 20.8 N s/m beside a back-EMF of 80^2 0.06^2 / 1.2."""
    document = Document(RIG)
    catalogue()[effect].edit(document, "motor", CASES[effect])
    changed = RIG.edited(document.text())
    seen, linear = told(changed, Plant.from_mjcf(changed.text))
    assert seen.constants.newtons_per_volt == pytest.approx(4.0)
    assert seen.constants.viscous == pytest.approx(20.8 + 80**2 * 0.06**2 / 1.2)
    plain, expected = told(RIG, Plant())
    assert seen.mass == pytest.approx(plain.mass)
    for one, other in zip(linear, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-6)


def test_a_delay_of_the_plant_leaves_the_gain() -> None:
    assert told(RIG, Plant(delay=0.004))[0] == told(RIG, Plant())[0]


def test_a_rotor_moves_with_its_joint() -> None:
    """1 kg on a spring of 100 N/m; its hidden rotor adds 0.5 kg and nothing else."""
    model = mjcf.compile(
        mjcf.from_text(
            """<mujoco><option gravity="0 0 0"/><worldbody>
            <body><joint name="x" type="slide" axis="1 0 0" stiffness="100"/><geom size="1" mass="1"/></body>
            <body><joint name="r" type="slide" axis="1 0 0"/><geom size="1" mass="0.5" contype="0"/></body>
            </worldbody><custom><text name="dipc_gym:follows:r" data="x"/></custom></mujoco>"""
        )
    )
    rigid = Rigid(model, [0])
    assert rigid.acceleration([0.03], [0.0], [0.0])[0] == pytest.approx(-3.0 / 1.5)
    assert rigid.acceleration([0.0], [0.0], [6.0])[0] == pytest.approx(4.0)
