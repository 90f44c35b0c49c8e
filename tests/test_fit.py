"""Fits find the parameters that a simulation was made with, and leave noise alone."""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear, minimize_scalar
from sim2real_rigs import CART, HANGING, NOISE, RK4, prepared, record, sweep

from dipc_gym import mjcf, physics
from dipc_gym.mjcf.edit import Document
from dipc_gym.recording import Recording
from dipc_gym.sim2real.effects import catalogue
from dipc_gym.sim2real.effects.friction_position_law import FrictionOfPosition
from dipc_gym.sim2real.estimation import shooting as shooting_module
from dipc_gym.sim2real.estimation.fit import Fit, begun, evaluate, fit, holding, readings, weights
from dipc_gym.sim2real.estimation.newton import _stepped
from dipc_gym.sim2real.estimation.problem import Problem, normalised_residual, predict
from dipc_gym.sim2real.estimation.segments import Prepared
from dipc_gym.sim2real.estimation.settings import ESTIMATION
from dipc_gym.sim2real.estimation.shooting import Shooting, typical
from dipc_gym.sim2real.model.parameters import model_parameters
from dipc_gym.sim2real.model.structure import Structure, Term, carry
from dipc_gym.sim2real.selection.screen import LaidOver, _within, pairs
from dipc_gym.sim2real.simulation.batch import Stepping
from dipc_gym.sim2real.simulation.windows import cut
from dipc_gym.sim2real.verdict import findings
from dipc_gym.sim2real.verdict.intervals import by_blocks, by_regimes

NOISY = 1e-5


@functools.cache
def run(
    damping: float = 21.4, friction: float = 0.0, volts: float = 4.0, seconds: float = 8.0, seed: int = 0
) -> Recording:
    """A cart simulated so finely that its error is no match for the noise."""
    text = CART.replace('damping="21.4"', f'damping="{damping}"')
    rig = physics.load(text)
    if not friction:
        return record(rig, sweep(volts), seconds, noise=NOISY, step=5e-4, integrator=RK4, seed=seed)
    return dry_run(damping, friction, volts, seconds, seed)


def dry_run(damping: float, friction: float, volts: float, seconds: float, seed: int) -> Recording:
    """Coulomb friction by the equation itself, at steps so short that MuJoCo's own friction has no part in it."""
    k, r, m, h = 78.7 * 0.06, 1.2, 1.26, 2e-5
    drag, command, rng = damping + k * k / r, sweep(volts), np.random.default_rng(seed)
    x = v = 0.0
    rows = []
    per = round(0.002 / h)
    for i in range(round(seconds / 0.002)):
        u = command(i * 0.002)
        rows.append((i * 0.002, u, x + rng.normal() * NOISY))
        for _ in range(per):
            pull = k / r * u - drag * v
            if v == 0 and abs(pull) <= friction:
                continue
            way = np.sign(v) if v else np.sign(pull)
            then = v + h * (pull - friction * way) / m
            v = 0.0 if v * then < 0 else then
            x += h * v
    table = np.array(rows)
    return Recording("dry", table[:, 0], table[:, 1:2], table[:, 2:], ["motor"], ["cart"])


@functools.cache
def gap_run(gap: float, rotor: float, seconds: float = 5.0) -> Recording:
    """Play between a rotor and a cart that weigh together what the model says, by the equations themselves."""
    k, r, drag, h = 78.74 * 0.06, 1.2, 21.4, 2e-5
    load, stiffness, damping = 1.26 - rotor, 1e5, 60.0
    command, rng = sweep(4.0), np.random.default_rng(3)
    x = v = y = w = 0.0  # cart, rotor
    rows = []
    for i in range(round(seconds / 0.002)):
        u = command(i * 0.002)
        rows.append((i * 0.002, u, x + rng.normal() * NOISY))
        for _ in range(round(0.002 / h)):
            apart = y - x
            deep = apart - gap / 2 if apart > gap / 2 else apart + gap / 2 if apart < -gap / 2 else 0.0
            push = stiffness * deep + damping * (w - v) if deep else 0.0
            push = push if push * deep > 0 else 0.0  # what has let go does not pull
            v += h * (push - drag * v) / load
            w += h * (k / r * (u - k * w) - push) / rotor
            x, y = x + h * v, y + h * w
    table = np.array(rows)
    return Recording("play", table[:, 0], table[:, 1:2], table[:, 2:], ["motor"], ["cart"])


def ready(recording: Recording, text: str = CART, **more: object) -> Prepared:
    return prepared(text, [recording], stepping=Stepping(0.002, RK4), **more)  # type: ignore[arg-type]


def free(P: Prepared, *keys: str) -> Structure:
    parameters = model_parameters(P.structure.document, P.structure.model)
    return replace(P.structure, model_parameters=tuple(n for n in parameters if n.key in keys))


def intervals(fitted: Fit) -> np.ndarray:
    """Standard deviation of each mapped parameter, were the model exact: from the sum of the windows' quadratics."""
    return np.sqrt(np.diag(np.linalg.inv(fitted.quadratics.A.sum(axis=0))))


# Parameters come back


def test_a_known_damping_and_mass_come_back() -> None:
    P = ready(run(), CART.replace('damping="21.4"', 'damping="30"').replace('mass="1.26"', 'mass="1.1"'))
    structure = free(P, "cart.damping", "cart.mass")
    fitted = fit(P.problem, structure)
    values = structure.values(fitted.z)
    truth = {"cart.damping": 21.4, "cart.mass": 1.26}
    assert fitted.converged
    assert fitted.error == pytest.approx(1.0, abs=0.05)
    for slot, z, spread in zip(structure.slots, fitted.z, intervals(fitted), strict=True):
        assert abs(z - slot.mapped(truth[slot.key])) < 4 * spread
        assert values[slot.key] == pytest.approx(truth[slot.key], rel=2e-3)


@pytest.mark.parametrize("friction", [1.0, 4.0])
def test_a_known_friction_comes_back(friction: float) -> None:
    P = ready(run(friction=friction, seconds=5.0))
    term = Term(catalogue()["friction.coulomb"], "cart", {"level": 2.0})
    structure = free(P, "cart.damping").with_term(term)
    fitted = fit(P.problem, structure)
    values = structure.values(fitted.z)
    assert values["friction.coulomb@cart.level"] == pytest.approx(friction, rel=5e-3)
    assert values["cart.damping"] == pytest.approx(21.4, rel=5e-3)
    assert fitted.error < 1.1


@pytest.mark.parametrize("rotor", [0.12, 0.3])
def test_a_known_gap_and_rotor_come_back(rotor: float) -> None:
    """From guesses that are far off, though no straight line foretells how a window has to start behind a gap."""
    P = ready(gap_run(3.5e-3, 0.22))
    guess = {"gap": 3e-3, "rotor_inertia": rotor, "contact_rate": 1e3, "contact_damping": 0.3}
    fitted = fit(P.problem, P.structure.with_term(Term(catalogue()["transmission.backlash"], "motor", guess)), most=20)
    values = {key.rpartition(".")[2]: value for key, value in fitted.structure.values(fitted.z).items()}
    assert values["gap"] == pytest.approx(3.5e-3, rel=0.02)
    assert values["rotor_inertia"] == pytest.approx(0.22, rel=0.05)


def test_intervals_cover_as_often_as_they_say() -> None:
    """Standard deviations from the quadratics, over ten recordings of nothing but noise on the right model."""
    off = []
    for seed in range(10):
        P = ready(run(seconds=2.0, seed=seed))
        structure = free(P, "cart.damping")
        fitted = fit(P.problem, structure)
        off.append(fitted.z[0] / intervals(fitted)[0])
    assert 0.4 < np.sqrt(np.mean(np.square(off))) < 1.8


@pytest.mark.parametrize("left", [1.0, 3.0])
def test_a_covariance_is_how_far_fits_to_other_noise_lie_apart(left: float) -> None:
    """Whether noise is what it was taken for or three times that: what is left tells."""
    P = ready(run(seconds=4.0))
    structure = free(P, "cart.damping", "cart.mass")
    true, rng, found, told = fit(P.problem, structure), np.random.default_rng(5), [], []
    clean = readings(P.problem, structure, true.z)
    for _ in range(100):
        noisy = clean + left * P.problem.windows.noise * rng.normal(size=clean.shape)
        one = fit(replace(P.problem, windows=replace(P.problem.windows, observed=noisy)), structure, true.z)
        found.append(one.z)
        told.append(np.diag(one.covariance()))
    apart = np.std(found, axis=0) / np.sqrt(np.mean(told, axis=0))
    assert np.all((apart > 0.8) & (apart < 1.25))  # chance allows a tenth; a factor of two in it would be 0.7 or 1.4


def test_a_prior_holds_what_the_data_does_not_say() -> None:
    """Mass, damping and motor constant scale together; what the owner knows of one of them sets the others."""
    P = ready(run())
    keys = ("cart.damping", "cart.mass", "motor.resistance", "motor.motorconst")
    parameters = {n.key: n for n in model_parameters(P.structure.document, P.structure.model)}
    known = replace(parameters["cart.mass"], expected=1.26 * 1.1, sigma=1e-3)
    structure = replace(P.structure, model_parameters=(known, *(parameters[key] for key in keys if key != "cart.mass")))
    fitted = fit(P.problem, structure)
    values = structure.values(fitted.z)
    assert values["cart.mass"] == pytest.approx(1.26 * 1.1, rel=5e-3)
    constant, resistance = values["motor.motorconst"], values["motor.resistance"]
    assert constant / resistance == pytest.approx(1.1 * 0.06 / 1.2, rel=2e-2)
    assert fitted.error == pytest.approx(1.0, abs=0.05)


def test_what_is_held_moves_the_others_as_their_priors_have_it() -> None:
    """Four parameters, of which the recording tells two ratios, to first order: a mass that is held leaves one open."""
    P, mass = ready(run()), math.log(1.1)
    parameters = {n.key: n for n in model_parameters(P.structure.document, P.structure.model)}
    wanted = [parameters[key] for key in ("cart.mass", "cart.damping", "motor.resistance", "motor.motorconst")]
    structure = replace(P.structure, model_parameters=tuple(wanted))
    drag, back_emf = 21.4, (78.7 * 0.06) ** 2 / 1.2

    def others(resistance: float) -> np.ndarray:
        """Logarithms that leave constant / resistance / mass as it is, and (drag + constant^2 / resistance) / mass."""
        constant = resistance + mass
        damping = mass + back_emf / drag * (mass - 2 * constant + resistance)
        return np.array([damping, resistance, constant])

    spread = np.array([parameter.sigma for parameter in wanted[1:]])
    likeliest = minimize_scalar(lambda resistance: np.sum((others(resistance) / spread) ** 2)).x
    found = holding(fit(P.problem, structure), P.problem, {0: mass})
    assert found == pytest.approx([mass, *others(likeliest)], abs=3e-3)


# Noise stays noise


def test_the_right_model_leaves_the_noise() -> None:
    """Prediction error of the nominal model, initial states corrected: one, within three per cent."""
    errors = []
    for seed in range(4):
        P = ready(run(seconds=8.0, seed=seed))
        fitted = fit(P.problem, P.structure)
        # What the start of each window takes away of its samples is no prediction.
        samples = P.problem.counts
        errors.append(np.sqrt(np.mean(fitted.mse * samples / (samples - P.problem.initial.shape[1]))))
    assert np.median(errors) == pytest.approx(1.0, abs=0.03)


def test_what_is_not_there_is_fitted_to_nothing() -> None:
    P = ready(run(seconds=4.0))
    for effect, at, guess in (
        ("friction.coulomb", "cart", {"level": 1.0}),
        ("load.constant", "cart", {"force": 1.0}),
        ("timing.delay", "motor", {"delay": 0.002}),
    ):
        structure = free(P, "cart.damping").with_term(Term(catalogue()[effect], at, guess))
        fitted = fit(P.problem, structure)
        (value,) = (v for k, v in structure.values(fitted.z).items() if "@" in k)
        assert abs(value) < 0.02 * next(iter(guess.values())), effect


# Initial states


def test_starts_are_eliminated() -> None:
    """However wrong the initial states, within their spread, the error that no initial state explains is the same."""
    P = ready(run(seconds=4.0))
    rng = np.random.default_rng(0)
    off = P.problem.initial + rng.normal(size=P.problem.initial.shape) * P.problem.spread * 0.5
    exact, moved = (fit(replace(P.problem, initial=s), P.structure) for s in (P.problem.initial, off))
    assert exact.error == pytest.approx(moved.error, rel=0.02)
    assert np.all(np.abs(exact.initial - moved.initial)[:, 0] < 5 * NOISY)
    before = normalised_residual(P.problem, predict(P.problem, P.structure, [P.structure.first], off[None])[0])
    assert np.sqrt(np.mean(before**2)) > 3 * moved.error


def test_what_is_left_cannot_be_explained_by_a_start() -> None:
    P = ready(run(seconds=4.0))
    fitted = fit(P.problem, free(P, "cart.damping"))
    assert np.einsum("nmk,nm->nk", fitted.sensitivity, fitted.left) == pytest.approx(0.0, abs=1e-6 * fitted.left.size)


def test_corrected_starts_are_a_simulation() -> None:
    """Predictions that are drawn come from real initial states, and are as good as the fit says."""
    P = ready(run(friction=2.0, seconds=4.0))
    structure = P.structure.with_term(Term(catalogue()["friction.coulomb"], "cart", {"level": 2.0}))
    fitted = fit(P.problem, structure)
    left = normalised_residual(P.problem, readings(P.problem, structure, fitted.z))
    assert np.sqrt(np.mean(left**2)) == pytest.approx(fitted.error, rel=0.03)


def test_comparison_windows_are_judged_without_being_fitted() -> None:
    P = ready(run(friction=2.0), span=(0.0, 1.0))
    train, comparison = P.problem.pick(np.arange(0, 32, 2)), P.problem.pick(np.arange(1, 32, 2))
    structure = P.structure.with_term(Term(catalogue()["friction.coulomb"], "cart", {"level": 1.0}))
    fitted = fit(train, structure)
    mse = evaluate(comparison, structure, fitted.z)
    nominal = evaluate(comparison, P.structure, P.structure.first)
    assert np.sqrt(mse.mean()) == pytest.approx(1.0, abs=0.1)
    assert np.sqrt(nominal.mean()) > 20


def test_what_numbers_say_of_windows_does_not_depend_on_those_beside_them() -> None:
    """A fit learns of more windows by being joined with what its parameters say of those."""
    P = ready(run(friction=2.0), span=(0.0, 1.0))
    structure = P.structure.with_term(Term(catalogue()["friction.coulomb"], "cart", {"level": 1.5}))
    z = structure.first
    together = fit(P.problem.pick(np.arange(9)), structure, z, most=0)
    parts = [fit(P.problem.pick(np.arange(*span)), structure, z, most=0) for span in ((0, 5), (5, 9))]
    joined = parts[0].join(parts[1])
    np.testing.assert_allclose(joined.mse, together.mse)
    np.testing.assert_allclose(joined.jacobian, together.jacobian, atol=1e-9)
    np.testing.assert_allclose(joined.quadratics.A, together.quadratics.A, rtol=1e-9)
    np.testing.assert_array_equal(joined.pick(np.arange(5)).initial, parts[0].initial)


def test_a_rig_that_rests_needs_no_start_corrected() -> None:
    """Held-out stretches may hold nothing but zeros, of which every initial state that is tried is the same."""
    problem, structure = ready(run()).problem, ready(run()).structure
    still = tuple(
        replace(r, commands=np.zeros_like(r.commands), sensors=np.zeros_like(r.sensors))
        for r in problem.windows.recordings
    )
    windows = replace(problem.windows, recordings=still, observed=np.zeros_like(problem.windows.observed))
    resting = replace(problem, windows=windows, initial=np.zeros_like(problem.initial))
    initial, _ = begun(resting, structure, structure.first)
    assert not evaluate(resting, structure, structure.first).any()
    assert not initial.any()


@given(st.integers(0, 10_000), st.integers(1, 6), st.integers(0, 3))
def test_what_screening_foretells_stays_within_bounds(seed: int, p: int, count: int) -> None:
    """With one bound it is where the sum of squares is lowest within it; with many, nothing leaves any."""
    rng = np.random.default_rng(seed)
    rows, wanted = rng.normal(size=(p + 3, p)), 3 * rng.normal(size=p + 3)
    A, b = rows.T @ rows, rows.T @ wanted
    one = np.full(p, np.inf)
    one[rng.integers(p)] = rng.uniform(0, 1)
    best = lsq_linear(rows, wanted, (np.full(p, -np.inf), one), tol=1e-14)
    np.testing.assert_allclose(_within(A, b, np.full(p, -np.inf), one, min(count, p)), best.x, rtol=1e-4, atol=1e-6)
    low, high = -rng.uniform(0, 1, p), rng.uniform(0, 1, p)
    assert not len(_within(A[:0, :0], b[:0], low[:0], high[:0], 0))
    step = _within(A, b, low, high, min(count, p))
    assert np.all((step >= low - 1e-12) & (step <= high + 1e-12))


def test_what_may_move_no_further_lets_the_others_make_up_for_it() -> None:
    """An effect of size 2 beside a friction that would move by 3: moved by 1, it leaves the effect less to do.

    Cut back after all was solved, both together would be worse than nothing.
    """
    A, b = np.array([[1.0, -0.9], [-0.9, 1.0]]), np.array([2 - 0.9 * 3, 3 - 0.9 * 2])

    def lowered(step: np.ndarray) -> float:
        return float(2 * b @ step - step @ A @ step)

    step = _within(A, b, np.array([0.0, -1.0]), np.array([100.0, 1.0]), 1)
    np.testing.assert_allclose(step, [0.2, 1.0])
    assert lowered(step) > 0 > lowered(np.array([2.0, 1.0]))


def test_three_joints_fit_together() -> None:
    rig = physics.load(HANGING.replace('damping="0.001"', 'damping="0.003"'))
    recording = record(rig, sweep(3.0), 4.0, noise=NOISE["hanging"], step=5e-4, integrator=RK4, start=(0.0, 0.4, -0.3))
    P = ready(recording, HANGING)
    structure = free(P, "pole1.damping", "pole2.damping", "cart.damping")
    values = structure.values(fit(P.problem, structure).z)
    assert values["pole1.damping"] == pytest.approx(0.003, rel=0.1)
    assert values["pole2.damping"] == pytest.approx(0.0005, rel=0.3)
    assert values["cart.damping"] == pytest.approx(21.4, rel=0.01)


# Robustness


def test_a_few_broken_windows_do_not_decide() -> None:
    """A push in three of thirty-two windows: their errors are large, the fit hardly moves."""
    recording = run(friction=2.0)
    sensors = recording.sensors.copy()
    for second in (1.1, 3.3, 6.2):
        inside = (recording.time > second) & (recording.time < second + 0.1)
        sensors[inside] += 1e-3 * np.sin(np.pi * (recording.time[inside, None] - second) / 0.1) ** 2
    P = ready(replace(recording, sensors=sensors, sha256=""))
    structure = P.structure.with_term(Term(catalogue()["friction.coulomb"], "cart", {"level": 1.0}))
    fitted = fit(P.problem, structure)
    assert structure.values(fitted.z)["friction.coulomb@cart.level"] == pytest.approx(2.0, rel=0.03)
    assert np.sqrt(np.median(fitted.mse)) < 1.3
    assert np.sqrt(fitted.mse.max()) > 5


def test_weights_fall_with_the_error() -> None:
    w = weights(np.array([0.5, 1.0, 1.5, 1.7, 1.8, 2.0, 1e6]))
    assert np.all(np.diff(w) < 0)
    assert w[-1] < 1e-5 * w[0]


def test_a_fifth_of_the_windows_does_not_set_the_scale() -> None:
    quiet = np.full(81, 2.0)
    assert typical(np.append(quiet, np.full(19, 1e6))) == pytest.approx(2.0, rel=1e-3)
    assert typical(np.full(10, 0.1)) == 1.0  # nothing is known better than the noise


def test_a_fit_carries_over_to_a_larger_structure() -> None:
    P = ready(run(friction=2.0, seconds=4.0))
    small = free(P, "cart.damping")
    z = fit(P.problem, small).z
    term = Term(catalogue()["friction.coulomb"], "cart", {"level": 1.5})
    large = small.with_term(term)
    started = large.values(carry(small, z, large))
    assert started["cart.damping"] == pytest.approx(small.values(z)["cart.damping"])
    assert started["friction.coulomb@cart.level"] == 1.5
    # What contains another effect takes its place.
    wider = large.with_term(
        Term(catalogue()["friction.stribeck"], "cart", {"level": 1.0, "static": 2.0, "velocity": 0.05})
    )
    assert [t.effect.id for t in wider.terms] == ["friction.stribeck"]


def test_what_elaborates_what() -> None:
    """Effects in the place of plainer ones that they contain, one for one."""
    base = ready(run(seconds=3.0)).structure

    def of(*effects: str) -> Structure:
        terms = tuple(
            Term(effect, "cart", dict.fromkeys((p.name for p in effect.parameters), 1.0))
            for effect in (catalogue()[name] for name in effects)
        )
        return replace(base, terms=terms)

    assert of("friction.stribeck").elaborates(of("friction.coulomb"))
    assert of("friction.stribeck", "load.spring").elaborates(of("load.spring", "friction.coulomb"))
    assert of("friction.coulomb").elaborates(of("friction.coulomb"))
    assert not of("friction.coulomb").elaborates(of("friction.stribeck"))
    assert not of("friction.stribeck", "load.spring").elaborates(of("friction.coulomb"))
    assert not of("friction.viscous").elaborates(of("friction.coulomb"))


def test_bounds_hold() -> None:
    P = ready(run(seconds=3.0))
    structure = P.structure.with_term(Term(catalogue()["friction.coulomb"], "cart", {"level": 1.0}))
    assert structure.values(structure.clip(np.array([-5.0])))["friction.coulomb@cart.level"] == 0.0
    fitted = fit(P.problem, structure, np.array([0.5]))
    assert structure.values(fitted.z)["friction.coulomb@cart.level"] >= 0.0


def test_a_structure_is_what_is_written() -> None:
    """The text of a fitted structure holds its parameters to the last digit."""
    P = ready(run(seconds=3.0))
    structure = free(P, "cart.damping", "motor.resistance")
    z = np.array([0.1234567, -0.0765432])
    model = mjcf.compile(structure.write(z).text())
    values = structure.values(z)
    assert model.dof_damping[0] == values["cart.damping"]
    assert model.actuator_gainprm[0, 0] == values["motor.resistance"]
    assert isinstance(mujoco.MjModel.from_xml_string(Document(mjcf.from_text(CART)).text()), mujoco.MjModel)


def test_a_good_guess_has_the_predicted_gain_that_it_brings() -> None:
    """On a double pendulum, whose model parameters have a null space that a joint step could run along."""
    wave = {"sine": 0.2, "cosine": 0.2, "wavelength": 0.13}
    document = Document(mjcf.from_text(HANGING))
    catalogue()["load.position"].edit(document, "cart", wave)
    run = record(
        physics.load(document.text()), sweep(3.0), 12.0, noise=NOISE["hanging"], integrator=RK4, start=(0, 1.5, -1.0)
    )
    S = ready(run, HANGING)
    parameters = tuple(model_parameters(S.structure.document, S.structure.model))
    alone = fit(S.problem, replace(S.structure, model_parameters=parameters), most=8)
    (tried,) = LaidOver(S.problem, alone, np.arange(9)).tried([Term(catalogue()["load.position"], "cart", wave)])
    whole = alone.structure.with_term(tried.term)
    after = fit(S.problem, whole, carry(alone.structure, alone.z, whole), alone.initial)
    brought = float(np.mean(np.log1p(alone.mse) - np.log1p(after.mse)))
    assert after.error < 1.1
    assert tried.predicted_gain > 0.5 * brought > 0.5


def test_what_model_parameters_do_for_a_subset_is_no_gain_of_an_effect() -> None:
    """A winding is screened in fine steps, so on eight windows alone, whose waves the rig's parameters can mimic."""
    document = Document(mjcf.from_text(HANGING))
    catalogue()["load.position"].edit(document, "cart", {"sine": 0.1, "cosine": 0.0, "wavelength": 0.13})
    run = record(physics.load(document.text()), sweep(3.0), 8.0, noise=NOISE["hanging"], integrator=RK4)
    S = ready(run, HANGING)
    parameters = tuple(model_parameters(S.structure.document, S.structure.model))
    fitted = fit(S.problem, replace(S.structure, model_parameters=parameters), most=8)
    winding = [Term(catalogue()["motor.inductance"], "motor", {"time_constant": 3e-4})]
    every = np.arange(len(S.problem.windows))
    (eight,), (all_,) = (LaidOver(S.problem, fitted, some).tried(winding) for some in (every[::4], every))
    assert eight.predicted_gain == pytest.approx(all_.predicted_gain, abs=0.15)


@given(z=st.lists(st.floats(-5, 5), min_size=5, max_size=5))
def test_static_friction_is_never_below_the_kinetic_level(z: list[float]) -> None:
    guess = {"level": 2.0, "static": 3.0, "velocity": 0.01, "stiffness": 1e4, "damping": 30.0}
    structure = Structure(Document(mjcf.from_text(CART)), mjcf.compile(mjcf.from_text(CART)), ("cart",)).with_term(
        Term(catalogue()["friction.stribeck:presliding"], "cart", guess)
    )
    values = structure.term_values(structure.clip(np.array(z)), structure.terms[0])
    assert values["static"] >= values["level"] * (1 - 1e-12) >= 0.0


def test_effects_that_need_each_other_are_seen_together() -> None:
    """A damping that was refitted without friction does the work of drag; neither effect alone undoes it."""
    document = Document(mjcf.from_text(CART))
    catalogue()["drag.quadratic"].edit(document, "cart", {"coefficient": 12.0})
    catalogue()["friction.coulomb"].edit(document, "cart", {"level": 0.9})
    S = ready(record(physics.load(document.text()), sweep(6.0), 12.0, noise=NOISE["cart"], integrator=RK4), CART)
    parameters = tuple(n for n in model_parameters(S.structure.document, S.structure.model) if n.key == "cart.damping")
    refitted = fit(S.problem, replace(S.structure, model_parameters=parameters), most=20)
    guesses = {
        "drag.quadratic": {"coefficient": 5.0},
        "friction.coulomb": {"level": 2.0},
        "load.spring": {"stiffness": 20.0, "rest": 0.0},
    }
    subset = np.arange(len(S.problem.windows))[::2]
    terms = [Term(catalogue()[k], "cart", v) for k, v in guesses.items()]
    tried = LaidOver(S.problem, refitted, subset).tried(terms)
    predicted_gain, structure = pairs(S.problem, refitted, tried, subset)[0]
    assert {term.effect.id for term in structure.terms} == {"drag.quadratic", "friction.coulomb"}
    assert predicted_gain > 1.0 + max(one.predicted_gain for one in tried)
    both = fit(S.problem, structure, carry(refitted.structure, refitted.z, structure), refitted.initial)
    assert both.error < 0.1 * refitted.error


def test_one_effect_from_two_guesses_makes_no_pair() -> None:
    S = ready(run(seconds=3.0))
    alone = fit(S.problem, S.structure)
    sag, subset = catalogue()["motor.sag"], np.arange(4)
    terms = [
        Term(sag, "motor", {"drop": drop, "time_constant": time, "current": 1.0, "gain": 1.0, "back": 0.0})
        for drop, time in ((0.02, 0.1), (0.05, 2.0))
    ]
    tried = LaidOver(S.problem, alone, subset).tried(terms)
    assert len(tried) == 2
    assert tried[0].key == tried[1].key
    assert pairs(S.problem, alone, tried, subset) == []


def test_one_hypothesis_makes_no_pair() -> None:
    S = ready(run(seconds=3.0))
    alone = fit(S.problem, S.structure)
    subset = np.arange(4)
    tried = LaidOver(S.problem, alone, subset).tried([Term(catalogue()["friction.coulomb"], "cart", {"level": 2.0})])
    assert len(tried) == 1
    assert pairs(S.problem, alone, tried, subset) == []
    assert pairs(S.problem, alone, [], subset) == []


def test_what_the_length_of_a_step_does_to_a_number() -> None:
    """Told from one simulation with halved steps, as twice what a refit with these moves it by."""
    P = prepared(CART, [run()], stepping=Stepping(0.002, mujoco.mjtIntegrator.mjINT_EULER))
    coarse = fit(P.problem, free(P, "cart.damping", "cart.mass"))
    halved = fit(P.problem.halved_by(1), coarse.structure, coarse.z, coarse.initial)
    assert findings.step_shift(coarse, P.problem) == pytest.approx(2 * np.abs(halved.z - coarse.z), rel=0.1)
    exact = ready(run())
    assert findings.step_shift(fit(exact.problem, coarse.structure), exact.problem).max() < 1e-6


def test_another_choice_of_parameters_tells_nothing_of_a_law_that_was_reshaped() -> None:
    """Its third value is of another place then."""
    P = ready(run())
    law = FrictionOfPosition([-0.2, 0.0, 0.2], [1.0, 2.0, 3.0])
    one, other = (
        free(P, key).with_term(Term(law, "cart", law.guess)).with_term(Term(catalogue()["drag.quadratic"], "cart", at))
        for key, at in (("cart.damping", {"coefficient": 1.0}), ("cart.mass", {"coefficient": 2.0}))
    )
    fitted, instead = fit(P.problem, one, most=0), fit(P.problem, other, most=0)
    instead = replace(instead, z=instead.z + 0.5)
    same = findings.choice_shift(fitted, [instead])
    np.testing.assert_allclose(same[1:4], 0.5)
    again = FrictionOfPosition([-0.2, 0.0, 0.3], [1.0, 2.0, 3.0])
    reshaped = replace(other, terms=(Term(again, "cart", again.guess), other.terms[1]))
    moved = findings.choice_shift(fitted, [replace(instead, structure=reshaped)])
    np.testing.assert_allclose(moved[1:4], 0.0)
    np.testing.assert_allclose(moved[[0, 4]], same[[0, 4]])


@given(st.lists(st.integers(0, 2**31), min_size=2, max_size=2), st.floats(0.0, 0.6))
@settings(max_examples=20, deadline=None)
def test_windows_of_irregular_samples_are_joined(seeds: list[int], uneven: float) -> None:
    """The most samples in a window differ then, and what stands in for those that do not exist says nothing."""
    plain = run(seconds=3.0)
    parts = []
    for seed in seeds:
        rng = np.random.default_rng(seed)
        time = np.cumsum(0.002 * (1 + uneven * rng.uniform(-1.0, 1.0, len(plain))))
        parts.append(cut([replace(plain, time=time)], np.ones(1), 0.25, (0.0, 1.0)))
    both = parts[0].join(parts[1])
    assert len(both) == len(parts[0]) + len(parts[1])
    for which, alone in ((slice(0, len(parts[0])), parts[0]), (slice(len(parts[0]), None), parts[1])):
        there, wanted = both.valid[which], alone.valid
        np.testing.assert_array_equal(both.times[which][there], alone.times[wanted])
        np.testing.assert_array_equal(both.observed[which][there], alone.observed[wanted])
        assert (np.diff(both.times[which], axis=1) >= 0).all()
        assert not both.observed[which][~there].any()


def test_what_no_reading_depends_on_has_no_interval() -> None:
    """Nothing weighs on a cart that goes level."""
    P = ready(run(friction=2.0, seconds=4.0))
    term = Term(catalogue()["friction.load"], "cart", {"level": 2.0, "by_drive": 0.02, "by_weight": 0.05})
    fitted = fit(P.problem, P.structure.with_term(term))
    assert np.isfinite(by_blocks(fitted, P.problem)).tolist() == [True, True, False]


def test_friction_under_load_knows_the_drive_of_its_own_step() -> None:
    """Late by a step of 2 ms, the error is 0.8 % of what the friction does; late by half of one, 0.26 %."""
    P = ready(run(seconds=3.0))
    base = P.structure
    loaded = base.with_term(
        Term(catalogue()["friction.load"], "cart", {"level": 0.5, "by_drive": 0.1, "by_weight": 0.0})
    )
    at = P.problem.initial[None]
    coarse = predict(P.problem, loaded, [loaded.first], at)
    fine = predict(P.problem.halved_by(5), loaded, [loaded.first], at)
    without = predict(P.problem, base, [base.first], at)
    assert np.abs(coarse - fine).max() < 2e-4 * np.abs(without - fine).max()


def test_a_number_at_its_bound_does_not_hold_the_others_back() -> None:
    """The others go to the least that is left for them, not to where they would make up for it."""
    P = ready(run(seconds=3.0))
    structure = free(P, "cart.damping").with_term(Term(catalogue()["friction.coulomb"], "cart", {"level": 1.0}))
    z = structure.clip(np.array([0.0, -5.0]))
    curvature, slope = np.array([[2.0, 1.8], [1.8, 2.0]]), np.array([0.2, -4.0])
    reached = _stepped(structure, z, curvature, slope, np.ones(2))
    assert reached == pytest.approx([0.1, z[1]])


def test_a_fit_that_cannot_come_near_is_left_early() -> None:
    """Damping in the place of 4 N of dry friction leaves far more than the noise, and what is left says so."""
    P = ready(run(friction=4.0, seconds=3.0), CART.replace('damping="21.4"', 'damping="60"'))
    wrong = free(P, "cart.damping")
    right = wrong.with_term(Term(catalogue()["friction.coulomb"], "cart", {"level": 1.0}))
    whole, left = fit(P.problem, wrong), fit(P.problem, wrong, hopeless=2.0)
    assert left.steps == 2 < whole.steps
    assert min(left.error, whole.error) > np.exp(1.0)
    kept = fit(P.problem, right, hopeless=2.0)
    assert kept.error == fit(P.problem, right).error < 1.1


def test_what_differs_between_regimes_widens_the_intervals_beside_it() -> None:
    """Square drag that a model leaves out: damping is another one at every speed, and each second has all speeds."""
    rig = physics.load(CART.replace('damping="21.4"', 'damping="21.4 40"'))

    def swelling(t: float) -> float:
        return 8.0 * abs(math.sin(math.pi * t)) * math.sin(2 * math.pi * 3.1 * t)

    P = ready(record(rig, swelling, 12.0, noise=NOISY, step=5e-4, integrator=RK4))
    fitted = fit(P.problem, free(P, "cart.damping"))
    regimes, seconds = by_regimes(fitted, P.problem), by_blocks(fitted, P.problem)
    assert regimes[0] > seconds[0] > 0


def test_one_second_of_data_gives_no_interval() -> None:
    S = ready(run(seconds=3.0))
    first = S.problem.pick(S.problem.windows.start < 1.0)
    fitted = fit(first, free(S, "cart.damping"))
    assert np.isinf(by_blocks(fitted, first)).all()


def test_a_model_that_is_to_be_simulated_as_it_is_keeps_its_step() -> None:
    """A step that is too long for what was added has to show."""
    S = ready(run(seconds=3.0))
    term = Term(catalogue()["motor.inductance"], "motor", {"time_constant": 3e-3})
    coarse = replace(S.problem, stepping=Stepping(0.002, None))
    physics_of = S.structure.with_term(term)
    own = predict(coarse, physics_of, [physics_of.first], coarse.initial[None])
    finer = predict(coarse.halved_by(2), physics_of, [physics_of.first], coarse.initial[None])
    exact = predict(S.problem.halved_by(2), physics_of, [physics_of.first], coarse.initial[None])
    assert np.abs(own - exact).max() > 2 * np.abs(finer - exact).max() > 0


@functools.cache
def shot() -> Shooting:
    S = ready(run())
    return Shooting(S.problem, S.structure)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), friction=st.sampled_from([0.0, 3.0]), far=st.sampled_from([0.1, 3.0, 100.0]))
def test_the_best_of_several_starts_is_the_one_that_leaves_least(seed: int, friction: float, far: float) -> None:
    """Unless the first does as foretold and leaves noise, in a problem where most windows are at the noise."""
    S, rng = ready(run(friction=friction)), np.random.default_rng(seed)
    shooting, z = Shooting(S.problem, S.structure), S.structure.first
    begin, (n, two) = S.problem.initial, S.problem.initial.shape
    tries = [begin + far * shooting.nudge * rng.normal(size=(n, two)) * (rng.random((n, 1)) < 0.5) for _ in range(4)]
    foretold = rng.choice([0.5, 1.0, 4.0]) * np.ones(n)
    residuals = shooting.residuals([z] * 4, np.stack(tries))
    least, _ = shooting.least(np.stack(tries), residuals)
    best, residual = shooting.best_initial(z, foretold, tries)
    np.testing.assert_allclose(residual, shooting.residuals([z], best[None])[0], rtol=1e-9, atol=1e-9)
    first = shooting.mse(shooting.rows(tries[0], residuals[0]))
    does = (first <= ESTIMATION.near) & (np.log1p(first) - np.log1p(foretold) <= ESTIMATION.lag)
    does &= foretold[0] <= ESTIMATION.near
    np.testing.assert_array_equal(best, np.where(does[:, None], tries[0], least))
    # And what is known without a simulation is taken where it is better.
    known, _ = shooting.best_initial(z, foretold, tries, known=(least, np.zeros_like(residuals[0])))
    np.testing.assert_array_equal(known, least)


def test_other_starts_are_simulated_only_where_the_first_will_not_do(monkeypatch: pytest.MonkeyPatch) -> None:
    S = ready(run())
    shooting, z = Shooting(S.problem, S.structure), S.structure.first
    begin, _, _, _ = shooting.settled(z, S.problem.initial, parameters=False)
    asked: list[int] = []

    def counted(problem: Problem, structure: Structure, Z: list[np.ndarray], initial: np.ndarray) -> np.ndarray:
        asked.append(len(Z) * len(problem.windows))
        return predict(problem, structure, Z, initial)

    monkeypatch.setattr(shooting_module, "predict", counted)
    n = len(begin)
    wrong = begin.copy()
    wrong[3, 1] += 1.0  # m/s
    shooting.best_initial(z, np.ones(n), [wrong, begin, S.problem.initial])
    assert asked[0] == n
    assert 2 <= sum(asked[1:]) < n


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_derivatives_carried_along_tell_the_step_that_was_made(seed: int) -> None:
    """And say of every direction at right angles to it what they said before."""
    shooting, rng = shot(), np.random.default_rng(seed)
    n, m = shooting.problem.windows.times.shape
    rows, two = m + shooting.nb2, shooting.nb2
    columns, sensitivity = rng.normal(size=(n, rows, 3)), rng.normal(size=(n, rows, two))
    step, moved, change = rng.normal(size=3), rng.normal(size=(n, two)) * shooting.nudge, rng.normal(size=(n, m, 1))
    after, then = shooting.secant(columns, sensitivity, step, moved, change)
    told = after @ step + np.einsum("nmk,nk->nm", then, moved / shooting.nudge)
    assert np.allclose(told[:, :m], change[..., 0], atol=1e-9)
    across = np.cross(step, rng.normal(size=3))
    assert np.allclose(after @ across, columns @ across, atol=1e-9)
    assert np.array_equal(after[:, m:], columns[:, m:])
    assert np.array_equal(then[:, m:], sensitivity[:, m:])


def test_a_pair_is_not_tried_again_under_another_name() -> None:
    """What answers to another name, and does the same, would only be fitted twice."""
    S, known = ready(run(friction=3.0)), catalogue()
    alone = fit(S.problem, S.structure)
    subset = np.arange(len(S.problem.windows))
    terms = [
        Term(known[name], "cart", {key: 1.0})
        for name, key in (("friction.coulomb", "level"), ("drag.quadratic", "coefficient"))
    ]
    one, other = LaidOver(S.problem, alone, subset).tried(terms)
    again = replace(other, term=replace(other.term, at="elsewhere"))
    gains = [predicted_gain for predicted_gain, _ in pairs(S.problem, alone, [one, other], subset)]
    assert len(gains) == 1
    assert [predicted_gain for predicted_gain, _ in pairs(S.problem, alone, [one, other, again], subset)] == gains
