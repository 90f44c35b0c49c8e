"""Friction compensators: inverse models of motor and friction, by name, in files, in the control loop.

from dipc_gym import compensators
llnf = compensators.fit("llnf", samples, rig)       # Samples and RigConstants: an identification run
compensators.save(llnf, "llnf.json")
volts = compensators.load("llnf.json").voltage(force=8.0, velocity=0.1)
"""

from dipc_gym.compensators.base import (
    Compensator,
    FallbackWarning,
    FitFigures,
    InputRange,
    OutOfRangeWarning,
    RigConstants,
    Samples,
    elementwise,
    numbers,
)
from dipc_gym.compensators.curve import Curve
from dipc_gym.compensators.disturbance_observer import DisturbanceObserver
from dipc_gym.compensators.feedforward import Feedforward
from dipc_gym.compensators.files import CompensatorError, load, save
from dipc_gym.compensators.friedland import Friedland
from dipc_gym.compensators.hilomot import HILOMOT
from dipc_gym.compensators.history import AdaptedHistory, History
from dipc_gym.compensators.llnf import LLNF
from dipc_gym.compensators.llnf_adaptive import AdaptiveLLNF
from dipc_gym.compensators.llnf_lagged import LaggedLLNF
from dipc_gym.compensators.lolimot import LOLIMOT
from dipc_gym.compensators.lugre import LuGre
from dipc_gym.compensators.maxwell_slip import MaxwellSlip
from dipc_gym.compensators.memory import Remembering
from dipc_gym.compensators.mlp import MLP
from dipc_gym.compensators.observed import Observed
from dipc_gym.compensators.registry import fit, kind, names, register, registered_elsewhere
from dipc_gym.compensators.static import Ideal, StaticGain
from dipc_gym.compensators.stribeck import Stribeck

register("none", StaticGain)
register("feedforward", Feedforward)
register("mlp", MLP)
register("llnf", LLNF)
register("ideal", Ideal)
register("curve", Curve)
register("hilomot", HILOMOT)
register("stribeck", Stribeck)
register("lugre", LuGre)
register("maxwell_slip", MaxwellSlip)
register("friedland", Friedland)
register("disturbance_observer", DisturbanceObserver)
register("llnf_lagged", LaggedLLNF)
register("llnf_adaptive", AdaptiveLLNF)
register("history", History)
register("history_adapted", AdaptedHistory)
register("observed", Observed)

__all__ = [
    "HILOMOT",
    "LLNF",
    "LOLIMOT",
    "MLP",
    "AdaptedHistory",
    "AdaptiveLLNF",
    "Compensator",
    "CompensatorError",
    "Curve",
    "DisturbanceObserver",
    "FallbackWarning",
    "Feedforward",
    "FitFigures",
    "Friedland",
    "History",
    "Ideal",
    "InputRange",
    "LaggedLLNF",
    "LuGre",
    "MaxwellSlip",
    "Observed",
    "OutOfRangeWarning",
    "Remembering",
    "RigConstants",
    "Samples",
    "StaticGain",
    "Stribeck",
    "elementwise",
    "fit",
    "kind",
    "load",
    "names",
    "numbers",
    "register",
    "registered_elsewhere",
    "save",
]
