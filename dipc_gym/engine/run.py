"""Programs on windows: arrays in, readings and their derivatives out."""

from __future__ import annotations

import ctypes
import functools
import os
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dipc_gym.engine import machine
from dipc_gym.engine.kernel import write_kernel
from dipc_gym.engine.laws import Rule
from dipc_gym.engine.layout import JOINTS, STOPS, At, Head, Row
from dipc_gym.engine.loop import write_loop
from dipc_gym.engine.program import Program, rules
from dipc_gym.engine.rigid import Tree
from dipc_gym.engine.uncovered import Uncovered
from dipc_gym.engine.values import LANES

Array = NDArray[np.float64]
Whole = NDArray[np.int64]

PAYS = 4  # packs of directions from which it pays to ask first which of them windows feel
NOTHING = 1e-10  # share of what a pack changes where it changes most: a window with less than this does not feel it


@dataclass(frozen=True)
class Commands:
    """Held commands of all recordings, one after the other.

    Attributes:
        stamps: from which on each sample is held, s, (samples,).
        values: (sets, samples, controls); a set for each way in which commands reach the model.
    """

    stamps: Array
    values: Array


@dataclass(frozen=True)
class Jobs:
    """What is to be simulated.

    Attributes:
        parameters: (variants, k).
        initial: states at each window's start, (variants, windows, nx).
        clock: time stamp of each window's start, s, (windows,).
        first: sample of `commands` from which each window reads, (windows,).
        count: samples from there on, (windows,).
        commands: all of them.
        which: set of commands that each variant gets, (variants,).
        times: at which sensors are read after the start, s, (windows, sensors, samples).
        until: s after the start to which each window is simulated, (windows,).
        limits: whether what limits do has to be known; else a joint that leaves its range ends its simulation.
    """

    parameters: Array
    initial: Array
    clock: Array
    first: Whole
    count: Whole
    commands: Commands
    which: Whole
    times: Array
    until: Array
    limits: bool = True


@dataclass(frozen=True)
class Directions:
    """Ways in which the first variant may change.

    Attributes:
        parameters: change of the parameters, (d, k).
        initial: change of the initial states, (d, windows, nx).
        commanding: which of them change commands, (m,).
        commands: change of the commands in these, (m, samples, controls).
    """

    parameters: Array
    initial: Array
    commanding: Whole = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    commands: Array | None = None


def run(program: Program, jobs: Jobs, step: float, *, threads: int = 0) -> tuple[Array, Array]:
    """Simulate every window with every variant.

    Args:
        program: of the model.
        jobs: what to simulate.
        step: longest step, s.
        threads: 0 for all cores.

    Returns:
        Readings (variants, windows, sensors, samples), not a number from where one diverged, and the states at the end,
        (variants, windows, nx).

    Raises:
        Uncovered: a joint left its range, and it matters what its limit does.
    """
    variants, windows, nx = jobs.initial.shape
    variant, window = (each.ravel() for each in np.indices((variants, windows)))
    rows = _rows(jobs, window)
    rows[:, Row.PARAMETERS] = variant
    rows[:, Row.COMMANDS] += jobs.which[variant] * len(jobs.commands.stamps)
    out = np.empty((variants, windows, *jobs.times.shape[1:]))
    ends = np.empty((variants, windows, nx))
    _call(program, jobs, rows, jobs.initial, step, threads, out, ends, {})
    return out, ends


def differentiate(
    program: Program, jobs: Jobs, directions: Directions, step: float, *, threads: int = 0
) -> tuple[Array, Array, Array, Array]:
    """Simulate every window with one variant, and how readings change in some directions.

    Args:
        program: of the model.
        jobs: what to simulate; one variant.
        directions: ways to change.
        step: longest step, s.
        threads: 0 for all cores.

    Returns:
        Readings (windows, sensors, samples), their changes (d, windows, sensors, samples), the states at the end
        (windows, nx), and their changes (d, windows, nx).

    Raises:
        Uncovered: a joint left its range, and it matters what its limit does.
    """
    felt = np.ones((max(1, -(-len(directions.parameters) // LANES)), jobs.initial.shape[1]), dtype=bool)
    if len(felt) >= PAYS:
        felt = _felt(program, jobs, directions, step, threads)
    return _along(program, jobs, directions, felt, step, threads)


def _felt(program: Program, jobs: Jobs, directions: Directions, step: float, threads: int) -> NDArray[np.bool_]:
    """Which packs of directions change anything in each window, (packs, windows).

    A window meets a few values of a table and none of the others; a sum of the directions of each pack, with factors at
    random so that none makes up for another, tells which.
    """
    count = len(directions.parameters)
    packs, k = -(-count // LANES), np.arange(count)
    factors = np.zeros((packs, count))
    factors[k // LANES, k] = np.random.default_rng(0).uniform(1.0, 2.0, count) * (1 - 2 * (k % 2))
    sums = Directions(factors @ directions.parameters, np.tensordot(factors, directions.initial, 1))
    if directions.commands is not None:
        moving = np.unique(directions.commanding // LANES)
        shares = factors[np.ix_(moving, directions.commanding)]
        sums = replace(sums, commanding=moving, commands=np.tensordot(shares, directions.commands, 1))
    all_of = np.ones((-(-packs // LANES), jobs.initial.shape[1]), dtype=bool)
    _, readings, _, ends = _along(program, jobs, sums, all_of, step, threads)
    size = np.maximum(np.abs(readings).max(axis=(2, 3), initial=0.0), np.abs(ends).max(axis=2, initial=0.0))
    felt = ~(size <= NOTHING * np.nanmax(size, axis=1, keepdims=True, initial=0.0))  # what diverged is felt
    felt[0] |= ~felt.any(axis=0)  # readings are asked for all the same
    return np.asarray(felt)


def _along(
    program: Program, jobs: Jobs, directions: Directions, felt: NDArray[np.bool_], step: float, threads: int
) -> tuple[Array, Array, Array, Array]:
    """`differentiate`, with each pack of directions in the windows that feel it, (packs, windows); at least one in
    each.
    """
    (packs, windows), count, nx = felt.shape, len(directions.parameters), jobs.initial.shape[2]
    pack, window = np.nonzero(felt)
    rows = _rows(jobs, window)
    rows[:, Row.DIRECTIONS] = pack
    commands = jobs.commands.values[jobs.which[0]][None]
    if directions.commands is None:
        moved = _still(commands.shape)
    else:  # a set for each pack that changes commands, after one for all others
        packed, lane = np.divmod(directions.commanding, LANES)
        moving, which = np.unique(packed, return_inverse=True)
        commands = np.repeat(commands, 1 + len(moving), axis=0)
        moved = np.zeros((*commands.shape, LANES))
        moved[1 + which, :, :, lane] = directions.commands
        sets = np.zeros(packs, dtype=np.int64)
        sets[moving] = 1 + np.arange(len(moving))
        rows[:, Row.COMMANDS] += sets[pack] * len(jobs.commands.stamps)
    out = np.empty((len(rows), *jobs.times.shape[1:]))
    ends = np.empty((len(rows), nx))
    tangents = {
        At.PARAMETER_TANGENTS: _packed(directions.parameters, packs),
        At.INITIAL_TANGENTS: _packed(directions.initial, packs)[pack, window],
        At.COMMAND_TANGENTS: moved,
        At.READING_TANGENTS: np.zeros((*out.shape, LANES)),
        At.END_TANGENTS: np.zeros((*ends.shape, LANES)),
    }
    sent = replace(jobs, commands=Commands(jobs.commands.stamps, commands))
    _call(program, sent, rows, jobs.initial[0, window], step, threads, out, ends, tangents)
    found = list[Array]()
    for values, at in ((out, At.READING_TANGENTS), (ends, At.END_TANGENTS)):
        whole, changes = np.empty((windows, *values.shape[1:])), np.zeros((packs, LANES, windows, *values.shape[1:]))
        whole[window] = values
        changes[pack, :, window] = np.moveaxis(tangents[at], -1, 1)
        found += [whole, changes.reshape(packs * LANES, *whole.shape)[:count]]
    readings, by_readings, states, by_states = found
    return readings, by_readings, states, by_states


def _rows(jobs: Jobs, window: Whole) -> Whole:
    """Simulations of these windows with the first variant, (rows, Row.SIZE)."""
    rows = np.zeros((len(window), int(Row.SIZE)), dtype=np.int64)
    rows[:, Row.WINDOW] = window
    rows[:, Row.COMMANDS] = rows[:, Row.STAMPS] = jobs.first[window]
    rows[:, Row.COUNT] = jobs.count[window]
    return rows


@functools.lru_cache(maxsize=1)
def _still(shape: tuple[int, ...]) -> Array:
    """Tangents of commands that do not change; as many numbers as recordings have, and asked for in every fit."""
    return np.zeros((*shape, LANES))


def _packed(directions: Array, packs: int) -> Array:
    """Directions (d, ...) in packs of LANES, (packs, ..., LANES)."""
    whole = np.zeros((packs * LANES, *directions.shape[1:]))
    whole[: len(directions)] = directions
    return np.ascontiguousarray(np.moveaxis(whole.reshape(packs, LANES, *directions.shape[1:]), 1, -1))


def _call(
    program: Program,
    jobs: Jobs,
    rows: Whole,
    initial: Array,
    step: float,
    threads: int,
    out: Array,
    ends: Array,
    tangents: dict[At, Array],
) -> None:
    codes = program.codes.copy()
    codes[Head.SAMPLES] = jobs.times.shape[2]
    count = len(rows)
    left = np.zeros(count, dtype=np.int64)
    arrays: dict[At, NDArray[np.generic]] = {
        At.PROGRAM: codes,
        At.PARAMETERS: jobs.parameters,
        At.INITIAL: initial,
        At.ENDS: ends,
        At.ROWS: rows,
        At.STAMPS: jobs.commands.stamps,
        At.COMMANDS: jobs.commands.values,
        At.TIMES: jobs.times,
        At.READINGS: out,
        At.STEP: np.array([step]),
        At.UNTIL: jobs.until,
        At.CLOCK: jobs.clock,
        At.LEFT: left,
        **tangents,
    }
    kept: dict[At, Any] = {at: np.ascontiguousarray(array) for at, array in arrays.items()}
    table = (ctypes.c_void_p * int(At.SIZE))()
    for at, array in kept.items():
        table[at] = array.ctypes.data
    function = _function(program.tree, bool(tangents))
    workers = min(cores(threads), max(1, count // 4))
    # Rows differ in what they cost; small shares even that out.
    borders = np.linspace(0, count, (4 * workers if workers > 1 else 1) + 1).astype(int)
    shares = list(zip(borders[:-1].tolist(), borders[1:].tolist(), strict=True))
    each = pool(workers, os.getpid()).map if workers > 1 else map
    list(each(functools.partial(_simulate, function, table, kept), shares))
    if jobs.limits and left.any():
        raise Uncovered("a joint that meets its limit")


def _simulate(function: Any, table: Any, kept: Mapping[At, Any], rows: tuple[int, int]) -> None:
    """Simulate some rows; a thread that Ctrl-C leaves behind goes on writing, into arrays that this keeps."""
    function(table, *rows)


def cores(threads: int) -> int:
    """How many cores what was given `threads`, 0 for all, may use: of all those that this process may.

    Example:
        >>> cores(3)
        3
    """
    return threads or (len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1)


@functools.lru_cache(maxsize=4)
def pool(workers: int, process: int) -> ThreadPoolExecutor:
    """Threads of this process; a fork has none of its parent's."""
    return ThreadPoolExecutor(workers, thread_name_prefix="engine")


def _function(tree: Tree, tangents: bool) -> Any:
    """The compiled function; calls of it let other threads run.

    A law may be registered at any time, and is in none that was compiled before.
    """
    return _compiled(tree, tangents, rules())


@functools.lru_cache(maxsize=256)
def _compiled(tree: Tree, tangents: bool, rules: tuple[Rule, ...]) -> Any:
    return machine.load([_loop(tangents, rules), write_kernel(tree)], ["run", "probe"]).function(
        "run", pointers=1, counts=2
    )


def rates(
    program: Program, parameters: Array, states: Array, commands: Array, time: float, touching: Sequence[bool] = ()
) -> Array:
    """Rates of the states (nx,) of a model whose joints all slide in the direction of their motion.

    Args:
        program: of the model.
        parameters: (k,).
        states: (nx,).
        commands: (controls,).
        time: s.
        touching: which stops are met: joints' limits that are springs in their order, then those of tendons.
    """
    n = program.codes[Head.JOINTS]
    function = _function(program.tree, False)
    probe = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 16)(function.library.addresses["probe"])
    signs = np.zeros(JOINTS + STOPS)
    signs[:n], signs[JOINTS : JOINTS + len(touching)] = np.sign(states[n : 2 * n]), touching
    out, forces = np.zeros(len(states)), np.zeros((2, n))
    now = np.array([time, 1e-12])
    arrays = [program.codes, parameters, None, commands, None, signs, now, None, states, None, out, None]
    arrays += [forces[0], None, forces[1], None]
    probe(*(None if array is None else array.ctypes.data for array in arrays))
    return out


@functools.lru_cache(maxsize=4)
def _loop(tangents: bool, rules: tuple[Rule, ...]) -> str:
    return str(write_loop(rules, tangents=tangents))
