"""Formulas in the place of tables: the right one where there is one, none where there is none."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dipc_gym.sim2real.verdict.closed_form import Formula, formulas

PLACE, SPEED = np.linspace(-0.4, 0.5, 33), np.linspace(0.0, 0.9, 25)
LAWS = {
    "Gaussian": (PLACE, lambda x: 2 + 1.8 * np.exp(-0.5 * ((x + 0.13) / 0.04) ** 2)),
    "step": (PLACE, lambda x: 1 + 0.7 * np.tanh((x - 0.1) / 0.05)),
    "sine": (PLACE, lambda x: 0.5 * np.sin(2 * np.pi * x / 0.3 + 0.4)),
    "line": (PLACE, lambda x: 0.2 - 3 * x),
    "power": (SPEED, lambda x: 1 + 4 * x**1.7),
    "exponential": (SPEED, lambda x: 2 + 1.5 * np.exp(-x / 0.08)),
}


def closed_form(x: np.ndarray, values: np.ndarray, precision: np.ndarray, samples: int) -> Formula | None:
    """The formula that says as much as a table, where there is one."""
    return next(reversed(formulas(x, values, precision, samples)), None)


@pytest.mark.parametrize("kind", LAWS)
@pytest.mark.parametrize("noise", [1e-4, 0.02])
def test_the_right_formula_comes_out_of_a_table(kind: str, noise: float) -> None:
    x, law = LAWS[kind]
    values = law(x) + noise * np.random.default_rng(0).standard_normal(len(x))
    found = closed_form(x, values, np.eye(len(x)) / noise**2, 150)
    assert found is not None
    assert [name for name, _, _ in found.terms] == [kind]
    np.testing.assert_allclose(found(x), law(x), atol=4 * noise + 1e-9)


def test_two_terms_are_told_and_put_in_words() -> None:
    values = 2 + 3 * np.exp(-0.5 * ((PLACE - 0.2) / 0.05) ** 2) - 1.5 * PLACE
    found = closed_form(PLACE, values, 1e6 * np.eye(len(PLACE)), 150)
    assert found is not None
    assert sorted(name for name, _, _ in found.terms) == ["Gaussian", "line"]
    assert "a Gaussian of 3 N, 0.05 m wide, at 0.2 m" in found.text("N", "m")
    assert found.to_dict("N", "m")["text"] == found.text("N", "m")


def test_what_is_no_formula_stays_a_table() -> None:
    values = np.random.default_rng(1).normal(0, 1, len(PLACE))
    assert closed_form(PLACE, values, 1e6 * np.eye(len(PLACE)), 150) is None


def test_directions_that_data_say_nothing_of_are_not_asked() -> None:
    """Half the table was never visited: the other half decides."""
    x, law = LAWS["Gaussian"]
    values = np.where(x < 0.05, law(x), 50.0)
    precision = np.diag(np.where(x < 0.05, 1e6, 0.0))
    found = closed_form(x, values, precision, 150)
    assert found is not None
    assert [name for name, _, _ in found.terms] == ["Gaussian"]


@settings(max_examples=30, deadline=None)
@given(size=st.floats(1e-3, 1e3), length=st.floats(1e-3, 1e3))
def test_units_change_nothing(size: float, length: float) -> None:
    x, law = LAWS["Gaussian"]
    noise = 0.01 * np.random.default_rng(2).standard_normal(len(x))
    found = closed_form(length * x, size * (law(x) + noise), np.eye(len(x)) / (0.01 * size) ** 2, 150)
    assert found is not None
    ((kind, (height,), where),) = found.terms
    assert kind == "Gaussian"
    assert height / size == pytest.approx(1.8, rel=0.05)
    assert abs(where["width"]) / length == pytest.approx(0.04, rel=0.1)


@settings(max_examples=30, deadline=None)
@given(fall=st.floats(0.3, 3.0), far=st.floats(0.5, 20.0), kind=st.sampled_from(["exponential", "flank"]))
def test_what_sits_somewhere_is_seen_there(fall: float, far: float, kind: str) -> None:
    """The flank of a Gaussian far away fits many a bend, but nobody would call it one."""
    x = SPEED - 0.3 if kind == "flank" else SPEED
    law = np.exp(-0.5 * ((x + far) / fall) ** 2 + 0.5 * ((x[0] + far) / fall) ** 2) if kind == "flank" else None
    values = 1.0 + (np.exp(-x / fall) if law is None else law)
    for formula in formulas(x, values, 1e6 * np.eye(len(x)), 150):
        for _, _, numbers in formula.terms:
            assert -0.2 * 0.9 + x[0] <= numbers.get("at", x[0]) <= x[-1] + 0.2 * 0.9
            assert numbers.get("width", 0.0) <= 0.9 + 1e-9
            assert numbers.get("scale", 0.0) <= 1.8 + 1e-9
