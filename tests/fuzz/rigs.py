"""Recordings, models and plants, and compiled code: what `replay`, `diagnose`, `train` and the environment read."""

from __future__ import annotations

import atexit
import functools
import io
import json
import os
import shutil
import tempfile
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Any
from unittest import mock

import gymnasium
import numpy as np
from mutate import archive, markup, octets, tree
from PIL import Image
from target import Target, as_json, finite

from dipc_gym import ENV_ID, compensators, mjcf, physics, recording, runs
from dipc_gym.identification.run import Sweep, cart, cart_model
from dipc_gym.mjcf import MjcfError
from dipc_gym.mjcf.edit import Document
from dipc_gym.plant import Plant, PlantError
from dipc_gym.recording.tables import RecordingError, write_table
from dipc_gym.sim2real.estimation.states import Undetermined
from dipc_gym.sim2real.model.parameters import fixed_masses, model_parameters
from dipc_gym.training import inverse

MODEL = """<mujoco model="axis"><option timestep="0.002"/><worldbody><body><joint name="axis" damping="0.1"/>
<geom type="capsule" size="0.02 0.2" mass="0.5" contype="0" conaffinity="0"/></body></worldbody>
<actuator><motor name="motor" joint="axis" ctrlrange="-5 5"/></actuator>
<sensor><jointpos name="axis" joint="axis"/></sensor></mujoco>"""
CUSTOM = """<custom><numeric name="dipc_gym:motor.deadzone:motor" data="0.4"/>
<numeric name="dipc_gym:timing.sensor_lag:pole1" data="0.002"/>
<numeric name="dipc_gym:sensor.gain:pole2" data="1.01"/>
{friction}
<numeric name="dipc_gym:disturbance.periodic:pole2" data="0.01 2 0.1"/>
<numeric name="dipc_gym:motor.map:motor" data="-24 24 -23 23"/>
<text name="dipc_gym:input:1:residual.force:cart" data="velocity cart"/>
<text name="dipc_gym:input:2:residual.force:cart" data="position pole1"/>
<numeric name="dipc_gym:residual.force:cart" data="1 2 2 -1 1 -1 1 0.1 0.2 0.3 0.4"/></custom></mujoco>"""
# Of dry friction a joint has one law.
FRICTION = (
    """<numeric name="dipc_gym:friction.wave:cart" data="2 0.5 0.5 0.3"/>
<numeric name="dipc_gym:friction.load:pole1" data="0.001 0.01 0.01"/>
<numeric name="dipc_gym:friction.load_stribeck:pole2" data="0.001 0.01 0.01 0.5 0.05"/>""",
    """<numeric name="dipc_gym:friction.position:cart" data="-0.4 0.4 1 2 3"/>
<numeric name="dipc_gym:friction.load_by_speed:pole1" data="0.1 0.01 0.01 0.5 0.05 0.4 0.1 0"/>""",
)
ASSETS = """<mujoco><compiler meshdir="parts" texturedir="parts"/><asset><mesh name="obj" file="bob.obj"/>
<mesh name="stl" file="bob.stl"/><hfield name="floor" file="floor.png" size="1 1 0.1 0.1"/>
<texture name="skin" type="2d" file="skin.png"/><material name="skin" texture="skin"/>
<model name="sub" file="sub.xml"/></asset>
<worldbody><geom type="hfield" hfield="floor" contype="0" conaffinity="0"/><attach model="sub" body="arm" prefix="p"/>
<body><joint name="axis" damping="0.1"/><geom type="mesh" mesh="obj" contype="0" conaffinity="0"/>
<geom type="mesh" mesh="stl" material="skin" contype="0" conaffinity="0"/></body></worldbody>
<sensor><jointpos name="axis" joint="axis"/></sensor></mujoco>"""
ARM = """<mujoco model="sub"><worldbody><body name="arm"><joint name="j"/><geom size="0.1" contype="0" conaffinity="0"/>
</body></worldbody></mujoco>"""
CORNERS = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]])
FACES = ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))
PLANT = Plant().to_dict() | {"schema": "dipc-gym/plant/1", "masses": {"cart": {"uniform": [1.0, 2.0]}}}
PLANT["friction"]["coulomb"] = {"normal": [8.0, 0.5]}


# --- recordings -----------------------------------------------------------------------------------------------------


def _recording(suffix: str) -> Callable[[Path], Any]:
    def read(folder: Path) -> None:
        found = recording.read(
            folder / f"run{suffix}", _axis(), mapping={"angle": "axis"}, units={"axis": "deg", "time": "ms"}
        )
        finite(found.time, found.commands, found.sensors, found.period)

    return read


@functools.cache
def _axis() -> Any:
    return mjcf.compile(MODEL)


@functools.cache
def _table(suffix: str) -> bytes:
    """As a robot logs it: its own names, degrees and milliseconds."""
    t = 0.01 * np.arange(60)
    return _written(suffix, {"time": 1000 * t, "motor": np.sin(9 * t).round(4), "angle": 57 * np.cos(7 * t).round(5)})


def _written(suffix: str, columns: dict[str, Any]) -> bytes:
    with tempfile.TemporaryDirectory() as place:
        path = Path(place) / f"run{suffix}"
        write_table(path, columns)
        return path.read_bytes()


@functools.cache
def _locked() -> bytes:
    run = runs.identify(sweep=Sweep(duration=8.0)).run
    return _written(".csv", {"time": run.time, "motor": run.commands[:, 0].round(6), "cart": 1000 * run.sensors[:, 0]})


def _trained_on(folder: Path) -> None:
    """What `train --recording` does."""
    found = runs.identify(from_recording=str(folder / "run.csv"), units={"cart": "mm"})
    found.excitation.report()
    for name in ("feedforward", "llnf"):
        made = found.fit(name)
        finite(made.voltage(1.0, 0.01))


def _drawn(folder: Path) -> None:
    """What `render --recording` draws."""
    course = runs.recorded(str(folder / "run.npz"))
    finite(course.time, course.state, course.voltage)


@functools.cache
def _balanced() -> bytes:
    t = 0.005 * np.arange(80)
    return _written(
        ".npz", {"time": t, "motor": 0 * t, **{name: 0.01 * np.sin(t) for name in ("cart", "pole1", "pole2")}}
    )


# --- models and plants ------------------------------------------------------------------------------------------------


def _rig(friction: str = FRICTION[0]) -> dict[str, bytes]:
    text = resources.files("dipc_gym").joinpath("rig.xml").read_text()
    text = text.replace("</mujoco>", '<include file="part.xml"/>' + CUSTOM.format(friction=friction))
    part = '<mujocoinclude><statistic extent="2"/><visual><global azimuth="90"/></visual></mujocoinclude>'
    return {"rig.xml": text.encode(), "part.xml": part.encode()}


def _model(folder: Path) -> None:
    source = mjcf.read(folder / "rig.xml")
    given = physics.load(source)
    mjcf.check_supported(given.model, source.name)
    parameters = model_parameters(document := Document(source), given.model)
    fixed_masses(document, given.model, parameters)
    env = gymnasium.make(ENV_ID, model=folder / "rig.xml")
    _drive(env)
    inner: Any = env.unwrapped
    cart(cart_model(inner.source, inner.plant))


def _drive(env: Any) -> None:
    observation, info = env.reset(seed=1)
    finite(observation, env.action_space.high, [v for v in info.values()])
    for volts in (1.0, -1.0):
        observation, reward, *_, info = env.step(np.array([volts]))
        finite(observation, reward, [v for v in info.values()])


def _plant(folder: Path) -> None:
    _drive(gymnasium.make(ENV_ID, plant=folder / "plant.json"))


def _compensated(folder: Path) -> None:
    """What `compensator` makes of a model, at few speeds and in a short run."""
    short = functools.partial(runs.identify, sweep=Sweep(duration=8.0))
    few = {"SPEEDS": np.array([0.05, 0.5]), "PLACES": np.zeros(1), "VOLTAGES": 9, "identify": short}
    with mock.patch.multiple(inverse, **few):
        made, law = inverse.compensator(folder / "rig.xml")
    finite(law.friction, law.force, made.voltage(1.0, 0.01))
    law.notes()
    compensators.save(made, folder / "made.json")
    compensators.load(folder / "made.json")


@functools.cache
def _parts() -> dict[str, bytes]:
    lines = [f"v {x} {y} {z}" for x, y, z in CORNERS] + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in FACES]
    triangle = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("spare", "<u2")])
    solid = np.zeros(len(FACES), triangle)
    solid["corners"] = CORNERS[np.array(FACES)]
    picture = io.BytesIO()
    Image.new("L", (8, 8), 100).save(picture, "PNG")
    stl = bytes(80) + np.uint32(len(FACES)).tobytes() + solid.tobytes()
    pictures = {"floor.png": picture.getvalue(), "skin.png": picture.getvalue()}
    files = {"bob.obj": "\n".join(lines).encode(), "bob.stl": stl, **pictures}
    return {"rig.xml": ASSETS.encode(), "sub.xml": ARM.encode()} | {f"parts/{k}": v for k, v in files.items()}


def _assembled(folder: Path) -> None:
    model = mjcf.compile(folder / "rig.xml")
    mjcf.check_supported(model, "rig.xml")


# --- a model with a recording ---------------------------------------------------------------------------------------


@functools.cache
def code_folder() -> str:
    """The folder for compiled code of this process: not the user's own, which damaged models would fill."""
    place = tempfile.mkdtemp(prefix="fuzz-code-")
    atexit.register(shutil.rmtree, place, ignore_errors=True)
    return place


def _replayed(folder: Path) -> None:
    """What `replay` does, and `diagnose` before it searches."""
    from dipc_gym.sim2real.replay import replay

    with mock.patch.dict(os.environ, {"XDG_CACHE_HOME": code_folder()}):
        done = replay(folder / "rig.xml", folder / "run.csv", units={"axis": "rad"}, threads=1)
        done.table()
        json.dumps(done.to_dict(), allow_nan=False)


def _diagnosed(folder: Path) -> None:
    """What `diagnose` does, with one effect to ask for, and whether what it writes can be read."""
    from dipc_gym.sim2real.diagnosis import diagnose
    from dipc_gym.sim2real.effects import catalogue
    from dipc_gym.sim2real.report import folder as folder_of

    with mock.patch.dict(os.environ, {"XDG_CACHE_HOME": code_folder()}):
        source = mjcf.read(folder / "rig.xml")
        runs_of_it = recording.read_all([folder / "run.csv"], mjcf.compile(source))
        found = diagnose(source, runs_of_it, effects=[catalogue()["friction.coulomb"]], threads=1)
        folder_of.save(found, folder / "found", model="rig.xml", command="dipc-gym diagnose")
        physics.load(folder / "found" / "improved.xml")


@functools.cache
def _swing() -> bytes:
    t = 0.01 * np.arange(100)
    return _written(".csv", {"time": t, "motor": np.sin(9 * t).round(4), "axis": np.cos(7 * t).round(5)})


@functools.cache
def stuck() -> bytes:
    """Eight seconds of that axis with dry friction, which the model lacks."""
    import mujoco

    model = mjcf.compile(MODEL.replace('damping="0.1"', 'damping="0.1" frictionloss="0.05"'))
    data, rng, sent, read = mujoco.MjData(model), np.random.default_rng(0), [], []
    for k in range(400):
        t = 0.02 * k
        data.ctrl[0] = round(0.5 * np.sin(5 * t + 0.4 * t**2), 4)
        sent.append(data.ctrl[0])
        read.append(round(data.qpos[0] + 1e-4 * rng.standard_normal(), 6))
        mujoco.mj_step(model, data, 10)
    return _written(".csv", {"time": 0.02 * np.arange(400), "motor": np.array(sent), "axis": np.array(read)})


SUM = "define i32 @sum(i32 %a, i32 %b) {\n  %c = add i32 %a, %b\n  ret i32 %c\n}\n"


@functools.cache
def _compiled() -> dict[str, bytes]:
    from dipc_gym.engine import machine

    with tempfile.TemporaryDirectory() as place, mock.patch.dict(os.environ, {"XDG_CACHE_HOME": place}):
        machine.load([SUM], ["sum"])
        return {f.relative_to(place).as_posix(): f.read_bytes() for f in Path(place).rglob("*") if f.is_file()}


def _called(folder: Path) -> None:
    import ctypes

    from dipc_gym.engine import machine

    for place in (folder, *folder.rglob("*")):
        place.chmod(0o700)
    machine._object.cache_clear()
    with mock.patch.dict(os.environ, {"XDG_CACHE_HOME": str(folder)}):
        library = machine.load([SUM], ["sum"])
    call = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_int32, ctypes.c_int32)
    if call(library.addresses["sum"])(3, 4) != 7:
        raise AssertionError("other code than what was compiled was run")


TARGETS: dict[str, Callable[[], Target]] = {
    "recording.csv": lambda: Target(
        {"run.csv": _table(".csv")}, {"run.csv": (octets,)}, _recording(".csv"), (RecordingError,)
    ),
    "recording.parquet": lambda: Target(
        {"run.parquet": _table(".parquet")}, {"run.parquet": (octets,)}, _recording(".parquet"), (RecordingError,)
    ),
    "recording.npz": lambda: Target(
        {"run.npz": _table(".npz")}, {"run.npz": (archive,)}, _recording(".npz"), (RecordingError,)
    ),
    "recording to train": lambda: Target({"run.csv": _locked()}, {"run.csv": (octets,)}, _trained_on, (ValueError,)),
    "recording to draw": lambda: Target({"run.npz": _balanced()}, {"run.npz": (archive,)}, _drawn, (RecordingError,)),
    "model": lambda: Target(
        _rig(), {"rig.xml": (markup, markup, octets), "part.xml": (markup, octets)}, _model, (MjcfError, PlantError)
    ),
    "model's parts": lambda: Target(
        _parts(),
        {name: (markup, octets) if name.endswith(".xml") else (octets,) for name in _parts()},
        _assembled,
        (MjcfError,),
    ),
    "model to replay": lambda: Target(
        {"rig.xml": MODEL.encode(), "run.csv": _swing()},
        {"rig.xml": (markup, markup, octets), "run.csv": (octets,)},
        _replayed,
        (MjcfError, RecordingError, Undetermined),
    ),
    "model to diagnose": lambda: Target(
        {"rig.xml": MODEL.encode(), "run.csv": stuck()},
        {"rig.xml": (markup, markup, octets), "run.csv": (octets,)},
        _diagnosed,
        (MjcfError, RecordingError, Undetermined, ValueError),
    ),
    "model to compensate": lambda: Target(
        _rig(FRICTION[1]), {"rig.xml": (markup, markup, octets)}, _compensated, (MjcfError, PlantError, ValueError)
    ),
    "compiled code": lambda: Target(_compiled(), dict.fromkeys(_compiled(), (octets,)), _called, ()),
    "plant": lambda: Target(
        {"plant.json": as_json(PLANT)}, {"plant.json": (tree, tree, octets)}, _plant, (PlantError, MjcfError)
    ),
}
