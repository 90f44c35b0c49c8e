"""Friction compensators: inverse models of motor and friction, by name, in files, in the control loop.

from dipc_gym import compensators
llnf = compensators.fit("llnf", samples, rig)       # Samples and RigConstants: an identification run
compensators.save(llnf, "llnf.json")
volts = compensators.load("llnf.json").voltage(force=8.0, velocity=0.1)
"""

from dipc_gym.compensators.base import (
    Compensator,
    FitFigures,
    InputRange,
    OutOfRangeWarning,
    RigConstants,
    Samples,
    elementwise,
    numbers,
)
from dipc_gym.compensators.curve import Curve
from dipc_gym.compensators.feedforward import Feedforward
from dipc_gym.compensators.files import CompensatorError, load, save
from dipc_gym.compensators.hilomot import HILOMOT
from dipc_gym.compensators.llnf import LLNF
from dipc_gym.compensators.lolimot import LOLIMOT
from dipc_gym.compensators.mlp import MLP
from dipc_gym.compensators.registry import fit, names, register
from dipc_gym.compensators.static import Ideal, StaticGain

register("none", StaticGain)
register("feedforward", Feedforward)
register("mlp", MLP)
register("llnf", LLNF)
register("ideal", Ideal)
register("curve", Curve)
register("hilomot", HILOMOT)

__all__ = [
    "HILOMOT",
    "LLNF",
    "LOLIMOT",
    "MLP",
    "Compensator",
    "CompensatorError",
    "Curve",
    "Feedforward",
    "FitFigures",
    "Ideal",
    "InputRange",
    "OutOfRangeWarning",
    "RigConstants",
    "Samples",
    "StaticGain",
    "elementwise",
    "fit",
    "load",
    "names",
    "numbers",
    "register",
    "save",
]
