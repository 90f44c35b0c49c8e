"""Recordings made by the independent integrator, and prediction errors on short windows of them.

The initial state of a window of 0.25 s is the recorded one; what a better one could still remove (the response to a
change of each initial position and velocity) is projected out of the residual. Errors are in units of the sensors'
noise.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from dipc_gym.trials import integrator
from dipc_gym.trials.entries import index
from dipc_gym.trials.hidden import Effect, Parameter
from dipc_gym.trials.rigs import SAMPLE_TIME, SAMPLES, Array, Rig

WINDOW = 125  # samples of a window that is predicted
FINE, COARSE = 5e-5, 2e-3  # s, longest steps of the truth, and of windows that are predicted
ONES = np.ones(SAMPLES)


@dataclass(frozen=True)
class Recording:
    """One recording with what no encoder shows.

    Attributes:
        parameters: those it was made with.
        command: shape (samples,).
        gain: factor on the command, shape (samples,).
        q: joint positions, shape (samples, joints).
        v: joint velocities.
        reading: sensor values before noise and quantisation.
        slope: their rates.
        measured: what is written.
    """

    parameters: Array
    command: Array
    gain: Array
    q: Array
    v: Array
    reading: Array
    slope: Array
    measured: Array


def step_size(rig: Rig, parameters: Array, largest: float) -> float:
    """Integration step that the fastest mode and the jumps in time allow, s."""
    step = largest
    if parameters[index("inductance")] > 0:
        step = min(step, 2 * parameters[index("inductance")] / parameters[index("resistance")])
    bristle, level = parameters[index("bristle", 0)], parameters[index("coulomb", 0)]
    if bristle > 0:
        step = min(step, max(0.5 * level / (bristle * 4 * rig.speed[0]), 1e-5))
    stiffness, rotor, driven = parameters[[index("stiffness"), index("rotor"), index("m0")]]
    if stiffness > 0:
        step = min(step, 0.4 * np.sqrt(rotor * driven / (rotor + driven) / stiffness))
    stop = max(parameters[index("stop_stiffness", joint)] for joint in range(rig.count))
    if stop > 0:  # a blow is over within half a swing
        step = min(step, 0.1 * np.sqrt(driven / stop))
    if any(parameters[index("pulse_size", joint)] for joint in range(rig.count)):
        step = min(step, 5e-4)
    if parameters[index("gap")] > 0:  # where in a step a contact begins, shows: only the same steps predict the same
        step = min(step, FINE)
    if parameters[index("dwell")] > 0:  # a joint breaks away at the end of one
        step = min(step, 1e-4)
    return float(step)


def record(
    rig: Rig, parameters: Array, drive: Array, gain: Array, rng: np.random.Generator, step: float = FINE
) -> Recording:
    """Run the rig and keep everything.

    Args:
        rig: the rig.
        parameters: the true ones.
        drive: excitation, shape (SAMPLES,).
        gain: factor on the command, shape (SAMPLES,).
        rng: source of the sensor noise.
        step: largest integration step, s.
    """
    shape = (SAMPLES, rig.count)
    noise = rig.white * rng.standard_normal(shape)
    start = np.tile(np.asarray(rig.start, dtype=float), (SAMPLES, 1))
    q, v, reading, slope, measured, command = integrator.simulate(
        parameters, rig.count, SAMPLE_TIME, step_size(rig, parameters, step), drive, gain, rig.feedback, rig.quantum,
        noise, start, np.zeros(shape), start, 0,
    )  # fmt: skip
    return Recording(parameters, command, gain, q, v, reading, slope, measured)


def _scaled_by(rig: Rig, parameters: Array, recording: Recording) -> tuple[Array, Array]:
    """What sensors of these parameters make noise-free readings of, and its rates, (samples, joints) each: past their
    filters and delays, before their encoders, gains and biases.
    """
    joints = range(rig.count)
    gain, bias = (parameters[[index(name, joint) for joint in joints]] for name in ("gain", "bias"))
    y, slope = (recording.reading - bias) / (1 + gain), recording.slope / (1 + gain)
    first = np.ascontiguousarray(y[:, 0]), np.ascontiguousarray(slope[:, 0])
    integrator.unscaled(parameters, *first)
    y[:, 0], slope[:, 0] = first
    return y, slope


def _initial_states(rig: Rig, parameters: Array, ys: Array, slopes: Array) -> tuple[Array, Array]:
    """Joint states that a rig of these parameters would read so, from what its sensors scale, see `_scaled_by`."""
    time = np.arange(SAMPLES) * SAMPLE_TIME
    q, v = np.empty_like(ys), np.empty_like(slopes)
    for joint in range(rig.count):
        y, slope = ys[:, joint], slopes[:, joint]
        lag, filtered = parameters[index("lag", joint)], parameters[index("filter", joint)]
        if lag > 0:
            from scipy.interpolate import CubicHermiteSpline

            spline = CubicHermiteSpline(time, y, slope)
            later = np.minimum(time + lag, time[-1])
            y, slope = spline(later), spline(later, 1)
        if filtered > 0:
            from scipy.interpolate import CubicSpline

            y, slope = y + filtered * slope, slope + filtered * CubicSpline(time, slope)(time, 1)
        q[:, joint], v[:, joint] = y, slope
    return q, v


def predict(
    rig: Rig, parameters: Array, recording: Recording, *, gain: Array = ONES, true_initial: bool = False,
    shift: tuple[Array, Array] | None = None,
) -> Array:  # fmt: skip
    """Readings as predicted window by window, shape (samples, joints).

    Args:
        rig: the rig.
        parameters: those that predict.
        recording: for the initial states, and the command.
        gain: factor on the command.
        true_initial: whether initial states are the true ones instead of what the readings say.
        shift: added to the initial positions and velocities.
    """
    start_y, slope = _scaled_by(rig, parameters, recording)
    q, v = (recording.q, recording.v) if true_initial else _initial_states(rig, parameters, start_y, slope)
    if shift is not None:
        q, v = q + shift[0], v + shift[1]
    return np.asarray(
        integrator.simulate(
            parameters, rig.count, SAMPLE_TIME, step_size(rig, parameters, COARSE), recording.command, gain,
            integrator.NO_FEEDBACK, rig.quantum, np.zeros_like(q), q, v, start_y, WINDOW,
        )[2]
    )  # fmt: skip


class Windows:
    """Residuals of predictions on one recording, in noise units, freed of what better initial states would remove.

    Args:
        rig: the rig.
        recording: the recording.
        parameters: of the rig whose response to its initial state is projected out (without its dry friction).
    """

    def __init__(self, rig: Rig, recording: Recording, parameters: Array) -> None:
        self.rig, self.recording = rig, recording
        smooth = parameters.copy()
        for joint in range(rig.count):
            smooth[index("coulomb", joint)] = 0.0
        base = predict(rig, smooth, recording)
        columns = []
        for joint in range(rig.count):
            for velocity in (False, True):
                change = np.zeros(rig.count)
                size = 1e-3 * (rig.speed[joint] if velocity else rig.span[joint])
                change[joint] = size
                shift = (np.zeros(rig.count), change) if velocity else (change, np.zeros(rig.count))
                columns.append(self._shape(predict(rig, smooth, recording, shift=shift) - base) / size)
        self.basis = np.linalg.qr(np.stack(columns, axis=-1))[0]

    def _shape(self, values: Array) -> Array:
        """(samples, joints) to (windows, window samples x joints), in noise units."""
        return (values / self.rig.noise).reshape(-1, WINDOW * self.rig.count)

    def residual(self, prediction: Array, reference: Array) -> Array:
        """Difference in noise units without what initial states explain, flat."""
        raw = self._shape(prediction - reference)
        along = np.einsum("wij,wi->wj", self.basis, raw)
        return np.asarray((raw - np.einsum("wij,wj->wi", self.basis, along)).ravel())


def rms(values: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def standard_parameters(rig: Rig, parameters: Array) -> list[Parameter]:
    """The model's parameters that anybody refits: damping, motor constant, driven mass, known dry friction."""
    refitted = []
    for j, at in enumerate(rig.joints):
        scale = max(parameters[index("damping", j)], 0.01 * rig.force[j] / rig.speed[j])
        refitted.append(Parameter(f"damping.{at}", "", index("damping", j), 0, 0, "change", scale))
    kt, ke = parameters[index("kt")], parameters[index("ke")]
    refitted.append(Parameter("motor_constant", "", index("kt"), 0, 0, "change", kt, ((index("ke"), ke),)))
    # A pendulum's mass stands in its inertia and in its weight.
    weight = ((index("mgl"), parameters[index("mgl")]),) if rig.name == "pendulum" else ()
    refitted.append(Parameter("mass", "", index("m0"), 0, 0, "change", parameters[index("m0")], weight))
    for j, at in enumerate(rig.joints):
        level = parameters[index("coulomb", j)]
        if level > 0:
            refitted.append(Parameter(f"coulomb.{at}", "", index("coulomb", j), 0, 0, "change", level))
    return refitted


@dataclass(frozen=True)
class Fit:
    """A refitted rig.

    Attributes:
        parameters: all of them.
        values: of the effect's parameters, none for a mere refit.
        error: windowed difference from the reference on the fitted recordings, noise units.
        end: where the solver stopped, for going on from there.
        converged: whether it stopped by itself.
    """

    parameters: Array
    values: tuple[float, ...]
    error: float
    end: Array
    converged: bool


def fit(
    windows: Sequence[Windows], references: Sequence[Array], parameters: Array, effects: Sequence[Effect],
    start: Sequence[float], *, effort: int = 10, own: Sequence[Parameter] | None = None, onward: Fit | None = None,
) -> Fit:  # fmt: skip
    """Fit the standard parameters, and those of added effects, to readings.

    Positive parameters are fitted as logarithms, the rest on the scale of their start. Levenberg-Marquardt
    (`scipy.optimize.least_squares`) on a forward-difference Jacobian.

    Args:
        windows: one for each recording.
        references: readings to be predicted, one for each recording.
        parameters: of the rig; where the standard ones begin.
        effects: added to them.
        start: values of the effects' parameters to start from.
        effort: largest number of Jacobians.
        own: parameters of the model to refit; all `standard_parameters` if None.
        onward: an earlier fit of the same parameters, to go on from where it stopped.
    """
    from scipy.optimize import least_squares

    rig = windows[0].rig
    if own is None:
        own = standard_parameters(rig, parameters)
    added = [parameter for effect in effects for parameter in effect.parameters]
    logarithmic = np.array([parameter.kind == "log" for parameter in added], dtype=bool)
    begin = np.asarray(start, dtype=float)
    scale = np.where(logarithmic, 1.0, np.where([n.kind == "uniform" for n in added], 0.3, np.abs(begin) + 1e-12))
    # A fit may leave the sizes that are drawn, except where that makes the simulation stiff and slow, and the more so
    # where it begins beyond them: a force along the way may repeat as often as the cogging that it is to stand for.
    least = [n.low if n.place == index("inductance") else min(n.low, x) / 5 for n, x in zip(added, begin, strict=True)]
    low = np.array([np.log(value) if n.kind == "log" else 0.0 for n, value in zip(added, least, strict=True)])
    most = [max(n.high, x) * 4 for n, x in zip(added, begin, strict=True)]
    high = np.array([np.log(value) if n.kind == "log" else 0.0 for n, value in zip(added, most, strict=True)])
    neutral = np.where(logarithmic, np.log(np.where(logarithmic, begin, 1.0)), begin) / scale
    x0 = np.concatenate([np.zeros(len(own)), neutral]) if onward is None else onward.end

    def split(x: Array) -> tuple[Array, Array]:
        result = parameters.copy()
        for parameter, change in zip(own, x[: len(own)], strict=True):
            result[parameter.place] = max(result[parameter.place] + parameter.factor * change, 0.0)
            for place, factor in parameter.also:
                result[place] = max(result[place] + factor * change, 0.0)
        result[index("m0")] = max(result[index("m0")], 0.05 * parameters[index("m0")])
        raw = x[len(own) :] * scale
        values = np.where(logarithmic, np.exp(np.clip(np.where(logarithmic, raw, 0.0), low, high)), raw)
        done = 0
        for effect in effects:
            count = len(effect.parameters)
            result = effect.apply(result, values[done : done + count])
            done += count
        return result, values

    latest: dict[bytes, Array] = {}

    def residuals(x: Array) -> Array:
        if x.tobytes() in latest:
            return latest[x.tobytes()]
        candidate, _ = split(x)
        with np.errstate(over="ignore", invalid="ignore"):  # a trial step may diverge; it is then refused
            parts = [
                w.residual(predict(rig, candidate, w.recording), reference)
                for w, reference in zip(windows, references, strict=True)
            ]
        latest.clear()
        latest[x.tobytes()] = np.clip(np.nan_to_num(np.concatenate(parts), nan=1e6), -1e6, 1e6)
        return latest[x.tobytes()]

    def jacobian(x: Array) -> Array:
        base = residuals(x)
        matrix = np.empty((base.size, x.size))
        for k in range(x.size):
            moved = x.copy()
            moved[k] += 1e-3
            matrix[:, k] = (residuals(moved) - base) / 1e-3
        return matrix

    found = least_squares(
        residuals, x0, jac=jacobian, method="lm", max_nfev=2 * effort, ftol=1e-4, xtol=1e-6, gtol=1e-10
    )
    best, values = split(found.x)
    return Fit(best, tuple(float(v) for v in values), rms(found.fun), found.x, found.status > 0)
