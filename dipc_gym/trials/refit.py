"""A rival of the diagnosis: the model's parameters refitted by `mujoco.sysid`, as a careful user would do it.

Google DeepMind's toolbox comes with MuJoCo (extra `mujoco[sysid]`). It is given what helps it: short windows from
estimated states, so that neither drift nor an unstable rig overwhelms it; residuals in units of noise and without
what better initial states would remove; steps of one sample, so that its interpolation of commands does no harm;
readings beside the step they belong to. It fits the parameters it is told to fit and names nothing.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Callable, Sequence
from pathlib import Path

import mujoco
import numpy as np

from dipc_gym.trials.replayed import Array, Motion, from_estimates, without_initial

BOUNDS = {"damping": (0.05, 10.0), "frictionloss": (0.05, 10.0), "armature": (0.3, 3.0)}
"""Bounds of parameters, as factors of the nominal one; wider ones diverge at a step of one sample."""
OTHERS = (0.3, 3.0)
"""Bounds of gear and masses."""
ITERATIONS = 12  # of mujoco.sysid, at most


def refit(model: Path, motions: Sequence[Motion], noise: Array) -> tuple[mujoco.MjModel, dict[str, float]]:
    """Fit damping, dry friction, gear and masses of a trial's nominal model to windows of recordings.

    Args:
        model: `nominal.xml` of a trial.
        motions: training recordings.
        noise: standard deviation of each reading's noise.

    Returns:
        The refitted model, and each parameter as a factor of the nominal one.

    Raises:
        ImportError: what `mujoco.sysid` needs is not installed.
    """
    try:
        from mujoco.sysid import (
            ModelSequences,
            Parameter,
            ParameterDict,
            TimeSeries,
            apply_param_modifiers,
            create_initial_state,
            model_residual,
            optimize,
        )  # fmt: skip
    except ImportError:
        raise ImportError("mujoco.sysid needs further packages: pip install 'mujoco[sysid]'") from None
    spec = mujoco.MjSpec.from_file(str(model))
    spec.option.timestep = motions[0].step
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_RK4
    params = ParameterDict()
    for name, write in _parameters(spec).items():
        low, high = BOUNDS.get(name.rsplit(".", 1)[1], OTHERS)
        params.add(Parameter(name, 1.0, low, high, modifier=write))
    given = spec.compile()
    initial, commands, readings = [], [], []
    sensors, controls = (
        f(given) for f in (TimeSeries.compute_all_sensor_mapping, TimeSeries.compute_all_control_mapping)
    )
    for motion in motions:
        time = motion.step * np.arange(len(motion.command), dtype=np.float64)
        parts = (motion.cut(x) for x in (time[:, None], motion.command, motion.measured, motion.q, motion.v))
        for t, u, y, q, v in zip(*parts, strict=True):
            initial.append(create_initial_state(given, q[0], v[0]))
            initial[-1][0] = t[0, 0]
            commands.append(TimeSeries(t[:, 0], u, controls))
            readings.append(TimeSeries(t[:, 0], y, sensors))
    names = [f"window_{k}" for k in range(len(initial))]
    sequences = ModelSequences("rig", spec, names, initial, commands, readings).measured_rollout
    bases = np.concatenate([from_estimates(given, motion, noise)[1] for motion in motions])

    bases = np.linalg.qr(bases[:, : -given.nv])[0]

    def scaled(params, predicted, measured, model, return_pred_all, state=None):  # type: ignore[no-untyped-def]
        # A rollout's first reading is that before its first step, and the last command is not stepped.
        residual = (measured.data[:-1] - predicted.data) / noise
        return np.clip(np.nan_to_num(residual, nan=1e4), -1e4, 1e4), predicted, measured

    def residual(x: Array, params: ParameterDict):  # type: ignore[no-untyped-def]
        residual, *more = model_residual(
            x, params, lambda p: apply_param_modifiers(p, spec), sequences, scaled, n_threads=1, resample_true=False
        )  # fmt: skip
        variants = x.shape[1] if x.ndim > 1 else 1
        by_window = residual.T.reshape(variants, len(sequences), -1)
        flat = without_initial(by_window, bases).reshape(variants, -1)
        return [flat.T if x.ndim > 1 else flat[0]], *more

    with contextlib.redirect_stdout(io.StringIO()):  # it prints every iteration
        found, _ = optimize(params, residual, max_iters=ITERATIONS)
    factors = dict(zip(found.get_non_frozen_parameter_names(), found.as_vector().tolist(), strict=True))
    return apply_param_modifiers(found, spec), factors


def _parameters(spec: mujoco.MjSpec) -> dict[str, Callable[[mujoco.MjSpec, object], None]]:
    """What may be scaled, by name, and how a spec is given a factor."""
    writers: dict[str, Callable[[mujoco.MjSpec, object], None]] = {}

    def scale(kind: str, name: str, *attributes: str) -> Callable[[mujoco.MjSpec, object], None]:
        nominal = {a: np.array(getattr(getattr(spec, kind)(name), a), dtype=float) for a in attributes}

        def write(target: mujoco.MjSpec, parameter: object) -> None:
            element = getattr(target, kind)(name)
            for attribute, value in nominal.items():
                new = value * parameter.value[0]  # type: ignore[attr-defined]
                setattr(element, attribute, float(new) if new.ndim == 0 else new)

        return write

    for joint in spec.joints:
        for attribute in ("damping", "frictionloss", "armature"):
            if np.any(np.asarray(getattr(joint, attribute)) > 0):
                writers[f"{joint.name}.{attribute}"] = scale("joint", joint.name, attribute)
    for actuator in spec.actuators:
        writers[f"{actuator.name}.gear"] = scale("actuator", actuator.name, "gear")
    for body in spec.bodies:
        if body.name != "world":
            writers[f"{body.name}.mass"] = scale("body", body.name, "mass", "inertia")
    return writers
