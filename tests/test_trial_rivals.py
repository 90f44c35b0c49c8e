"""The rivals of the blind trial: the windows they are judged by, the refit, the network and PySINDy."""

import json
import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest

pytest.importorskip("numba")

from dipc_gym.trials import catalogue, generate, network, prediction, replayed, rigs, rivals, sparse
from dipc_gym.trials.entries import index
from dipc_gym.trials.generate import write_csv

CART = "cart"


def rig_with(tmp_path, effect=None, values=(), *, rig=CART, nominal=None):
    """Three recordings of a rig as a trial has them, and the generator's own view of the last."""
    rng = np.random.default_rng(3)
    made = rigs.RIGS[rig](rng)
    parameters = made.parameters
    if effect is not None:
        one = next(e for e in catalogue.effects(made) if e.name == effect)
        parameters = one.apply(parameters, np.asarray(values, dtype=float))
    recordings = [
        prediction.record(made, parameters, rigs.excitation(made, kind, rng), prediction.ONES, rng)
        for kind in ("chirp", "noise", "steps")
    ]
    for name, recording in zip(("train_1", "train_2", "test"), recordings, strict=True):
        write_csv(tmp_path / f"{name}.csv", made, recording)
    given = made.parameters if nominal is None else nominal(made.parameters.copy())
    (tmp_path / "nominal.xml").write_text(rigs.nominal_xml(made, given))
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "nominal.xml"))
    motions = [replayed.Motion.read(tmp_path / f"{name}.csv") for name in ("train_1", "train_2", "test")]
    return made, model, [first(motion) for motion in motions], recordings


def first(motion, windows_=24):
    """The beginning of a recording, which is quicker."""
    part = slice(0, windows_ * replayed.WINDOW)
    return replace(motion, **{name: getattr(motion, name)[part] for name in ("command", "measured", "q", "v", "a")})


def generators_error(rig, parameters, recording):
    seen = prediction.Windows(rig, recording, rig.parameters)
    residual = seen.residual(prediction.predict(rig, parameters, recording), recording.measured)
    return prediction.rms(residual[: 24 * replayed.WINDOW * rig.count])


@pytest.mark.parametrize(("rig", "effect", "values"), [("upright", None, ()), ("pendulum", "drag.quadratic", (0.01,))])
def test_windows_in_mujoco_say_what_the_generator_says(tmp_path, rig, effect, values):
    """Two integrators, two estimates of the starts, one error."""
    made, model, motions, recordings = rig_with(tmp_path, effect, values, rig=rig)
    there = generators_error(made, made.parameters, recordings[2])
    assert (there < 1.1) == (effect is None)
    assert replayed.error(model, motions[2], made.noise) == pytest.approx(there, rel=0.01)


@pytest.mark.parametrize(("rig", "shows"), [("cart", 20), ("hanging", 10), ("pendulum", 5)])
def test_a_tilt_is_gravity_turned_backwards_about_y(tmp_path, rig, shows):
    """What the scorer takes for granted when it compares a tilt with the printed angle."""
    made, model, motions, _ = rig_with(tmp_path, "load.tilt", (0.02,), rig=rig)
    assert replayed.error(model, motions[2], made.noise) > shows
    about_y = -0.02
    model.opt.gravity = [-9.81 * math.sin(about_y), 0.0, -9.81 * math.cos(about_y)]
    assert replayed.error(model, motions[2], made.noise) == pytest.approx(1.0, abs=0.05)


def test_the_network_learns_a_missing_force_and_leaves_a_complete_model_alone(tmp_path, monkeypatch):
    pytest.importorskip("torch")
    monkeypatch.setattr(network, "EPOCHS", 40)
    made, model, motions, _ = rig_with(tmp_path, "drag.quadratic", (30.0,))
    before = replayed.error(model, motions[2], made.noise)
    force = network.learn(model, motions[:2], made.noise)
    assert force is not None
    assert replayed.error(model, motions[2], made.noise, force) < 0.6 * before
    other = tmp_path / "complete"
    other.mkdir()
    made, model, motions, _ = rig_with(other)
    assert network.learn(model, motions[:2], made.noise) is None


def test_pysindy_finds_a_force_of_its_own_shape_and_leaves_a_complete_model_alone(tmp_path):
    pytest.importorskip("pysindy")
    made, model, motions, _ = rig_with(tmp_path, "drag.quadratic", (30.0,))
    before = replayed.error(model, motions[2], made.noise)
    force = sparse.discover(model, motions[:2], made.noise)
    assert force is not None
    assert replayed.error(model, motions[2], made.noise, force) < 0.05 * before
    assert 0 < np.count_nonzero(force.coefficients) < force.coefficients.size / 2
    still, moving = np.zeros((2, 1)), np.array([[-0.4], [0.4]])
    backwards, forwards = force(still, moving, still)[:, 0]
    assert backwards > 2 > -2 > forwards  # of a drag of 30 N s^2/m^2, 4.8 N; the command's terms share some of it
    other = tmp_path / "complete"
    other.mkdir()
    made, model, motions, _ = rig_with(other)
    assert sparse.discover(model, motions[:2], made.noise) is None


def test_sysid_finds_wrong_parameters(tmp_path):
    sysid = pytest.importorskip("mujoco.sysid")
    if not hasattr(sysid, "optimize"):
        pytest.skip("mujoco[sysid] is not installed")
    from dipc_gym.trials.entries import index
    from dipc_gym.trials.refit import refit

    def worn(parameters):
        parameters[index("damping", 0)] *= 0.5
        return parameters

    made, model, motions, _ = rig_with(tmp_path, nominal=worn)
    assert replayed.error(model, motions[2], made.noise) > 5
    better, factors = refit(tmp_path / "nominal.xml", motions[:1], made.noise)
    assert replayed.error(better, motions[2], made.noise) == pytest.approx(1.0, abs=0.1)
    # Damping, gear and mass together have a null space; their ratio has none.
    assert set(factors) == {"cart.damping", "motor.gear", "cart.mass"}


def test_a_perfect_force_comes_to_the_noise(tmp_path):
    """It is held over each step of the integration, which must cost nothing."""
    lost = []

    def oiled(parameters):
        lost.append(0.9 * parameters[index("damping", 0)])
        parameters[index("damping", 0)] -= lost[0]
        return parameters

    made, model, motions, _ = rig_with(tmp_path, rig="motor_axis", nominal=oiled)
    assert replayed.error(model, motions[2], made.noise) > 5
    found = replayed.error(model, motions[2], made.noise, lambda q, v, command: -lost[0] * v)
    assert found == pytest.approx(1.0, abs=0.05)


def test_a_rival_that_diverges_is_a_result(tmp_path, monkeypatch):
    pytest.importorskip("torch")
    pytest.importorskip("pysindy")
    rig_with(tmp_path)
    explodes = lambda q, *_: np.full_like(q, np.inf)  # noqa: E731
    monkeypatch.setattr("dipc_gym.trials.network.learn", lambda *_: explodes)
    monkeypatch.setattr("dipc_gym.trials.sparse.discover", lambda *_: None)
    monkeypatch.setattr("dipc_gym.trials.refit.refit", lambda path, *_: (mujoco.MjModel.from_xml_path(str(path)), {}))
    contest = rivals.Contest(folder=str(tmp_path), noise=(1e-5,))
    note = json.loads(json.dumps(contest.run(), allow_nan=False))
    contest.check(note)
    assert note["network"]["error"] is None
    assert note["network"]["kept"]
    assert not note["sparse"]["kept"]
    assert note["sparse"]["error"] == note["sysid"]["error"] > 0


def test_the_table_of_rivals(tmp_path, monkeypatch):
    plans = [generate.Plan(1, "null", CART, "", False)]
    plans += [generate.Plan(number, "single", CART, "load.spring", False) for number in (2, 3)]
    (tmp_path / "sealed").mkdir()
    for plan, size in zip(plans, (0.0, 30.0, 30.0), strict=True):
        start = 40.0 if size else 1.0
        answer = {
            **dict.fromkeys(("share_of_signal", "moved_from_nominal", "signal"), max(size, 1e-9)),
            **{key: {} for key in ("parameters", "equivalents", "equivalent_sets", "share_of_each")},
            **dict.fromkeys(("tuned", "recalibrated_suffices"), False),
            "known_friction": plan.number == 3,
            "trial": plan.name,
            "rig": CART,
            "kind": plan.kind,
            "missing": [{"effect": plan.effect, "at": CART, "also_at": []}] if plan.effect else [],
            "includes": [],
            "drive": dict.fromkeys(("gear", "rotor", "kt", "resistance"), 1.0),
            "held_out_predictable": True,
            "test_error": {"nominal": start, "recalibrated": start, "truth": 1.0},
            "noise": {"cart": 1e-5},
        }
        (tmp_path / "sealed" / f"{plan.name}.json").write_text(json.dumps(answer))
    asked = []

    def swept(contests, **_):
        for contest in contests:
            asked.append(contest.name)
            assert contest.noise == (1e-5,)
            errors = {"sysid": 20.0, "network": None if contest.name == plans[0].name else 4.0, "sparse": 0.5}
            yield contest.name, {rival: {"error": error, "seconds": 3.0} for rival, error in errors.items()}

    monkeypatch.setattr(rivals, "generate", lambda out, **_: plans)
    monkeypatch.setattr(rivals, "swept", swept)
    done = tmp_path / "results" / plans[1].name
    rivals.compare(tmp_path, seed=1)
    (done / "attempt.json").write_text(json.dumps({"seconds": 1.0, "failure": None, "sensor_errors": {"cart": 1.1e-5}}))
    rows = rivals.compare(tmp_path, seed=1)
    assert asked == [plan.name for plan in plans]  # nobody is asked twice
    assert [row["known_friction"] for row in rows] == [False, False, True]
    assert rows[1]["error"] == {
        "nominal": 40.0, "sysid": 20.0, "network": 4.0, "sparse": 0.5, "diagnose": pytest.approx(1.1), "truth": 1.0
    }  # fmt: skip
    text = (tmp_path / "rivals.md").read_text()
    assert "nothing missing (1)" in text
    assert "effects of twice the noise or more (1)" in text
    assert "Left out are 1 whose model has dry friction, which MuJoCo makes soft for rivals." in text
    assert "`diagnose` has no error in 1, not run or failed, which its medians leave out." in text
    assert "| residual network |  | 4 (4 to 4) |" in text
    assert "residual network diverges on the held-out recording in 1, which its medians leave out." in text
    assert "below `mujoco.sysid` refit in 1, residual network in 1, PySINDy on estimated forces in 0 of 1." in text
    assert json.loads((tmp_path / "rivals.json").read_text())["seed"] == 1

    (done / "attempt.json").write_text("{")  # the tables are written all the same, without it
    rows = rivals.compare(tmp_path, seed=1)
    assert rows[1]["error"]["diagnose"] is None
    assert rows[1]["error"]["network"] == 4.0
    assert (done / "attempt.json").read_text() == "{"


def test_a_complete_model_is_judged_complete_once_its_integration_is_exact(tmp_path):
    """At its file's own step this very model reads three times the noise, all of it owed to the integrator."""
    from dipc_gym.sim2real.replay import replay

    made, *_ = rig_with(tmp_path, rig="motor_axis")
    files = tmp_path / "nominal.xml", tmp_path / "test.csv"
    own, exact, finer = (
        replay(*files, window=0.25, step=step, threads=1).sensors[0].error / made.noise[0]
        for step in (None, 0.001, 0.0005)
    )
    assert own > 1.5
    assert exact == pytest.approx(1.0, abs=0.05)
    assert exact == pytest.approx(finer, abs=0.01)
    with pytest.raises(ValueError, match="no step"):
        replay(*files, step=0.0)
