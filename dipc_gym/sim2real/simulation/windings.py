"""Currents of motors with inductance, as MuJoCo steps them under Runge-Kutta, put right."""

from __future__ import annotations

import math

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

Array = NDArray[np.float64]

_LARGEST = 1.2  # time constants in a step, to which `_decay` grows


def steady_currents(model: mujoco.MjModel, step: float) -> Array:
    """Make windings follow their time constants under RK4; the delay each control still needs for that, s, (nu,).

    MuJoCo averages the current's rate over RK4's stages and puts the average into an exponential meant for the rate at
    the step's beginning, which delays by half a step; or it acts with the next step's current (`actearly`), which comes
    half a step early, before the back-EMF of its own speed too. The first of the two with another time constant,
    chosen so that a step decays as the winding does, is of second order; it exists where a step is not much longer than
    half the time constant. Faster windings act early. What either lacks of the winding's lag is a delay of commands.
    """
    delay = np.zeros(model.nu)
    for i in range(model.nactuator):
        tau = float(model.actuator_dynprm[i, 0])
        if model.actuator_gaintype[i] != mujoco.mjtGain.mjGAIN_DCMOTOR or tau <= 0:
            continue
        decay = -math.expm1(-step / tau)
        lag = step / decay - step
        if decay < _decay(_LARGEST):
            x = brentq(lambda x, decay=decay: _decay(x) - decay, 1e-9, _LARGEST)
            model.actuator_dynprm[i, 0], model.actuator_actearly[i] = step / x, False
            lag = step / decay * (1 - x / 2 + x**2 / 6 - x**3 / 24)  # of the mean over RK4's stages
        first = int(model.actuator_ctrladr[i])
        delay[first : first + int(model.actuator_ctrlnum[i])] = tau - lag
    return delay


def _decay(x: float) -> float:
    """Share of the way to its target that MuJoCo's current goes in a step of x time constants, under RK4."""
    return (x - x**2 / 2 + x**3 / 6 - x**4 / 24) * -math.expm1(-x) / x
