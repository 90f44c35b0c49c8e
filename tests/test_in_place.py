"""What a found effect writes over is said, and what it adds to is not."""

from __future__ import annotations

import pytest
from sim2real_rigs import CART

from dipc_gym import mjcf
from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real import catalogue
from dipc_gym.sim2real.effects.load_stop import Stop
from dipc_gym.sim2real.model.structure import Structure, Term
from dipc_gym.sim2real.verdict.effect_words import in_words
from dipc_gym.sim2real.verdict.in_place import in_place_of

VALUES = {
    "timing.delay": {"delay": 0.005},
    "motor.cogging": {"sine": 0.01, "cosine": 0.02, "poles": 7.0},
    "motor.saturation:torque": {"limit": 0.1},
    "motor.deadzone": {"width": 0.3},
    "timing.sensor_lag:delay": {"delay": 0.003},
    "timing.sensor_lag": {"time_constant": 0.004},
    "drag.quadratic": {"coefficient": 0.7},
    "friction.coulomb": {"level": 2.0},
    "transmission.compliance": {"stiffness": 9e3, "damping": 1.0, "rotor_inertia": 0.2},
    "load.constant": {"force": 1.0},
}
WHOLE = {"timing.delay", "motor.cogging", "motor.saturation:torque", "timing.sensor_lag:delay", "drag.quadratic"}
LOADER = {"motor.deadzone", "timing.sensor_lag"}


def term(effect: str, size: float = 1.0) -> Term:
    one = catalogue()[effect]
    at = {"joint": "cart", "actuator": "motor", "sensor": "cart", "world": "world"}[one.place]
    return Term(one, at, {name: size * value for name, value in VALUES[effect].items()})


@pytest.mark.parametrize("effect", VALUES)
def test_what_a_model_has_already_is_told_beside_what_takes_its_place(effect: str) -> None:
    document = Document(mjcf.from_text(CART))
    first, other = term(effect), term(effect, 0.5 if effect == "motor.saturation:torque" else 1.5)  # it lies within
    assert in_place_of(document, first, first.guess) == ""
    first.effect.edit(document, first.at, first.guess)
    if effect in WHOLE | LOADER:
        said = in_place_of(document, other, other.guess)
        assert ("<custom>" in said) == (effect in LOADER)
        assert str(next(iter(VALUES[effect].values()))) in said or effect == "motor.cogging"
        assert in_place_of(document, first, first.guess) == ""
    else:
        assert in_place_of(document, other, other.guess) == ""


def test_the_sentence_says_so() -> None:
    document, late = Document(mjcf.from_text(CART)), term("timing.delay")
    late.effect.edit(document, "motor", {"delay": 0.002})
    structure = Structure(document, mjcf.compile(document.text()), ("cart",), (), (late,))
    said = in_words(structure, structure.first, late)
    assert said == 'Commands to motor act 5 ms late. It takes the place of delay="0.002".'


def test_a_stop_says_that_it_makes_the_other_end_as_soft() -> None:
    """A joint has one `solreflimit` for both ends of its range."""
    hard = CART.replace('damping="21.4"', 'damping="21.4" range="-0.45 0.45" solreflimit="0.004 1"')
    for text, said in ((hard, 'solreflimit="0.004 1"'), (CART, "")):
        stop = Stop(("high",))
        values = {"high": 0.3, "contact_rate": 100.0, "contact_damping": 0.5}
        assert in_place_of(Document(mjcf.from_text(text)), Term(stop, "cart", values), values) == said
