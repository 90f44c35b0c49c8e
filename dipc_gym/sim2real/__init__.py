"""Sim-to-real: find, name and model the physics that a simulator leaves out.

`diagnose(model, recordings)` does it all. Data flows one way through the rooms here: a `model` with its `effects` is
laid over recordings in `simulation` and `estimation`, `selection` compares what may be missing, `verdict` says what it
comes to, and `report` tells it.

What is listed in `__all__` is public, and stays. An effect of one's own needs `Effect`, `Parameter`, `Evidence`,
`Values` and `Document` to be written, `fit_effect` to be tried, and `register` to stand in the `catalogue` that
`diagnose` searches. `save` writes a diagnosis into a folder, and `redraw` draws its report again.
"""

from dipc_gym import recording
from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.diagnosis import diagnose
from dipc_gym.sim2real.effects import Effect, Evidence, Parameter, Values, catalogue, register
from dipc_gym.sim2real.model.parameters import Wishes
from dipc_gym.sim2real.one_effect import EffectFit, fit_effect
from dipc_gym.sim2real.report.folder import redraw, save
from dipc_gym.sim2real.report.saved import SavedError
from dipc_gym.sim2real.result import (
    Candidate,
    Design,
    Details,
    Diagnosis,
    Errors,
    Located,
    Mismatch,
    Missing,
    SensorResidual,
    Trace,
)

__all__ = [
    "Candidate",
    "Design",
    "Details",
    "Diagnosis",
    "Document",
    "Effect",
    "EffectFit",
    "Errors",
    "Evidence",
    "Located",
    "Mismatch",
    "Missing",
    "Parameter",
    "SavedError",
    "SensorResidual",
    "Trace",
    "Values",
    "Wishes",
    "catalogue",
    "diagnose",
    "fit_effect",
    "recording",
    "redraw",
    "register",
    "save",
]
