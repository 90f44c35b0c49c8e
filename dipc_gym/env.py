"""The Gymnasium environment: voltage in, encoder readings out, friction in between."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import gymnasium
import mujoco
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from dipc_gym import kernels, mjcf
from dipc_gym.drawing.viewer import has_display, viewer
from dipc_gym.mjcf.edit import Document
from dipc_gym.plant import Plant, PlantError
from dipc_gym.randomise import PlantFamily
from dipc_gym.rigs import ENGINES, unknown_engine
from dipc_gym.rigs.rig import DIVERGED, Rig
from dipc_gym.rigs.together import COSTS
from dipc_gym.safety import actions
from dipc_gym.safety.naming import suggestion

__all__ = ["DoublePendulumEnv"]

Array = NDArray[np.float64]
State = tuple[float, float, float, float, float, float]

START_SPREAD = 0.02  # m and rad, either way, at reset
FRAMES_PER_SECOND = 60  # of the window, in simulated time


class DoublePendulumEnv(gymnasium.Env[Array, NDArray[np.float32]]):
    """A double inverted pendulum on a cart, driven by a DC motor through stick-slip friction.

    ## Description
    A belt pulls a cart along a rail of 0.9 m; on the cart stands a pole, and on its end another. The controller sets
    the motor's voltage every 5 ms and has to hold both poles upright. Dry friction, larger at standstill than in
    motion, swallows small commands and keeps a linear controller in a limit cycle: that is the point of this rig.
    It follows Nejadfard, Yazdanpanah and Hassanzadeh, Neural Computing and Applications 22 (2013) 337-347.

    ## Action space
    `Box(-24, 24, (1,), float32)`: motor voltage. What goes beyond the supply is clipped, and `info["clipped"]` says
    so. Any array of one finite number is taken, in single or double precision.

    ## Observation space
    `Box(-inf, inf, (6,), float64)`; angles are absolute, from upright, positive towards positive x.

    | index | meaning | unit |
    |---|---|---|
    | 0 | position of the cart | m |
    | 1 | angle of the first pole | rad |
    | 2 | angle of the second pole | rad |
    | 3 | velocity of the cart | m/s |
    | 4 | rate of the first angle | rad/s |
    | 5 | rate of the second angle | rad/s |

    Positions are encoder readings: rounded to counts, with noise if the plant has any. Rates are filtered differences
    of them (`Encoders`). `exact_state=True` gives the simulation's own state instead.

    ## Reward
    `1 - cost_cart - cost_pole1 - cost_pole2 - cost_voltage`. Each cost is quadratic in the simulated state or the
    applied voltage and reaches 0.25 at its limit: 0.45 m, 0.35 rad (from the nearest upright), the supply. So a
    balancing step earns between 0 and 1.

    ## Info
    At every step and at reset: `reward_survive`, the four costs, `voltage` (V, as applied), `clipped`, `friction`
    (N, dry friction on the cart, negative when it acts towards negative x), `time` (s) and `diverged`.

    ## Initial state
    At rest, cart and absolute angles uniform within 0.02 (m, rad) of upright. `reset(options=...)` takes:

    - `start`: `"upright"` (default) or `"hanging"`, both within 0.02;
    - `state`: six numbers as observed, exactly this state;
    - `plant`: for this episode, another `Plant`, a dictionary of changed fields, or a file.

    ## Episode end
    Terminated when the cart is as far out as the nearer rail stop, when a pole leaves 0.35 rad (not after a hanging
    start, nor when `state` starts a pole beyond it), or when the simulation diverges; the observation is then the last
    finite one and `info["diverged"]` is true. Truncated by Gymnasium's `TimeLimit` after 2,000 steps (10 s); the
    paper's 80 s are `gymnasium.make("DIPC-Friction-v0", max_episode_steps=16_000)`.

    ## Arguments
    All are keywords and may be given to `gymnasium.make`.

    Args:
        plant: a `Plant`, a dictionary of changed fields, or the path of a JSON file; by default the model's own.
            Numbers may be distributions, drawn anew at every reset; see `PlantFamily`.
        model: path of an MJCF file of one's own, with an actuator `motor` and jointpos sensors `cart`, `pole1` and
            `pole2` (pole2 relative to pole1). By default the package's `rig.xml`.
        exact_state: observe the simulation's state instead of encoder readings.
        engine: what simulates: `"mujoco"`, or `"compiled"`, machine code that integrates more finely and agrees with
            the vector environment on the same engine to the last bit. It leaves out dry friction by `frictionloss`,
            ranges of the poles' joints, stops, delayed sensors, and of `<custom>` all but forces; the rail's stops do
            not push, for an episode ends there.
        render_mode: `"human"`, `"rgb_array"` or None.
        width: of the picture, pixels.
        height: of the picture, pixels.
        camera: name of the camera, `"side"` or `"follow"` in `rig.xml`; None is MuJoCo's free camera.

    Raises:
        PlantError: the plant is impossible or its file is.
        MjcfError: the model is refused, does not compile, lacks the actuator or a sensor, or has what the engine
            does not simulate.

    Example:
        >>> import gymnasium, dipc_gym
        >>> env = gymnasium.make("DIPC-Friction-v0", plant={"friction": {"coulomb": 5.0, "static": 7.0}})
        >>> observation, info = env.reset(seed=1)
        >>> observation, reward, terminated, truncated, info = env.step([3.0])
        >>> info["voltage"]
        3.0

    ## Version history
    - v0: first version.
    """

    metadata: dict[str, Any] = {"render_modes": ["human", "rgb_array"], "render_fps": 200}  # noqa: RUF012

    _balances = True  # and so ends when a pole that stood has fallen
    _rig: Rig
    _readings: tuple[float, float, float]  # encoders: cart, absolute angles
    _rates: tuple[float, float, float]  # the velocity filter's memory
    _observed: State

    def __init__(
        self,
        *,
        plant: PlantFamily | Plant | Mapping[str, Any] | str | Path | None = None,
        model: str | Path | None = None,
        exact_state: bool = False,
        engine: str = "mujoco",
        render_mode: str | None = None,
        width: int = 640,
        height: int = 480,
        camera: str | None = "side",
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(f"render_mode is {render_mode!r}; it can be None, 'human' or 'rgb_array'")
        if engine not in list(ENGINES):
            raise ValueError(unknown_engine(engine))
        self.render_mode, self.engine = render_mode, engine
        self.exact_state = exact_state
        for name, size in (("width", width), ("height", height)):
            if not isinstance(size, (int, np.integer)) or isinstance(size, bool) or size < 1:
                raise ValueError(f"{name} is {size!r}; it is a whole number of pixels, 1 or more")
        self._picture = (width, height, camera)
        self._viewer: Any = None
        self._source = _own_rig() if model is None else _checked_model(model)
        _check_camera(self._source, camera)
        try:
            base = Plant.from_mjcf(self._source.text)
        except PlantError as error:
            raise PlantError(f"{self._source.name}: {error}") from None
        self._family = PlantFamily.of(plant, base=base)
        self._home = self._family.base
        self._compiled: Any = None
        self._set_plant(self._home)
        self.metadata = {**self.metadata, "render_fps": round(1 / self._home.control_period)}
        self.observation_space = spaces.Box(-np.inf, np.inf, (6,), np.float64)
        limit = actions.bound(self._home.supply)
        self.action_space = spaces.Box(-limit, limit, (1,), np.float32)
        self._begin((0.0,) * 6)

    # ------------------------------------------------------------------------------------------------ Gymnasium

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Start an episode; see the class for `options`.

        Raises:
            ValueError: an unknown option, or one that is not understood.
            PlantError: `options["plant"]` is impossible.
        """
        super().reset(seed=seed)
        options = dict(options or {})
        plant, start, state = (options.pop(key, None) for key in ("plant", "start", "state"))
        if options:
            raise ValueError(unknown_options(options, ("plant", "start", "state")))
        if start is not None and state is not None:
            raise ValueError("give either options['start'] or options['state'], not both")
        family = self._family if plant is None else PlantFamily.of(plant, base=self._home)
        family.check_fixed(self._home)
        self._set_plant(family.draw(self.np_random))
        self._begin(self._start_state(start, state))
        if self.render_mode == "human":
            self.render()
        return self._observation(), self._info(0.0, False, False, self._nothing_earned(False))

    def step(self, action: NDArray[Any]) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Hold a voltage for one control period.

        Args:
            action: (1,) V.

        Raises:
            ValueError: the action is not one finite number.
        """
        asked = actions.one(action, "voltage")
        supply = self._rig.plant.supply
        volts = -supply if asked < -supply else supply if asked > supply else asked

        self._advance(volts)
        state = self._read_state()
        x, theta1, theta2, v, w1, w2 = state
        if not abs(x) + abs(theta1) + abs(theta2) + abs(v) + abs(w1) + abs(w2) < DIVERGED:
            info = self._info(volts, volts != asked, True, self._nothing_earned(True))
            return self._observation(), 0.0, True, False, info
        reward, terms = self._earned(state, volts)
        terminated = not -self._rig.rail < x < self._rig.rail or (
            self._can_fall and not (-kernels.FALL <= theta1 <= kernels.FALL and -kernels.FALL <= theta2 <= kernels.FALL)
        )
        self._measure(state)
        if self.render_mode == "human":
            self._draw_frame()
        return self._observation(), reward, terminated, False, self._info(volts, volts != asked, False, terms)

    def render(self) -> NDArray[np.uint8] | None:
        """Draw the rig: a picture (height, width, 3) in `rgb_array` mode, the window in `human` mode.

        Without a display, and unless `MUJOCO_GL` is set, EGL or OSMesa is chosen.

        Raises:
            gymnasium.error.DependencyNotInstalled: Gymnasium's MuJoCo renderer cannot be imported.
            gymnasium.error.Error: a window is asked for and there is no display.
        """
        if self.render_mode is None:
            gymnasium.logger.warn(
                "render() does nothing without a render mode; say gymnasium.make(..., render_mode='rgb_array')"
            )
            return None
        if self._viewer is None:
            if self.render_mode == "human" and not has_display():
                raise gymnasium.error.Error(
                    "render_mode='human' opens a window, and there is no display; say render_mode='rgb_array', or to "
                    "Gymnasium's check_env skip_render_check=True"
                )
            self._viewer = viewer(self.model, self._data, *self._picture)
        if self._compiled is not None:
            self._compiled.show(self._data)
        return self._viewer.render(self.render_mode)

    def _draw_frame(self) -> None:
        """Draw every few steps, so that the window keeps up with time."""
        self._steps += 1
        if self._steps % self._frame_every == 0:
            self.render()

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._viewer is not None:
            self._viewer.close()
            self._viewer = None

    # ------------------------------------------------------------------------------- what wrappers may ask for

    @property
    def plant(self) -> Plant:
        """The plant of this episode."""
        return self._rig.plant

    @property
    def rig(self) -> Rig:
        """The model of this episode, and where its parts are."""
        return self._rig

    @property
    def family(self) -> PlantFamily:
        """What plants are drawn from."""
        return self._family

    @property
    def source(self) -> mjcf.Source:
        """The text of the model, its includes put in place, before any plant is written into it."""
        return self._source

    @property
    def model(self) -> mujoco.MjModel:
        """The compiled model of this episode."""
        return self._rig.model

    @property
    def state(self) -> Array:
        """The simulation's exact state, (6,), as the observation orders it."""
        return np.array(self._read_state())

    @property
    def measured_state(self) -> Array:
        """The state as last observed, (6,): cart, absolute angles, which count turns, and their rates."""
        return np.array(self._observed)

    @staticmethod
    def observation_of(state: Array) -> Array:
        """What the environment observes of states (..., 6)."""
        return state

    @property
    def measured_velocity(self) -> float:
        """Velocity of the cart as last observed, m/s."""
        return self._observed[3]

    @property
    def encoders(self) -> tuple[float, float, float]:
        """Last readings of the three encoders, m and rad; the third is relative to the first pole."""
        x, theta1, theta2 = self._readings
        return x, theta1, theta2 - theta1

    @property
    def time(self) -> float:
        """Simulated time since the reset, s."""
        return self._data.time

    @property
    def friction(self) -> float:
        """Dry friction on the cart at the last physics step, N: what passive elements and frictionloss exert."""
        if self._compiled is not None:
            return self._compiled.friction
        forces = self._actuator_force.tolist()
        force = 0.0
        for i, gear in self._rig.passive:
            force += gear * forces[i]
        if self._rig.frictionloss:
            data = self._data
            rows = (data.efc_type == mujoco.mjtConstraint.mjCNSTR_FRICTION_DOF) & (data.efc_id == self._rig.dofs[0])
            force += float(data.efc_force[rows].sum())
        return force

    def strike(self, impulse: float) -> None:
        """Let the cart take a blow: the rates of cart and poles change at once, by the mass matrix.

        Args:
            impulse: N s, positive towards positive x.

        Raises:
            ValueError: the impulse is not a finite number.
        """
        if not math.isfinite(impulse):
            raise ValueError(f"the impulse is {impulse}; it must be a finite number of N s")
        model, data = self._rig.model, self._data
        mujoco.mj_forward(model, data)  # the mass matrix of this very position
        blow, change = np.zeros((1, model.nv)), np.zeros((1, model.nv))
        blow[0, self._rig.dofs[0]] = impulse
        mujoco.mj_solveM(model, data, change, blow)
        self._qvel[:] += change[0]

    # -------------------------------------------------------------------------------------------- simulation

    def _set_plant(self, plant: Plant) -> None:
        """Compile the model for a plant, unless it is the one at work."""
        if hasattr(self, "_rig") and self._rig.plant == plant:
            return
        if getattr(self, "_viewer", None) is not None:
            self.close()  # it draws the model that is now replaced
        self._rig = rig = Rig.of(self._source, plant)
        if self.engine == "compiled" and not (self._compiled and self._compiled.become(rig)):
            self._compiled = _compiled(rig)
        self._command = np.zeros(rig.model.nu)
        self._data = mujoco.MjData(rig.model)
        self._keep, self._gain = kernels.velocity_gains(plant.encoders.velocity_filter, plant.control_period)
        self._frame_every = max(1, round(1 / (FRAMES_PER_SECOND * plant.control_period)))
        self._bind()

    def _bind(self) -> None:
        """Hold views into the simulation's arrays; asking `data` for them costs more than using them."""
        data = self._data
        self._qpos, self._qvel, self._ctrl = data.qpos, data.qvel, data.ctrl
        self._actuator_force = data.actuator_force

    def _advance(self, volts: float) -> None:
        rig = self._rig
        if self._compiled is not None:
            self._compiled.advance(self._data, volts)
        elif rig.physics.extras:
            self._command[rig.motor] = volts
            rig.physics.step(self._data, self._command, rig.steps)
        else:
            self._ctrl[rig.motor] = volts
            mujoco.mj_step(rig.model, self._data, rig.steps)

    def _read_state(self) -> State:
        q, v = self._qpos.tolist(), self._qvel.tolist()
        a, b, c = self._rig.positions
        i, j, k = self._rig.dofs
        theta1, w1 = q[b], v[j]
        return q[a], theta1, theta1 + q[c], v[i], w1, w1 + v[k]

    def _measure(self, state: State) -> None:
        """Read the encoders, update the velocity filter, and note what is observed."""
        x0, a0, b0 = self._readings
        v0, w0, u0 = self._rates
        keep, gain = self._keep, self._gain
        x, theta1, theta2 = self._readings = self._read_encoders()
        v, w1, w2 = self._rates = (
            kernels.velocity(x, x0, v0, keep, gain),
            kernels.velocity(theta1, a0, w0, keep, gain),
            kernels.velocity(theta2, b0, u0, keep, gain),
        )
        self._observed = state if self.exact_state else (x, theta1, theta2, v, w1, w2)

    def _read_encoders(self) -> tuple[float, float, float]:
        """Readings of the cart and the two absolute angles."""
        encoders = self._rig.plant.encoders
        if self._rig.joint_readings:
            q = self._qpos.tolist()
            a, b, c = self._rig.positions
            x, joint1, joint2 = q[a], q[b], q[c]
        else:
            mujoco.mj_forward(self._rig.model, self._data)
            sensed = self._rig.physics.sense(self._data.sensordata, self._lag, self._rig.plant.control_period)
            x, joint1, joint2 = (float(sensed[i]) for i in self._rig.sensors)
        if encoders.noise:
            noise = self.np_random.standard_normal(3).tolist()
            x += encoders.noise * encoders.cart * noise[0]
            joint1 += encoders.noise * encoders.pole * noise[1]
            joint2 += encoders.noise * encoders.pole * noise[2]
        theta1 = kernels.quantise(joint1, encoders.pole)
        return kernels.quantise(x, encoders.cart), theta1, theta1 + kernels.quantise(joint2, encoders.pole)

    def _begin(self, state: State) -> None:
        """Put the rig, its motor and the velocity filter into a state."""
        x, theta1, theta2, v, w1, w2 = state
        mujoco.mj_resetData(self._rig.model, self._data)
        for address, value in zip(self._rig.positions, (x, theta1, theta2 - theta1), strict=True):
            self._qpos[address] = value
        for address, value in zip(self._rig.dofs, (v, w1, w2 - w1), strict=True):
            self._qvel[address] = value
        for qpos, led_by, dof, driven_by in self._rig.ties:
            self._qpos[qpos], self._qvel[dof] = self._qpos[led_by], self._qvel[driven_by]
        for address, along in self._rig.slips:  # unbent where the episode begins
            self._data.plastic[address : address + 2] = np.dot(along, self._data.qpos)
        mujoco.mj_forward(self._rig.model, self._data)
        if self._compiled is not None:
            self._compiled.begin(state)
        self._lag = self._rig.physics.sensor_memory(self._data.sensordata)
        self._can_fall = self._balances and abs(theta1) <= kernels.FALL and abs(theta2) <= kernels.FALL
        self._steps = 0
        self._readings = self._read_encoders()
        self._rates = (v, w1, w2)
        self._observed = state if self.exact_state else (*self._readings, *self._rates)
        if not all(map(math.isfinite, (*self._observed, *self._data.qacc))):
            raise mjcf.MjcfError(
                f"{self._source.name}: from the state {state} on, the model with this plant gives no finite numbers; "
                "check masses, forces and the numbers under <custom>"
            )

    # --------------------------------------------------------------------- what makes a task of the rig

    def _start_state(self, start: Any, state: Any) -> State:
        """The state in which an episode starts, as the reset options `start` and `state` want it."""
        return start_state(self.np_random, start, state)

    def _observation(self) -> Array:
        """What is observed now."""
        return self.observation_of(np.array(self._observed))

    def _earned(self, state: State, volts: float) -> tuple[float, dict[str, Any]]:
        """The reward of a step that ended in a state, and its terms for `info`."""
        x, theta1, theta2, *_ = state
        a, b, c, d = kernels.costs(x, theta1, theta2, volts, self._rig.rail, self._rig.plant.supply)
        terms = {"reward_survive": 1.0, "cost_cart": a, "cost_pole1": b, "cost_pole2": c, "cost_voltage": d}
        return 1.0 - a - b - c - d, terms

    def _nothing_earned(self, diverged: bool) -> dict[str, Any]:
        """The terms at a reset, or of a step in which the simulation diverged."""
        return {"reward_survive": 0.0 if diverged else 1.0, **dict.fromkeys(COSTS, 0.0)}

    def _info(self, volts: float, clipped: bool, diverged: bool, terms: dict[str, Any]) -> dict[str, Any]:
        return {
            **terms,
            "voltage": volts,
            "clipped": clipped,
            "friction": 0.0 if diverged else self.friction,
            "time": self._data.time,
            "diverged": diverged,
        }

    # ------------------------------------------------------------------------------------- pickling

    def __getstate__(self) -> dict[str, Any]:
        """Everything, the simulation's hidden state included, but the window and the views into the arrays."""
        views = ("_qpos", "_qvel", "_ctrl", "_actuator_force")
        return {**{key: value for key, value in self.__dict__.items() if key not in views}, "_viewer": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._bind()


def _compiled(rig: Rig) -> Any:
    from dipc_gym.rigs.one import CompiledRig  # LLVM takes a while to import

    return CompiledRig(rig)


@functools.cache
def _own_rig() -> mjcf.Source:
    return mjcf.Source(None, Path(), resources.files("dipc_gym").joinpath("rig.xml").read_text(encoding="utf-8"))


def _check_camera(source: mjcf.Source, camera: str | None) -> None:
    """Refuse a camera that was asked for and that the model does not have; one's own model need not have ours."""
    if camera is None or camera == "side":
        return
    model = mjcf.compile(source)
    cameras = [model.camera(k).name for k in range(model.ncam)]
    if camera not in cameras:
        known = f"has {', '.join(cameras)}{suggestion(str(camera), cameras)}" if cameras else "has none"
        raise ValueError(f"camera is {camera!r}; {source.name} {known}; None is MuJoCo's free camera")


def _checked_model(path: str | Path) -> mjcf.Source:
    source = mjcf.read(path)
    model = mjcf.compile(source)
    controls = mjcf.controls(model, source.name)
    if "motor" not in controls:
        raise mjcf.MjcfError(f"{source.name}: no actuator 'motor' with a control; there are {controls}")
    # A plant is written into a single text that says the time step, wherever the model has it from.
    document = Document(source)
    document.option(timestep=model.opt.timestep)
    return source.edited(document.text())


def start_state(rng: np.random.Generator, start: Any = None, state: Any = None) -> State:
    """The state in which an episode starts, as the reset options `start` and `state` want it.

    Raises:
        ValueError: an option that is not understood.
    """
    if state is not None:
        return _state(state)
    if start not in (None, "upright", "hanging"):
        near = suggestion(str(start), ("upright", "hanging"))
        raise ValueError(f"options['start'] is {start!r}; it can be 'upright' or 'hanging'{near}")
    x, theta1, theta2 = rng.uniform(-START_SPREAD, START_SPREAD, 3).tolist()
    down = math.pi if start == "hanging" else 0.0
    return x, theta1 + down, theta2 + down, 0.0, 0.0, 0.0


def unknown_options(given: Iterable[str], known: Sequence[str]) -> str:
    """What to say of reset options that there are not."""
    unknown = sorted(map(str, given))
    there_are = " and ".join((", ".join(map(repr, known[:-1])), repr(known[-1])))
    return f"unknown reset options {unknown}; there are {there_are}{suggestion(unknown[0], known)}"


def _state(values: Any) -> State:
    try:
        x, theta1, theta2, v, w1, w2 = (float(value) for value in values)
        if math.isfinite(x + theta1 + theta2 + v + w1 + w2):
            return x, theta1, theta2, v, w1, w2
    except (TypeError, ValueError):
        pass
    raise ValueError(f"options['state'] must be six finite numbers, as observed; this is {values!r}")
