"""One rig as machine code, for the single environment; MuJoCo's data show where it is."""

from __future__ import annotations

import mujoco
import numpy as np

from dipc_gym.rigs.compiled import CompiledRigs
from dipc_gym.rigs.rig import Rig
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
        self._rig, self._encoders = rig, Encoders(1)
        self._encoders.become(_ROW, [rig.plant])
        self._rigs = CompiledRigs(rig, self._encoders)
        self._volts = np.zeros(1)

    def become(self, rig: Rig) -> bool:
        """Take the numbers of a rig; False if it has another layout."""
        mine, theirs = self._rig.plant, rig.plant
        fits = rig.source is self._rig.source and theirs.layout == mine.layout and theirs.delay <= mine.delay
        if fits:
            self._encoders.become(_ROW, [theirs])
            self._rigs.become(_ROW, [theirs])
        return fits

    @property
    def friction(self) -> float:
        """Dry friction on the cart at the last physics step, N."""
        return float(self._rigs.friction[0])

    def begin(self, state: tuple[float, ...]) -> None:
        """Put the rig into a state as observed, the motor at rest."""
        self._rigs.begin(_ROW, np.array([state]), np.zeros(1, dtype=bool), np.zeros((1, 3)))

    def advance(self, data: mujoco.MjData, volts: float) -> None:
        """Hold a voltage for one control period, from where and how fast the data say that joints move."""
        motion, n = self._rigs.motion(0), self._rig.model.nq
        motion[:n], motion[n:] = data.qpos, data.qvel
        self._volts[0] = volts
        self._rigs.hold(self._volts)
        data.qpos, data.qvel, data.time = motion[:n], motion[n:], self._rigs.time[0]

    def show(self, data: mujoco.MjData) -> None:
        """Work out where bodies are, for a picture; `advance` needs no more than joints."""
        model = self._rig.model
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_camlight(model, data)
