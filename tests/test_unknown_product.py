"""Forces in proportion to one thing, by a factor that depends on another."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sim2real_rigs import CART, NOISE, RK4, record, sweep

from dipc_gym import mjcf, physics
from dipc_gym.mjcf.edit import Document
from dipc_gym.physics import formulas
from dipc_gym.sim2real import catalogue, diagnosis, fit_effect
from dipc_gym.sim2real.effects.shared.surfaces import Surface
from dipc_gym.sim2real.effects.unknown_force import UnknownForce
from dipc_gym.sim2real.effects.unknown_product import UnknownProduct
from dipc_gym.sim2real.effects.unknown_recent import UnknownRecent
from dipc_gym.sim2real.estimation.fit import fit
from dipc_gym.sim2real.model.parameters import Wishes
from dipc_gym.sim2real.model.structure import Structure, Term
from dipc_gym.sim2real.selection import kinds
from dipc_gym.sim2real.selection.baseline import baseline
from dipc_gym.sim2real.selection.case import part
from dipc_gym.sim2real.selection.stop import Stop
from dipc_gym.sim2real.verdict.withheld import gather

PRODUCT = "residual.force:product"
PLACES = np.linspace(-0.1, 0.5, 61)
# Bell curves: no table of a few knots is one.
DRAG = -8.0 * np.exp(-(((PLACES - 0.2) / 0.04) ** 2))  # N s/m
DRIVE = 0.4 * np.exp(-(((PLACES - 0.1) / 0.05) ** 2)) - 0.3 * np.exp(-(((PLACES - 0.28) / 0.06) ** 2))  # N/V


def hidden(factor: np.ndarray, carrier: str, most: float, pull: float = 0.0) -> physics.Physics:
    """The cart with a force of which a table knows what it is at the largest speed or command, and a slope, m/s^2."""
    levels = np.stack([-factor * most, factor * most], axis=1)
    numbers = [10.0, len(PLACES), 2, *PLACES, -most, most, *levels.ravel()]
    names = [
        f'<text name="dipc_gym:input:{k}:residual.force:cart" data="{of}"/>'
        for k, of in ((1, "position cart"), (2, carrier))
    ]
    entry = f'<numeric name="dipc_gym:residual.force:cart" data="{" ".join(map(str, numbers))}"/>'
    sloping = CART.replace("<option ", f'<option gravity="{pull} 0 -9.81" ')
    return physics.load(sloping.replace("</mujoco>", f"<custom>{entry}{''.join(names)}</custom></mujoco>"))


@pytest.mark.parametrize(
    ("factor", "carrier", "most", "words"),
    [(DRAG, "velocity cart", 5.0, "the velocity of cart"), (DRIVE, "command motor", 40.0, "the command to motor")],
)
def test_what_it_is_in_proportion_to_and_by_how_much_is_found(
    factor: np.ndarray, carrier: str, most: float, words: str
) -> None:
    run = record(hidden(factor, carrier, most), sweep(4.0), 8.0, noise=NOISE["cart"], step=1e-4, integrator=RK4)
    (found, *_) = fit_effect(catalogue()[PRODUCT], mjcf.from_text(CART), [run])
    assert found.error < found.error_without / 8
    assert f"in proportion to {words}" in found.sentence
    low, high = (float(one) for one in re.search(r"by (\S+) to (\S+) N per", found.sentence).groups())
    assert high - low == pytest.approx(np.ptp(factor), rel=0.25)  # damping and gear take up what is everywhere alike


def test_between_its_knots_a_factor_bends() -> None:
    """Ten values hold an exponential to a few thousandths, where straight lines are off by ten times as much."""
    roots = np.linspace(0.0, 8.0, 10)
    law = UnknownRecent(roots.tolist(), (-np.exp(-(roots**2) / 7.8)).tolist(), ("velocity cart",) * 2, 1.0, 9.0)
    document = Document(mjcf.from_text(CART))
    law.edit(document, "cart", law.guess)
    (extra,) = physics.load(document.text()).extras
    sizes = np.linspace(0.0, 64.0, 501)
    data, ones = np.broadcast_to(extra.data, (len(sizes), len(extra.data))), np.ones_like(sizes)
    moment = physics.Moment(ones, ones, ones, ones, ones, ones, (ones,), sizes)
    written = formulas.force_of_recent(data, moment)
    np.testing.assert_allclose(written, -np.exp(-sizes / 7.8), atol=2e-3)
    straight = np.interp(sizes, roots**2, law.first)
    assert np.abs(straight + np.exp(-sizes / 7.8)).max() > 8 * np.abs(written + np.exp(-sizes / 7.8)).max()


def test_beyond_the_data_it_goes_on_in_proportion() -> None:
    """A drag does not let go of a joint that is faster; what drives fades there, and the table says the same."""
    law = UnknownProduct([0.0, 1.0], [-3.0, 2.0], ("position cart", "velocity cart"), 1.0, 5.0, ("m", "m/s"))
    document = Document(mjcf.from_text(CART))
    law.edit(document, "cart", law.guess)
    (extra,) = physics.load(document.text()).extras
    place, speed = np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0]), np.array([0.5, 1.0, 20.0, 0.5, 4.0, 20.0])
    zero = 0 * speed
    data = np.broadcast_to(extra.data, (len(speed), len(extra.data)))
    moment = physics.Moment(zero, place, zero, zero, zero, speed, (place, speed))
    np.testing.assert_allclose(formulas.force_of(data, moment), [-1.5, -3.0, -60.0, 1.0, 8.0, 0.0], atol=1e-9)
    said = law.law_of(law.guess, {"value_1": "N"})
    assert said["supported"] == [[0.0, 1.0], [-1.0, 1.0]]
    across = said["table"]["inputs"][1]["knots"]
    assert [np.interp(v, across, said["table"]["levels"][0]) for v in (0.5, 20.0)] == pytest.approx([-1.5, -60.0])


@given(st.integers(3, 9), st.floats(-1.0, 1.0), st.floats(-1.0, 1.0))
def test_a_value_that_no_motion_tells_goes_on_as_its_neighbours_do(count: int, begin: float, slope: float) -> None:
    """All but the first are known and lie on a line: it is likeliest on that line, whatever it was guessed to be."""
    knots = np.linspace(0.0, 1.0, count)
    guess = [4.0, *(begin + slope * knots[1:])]
    law = UnknownProduct(knots.tolist(), guess, ("position cart", "velocity cart"), 2.0, 1.0)
    source = mjcf.from_text(CART)
    structure = Structure(Document(source), mjcf.compile(source), ("cart",)).with_term(Term(law, "cart", law.guess))
    prior, others = structure.prior, structure.first - structure.prior.centre
    likeliest = prior.centre[0] - prior.precision[0, 1:] @ others[1:] / prior.precision[0, 0]
    off = structure.slots[0].value(likeliest) - begin
    assert abs(off) < 0.1 * (4.0 - begin)


@pytest.mark.parametrize(("pull", "kind"), [(0.0, [PRODUCT]), (0.6, ["load.constant", PRODUCT])])
def test_a_table_over_two_inputs_is_a_product_and_what_acts_beside_it(pull: float, kind: list[str]) -> None:
    """The table holds both at once, in many times as many values; beside a load no product alone comes near."""
    rig = hidden(DRAG, "velocity cart", 5.0, pull)
    run = record(rig, sweep(4.0), 8.0, noise=NOISE["cart"], step=1e-4, integrator=RK4)
    case = part(gather(mjcf.from_text(CART), [run], (), Wishes())[0], threads=1)
    asked = [catalogue()[name] for name in ("residual.force", "load.constant", PRODUCT)]
    search = diagnosis.begin_search(case, baseline(case), asked, Stop(lambda line: None))[0]
    bare, (places, speeds) = search.progress.current, (np.linspace(0.0, 0.4, 17), np.array([-5.0, 5.0]))
    levels = np.interp(places, PLACES, DRAG)[:, None] * speeds + 1.26 * pull
    law = UnknownForce(Surface(("position cart", "velocity cart"), (places, speeds), levels), 9.0, ("m", "m/s"), "cart")
    structure = bare.structure.with_term(Term(law, "cart", law.first))
    modelled = fit(search.partition.problem, structure, None, bare.initial, most=8)
    found = kinds.named(search.question, search.fitter, modelled, bare, print)
    assert sorted(term.effect.id for term in found.structure.terms) == kind
    assert len(found.z) < len(modelled.z)


def test_a_drag_of_one_sign_is_passive_and_a_drive_is_not() -> None:
    known = type(catalogue()[PRODUCT])
    for values, carrier, passive in (
        ([-1.0, -2.0], "velocity cart", True),
        ([-1.0, 2.0], "velocity cart", False),
        ([-1.0, -2.0], "command motor", False),
    ):
        law = known([0.0, 1.0], values, ("position cart", carrier), 2.0, 1.0, ("m", "m/s"))
        assert law.law_of(law.guess, {"value_1": "N"})["passive"] is passive


def test_it_drives_nothing_beyond_the_speeds_in_the_data() -> None:
    """Twice as fast as it was seen, a drive along the motion has faded, and a drag has not."""
    numbers = "1.0 2 2 0 1 -2 2 -3 3 -3 3"
    names = '<text name="dipc_gym:input:1:residual.force:cart" data="position cart"/>'
    names += '<text name="dipc_gym:input:2:residual.force:cart" data="velocity cart"/>'
    entry = f'<custom><numeric name="dipc_gym:residual.force:cart" data="{numbers}"/>{names}</custom>'
    (extra,) = physics.load(CART.replace("</mujoco>", f"{entry}</mujoco>")).extras
    still = np.zeros(3)
    speed = np.array([0.5, 2.0, 5.0])
    data = np.broadcast_to(extra.data, (3, len(extra.data)))
    moment = physics.Moment(still, still, still, still, still, speed, (still, speed))
    assert formulas.force_of(data, moment) == pytest.approx([0.75, 0.0, 0.0])
