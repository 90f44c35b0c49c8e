"""Public recordings of four real rigs, made ready for `dipc-gym diagnose`.

The authors' own files stay where they are published: download what you want to look at, and this script writes each
run as a recording (CSV, SI units, columns named as in the model) and, beside it, the simulator's model of the rig as
its authors publish it, without the physics that is worth looking for. Nothing is downloaded, nothing unpickled.

emps: a carriage on a ball screw, current-controlled motor. `examples/EMPS/data/DATA_EMPS.mat` and
`DATA_EMPS_PULSES.mat` of github.com/forgi86/sysid-neural-continuous (Apache-2.0); A. Janot, M. Gautier, M. Brunot,
"Data set and reference models of EMPS", 2019. Read: t (s), vir (V), qm (m), gtau (N/V), pulses_N (N) if there.
The model knows mass and drive gain; friction of any kind is left out.

dfki: a double pendulum with a motor in each joint. `trajectory.csv` of the folders of
`data/experiment_records/design_C.1/20230629/sysid` in github.com/dfki-ric-underactuated-lab/double_pendulum
(BSD-3-Clause). Read: time (s), tau_con1, tau_con2 (N m, as commanded), pos_meas1, pos_meas2 (rad). The model has the
numbers of its `design_C.1/model_1.0/model_parameters.yml`; the joints' friction is left out.

bam: a hobby servo (Dynamixel XL330) that swings a mass. `bam/data.bak/raw/*.json` of github.com/Rhoban/bam
(Apache-2.0). Read: mass (kg), length (m), motor, trajectory, kp, and in each of the entries timestamp (s),
position (rad), load (PWM, 885 is full), input_volts (V), torque_enable. A run ends where the torque is switched off:
an open motor is none at 0 V, which brakes. The model has motor and constant and viscous friction of BAM's `m6` fit for
this servo (params/xl330/m6.json at commit 62bd8ce); the friction that this fit lets grow with load is left out.

uw: a double pendulum that swings freely, cart clamped. `Datas/DoublePendulum/DoubleDataFreeSwing_1_Dt_0_001.mat` (to 4)
of github.com/dynamicslab/MultiArm-Pendulum (MIT); K. Kaheman et al., "The experimental multi-arm pendulum on a cart",
2022. Read: Time (s), Theta1, Theta2 (rad, absolute, zero pointing up). The runs may begin in somebody's
hand: look first, and cut with --begin. The model has the published numbers, joint damping among them.

    python examples/real_recordings.py emps DATA_EMPS.mat --out emps
    dipc-gym diagnose emps/nominal.xml emps/DATA_EMPS.csv --out emps/diagnosis
"""

import csv
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro

from dipc_gym import recording
from dipc_gym.recording import Recording

EMPS = """\
<!-- EMPS, a carriage on a ball screw: mass and drive gain (N/V) alone. Friction is what a diagnosis should find. -->
<mujoco model="emps">
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <body name="carriage">
      <joint name="carriage" type="slide" axis="1 0 0"/>
      <inertial pos="0 0 0" mass="95.1089" diaginertia="1 1 1"/>
    </body>
  </worldbody>
  <actuator><motor name="drive" joint="carriage" gear="{gain:.7g}"/></actuator>
  <sensor><jointpos name="carriage" joint="carriage"/></sensor>
</mujoco>
"""

DFKI = """\
<!-- DFKI double pendulum, design C.1, model 1.0. Angles are zero hanging down, the second one relative to the first.
     Inertias about the joints are published (0.0318872 and 0.0508698 kg m^2); those here are about the centres of mass.
     armature: rotor inertia 6.2872e-5 kg m^2 times the gear ratio 6 squared. Joint friction is left out. -->
<mujoco model="dfki_double_pendulum">
  <compiler angle="radian"/>
  <option timestep="0.001" integrator="implicitfast" gravity="0 0 -9.81"/>
  <default><joint type="hinge" axis="0 -1 0" armature="0.00226339"/></default>
  <worldbody>
    <body name="upper">
      <joint name="shoulder"/>
      <inertial pos="0 0 -0.2" mass="0.52346" diaginertia="0.0109488 0.0109488 1e-5"/>
      <body name="lower" pos="0 0 -0.2">
        <joint name="elbow"/>
        <inertial pos="0 0 -0.255693" mass="0.625568" diaginertia="0.0099708 0.0099708 1e-5"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="shoulder" joint="shoulder"/><motor name="elbow" joint="elbow"/></actuator>
  <sensor><jointpos name="q1" joint="shoulder"/><jointpos name="q2" joint="elbow"/></sensor>
</mujoco>
"""

BAM = """\
<!-- XL330 servo with a mass on an arm, zero hanging down. Motor, constant and viscous friction of BAM's m6 fit; the
     part of that friction that grows with load is left out. Command: volts at the motor. -->
<mujoco model="bam_xl330">
  <compiler angle="radian"/>
  <option timestep="0.001" integrator="implicitfast" gravity="0 0 -9.81"/>
  <worldbody>
    <body name="arm">
      <joint name="joint" axis="0 -1 0" armature="0.00180774" damping="0.00535967" frictionloss="0.00477118"/>
      <inertial pos="0 0 -{length:.6g}" mass="{mass:.6g}" diaginertia="1e-5 1e-5 1e-5"/>
    </body>
  </worldbody>
  <actuator><dcmotor name="servo" joint="joint" motorconst="0.366013" resistance="2.81139"/></actuator>
  <sensor><jointpos name="joint" joint="joint"/></sensor>
</mujoco>
"""

UW = """\
<!-- Double pendulum of the University of Washington, cart clamped, no actuator. Angles are absolute, zero pointing up.
     Published numbers, damping of both joints among them. -->
<mujoco model="uw_double_pendulum">
  <compiler angle="radian"/>
  <option timestep="0.001" integrator="implicitfast" gravity="0 0 -9.80858"/>
  <default><joint type="hinge" axis="0 1 0"/></default>
  <worldbody>
    <body name="first">
      <joint name="first" damping="2.37143e-4"/>
      <inertial pos="0 0 0.108565" mass="0.093844" diaginertia="4.37529e-4 4.37529e-4 1e-7"/>
      <body name="second" pos="0 0 0.172719">
        <joint name="second" damping="1e-5"/>
        <inertial pos="0 0 0.116779" mass="0.137596" diaginertia="1.26883e-3 1.26883e-3 1e-7"/>
      </body>
    </body>
  </worldbody>
  <tendon><fixed name="absolute"><joint joint="first" coef="1"/><joint joint="second" coef="1"/></fixed></tendon>
  <sensor><jointpos name="theta1" joint="first"/><tendonpos name="theta2" tendon="absolute"/></sensor>
</mujoco>
"""

FULL_PWM = 885  # counts at which an XL330 puts its whole supply on the motor


class OtherLayout(Exception):
    """A file that is not laid out as this script knows it."""


def run(name: str, time: Any, commands: dict[str, Any], sensors: dict[str, Any]) -> Recording:
    """A recording that starts at time zero."""
    time = np.asarray(time, dtype=float).ravel()

    def table(columns: dict[str, Any]) -> np.ndarray:
        return np.array([np.ravel(column) for column in columns.values()], dtype=float).reshape(-1, len(time)).T

    return Recording(name, time - time[0], table(commands), table(sensors), tuple(commands), tuple(sensors))


def matlab(file: Path, fields: Sequence[str]) -> dict[str, np.ndarray]:
    """The variables of a MATLAB file of version 5 to 7.2, plain arrays only."""
    from scipy.io import loadmat

    try:
        found = loadmat(file)
    except NotImplementedError:  # what scipy says of version 7.3, which is HDF5
        raise OtherLayout(f"{file}: a MATLAB file of version 7.3; save it again in MATLAB with -v7") from None
    except ValueError as error:
        raise OtherLayout(f"{file}: not a MATLAB file ({error})") from None
    missing = [name for name in fields if name not in found]
    if missing:
        there = ", ".join(name for name in found if not name.startswith("__"))
        raise OtherLayout(f"{file}: no variable {', '.join(missing)}; it holds {there}")
    return found


def emps(files: Sequence[Path]) -> tuple[str, list[Recording]]:
    gains, runs = [], []
    for file in files:
        data = matlab(file, ("t", "vir", "qm", "gtau"))
        gain, volts = float(data["gtau"].item()), data["vir"].astype(float)
        if "pulses_N" in data:  # a force that the drive adds to what its controller asks for
            volts = volts + data["pulses_N"] / gain
        gains.append(gain)
        runs.append(run(file.stem, data["t"], {"drive": volts}, {"carriage": data["qm"]}))
    return EMPS.format(gain=same("gtau", gains)), runs


def dfki(files: Sequence[Path]) -> tuple[str, list[Recording]]:
    fields, runs = ("time", "tau_con1", "tau_con2", "pos_meas1", "pos_meas2"), []
    for file in files:
        with file.open(newline="") as stream:
            rows = list(csv.DictReader(stream))
        missing = [name for name in fields if not rows or name not in rows[0]]
        if missing:
            raise OtherLayout(f"{file}: no column {', '.join(missing)}")
        time, tau1, tau2, q1, q2 = (np.array([float(row[name]) for row in rows]) for name in fields)
        # All files are called trajectory.csv; the folder says which run it is.
        name = file.parent.name if file.stem == "trajectory" and file.parent.name else file.stem
        runs.append(run(name, time, {"shoulder": tau1, "elbow": tau2}, {"q1": q1, "q2": q2}))
    return DFKI, runs


def bam(files: Sequence[Path]) -> tuple[str, list[Recording]]:
    masses, lengths, runs = [], [], []
    for file in files:
        log = json.loads(file.read_text())
        try:
            if log["motor"] != "xl330":
                raise OtherLayout(f"{file}: motor {log['motor']!r}; the model here is that of an xl330")
            entries = log["entries"]
            driven = next((i for i, entry in enumerate(entries) if not entry["torque_enable"]), len(entries))
            entries = entries[:driven]
            time, position = ([entry[key] for entry in entries] for key in ("timestamp", "position"))
            volts = [entry["load"] / FULL_PWM * entry["input_volts"] for entry in entries]
            masses.append(float(log["mass"]))
            lengths.append(float(log["length"]))
            name = f"{log['trajectory']}_kp{log['kp']}_{file.stem}"
        except (KeyError, TypeError) as error:
            raise OtherLayout(f"{file}: not a raw log of BAM, {error} is not as expected") from None
        if not entries:
            raise OtherLayout(f"{file}: the torque is off from its first entry on")
        runs.append(run(name, time, {"servo": volts}, {"joint": position}))
    return BAM.format(mass=same("mass", masses), length=same("length", lengths)), runs


def uw(files: Sequence[Path]) -> tuple[str, list[Recording]]:
    runs = []
    for file in files:
        data = matlab(file, ("Time", "Theta1", "Theta2"))
        runs.append(run(file.stem, data["Time"], {}, {"theta1": data["Theta1"], "theta2": data["Theta2"]}))
    return UW, runs


SOURCES: dict[str, Callable[[Sequence[Path]], tuple[str, list[Recording]]]] = {
    "emps": emps,
    "dfki": dfki,
    "bam": bam,
    "uw": uw,
}


def same(what: str, values: Sequence[float]) -> float:
    """The value that all files have."""
    if len(set(values)) > 1:
        raise OtherLayout(f"{what} differs between the files ({', '.join(map(str, values))}): one rig at a time")
    return values[0]


def part(whole: Recording, begin: float, end: float) -> Recording:
    """What was recorded between two times, from zero again."""
    kept = (whole.time >= begin) & (whole.time < end)
    if not kept.any():
        raise OtherLayout(f"{whole.name}: nothing between {begin:g} and {end:g} s; it lasts {whole.duration:.4g} s")
    time = whole.time[kept]
    return replace(whole, time=time - time[0], commands=whole.commands[kept], sensors=whole.sensors[kept])


@dataclass
class Arguments:
    source: Annotated[Literal["list", "emps", "dfki", "bam", "uw"], tyro.conf.Positional] = "list"
    """whose files these are; `list` says where to find them"""
    files: Annotated[tuple[Path, ...], tyro.conf.Positional] = ()
    """the files as downloaded, one run each"""
    out: Path = Path("recordings")
    """folder for the recordings and nominal.xml"""
    begin: float = 0.0
    """s; what comes before is cut off"""
    end: float = math.inf
    """s; what comes after is cut off"""
    overwrite: bool = False
    """replace recordings that are there already"""


def main(arguments: Arguments) -> None:
    if arguments.source == "list":
        print(__doc__)
        return
    if not arguments.files:
        raise OtherLayout(f"{arguments.source}: name the downloaded files too; without arguments, this lists them")
    model, runs = SOURCES[arguments.source](arguments.files)
    runs = [part(each, arguments.begin, arguments.end) for each in runs]
    arguments.out.mkdir(parents=True, exist_ok=True)
    nominal = arguments.out / "nominal.xml"
    if nominal.exists() and nominal.read_text() != model and not arguments.overwrite:
        raise OtherLayout(f"{nominal} is there and another; say --overwrite to replace it, or name another --out")
    nominal.write_text(model)
    files = []
    for each in runs:
        file = arguments.out / f"{each.name}.csv"
        files.append(recording.write(each, file, overwrite=arguments.overwrite))
        print(f"{file}: {each.duration:.4g} s, {len(each.time)} samples")
    print(f"\ndipc-gym diagnose {nominal} {' '.join(map(str, files))} --out {arguments.out / 'diagnosis'}")


if __name__ == "__main__":
    try:
        main(tyro.cli(Arguments, description=__doc__))
    except (OtherLayout, OSError, recording.RecordingError) as error:
        raise SystemExit(f"error: {error}") from None
