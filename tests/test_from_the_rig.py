"""The section "From the rig" of docs/rig.md, command by command, with a simulated rig in the place of a real one."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import gymnasium
import numpy as np
import pages
import pytest

import dipc_gym
from dipc_gym import cli, compensators, recording
from dipc_gym.identification import Sweep
from dipc_gym.recording import Recording
from dipc_gym.runs import identify
from dipc_gym.sim2real import effects

PAGE = pages.ROOT / "docs" / "rig.md"
FRICTION = ("friction.coulomb", "friction.stribeck", "friction.viscous")


def hanging(path: str, seed: int) -> None:
    """As the page describes it: the poles hang, the motor is swept."""
    env = gymnasium.make("DIPC-Friction-v0")
    env.reset(seed=seed, options={"start": "hanging"})
    time = 0.005 * np.arange(1600)
    phase = np.random.default_rng(seed).uniform(0, 2 * np.pi)
    volts, readings = 12 * np.sin(2 * np.pi * time * (2.5 + 3.5 * time / 16) + phase), []
    for u in volts.tolist():
        readings.append(env.unwrapped.encoders)  # type: ignore[attr-defined]
        assert not env.step(np.array([u]))[2]
    run = Recording(path, time, volts[:, None], np.array(readings), ("motor",), ("cart", "pole1", "pole2"))
    recording.write(run, path)


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """What the page takes as given: the model without dry friction, and recordings."""
    monkeypatch.chdir(tmp_path)
    text = Path(dipc_gym.__file__).with_name("rig.xml").read_text()
    nominal = re.sub(
        r'    <!-- Friction of rail.*?-->\n    <dcmotor name="friction"[^>]*/>\n', "", text, flags=re.DOTALL
    )
    assert "lugre" not in nominal
    Path("rig.xml").write_text(nominal)
    hanging("hanging_1.csv", 1)
    hanging("hanging_2.csv", 2)
    recording.write(identify().run, "sweep.csv")
    recording.write(identify(sweep=Sweep(duration=6.0, low=0.1, high=0.3, amplitude=5.0)).run, "push.csv")
    effects.catalogue()
    few = {name: effect for name, effect in effects._effects.items() if name in FRICTION}
    monkeypatch.setattr(effects, "_effects", few)
    return tmp_path


def section() -> list[tuple[str, str]]:
    """Commands in order, each with what the page says that it prints, or nothing."""
    text = PAGE.read_text(encoding="utf-8").split("\n## From the rig\n")[1].split("\n## ")[0]
    blocks = re.findall(r"^```(bash|text)\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    found: list[tuple[str, str]] = []
    for language, block in blocks:
        if language == "bash":
            found += [(line, "") for line in block.splitlines()]
        else:
            found[-1] = (found[-1][0], block)
    return found


def alike(said: str, printed: str) -> None:
    """The same words and the same map, and numbers that differ by no more than other processors make them."""
    number = r"-?\d+(?:\.\d+)?"
    assert re.sub(number, "#", said) == re.sub(number, "#", printed)
    ours, theirs = ([float(x) for x in re.findall(number, text)] for text in (said, printed))
    assert theirs == pytest.approx(ours, rel=0.1)


def test_every_command_does_what_the_page_says(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    commands = section()
    assert [command.split()[1] for command, _ in commands] == ["diagnose", "train", "train", "compensator", "export"]
    for command, said in commands:
        refused = "refused.json" in command
        words = shlex.split(command)[1:]
        assert cli.main(words + (["--jobs", "1"] if words[0] == "diagnose" else [])) == (2 if refused else 0), command
        printed = capsys.readouterr()
        if said:
            alike(said, printed.err if refused else printed.out)
    assert "frictionloss" in Path("diagnosis/improved.xml").read_text()
    assert not Path("refused.json").exists()
    mine, implied = compensators.load("mine.json"), compensators.load("implied.json")
    for made, away in ((mine, 0.5), (implied, 2.0)):  # from the 8 N at 0.3 m/s that the rig has
        for way in (1, -1):
            made.reset()
            made.voltage(0.0, way * 0.3)
            pushes = way * 4 * made.voltage(0.0, way * 0.3)
            assert pushes == pytest.approx(8.0, abs=away)


def test_columns_of_locked_poles_have_units_and_names_of_their_own(tmp_path: Path) -> None:
    """One count of an encoder in degrees is a twelfth of one; read as radians, poles would swing."""
    run = identify(sweep=Sweep(duration=20.0)).run
    poles = np.degrees(0.0015) * (np.arange(len(run)) % 2)[:, None] * np.ones(2)
    seen = Recording(
        "sweep", run.time, run.commands, np.hstack([run.sensors, poles]), ("motor",), ("cart", "th1", "pole2")
    )
    path = recording.write(seen, tmp_path / "sweep.csv")
    known = {"mapping": {"th1": "pole1"}, "units": {"pole1": "deg", "pole2": "deg"}}
    assert len(identify(from_recording=str(path), **known).run) == len(run)
    for mapping, units in (
        ({"th1": "pole1"}, {"th1": "deg", "pole2": "deg"}),
        ({"th1": "sensor:pole1"}, {"sensor:pole1": "deg", "pole2": "deg"}),
    ):
        assert len(identify(from_recording=str(path), mapping=mapping, units=units).run) == len(run)
    with pytest.raises(ValueError, match=r"pole1 swings by 0\.\d+ rad; identification needs the poles locked"):
        identify(from_recording=str(path), mapping=known["mapping"])
