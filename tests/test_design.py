"""The next experiment: it asks what tells rivals apart, and asks nothing that the rig cannot do."""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from sim2real_rigs import CART, HANGING, NOISE, RK4, TORQUE, prepared, record, sweep

from dipc_gym import mjcf, physics, recording
from dipc_gym.recording import Recording
from dipc_gym.recording.units import commanded_by
from dipc_gym.sim2real import design
from dipc_gym.sim2real.effects import catalogue
from dipc_gym.sim2real.estimation.segments import Prepared
from dipc_gym.sim2real.model.structure import Structure, Term
from dipc_gym.sim2real.simulation.batch import Stepping

LIMITED = CART.replace('motorconst="0.06"', 'motorconst="0.06" ctrlrange="-3 5"')


@pytest.fixture(autouse=True)
def _shortly(monkeypatch: pytest.MonkeyPatch) -> None:
    """Six seconds instead of twenty."""
    few = replace(design.DESIGN, duration=6.0, sizes=(1.0, 0.5, 0.25, 0.125, 0.0625), enough=12)
    monkeypatch.setattr(design, "DESIGN", few)


@functools.cache
def ready(text: str, strength: float = 4.0, noise: Sequence[float] = (1e-5,)) -> tuple[Prepared, Recording]:
    run = record(physics.load(text), sweep(strength), 4.0, noise=noise, integrator=RK4)
    return prepared(text, [run], stepping=Stepping(0.002, RK4)), run


def structure(P: Prepared, *terms: tuple[str, str, dict[str, float]]) -> tuple[Structure, np.ndarray]:
    built = P.structure
    for effect, at, guess in terms:
        built = built.with_term(Term(catalogue()[effect], at, guess))
    return built, built.first


def propose(text: str, *structures: tuple[str, str, dict[str, float]], strength: float = 4.0) -> design.Design:
    P, run = ready(text, strength)
    return design.propose([structure(P, s) for s in structures], P.problem, [run], P.motions)


COULOMB = ("friction.coulomb", "cart", {"level": 1.5})
STRIBECK = ("friction.stribeck", "cart", {"level": 1.5, "static": 2.0, "velocity": 0.02})
COULOMB_SHOULDER = ("friction.coulomb", "shoulder", {"level": 0.02})
DEADZONE = ("motor.deadzone", "motor", {"width": 0.38})


@functools.cache
def between(rival: str) -> design.Design:
    """Coulomb friction or a rival, on the cart; worked out once for all tests."""
    return propose(CART, COULOMB, {"friction.stribeck": STRIBECK, "motor.deadzone": DEADZONE}[rival])


def played(text: str, commands: Recording, start: np.ndarray) -> np.ndarray:
    """Positions that MuJoCo's own step gives under a proposed command."""
    rig = physics.load(text)
    held = dict(zip(np.round(commands.time, 6), commands.commands[:, 0], strict=True))
    run = record(
        rig, lambda t: held.get(round(round(t / 0.002) * 0.002, 6), 0.0), commands.time[-1], start=start, integrator=RK4
    )
    return run.sensors


@pytest.mark.parametrize("rival", [STRIBECK, DEADZONE], ids=lambda rival: rival[0])
def test_it_tells_rivals_apart_within_the_range(rival: tuple[str, str, dict[str, float]]) -> None:
    found = between(rival[0])
    P, run = ready(CART)
    assert found.difference > 2
    for word in ("friction.coulomb at cart", f"{rival[0]} at {rival[1]}", "motor", " V", "cart at", "6 s"):
        assert word in found.sentence
    assert found.commands.actuator_names == ("motor",)
    # The nominal model, without the friction that holds it back, shows that the size was not guessed.
    friction = CART.replace("<joint ", '<joint frictionloss="1.5" solreffriction="0.002 1" ')
    moved = played(friction, found.commands, np.median(P.motions[0].position, axis=0))
    spare = 0.05 * np.ptp(run.sensors)
    assert run.sensors.min() - spare < moved.min() < moved.max() < run.sensors.max() + spare
    assert np.ptp(moved) > 0.1 * np.ptp(run.sensors)


def test_slow_ramps_show_what_happens_at_low_speed() -> None:
    """Between Coulomb and Stribeck friction it asks for slow motion or small amplitudes, not for steps."""
    assert any(word in between("friction.stribeck").sentence for word in ("slow ramps", "small tones"))


def test_what_cannot_be_told_apart_is_said() -> None:
    viscous = ("friction.viscous", "shoulder", {"coefficient": 0.1})
    found = propose(TORQUE, viscous, ("motor.back_emf", "drive", {"coefficient": 0.1}), strength=0.4)
    assert found.difference < 0.05
    assert "Do not expect much" in found.sentence
    assert " V" not in found.sentence
    assert "rad" in found.sentence


def test_a_single_structure_gets_what_determines_it() -> None:
    found = propose(CART, COULOMB)
    assert math.isnan(found.difference)
    assert "determine" in found.sentence
    P, run = ready(CART)
    bare = design.propose([(P.structure, P.structure.first)], P.problem, [run], P.motions)
    assert np.abs(bare.commands.commands).max() > 0


def test_commands_keep_within_the_control_range() -> None:
    found = propose(LIMITED, COULOMB, DEADZONE, strength=1.5)
    assert found.commands.commands.min() >= -3
    assert found.commands.commands.max() <= 3


@pytest.mark.parametrize(("low", "high"), [(0.0, 0.6), (0.1, 0.4), (-0.5, -0.1)])
def test_commands_of_one_sign_swing_within_their_range(low: float, high: float) -> None:
    """They begin with the least that the range has, on a pendulum that its weight brings back."""
    text = TORQUE.replace('gear="2"', f'gear="2" ctrlrange="{low} {high}"').replace('type="hinge"', 'damping="0.2"')
    P, run = ready(TORQUE.replace('type="hinge"', 'damping="0.2"'), 0.4)
    built = structure(replace(P, structure=prepared(text, [run]).structure), COULOMB_SHOULDER)
    found = design.propose([built], P.problem, [run], P.motions)
    commands = found.commands.commands
    assert commands.min() >= low - 1e-12
    assert commands.max() <= high + 1e-12
    assert np.ptp(commands) > 0.05 * (high - low)
    assert np.abs(commands[0]) == pytest.approx(min(abs(low), abs(high)))


def test_it_begins_and_ends_gently() -> None:
    commands = between("friction.stribeck").commands
    assert commands.commands[0] == 0
    assert np.abs(commands.commands[-1]).max() < 0.05 * np.abs(commands.commands).max()
    assert commands.period == pytest.approx(0.002)


def test_it_is_the_same_every_time() -> None:
    first, second = between("motor.deadzone"), propose(CART, COULOMB, DEADZONE)
    assert first.sentence == second.sentence
    assert np.array_equal(first.commands.commands, second.commands.commands)


def test_it_makes_a_file(tmp_path: Path) -> None:
    found = between("motor.deadzone")
    path = recording.write(found.commands, tmp_path / "next.csv")
    lines = path.read_text().splitlines()
    assert lines[0] == "time,motor"
    assert len(lines) == len(found.commands) + 1
    assert lines[2].startswith("0.002,")


def test_a_rig_that_falls_needs_its_controller() -> None:
    """Poles upright: no command keeps them there, so tones go on top of the controller's."""
    upright = HANGING.replace('name="pole1" type="hinge"', 'name="pole1" type="hinge" ref="0"').replace(
        'pos="0 0 -0.2"', 'pos="0 0 0.2"'
    )
    P, run = ready(HANGING, 3.0, NOISE["hanging"])
    held = replace(
        run,
        sensors=run.sensors * [1, 1e-2, 1e-2] + np.random.default_rng(0).normal(size=run.sensors.shape) * 1e-4,
        sha256="",
    )
    P = prepared(upright, [held], stepping=Stepping(0.002, RK4), length=0.05)
    friction, zone = structure(P, ("friction.coulomb", "cart", {"level": 1.0})), structure(P, DEADZONE)
    found = design.propose([friction, zone], P.problem, [held], P.motions)
    assert "controller" in found.sentence
    assert math.isnan(found.difference)
    usual = np.sqrt(np.mean(run.commands**2))
    assert 0 < np.abs(found.commands.commands).max() <= 0.2 * usual * (1 + 1e-9)


def test_a_log_without_commands_gets_some_that_the_rig_takes() -> None:
    """A free fall, of poles that no command keeps up: a share of nothing is nothing."""
    upright = HANGING.replace('pos="0 0 -0.2"', 'pos="0 0 0.2"')
    _, run = ready(HANGING, 3.0, NOISE["hanging"])
    held = replace(run, commands=np.zeros_like(run.commands), sensors=run.sensors * [1, 1e-2, 1e-2], sha256="")
    P = prepared(upright, [held], stepping=Stepping(0.002, RK4), length=0.05)
    found = design.propose([structure(P, ("friction.coulomb", "cart", {"level": 1.0}))], P.problem, [held], P.motions)
    assert "leaves its range when left alone" in found.sentence
    assert np.abs(found.commands.commands).max() == pytest.approx(0.2 * 24, rel=1e-6)  # of what the motor takes
    assert "4.8 V" in found.sentence


def test_a_joint_that_never_moved_has_not_left_its_range() -> None:
    """A locked one has been where its noise says, and a simulation that is off by rounding has not left that."""
    motion = ready(CART)[0].motions[0]
    locked = replace(motion, position=0 * motion.position)
    usual, low, high = design._visited([locked], np.array([1e-5]))
    assert low[0] == pytest.approx(-1e-4)
    assert usual[0] == 0
    assert high[0] == pytest.approx(1e-4)


@pytest.mark.parametrize("name", ["motor", "the.motor"])
def test_a_motor_is_asked_in_volts_whatever_its_name(name: str) -> None:
    text = CART.replace('name="motor"', f'name="{name}" input="voltage"')
    run = record(physics.load(text), sweep(4.0), 1.0, noise=(1e-5,), integrator=RK4)
    built = prepared(text, [run], stepping=Stepping(0.002, RK4)).structure
    assert design._unit(built, replace(run, actuator_names=[name]), 0) == " V"
    assert commanded_by(built.model, f"{name}.pos") == 0


def test_a_motor_that_heats_is_watched_for_longer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(design, "DESIGN", replace(design.DESIGN, warming=12.0))
    hot = ("motor.thermal", "motor", {"thermal_resistance": 5.0, "time_constant": 5.0})
    found = propose(CART, hot, ("motor.saturation", "motor", {"limit": 6.0}))
    assert found.commands.duration == pytest.approx(12.0, abs=0.01)
    assert found.difference > 1


def test_nothing_to_ask_or_to_command() -> None:
    P, run = ready(CART)
    with pytest.raises(ValueError, match="at least one structure"):
        design.propose([], P.problem, [run], P.motions)
    still = replace(run, commands=np.zeros((len(run), 0)), actuator_names=(), sha256="")
    with pytest.raises(ValueError, match="no actuator"):
        design.propose([structure(P)], P.problem, [still], P.motions)
    assert mjcf.controls(P.structure.model) == ["motor"]
