"""A look at one effect: where it is missing it brings the prediction to the noise, and its parameter to the truth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from dipc_gym import mjcf, recording
from dipc_gym.sim2real import catalogue, diagnose, fit_effect

FOLDER = Path(__file__).resolve().parent.parent / "examples" / "diagnose"


def test_finds_the_level_and_writes_a_model_that_has_it() -> None:
    model = mjcf.read(FOLDER / "arm.xml")
    run = recording.read(FOLDER / "run_1.csv", mjcf.compile(model))
    (found,) = fit_effect(catalogue()["friction.coulomb"], model, [run])
    assert found.at == "shoulder"
    assert found.error < 1.2 < found.error_without
    assert found.values["level"] == pytest.approx(0.15, rel=0.02)  # what record.py of that folder simulates
    assert found.units == {"level": "N m"}
    improved = mujoco.MjModel.from_xml_string(found.improved)
    assert improved.dof_frictionloss[0] == found.values["level"]


def test_an_effect_that_the_model_has_already_is_fitted_nowhere() -> None:
    model = mjcf.from_text((FOLDER / "arm.xml").read_text().replace("<joint ", '<joint frictionloss="0.1" '))
    run = recording.read(FOLDER / "run_1.csv", mjcf.compile(model))
    assert fit_effect(catalogue()["friction.coulomb"], model, [run]) == []


def test_angles_that_look_like_degrees_are_refused_with_what_to_say() -> None:
    model = mjcf.read(FOLDER / "arm.xml")
    run = recording.read(FOLDER / "run_1.csv", mjcf.compile(model))
    wrong = replace(run, sensors=np.degrees(run.sensors), sha256="")
    with pytest.raises(recording.RecordingError, match=r"looks like degrees; read it with units={'angle': 'deg'} if"):
        fit_effect(catalogue()["friction.coulomb"], model, [wrong])
    for recordings, held_out in (([wrong], []), ([run], [wrong])):
        with pytest.raises(recording.RecordingError, match="looks like degrees; read it with units="):
            diagnose(model, recordings, held_out)
