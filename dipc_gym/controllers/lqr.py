"""The linear model about upright, and the gains that hold it there.

The paper prints A, B and K without minus signs. With the parameters of `rig.xml` the linear model has its twelve
figures to the last digit, and the signs follow. Its K does not follow from the Q printed there, diag(10, 20, 20, 50,
700, 700), at any sample time; it does, within 0.4 %, from diag(1000, 20, 20, 50, 700, 700) at 0.12 ms.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg

from dipc_gym import mjcf
from dipc_gym.mechanics.rigid import Rigid

if TYPE_CHECKING:
    from dipc_gym.dataflow import Program, Value

Array = NDArray[np.float64]

PRINTED_GAIN = np.array([31.6, -720.1, 1176.3, 28.1, -20.0, 210.4])  # paper, section 4, signs restored
PRINTED_Q = np.diag([10.0, 20.0, 20.0, 50.0, 700.0, 700.0])  # the paper's weights of the state
RECOVERED_Q = np.diag([1000.0, 20.0, 20.0, 50.0, 700.0, 700.0])  # the weights from which the printed gain follows
R = 1.0  # the paper's weight of the force

_ABSOLUTE = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 1.0, 1.0]])  # joint angles -> absolute angles


@dataclass(frozen=True, eq=False)
class LQR:
    """Linear state feedback, by default with the gain printed in the paper.

    Attributes:
        gain: (6,) N per unit of the observation.

    Example:
        >>> LQR().force(np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])).__round__(6)
        -3.16
    """

    gain: Array = field(default_factory=PRINTED_GAIN.copy)
    name: str = "lqr"

    def force(self, observation: Array) -> float:
        """Minus gain times state."""
        return -float(self.gain @ observation)

    def express(self, program: Program, observation: Value) -> Value:
        """The same, written into a program that can be exported."""
        return observation.affine(-self.gain)


def linear_model(model: mujoco.MjModel) -> tuple[Array, Array]:
    """Linearise a rig about upright, motor short-circuited, without dry friction, lags and play.

    Viscous drag and back-EMF are in it: they are linear. The state is the observation's, with absolute angles.

    Args:
        model: a rig with the sensors `cart`, `pole1`, `pole2`.

    Returns:
        A, (6, 6), and B, (6, 1), of dx/dt = A x + B F with the force F on the cart in N.

    Raises:
        MjcfError: a sensor is missing.

    Example:
        >>> from dipc_gym.env import DoublePendulumEnv
        >>> A, B = linear_model(DoublePendulumEnv().model)
        >>> B[3:, 0].round(4).tolist()
        [1.2005, -2.8687, -0.1414]
    """
    dofs = []
    for name in ("cart", "pole1", "pole2"):
        sensor = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SENSOR, name)
        if sensor < 0:
            raise mjcf.MjcfError(f"the model has no sensor {name!r}")
        dofs.append(int(model.jnt_dofadr[model.sensor_objid[sensor]]))
    rigid = Rigid(model, dofs)

    def acceleration(state: Array, force: float) -> Array:
        position, velocity = np.linalg.solve(_ABSOLUTE, state[:3]), np.linalg.solve(_ABSOLUTE, state[3:])
        return _ABSOLUTE @ rigid.acceleration(position, velocity, [force, 0.0, 0.0])

    step = 1e-5  # central differences: error near 1e-10 from the step and 1e-10 from rounding
    A, B = np.zeros((6, 6)), np.zeros((6, 1))
    A[:3, 3:] = np.eye(3)
    zero = np.zeros(6)
    for i in range(6):
        nudge = step * np.eye(6)[i]
        A[3:, i] = (acceleration(nudge, 0.0) - acceleration(-nudge, 0.0)) / (2 * step)
    B[3:, 0] = (acceleration(zero, step) - acceleration(zero, -step)) / (2 * step)
    return A, B


def sampled(A: ArrayLike, B: ArrayLike, period: float) -> tuple[Array, Array]:
    """The exact discrete model of a continuous one whose input is held over each period (s).

    Raises:
        ValueError: the period is not positive.
    """
    if not period > 0:
        raise ValueError(f"the sample time is {period} s; it must be positive")
    A, B = np.atleast_2d(np.asarray(A, float)), np.atleast_2d(np.asarray(B, float))
    n, m = B.shape
    both = linalg.expm(np.block([[A, B], [np.zeros((m, n + m))]]) * period)
    return both[:n, :n], both[:n, n:]


def lqr(A: ArrayLike, B: ArrayLike, Q: ArrayLike, R: ArrayLike) -> Array:
    """Gain K of u = -K x that minimises the integral of x'Qx + u'Ru.

    Returns:
        (m, n) gain.

    Raises:
        numpy.linalg.LinAlgError: there is no stabilising gain.

    Example:
        >>> lqr([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], np.eye(2), 1.0).round(3).tolist()
        [[1.0, 1.732]]
    """
    A, B, Q, R = (np.atleast_2d(np.asarray(matrix, float)) for matrix in (A, B, Q, R))
    return np.linalg.solve(R, B.T @ linalg.solve_continuous_are(A, B, Q, R))


def dlqr(A: ArrayLike, B: ArrayLike, Q: ArrayLike, R: ArrayLike) -> Array:
    """Gain K of u(k) = -K x(k) that minimises the sum of x'Qx + u'Ru; A and B of the sampled model.

    Returns:
        (m, n) gain.

    Raises:
        numpy.linalg.LinAlgError: there is no stabilising gain.

    Example:
        >>> dlqr(1.0, 1.0, 1.0, 1.0).round(3).tolist()
        [[0.618]]
    """
    A, B, Q, R = (np.atleast_2d(np.asarray(matrix, float)) for matrix in (A, B, Q, R))
    P = linalg.solve_discrete_are(A, B, Q, R)
    return np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
