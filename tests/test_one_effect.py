"""A look at one effect: where it is missing it brings the prediction to the noise, and its parameter to the truth."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from dipc_gym import mjcf, recording
from dipc_gym.sim2real import Document, Effect, Evidence, Parameter, Values, catalogue, diagnose, fit_effect

FOLDER = Path(__file__).resolve().parent.parent / "examples" / "diagnose"


class Bob(Effect):
    """A mass on a joint's body: as a geom, which counts no more once the body has an `<inertial>`, or as a body."""

    id = "load.bob"
    place = "joint"
    parameters = (Parameter("mass", "kg", low=0.0),)

    def __init__(self, as_body: bool) -> None:
        self.as_body = as_body

    def guesses(self, evidence: Evidence) -> list[Values]:
        return [{"mass": 0.05}]

    def edit(self, document: Document, at: str, values: Values) -> None:
        body = next(body for body in document.root.iter("body") if document.joint(at) in list(body))
        body = ET.SubElement(body, "body") if self.as_body else body
        ET.SubElement(body, "geom", type="sphere", size="0.01", pos="0.1 0 0", mass=str(values["mass"]))

    def sentence(self, at: str, values: Values, unit: dict[str, str]) -> str:
        return f"A bob of {values['mass']:.3g} {unit['mass']} at {at}."


def test_an_effect_that_changes_no_prediction_is_refused_and_not_fitted() -> None:
    model = mjcf.read(FOLDER / "arm.xml")
    run = recording.read(FOLDER / "run_1.csv", mjcf.compile(model))
    with pytest.raises(ValueError, match=r"load\.bob at shoulder changes no prediction: does something override its"):
        fit_effect(Bob(as_body=False), model, [run])
    (found,) = fit_effect(Bob(as_body=True), model, [run])  # the mend that the page names
    assert found.values["mass"] != 0.05


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


def test_times_are_counted_from_the_first_sample_as_a_diagnosis_counts_them() -> None:
    """A clock that counts from 1970 would give the phase of what shakes a rig for that year."""
    model = mjcf.read(FOLDER / "arm.xml")
    run = recording.read(FOLDER / "run_1.csv", mjcf.compile(model))
    later = replace(run, time=run.time + 2.0**24)
    ours, theirs = (fit_effect(catalogue()["disturbance.periodic"], model, [one])[0] for one in (run, later))
    assert theirs.values == pytest.approx(ours.values, rel=1e-3)  # a clock that has run for months has few digits left


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
