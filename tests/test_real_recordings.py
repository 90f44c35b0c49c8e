"""Recordings of real rigs: how their originals are read, and what the diagnosis says of them.

The originals that are read here are written by the tests, in the layout of the published ones. The recordings are not
part of the project; where they are not beside it, their tests skip.
"""

from __future__ import annotations

import importlib.util
import json
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import mujoco
import numpy as np
import pytest
from scipy.io import savemat

from dipc_gym import mjcf, recording
from dipc_gym.sim2real.diagnosis import diagnose
from dipc_gym.sim2real.effects import catalogue
from dipc_gym.sim2real.result import Diagnosis

CHECKOUT = Path(__file__).resolve().parent.parent
SCRIPT = CHECKOUT / "examples" / "real_recordings.py"
EMPS_PUBLISHED = 0.0311  # relative error of the force, friction depending on direction (Janot et al. 2019)


@pytest.fixture(scope="module")
def script() -> ModuleType:
    spec = importlib.util.spec_from_file_location("real_recordings", SCRIPT)
    assert spec
    assert spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def convert(script: ModuleType, source: str, files: list[Path], out: Path, **options: object) -> mujoco.MjModel:
    script.main(script.Arguments(source, tuple(files), out, **options))
    return mjcf.compile(out / "nominal.xml")


def test_emps(script: ModuleType, tmp_path: Path) -> None:
    """Columns as MATLAB keeps them; the force of the pulses comes through the drive."""
    t = np.arange(60)[:, None] / 1000
    plain = {"t": t, "vir": np.cos(9 * t), "qm": 0.01 * np.sin(9 * t), "gtau": 35.0, "qg": t}
    savemat(tmp_path / "DATA.mat", plain)
    savemat(tmp_path / "PULSES.mat", {**plain, "pulses_N": np.full_like(t, 70.0)})
    model = convert(script, "emps", [tmp_path / "DATA.mat", tmp_path / "PULSES.mat"], tmp_path / "out")
    assert model.actuator("drive").gear[0] == 35.0
    calm, pushed = (recording.read(tmp_path / "out" / f"{name}.csv", model) for name in ("DATA", "PULSES"))
    np.testing.assert_array_equal(calm.time, t.ravel())
    np.testing.assert_array_equal(calm.sensors, plain["qm"])
    np.testing.assert_allclose(pushed.commands - calm.commands, 2.0)


def test_dfki(script: ModuleType, tmp_path: Path) -> None:
    """The torque that was commanded, not the measured one; runs are named after their folders."""
    names = "time,pos_meas1,pos_meas2,vel_meas1,tau_con1,tau_con2,tau_meas1"
    rows = [[5 + k / 500, np.sin(k), np.cos(k), 0, k, -k, 99] for k in range(30)]
    file = tmp_path / "20230629-143339" / "trajectory.csv"
    file.parent.mkdir()
    file.write_text("\n".join([names, *(",".join(map(str, row)) for row in rows)]) + "\n")
    model = convert(script, "dfki", [file], tmp_path / "out")
    read = recording.read(tmp_path / "out" / "20230629-143339.csv", model)
    np.testing.assert_allclose(read.time, np.arange(30) / 500, atol=1e-12)
    np.testing.assert_array_equal(read.commands, [[k, -k] for k in range(30)])
    np.testing.assert_array_equal(read.sensors, [[np.sin(k), np.cos(k)] for k in range(30)])
    # The published inertias are about the joints: links alone and with their rotors.
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    M = np.zeros((2, 2))
    mujoco.mj_fullM(model, data, M)
    rotor = 36 * 6.287203962819607e-05
    assert M[1, 1] == pytest.approx(0.05086984812807257 + rotor, rel=1e-4)
    both = 0.031887199591513114 + 0.05086984812807257 + 0.04 * 0.6255677 + 2 * 0.2 * 0.6255677 * 0.25569305
    assert M[0, 0] == pytest.approx(both + rotor, rel=1e-4)


def bam_log(off: int = 40, **changes: object) -> dict[str, object]:
    return {
        "mass": 0.49,
        "length": 0.1,
        "kp": 100,
        "motor": "xl330",
        "trajectory": "sin_sin",
        "entries": [
            {
                "timestamp": 0.003 + 0.005 * k,
                "position": 0.1 * k,
                "load": 885 if k % 2 else -177,
                "input_volts": 7.5,
                "torque_enable": k < off,
            }
            for k in range(40)
        ],
        **changes,
    }


def test_bam(script: ModuleType, tmp_path: Path) -> None:
    """PWM times supply is the motor's voltage; what follows once the torque is off is another system."""
    (tmp_path / "one.json").write_text(json.dumps(bam_log(off=30)))
    model = convert(script, "bam", [tmp_path / "one.json"], tmp_path / "out")
    read = recording.read(tmp_path / "out" / "sin_sin_kp100_one.csv", model)
    np.testing.assert_allclose(read.commands.ravel(), [-1.5, 7.5] * 15)
    np.testing.assert_allclose(read.sensors.ravel(), 0.1 * np.arange(30))
    assert model.body("arm").mass[0] == 0.49
    assert model.body("arm").ipos[2] == -0.1


def test_uw(script: ModuleType, tmp_path: Path) -> None:
    """No command at all; the beginning can be cut off; the second angle is absolute."""
    t = np.arange(200)[:, None] / 1000
    savemat(tmp_path / "FreeSwing.mat", {"Time": t, "Theta1": np.sin(t), "Theta2": np.cos(t), "dt": 0.001})
    model = convert(script, "uw", [tmp_path / "FreeSwing.mat"], tmp_path / "out", begin=0.1, end=0.15)
    read = recording.read(tmp_path / "out" / "FreeSwing.csv", model)
    assert read.commands.shape == (50, 0)
    np.testing.assert_allclose(read.time, np.arange(50) / 1000, atol=1e-12)
    np.testing.assert_array_equal(read.sensors[:, 0], np.sin(t[100:150, 0]))
    data = mujoco.MjData(model)
    data.qpos[:] = 0.3, 0.4
    mujoco.mj_forward(model, data)
    assert data.sensor("theta2").data[0] == pytest.approx(0.7)


def spoilt_matlab(folder: Path) -> list[Path]:
    savemat(folder / "a.mat", {"t": np.arange(3.0), "vir": np.arange(3.0)})
    return [folder / "a.mat"]


def spoilt_text(folder: Path) -> list[Path]:
    (folder / "a.mat").write_text("this is no MATLAB file, and never was one; " * 20)
    return [folder / "a.mat"]


def spoilt_logs(folder: Path, **changes: object) -> list[Path]:
    (folder / "a.json").write_text(json.dumps(bam_log()))
    (folder / "b.json").write_text(json.dumps(bam_log(**changes)))
    return [folder / "a.json", folder / "b.json"]


@pytest.mark.parametrize(
    ("source", "spoilt", "says"),
    [
        ("emps", spoilt_matlab, "no variable qm, gtau; it holds t, vir"),
        ("uw", spoilt_text, "not a MATLAB file"),
        ("bam", lambda folder: spoilt_logs(folder, mass=1.0), "mass differs between the files"),
        ("bam", lambda folder: spoilt_logs(folder, motor="mx64"), "model here is that of an xl330"),
        ("bam", lambda folder: spoilt_logs(folder, off=0), "torque is off"),
        ("bam", lambda folder: spoilt_logs(folder, entries=[{"load": 3}]), "torque_enable"),
        ("dfki", lambda folder: spoilt_logs(folder)[:1], "no column time"),
        ("emps", lambda folder: [], "name the downloaded files"),
    ],
)
def test_other_layouts_are_refused(source, spoilt, says: str, script: ModuleType, tmp_path: Path) -> None:
    """Named by file and field, with nothing written."""
    with pytest.raises(script.OtherLayout, match=says):
        convert(script, source, spoilt(tmp_path), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_help_teaches() -> None:
    done = subprocess.run([sys.executable, str(SCRIPT), "--help"], capture_output=True, text=True, check=True)
    for word in ("DATA_EMPS.mat", "tau_con1", "input_volts", "Theta1", "--begin", "Apache-2.0", "BSD-3-Clause", "MIT"):
        assert word in done.stdout


def real(rig: str) -> Path:
    """The folder of a rig's recordings, found above the checkout."""
    for folder in CHECKOUT.parents:
        if (folder / "shared" / "recordings" / rig).is_dir():
            return folder / "shared" / "recordings" / rig
    pytest.skip(f"no shared/recordings/{rig} beside the checkout")


def diagnosed(rig: str, runs: str, *effects: str) -> Diagnosis:
    """Diagnose the runs that match a pattern, with a part of the catalogue."""
    model = real(rig) / "nominal.xml"
    known = catalogue()
    compiled = mjcf.compile(model)
    read = [recording.read(run, compiled) for run in sorted(real(rig).glob(runs))]
    return diagnose(model, read, effects=[known[name] for name in effects])


@pytest.fixture(scope="module")
def emps() -> Diagnosis:
    return diagnosed(
        "emps",
        "emps.csv",
        "friction.coulomb",
        "friction.viscous",
        "friction.asymmetric:viscous",
        "drag.quadratic",
    )


def named(found: Diagnosis) -> list[str]:
    """What is missing, the strongest first."""
    return [f"{missing.effect}@{missing.at}" for missing in found.missing]


def test_emps_lacks_dry_and_viscous_friction(emps: Diagnosis) -> None:
    assert {"friction.coulomb@carriage", "friction.viscous@carriage"} <= set(named(emps))


def test_emps_friction_depends_on_direction(emps: Diagnosis) -> None:
    """As its authors found; with it, the force is at least as well explained as by their best model."""
    assert "friction.asymmetric@carriage" in named(emps)
    assert emps.to_dict()["fit"]["held_out_force"]["carriage"]["improved"] <= EMPS_PUBLISHED


def test_bam_friction_grows_with_load() -> None:
    """As its authors found. In the runs left out the torque was switched off, which no command of 0 V says."""
    found = diagnosed(
        "bam_xl330", "[su]*_kp*.csv", "friction.load", "friction.position", "friction.stribeck", "motor.saturation"
    )
    assert "friction.load@joint" in named(found)


def test_dfki_lacks_friction_at_its_joints_and_more() -> None:
    """As published for both joints; what else is at the shoulder has no name in the catalogue."""
    found = diagnosed("dfki", "run_0[024].csv", "friction.coulomb", "load.constant", "drag.quadratic")
    assert {"friction.coulomb@shoulder", "friction.coulomb@elbow", "unknown@shoulder"} <= set(named(found))
    assert found.verdict == "partly explained"


def test_uw_lacks_nothing() -> None:
    """Its published model explains it; at most its parameters move."""
    found = diagnosed("uw_double", "free_swing.csv", "friction.coulomb", "drag.quadratic")
    assert found.verdict in ("consistent", "recalibrated")
    assert not found.missing
