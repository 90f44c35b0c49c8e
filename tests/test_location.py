"""Where a mismatch sits, and what it goes with: quantities of the moment, and how fast a joint was of late."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from dipc_gym import mjcf
from dipc_gym.sim2real.estimation.unexplained import Scene
from dipc_gym.sim2real.result import Located
from dipc_gym.sim2real.verdict import word
from dipc_gym.sim2real.verdict.location import locate
from dipc_gym.sim2real.verdict.settings import VERDICT

AXIS = mjcf.compile(
    mjcf.from_text(
        '<mujoco><worldbody><body><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><joint name="axis"/></body>'
        "</worldbody></mujoco>"
    )
)
PERIOD, SAMPLES = 0.002, 10_000


def scene(thins: float, noise: float, seed: int = 0) -> Scene:
    """Two recordings of 20 s in which a drag of 1 N m s/rad is less by a share, where the joint was fast of late."""
    rng = np.random.default_rng(seed)
    time = np.arange(SAMPLES) * PERIOD
    velocities, forces = [], []
    for _ in range(2):
        swell = 1.0 + 0.9 * np.sin(2 * np.pi * time / rng.uniform(6.0, 9.0) + rng.uniform(0, 6))
        velocity = swell * np.sin(2 * np.pi * rng.uniform(1.0, 2.0) * time)
        late = lfilter([PERIOD / 2.0], [1.0, PERIOD / 2.0 - 1.0], np.abs(velocity))
        velocities.append(velocity)
        forces.append(thins * velocity * (late - late.mean()) + noise * rng.normal(size=SAMPLES))
    velocity, force = np.concatenate(velocities)[:, None], np.concatenate(forces)[:, None]
    position = np.concatenate([np.cumsum(one) * PERIOD for one in velocities])[:, None]
    load = np.gradient(velocity[:, 0])[:, None] / PERIOD
    return Scene(AXIS, (), np.tile(time, 2), position, velocity, force, load, 0 * force, np.ones(1))


def test_a_drag_that_thins_is_told_beneath_the_noise_of_accelerations() -> None:
    """No bins of speed, place, load or time tell of a force that goes with speed now one way and now the other."""
    (found,) = locate(scene(0.4, 0.5), ["axis"])
    assert found.explained < VERDICT.pattern
    assert found.of_late > 1.5 * VERDICT.of_late
    assert found.where.startswith("goes with velocity, by how fast it was of late")
    assert not word.negligible(8.0, 1e5, found)


@pytest.mark.parametrize("seed", range(10))
def test_noise_goes_with_nothing(seed: int) -> None:
    (found,) = locate(scene(0.0, 0.5, seed), ["axis"])
    assert max(found.explained, 2 * found.of_late) < 0.5 * VERDICT.pattern
    assert "alike" in found.where
    assert word.negligible(8.0, 1e5, found)


def test_a_force_of_the_moment_is_said_to_be_one() -> None:
    plain = scene(0.0, 0.1)
    (found,) = locate(Scene(**{**vars(plain), "force": plain.force + np.sin(plain.position)}), ["axis"])
    assert found.where.startswith("goes with position")


def test_what_is_small_and_goes_with_nothing_is_negligible() -> None:
    assert word.negligible(8.0, 1e5, Located("axis", 1.0, "", 0.02, 0.01))
    assert not word.negligible(8.0, 1e3, Located("axis", 1.0, "", 0.02, 0.01))
