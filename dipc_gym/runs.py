"""Runs that experiments and the command line share: training on a rig, and balancing one."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium
import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym import ENV_ID, SWING_UP_ID, compensators, estimators, recording
from dipc_gym.compensators import Compensator, Samples
from dipc_gym.controllers import Controller, lqr
from dipc_gym.controllers.base import Remembers
from dipc_gym.controllers.tracking import Tracking, equilibrium
from dipc_gym.estimators import Estimator, RigModel
from dipc_gym.identification.excitation import Excitation
from dipc_gym.identification.run import Cart, Sweep, cart, cart_model, delay, delayed, excitation, record, samples
from dipc_gym.kernels import FALL
from dipc_gym.plant import Plant
from dipc_gym.policy import Policy
from dipc_gym.recording import Recording
from dipc_gym.recording.columns import SENSOR
from dipc_gym.recording.degrees import refuse_odd_units

__all__ = [
    "Course",
    "Identification",
    "Impulse",
    "balance",
    "compensator",
    "estimator",
    "identify",
    "recorded",
    "swing_up",
]

Array = NDArray[np.float64]

UNIT = "say --unit {name}={odd} (in Python units={{{name!r}: '{odd}'}}) if these are, or {name}={si} if they are not"
STILL = 0.01  # rad; a locked pole gives that much, and reads its noise


@dataclass(frozen=True)
class Identification:
    """An identification run and what it says.

    Attributes:
        run: the recording.
        cart: the linear model of the cart.
        plant: the rig that made it, or that it is taken to be of.
        samples: what compensators are fitted to.
        excitation: what of force and velocity the run covers.
        rig: linear model, sensors and delay of the whole rig. The delay is the plant's, if it says one, else what the
            run shows; samples have the voltages when they arrived.
    """

    run: Recording
    cart: Cart
    plant: Plant
    samples: Samples
    excitation: Excitation
    rig: RigModel

    def fit(self, name: str, *, seed: int = 0) -> Compensator:
        """Fit a compensator by its registered name, or load a saved one (`.json`).

        Raises:
            ValueError: neither is there.
        """
        if name.endswith(".json"):
            return compensators.load(name)
        return compensators.fit(name, self.samples, self.cart.constants, seed=seed)

    def fit_estimator(self, name: str, *, seed: int = 0) -> Estimator:
        """Fit an estimator by its registered name, or load a saved one (`.json`).

        Raises:
            ValueError: neither is there.
        """
        if name.endswith(".json"):
            return estimators.load(name)
        return estimators.fit(name, self.samples, self.cart.constants, self.rig, seed=seed)


def identify(
    plant: Plant | str | None = None,
    *,
    model: str | None = None,
    from_recording: str | None = None,
    mapping: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    sweep: Sweep | None = None,
    seed: int = 0,
) -> Identification:
    """Identify a rig: simulate the paper's run on it, or take a recording of the real one.

    Args:
        plant: as the environment takes it.
        model: MJCF file of the rig; None is the package's.
        from_recording: file of a recording with columns `time`, `motor` and `cart`, made with the poles locked.
        mapping: of the recording's columns; see `recording.read`.
        units: of the recording's columns; see `recording.read`.
        sweep: the simulated run; the paper's by default.
        seed: of the encoders' noise.

    Raises:
        ValueError: a file that cannot be used, or a recording that cannot support a compensator.
    """
    sweep = Sweep() if sweep is None else sweep
    env = _unwrapped(gymnasium.make(ENV_ID, plant=plant, model=model))
    fixed = cart_model(env.source, env.plant)
    linear = cart(fixed)
    constants = dataclasses.replace(linear.constants, period=env.plant.control_period)
    linear = dataclasses.replace(linear, constants=constants)
    if from_recording is None:
        run = record(fixed, env.plant, sweep, seed=seed)
    else:
        free = _read(env.model) - _read(fixed)  # poles may have columns as well, and units of their own
        mapped = {column: name.removeprefix(SENSOR) for column, name in (mapping or {}).items()}
        columns = {column for column, name in mapped.items() if name in free}
        run = recording.read(
            from_recording,
            fixed,
            mapping={column: name for column, name in (mapping or {}).items() if column not in columns},
            units={key: unit for key, unit in (units or {}).items() if key.removeprefix(SENSOR) not in free | columns},
        )
        refuse_odd_units([run], fixed, mend=UNIT)
    encoders, period = env.plant.encoders, env.plant.control_period
    data = samples(run, linear, encoders, period, block=sweep.block, smoothed=from_recording is not None)
    late = env.plant.delay or delay(data, linear.constants)
    found = excitation(run, linear, encoders, period, block=sweep.block, late=late)
    if from_recording is not None:
        _check_locked(run, env, from_recording, mapping, units)
        if found.refusal is not None:
            raise ValueError(f"{from_recording}: no compensator can be trained from this: {found.refusal}")
    if late:
        data = dataclasses.replace(data, voltage=delayed(data.voltage, period, late))
    rig = RigModel.of(*lqr.linear_model(env.model), env.plant, linear.constants.newtons_per_volt, late)
    return Identification(run, linear, env.plant, data, found, rig)


def _read(model: mujoco.MjModel) -> set[str]:
    """Names of a model's sensors, which columns of a recording go by."""
    return {model.sensor(i).name for i in range(model.nsensor)}


def _check_locked(
    run: Recording,
    env: Any,
    path: str,
    mapping: Mapping[str, str] | None,
    units: Mapping[str, str] | None,
) -> None:
    """Refuse a recording whose columns of the poles show that they swung.

    Raises:
        ValueError: they did.
    """
    known = {*run.ignored, *(name.removeprefix(SENSOR) for name in (mapping or {}).values())}
    if not {"pole1", "pole2"} <= known:
        return
    whole = recording.read(path, env.model, mapping=mapping, units=units)
    for name in ("pole1", "pole2"):
        swing = float(np.ptp(whole.sensors[:, whole.sensor_names.index(name)]))
        if swing > STILL:
            raise ValueError(
                f"{path}: {name} swings by {swing:.2g} rad; identification needs the poles locked, for their weight "
                "moves the cart too"
            )


def compensator(name: str, plant: Plant | str | None = None, *, model: str | None = None, seed: int = 0) -> Compensator:
    """A compensator by name, trained on a simulated identification run of the rig, or a saved one (`.json`).

    Raises:
        ValueError: neither is there.
    """
    if name.endswith(".json"):
        return compensators.load(name)
    compensators.registry.kind(name)  # an unknown name is refused before anything is simulated
    return identify(plant, model=model, seed=seed).fit(name, seed=seed)


def estimator(name: str, plant: Plant | str | None = None, *, model: str | None = None, seed: int = 0) -> Estimator:
    """An estimator by name, fitted to a simulated identification run of the rig, or a saved one (`.json`).

    Raises:
        ValueError: neither is there.
    """
    if name.endswith(".json"):
        return estimators.load(name)
    estimators.kind(name)  # an unknown name is refused before anything is simulated
    return identify(plant, model=model, seed=seed).fit_estimator(name, seed=seed)


@dataclass(frozen=True)
class Impulse:
    """A blow on the cart.

    Attributes:
        size: N s, positive towards positive x.
        time: after the start of the run, s.
    """

    size: float
    time: float


@dataclass(frozen=True)
class MotorFault:
    """What a motor does to the voltages that it is given; see `FaultyMotor`.

    Attributes:
        noise: standard deviation of a voltage that is added in every period, V.
        response: share of a change of voltage that arrives, 1 for all of it.
    """

    noise: float = 0.0
    response: float = 1.0


@dataclass(frozen=True)
class Course:
    """How a run went, one row for each control period.

    Attributes:
        time: (n,) s.
        state: (n, 6) exact state before each command, as the observation orders it.
        force: (n,) N, as the controller commanded it, limited.
        voltage: (n,) V, as applied.
        readings: (n, 3) encoders, the third relative to the first pole.
        clipped: number of periods in which the voltage met the supply.
        fell: whether the run ended early.
    """

    time: Array
    state: Array
    force: Array
    voltage: Array
    readings: Array
    clipped: int
    fell: bool

    def held(self, goal: str) -> float:
        """For how long it stayed at a posture until its end without a break, s; 0 if it ended early.

        Args:
            goal: a name of `postures.POSTURES`; both poles are within 0.35 rad of it.
        """
        if self.fell:
            return 0.0
        off = np.abs(np.remainder(self.state[:, 1:3] - equilibrium(goal)[1:3] + math.pi, 2 * math.pi) - math.pi)
        away = np.flatnonzero((off > FALL).any(axis=1))
        since = int(away[-1]) + 1 if len(away) else 0
        return self.lasted - float(self.time[since]) if since < len(self.time) else 0.0

    @property
    def lasted(self) -> float:
        """How long it lasted, s; if it fell, when."""
        return float(self.time[-1] + (self.time[1] - self.time[0] if len(self.time) > 1 else 0.0))

    def recording(self, name: str) -> Recording:
        """The run in the form of a recording."""
        return Recording(name, self.time, self.voltage[:, None], self.readings, ("motor",), ("cart", "pole1", "pole2"))


def balance(
    controller: Controller,
    compensator: Compensator,
    *,
    seconds: float,
    seed: int,
    plant: Plant | str | None = None,
    model: str | None = None,
    exact_state: bool = False,
    impulse: Impulse | Sequence[Impulse] | None = None,
    estimator: Estimator | None = None,
    fault: MotorFault | None = None,
) -> Course:
    """Balance a rig until it falls or time is over.

    Args:
        controller: commands force.
        compensator: turns it into voltage.
        seconds: length of the run, s.
        seed: of initial state and noise.
        plant: as the environment takes it.
        model: MJCF file of the rig; None is the package's.
        exact_state: let controller and compensator see the exact state instead of encoder readings.
        impulse: a blow that the cart takes on the way, or several.
        estimator: what controller and compensator see the rig through; None is the environment's own observation.
        fault: what the motor does to the voltages.

    Raises:
        ValueError: `seconds` is not finite, or shorter than a control period; a blow falls outside them; the policy was
            trained to see through another estimator; or the compensator needs one that observes friction, and this does
            not; or both `exact_state` and an estimator are given.
    """
    env: gymnasium.Env[Any, Any] = gymnasium.make(
        ENV_ID, plant=plant, model=model, exact_state=exact_state, max_episode_steps=2**31
    )
    given = () if impulse is None else (impulse,) if isinstance(impulse, Impulse) else impulse
    return _course(env, controller, compensator, seconds, seed, given, estimator, fault)


def swing_up(
    controller: Controller,
    compensator: Compensator,
    *,
    seconds: float,
    seed: int,
    start: str = "down-down",
    goal: str = "up-up",
    plant: Plant | str | None = None,
    model: str | None = None,
    exact_state: bool = False,
    estimator: Estimator | None = None,
) -> Course:
    """Take a rig from one equilibrium to another, until it meets the rail's end or time is over.

    Args:
        controller: commands force for observations of `DIPC-Friction-SwingUp-v0`; one that follows a plan is begun
            anew.
        compensator: turns it into voltage.
        seconds: length of the run, s.
        seed: of initial state and noise.
        start: a name of `postures.POSTURES`, or `anywhere`.
        goal: another.
        plant: as the environment takes it.
        model: MJCF file of the rig; None is the package's.
        exact_state: let controller and compensator see the exact state instead of encoder readings.
        estimator: what they see the rig through, such as `rigid_body`; None is the environment's own observation.

    Raises:
        ValueError: no such posture, `seconds` is not finite, or the controller's plan is for another control period or
            other equilibria, or the policy was trained to see through another estimator; or the compensator needs an
            estimator that observes friction, and this is none; or both `exact_state` and an estimator are given.
    """
    env: gymnasium.Env[Any, Any] = gymnasium.make(
        SWING_UP_ID,
        start=start,
        goal=goal,
        plant=plant,
        model=model,
        exact_state=exact_state,
        max_episode_steps=2**31,
    )
    if isinstance(controller, Tracking):
        controller.require(start, goal, _unwrapped(env).plant.control_period)
    return _course(env, controller, compensator, seconds, seed, (), estimator, None)


def _course(
    env: gymnasium.Env[Any, Any],
    controller: Controller,
    compensator: Compensator,
    seconds: float,
    seed: int,
    given: Sequence[Impulse],
    estimator: Estimator | None,
    fault: MotorFault | None,
) -> Course:
    """Run an environment; see `balance`."""
    from dipc_gym.wrappers import EstimateState, FaultyMotor, ForceCommand

    inner = _unwrapped(env)
    period = inner.plant.control_period
    if estimator is not None and inner.exact_state:
        raise ValueError(
            "exact_state shows the simulation's state, and an estimator reads encoders: leave one of them out"
        )
    if not (math.isfinite(seconds) and seconds >= period):
        raise ValueError(f"a run of {seconds:g} s; it must be finite, and at least one control period, {period:g} s")
    steps = round(seconds / period)
    if fault is not None:
        env = FaultyMotor(env, noise=fault.noise, response=fault.response)
    if estimator is not None:
        env = EstimateState(env, estimator)
    env = ForceCommand(env, compensator)
    observation, _ = env.reset(seed=seed)
    state, readings = np.zeros((steps, 6)), np.zeros((steps, 3))
    force, voltage, action = np.zeros(steps), np.zeros(steps), np.zeros(1)
    done, clipped, fell = 0, 0, False
    blows = dict[int, float]()
    for blow in given:
        k = round(blow.time / period)
        if not 0 <= k < steps:
            raise ValueError(f"a blow at {blow.time:g} s, in a run of {seconds:g} s; it must fall within")
        blows[k] = blows.get(k, 0.0) + blow.size
    if isinstance(controller, Remembers):
        controller.reset()
    if isinstance(controller, Policy):
        controller.require_estimator(None if estimator is None else estimator.name)
    for k in range(steps):
        if k in blows:
            inner.strike(blows[k])
        state[k], readings[k] = inner.state, inner.encoders
        action[0] = controller.force(observation)
        observation, _, fell, _, info = env.step(action)
        force[k], voltage[k] = info["force"], info["voltage"]
        clipped += info["clipped"]
        done = k + 1
        if fell:
            break
    env.close()
    return Course(period * np.arange(done), state[:done], force[:done], voltage[:done], readings[:done], clipped, fell)


def recorded(
    path: str,
    *,
    model: str | None = None,
    mapping: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
) -> Course:
    """The course of a recorded run, as far as the encoders tell it: rates and force are zero.

    Args:
        path: file of the recording.
        model: MJCF file of the rig; None is the package's.
        mapping: of the recording's columns; see `recording.read`.
        units: of the recording's columns; see `recording.read`.

    Raises:
        RecordingError: the file cannot be used, or lacks an encoder.
    """
    env = _unwrapped(gymnasium.make(ENV_ID, model=model))
    run = recording.read(path, env.model, mapping=mapping, units=units)
    cart, pole1, pole2 = (run.sensors[:, run.sensor_names.index(name)] for name in ("cart", "pole1", "pole2"))
    state = np.zeros((len(run), 6))
    state[:, :3] = np.stack([cart, pole1, pole1 + pole2], axis=1)
    volts = run.commands[:, run.actuator_names.index("motor")]
    readings = np.stack([cart, pole1, pole2], axis=1)
    return Course(run.time - run.time[0], state, np.zeros(len(run)), volts, readings, 0, False)


def _unwrapped(env: gymnasium.Env[Any, Any]) -> Any:
    return env.unwrapped
