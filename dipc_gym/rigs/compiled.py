"""Rigs as machine code of the engine, eight of them to an instruction."""

from __future__ import annotations

import ctypes
import functools
import math
import os
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from dipc_gym import mjcf
from dipc_gym.engine import Uncovered, machine
from dipc_gym.engine import program as programs
from dipc_gym.engine.check import check
from dipc_gym.engine.ensemble import WIDTH, require
from dipc_gym.engine.layout import JOINTS, Head
from dipc_gym.engine.motion import FOLLOWED
from dipc_gym.engine.program import Program
from dipc_gym.engine.run import cores, pool
from dipc_gym.plant import Plant
from dipc_gym.rigs.batch import free_at_rest
from dipc_gym.rigs.code import CHUNK, At, Flag, Kept, Own, Places, Run, Term, write
from dipc_gym.rigs.numbers import PlantNumbers
from dipc_gym.rigs.rig import DIVERGED, Rig
from dipc_gym.rigs.together import COSTS, Array, Encoders, Mask, Period, Rows, absolute, readings

_STATES = int(Kept.SIZE)  # where a rig's states begin in what it remembers
_PARAMETERS = int(Own.SIZE)


class CompiledRigs:
    """Rigs of one layout; see `together.Rigs`.

    Args:
        rig: that knows the model; its plant has the longest delay.
        encoders: theirs, one a rig.
        exact_state: whether the state is observed.
        threads: 0 for one a core.

    Raises:
        MjcfError: the model has what this engine leaves out.
    """

    def __init__(self, rig: Rig, encoders: Encoders, *, exact_state: bool = False, threads: int = 1) -> None:
        n = len(encoders.noise)
        self._rig, self._encoders, self._exact, self.count = rig, encoders, exact_state, n
        self._program, parameters, places = _read(rig)
        self._past, self._command, self._cart = places.past, places.command, places.speeds[0]
        self._text = write(self._program.tree, tuple(self._program.codes.tolist()), places)
        groups = -(-n // WIDTH)
        self._threads = min(cores(threads), -(-groups // CHUNK))
        try:
            check(self._program, parameters, rig.endless, self._rates)
        except Uncovered as reason:
            raise mjcf.MjcfError(f"{rig.source.name}: engine 'compiled' is refused for {reason}") from None
        self._plants, self._free_at_rest = PlantNumbers(rig, self._program, parameters), free_at_rest(rig)
        numbers = np.concatenate([np.zeros(_PARAMETERS), self._plants.of([rig.plant])[0]])
        numbers[[Own.STEP, Own.SUPPLY, Own.RAIL]] = rig.model.opt.timestep, rig.plant.supply, rig.rail
        # One group of numbers serves all while they are the same.
        self._numbers = np.repeat(numbers[None, :, None], WIDTH, axis=2)
        self._write_encoders(slice(None), slice(None), np.zeros(1, dtype=np.intp))
        self._memory = np.zeros((groups, _STATES + self._program.nx + places.past, WIDTH))
        self._new = np.zeros(self._memory.shape[1])
        self._new[_STATES : _STATES + rig.model.nq] = rig.model.qpos0
        speeds = rig.model.nq  # hinges and slides have as many
        self._joints = _STATES + np.array([*rig.positions, *(speeds + dof for dof in rig.dofs)])
        ties = [pair for q, led, dof, driven in rig.ties for pair in ((q, led), (speeds + dof, speeds + driven))]
        self._followers, self._leaders = _STATES + np.array(ties, dtype=np.intp).reshape(-1, 2).T
        self._asked, self._still = np.zeros(groups * WIDTH), np.zeros((3, groups * WIDTH))
        self._observed = np.zeros((groups * WIDTH, 6))
        self._head = 0
        self._bound: tuple[Any, Any, Any] | None = None

    # ---------------------------------------------------------------------------------------------- what is known

    @property
    def time(self) -> Array:
        """Since each reset, (n,) s."""
        return self._remembered(Kept.TIME)

    @property
    def friction(self) -> Array:
        """Dry friction on each cart at the last physics step, (n,) N."""
        return self._remembered(Kept.FRICTION)

    @property
    def state(self) -> Array:
        """Exact states, (n, 6), as observed."""
        return absolute(self._by_row(self._joints)).T

    @property
    def measured(self) -> Array:
        """Readings of the encoders, angles absolute, and velocities worked out from them, (6, n)."""
        return self._by_row(np.arange(6) + int(Kept.MEASURED))

    def motion(self, row: int) -> Array:
        """A view of positions and speeds of all joints of one rig, (2 nq,), m, rad and their rates."""
        return self._memory[row // WIDTH, _STATES : _STATES + 2 * self._rig.model.nq, row % WIDTH]

    def observations(self) -> Array:
        """What is observed now, (n, 6), as an array of its own."""
        return self._observed[: self.count].copy()

    def _remembered(self, what: int) -> Array:
        return self._memory[:, int(what)].reshape(-1)[: self.count].copy()

    def _by_row(self, what: Rows) -> Array:
        return np.moveaxis(self._memory[:, what], 1, 0).reshape(len(what), -1)[:, : self.count].copy()

    # -------------------------------------------------------------------------------------------------- simulation

    def become(self, rows: Rows, plants: Sequence[Plant]) -> None:
        """Give plants to rows, whose encoders have them already."""
        if len(self._numbers) < len(self._memory):
            self._numbers, self._bound = np.repeat(self._numbers, len(self._memory), axis=0), None
        group, lane = np.divmod(rows, WIDTH)
        self._numbers[group, _PARAMETERS:, lane] = self._plants.of(plants)
        self._write_encoders(group, lane, rows)

    def _write_encoders(self, group: Any, lane: Any, rows: Rows) -> None:
        own = self._encoders
        columns = {Own.CART: own.counts[0], Own.POLE: own.counts[1], Own.KEEP: own.keep, Own.GAIN: own.gain}
        for what, numbers in columns.items():
            self._numbers[group, int(what), lane] = numbers[rows]

    def begin(self, rows: Rows, states: Array, can_fall: Mask, noise: Array) -> Array:
        """Put rows into states (rows, 6), the motor at rest; the dry friction there, (rows,) N."""
        joints = states.copy()
        joints[:, 2] -= states[:, 1]
        joints[:, 5] -= states[:, 4]
        fresh = np.repeat(self._new[None], len(rows), axis=0)
        fresh[:, self._joints] = joints
        fresh[:, self._followers] = fresh[:, self._leaders]
        first = 2 * self._rig.model.nq + self._rig.model.na
        for k, (_, along) in enumerate(self._rig.slips):  # springs that yield are unbent where the episode begins
            fresh[:, _STATES + first + k] = fresh[:, _STATES : _STATES + len(along)] @ along
        fresh[:, Kept.CAN_FALL] = can_fall
        measured = fresh[:, Kept.MEASURED : Kept.MEASURED + 6]
        measured[:, :3] = readings((joints[:, :3] + noise).T, self._encoders.counts[:, rows]).T
        measured[:, 3:] = states[:, 3:]
        seen = states if self._exact else measured
        fresh[:, Kept.OBSERVED : Kept.OBSERVED + 6] = self._observed[rows] = seen
        if not self._free_at_rest or states[:, 3:].any():
            group, lane = np.divmod(rows, WIDTH)
            for i, state in enumerate(fresh[:, _STATES : _STATES + self._program.nx]):
                own = self._numbers[group[i] if len(self._numbers) > 1 else 0, :, lane[i]]
                passive = self._probe(own[_PARAMETERS:], state, np.zeros(1), 0.0, own[Own.STEP] * FOLLOWED)[1]
                fresh[i, Kept.FRICTION] = passive[self._cart]
        self._memory[rows // WIDTH, :, rows % WIDTH] = fresh
        return fresh[:, Kept.FRICTION]

    def hold(self, volts: Array) -> None:
        """Only the physics of `advance`, for an environment that does the rest itself."""
        self._step(volts)
        self._run(True, False, self._still, self._still, self._still)

    def advance(self, asked: Array, going: Mask, noise: Callable[[Mask], Array] | None) -> Period:
        """Hold voltages for one control period; what is said of rows that are not `going` means nothing."""
        n, rows = self.count, len(self._asked)
        terms, flags = np.empty((int(Term.SIZE), rows)), np.empty((int(Flag.SIZE), rows), dtype=bool)
        self._step(asked)
        if noise is None:
            self._run(True, True, self._still, terms, flags)
        else:
            self._run(True, False, self._still, terms, flags)
            added = self._still.copy()
            added[:, :n] = noise(going & (np.abs(self.state).T.sum(axis=0) < DIVERGED))
            self._run(False, True, added, terms, flags)
        rewards, survived, *costs, volts, friction, time = terms[:, :n]
        if not going.all():
            rewards[~going] = 0.0
        terminated, clipped, diverged = flags[:, :n]
        infos: dict[str, Any] = {"reward_survive": survived, **dict(zip(COSTS, costs, strict=True))}
        infos |= {"friction": friction, "voltage": volts, "clipped": clipped, "time": time, "diverged": diverged}
        return Period(rewards, terminated & going, infos)

    def _step(self, asked: Array) -> None:
        self._asked[: self.count] = asked
        if self._past:
            self._head = (self._head + 1) % self._past

    # ------------------------------------------------------------------------------------------------ machine code

    def _run(self, advance: bool, observe: bool, noise: Array, terms: Array, flags: Any) -> None:
        whole, table, run = self._bound = self._bound or self._bind()
        whole[Run.STEPS], whole[Run.OBSERVE], whole[Run.HEAD] = self._rig.steps * advance, observe, self._head
        whole[Run.TURN] = 0
        if observe:
            table[At.NOISE], table[At.TERMS], table[At.FLAGS] = (x.ctypes.data for x in (noise, terms, flags))
        others = self._threads - 1
        waiting = [pool(others, os.getpid()).submit(run, table) for _ in range(others)] if others else []
        run(table)
        for one in waiting:
            one.result()

    def _bind(self) -> tuple[Any, Any, Any]:
        """What the machine code is given, with the addresses of arrays that stay."""
        whole, table = (ctypes.c_int64 * int(Run.SIZE))(), (ctypes.c_void_p * int(At.SIZE))()
        whole[Run.GROUPS], whole[Run.EXACT] = len(self._memory), self._exact
        whole[Run.STRIDE] = self._numbers.shape[1] * (len(self._numbers) > 1)
        table[At.RUN] = ctypes.addressof(whole)
        for at, array in (
            (At.NUMBERS, self._numbers),
            (At.MEMORY, self._memory),
            (At.ASKED, self._asked),
            (At.OBSERVED, self._observed),
        ):
            table[at] = array.ctypes.data
        return whole, table, _functions(self._text)[0]

    def __getstate__(self) -> dict[str, Any]:
        """Everything but addresses."""
        return {**self.__dict__, "_bound": None}

    def _probe(
        self, parameters: Array, states: Array, commands: Array, time: float, shortest: float
    ) -> tuple[Array, Array]:
        """Rates of the states (nx,) of one rig, and the forces of its passive actuators on joints."""
        inside = (parameters, commands, np.array([time]), states, np.array([shortest]))
        lanes = [np.repeat(np.asarray(numbers, dtype=float)[:, None], WIDTH, axis=1) for numbers in inside]
        rates, passive = np.zeros((len(states), WIDTH)), np.zeros((JOINTS, WIDTH))
        _functions(self._text)[1](*(array.ctypes.data for array in (*lanes, rates, passive)))
        return rates[:, 0], passive[:, 0]

    def _rates(
        self, program: Program, parameters: Array, states: Array, commands: Array, time: float, touching: Sequence[bool]
    ) -> Array:
        """What `check` compares with MuJoCo; stops mean nothing here."""
        return self._probe(parameters, states, commands, time, 1e-12)[0]


def _read(rig: Rig) -> tuple[Program, Array, Places]:
    """The program of a rig, its parameters (k,), and where the environment finds what it needs."""
    model = rig.model
    try:
        program, variants = programs.read([rig.endless])
        parameters = variants[0]
        if len(limited := np.flatnonzero(rig.endless.model.jnt_limited)):
            raise Uncovered(f"the range of joint {model.joint(limited[0]).name!r}")
        require(program, parameters)
        if rig.physics.stage("command"):
            raise Uncovered("what <custom> does to commands")
        if not rig.joint_readings:
            raise Uncovered("a sensor with a delay")
    except Uncovered as reason:
        raise mjcf.MjcfError(
            f"{rig.source.name}: engine 'compiled' does not simulate {reason}; make it with engine='mujoco'"
        ) from None
    delay = float(parameters[program.codes[Head.DELAYS] + rig.motor])
    past = math.ceil(delay / rig.plant.control_period) + 2 if delay > 0 else 0
    x, q1, q2 = rig.positions
    v, w1, w2 = rig.dofs
    return program, parameters, Places((x, q1, q2), (v, w1, w2), rig.motor, past)


@functools.lru_cache(maxsize=64)
def _functions(text: str) -> tuple[Any, Any]:
    """`run` and `probe`; calls of them let other threads run."""
    library = machine.load([text], ["run", "probe"])
    run = ctypes.CFUNCTYPE(None, ctypes.c_void_p)(library.addresses["run"])
    probe = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 7)(library.addresses["probe"])
    run.library = library  # type: ignore[attr-defined]
    return run, probe
