"""A control period of many rigs as machine code: the physics, then what the environment makes of it.

The environment's arithmetic is that of `kernels`, the same functions, with each operation rounded by itself: the
single environment works it out on Python's floats and gets the same bits.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

from llvmlite import ir

from dipc_gym import kernels
from dipc_gym.engine.code import Code, Numbers, integer
from dipc_gym.engine.ensemble import WIDTH, Ensemble, Stepper
from dipc_gym.engine.layout import JOINTS, Head
from dipc_gym.engine.rigid import Tree
from dipc_gym.engine.values import INT, POINTER, REAL, Value, where
from dipc_gym.rigs.rig import DIVERGED

CHUNK = 16  # groups of rigs that a thread takes at once


class At(IntEnum):
    """Addresses that a run is given."""

    RUN = 0  # whole numbers
    NUMBERS = 1  # of each group of rigs, or of all
    MEMORY = 2
    ASKED = 3  # volts, (rows,)
    NOISE = 4  # on the joints' readings, (3, rows)
    OBSERVED = 5  # (rows, 6)
    TERMS = 6  # (TERMS, rows)
    FLAGS = 7  # (FLAGS, rows)
    SIZE = 8


class Run(IntEnum):
    """Whole numbers of a run."""

    GROUPS = 0
    STRIDE = 1  # from one group's numbers to the next's; 0 where all have the same
    STEPS = 2  # of the physics; none to leave it alone
    OBSERVE = 3  # whether what follows is worked out
    EXACT = 4  # whether the state is observed
    HEAD = 5  # place of this period's command among those kept
    TURN = 6  # group that is next to be taken
    SIZE = 7


class Own(IntEnum):
    """Numbers of a rig; its program's parameters follow."""

    STEP = 0
    SUPPLY = 1
    RAIL = 2
    CART = 3  # metres a count
    POLE = 4  # radians a count
    KEEP = 5
    GAIN = 6
    SIZE = 7


class Kept(IntEnum):
    """What a rig remembers; its states and past commands follow."""

    TIME = 0
    FRICTION = 1
    CAN_FALL = 2
    MEASURED = 3  # readings and velocities worked out from them
    OBSERVED = 9
    SIZE = 15


class Term(IntEnum):
    """What a period gives, as numbers."""

    REWARD = 0
    SURVIVE = 1
    COSTS = 2  # four
    VOLTAGE = 6
    FRICTION = 7
    TIME = 8
    SIZE = 9


class Flag(IntEnum):
    """What a period gives, as yes or no."""

    TERMINATED = 0
    CLIPPED = 1
    DIVERGED = 2
    SIZE = 3


@dataclass(frozen=True)
class Places:
    """Where the environment finds its rig in a model.

    Attributes:
        positions: of cart, first and second joint among the positions.
        speeds: of the same among the speeds.
        command: of the motor among the controls.
        past: commands kept, 0 where none acts late.
    """

    positions: tuple[int, int, int]
    speeds: tuple[int, int, int]
    command: int
    past: int


@functools.lru_cache(maxsize=64)
def write(tree: Tree, codes: tuple[int, ...], places: Places) -> str:
    """The module with `run(addresses)` and the ensemble's `probe`.

    Args:
        tree: of the program.
        codes: of the program.
        places: of the environment.
    """
    module = ir.Module("rigs")
    ensemble = Ensemble(module, tree, codes)
    advance = _write_advance(module, ensemble, places)
    observe = _write_observe(module, ensemble, places)
    code = Code(module, "run", [POINTER], width=WIDTH)
    (addresses,) = code.function.args
    at: dict[At, Any] = {k: code.pointer(addresses, int(k)) for k in At if k != At.SIZE}
    whole: dict[Run, Any] = {k: code.whole(at[At.RUN], int(k)) for k in Run if k != Run.SIZE}
    size = int(Kept.SIZE) + ensemble.nx + places.past
    with code.repeat() as stop:
        turn = code.offset(at[At.RUN], int(Run.TURN), INT)
        first = code.at.atomic_rmw("add", turn, integer(CHUNK), "monotonic")
        stop(code.at.icmp_signed(">=", first, whole[Run.GROUPS]))
        end = code.sum(first, CHUNK)
        end = code.at.select(code.below(end, whole[Run.GROUPS]), end, whole[Run.GROUPS])
        with code.count(end, first) as group:
            numbers = code.offset(at[At.NUMBERS], code.product(group, whole[Run.STRIDE]))
            memory = code.offset(at[At.MEMORY], code.product(group, size))
            row = code.product(group, WIDTH)
            rows = code.product(whole[Run.GROUPS], WIDTH)
            asked = code.offset(at[At.ASKED], row, REAL)
            with code.when(code.below(integer(0), whole[Run.STEPS])):
                code.at.call(advance, [numbers, memory, asked, whole[Run.STEPS], whole[Run.HEAD]])
            with code.when(code.equal(whole[Run.OBSERVE], 1)):
                code.at.call(
                    observe,
                    [
                        numbers,
                        memory,
                        asked,
                        code.offset(at[At.NOISE], row, REAL),
                        code.offset(at[At.OBSERVED], code.product(row, 6), REAL),
                        code.offset(at[At.TERMS], row, REAL),
                        code.offset(at[At.FLAGS], row, _BYTE),
                        rows,
                        whole[Run.EXACT],
                    ],
                )
    code.finish()
    return str(module)


_BYTE = ir.IntType(8)


def _clipped(asked: Value, supply: Value) -> Value:
    return where(asked < -supply, -supply, where(asked > supply, supply, asked))


# ---------------------------------------------------------------------------------------------------- the physics


def _write_advance(module: ir.Module, ensemble: Ensemble, places: Places) -> ir.Function:
    """Physics steps under the commands that have arrived."""
    code = Code(module, "advance", [POINTER, POINTER, POINTER, INT, INT], internal=True, width=WIDTH)
    own, memory, asked = (code.numbers(argument) for argument in code.function.args[:3])
    steps, head = code.function.args[3:]
    kept, past = memory.since(int(Kept.SIZE)), memory.since(int(Kept.SIZE) + ensemble.nx)
    states, passive = code.scratch(ensemble.nx), code.scratch(JOINTS)
    for k in range(ensemble.nx):
        states[k] = kept[k]
    controls = max(1, int(ensemble.codes[Head.CONTROLS]))
    commands = code.scratch(controls)
    for k in range(controls):
        commands[k] = 0.0
    volts = _clipped(asked[0], own[Own.SUPPLY])
    commands[places.command] = volts
    if places.past:
        past[head] = volts
    parameters = own.since(int(Own.SIZE))
    stepper = Stepper(ensemble, code, parameters, commands)
    length = own[Own.STEP]
    time = code.scratch(1)
    time[0] = memory[Kept.TIME]
    with code.count(steps) as step:
        if places.past:
            delay = parameters[int(ensemble.codes[Head.DELAYS]) + places.command]
            commands[places.command] = _arrived(code, past, head, places.past, steps, step, delay / length)
        stepper.step(time[0], states, length, passive)
        time[0] = time[0] + length
    for k in range(ensemble.nx):
        kept[k] = states[k]
    memory[Kept.TIME], memory[Kept.FRICTION] = time[0], passive[places.speeds[0]]
    return code.finish()


def _arrived(
    code: Code, past: Numbers, head: ir.Value, size: int, steps: ir.Value, step: ir.Value, delay: Value
) -> Value:
    """The mean over a physics step of a command that acts `delay` steps late."""
    count, now = (Value(code, code.splat(code.at.sitofp(x, REAL))) for x in (steps, step))
    begin = now - delay
    whole = begin // 1.0
    share = begin - whole
    one, other = (_command(code, past, head, size, (x / count) // 1.0) for x in (whole, whole + 1.0))
    return one + share * (other - one)


def _command(code: Code, past: Numbers, head: ir.Value, size: int, period: Value) -> Value:
    """The command of each rig's own period, counted from the present one."""
    at, out = code.at, ir.Constant(code.real, ir.Undefined)
    for lane in range(WIDTH):
        place = ir.Constant(ir.IntType(32), lane)
        ago = at.fptosi(at.extract_element(period.primal, place), INT)
        index = at.srem(code.sum(code.sum(head, ago), size), integer(size))
        number = at.load(code.offset(past.place, code.sum(code.product(index, WIDTH), lane), REAL), align=8, typ=REAL)
        out = at.insert_element(out, number, place)
    return Value(code, out)


# ----------------------------------------------------------------------------------------------- the environment


def _write_observe(module: ir.Module, ensemble: Ensemble, places: Places) -> ir.Function:
    """Encoders, velocities, rewards and endings."""
    code = Code(module, "observe", [*[POINTER] * 7, INT, INT], internal=True, width=WIDTH, exact=True)
    own, memory, asked_at, noise = (code.numbers(argument) for argument in code.function.args[:4])
    observed, terms, flags, rows, exact = code.function.args[4:]
    kept = memory.since(int(Kept.SIZE))
    joints = [kept[k] for k in places.positions]
    speeds = [kept[int(ensemble.codes[Head.JOINTS]) + k] for k in places.speeds]
    state = [*joints[:2], joints[1] + joints[2], *speeds[:2], speeds[1] + speeds[2]]
    size = abs(state[0])
    for number in state[1:]:
        size = size + abs(number)
    fine = size < DIVERGED

    counts = [own[Own.CART], own[Own.POLE], own[Own.POLE]]
    per_row = [Numbers(code, code.offset(noise.place, code.product(rows, k), REAL), None)[0] for k in range(3)]
    quantise: Any = kernels.quantise
    readings = [quantise(q + n, count) for q, n, count in zip(joints, per_row, counts, strict=True)]
    readings[2] = readings[1] + readings[2]
    velocity: Any = kernels.velocity
    before = [memory[Kept.MEASURED + k] for k in range(6)]
    rates = [velocity(readings[k], before[k], before[3 + k], own[Own.KEEP], own[Own.GAIN]) for k in range(3)]
    shown = code.equal(exact, 1)
    seen = []
    for k, number in enumerate([*readings, *rates]):
        memory[Kept.MEASURED + k] = where(fine, number, before[k])
        last = memory[Kept.OBSERVED + k]
        seen.append(where(fine, where(shown, state[k], number), last))
        memory[Kept.OBSERVED + k] = seen[k]
    for lane in range(WIDTH):
        place = ir.Constant(ir.IntType(32), lane)
        for k in range(6):
            number = code.at.extract_element(seen[k].primal, place)
            code.at.store(number, code.offset(observed, 6 * lane + k, REAL), align=8)

    nothing = code.value(0.0)
    asked, rail, supply = asked_at[0], own[Own.RAIL], own[Own.SUPPLY]
    volts = _clipped(asked, supply)
    worked_out: Any = kernels.costs
    costs = worked_out(*state[:3], volts, rail, supply)
    reward = 1.0 - costs[0] - costs[1] - costs[2] - costs[3]
    given = {
        Term.REWARD: where(fine, reward, nothing),
        Term.SURVIVE: where(fine, code.value(1.0), nothing),
        **{Term.COSTS + k: where(fine, cost, nothing) for k, cost in enumerate(costs)},
        Term.VOLTAGE: volts,
        Term.FRICTION: where(fine, memory[Kept.FRICTION], nothing),
        Term.TIME: memory[Kept.TIME],
    }
    for term, number in given.items():
        place = code.offset(terms, code.product(rows, int(term)), REAL)
        code.at.store(number.primal, place, align=8)
    at = code.at
    leans = code.any_of(abs(state[1]) > kernels.FALL, abs(state[2]) > kernels.FALL)
    fell = code.all_of(memory[Kept.CAN_FALL] > 0, leans)
    stopped = code.any_of(abs(state[0]) >= rail, fell)
    diverged = at.not_(fine)
    said = {
        Flag.TERMINATED: code.any_of(stopped, diverged),
        Flag.CLIPPED: at.fcmp_ordered("!=", volts.primal, asked.primal),
        Flag.DIVERGED: diverged,
    }
    for flag, yes in said.items():
        place = code.offset(flags, code.product(rows, int(flag)), _BYTE)
        at.store(at.zext(yes, ir.VectorType(_BYTE, WIDTH)), place, align=1)
    return code.finish()
