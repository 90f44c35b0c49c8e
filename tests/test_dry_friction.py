"""Dry friction with located reversals, against solutions in closed form and an integrator that detects events."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mujoco import batch
from scipy.integrate import solve_ivp

from dipc_gym.sim2real.simulation.dry_friction import DryFriction

STEP = 0.002
BLOCK = """<mujoco><option timestep="0.002" integrator="RK4" gravity="{gravity}"/>
  <worldbody><body><inertial pos="0 0 0" mass="{mass}" diaginertia="1 1 1"/>
    <joint type="slide" axis="1 0 0" stiffness="{stiffness}"/></body></worldbody></mujoco>"""
CART_POLE = """<mujoco><option timestep="0.002" integrator="RK4"/>
  <worldbody><body><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><joint type="slide" axis="1 0 0"/>
    <body><inertial pos="0 0 -0.3" mass="0.5" diaginertia="0.01 0.01 0.01"/><joint axis="0 1 0"/></body>
  </body></worldbody></mujoco>"""


def block(mass: float = 1.5, stiffness: float = 0.0, gravity: str = "0 0 -9.81") -> str:
    return BLOCK.format(mass=mass, stiffness=stiffness, gravity=gravity)


def simulate(
    text: str,
    level: Sequence[float] | np.ndarray,
    start: np.ndarray,
    steps: int,
    force: Callable[[float], float] = lambda t: 0.0,
) -> np.ndarray:
    """States (steps + 1, nsim, 2 nv) from starts (nsim, 2 nv), under a force on the first joint held over each step."""
    start = np.atleast_2d(np.asarray(start, dtype=float))
    model = mujoco.MjModel.from_xml_string(text)
    sims = batch.Batch(model, len(start), 1)
    dry = DryFriction(sims, np.broadcast_to(np.asarray(level, dtype=float), (len(start), model.nv)).copy())
    sims.qpos[:], sims.qvel[:] = start[:, : model.nv], start[:, model.nv :]
    dry.begin()
    out, forces, sensed = [start], np.zeros((len(start), model.nv)), sims.bind("sensordata")
    for k in range(steps):
        forces[:, 0] = force(k * STEP)
        dry.step(forces, None, sensed)
        out.append(np.concatenate([sims.qpos, sims.qvel], axis=1))
    return np.array(out)


# One block


@pytest.mark.parametrize(("mass", "speed", "level"), [(1.5, 0.4, 2.0), (0.2, -3.0, 7.3), (10.0, 0.001, 0.5)])
def test_a_sliding_block_stops_where_and_when_it_must(mass: float, speed: float, level: float) -> None:
    states = simulate(block(mass), [level], [[0.1, speed]], 600)[:, 0]
    time = np.arange(601) * STEP
    sliding = np.minimum(time, mass * abs(speed) / level)
    way = np.sign(speed) * (abs(speed) * sliding - level / mass * sliding**2 / 2)
    assert states[:, 0] == pytest.approx(0.1 + way, abs=1e-12)
    assert states[-1, 1] == 0
    assert states[:, 1] == pytest.approx(speed - np.sign(speed) * level / mass * sliding, abs=1e-12)


def test_a_stopped_block_never_moves_again() -> None:
    states = simulate(block(), [2.0], [[0.0, -0.5]], 5000, force=lambda t: 1.99)[:, 0]
    stopped = np.flatnonzero(states[:, 1] == 0)[0]
    assert np.ptp(states[stopped:, 0]) == 0
    assert not np.any(states[stopped:, 1])


@pytest.mark.parametrize("sign", [-1, 1])
def test_a_block_under_a_slow_ramp_breaks_away_at_the_level(sign: int) -> None:
    level, mass, rate = 2.0, 1.5, 1.7
    states = simulate(block(mass), [level], [[0.0, 0.0]], 800, force=lambda t: sign * rate * t)[:, 0]
    held = np.arange(800) * STEP * rate
    first = int(np.flatnonzero(held > level)[0])
    assert not np.any(states[: first + 1])
    assert sign * states[first + 1, 1] == pytest.approx((held[first] - level) / mass * STEP, rel=1e-9)
    # From then on, what is left of the force accelerates it.
    speed = np.concatenate([[0.0], np.cumsum(np.maximum(held - level, 0.0)) / mass * STEP])
    assert sign * states[:, 1] == pytest.approx(speed, abs=1e-12)


def test_on_a_slope_it_holds_up_to_the_angle_of_friction() -> None:
    weight, level = 1.5 * 9.81, 3.0
    angle = np.arcsin(level / weight)
    for slope, moves in ((0.999 * angle, False), (1.001 * angle, True)):
        gravity = f"{9.81 * np.sin(slope)} 0 {-9.81 * np.cos(slope)}"
        states = simulate(block(gravity=gravity), [level], [[0.0, 0.0]], 500)[:, 0]
        assert bool(states[-1, 0]) == moves
        if moves:
            acceleration = (weight * np.sin(slope) - level) / 1.5
            assert states[-1, 0] == pytest.approx(acceleration * 1.0**2 / 2, rel=1e-9)


def test_a_spring_brings_it_to_rest_within_the_dead_band() -> None:
    """Free swings lose 4 level / stiffness of amplitude each full turn, until the spring cannot pull it loose."""
    level, stiffness, mass = 1.0, 200.0, 1.5
    states = simulate(block(mass, stiffness), [level], [[0.1, 0.0]], 2000)[:, 0]
    band = level / stiffness
    half = np.pi * np.sqrt(mass / stiffness)
    swings = 0
    amplitude = 0.1
    while amplitude > band:
        amplitude, swings = abs(amplitude - 2 * band), swings + 1
    # In the last swing it may stop on either side of the middle.
    assert abs(states[-1, 0]) == pytest.approx(amplitude, abs=1e-6)
    assert not np.any(states[int(swings * half / STEP) + 2 :, 1])


# Against an integrator that detects events


def stick_slip(
    accelerate: Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]],
    level: np.ndarray,
    state: np.ndarray,
    until: float,
) -> np.ndarray:
    """A reference: solve_ivp within a regime, events at its borders.

    Args:
        accelerate: gives accelerations and holding forces (nv,) from positions, velocities, friction on sliding
            joints, and which joints stick.
        level: of friction, (nv,).
        state: positions and velocities, (2 nv,).
        until: s.
    """
    nv, now, state = len(level), 0.0, state.astype(float)
    sign = np.sign(state[nv:])
    while now < until - 1e-12:
        for _ in range(3):  # joints at rest stick, or begin to slide against what would have to hold them
            _, hold = accelerate(state[:nv], state[nv:], -sign * level, sign == 0)
            free = (sign == 0) & (np.abs(hold) > level * (1 + 1e-12))
            sign = np.where(free, -np.sign(hold), sign)
            if not free.any():
                break

        def right(t: float, y: np.ndarray, sign: np.ndarray = sign) -> np.ndarray:
            return np.concatenate([y[nv:], accelerate(y[:nv], y[nv:], -sign * level, sign == 0)[0]])

        events: list[Callable[..., float]] = []
        for j in range(nv):

            def border(t: float, y: np.ndarray, j: int = j, sign: np.ndarray = sign) -> float:
                if sign[j]:
                    return float(sign[j] * y[nv + j])
                return float(level[j] - abs(accelerate(y[:nv], y[nv:], -sign * level, sign == 0)[1][j]))

            border.terminal, border.direction = True, -1  # type: ignore[attr-defined]
            events.append(border)
        done = solve_ivp(right, (now, until), state, rtol=1e-11, atol=1e-13, events=events, max_step=0.01)
        now, state = float(done.t[-1]), done.y[:, -1].copy()
        for j, happened in enumerate(done.t_events):
            if len(happened):
                if sign[j]:
                    state[nv + j], sign[j] = 0.0, 0.0
                else:
                    hold = accelerate(state[:nv], state[nv:], -sign * level, sign == 0)[1][j]
                    sign[j] = -np.sign(hold)
    return state


def test_a_driven_oscillator_agrees_with_event_detection() -> None:
    """Stick, slip and reversals under a force held over each step: to a micrometre in 3 s, at steps of 2 ms."""
    mass, stiffness, level = 1.5, 400.0, np.array([2.0])

    def force(t: float) -> float:
        return float(6 * np.sin(2 * np.pi * 1.1 * t) + 3 * np.sin(2 * np.pi * 2.7 * t + 0.5))

    states = simulate(block(mass, stiffness), level, [[0.02, 0.0]], 1500, force)[:, 0]
    reference = [np.array([0.02, 0.0])]
    for k in range(1500):
        pull = force(k * STEP)

        def accelerate(
            q: np.ndarray, v: np.ndarray, friction: np.ndarray, stuck: np.ndarray, pull: float = pull
        ) -> tuple[np.ndarray, np.ndarray]:
            rest = pull - stiffness * q
            return np.where(stuck, 0.0, (rest + friction) / mass), -rest

        reference.append(stick_slip(accelerate, level, reference[-1], STEP))
    assert np.sum(np.diff(np.sign(states[:, 1])) != 0) > 10  # it reverses and sticks often enough to be a test
    assert np.sum(states[:, 1] == 0) > 100
    assert states[:, 0] == pytest.approx(np.array(reference)[:, 0], abs=1e-6)


def cart_pole(q: np.ndarray, v: np.ndarray, friction: np.ndarray, stuck: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Equations of motion of a pole that hangs from a cart, angle from hanging; sticking joints are held."""
    m, l, inertia, g = 0.5, 0.3, 0.01 + 0.5 * 0.3**2, 9.81
    # A positive turn about y moves what hangs towards negative x.
    matrix = np.array([[1.5, -m * l * np.cos(q[1])], [-m * l * np.cos(q[1]), inertia]])
    rest = np.array([-m * l * np.sin(q[1]) * v[1] ** 2, -m * g * l * np.sin(q[1])])
    hold = np.zeros(2)
    slides = ~stuck
    acceleration = np.zeros(2)
    if slides.any():
        acceleration[slides] = np.linalg.solve(matrix[np.ix_(slides, slides)], (rest + friction)[slides])
    hold[stuck] = (matrix @ acceleration - rest)[stuck]
    return acceleration, hold


def test_the_reference_moves_like_the_model() -> None:
    states = simulate(CART_POLE, [0.0, 0.0], [[0.0, 1.0, 0.1, -0.5]], 100)[:, 0]
    reference = stick_slip(cart_pole, np.zeros(2), np.array([0.0, 1.0, 0.1, -0.5]), 0.2)
    assert states[-1] == pytest.approx(reference, abs=1e-7)


@pytest.mark.parametrize("level", [(0.8, 0.02), (2.5, 0.05), (0.05, 0.3)])
def test_two_joints_with_friction_agree_with_event_detection(level: tuple[float, float]) -> None:
    """A pole swings out on a cart that it drags along, sticks and tears loose.

    A stuck joint that is torn loose by another one's motion moves from the next step on: hence micrometres here, and
    tens of microradians after many swings.
    """
    start = np.array([0.0, 1.2, 0.0, 0.0])
    states = simulate(CART_POLE, level, start, 1000)[:, 0]
    for seconds, tolerance in ((0.25, 3e-6), (0.9, 1e-5), (2.0, 3e-5)):
        reference = stick_slip(cart_pole, np.array(level), start, seconds)
        assert states[round(seconds / STEP), :2] == pytest.approx(reference[:2], abs=tolerance)


def test_a_stuck_cart_is_a_fixed_pivot() -> None:
    """Friction that is never overcome: the pole swings as if the cart were bolted down."""
    start = np.array([0.0, 1.2, 0.0, 0.0])
    states = simulate(CART_POLE, [1e3, 0.0], start, 1000)[:, 0]
    bolted = solve_ivp(
        lambda t, y: [y[1], -0.5 * 9.81 * 0.3 * np.sin(y[0]) / (0.01 + 0.5 * 0.3**2)],
        (0, 2),
        [1.2, 0],
        rtol=1e-11,
        atol=1e-13,
    )
    assert not np.any(states[:, [0, 2]])
    assert states[-1, 1] == pytest.approx(bolted.y[0, -1], abs=2e-6)


# Laws that hold for all


def energy(states: np.ndarray) -> np.ndarray:
    model = mujoco.MjModel.from_xml_string(CART_POLE)
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    data, out = mujoco.MjData(model), []
    for state in states:
        data.qpos[:], data.qvel[:] = state[:2], state[2:]
        mujoco.mj_forward(model, data)
        out.append(sum(data.energy))
    return np.array(out)


@settings(max_examples=40, deadline=None)
@given(
    level=st.tuples(st.floats(0, 4), st.floats(0, 0.5)),
    start=st.tuples(st.floats(-0.2, 0.2), st.floats(-3, 3), st.floats(-1, 1), st.floats(-8, 8)),
)
def test_energy_never_rises_without_drive(level: tuple[float, float], start: tuple[float, ...]) -> None:
    states = simulate(CART_POLE, level, np.array([start]), 150)[:, 0]
    rise = np.diff(energy(states))
    assert rise.max() < 1e-6  # J, of up to 10: what RK4 and a holding force that follows a step behind leave


@settings(max_examples=30, deadline=None)
@given(st.floats(0.05, 5), st.floats(-2, 2), st.floats(-4, 4))
def test_friction_never_exceeds_its_level(level: float, speed: float, pull: float) -> None:
    states = simulate(block(1.0), [level], [[0.0, speed]], 200, force=lambda t: pull)[:, 0]
    friction = np.diff(states[:, 1]) / STEP - pull
    # Reversals are located to a millionth of a step, in which friction still acts the old way.
    assert np.abs(friction).max() <= level + 2e-6 * (level + abs(pull)) + 1e-9


def test_simulations_of_a_batch_do_not_touch_each_other() -> None:
    rng = np.random.default_rng(3)
    level, start = rng.uniform(0, [2, 0.2], (7, 2)), rng.normal(size=(7, 4))
    together = simulate(CART_POLE, level, start, 200)
    alone = [simulate(CART_POLE, level[i], start[i], 200)[:, 0] for i in range(7)]
    assert np.array_equal(together, np.stack(alone, axis=1))


def test_without_friction_it_is_mujocos_own_step() -> None:
    start = np.array([0.1, 0.5, -0.3, 2.0])
    model = mujoco.MjModel.from_xml_string(CART_POLE)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = start[:2], start[2:]
    mujoco.mj_step(model, data, 300)
    assert np.array_equal(simulate(CART_POLE, [0.0, 0.0], start, 300)[-1, 0], [*data.qpos, *data.qvel])


def test_a_block_under_way_where_friction_begins_is_not_held() -> None:
    """Friction along the way may be none for a while; the block that comes from there slides on, and slows down."""
    model = mujoco.MjModel.from_xml_string(block(mass=1.5))
    sims = batch.Batch(model, 2, 1)
    dry = DryFriction(sims, np.zeros((2, 1)))
    sims.qvel[:] = [[0.4], [-0.4]]
    dry.begin()
    forces, sensed = np.zeros((2, 1)), sims.bind("sensordata")
    dry.step(forces, None, sensed)
    dry.level[:] = 2.0
    for _ in range(50):
        dry.step(forces, None, sensed)
    np.testing.assert_allclose(sims.qvel[:, 0], [0.4 - 2.0 / 1.5 * 0.1, -0.4 + 2.0 / 1.5 * 0.1], rtol=1e-9)
