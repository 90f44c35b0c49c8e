"""Laws that a diagnosis found, as tables and as C: the same numbers as in Python, on many inputs."""

from __future__ import annotations

import csv
import ctypes
import json
import math
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dipc_gym import cli, mjcf, physics
from dipc_gym.export import law as laws
from dipc_gym.export.c import named, plain
from dipc_gym.export.law import Input, Law, LawError
from dipc_gym.mjcf.edit import Document
from dipc_gym.physics import formulas
from dipc_gym.sim2real import result
from dipc_gym.sim2real.effects import catalogue
from dipc_gym.sim2real.effects.friction_hysteresis import Hysteresis
from dipc_gym.sim2real.effects.friction_hysteresis_law import HysteresisOfAnyLaw
from dipc_gym.sim2real.effects.friction_load_law import UnderLoadOfAnyLaw
from dipc_gym.sim2real.effects.friction_position_law import FrictionOfPosition
from dipc_gym.sim2real.effects.friction_resting_law import RestingOfAnyLaw
from dipc_gym.sim2real.effects.friction_speed import FrictionOfSpeed
from dipc_gym.sim2real.effects.friction_time import FrictionOfTime
from dipc_gym.sim2real.effects.load_creeping_law import CreepingSpringOfAnyLaw
from dipc_gym.sim2real.effects.load_position_law import ForceOfPosition
from dipc_gym.sim2real.effects.load_swinging_law import SwingingLoadOfAnyLaw
from dipc_gym.sim2real.effects.motor_map import CommandMap
from dipc_gym.sim2real.effects.motor_sag_law import SagOfAnyLaw
from dipc_gym.sim2real.effects.sensor_map import ScaleMap
from dipc_gym.sim2real.effects.shared import law as shapes
from dipc_gym.sim2real.effects.shared.surfaces import Surface
from dipc_gym.sim2real.effects.unknown_force import UnknownForce
from dipc_gym.sim2real.effects.unknown_product import UnknownProduct
from dipc_gym.sim2real.effects.unknown_recent import UnknownRecent

GCC = shutil.which("gcc") or shutil.which("cc")
STRICT = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic")
COUNT = 100_000
needs_c = pytest.mark.skipif(GCC is None, reason="no C compiler")


def surface() -> UnknownForce:
    levels = np.array([[0.3, -0.2], [0.1, 0.4], [-0.3, -0.1]])
    knots = np.array([-1.0, 0.1, 2.0]), np.array([-3.0, 3.5])
    shape = Surface(("position cart", "velocity pole1"), knots, levels)
    return UnknownForce(shape, 1.5, ("m", "rad/s"), "cart")


FOUND = {
    "friction.position@cart": FrictionOfPosition([-0.2, -0.05, 0.0, 0.3], [2.0, 1.5, 6.0, 2.5]),
    "friction.hysteresis@cart": Hysteresis([0.001, 0.004], [2.0, 1.0]),
    "friction.hysteresis@pole1": HysteresisOfAnyLaw({"bound": 2.0, "fall_1": 1e2, "fall_2": 4e2}),
    "friction.load@cart": UnderLoadOfAnyLaw(
        {"level": 1.0, "by_drive": 0.1, "by_weight": 0.0, "fastest": 0.5, "more_1": 0.1, "more_2": 0.4}
    ),
    "friction.resting@cart": RestingOfAnyLaw(
        {"level": 2.0, "longest": 0.8, "slow": 1e-3, "more_1": 0.5, "more_2": 0.3}
    ),
    "friction.speed@cart": FrictionOfSpeed([0.0, 0.02, 0.4], [3.0, 2.0, 2.6]),
    "friction.time@cart": FrictionOfTime([0.0, 8.0, 40.0], [4.5, 2.5, 2.0]),
    "load.creeping@cart": CreepingSpringOfAnyLaw(0.05, {"stiffness": 40.0, "faster_1": 0.02, "faster_2": 0.08}),
    "load.swinging@cart": SwingingLoadOfAnyLaw(
        (0.0, 0.02, 0.05), {"mass": 0.1, "small_swing_frequency": 2.0, "damping_ratio": 0.1, "slope_2": 0.4}
    ),
    "motor.sag@motor": SagOfAnyLaw(
        {"time_constant": 1.0, "more_1": 0.02, "more_2": 0.1, "current": 4.0, "gain": 2.0, "back": 0.0}
    ),
    "load.position@cart": ForceOfPosition([-0.2, 0.2], [1.0, -1.0]),
    "motor.map@motor": CommandMap([-10.0, 0.0, 10.0], [-7.0, 0.5, 9.0]),
    "sensor.map@cart": ScaleMap([-0.2, 0.0, 0.1, 0.3], [-0.21, 0.02, 0.1, 0.26]),
    "unknown@cart": surface(),
    "unknown@pole2": UnknownRecent([0.0, 0.4], [-1.0, -0.2], ("velocity pole2",) * 2, 3.0, 3.0, ("rad/s",) * 2, 0.5),
    "unknown@pole1": UnknownProduct(
        [-0.2, 0.0, 0.3], [1.0, -0.5, 0.2], ("position cart", "command motor"), 24.0, 3.0, ("m", "")
    ),
}


def test_what_a_diagnosis_writes_now_is_read() -> None:
    assert laws.SCHEMAS[-1] == result.SCHEMA


def test_every_law_of_free_shape_is_tried() -> None:
    assert {type(effect) for effect in FOUND.values()} == {type(one) for one in catalogue().values() if one.free}


@given(st.text())
def test_words_cannot_end_a_comment(words: str) -> None:
    """Whatever a stranger's diagnosis says in them."""
    said = named(plain(f"*\\{words}\\* @_{words}"), "law")
    assert not any(end in said for end in ("*/", "/*", "//*", "\n", "\\", "??"))
    assert "law_" not in said or "law_" in words


@pytest.mark.parametrize("word", ["static", "float", "main"])
def test_a_word_of_c_names_no_function(word: str) -> None:
    with pytest.raises(ValueError, match="is a word of C"):
        Law("a@b", "force", "N", (Input("x", "m", np.array([0.0, 1.0])),), np.array([0.0, 1.0])).c(word)


def test_the_law_of_a_swinging_load_pulls_both_ways_as_its_springs_do() -> None:
    """Against the springs of the model that it is written into, also beyond its data."""
    text = """<mujoco><option gravity="0 0 0"/><worldbody><body name="cart"><joint name="cart" type="slide"/>
        <geom size=".1" mass="1"/></body></worldbody></mujoco>"""
    effect = SwingingLoadOfAnyLaw([0.0, 0.02, 0.05], {})
    values = {"mass": 0.3, "small_swing_frequency": 2.0, "damping_ratio": 0.0}
    values |= {p.name: 2.0 for p in effect.parameters[3:]}
    said = effect.law_of(values, {"mass": "kg", "small_swing_frequency": "Hz", "damping_ratio": ""})
    law = laws._law("load.swinging:law@cart", json.loads(json.dumps(said)))
    document = Document(mjcf.from_text(text))
    effect.edit(document, "cart", values)
    model = mjcf.compile(document.text())
    data = mujoco.MjData(model)
    for stretch in (*law.inputs[0].knots[::5].tolist(), 0.2):
        data.qpos[model.joint("cart_load").qposadr[0]] = stretch
        mujoco.mj_forward(model, data)
        pull = -data.qfrc_passive[model.joint("cart_load").dofadr[0]]
        assert float(law(stretch)) == pytest.approx(pull, rel=1e-6, abs=1e-9)
    assert "moved ahead of the joint" in law.c("load")
    assert law.inputs[0].told == (-0.05, 0.05)


def test_friction_with_memory_builds_up_as_its_elements_slip() -> None:
    """Two springs, of 2 N that slips at 1 mm and 1 N that slips at 4 mm."""
    found = FOUND["friction.hysteresis@cart"]
    law = found.law_of(found.guess, {p.name: "N" for p in found.parameters})
    (along,) = law["table"]["inputs"]
    assert along["knots"] == [-0.004, -0.001, 0.0, 0.001, 0.004]
    assert law["table"]["levels"] == pytest.approx([-3.0, -2.25, 0.0, 2.25, 3.0])


def diagnosis(folder: Path, *keys: str) -> Path:
    """What `diagnose` writes of these laws."""
    missing = []
    for key in keys:
        effect = FOUND[key]
        values = effect.guess if isinstance(effect, shapes.Law) else effect.first
        law = effect.law_of(values, {p.name: "V" if "motor" in key else "N" for p in effect.parameters})
        name, _, at = key.partition("@")
        missing.append({"effect": name, "at": at, "law": law})
    (folder / "diagnosis.json").write_text(
        json.dumps({"schema": laws.SCHEMAS[-1], "missing": missing}, allow_nan=False)
    )
    return folder / "diagnosis.json"


def compiled(text: str, count: int, folder: Path, *, single: bool = False) -> Any:
    """The header's function on arrays."""
    (folder / "law.h").write_text(text)
    letters = [f"a{k}" for k in range(count)]
    all_of = f"void all(int n, {', '.join(f'const double *{x}' for x in letters)}, double *out)"
    one = f"law({', '.join(f'(law_real){x}[i]' for x in letters)})"
    loop = f"{{ int i; for (i = 0; i < n; i++) out[i] = (double){one}; }}"
    (folder / "law.c").write_text(f'#include "law.h"\n{all_of};\n{all_of}\n{loop}\n')
    library = folder / "law.so"
    flags = ["-DLAW_FLOAT"] if single else []
    subprocess.run(
        [GCC, *STRICT, *flags, "-O2", "-shared", "-fPIC", "law.c", "-o", str(library)], cwd=folder, check=True
    )
    function = ctypes.CDLL(str(library)).all

    def call(*inputs: np.ndarray) -> np.ndarray:
        given = [np.ascontiguousarray(one, dtype=float) for one in inputs]
        out = np.empty(len(given[0]))
        function(len(out), *(ctypes.c_void_p(one.ctypes.data) for one in (*given, out)))
        return out

    return call


@needs_c
@pytest.mark.parametrize("single", [False, True])
@pytest.mark.parametrize("key", FOUND)
def test_c_gives_what_python_gives_on_a_hundred_thousand_inputs(key: str, single: bool, tmp_path: Path) -> None:
    law = laws.read(diagnosis(tmp_path, *FOUND), key)
    rng = np.random.default_rng(0)
    inputs = []
    for one in law.inputs:
        reach = one.knots[-1] - one.knots[0]
        x = rng.uniform(one.knots[0] - reach, one.knots[-1] + reach, COUNT)
        x[: len(one.knots)] = one.knots
        x[-4:] = np.inf, -np.inf, np.nan, 1e30
        inputs.append(x)
    speed = rng.uniform(-5, 5, COUNT) if law.driven_up_to is not None else None
    more = [] if speed is None else [speed]
    function = compiled(law.c("law"), len(inputs) + len(more), tmp_path, single=single)
    with np.errstate(invalid="ignore"):
        expected = law(*inputs, speed=speed)
    found = function(*inputs, *more)
    fine = np.isfinite(expected)
    size = np.abs(expected[fine][:-1]).max()
    np.testing.assert_allclose(
        found[fine], expected[fine], rtol=1e-5 if single else 1e-13, atol=size * (1e-4 if single else 1e-13)
    )
    assert np.isnan(found[-2])
    assert np.isnan(expected[-2])


@pytest.mark.parametrize("key", ["friction.position@cart", "motor.map@motor", "sensor.map@cart", "unknown@cart"])
def test_a_law_is_what_the_loader_applies(key: str, tmp_path: Path) -> None:
    """The same numbers as the model has under `<custom>`, in the physics that environments and replay run."""
    law, effect = laws.read(diagnosis(tmp_path, key)), FOUND[key]
    rng = np.random.default_rng(1)
    given = [rng.uniform(2 * one.knots[0], 2 * one.knots[-1], 500) for one in law.inputs]
    speed = rng.uniform(-4, 4, 500)
    zero = np.zeros(500)
    if key == "unknown@cart":
        first, second = law.inputs
        data = np.array([1.5, 3, 2, *first.knots, *second.knots, *law.levels.ravel()])
        moment = physics.Moment(zero, zero, zero, zero, zero, speed, tuple(given))
        applied = formulas.force_of(np.tile(data, (500, 1)), moment)
        found = law(*given, speed=speed)
    elif key in ("motor.map@motor", "sensor.map@cart"):
        applied = formulas.mapped(
            np.concatenate(effect.written(effect.guess)), physics.Moment(zero, zero, zero, zero, given[0])
        )
        found = law(*given)
    else:
        even = np.linspace(-0.2, 0.3, 501)  # the file has knots at even distances
        data = np.tile([-0.2, 0.3, *np.interp(even, law.inputs[0].knots, law.levels)], (500, 1))
        applied = formulas.friction_along(data, physics.Moment(zero, given[0], zero, zero, zero))
        found = law(*given)
    np.testing.assert_allclose(applied, found, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("key", "at"), [("friction.resting@cart", "memory"), ("friction.load@cart", "speed")], ids=["resting", "load"]
)
def test_a_law_that_bends_between_its_knots_is_what_the_loader_applies(key: str, at: str, tmp_path: Path) -> None:
    """Its table has so many knots that straight lines do."""
    law, effect = laws.read(diagnosis(tmp_path, key)), FOUND[key]
    text = """<mujoco><worldbody><body><joint name="cart" type="slide" axis="1 0 0"/><geom size=".1" mass="1"/></body>
        </worldbody></mujoco>"""
    document = Document(mjcf.from_text(text))
    effect.edit(document, "cart", effect.first)
    (extra,) = physics.load(mjcf.from_text(document.text())).extras
    (along,) = law.inputs
    given = np.linspace(0.0, 1.5 * along.knots[-1], 500)
    zero = np.zeros(500)
    moment = replace(physics.Moment(zero, zero, zero + 1.0 / 0.1, zero, zero), **{at: given})
    applied = replace(extra, data=np.tile(extra.data, (500, 1)))(moment)
    found = law(given) + (effect.first["level"] if at == "speed" else 0.0)
    np.testing.assert_allclose(applied, found, atol=1e-3 * float(np.ptp(law.levels)))


@pytest.mark.parametrize("key", FOUND)
def test_the_table_is_the_law_at_its_knots(key: str, tmp_path: Path) -> None:
    law = laws.read(diagnosis(tmp_path, key))
    head, *rows = csv.reader(law.csv().splitlines())
    assert len(head) == len(law.inputs) + 1
    numbers = np.array(rows, dtype=float)
    still = None if law.driven_up_to is None else np.zeros(len(numbers))
    np.testing.assert_allclose(law(*numbers.T[:-1], speed=still), numbers[:, -1], rtol=1e-15)
    assert len(numbers) == law.levels.size


@given(st.integers(0, 10_000), st.integers(2, 9))
def test_a_law_stays_within_its_levels(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    levels = rng.normal(size=count)
    law = Law("a@b", "force", "N", (Input("position", "m", np.cumsum(rng.uniform(0.1, 1, count))),), levels)
    found = law(rng.normal(size=200) * 1e3)
    assert levels.min() - 1e-12 <= found.min()
    assert found.max() <= levels.max() + 1e-12


def test_the_command_writes_both(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file, several = diagnosis(tmp_path, "friction.position@cart"), tmp_path / "several"
    several.mkdir()
    assert cli.main(["export", str(file), "--to", "c", "--out", str(tmp_path / "my law.h")]) == 0
    assert "my_law(position), dry friction of friction.position@cart in N" in capsys.readouterr().out
    assert "data from -0.2 to 0.3" in (tmp_path / "my law.h").read_text()
    assert cli.main(["export", str(file), "--to", "csv", "--out", str(tmp_path / "law.csv")]) == 0
    assert (tmp_path / "law.csv").read_text().splitlines()[:2] == ['"position, m","dry friction, N"', "-0.2,2.0"]
    both = diagnosis(several, "friction.speed@cart", "load.position@cart")
    for arguments, says in (
        ([str(both)], "it holds friction.speed@cart, load.position@cart; say --law which"),
        ([str(both), "--law", "friction.sped@cart"], "did you mean 'friction.speed@cart'"),
        ([str(file), "--plant", "rig.json"], "--plant rig.json: a law is exported by itself"),
        ([str(tmp_path / "none.json"), "--law", "a@b"], "give a diagnosis as dipc-gym diagnose makes it"),
    ):
        assert cli.main(["export", *arguments, "--to", "csv", "--out", str(tmp_path / "other.csv")]) == 2
        assert says in capsys.readouterr().err
        assert not (tmp_path / "other.csv").exists()


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"levels": [1.0, 2.0]}, "levels of shape (2,) for knots of (4,)"),
        ({"levels": [1.0, math.nan, 2.0, 3.0]}, "a level is not a finite number"),
        ({"inputs": [{"name": "position", "unit": "m", "knots": [0.0, 1.0, 1.0, 2.0]}]}, "do not increase"),
        (
            {"inputs": [{"name": "position", "unit": "m", "knots": list(range(5000))}], "levels": [0.0] * 5000},
            "at most 4096",
        ),
        ({"inputs": "position"}, "not a law"),
        ({"levels": "many"}, "not a law"),
        ({"levels": [10**400, 1.0, 2.0, 3.0]}, "not a law (OverflowError"),
        ({"unit": "N\ud800"}, "can be printed"),
        ({"unit": "\x9b31m"}, "can be printed"),
        ({"inputs": []}, "one or two inputs"),
    ],
)
def test_a_law_that_is_none_is_refused_by_name(change: dict[str, Any], says: str, tmp_path: Path) -> None:
    file = diagnosis(tmp_path, "friction.position@cart")
    said = json.loads(file.read_text())
    said["missing"][0]["law"]["table"] |= change
    file.write_text(json.dumps(said))
    with pytest.raises(LawError) as refused:
        laws.read(file)
    assert says in str(refused.value)
    assert str(refused.value).startswith(f"{file}: friction.position@cart: ")


@pytest.mark.parametrize("at", ["cart\x9b2J", "y" * 5000, 7, "\ud800"])
def test_a_law_at_what_is_no_name_is_refused_in_few_words(at: Any, tmp_path: Path) -> None:
    file = diagnosis(tmp_path, "friction.position@cart")
    said = json.loads(file.read_text())
    said["missing"][0]["at"] = at
    file.write_text(json.dumps(said))
    with pytest.raises(LawError, match=r"missing\[0\]: effect and at must name the law") as refused:
        laws.read(file)
    assert len(str(refused.value)) < 500
    assert str(refused.value).isprintable()
