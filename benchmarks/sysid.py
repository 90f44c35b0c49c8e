"""Our fit beside MuJoCo's own system identification, `mujoco.sysid`.

    python benchmarks/sysid.py [--threads 1] [--repeats 3]
    python benchmarks/sysid.py --model MODEL.xml --recording RUN.csv [--mass KG] [--effects ID ...]

The first line measures what a hypothesis costs: a cart with a motor, 2 x 20 s at 500 Hz simulated here, and three
numbers to find: mass, damping, Coulomb friction. Both get the same runs, first values and step. `diagnose` fits 48
windows of 0.25 s, and so do we in the first row; in the second, all there are. `mujoco.sysid` simulates each run from
its first sample to its last; it is told the state at the start, which we estimate. Times are of the processor, all
threads together, because the machine may be busy with other things.

The second line asks both about one recording of a rig with one slide joint, its mass in an `<inertial>`. For
`mujoco.sysid` we free mass, damping and dry friction, since its user has to think of friction; `diagnose` chooses among
the effects that `--effects` names, or the whole catalogue. Both fit the first three quarters and are judged by the
last: error of predicted windows, in units of the sensor's noise, and of the inverse force, relative to the force.
`--mass` is the known one. For the recordings of real rigs see examples/real_recordings.py.

`mujoco.sysid` comes with MuJoCo and needs `pip install "mujoco[sysid]"`.
"""

import argparse
import contextlib
import io
import time
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
from mujoco import sysid

from dipc_gym import mjcf, physics, recording
from dipc_gym.mjcf.edit import Document
from dipc_gym.recording import Recorder
from dipc_gym.sim2real.diagnosis import diagnose
from dipc_gym.sim2real.effects import catalogue
from dipc_gym.sim2real.estimation import unexplained
from dipc_gym.sim2real.estimation.fit import evaluate, fit
from dipc_gym.sim2real.estimation.segments import prepare
from dipc_gym.sim2real.model.parameters import model_parameters
from dipc_gym.sim2real.simulation.batch import Stepping

CART = """
<mujoco model="cart">
  <option timestep="{step}" integrator="implicitfast"/>
  <worldbody>
    <body name="cart">
      <joint name="cart" type="slide" axis="1 0 0" damping="{damping}" frictionloss="{frictionloss}"/>
      <inertial pos="0 0 0" mass="{mass}" diaginertia="1 1 1"/>
    </body>
  </worldbody>
  <actuator><motor name="motor" joint="cart" gear="8"/></actuator>
  <sensor><jointpos name="x" joint="cart"/></sensor>
</mujoco>
"""
TRUE = {"mass": 1.6, "damping": 12.0, "frictionloss": 5.0}
FIRST = {"mass": 2.0, "damping": 8.0, "frictionloss": 3.0}
PERIOD, SECONDS = 0.002, 20.0
ENCODER = 2e-5  # m, a count
SHARE = 0.75  # of a recording is fitted
FITTED = 48  # windows, as in a diagnosis


def record(seed):
    """The true cart, simulated ten times as finely as it is read; a swept voltage with steps on top."""
    model = mjcf.compile(CART.format(step=PERIOD / 10, **TRUE))
    model.dof_solref[:] = 0.002, 1.0  # friction as hard as this step bears
    data, recorder, rng = mujoco.MjData(model), Recorder(["motor"], ["x"]), np.random.default_rng(seed)
    levels = rng.uniform(-1, 1, int(SECONDS))
    for k in range(int(SECONDS / PERIOD)):
        t = k * PERIOD
        volts = 2.5 * np.sin(2 * np.pi * (0.3 + 0.05 * t) * t) + levels[int(t)]
        mujoco.mj_forward(model, data)
        recorder.append(t, [volts], np.round(data.sensordata / ENCODER) * ENCODER)
        data.ctrl[:] = volts
        mujoco.mj_step(model, data, 10)
    return recorder.recording(f"run{seed}")


def theirs(text, runs, first, *, threads, optimizer, **most):
    """`mujoco.sysid`: found numbers, its optimised parameters, its residuals; `most` goes to the optimizer."""
    spec = mujoco.MjSpec.from_string(text)
    model = spec.compile()
    body = model.body(model.jnt_bodyid[0]).name

    def write(name):
        def modifier(spec, parameter):
            value = float(parameter.value[0])
            if name == "mass":
                spec.body(body).mass = value
            elif name == "damping":
                spec.joints[0].damping = [value, 0, 0]
            else:
                spec.joints[0].frictionloss = value

        return modifier

    parameters = sysid.ParameterDict()
    for name, value in first.items():
        parameters.add(sysid.Parameter(name, value, value / 20, value * 20, modifier=write(name)))
    starts, controls, sensors = [], [], []
    for run in runs:
        starts.append(sysid.create_initial_state(model, run.sensors[0], np.zeros(1)))
        controls.append(sysid.TimeSeries(run.time, run.commands))
        sensors.append(sysid.TimeSeries.from_names(run.time, run.sensors, model))
    sequences = sysid.ModelSequences("rig", spec, [r.name for r in runs], starts, controls, sensors)
    residuals = sysid.build_residual_fn(models_sequences=[sequences], n_threads=threads)
    with contextlib.redirect_stdout(io.StringIO()):  # its optimisers tell every step, asked or not
        found, _ = sysid.optimize(parameters, residuals, optimizer=optimizer, verbose=False, **most)
    left, _, _ = residuals(found.as_vector(), found)
    return {name: float(found[name].value[0]) for name in first}, found, np.concatenate([np.ravel(r) for r in left])


def prepared(text, runs, threads, span=(0.0, 1.0)):
    """Windows and initial states, as a diagnosis makes them; and the source."""
    source = mjcf.from_text(text)
    stepping = Stepping(PERIOD, mujoco.mjtIntegrator.mjINT_RK4)
    return source, prepare(source, physics.load(source), runs, stepping, span=span, threads=threads)


def ours(source, ready, windows, **most):
    """One fit of mass, damping and friction: found numbers; `most` goes to the fit."""
    parameters = [n for n in model_parameters(Document(source), ready.structure.model) if n.attribute in TRUE]
    problem = ready.problem
    if windows < len(problem.windows):
        problem = problem.pick(np.linspace(0, len(problem.windows) - 1, windows).astype(int))
    found = fit(problem, replace(ready.structure, model_parameters=tuple(parameters)), **most)
    return {n.attribute: slot.value(z) for n, slot, z in zip(parameters, found.structure.slots, found.z, strict=True)}


def speed(threads, repeats):
    text = CART.format(step=PERIOD, **FIRST)
    runs = [record(seed) for seed in (1, 2)]
    start = time.process_time()
    source, ready = prepared(text, runs, threads)
    preparation, count = time.process_time() - start, len(ready.problem.windows)
    ways = {
        f"dipc-gym, {FITTED} windows": lambda: ours(source, ready, FITTED),
        f"dipc-gym, all {count} windows": lambda: ours(source, ready, count),
        "mujoco.sysid, optimizer mujoco": lambda: theirs(text, runs, FIRST, threads=threads, optimizer="mujoco")[0],
        "mujoco.sysid, optimizer scipy": lambda: theirs(text, runs, FIRST, threads=threads, optimizer="scipy")[0],
    }
    best = dict.fromkeys(ways, np.inf)
    found = {}
    for _ in range(repeats):
        for name, way in ways.items():
            start = time.process_time()
            found[name] = way()
            best[name] = min(best[name], time.process_time() - start)
    print(f"2 x {SECONDS:g} s at {1 / PERIOD:g} Hz, {threads} thread(s); fastest of {repeats}")
    print(f"once a diagnosis, not a fit: states and windows, {preparation:.1f} s\n")
    print(f"{'one fit':34}{'CPU s':>8}{'ratio':>8}" + "".join(f"{name:>14}" for name in TRUE))
    for name, seconds in best.items():
        ratio = seconds / best[f"dipc-gym, {FITTED} windows"]
        print(f"{name:34}{seconds:8.2f}{ratio:8.1f}" + "".join(f"{found[name][key]:14.3f}" for key in TRUE))
    print(f"{'truth':50}" + "".join(f"{value:14.3f}" for value in TRUE.values()))

    # What an iteration costs: what more of them take longer. The first one of either pays for much else.
    more = {
        f"dipc-gym, {FITTED} windows": lambda k: ours(source, ready, FITTED, most=k, tolerance=0.0),
        f"dipc-gym, all {count} windows": lambda k: ours(source, ready, count, most=k, tolerance=0.0),
        "mujoco.sysid, optimizer mujoco": lambda k: theirs(
            text, runs, FIRST, threads=threads, optimizer="mujoco", max_iters=k
        ),
    }
    spent = {name: [iteration(way) for _ in range(repeats)] for name, way in more.items()}
    usual = {name: float(np.median(each)) for name, each in spent.items()}
    print(f"\n{'one iteration':34}{'CPU ms':>8}{'ratio':>8}")
    for name, seconds in usual.items():
        print(f"{name:34}{1e3 * seconds:8.1f}{usual['mujoco.sysid, optimizer mujoco'] / seconds:8.1f}")


def iteration(way, first=1, last=4):
    """Seconds of the processor that one more iteration takes."""
    ends = []
    for most in (first, last):
        start = time.process_time()
        way(most)
        ends.append(time.process_time() - start)
    return (ends[1] - ends[0]) / (last - first)


def with_numbers(source, values):
    """The text of the model with these numbers."""
    document = Document(source)
    joint = document.joint(document.joint_names()[0])
    document.set(joint, damping=values["damping"], frictionloss=values["frictionloss"])
    document.set(document.parent(joint).find("inertial"), mass=values["mass"])
    return document.text()


def judged(text, run, threads):
    """Held-out errors of a model: of windows in units of noise, of the inverse force."""
    source, ready = prepared(text, [run], threads, (SHARE, 1.0))
    mse = evaluate(ready.problem, ready.structure, np.zeros(0))
    (force,) = unexplained.force_errors(physics.load(source), [run], ready.motions, (SHARE, 1.0))
    return float(np.sqrt(np.mean(mse))), float(force)


def mass_of(text):
    model = mjcf.from_text(text)
    return float(physics.load(model).model.body_subtreemass[0])


def question(model, file, effects, mass, threads):
    """Both tools, one recording."""
    source = mjcf.read(model)
    whole = recording.read(file, mjcf.compile(model))
    until = int(SHARE * len(whole))
    first = replace(whole, time=whole.time[:until], commands=whole.commands[:until], sensors=whole.sensors[:until])
    # A guess of the order of magnitude; the bounds are a factor of twenty either way.
    guess = {"mass": mass_of(source.text), "damping": 100.0, "frictionloss": 10.0}

    from mujoco.sysid.report.sections.insights import AutomatedInsights

    start = time.process_time()
    values, parameters, left = theirs(source.text, [first], guess, threads=threads, optimizer="mujoco")
    seconds_theirs = time.process_time() - start
    insights = AutomatedInsights("insights", parameters)
    said = "; ".join(f"{x['title']}: {x['message']}" for x in insights.get_context()["insights"])
    known = catalogue()
    start = time.process_time()
    found = diagnose(model, [whole], effects=[known[e] for e in effects] if effects else None, threads=threads)
    seconds_ours = time.process_time() - start

    print(f"{Path(file).name}: fitted on the first {SHARE:.0%}, judged on the rest, {threads} thread(s)\n")
    print(f"{'':16}{'CPU s':>9}{'mass, kg':>12}{'windows x noise':>18}{'inverse force':>15}")
    rows = {
        "as given": (0.0, source.text),
        "mujoco.sysid": (seconds_theirs, with_numbers(source, values)),
        "dipc-gym": (seconds_ours, found.improved),
    }
    for name, (seconds, text) in rows.items():
        windows, force = judged(text, whole, threads)
        print(f"{name:16}{seconds:9.0f}{mass_of(text):12.2f}{windows:18.0f}{force:15.2%}")
    if mass:
        print(f"{'known':25}{mass:12.2f}")
    r = left - left.mean()
    print(f"\nmujoco.sysid found {', '.join(f'{k} {v:.4g}' for k, v in values.items())}")
    print(f"  its report says: {said}")
    print(f"  autocorrelation of its residual at one sample: {r[1:] @ r[:-1] / (r @ r):.4f}")
    print(f"dipc-gym: {found.verdict}. {found.sentence}")
    for missing in found.missing:
        print(f"  {missing.effect}: {missing.sentence}")
    for note in found.notes:
        print(f"  note: {note}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--threads", type=int, default=1, help="of both")
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--model", type=Path, help="MJCF of a rig with one slide joint")
    parser.add_argument("--recording", type=Path, help="of that rig")
    parser.add_argument("--mass", type=float, help="kg, where it is known")
    parser.add_argument("--effects", nargs="+", help="of the catalogue; all, if not given")
    options = parser.parse_args()
    if not hasattr(sysid, "optimize"):  # it imports without what it needs, and then has nothing in it
        print('not run: needs pip install "mujoco[sysid]"')
    elif options.model:
        question(options.model, options.recording, options.effects, options.mass, options.threads)
    else:
        speed(options.threads, options.repeats)


if __name__ == "__main__":
    main()
