"""How far pairs hold on changed rigs: the axes, the blow, the figures, and policies beside LQR."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dipc_gym import compensators, sweep
from dipc_gym.cli import main
from dipc_gym.compensators import StaticGain
from dipc_gym.controllers import LQR
from dipc_gym.controllers.lqr import PRINTED_GAIN
from dipc_gym.env import DoublePendulumEnv
from dipc_gym.experiments import compare
from dipc_gym.experiments.cells import Balancing
from dipc_gym.experiments.compare import Comparison
from dipc_gym.experiments.robustness import AXES, Axis, Endurance
from dipc_gym.plant import Plant
from dipc_gym.policy import Policy
from dipc_gym.runs import Impulse, balance


def linear_policy(compensator: str = "llnf", commands: Any = "force", gain: float = 1.0) -> Policy:
    """LQR in the form of a policy: one layer, clipped to 96 N (or 24 V, at 4 N/V)."""
    limit = 96.0 if commands == "force" else 24.0
    per_unit = 1.0 if commands == "force" else 4.0
    layers = ((-gain * PRINTED_GAIN[None] / (per_unit * limit), np.zeros(1)),)
    return Policy(layers=layers, commands=commands, limit=limit, compensator=compensator, newtons_per_volt=4.0)


def balancing(**changes: Any) -> Balancing:
    settings: dict[str, Any] = {
        "controller": "lqr",
        "compensator": "none",
        "trained": StaticGain(newtons_per_volt=4.0).to_dict(),
        "plant": Plant(),
        "model": None,
        "seed": 0,
        "seconds": 4.0,
        "exact_state": False,
        "files": {},
    }
    return Balancing(**{**settings, **changes})


# ------------------------------------------------------------------------------------------------ the blow


def test_a_blow_changes_momentum_by_its_size_and_nothing_else() -> None:
    env = DoublePendulumEnv(exact_state=True)
    env.reset(options={"state": [0.05, 0.1, -0.2, 0.3, 0.4, -0.5]})
    before, time = env.state, env.time
    env.strike(1.5)
    after = env.state
    assert env.time == time
    np.testing.assert_array_equal(after[:3], before[:3])
    # The paper's equations, d1 to d6 of the rig: M(theta) times the change of rates is the impulse on the cart.
    d1, d2, d3, d4, d5, d6 = 1.259984, 0.176948, 0.035200, 0.073354, 0.014080, 0.013195
    t1, t2 = before[1:3]
    mass = np.array(
        [
            [d1, d2 * math.cos(t1), d3 * math.cos(t2)],
            [d2 * math.cos(t1), d4, d5 * math.cos(t1 - t2)],
            [d3 * math.cos(t2), d5 * math.cos(t1 - t2), d6],
        ]
    )
    np.testing.assert_allclose(mass @ (after - before)[3:], [1.5, 0.0, 0.0], atol=2e-5)
    with pytest.raises(ValueError, match="finite number of N s"):
        env.strike(math.inf)


def test_a_blow_hits_once_and_at_its_time() -> None:
    quiet, hit = (
        balance(LQR(), StaticGain(newtons_per_volt=4.0), seconds=1.0, seed=3, exact_state=True, impulse=impulse)
        for impulse in (None, Impulse(1.0, 0.5))
    )
    np.testing.assert_array_equal(hit.state[:100], quiet.state[:100])
    assert hit.state[100, 3] - quiet.state[100, 3] > 1.0  # m/s; the cart alone has 1/1.26 and the poles lean back
    assert np.all(hit.state[100, :3] == quiet.state[100, :3])


# ------------------------------------------------------------------------------------------------ axes


@pytest.mark.parametrize("name", sorted(AXES))
def test_axes_hold_the_usual_rig_and_rise(name: str) -> None:
    axis = AXES[name]
    assert axis.usual in axis.values
    assert list(axis.values) == sorted(set(axis.values))
    assert axis.rig(Plant(), axis.usual) == Plant()
    for value in axis.values:
        gymnasium.make("DIPC-Friction-v0", plant=axis.rig(Plant(), value)).close()


def test_axes_change_what_they_say() -> None:
    double = {name: axis.rig(Plant(), 2.0) for name, axis in AXES.items()}
    assert double["friction"].friction is not None
    assert (double["friction"].friction.coulomb, double["friction"].friction.static) == (16.0, 22.0)
    assert double["friction"].friction.viscous == Plant().friction.viscous  # type: ignore[union-attr]
    assert double["encoder"].encoders.pole == 2 * Plant().encoders.pole
    assert double["encoder"].encoders.cart == 2 * Plant().encoders.cart
    assert double["period"].control_period == 0.01
    assert double["supply"].supply == 48.0
    assert double["impulse"] == Plant()


@given(st.lists(st.booleans(), min_size=7, max_size=7))
def test_between_is_the_longest_run_of_holding_around_the_usual_value(held: list[bool]) -> None:
    values = (0.25, 0.5, 0.7, 1.0, 1.5, 2.0, 4.0)
    found = Axis("", 1.0, values, lambda plant, _: plant).between(dict(zip(values, held, strict=True)))
    if not held[3]:
        assert found is None
        return
    assert found is not None
    low, high = values.index(found[0]), values.index(found[1])
    assert low <= 3 <= high
    assert all(held[low : high + 1])
    assert low == 0 or not held[low - 1]
    assert high == 6 or not held[high + 1]


# ------------------------------------------------------------------------------------------------ cells


def test_a_weak_supply_and_a_hard_blow_make_it_fall() -> None:
    supply = Endurance(balancing=balancing(), axis="supply", values=(0.1, 1.0)).run()
    assert [row["survived"] for row in supply] == [False, True]
    assert supply[0]["seconds"] < 2.0
    impulse = Endurance(balancing=balancing(), axis="impulse", values=(0.0, 3.0, 50.0)).run()
    assert [row["survived"] for row in impulse] == [True, True, False]
    assert 1.0 <= impulse[2]["seconds"] < 1.5  # struck after a quarter of the run
    assert impulse[1]["cart_m"] > impulse[0]["cart_m"]


def test_usual_value_is_the_balancing_itself() -> None:
    plain = balancing().run()
    for axis in AXES:
        row = Endurance(balancing=balancing(), axis=axis, values=(AXES[axis].usual,)).run()[0]
        for key in ("survived", "seconds", "cart_m", "pole1_deg", "force_rms"):
            assert row[key] == plain[key], (axis, key)


def test_what_remembers_is_told_another_control_period() -> None:
    """As an estimator is: whoever sets it knows it."""
    bristle = compensators.LuGre(4.0, 24.0, 0.005, 2e4, 60.0, 8.0, 3.0, 0.02)
    trained = balancing(compensator="lugre", trained=bristle.to_dict(), seconds=1.0)
    rows = Endurance(balancing=trained, axis="period", values=(1.0, 2.0)).run()
    assert [row["survived"] for row in rows] == [True, True]
    assert rows[0]["voltage_rms"] != rows[1]["voltage_rms"]


def test_more_friction_than_trained_on_makes_the_cart_stray() -> None:
    rows = Endurance(balancing=balancing(seconds=10.0), axis="friction", values=(0.5, 1.0, 2.0)).run()
    strays = [row["cart_m"] for row in rows]
    assert strays == sorted(strays)
    assert strays[2] > 1.5 * strays[1]


# ------------------------------------------------------------------------------------------------ the whole


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Comparison]:
    out = tmp_path_factory.mktemp("robust") / "out"
    linear_policy().save(out.parent / "learned.json")
    linear_policy("none", "voltage").save(out.parent / "direct.json")
    comparison = Comparison(
        controllers=("lqr", str(out.parent / "learned.json"), str(out.parent / "direct.json")),
        compensators=("none", "ideal"),
        seeds=2,
        seconds=2.0,
        robustness=("supply", "impulse"),
    )
    compare.run(comparison, out, jobs=1)
    return out, comparison


def test_table_and_figures_of_all_pairs(finished: tuple[Path, Comparison]) -> None:
    out, comparison = finished
    held = json.loads((out / "robustness.json").read_text())
    pairs = [("lqr", "none"), ("lqr", "ideal"), ("learned", "none"), ("learned", "ideal"), ("direct", "none")]
    assert comparison.pairs() == pairs
    assert [(row["controller"], row["compensator"], row["axis"]) for row in held["rows"]] == [
        (*pair, axis) for pair in pairs for axis in ("supply", "impulse")
    ]
    for row in held["rows"]:
        assert [step["value"] for step in row["steps"]] == list(AXES[row["axis"]].values)
        assert all(step["rigs"] == 2 for step in row["steps"])
        shares = {step["value"]: step["stood"] / 2 for step in row["steps"]}
        assert row["every"] == list(AXES[row["axis"]].between({v: s == 1 for v, s in shares.items()}) or []) or None
        assert row["half"][0] <= row["every"][0] <= row["every"][1] <= row["half"][1]
    text = (out / "robustness.txt").read_text()
    assert "≥1.5" in text
    assert "runs of 2 s" in text
    assert (out / "figures" / "robustness.pdf").read_bytes().startswith(b"%PDF")
    assert (out / "figures" / "robustness.png").read_bytes().startswith(b"\x89PNG")


def test_a_policy_that_is_lqr_holds_like_lqr(finished: tuple[Path, Comparison]) -> None:
    rows = {
        (row["controller"], row["compensator"], row["axis"]): row
        for row in json.loads((finished[0] / "robustness.json").read_text())["rows"]
    }
    for axis in ("supply", "impulse"):
        assert rows["learned", "none", axis]["every"] == rows["lqr", "none", axis]["every"]
        assert rows["direct", "none", axis]["every"] == rows["lqr", "none", axis]["every"]


def test_policies_are_marked_and_voltage_has_no_compensator(finished: tuple[Path, Comparison]) -> None:
    summary = json.loads((finished[0] / "summary.json").read_text())
    marks = {(row["controller"], row["compensator"]): row["trained_with"] for row in summary["rows"]}
    assert marks == {
        ("lqr", "none"): None,
        ("lqr", "ideal"): None,
        ("learned", "none"): "llnf",
        ("learned", "ideal"): "llnf",
        ("direct", "none"): None,
    }
    text = (finished[0] / "table.txt").read_text()
    assert "* learned was trained with llnf" in text
    assert "direct commands voltage, so it stands in the table with 'none' only" in text


def test_the_same_command_again_runs_nothing_and_more_rigs_run_only_those(
    finished: tuple[Path, Comparison], monkeypatch: pytest.MonkeyPatch
) -> None:
    out, comparison = finished
    before = {path: path.stat().st_mtime_ns for path in (out / "cells").iterdir()}
    held = (out / "robustness.json").read_bytes()
    compare.run(comparison, out, jobs=1)
    assert (out / "robustness.json").read_bytes() == held
    compare.run(dataclasses.replace(comparison, seeds=3), out, jobs=1)
    after = {path: path.stat().st_mtime_ns for path in (out / "cells").iterdir()}
    assert {path: after[path] for path in before} == before
    assert len(after) > len(before)
    assert {path.stem.split("-")[2] for path in after.keys() - before.keys()} == {"02"}


def test_a_changed_file_or_length_is_named(finished: tuple[Path, Comparison]) -> None:
    out, comparison = finished
    with pytest.raises(sweep.SweepError, match=r"was made with seconds = 2\.0, and this sweep has 3\.0"):
        compare.run(dataclasses.replace(comparison, seconds=3.0), out)
    policy = out.parent / "learned.json"
    text = policy.read_text()
    linear_policy(gain=1.01).save(policy)
    try:
        with pytest.raises(sweep.SweepError, match=r"was made with files\..*learned\.json"):
            compare.run(comparison, out)
    finally:
        policy.write_text(text)


def test_a_failure_is_listed_and_the_others_stand(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise RuntimeError("no such luck\nat all")

    monkeypatch.setattr(compensators.registry.kind("feedforward"), "fit", refuse)
    command = ["compare", "--out", str(tmp_path / "out"), "--compensator", "none,feedforward", "--seeds", "2"]
    assert main([*command, "--seconds", "1", "--jobs", "1"]) == 1
    said = capsys.readouterr()
    assert "failed: train-feedforward-01: RuntimeError: no such luck" in said.out
    assert "2 failed" in said.err
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert [(row["compensator"], row["seeds"]) for row in summary["rows"]] == [("none", 2)]
    monkeypatch.undo()
    assert main([*command, "--seconds", "1", "--jobs", "1"]) == 0
    assert [row["compensator"] for row in json.loads((tmp_path / "out" / "summary.json").read_text())["rows"]] == [
        "none",
        "feedforward",
    ]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--robustness", "wind"], "no robustness axis 'wind'; there are friction, encoder, period, supply, impulse"),
        (["--jobs", "0"], "1 or more"),
        (["--jobs", "-2"], "1 or more"),
        (["--controller", "policy.json"], "policy.json"),
        (["--controller", "voltage.json", "--compensator", "llnf"], "goes with the compensator 'none' alone"),
        (["--controller", "a/p.json,b/p.json"], "two controllers are called 'p'"),
        (["--controller", "broken.json"], "broken.json"),
    ],
)
def test_bad_input(
    arguments: list[str],
    says: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "broken.json").write_text('{"schema": "dipc-gym/compensator/1"}')
    linear_policy("none", "voltage").save("voltage.json")
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        linear_policy().save(f"{folder}/p.json")
    assert main(["compare", "--out", "new", *arguments]) == 2
    assert says in capsys.readouterr().err
    assert not (tmp_path / "new").exists()


def test_a_model_as_diagnose_writes_it_goes_through_all_of_it(tmp_path: Path) -> None:
    rig = DoublePendulumEnv().source.text
    lugre = next(line for line in rig.splitlines() if 'name="friction"' in line)
    text = rig.replace(lugre, "").replace(
        'damping="20.8"', 'damping="20.8" frictionloss="7.4" solreffriction="0.002 1"'
    )
    numeric = '<custom><numeric name="dipc_gym:motor.deadzone:motor" data="0.6"/></custom>'
    (tmp_path / "improved.xml").write_text(text.replace("<worldbody>", f"{numeric}<worldbody>", 1))
    comparison = Comparison(
        model=str(tmp_path / "improved.xml"),
        compensators=("none", "feedforward"),
        seeds=1,
        seconds=4.0,
        robustness=("impulse",),
    )
    summary = compare.run(comparison, tmp_path / "out", jobs=1)
    none, feedforward = summary["rows"]
    assert (none["survived"], feedforward["survived"]) == (1, 1)
    assert feedforward["cost"]["median"] < none["cost"]["median"]
    with pytest.raises(ValueError, match=r"axis friction needs .* --robustness encoder,period,supply,impulse"):
        compare.run(dataclasses.replace(comparison, robustness=("friction",)), tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_values_that_no_rig_has_are_left_out() -> None:
    """Twenty times a control period of 0.06 s is more than a plant may have."""
    slow = Plant(control_period=0.06)
    assert AXES["period"].possible(slow)[-1] == 16.0
    assert AXES["period"].possible(Plant()) == AXES["period"].values
