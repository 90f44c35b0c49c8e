"""The blind trial: its physics, its secrecy, its answers and its scorer."""

import ast
import json
import math
import stat
import subprocess
import sys
from pathlib import Path

import mujoco
import numpy as np
import pytest
from paper import inches

pytest.importorskip("numba")

import dipc_gym
from dipc_gym.trials import (
    attempt,
    catalogue,
    generate,
    grade,
    integrator,
    prediction,
    publish,
    rigs,
    run,
    score,
    secret,
    shapes,
)
from dipc_gym.trials.entries import SIZE, index
from dipc_gym.trials.hidden import draw

PACKAGE = Path(dipc_gym.__file__).parent
PYTHON = sys.executable
GENERATOR = ("integrator", "rigs", "hidden", "catalogue", "shapes", "prediction", "secret", "generate")


def cart(**joint):
    parameters = np.zeros(SIZE)
    parameters[[index("m0"), index("resistance"), index("gravity"), index("kt")]] = 2.0, 1.0, 9.81, 1.0
    for name, value in joint.items():
        parameters[index(name, 0)] = value
    return parameters


def simulated(parameters, command, *, joints=1, start=None, speed=None, step=5e-5, dt=0.002, gain=None):
    count = len(command)
    start = np.zeros(joints) if start is None else np.asarray(start, dtype=float)
    q0 = np.tile(start, (count, 1))
    v0 = np.zeros((count, joints))
    if speed is not None:
        v0[0] = speed
    return integrator.simulate(
        parameters, joints, dt, step, np.asarray(command, dtype=float), np.ones(count) if gain is None else gain,
        integrator.NO_FEEDBACK, np.full(joints, 1e-9), np.zeros((count, joints)), q0, v0, q0, 0,
    )  # fmt: skip


# --- secrecy -------------------------------------------------------------------------------------------------


def imports(module: str) -> set[str]:
    path = PACKAGE.parent / Path(*module.split("."))
    file = path.with_suffix(".py") if path.with_suffix(".py").exists() else path / "__init__.py"
    found = set()
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            assert node.level == 0
            found |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return found


def reachable(module: str) -> set[str]:
    seen, todo = set(), [module]
    while todo:
        one = todo.pop()
        if one in seen:
            continue
        seen.add(one)
        place = PACKAGE.parent / Path(*one.split("."))
        if one.startswith("dipc_gym") and (place.with_suffix(".py").exists() or (place / "__init__.py").exists()):
            todo += imports(one)
    return seen


@pytest.mark.parametrize("name", GENERATOR)
def test_the_generator_knows_neither_the_tool_nor_mujoco(name):
    names = reachable(f"dipc_gym.trials.{name}")
    assert len(names) > 3
    assert not [n for n in names if n.split(".")[0] == "mujoco" or n.startswith("dipc_gym.sim2real")]


def test_nothing_of_the_tool_is_loaded_when_trials_are_made():
    code = "import sys, dipc_gym.trials.generate; print(*[m for m in sys.modules if m == 'mujoco' or 'sim2real' in m])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""


def test_the_tool_does_not_know_the_generator():
    files = list((PACKAGE / "sim2real").rglob("*.py"))
    assert files
    for file in files:
        module = ".".join(file.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__")
        assert not [n for n in imports(module) if n.startswith("dipc_gym.trials")], module


# --- physics -------------------------------------------------------------------------------------------------


def acceleration(parameters, q, v, force=0.0):
    state = np.zeros(integrator.STATE_SIZE)
    state[: len(q)], state[3 : 3 + len(v)] = q, v
    out, hold, rhs = np.zeros_like(state), np.zeros(3), np.zeros(3)
    free = np.full(len(q), integrator.FREE)
    integrator.derivative(0.0, state, force, parameters, len(q), free, out, hold, np.zeros((3, 3)), rhs)
    return out[3 : 3 + len(q)].copy()


def test_equations_of_motion_follow_from_the_lagrangian():
    sympy = pytest.importorskip("sympy")
    rig = rigs.hanging(np.random.default_rng(0))
    parameters = rig.parameters.copy()
    parameters[index("tilt")] = 0.3
    parameters[[index("kt"), index("ke"), index("resistance")]] = 1.0, 0.0, 1.0
    t = sympy.Symbol("t")
    q = [sympy.Function(f"q{i}")(t) for i in range(3)]
    m0, m1, m2, c1, c2, i1, i2, l1 = (
        float(parameters[index(n)]) for n in ("m0", "m1", "m2", "com1", "com2", "inertia1", "inertia2", "length1")
    )
    gx, gz = 9.81 * math.sin(0.3), -9.81 * math.cos(0.3)
    a1, a2 = q[1], q[1] + q[2]
    bodies = [
        (m0, 0.0, q[0], sympy.Integer(0), sympy.Integer(0)),
        (m1, i1, q[0] + c1 * sympy.sin(a1), c1 * sympy.cos(a1), a1),
        (m2, i2, q[0] + l1 * sympy.sin(a1) + c2 * sympy.sin(a2), l1 * sympy.cos(a1) + c2 * sympy.cos(a2), a2),
    ]
    lagrangian = sum(
        m * (x.diff(t) ** 2 + z.diff(t) ** 2) / 2 + i * a.diff(t) ** 2 / 2 + m * (gx * x + gz * z)
        for m, i, x, z, a in bodies
    )
    rng = np.random.default_rng(1)
    places, speeds = rng.uniform(-3, 3, 3), rng.uniform(-4, 4, 3)
    damping = np.array([parameters[index("damping", j)] for j in range(3)])
    found = acceleration(parameters, places, speeds, force=2.5)
    values = {q[i].diff(t, 2): found[i] for i in range(3)}
    values |= {q[i].diff(t): speeds[i] for i in range(3)}
    for i in range(3):
        left = lagrangian.diff(q[i].diff(t)).diff(t) - lagrangian.diff(q[i])
        number = left.subs(values).subs({q[k]: places[k] for k in range(3)})
        assert float(number) == pytest.approx((2.5 if i == 0 else 0.0) - damping[i] * speeds[i], abs=1e-9)


def energy(parameters, q, v):
    m0, m1, m2, c1, c2, i1, i2, l1 = (
        parameters[index(n)] for n in ("m0", "m1", "m2", "com1", "com2", "inertia1", "inertia2", "length1")
    )
    a1, a2, w1, w2 = q[:, 1], q[:, 1] + q[:, 2], v[:, 1], v[:, 1] + v[:, 2]
    x1, z1 = v[:, 0] + c1 * np.cos(a1) * w1, -c1 * np.sin(a1) * w1
    x2, z2 = v[:, 0] + l1 * np.cos(a1) * w1 + c2 * np.cos(a2) * w2, -l1 * np.sin(a1) * w1 - c2 * np.sin(a2) * w2
    moving = m0 * v[:, 0] ** 2 + m1 * (x1**2 + z1**2) + m2 * (x2**2 + z2**2) + i1 * w1**2 + i2 * w2**2
    height = 9.81 * (m1 * c1 * np.cos(a1) + m2 * (l1 * np.cos(a1) + c2 * np.cos(a2)))
    return moving / 2 + height


def test_energy_stays_without_losses_and_only_falls_with_dry_friction():
    parameters = rigs.hanging(np.random.default_rng(0)).parameters.copy()
    parameters[[index("damping", j) for j in range(3)]] = 0.0
    parameters[index("ke")] = 0.0
    q, v = simulated(parameters, np.zeros(2500), joints=3, start=(0.0, 2.0, 0.5))[:2]
    assert np.ptp(energy(parameters, q, v)) < 1e-7
    parameters[[index("coulomb", j) for j in range(3)]] = 0.3, 0.01, 0.005
    q, v = simulated(parameters, np.zeros(2500), joints=3, start=(0.0, 2.0, 0.5))[:2]
    lost = energy(parameters, q, v)
    assert np.diff(lost).max() < 1e-9
    friction = np.array([0.3, 0.01, 0.005])
    work = np.concatenate([[0], np.cumsum(np.abs(v[1:] + v[:-1]) / 2 @ friction) * 0.002])
    np.testing.assert_allclose(lost[0] - lost, work, atol=2e-3 * work[-1])


def test_a_sliding_cart_stops_where_coulomb_says_and_then_rests():
    parameters = cart(coulomb=3.0)
    q, v = simulated(parameters, np.zeros(1000), speed=0.8)[:2]
    assert q[-1, 0] == pytest.approx(0.8**2 / (2 * 1.5), rel=1e-9)
    assert np.all(v[600:] == 0.0)
    assert np.all(q[600:] == q[-1])


def test_static_friction_holds_below_its_level_and_breaks_away_at_it():
    parameters = cart(coulomb=2.0, excess=1.0, stribeck_speed=0.05)
    ramp = np.linspace(0.0, 4.0, 2001)
    q, v = simulated(parameters, ramp)[:2]
    moving = np.flatnonzero(v[:, 0])[0]
    assert ramp[moving - 2] <= 3.0 < ramp[moving]
    assert np.all(q[:moving] == 0.0)
    # Once it slides only the kinetic level is left.
    q, v = simulated(parameters, np.full(2000, 3.2))[:2]
    assert (v[-1, 0] - v[-501, 0]) / (500 * 0.002) == pytest.approx((3.2 - 2.0) / 2.0, rel=1e-3)


def test_bristles_deflect_before_they_slip_and_end_at_the_level():
    parameters = cart(coulomb=2.0, excess=1.0, stribeck_speed=0.05, bristle=1e4, bristle_damping=80.0, damping=1.0)
    # Pushed slowly the bristle follows dz/dx = 1 - s z / level, so x = -level / s ln(1 - force / level).
    q = simulated(parameters, np.minimum(np.linspace(0.0, 3.0, 4000), 1.5), step=1e-4)[0]
    assert q[-1, 0] == pytest.approx(-3.0 / 1e4 * math.log(1 - 1.5 / 3.0), rel=0.02)
    _, v = simulated(parameters, np.full(10_000, 4.0), step=5e-5)[:2]
    assert v[-1, 0] == pytest.approx(4.0 - 2.0, rel=1e-3)


def test_held_commands_fractional_delay_and_sensor_lag_against_the_closed_form():
    """Of m a = u - b v with u = 1 from the delay on."""
    parameters = cart(damping=4.0)
    parameters[index("delay")] = 0.0137
    q, _, reading = simulated(parameters, np.ones(500))[:3]
    t = np.maximum(np.arange(500) * 0.002 - 0.0137, 0.0)
    exact = t / 4 - (1 - np.exp(-2 * t)) / 8
    np.testing.assert_allclose(q[:, 0], exact, atol=1e-12)
    parameters[index("delay")] = 0.0
    parameters[index("lag", 0)] = 0.0137
    reading = simulated(parameters, np.ones(500))[2]
    np.testing.assert_allclose(reading[:, 0], exact, atol=3e-8)
    parameters[index("lag", 0)] = 0.0
    parameters[index("filter", 0)] = 0.02
    q, _, reading = simulated(parameters, np.ones(6000), step=1e-3)[:3]
    assert q[-1, 0] - reading[-1, 0] == pytest.approx(0.02 / 4, rel=1e-5)


@pytest.mark.parametrize("rig", ["cart", "hanging"])
@pytest.mark.parametrize(
    "hidden",
    [
        {"encoder_size": 0.004, "encoder_wave": 40.0, "encoder_phase": 0.7},
        {"encoder_size": 0.004, "encoder_wave": 40.0, "filter": 0.006, "bias": 0.02, "gain": 0.05},
        {"filter": 0.006, "bias": 0.02},
    ],
    ids=["eccentric", "all of it", "filter and bias"],
)
def test_readings_tell_the_states_that_they_were_made_of(rig, hidden):
    """Windows that begin at what noise-free readings say are predicted as those that begin at the truth."""
    rng = np.random.default_rng(4)
    made = rigs.RIGS[rig](rng)
    parameters = made.parameters.copy()
    for name, value in hidden.items():
        parameters[index(name) if name.startswith("encoder") else index(name, 0)] = value
    seen = prediction.record(made, parameters, rigs.excitation(made, "noise", rng), prediction.ONES, rng, step=2e-3)
    windows = prediction.Windows(made, seen, made.parameters)
    off = windows.residual(prediction.predict(made, parameters, seen), seen.reading)
    assert prediction.rms(off) < 0.02


def test_truth_predicts_a_rig_with_play_to_its_noise():
    """Where a contact begins shows: windows are predicted in steps as fine as the recording was made in."""
    rng = np.random.default_rng(0)
    made = rigs.RIGS["motor_axis"](rng)
    play = next(one for one in catalogue.effects(made) if one.name == "transmission.backlash")
    parameters = play.apply(made.parameters, np.array([0.04 * made.span[0]]))
    seen = prediction.record(made, parameters, rigs.excitation(made, "noise", rng), prediction.ONES, rng)
    windows = prediction.Windows(made, seen, made.parameters)
    predicted = prediction.predict(made, parameters, seen, true_initial=True)
    assert prediction.rms(windows.residual(predicted, seen.reading)) < 0.1


def test_friction_under_load_is_that_of_what_the_transmission_passes_on():
    """A motor that turns within the play presses nothing, at rest as in motion."""
    rng = np.random.default_rng(1)
    made = rigs.RIGS["cart"](rng)
    p = made.parameters.copy()
    for name, value in {"rotor": made.rotor, "stiffness": made.rotor * 700.0**2, "gap": 6e-3}.items():
        p[index(name)] = value
    p[index("per_load", 0)], p[index("constant", 0)] = 0.2, 0.5
    state, out = np.zeros(integrator.STATE_SIZE), np.zeros(integrator.STATE_SIZE)
    hold, mass, rhs = np.zeros(3), np.zeros((3, 3)), np.zeros(3)
    held = np.zeros(1, dtype=np.int64)
    passed_on = integrator.derivative(0.0, state, 3.0, p, 1, held, out, hold, mass, rhs)
    assert passed_on == 0.0
    assert abs(hold[0]) == pytest.approx(0.5)
    assert integrator._level(p, 0, 0.0, 0.0, 1, 0.0, passed_on) == 0.0


def test_winding_current_heat_and_limits():
    parameters = cart(damping=5.0)
    parameters[[index("inductance"), index("resistance"), index("ke")]] = 0.01, 2.0, 0.0
    v = simulated(parameters, np.full(3000, 4.0))[1]
    # Constant force after L/R = 5 ms: the speed lags by that time.
    assert v[-1, 0] == pytest.approx(4.0 / 2.0 / 5.0, rel=1e-6)
    parameters[[index("heat_coefficient"), index("heat_resistance"), index("heat_time")]] = 0.004, 10.0, 0.3
    v = simulated(parameters, np.full(3000, 4.0))[1]
    warm = 2.0 * (1 + 0.004 * 10.0 * 4.0**2 / (2.0 * 1.24))
    rise = 1.0
    for _ in range(100):  # the fixed point of R = R0 (1 + a Rth u^2 / R)
        rise = 1 + 0.004 * 10.0 * 4.0**2 / (2.0 * rise)
    assert abs(warm - 2.0 * rise) < 0.2
    assert v[-1, 0] == pytest.approx(4.0 / (2.0 * rise) / 5.0, rel=1e-4)
    parameters = cart(damping=5.0)
    parameters[index("dead")], parameters[index("vlimit")] = 0.5, 2.0
    v = simulated(parameters, np.full(3000, 9.0))[1]
    assert v[-1, 0] == pytest.approx(2.0 / 5.0)
    parameters[index("vlimit")] = 0.0
    assert simulated(parameters, np.full(300, 0.49))[0][-1, 0] == 0.0


def test_backlash_lets_the_rotor_run_and_compliance_rings_at_its_frequency():
    parameters = cart()
    parameters[[index("m0"), index("rotor"), index("stiffness"), index("gap")]] = 1.5, 0.5, 2e5, 0.01
    q = simulated(parameters, np.ones(200))[0]
    # The rotor crosses half the gap, 5 mm at 2 m/s^2, before anything moves.
    assert np.flatnonzero(np.abs(q[:, 0]) > 1e-9)[0] * 0.002 == pytest.approx(math.sqrt(2 * 0.005 / 2.0), abs=0.003)
    parameters[[index("gap"), index("stiffness")]] = 0.0, 400.0
    v = simulated(parameters, np.ones(5000))[1][:, 0]
    ringing = v - 0.5 * np.arange(5000) * 0.002
    crossings = np.count_nonzero(np.diff(np.sign(ringing - ringing.mean()))) / 2 / 10.0
    reduced = 1.5 * 0.5 / 2.0
    assert crossings == pytest.approx(math.sqrt(400.0 / reduced) / (2 * math.pi), rel=0.02)


@pytest.mark.parametrize("name", list(rigs.RIGS))
def test_the_nominal_model_is_the_same_in_mujoco(name):
    """The only place where MuJoCo and the integrator meet: without a secret both give the same motion."""
    rng = np.random.default_rng(5)
    rig = rigs.RIGS[name](rng)
    count = 1000
    command = rigs.excitation(rig, "chirp", rng)[:count]
    start = np.asarray(rig.start)
    q = simulated(rig.parameters, command if name != "upright" else 0 * command, joints=rig.count, start=start)[0]
    model = mujoco.MjModel.from_xml_string(rigs.nominal_xml(rig, rig.parameters))
    assert model.nu == 1
    assert model.nsensor == rig.count
    model.opt.timestep, model.opt.integrator = 1e-4, mujoco.mjtIntegrator.mjINT_RK4
    data = mujoco.MjData(model)
    data.qpos[:] = start
    if name == "upright":
        command, count = 0 * command, 150  # it falls
    seen = np.empty((count, rig.count))
    for k in range(count):
        seen[k] = data.qpos
        data.ctrl[0] = command[k]
        for _ in range(20):
            mujoco.mj_step(model, data)
    assert np.abs(seen - q[:count]).max(axis=0) == pytest.approx(np.zeros(rig.count), abs=float(rig.noise.min()))
    assert np.ptp(seen[:, -1]) > 20 * rig.noise[-1]


# --- secrets -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", list(rigs.RIGS))
def test_every_effect_shows_at_its_largest_and_keeps_the_balance_of_units(name):
    rng = np.random.default_rng(2)
    rig = rigs.RIGS[name](rng)
    drive = rigs.excitation(rig, "chirp", rng)
    clean = prediction.record(rig, rig.parameters, drive, prediction.ONES, np.random.default_rng(0), step=2.5e-4)
    seen = prediction.Windows(rig, clean, rig.parameters)
    assert prediction.rms(seen.residual(prediction.predict(rig, rig.parameters, clean), clean.reading)) < 1e-2
    for effect in [*catalogue.effects(rig), *catalogue.unknowns(rig)]:
        if not effect.parameters:
            continue
        low = effect.name == "motor.saturation"
        largest = np.array([n.low if low or n.name == "frequency" else n.high for n in effect.parameters])
        if effect.name == "transmission.compliance":
            largest = np.array([n.low for n in effect.parameters])
        parameters = effect.apply(rig.parameters, largest)
        changed = seen.residual(prediction.predict(rig, parameters, clean), clean.reading)
        blind = effect.name == "sensor.gain" and rig.count == 1 and name == "cart"
        assert blind or prediction.rms(changed) > 1.0, (effect.name, effect.at, effect.kind)


def test_catalogue_covers_every_id():
    ids = {e.name for make in rigs.RIGS.values() for e in catalogue.effects(make(np.random.default_rng(0)))}
    families = {
        "friction": "coulomb stribeck viscous asymmetric position load resting",
        "drag": "quadratic",
        "load": "constant tilt spring inertia position swinging creeping stop",
        "inertia": "mass",
        "motor": "deadzone saturation inductance back_emf cogging thermal",
        "timing": "delay sensor_lag",
        "transmission": "backlash compliance",
        "sensor": "bias gain eccentric",
        "disturbance": "periodic pulse",
    }
    assert ids == {f"{family}.{name}" for family, names in families.items() for name in names.split()}
    singles = {p.effect for p in generate.plans(1, full=True) if p.kind == "single"}
    assert singles == ids


def test_compositions_and_seeds():
    small, full = generate.plans(3), generate.plans(3, full=True)
    assert 38 <= len(small) <= 45
    assert sum(p.kind == "null" for p in small) == 15
    assert len(full) >= 400
    assert sum(p.kind == "null" for p in full) == 150
    assert generate.plans(3) == small
    assert generate.plans(4) != small
    assert len(generate.plans(3, count=7)) == 7
    assert {p.rig for p in small} == set(rigs.RIGS)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Four trials, made once."""
    out = tmp_path_factory.mktemp("made")
    (out / "sealed").mkdir()
    plans = [
        generate.Plan(1, "single", "cart", "load.tilt", False),
        generate.Plan(2, "single", "cart", "friction.viscous", True),
        generate.Plan(3, "null", "upright", "", False),
        generate.Plan(4, "wrong", "motor_axis", "", False),
        generate.Plan(5, "single", "cart", "friction.asymmetric", False),
    ]
    for plan in plans:
        generate.make_trial(out, plan, 11)
    return out, plans


def answer_of(out, plan):
    return json.loads((out / "sealed" / f"{plan.name}.json").read_text())


def test_folders_hold_what_a_rigs_owner_has_and_nothing_else(made):
    out, plans = made
    for plan in plans:
        folder = out / "trials" / plan.name
        assert {p.name for p in folder.iterdir()} == {"nominal.xml", "train_1.csv", "train_2.csv", "test.csv"}
        model = mujoco.MjModel.from_xml_path(str(folder / "nominal.xml"))
        names = ["time", model.actuator(0).name, *(model.sensor(i).name for i in range(model.nsensor))]
        for recording in ("train_1", "train_2", "test"):
            lines = (folder / f"{recording}.csv").read_text().splitlines()
            assert lines[0].split(",") == names
            table = np.array([[float(x) for x in line.split(",")] for line in lines[1:]])
            assert table.shape == (10_000, len(names))
            np.testing.assert_allclose(np.diff(table[:, 0]), 0.002, atol=1e-9)
            rig = rigs.RIGS[plan.rig](np.random.default_rng(0))
            steps = table[:, 2:] / rig.quantum
            assert np.abs(steps - np.round(steps)).max() < 1e-3
        text = (folder / "nominal.xml").read_text()
        assert not [word for word in ("tilt", "viscous", "null", "wrong") if word in text]


def test_answers_know_what_cannot_be_told_apart(made):
    out, plans = made
    tilt, viscous, null, wrong, asymmetric = (answer_of(out, plan) for plan in plans)
    assert tilt["equivalents"]["load.tilt@world"] == [{"effect": "load.constant", "at": "cart"}]
    assert not tilt["recalibrated_suffices"]
    # Levels of 3 +- 1 N are 3 N and a constant load of 1 N, sliding and held.
    names = [[e["effect"] for e in s] for s in asymmetric["equivalent_sets"]["friction.asymmetric@cart"]]
    assert names == [["friction.coulomb", "load.constant"]]
    assert asymmetric["equivalents"] == {"friction.asymmetric@cart": []}
    # A refit of damping and motor constant is the truth; a tuned simulator would have nothing left to find.
    assert viscous["recalibrated_suffices"]
    assert not viscous["tuned"]
    assert {"effect": "motor.back_emf", "at": "motor"} in viscous["equivalents"]["friction.viscous@cart"]
    assert null["missing"] == null["wrong"] == []
    assert null["test_error"]["nominal"] == pytest.approx(1.0, abs=0.1)
    assert wrong["wrong"]
    assert wrong["test_error"]["nominal"] > wrong["test_error"]["truth"] * 1.02
    assert wrong["test_error"]["recalibrated"] == pytest.approx(wrong["test_error"]["truth"], rel=1e-3)
    for answer in (tilt, viscous, null, wrong):
        assert answer["test_error"]["truth"] == pytest.approx(1.0, abs=0.1)


def test_a_force_along_the_way_may_repeat_as_often_as_cogging_does(tmp_path):
    """The pitch of a motor's cogging lies beyond what is drawn for such forces, and they are one and the same model."""
    plans = ((seed, plan) for seed in range(50) for plan in generate.plans(seed))
    seed, plan = next(each for each in plans if each[1].effect == "motor.cogging" and each[1].rig == "cart")
    (tmp_path / "sealed").mkdir()
    generate.make_trial(tmp_path, plan, seed)
    answer = answer_of(tmp_path, plan)
    assert answer["equivalents"]["motor.cogging@motor"] == [{"effect": "load.position", "at": plan.rig}]


def test_an_effect_may_show_nothing_but_the_plainer_one_that_it_includes(tmp_path):
    """Friction that grows while a joint rests is plain friction on a rig that balances and never rests."""
    plan = secret.Plan(1, "single", "upright", "friction.resting", False)
    (tmp_path / "sealed").mkdir()
    generate.make_trial(tmp_path, plan, 42)  # it leaves 0.005 of the noise; 0.1 is as good as nothing
    answer = answer_of(tmp_path, plan)
    assert {"effect": "friction.coulomb", "at": "cart"} in answer["equivalents"]["friction.resting@cart"]


def test_a_trial_is_the_same_every_time(made, tmp_path):
    out, plans = made
    (tmp_path / "sealed").mkdir()
    generate.make_trial(tmp_path, plans[2], 11)
    for name in ("nominal.xml", "train_1.csv", "train_2.csv", "test.csv"):
        again = (tmp_path / "trials" / plans[2].name / name).read_bytes()
        assert again == (out / "trials" / plans[2].name / name).read_bytes()


def test_an_interrupted_run_goes_on_and_another_seed_is_refused(tmp_path, monkeypatch):
    done = []

    def make(out, plan, seed):
        if len(done) == 2:
            raise KeyboardInterrupt
        done.append(plan.name)
        (out / "sealed" / f"{plan.name}.json").write_text(json.dumps(sealed(plan.kind, []) | {"trial": plan.name}))

    monkeypatch.setattr(generate, "make_trial", make)
    with pytest.raises(KeyboardInterrupt):
        generate.generate(tmp_path, seed=1, count=4)
    first = list(done)
    done.clear()
    monkeypatch.setattr(generate, "make_trial", lambda out, plan, seed: done.append(plan.name))
    generate.generate(tmp_path, seed=1, count=4)
    assert len(first) == len(done) == 2
    assert not set(first) & set(done)
    with pytest.raises(ValueError, match=r"generator\.json.*choose another folder"):
        generate.generate(tmp_path, seed=2, count=4)


# --- the scorer ----------------------------------------------------------------------------------------------


def sealed(kind="single", missing=(("friction.coulomb", "cart"),), **other):
    return {
        "trial": "t001_cart",
        "rig": "cart",
        "kind": kind,
        "tuned": False,
        "known_friction": False,
        "missing": [{"effect": e, "at": at, "also_at": [], "kind": ""} for e, at in missing],
        "includes": [],
        "parameters": {"friction.coulomb@cart": {"level": {"value": 3.0, "unit": "N"}}},
        "equivalents": {},
        "recalibrated_suffices": False,
        "share_of_signal": 10.0,
        "share_of_each": {},
        "equivalent_sets": {},
        "moved_from_nominal": 10.0,
        "signal": 100.0,
        "drive": {"gear": 2.0, "rotor": 0.1, "kt": 3.0, "resistance": 1.5},
        "held_out_predictable": True,
        "test_error": {"nominal": 12.0, "recalibrated": 10.0, "truth": 1.0},
        "noise": {"cart": 1e-5},
    } | other


def said(*effects_, verdict="explained", recalibrated=()):
    return {"verdict": verdict, "missing": list(effects_), "recalibrated": list(recalibrated)}


def one(effect, at="cart", same=(), **parameters):
    return {
        "effect": effect,
        "at": at,
        "same_here": [dict(zip(("effect", "at"), name.split("@"), strict=True)) for name in same],
        "parameters": {k: {"value": v[0], "low": v[1], "high": v[2]} for k, v in parameters.items()},
    }


FINE = {"seconds": 5.0, "failure": None, "sensor_errors": {"cart": 1.9e-5}}


def test_a_right_name_at_another_joint_is_in_no_right_set():
    judged = grade.grade(sealed(), said(one("friction.coulomb", "pole1")), FINE)
    assert (judged.name, judged.set, judged.place) == (True, False, False)


def test_a_failed_diagnosis_of_unknown_physics_is_no_case_without_a_false_name():
    judged = grade.grade(sealed(kind="unknown"), None, FINE | {"failure": "stopped"})
    assert (judged.unknown, judged.misnamed) == (False, None)


def test_the_truth_is_right_and_a_stranger_is_not():
    judged = grade.grade(sealed(), said(one("friction.coulomb", level=(3.1, 2.9, 3.2))), FINE)
    assert (judged.name, judged.set, judged.place, judged.route) == (True, True, True, "truth")
    assert (judged.inside, judged.printed, judged.parameters) == (1, 1, 1)
    assert judged.reached == pytest.approx((10 - 1.9) / (10 - 1))
    judged = grade.grade(sealed(), said(one("motor.deadzone", "motor"), one("friction.coulomb")), FINE)
    assert (judged.name, judged.set, judged.place) == (False, False, False)
    judged = grade.grade(sealed(), said(one("friction.coulomb", "pole1", level=(3.1, 2.9, 3.2))), FINE)
    assert (judged.name, judged.place, judged.printed) == (True, False, 0)
    judged = grade.grade(sealed(), said(one("friction.coulomb", level=(3.1, None, None))), FINE)
    assert (judged.printed, judged.parameters) == (0, 1)
    judged = grade.grade(sealed(), said(one("friction.coulomb", level=(3.4, 3.2, 3.6))), FINE)
    assert (judged.inside, judged.printed) == (0, 1)


def test_another_name_counts_only_if_it_is_the_same_and_the_tool_says_so():
    answer = sealed(
        missing=[("load.tilt", "world")], equivalents={"load.tilt@world": [{"effect": "load.constant", "at": "cart"}]}
    )
    open_ = grade.grade(answer, said(one("load.constant", same=["load.tilt@world"])), FINE)
    assert (open_.name, open_.set, open_.place, open_.route) == (True, True, True, "same")
    silent = grade.grade(answer, said(one("load.constant")), FINE)
    assert (silent.name, silent.set, silent.place) == (False, False, True)
    elsewhere = grade.grade(answer, said(one("load.constant", same=["load.tilt@pole1"])), FINE)
    assert (elsewhere.name, elsewhere.route) == (False, "")
    boast = grade.grade(sealed(), said(one("motor.deadzone", same=["friction.coulomb@cart"])), FINE)
    assert boast.name is False


def test_parts_pairs_and_refits():
    curve = sealed(missing=[("friction.stribeck", "cart")], includes=["friction.coulomb"])
    assert grade.grade(curve, said(one("friction.coulomb"), one("friction.stribeck")), FINE).route == "part"
    assert grade.grade(curve, said(one("friction.coulomb")), FINE).name is False
    pair = sealed("pair", [("friction.coulomb", "cart"), ("load.spring", "cart")])
    half = grade.grade(pair, said(one("load.spring")), FINE)
    assert (half.name, half.set) == (True, False)
    both = grade.grade(pair, said(one("load.spring"), one("friction.coulomb")), FINE)
    assert (both.name, both.set) == (True, True)
    more = grade.grade(pair, said(one("load.spring"), one("friction.coulomb"), one("timing.delay")), FINE)
    assert (more.name, more.set) == (True, False)
    faint = pair | {"share_of_each": {"friction.coulomb@cart": 0.2, "load.spring@cart": 9.0}}
    assert grade.grade(faint, said(one("load.spring")), FINE).set is True
    assert grade.grade(faint, said(one("load.spring"), one("timing.delay")), FINE).set is False
    both = [{"effect": "friction.coulomb", "at": "cart"}, {"effect": "load.constant", "at": "cart"}]
    split = sealed(missing=[("friction.asymmetric", "cart")], equivalent_sets={"friction.asymmetric@cart": [both]})
    told = [one("friction.coulomb", same=["friction.asymmetric@cart"]), one("load.constant")]
    assert grade.grade(split, said(*told), FINE).route == "same"
    assert grade.grade(split, said(told[0]), FINE).name is False
    assert grade.grade(split, said(one("friction.coulomb"), told[1]), FINE).name is False
    number = sealed(missing=[("friction.viscous", "cart")], recalibrated_suffices=True)
    assert grade.grade(number, said(verdict="recalibrated"), FINE).route == "refit"
    assert grade.grade(number, said(one("friction.viscous")), FINE).name is True
    assert grade.grade(sealed(), said(verdict="recalibrated"), FINE).name is False


def test_several_effects_that_are_the_truth_stand_for_it_beside_others():
    both = [{"effect": "load.constant", "at": "cart"}, {"effect": "sensor.bias", "at": "pole1"}]
    pair = sealed(
        "pair",
        [("load.tilt", "world"), ("motor.deadzone", "motor")],
        equivalent_sets={"load.tilt@world": [both], "motor.deadzone@motor": []},
    )
    told = [one("motor.deadzone", "motor"), one("sensor.bias", "pole1", same=["load.tilt@world"]), one("load.constant")]
    judged = grade.grade(pair, said(*told), FINE)
    assert (judged.name, judged.set, judged.route) == (True, True, "truth")
    assert grade.grade(pair, said(*told[1:], told[0]), FINE).route == "same"
    assert grade.grade(pair, said(told[0], one("sensor.bias", "pole2"), told[2]), FINE).set is False
    assert grade.grade(pair, said(*told, one("timing.delay")), FINE).set is False


def test_what_a_refit_explains_has_its_size_beyond_the_nominal_model():
    faint = sealed(share_of_signal=0.1, recalibrated_suffices=True)
    judged = grade.grade(faint, said(one("motor.deadzone")), FINE)
    assert (judged.size, judged.share, judged.clear) == (10.0, 0.1, True)  # right or wrong, it counts
    assert not grade.grade(sealed(share_of_signal=1.9), said(), FINE).clear
    assert not grade.grade(sealed("null", []), said(), FINE).clear
    # Nothing said is no place found.
    assert grade.grade(sealed(), said(verdict="consistent"), FINE).place is False


@pytest.mark.parametrize(
    ("effect", "numbers", "printed"),
    [
        ("load.tilt", {"tilt": 0.02}, {"about_y": -0.02}),
        ("motor.back_emf", {"back_emf": 0.5}, {"coefficient": 1.0}),
        ("motor.inductance", {"inductance": 0.003}, {"time_constant": 0.002}),
        ("disturbance.periodic", {"frequency": math.tau, "amplitude": 2.0, "phase": 0.0}, {"frequency": 1, "sine": 2}),
        ("motor.cogging", {"amplitude": 3.0, "wave": 12.0, "phase": math.pi / 2}, {"cosine": 1.5, "poles": 6.0}),
        ("load.position", {"amplitude": 3.0, "wave": math.pi, "phase": 0.0}, {"sine": 3.0, "wavelength": 2.0}),
        ("friction.load", {"slope": 0.1}, {"by_drive": 0.1}),
        (
            "friction.position",
            {"level": 2.0, "variation": 0.5, "wave": math.pi, "phase": 0.0},
            {"level": 2.0, "sine": 1.0, "cosine": 0.0, "wavelength": 2.0},
        ),
        ("sensor.gain", {"gain": -0.02}, {"gain": 0.98}),
        (
            "sensor.eccentric",
            {"amplitude": 0.002, "wave": math.tau / 0.08, "phase": math.pi / 2},
            {"sine": 0.0, "cosine": 0.002, "wavelength": 0.08},
        ),
    ],
)
def test_true_values_stand_under_the_names_that_are_printed(effect, numbers, printed):
    answer = sealed(
        missing=[(effect, "cart")],
        parameters={f"{effect}@cart": {name: {"value": value, "unit": ""} for name, value in numbers.items()}},
    )
    around = {name: (value, value - 1e-9, value + 1e-9) for name, value in printed.items()}
    judged = grade.grade(answer, said(one(effect, **around)), FINE)
    assert (judged.inside, judged.printed) == (len(printed), len(printed))


def test_false_alarms_wrong_parameters_and_the_unknown():
    null = sealed("null", [])
    assert grade.grade(null, said(verdict="consistent"), FINE).alarm is False
    assert grade.grade(null, said(verdict="cannot tell"), FINE).alarm is False
    assert grade.grade(null, said(verdict="unexplained"), FINE).alarm is True
    assert grade.grade(null, said(one("unknown")), FINE).alarm is True
    renumbered = grade.grade(null, said(verdict="recalibrated", recalibrated=[{}]), FINE)
    assert (renumbered.alarm, renumbered.renumbered) == (False, True)
    wrong = sealed("wrong", [])
    assert grade.grade(wrong, said(verdict="recalibrated"), FINE).name is True
    assert grade.grade(wrong, said(one("friction.viscous")), FINE).name is False
    unknown = sealed("unknown", [("unknown", "cart")], includes=["friction.coulomb"], held_out_predictable=False)
    for diagnosis in (said(one("unknown")), said(verdict="unexplained"), said(one("friction.coulomb"), one("unknown"))):
        judged = grade.grade(unknown, diagnosis, FINE)
        assert (judged.unknown, judged.misnamed) == (True, False)
    judged = grade.grade(unknown, said(one("friction.load")), FINE)
    assert (judged.unknown, judged.misnamed, judged.reached) == (False, True, None)
    part = said(one("friction.coulomb"))
    assert grade.grade(unknown, part, FINE).unknown is False
    whole = unknown | {"equivalents": {"unknown@cart": [{"effect": "friction.coulomb", "at": "cart"}]}}
    assert grade.grade(whole, part, FINE).unknown is True


def test_a_law_and_the_effect_beside_it_are_judged_each_by_itself():
    two = sealed(
        "single",
        [("motor.map", "motor"), ("friction.coulomb", "cart")],
        beside=True,
        share_of_each={"motor.map@motor": 7.0, "friction.coulomb@cart": 5.0},
    )
    level = one("friction.coulomb", level=(3.1, 2.9, 3.2))
    judged = grade.grade(two, said(level, one("motor.map", "motor")), FINE)
    assert (judged.name, judged.set, judged.place, judged.beside, judged.size) == (True, True, True, True, 7.0)
    assert (judged.inside, judged.printed, judged.said) == (1, 1, ["motor.map"])
    judged = grade.grade(two, said(level), FINE)
    assert (judged.name, judged.beside) == (False, True)
    judged = grade.grade(two, said(one("motor.map", "motor"), one("friction.coulomb", "pole1")), FINE)
    assert (judged.name, judged.set, judged.beside) == (True, False, False)
    faint = two | {"share_of_each": {"motor.map@motor": 7.0, "friction.coulomb@cart": 1.0}}
    assert grade.grade(faint, said(one("motor.map", "motor")), FINE).beside is None
    nameless = sealed(
        "unknown",
        [("unknown", "cart"), ("friction.coulomb", "cart")],
        beside=True,
        share_of_each={"unknown@cart": 7.0, "friction.coulomb@cart": 5.0},
    )
    judged = grade.grade(nameless, said(one("unknown"), level), FINE)
    assert (judged.unknown, judged.misnamed, judged.beside, judged.inside) == (True, False, True, 1)
    judged = grade.grade(nameless, said(level, one("load.spring")), FINE)
    assert (judged.unknown, judged.misnamed, judged.beside) == (False, True, True)


def test_a_formula_is_right_if_it_is_the_truth_and_nothing_more():
    thins = {"unknown@cart": {"thin_shear": {"value": 0.5, "unit": "m/s"}}}
    hidden = sealed("unknown", [("unknown", "cart")], parameters=thins)

    def judged(*terms, size=10.0, at="cart", of="recent velocity cart"):
        law = {"law": {"of": [of], "formula": {"terms": list(terms)} if terms else None}}
        return grade.grade(hidden | {"share_of_signal": size}, said(one("unknown", at) | law), FINE).formula

    near, far = ({"kind": "exponential", "factors": [1.0], "scale": scale} for scale in (0.53, 0.555))
    assert judged(near, at="pole1") is False
    assert judged(near, of="time") is False
    assert judged(near) is True
    assert judged(far) is False
    assert judged({"kind": "line", "factors": [1.0]}) is False
    assert judged(near, {"kind": "line", "factors": [1e-9]}) is False
    assert judged() is False
    assert judged(near, size=1.0) is None
    assert grade.grade(hidden, said(), FINE).formula is False
    assert grade.grade(sealed("unknown", [("unknown", "cart")]), said(one("unknown")), FINE).formula is None


def test_a_third_of_the_laws_stands_beside_what_machines_usually_have(tmp_path):
    plans = generate.plans(5, laws=True)
    assert 25 <= sum(plan.beside for plan in plans) <= 55
    assert not any(plan.beside for plan in plans if plan.kind == "null")
    assert not any(plan.beside for plan in generate.plans(5, full=True))
    (tmp_path / "sealed").mkdir()
    plan = generate.Plan(1, "single", "cart", "motor.map", False, laws=True, beside=True)
    generate.make_trial(tmp_path, plan, 3)
    held = answer_of(tmp_path, plan)
    law, usual = held["missing"]
    assert (law["effect"], usual["effect"] in secret.USUAL) == ("motor.map", True)
    assert held["share_of_each"].keys() == {f"{m['effect']}@{m['at']}" for m in held["missing"]}


@pytest.mark.parametrize(
    ("law", "beside"),
    [
        ("friction.speed", {"load.constant"}),
        ("friction.position", {"load.constant", "drag.quadratic"}),
        ("load.position", {"friction.coulomb", "drag.quadratic"}),
        ("motor.map", {"friction.coulomb", "drag.quadratic", "load.constant"}),
    ],
)
def test_what_a_law_may_have_in_itself_is_not_hidden_beside_it(law, beside):
    """Nobody could tell the two apart."""
    rng = np.random.default_rng(1)
    rig = rigs.RIGS["cart"](rng)
    hidden = draw(next(effect for effect in shapes.named(rig) if effect.name == law), rng)
    usual = [secret._usual(rig, hidden, rng) for _ in range(40)]
    assert {one.effect.name for one in usual} == beside
    assert {one.effect.at for one in usual} == {rig.joints[0]}


def test_a_failed_diagnosis_is_a_wrong_one():
    broken = {"seconds": 1.0, "failure": "it broke", "sensor_errors": None}
    judged = grade.grade(sealed(), None, broken)
    assert (judged.verdict, judged.name, judged.set, judged.reached) == ("failed", False, False, None)
    assert grade.grade(sealed("wrong", []), None, broken).name is False
    # Failing on a null is no way to keep the false alarms down.
    lamed = {**said(one("friction.coulomb")), "notes": [f"More could not be worked out. {grade.BROKEN}."]}
    assert grade.grade(sealed(), lamed, FINE).broken
    assert not grade.grade(sealed(), said(one("friction.coulomb")), FINE).broken
    null = grade.grade(sealed("null", []), None, broken)
    assert null.alarm is None
    assert score.summarise([null])["summary"]["nulls"] == 0


@pytest.mark.parametrize(("events", "trials"), [(0, 150), (3, 150), (7, 15)])
def test_upper_bound_is_the_rate_that_makes_so_few_events_rare(events, trials):
    rate = score.upper_bound(events, trials)
    chance = sum(math.comb(trials, k) * rate**k * (1 - rate) ** (trials - k) for k in range(events + 1))
    assert chance == pytest.approx(0.05, rel=1e-6)
    assert score.upper_bound(5, 5) == 1.0


def test_the_report_counts_what_was_judged(tmp_path):
    cases = {
        "t001_cart": (sealed(), said(one("friction.coulomb", level=(3.1, 2.9, 3.2)))),
        "t002_cart": (sealed(), said(one("motor.deadzone", "motor"))),
        "t003_cart": (sealed(share_of_signal=0.5), said(verdict="consistent")),
        "t004_cart": (sealed("null", []), said(verdict="consistent")),
        "t005_cart": (sealed("null", []), said(one("timing.delay", "motor"))),
        "t006_cart": (sealed("unknown", [("unknown", "cart")]), said(verdict="unexplained")),
        "t007_cart": (sealed("wrong", []), None),
        "t008_cart": (sealed("unknown", [("unknown", "cart")], share_of_signal=0.5), said(verdict="consistent")),
    }
    (tmp_path / "sealed").mkdir()
    for name, (answer, diagnosis) in cases.items():
        (tmp_path / "sealed" / f"{name}.json").write_text(json.dumps(answer | {"trial": name}))
        place = tmp_path / "results" / name
        place.mkdir(parents=True)
        if diagnosis:
            (place / "diagnosis.json").write_text(json.dumps(diagnosis))
        (place / "attempt.json").write_text(json.dumps(FINE if diagnosis else FINE | {"failure": "broke"}))
    scores = score.score(tmp_path, [*cases, "t009_cart"])
    summary = scores["summary"]
    assert scores["open"] == 1
    assert summary["failed"] == ["t007_cart"]
    assert summary["name"] == {"right": 1, "of": 2, "rate": 0.5}
    assert summary["name_all_sizes"]["of"] == 3
    assert (summary["false_alarms"], summary["nulls"]) == (1, 2)
    assert summary["unknown"] == {"right": 1, "of": 1, "rate": 1.0}  # one does not show
    assert summary["interval_coverage"] == {"right": 1, "of": 1, "rate": 1.0}
    assert scores["confusion"]["friction.coulomb"] == {"friction.coulomb": 1, "motor.deadzone": 1, "(consistent)": 1}
    assert sum(row["trials"] for row in scores["by_size"]) == 3
    publish.write_report(tmp_path, scores, seed=1)
    text = (tmp_path / "report.md").read_text()
    assert "| right name first | 50 % (1 of 2): 1 by truth |" in text
    assert "1 of 2 (95 % upper bound 97.5 %)" in text
    assert json.loads((tmp_path / "report.json").read_text())["seed"] == 1
    assert (tmp_path / "report.png").read_bytes().startswith(b"\x89PNG")
    assert [inches(tmp_path / name) for name in ("report.pdf", "report-narrow.pdf")] == [7.0, 3.4]


def test_nothing_judged_yet_is_a_report_too(tmp_path):
    publish.write_report(tmp_path, score.score(tmp_path, ["t001_cart"]), seed=1)
    assert "0 trials" in (tmp_path / "report.md").read_text()
    assert not (tmp_path / "report.png").exists()


def test_pairs_alone_have_no_single_name_to_be_mistaken(tmp_path):
    scores = score.score(tmp_path, ["t001_cart"]) | {"by_size": [], "confusion": {}}
    assert len(publish.figure(scores).axes) == 2


def test_what_is_kept_replaces_files_and_leaves_folders(tmp_path):
    (tmp_path / "of the owner").mkdir()
    (tmp_path / "report.html").write_text("old")
    run._keep({"attempt.json": "{}"}, tmp_path)
    assert sorted(one.name for one in tmp_path.iterdir()) == ["attempt.json", "of the owner"]


def test_an_attempt_outlives_a_recording_that_was_damaged(tmp_path):
    """The seed makes the recording again, the same; what was diagnosed stays."""
    for folder in ("sealed", "results/t001_cart", "trials/t001_cart"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "results/t001_cart/attempt.json").write_text(json.dumps(FINE | {"tool": run.tool()}))
    for answer in (sealed("null", []) | {"trial": "t001_cart", "files": {"test.csv": "0" * 64}}, {}):
        (tmp_path / "sealed/t001_cart.json").write_text(json.dumps(answer))
        assert run._done(tmp_path, "t001_cart")
        assert (tmp_path / "results/t001_cart/attempt.json").exists()


# --- running the tool ----------------------------------------------------------------------------------------


def fake_tool(tmp_path, body):
    """Something that stands where `python -m dipc_gym` stands."""
    script = tmp_path / "python"
    script.write_text(f"#!{PYTHON}\nimport json, os, pathlib, sys\nargs = sys.argv[3:]\n{body}\n")
    script.chmod(script.stat().st_mode | stat.S_IEXEC)
    return str(script)


def folder_with_recordings(tmp_path):
    folder = tmp_path / "trials" / "t001_cart"
    folder.mkdir(parents=True)
    for name in ("nominal.xml", "train_1.csv", "train_2.csv", "test.csv"):
        (folder / name).write_text(name)
    return folder


def attempted(folder, *, limit=60.0):
    """What an attempt gives: its note, and all files by name."""
    texts = attempt.Attempt(folder=str(folder), seed=0, limit=limit).run()
    return json.loads(texts["attempt.json"]), texts


def test_the_tool_sees_what_it_is_given_and_nothing_else(tmp_path, monkeypatch):
    body = """
out = pathlib.Path(args[args.index("--out") + 1])
out.mkdir(parents=True)
(out / "diagnosis.json").write_text(json.dumps({"args": args, "files": sorted(os.listdir())}))
"""
    monkeypatch.setattr(sys, "executable", fake_tool(tmp_path, body))
    found = attempt.run_tool(folder_with_recordings(tmp_path), tmp_path / "result", seed=3)
    assert found["files"] == ["nominal.xml", "train_1.csv", "train_2.csv"]
    assert found["args"][:4] == ["diagnose", "nominal.xml", "train_1.csv", "train_2.csv"]


def test_a_tool_that_breaks_is_noted_with_its_last_words(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "executable", fake_tool(tmp_path, 'sys.exit("out of ideas")'))
    note, texts = attempted(folder_with_recordings(tmp_path))
    assert "out of ideas" in note["failure"]
    assert note["sensor_errors"] is None
    assert list(texts) == ["attempt.json"]
    monkeypatch.setattr(sys, "executable", fake_tool(tmp_path, "import time; time.sleep(30)"))
    with pytest.raises(RuntimeError, match="took longer"):
        attempt.run_tool(tmp_path / "trials" / "t001_cart", tmp_path / "result", patience=0.5)


def test_time_that_is_up_is_told_and_an_interruption_is_no_failure(tmp_path, monkeypatch):
    folder = folder_with_recordings(tmp_path)
    monkeypatch.setattr(sys, "executable", fake_tool(tmp_path, "import time; time.sleep(30)"))
    note, _ = attempted(folder, limit=0.5)
    assert note["timed_out"]
    assert note["limit"] == 0.5
    assert grade.grade(sealed(), said(one("friction.coulomb")), note).verdict == "failed"
    monkeypatch.setattr(sys, "executable", fake_tool(tmp_path, "sys.exit(130)"))
    with pytest.raises(KeyboardInterrupt):
        attempted(folder)


def test_a_diagnosis_that_cannot_be_read_or_replayed_is_noted(tmp_path, monkeypatch):
    folder = folder_with_recordings(tmp_path)
    torn = """
out = pathlib.Path(args[args.index("--out") + 1])
out.mkdir(parents=True)
(out / "diagnosis.json").write_text('{"verdict"')
"""
    monkeypatch.setattr(sys, "executable", fake_tool(tmp_path, torn))
    note, texts = attempted(folder)
    assert "is not JSON" in note["failure"]
    assert texts["diagnosis.json"] == '{"verdict"'
    whole = torn.replace("""'{"verdict"'""", """'{"verdict": "consistent"}'""")
    whole = "if args[0] == 'replay': sys.exit('no window')\n" + whole
    monkeypatch.setattr(sys, "executable", fake_tool(tmp_path, whole))
    note, _ = attempted(folder)
    assert note["failure"] is None
    assert "no window" in note["replay_failure"]


def given_back(note):
    """What an attempt gives that said nothing is missing."""
    return {"attempt.json": json.dumps(note), "diagnosis.json": json.dumps(said(verdict="consistent"))}


def test_what_breaks_off_is_said_and_stays_open(tmp_path, capsys):
    gone = attempt.Attempt(folder=str(tmp_path / "t001_cart"), seed=0, limit=1.0)
    assert list(run.swept([gone], jobs=1, backend="local", label="diagnose")) == []
    said = capsys.readouterr().err
    assert "t001_cart: FileNotFoundError" in said
    assert "the same command tries it again" in said


def test_ctrl_c_scores_what_is_done_nulls_first(tmp_path, monkeypatch):
    plans = [generate.Plan(1, "single", "cart", "load.spring", False), generate.Plan(2, "null", "cart", "", False)]
    (tmp_path / "sealed").mkdir()
    for plan in plans:
        (tmp_path / "sealed" / f"{plan.name}.json").write_text(json.dumps(sealed("null", []) | {"trial": plan.name}))

    def swept(cells, **_):
        for cell in cells:
            if cell.name == plans[0].name:
                raise KeyboardInterrupt
            yield cell.name, given_back(FINE)

    monkeypatch.setattr(run, "plans", lambda seed, **_: plans)
    monkeypatch.setattr(run, "generate", lambda out, **_: plans)
    monkeypatch.setattr(run, "swept", swept)
    with pytest.raises(KeyboardInterrupt):
        run.trial(tmp_path, seed=1)
    assert (
        "1 trials, 0 failed (0 of them out of time), 0 with a stage that failed inside, 1 open"
        in (tmp_path / "report.md").read_text()
    )


def test_a_run_that_was_stopped_goes_on_and_tries_failures_again(tmp_path, monkeypatch):
    plans = [generate.Plan(k, "null", "cart", "", False) for k in (1, 2, 3)]
    (tmp_path / "sealed").mkdir()
    for plan in plans:
        answer = sealed("null", []) | {"trial": plan.name}
        (tmp_path / "sealed" / f"{plan.name}.json").write_text(json.dumps(answer))
    asked, versions = [], ["one"]
    monkeypatch.setattr(run, "tool", lambda: versions[-1])

    def swept(cells, **_):
        for cell in cells:
            asked.append(cell.name)
            fails = cell.name == plans[1].name and len(asked) <= 3
            yield cell.name, given_back(FINE | {"failure": "broke" if fails else None, "tool": versions[-1]})

    made = []
    monkeypatch.setattr(run, "plans", lambda seed, **_: plans)
    monkeypatch.setattr(run, "generate", lambda out, **_: made.append(out))
    monkeypatch.setattr(run, "swept", swept)
    run.trial(tmp_path, seed=1)
    assert asked == [plan.name for plan in plans]
    scores = run.trial(tmp_path, seed=1)
    assert asked[3:] == [plans[1].name]
    assert (scores["summary"]["nulls"], scores["summary"]["false_alarms"]) == (3, 0)
    contest = tmp_path / "results" / plans[0].name / "rivals.json"
    contest.write_text("{}")
    versions.append("two")
    with pytest.raises(ValueError, match=r"t001_cart.attempt\.json: diagnosed by another version of the tool"):
        run.trial(tmp_path, seed=1)
    assert len(made) == 2, "what is refused is refused before trials are made"
    for record in tmp_path.glob("results/*/attempt.json"):
        record.unlink()
    run.trial(tmp_path, seed=1)
    assert len(asked) == 7
    assert (tmp_path / "report.md").exists()
    assert contest.read_text() == "{}"
