"""Replays: a model that made a recording predicts it, one that did not is found out, where and in what."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from paper import inches

from dipc_gym import mjcf, physics
from dipc_gym import recording as recordings
from dipc_gym.cli import main
from dipc_gym.mjcf.edit import Document
from dipc_gym.recording import Recorder, Recording, RecordingError
from dipc_gym.sim2real.effects import catalogue
from dipc_gym.sim2real.estimation import segments, states
from dipc_gym.sim2real.estimation.fit import fit
from dipc_gym.sim2real.estimation.settings import ESTIMATION
from dipc_gym.sim2real.model.structure import Structure, Term
from dipc_gym.sim2real.replay import replay
from dipc_gym.sim2real.simulation.batch import Stepping

SHARED = Path(__file__).parents[2] / "shared"
STEP = 0.001

HANGING = """
<mujoco>
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <body name="cart">
      <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
      <joint name="cart" type="slide" axis="1 0 0" damping="{damping}"/>
      <body name="pole">
        <inertial pos="0 0 -0.3" mass="0.5" diaginertia="0.01 0.01 0.01"/>
        <joint name="pole" axis="0 1 0" damping="0.01"/>
      </body>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="cart" gear="3" ctrllimited="true" ctrlrange="-4 4"/></actuator>
  <sensor><jointpos name="x" joint="cart"/><jointpos name="angle" joint="pole"/></sensor>
  <custom>{custom}</custom>
</mujoco>"""
ARM = """
<mujoco>
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <body>
      <inertial pos="0 0 0.2" mass="0.3" diaginertia="0.001 0.001 0.001"/>
      <joint name="upper" axis="0 1 0"/>
      <body pos="0 0 0.3">
        <inertial pos="0 0 0.1" mass="0.2" diaginertia="0.001 0.001 0.001"/>
        <joint name="lower" axis="0 1 0" damping="{damping}"/>
      </body>
    </body>
  </worldbody>
  <tendon><fixed name="both"><joint joint="upper" coef="1"/><joint joint="lower" coef="1"/></fixed></tendon>
  <sensor><jointpos name="phi1" joint="upper"/><tendonpos name="phi2" tendon="both"/></sensor>
</mujoco>"""
NOISE = np.array([1e-5, 2e-4])


@dataclass(frozen=True)
class Run:
    """How to record: start, length, stamps, noise, and a force that no model knows."""

    start: Sequence[float] = (0.0, 0.6)
    seconds: float = 4.0
    every: int = 2
    irregular: bool = False
    noise: float = 1.0
    volts: float = 2.5
    push: Callable[[float], float] = lambda t: 0.0

    def of(self, text: str, seed: int = 0) -> Recording:
        """Simulate with MuJoCo's own step, the loader's effects included."""
        rng, rig = np.random.default_rng(seed), physics.load(text)
        names = mjcf.controls(rig.model), mjcf.scalar_sensors(rig.model)
        model, data = rig.model, mujoco.MjData(rig.model)
        data.qpos[: len(self.start)] = self.start
        mujoco.mj_forward(model, data)
        memory = rig.sensor_memory(data.sensordata.copy())
        recorder = Recorder(*names)
        since = 0.0
        while data.time < self.seconds:
            command = np.full(
                len(names[0]), self.volts * np.sin(8 * data.time) + 0.8 * self.volts * np.sin(19 * data.time)
            )
            steps = int(rng.integers(1, 2 * self.every)) if self.irregular else self.every
            mujoco.mj_forward(model, data)
            read = rig.sense(data.sensordata, memory, since)
            recorder.append(data.time, command, read + self.noise * NOISE * rng.normal(size=2))
            for _ in range(steps):
                data.qfrc_applied[0] = self.push(data.time)
                rig.step(data, command)
            since = steps * STEP
        return recorder.recording("run")


def hanging(damping: float = 5.0, custom: str = "") -> str:
    return HANGING.format(damping=damping, custom=custom)


def files(folder: Path, text: str, recording: Recording) -> tuple[Path, Path]:
    (folder / "rig.xml").write_text(text)
    return folder / "rig.xml", recordings.write(recording, folder / "run.csv", overwrite=True)


# Right and wrong models


@pytest.mark.parametrize("irregular", [False, True])
def test_the_model_that_made_a_recording_predicts_it_within_its_noise(tmp_path: Path, irregular: bool) -> None:
    done = replay(*files(tmp_path, hanging(), Run(irregular=irregular).of(hanging())))
    assert done.window == ESTIMATION.window_length
    assert 0.85 < done.error < 1.1
    for sensor, noise in zip(done.sensors, NOISE, strict=True):
        assert sensor.noise == pytest.approx(noise, rel=0.1)
        assert 0.85 < sensor.ratio < 1.1
        assert sensor.median <= sensor.high
    assert [s.unit for s in done.sensors] == ["m", "rad"]


def test_without_noise_the_right_model_is_exact_and_nothing_breaks(tmp_path: Path) -> None:
    recording = Run(noise=0.0).of(hanging())
    right = replay(*files(tmp_path, hanging(), recording))
    assert [s.error for s in right.sensors] == pytest.approx([0.0, 0.0], abs=1e-6)
    wrong = replay(*files(tmp_path, hanging(damping=5.5), recording))
    assert wrong.sensors[0].error > 100 * right.sensors[0].error


def test_a_wrong_parameter_shows_in_the_sensor_it_touches_most(tmp_path: Path) -> None:
    done = replay(*files(tmp_path, hanging(damping=4.0), Run().of(hanging(damping=5.0))))
    assert done.sensors[0].ratio > 10
    assert done.sensors[0].ratio > done.sensors[1].ratio
    assert done.error > 5


def test_the_worst_window_is_where_the_model_was_wrong(tmp_path: Path) -> None:
    recording = Run(push=lambda t: 3.0 * (3.10 <= t < 3.15)).of(hanging())
    done = replay(*files(tmp_path, hanging(), recording))
    assert done.sensors[0].worst[0] == pytest.approx(3.0, abs=0.01)
    assert done.errors[12] > 5
    assert np.median(done.errors) < 1.1


def test_a_step_that_would_take_for_ever_is_refused(tmp_path: Path) -> None:
    model, path = files(tmp_path, hanging(), Run().of(hanging()))
    with pytest.raises(ValueError, match="a step of 1e-09 s would take for ever; give 1e-06 s or more"):
        replay(model, path, step=1e-9)


def test_windows_that_diverge_are_the_worst_and_are_written_as_none(tmp_path: Path) -> None:
    text = hanging().replace('damping="5.0"', 'damping="5.0" stiffness="-1e7"')
    assert "stiffness" in text
    model, path = files(tmp_path, text, Run().of(hanging()))
    said = tmp_path / "said.json"
    assert main(["replay", str(model), str(path), "--step", "0.002", "--window", "0.5", "--json", str(said)]) == 0
    held = json.loads(said.read_text())
    assert held["error"] is None
    assert held["sensors"]["x"]["error"] is None
    worst = held["sensors"]["x"]["worst"][0]
    assert next(one for one in held["windows"] if one["start"] == worst)["error"] is None


def test_free_motion_read_by_a_tendon_needs_no_actuator(tmp_path: Path) -> None:
    text = ARM.format(damping=0.001)
    recording = Run(start=(2.6, 0.8)).of(text)
    right = replay(*files(tmp_path, text, recording))
    assert 0.8 < right.error < 1.1
    assert [s.unit for s in right.sensors] == ["rad", "rad"]
    assert replay(*files(tmp_path, ARM.format(damping=0.01), recording)).error > 3


def test_commands_beyond_their_range_are_clamped_as_the_model_says_and_noted(tmp_path: Path) -> None:
    done = replay(*files(tmp_path, hanging(), Run(volts=6.0).of(hanging())))
    assert done.error < 1.1
    assert any("ctrlrange" in note for note in done.recording.notes)


def test_a_sensor_that_never_changes_has_no_weight(tmp_path: Path) -> None:
    recording = Run(volts=0.0, start=(0.0, 0.0)).of(hanging())
    sensors = recording.sensors.copy()
    sensors[:, 1] = 0.0
    done = replay(*files(tmp_path, hanging(), replace(recording, sensors=sensors, sha256="")))
    assert 0.85 < done.error < 1.1
    assert math.isnan(done.sensors[1].ratio)
    assert "constant" in done.table()
    written = json.loads(json.dumps(done.to_dict(), allow_nan=False))
    assert written["sensors"]["angle"]["noise"] is None
    assert written["sensors"]["angle"]["ratio"] is None


# What MJCF cannot say, and joints that nobody sees


@pytest.mark.parametrize(
    "effect",
    [
        ("motor.deadzone", "motor", "0.8"),
        ("sensor.gain", "angle", "1.05"),
        ("timing.sensor_lag", "x", "0.01"),
        ("friction.position", "cart", "-0.2 0.2 1.0 2.0 1.5"),
        ("disturbance.periodic", "pole", "0.2 3 0.5"),
    ],
)
def test_effects_under_custom_are_applied(tmp_path: Path, effect: tuple[str, str, str]) -> None:
    custom = '<numeric name="dipc_gym:{}:{}" data="{}"/>'.format(*effect)
    recording = Run().of(hanging(custom=custom))
    with_it = replay(*files(tmp_path, hanging(custom=custom), recording))
    without = replay(*files(tmp_path, hanging(), recording))
    assert np.median(with_it.errors) < 1.2
    assert np.median(without.errors) > 1.5 * np.median(with_it.errors)


@pytest.mark.parametrize(
    ("effect", "at", "values"),
    [
        (
            "transmission.backlash",
            "motor",
            {"gap": 0.004, "rotor_inertia": 0.1, "contact_rate": 1e3, "contact_damping": 0.3},
        ),
        ("motor.inductance", "motor", {"time_constant": 0.015}),
    ],
)
def test_improved_models_with_hidden_states_replay(
    tmp_path: Path, effect: str, at: str, values: dict[str, float]
) -> None:
    drive = '<dcmotor name="motor" joint="cart" gear="80" resistance="1.2" motorconst="0.06"'
    text = hanging().replace('<motor name="motor" joint="cart" gear="3"', drive)
    source = mjcf.from_text(text)
    model = mjcf.compile(source)
    structure = Structure(Document(source), model, mjcf.base_joints(model))
    term = Term(catalogue()[effect], at, values)
    structure = structure.with_term(term)
    improved = structure.write(structure.first).text()
    recording = Run().of(improved)
    right = replay(*files(tmp_path, improved, recording))
    wrong = replay(*files(tmp_path, text, recording))
    # A rotor within its gap is where nobody sees it: some windows start wrongly, most do not.
    assert np.median(right.errors) < 1.5
    assert np.median(wrong.errors) > 3 * np.median(right.errors)


def test_time_is_counted_from_the_first_sample(tmp_path: Path) -> None:
    """As in a diagnosis: what shakes the rig has no clock but the recording's, which may begin anywhere."""
    shaken = hanging(custom='<numeric name="dipc_gym:disturbance.periodic:cart" data="0.5 0.3 1.7"/>')
    recording = Run().of(shaken)
    late = replace(recording, time=recording.time + 1000.1)
    first, second = (replay(*files(tmp_path, shaken, run)) for run in (recording, late))
    assert first.error < 1.1
    assert second.error == pytest.approx(first.error, rel=0.01)
    assert any("1000.1" in note for note in second.recording.notes)


# Length of windows


def balanced(length: float) -> str:
    """A rod on its end; its unstable rate is sqrt(3 g / 2 length)."""
    inertia = 0.1 * length**2 / 12
    return f"""
        <mujoco>
          <option timestep="0.0005" integrator="RK4"/>
          <worldbody>
            <body>
              <inertial pos="0 0 {length / 2}" mass="0.1" diaginertia="{inertia} {inertia} 1e-9"/>
              <joint name="rod" axis="0 1 0"/>
            </body>
          </worldbody>
          <actuator><motor name="motor" joint="rod"/></actuator>
          <sensor><jointpos name="rod" joint="rod"/></sensor>
        </mujoco>"""


def balancing(length: float) -> Recording:
    rng, rig = np.random.default_rng(0), physics.load(balanced(length))
    data, recorder = mujoco.MjData(rig.model), Recorder(["motor"], ["rod"])
    weight = 0.1 * 9.81 * length / 2
    data.qpos[0] = 0.03
    for _ in range(2000):
        torque = -weight * (3 * data.qpos[0] + 0.3 * np.sqrt(length) * data.qvel[0] - 0.2 * np.sin(5 * data.time))
        recorder.append(data.time, [torque], data.qpos + 1e-5 * rng.normal(size=1))
        rig.step(data, np.array([torque]), 4)
    return recorder.recording("balancing")


def prepared(length: float) -> segments.Prepared:
    source = mjcf.from_text(balanced(length))
    rig = physics.load(source)
    return segments.prepare(source, rig, [balancing(length)], Stepping(rig.model.opt.timestep, None))


def test_start_errors_grow_as_the_unstable_mode_says() -> None:
    slow = prepared(1.0)  # 3.8 / s
    assert slow.length == ESTIMATION.window_length
    rate = np.sqrt(1.5 * 9.81 / 1.0)
    t = slow.problem.windows.times[0]
    expected = np.hypot(np.cosh(rate * t), np.sinh(rate * t) / (rate * ESTIMATION.window_length))
    grown = segments.growth(slow.problem, slow.structure, ESTIMATION.window_length)
    np.testing.assert_allclose(grown[0], expected, rtol=0.02)


def test_windows_are_shorter_where_an_unstable_rig_amplifies_the_start() -> None:
    fast = prepared(0.03)  # 22 / s
    rate = np.sqrt(1.5 * 9.81 / 0.03)
    t = np.linspace(0, ESTIMATION.window_length, 1000)
    expected = np.hypot(np.cosh(rate * t), np.sinh(rate * t) / (rate * ESTIMATION.window_length))
    assert fast.length == pytest.approx(t[np.argmax(expected > ESTIMATION.growth)], abs=0.004)
    assert fast.problem.windows.times.max() < fast.length


def test_an_unstable_rig_filmed_at_thirty_hertz_gets_no_longer_windows() -> None:
    run = balancing(0.03)
    filmed = Recording("film", run.time[::17], run.commands[::17], run.sensors[::17], ("motor",), ("rod",))
    source = mjcf.from_text(balanced(0.03))
    assert (
        segments.prepare(source, physics.load(source), [filmed], Stepping(5e-4, None)).length
        <= ESTIMATION.window_length
    )


def test_a_length_that_is_asked_for_is_kept(tmp_path: Path) -> None:
    model, run = files(tmp_path, balanced(0.03), balancing(0.03))
    assert replay(model, run).window < 0.2
    assert replay(model, run, window=0.3).window == 0.3


# Files


def test_columns_are_mapped_and_units_converted(tmp_path: Path) -> None:
    recording = Run().of(hanging())
    model, run = files(tmp_path, hanging(), recording)
    plain = replay(model, run)
    columns = {"t": 1e3 * recording.time, "u": recording.commands[:, 0], "x": recording.sensors[:, 0]}
    columns["theta"] = np.degrees(recording.sensors[:, 1])
    np.savetxt(
        tmp_path / "odd.csv",
        np.column_stack(list(columns.values())),
        "%.17g",
        ",",
        header=",".join(columns),
        comments="",
    )
    odd = replay(
        model,
        tmp_path / "odd.csv",
        mapping={"t": "time", "u": "motor", "theta": "angle"},
        units={"t": "ms", "angle": "deg"},
    )
    assert odd.error == pytest.approx(plain.error, rel=1e-6)


def test_the_dictionary_says_what_came_out_and_from_what(tmp_path: Path) -> None:
    done = replay(*files(tmp_path, hanging(), Run(seconds=2.0).of(hanging())), window=0.1)
    told = json.loads(json.dumps(done.to_dict(), allow_nan=False))
    assert told["schema"] == "dipc-gym/replay/1"
    assert told["window"] == 0.1
    assert told["error"] == done.error
    assert told["median_error"] == pytest.approx(np.median([w["error"] for w in told["windows"]]))
    assert told["error"] == pytest.approx(np.sqrt(np.mean([w["error"] ** 2 for w in told["windows"]])))
    assert [w["start"] for w in told["windows"]] == pytest.approx(0.1 * np.arange(20))
    assert set(told["sensors"]) == {"x", "angle"}
    angle = told["sensors"]["angle"]
    assert angle["ratio"] == pytest.approx(angle["error"] / angle["noise"])
    assert all(len(digest) == 64 for digest in told["provenance"]["inputs"].values())
    assert len(told["provenance"]["inputs"]) == 2
    assert told["provenance"]["timestep"] == pytest.approx(STEP)


def test_repetition_gives_the_same_bits(tmp_path: Path) -> None:
    paths = files(tmp_path, hanging(), Run(seconds=2.0).of(hanging()))
    assert replay(*paths).to_dict() == replay(*paths).to_dict()


@pytest.mark.parametrize(
    ("window", "words"),
    [(9.0, "hold no window of 9 s"), (0.003, "at least 4 samples"), (0.0, "positive"), (math.nan, "positive")],
)
def test_windows_that_cannot_be_are_refused(tmp_path: Path, window: float, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        replay(*files(tmp_path, hanging(), Run(seconds=2.0).of(hanging())), window=window)


def test_a_recording_in_which_nothing_moves_is_refused(tmp_path: Path) -> None:
    recording = Run(seconds=1.0).of(hanging())
    still = replace(recording, sensors=np.zeros_like(recording.sensors), sha256="")
    with pytest.raises(RecordingError, match=r"run\.csv: no sensor changes"):
        replay(*files(tmp_path, hanging(), still))


def test_models_that_cannot_be_treated_are_refused(tmp_path: Path) -> None:
    recording = Run(seconds=1.0).of(hanging())
    touching = (
        hanging()
        .replace("<inertial", '<geom size="0.1" mass="0.1"/><inertial')
        .replace("<worldbody>", '<worldbody><geom type="plane" size="1 1 1"/>')
    )
    with pytest.raises(mjcf.MjcfError, match="can touch"):
        replay(*files(tmp_path, touching, recording))
    beside = '<body><joint name="other"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body></worldbody>'
    blind = hanging().replace('<jointpos name="angle" joint="pole"/>', '<jointpos name="angle" joint="other"/>')
    blind = blind.replace("</worldbody>", beside)
    with pytest.raises(states.Undetermined, match="sees joint pole"):
        replay(*files(tmp_path, blind, recording))


def test_from_the_shell(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model, run = map(str, files(tmp_path, hanging(), Run(seconds=2.0).of(hanging())))
    out, picture = tmp_path / "out.json", tmp_path / "out.png"
    command = ["replay", model, run, "--json", str(out), "--plot", str(picture)]
    assert main(command) == 0
    shown = capsys.readouterr().out
    assert json.loads(out.read_text())["schema"] == "dipc-gym/replay/1"
    assert picture.read_bytes().startswith(b"\x89PNG")
    lines = shown.splitlines()
    assert [line.split()[0] for line in lines[-3:]] == ["x", "angle", "error:"]
    assert lines[-1].endswith("x noise, in windows of 0.25 s")
    before = out.read_bytes()
    assert main(command) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert main([*command, "--overwrite"]) == 0
    assert out.read_bytes() == before
    assert main(["replay", model, run, "--unit", "angle"]) == 2
    assert "equals sign" in capsys.readouterr().err
    assert main(["replay", model, run, "--map", "x=x", "--map", "x=angle"]) == 2
    assert "twice" in capsys.readouterr().err
    for width in ("7", "3.4"):
        assert main(["replay", model, run, "--plot", str(tmp_path / f"{width}.pdf"), "--width", width]) == 0
        assert inches(tmp_path / f"{width}.pdf") == pytest.approx(float(width))
    assert main(["replay", model, run, "--plot", str(tmp_path / "no.pdf"), "--width", "0"]) == 2
    assert "it can be 2 to 30" in capsys.readouterr().err
    assert not (tmp_path / "no.pdf").exists()
    assert main(["replay", model, run, "--json", str(tmp_path / "no.json"), "--width", "5"]) == 2
    assert "it is that of the picture" in capsys.readouterr().err
    assert not (tmp_path / "no.json").exists()
    assert main(["replay", model, run, "--plot", str(tmp_path / "out.txt")]) == 2
    assert ".png" in capsys.readouterr().err


# Recordings of real rigs, and of ones simulated elsewhere


@pytest.mark.parametrize(
    ("folder", "run", "most"),
    [
        ("recordings/bam_xl330", "sin_sin_kp400.csv", 500),
        ("recordings/dfki", "run_08.csv", 500),
        ("recordings/emps", "emps.csv", 1e5),
        ("recordings/uw_double", "free_swing.csv", 30),
        ("practice/p04_hanging", "train_1.csv", 5),
        ("practice/p06_cart", "test.csv", 2000),
    ],
)
def test_every_kind_of_recording_replays(folder: str, run: str, most: float) -> None:
    if not (SHARED / folder).is_dir():
        pytest.skip(f"{folder} is not there")
    done = replay(SHARED / folder / "nominal.xml", SHARED / folder / run)
    assert 0.5 < done.error < most
    assert done.window == ESTIMATION.window_length
    assert len(done.errors) >= 0.9 * done.recording.duration / done.window
    assert np.isfinite(done.predicted).all()


def test_a_balanced_pendulum_keeps_whole_windows_until_they_are_too_long() -> None:
    folder = SHARED / "practice" / "p07_upright"
    if not folder.is_dir():
        pytest.skip("practice is not there")
    source = mjcf.read(folder / "nominal.xml")
    rig = physics.load(source)
    run = recordings.read(folder / "train_1.csv", rig.model).slice(0, 4000)
    stepping = Stepping(rig.model.opt.timestep, None)
    usual = segments.prepare(source, rig, [run], stepping)
    assert usual.length == ESTIMATION.window_length
    grown = segments.growth(usual.problem, usual.structure, ESTIMATION.window_length).max(axis=1)
    assert 2 < np.median(grown) < ESTIMATION.growth
    long = segments.prepare(source, rig, [run], stepping, length=1.0)
    steady = segments.steady_length(long.problem, long.structure, 1.0)
    assert ESTIMATION.window_length < steady < 0.6
    # Nothing is missing in this rig: the longer windows too find its noise and nothing else.
    steadier = segments.prepare(source, rig, [run], stepping, length=steady)
    assert 0.9 < fit(steadier.problem, steadier.structure).error < 1.15


def test_windows_of_slow_samples_are_longer_where_recordings_are_long_enough() -> None:
    def sampled(period: float, seconds: float) -> Recording:
        time = np.arange(0.0, seconds, period)
        return Recording("run", time, np.zeros((len(time), 1)), np.zeros((len(time), 1)), ["motor"], ["x"])

    for period, seconds, length in ((0.002, 40.0, 0.25), (0.005, 40.0, 0.25), (0.01, 40.0, 0.4), (0.05, 200.0, 2.0)):
        assert segments.usual_length([sampled(period, seconds)], (0.0, 1.0)) == pytest.approx(length, rel=1e-6)
    assert segments.usual_length([sampled(0.01, 10.8)], (0.0, 1.0)) == pytest.approx(0.3, rel=0.01)
    assert segments.usual_length([sampled(0.01, 4.0)], (0.0, 1.0)) == 0.25


def test_windows_in_which_nobody_knows_an_activation_are_left_out(tmp_path: Path) -> None:
    """A filter of 0.15 s shows for half a second where it was before the file began."""
    text = """
    <mujoco><option timestep="0.002" integrator="RK4"/><worldbody><body><joint name="z" axis="0 0 1" damping="0.1"/>
    <geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="0.4" contype="0" conaffinity="0"/></body></worldbody>
    <actuator><general name="m" joint="z" dyntype="filterexact" dynprm="0.15"/></actuator>
    <sensor><jointpos name="z" joint="z"/></sensor></mujoco>"""
    (tmp_path / "slow.xml").write_text(text)
    rig = physics.load(mjcf.from_text(text))
    data = mujoco.MjData(rig.model)
    data.act[:] = 1.5
    recorder = Recorder(["m"], ["z"])
    for k in range(2000):
        command = float(np.sin(0.01 * k))
        data.ctrl[:] = command
        recorder.append(0.002 * k, [command], data.sensordata.copy())
        mujoco.mj_step(rig.model, data)
        mujoco.mj_forward(rig.model, data)
    file = recordings.write(recorder.recording("slow"), tmp_path / "slow.csv")
    found = replay(tmp_path / "slow.xml", file)
    assert found.windows.start.min() >= 0.4
    assert any("windows are left out" in note for note in found.recording.notes)
    short = recordings.write(recorder.recording("short").slice(0, 250), tmp_path / "short.csv")
    with pytest.raises(RecordingError, match="is forgotten; record longer"):
        replay(tmp_path / "slow.xml", short)
