"""One rig as machine code, for the single environment; MuJoCo's data show where it is."""

from __future__ import annotations

import mujoco
import numpy as np

from dipc_gym.rig import Rig
from dipc_gym.rigs.compiled import CompiledRigs
from dipc_gym.rigs.together import Encoders

_ROW = np.zeros(1, dtype=np.intp)


class CompiledRig:
    """A rig of `CompiledRigs` that is alone: the physics only, to the same bits.

    Args:
        rig: the model and where its parts are.

    Raises:
        MjcfError: the model has what this engine leaves out.
    """

    def __init__(self, rig: Rig) -> None:
        encoders = Encoders(1)
        encoders.become(_ROW, [rig.plant])
        self._rigs = CompiledRigs(rig, encoders)

    @property
    def friction(self) -> float:
        """Dry friction on the cart at the last physics step, N."""
        return float(self._rigs.friction[0])

    def begin(self, state: tuple[float, ...]) -> None:
        """Put the rig into a state as observed, the motor at rest."""
        self._rigs.begin(_ROW, np.array([state]), np.zeros(1, dtype=bool), np.zeros((1, 3)))

    def advance(self, data: mujoco.MjData, volts: float) -> None:
        """Hold a voltage for one control period, from where and how fast the data say that joints move."""
        rigs = self._rigs
        rigs.motion = np.concatenate([data.qpos, data.qvel])[None]
        rigs.hold(np.array([volts]))
        motion, n = rigs.motion[0], len(data.qpos)
        data.qpos[:], data.qvel[:], data.time = motion[:n], motion[n:], float(rigs.time[0])
