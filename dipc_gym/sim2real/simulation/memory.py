"""What a window begins with, in either simulator: what its sensors show, and what no sensor shows.

Some of the latter remembers longer than any warm-up lasts. A spring that yields stays as it was bent until it is bent
as far the other way; a load that swings, swings on for seconds, and a spring that creeps takes as long. All follow
from how the joints moved before: one pass over the whole recording gives what they are at each window's start, as it
does for the heat of a winding. A recording is taken to begin with springs unbent and loads at rest.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf
from dipc_gym.engine.remember import recall
from dipc_gym.engine.swing import Spring, swing
from dipc_gym.physics import Physics
from dipc_gym.physics.formulas import resting, told_rests
from dipc_gym.recording import Recording
from dipc_gym.recording.held import held_at
from dipc_gym.sim2real.simulation.commands import changed_by
from dipc_gym.sim2real.simulation.heat import heating_motors, winding_temperatures
from dipc_gym.sim2real.simulation.motion import Motion
from dipc_gym.sim2real.simulation.windows import Windows
from dipc_gym.sim2real.unseen.parts import Load, loads
from dipc_gym.sim2real.unseen.play import dragged, turned

Array = NDArray[np.float64]

INSTANT = 1e-9  # s, before and after a moment
LEAST = 1e-12  # m or rad, of a swing


def bends(variants: Sequence[Physics], tendon: int, motion: Motion, time: Array) -> Array:
    """How far a spring that yields is bent, at times within a recording.

    Args:
        variants: one model with different parameters.
        tendon: a fixed one.
        motion: of the base joints.
        time: s, (n,).

    Returns:
        m or rad, (variants, n).
    """
    model = variants[0].model
    joints, coefficients = zip(*mjcf.along(model, tendon), strict=True)
    # What hides behind a gap is where its leader is, but for the gap.
    length = motion.position @ (np.array(coefficients) @ mjcf.spread_out(model)[list(joints)])
    wanted = np.interp(time, motion.time, length)
    bears = np.array([v.model.tendon_springyield[tendon] for v in variants])
    unbent = np.array([v.model.tendon_lengthspring[tendon, 0] for v in variants])
    (widths, rests), each = np.unique([bears, unbent], axis=1, return_inverse=True)
    turns, where = turned(length, widths, rests)
    # A time before the first sample sees the motion where it begins.
    last = np.searchsorted(motion.time[turns], time, side="right") - 1
    bent = wanted[:, None] - dragged(where[np.maximum(last, 0)], wanted, widths)
    return np.ascontiguousarray(bent[:, each].T)


def swings(variants: Sequence[Physics], load: Load, joint: int, motion: Motion, time: Array) -> Array:
    """Where a load is against the joint that it hangs on, and how fast, at times within a recording.

    Args:
        variants: one model with different parameters.
        load: the load.
        joint: that it hangs on, among those of the motion.
        motion: of joints.
        time: s, (n,), or of each variant, (variants, n).

    Returns:
        m or rad, then m/s or rad/s, (2, variants, n).
    """
    time = np.broadcast_to(time, (len(variants), np.shape(time)[-1]))
    out = np.empty((2, *time.shape))
    known: dict[tuple[tuple[Spring, ...], float, float], Array] = {}
    for v, variant in enumerate(variants):
        held = load.held(variant.model)
        if held not in known:
            moved = motion.position[:, joint], motion.velocity[:, joint], motion.time
            springs, drag, ground = held
            known[held] = swing(springs, drag, *moved, ground=ground)
        out[:, v] = [np.interp(time[v], motion.time, one) for one in known[held]]
    return out


def swung(physics: Physics, joint: int, leader: str, motion: Motion) -> Array:
    """How wide the loads that hang on a joint have swung of late, at each sample of a motion, m or rad, (n,).

    A wide swing counts for as long as it rings: it fades as a swing does.

    Args:
        physics: the model.
        joint: that they hang on, among the base joints.
        leader: its name.
        motion: of the base joints.
    """
    model, out = physics.model, np.zeros(len(motion.time))
    followers = mjcf.followers(model)
    for name, load in loads(model).items():
        if followers[name] != leader:
            continue
        _, drag, ground = load.held(model)
        apart = np.abs(swings([physics], load, joint, motion, motion.time)[0, 0])
        fades = 0.5 * (drag + ground) * (motion.time - motion.time[0])
        widest = np.maximum.accumulate(np.log(np.maximum(apart, LEAST)) + fades)
        out = np.maximum(out, np.exp(widest - fades))
    return out


def memories(
    variants: Sequence[Physics],
    which: int,
    delays: Array,
    recording: Recording,
    motion: Motion,
    time: Array,
) -> Array:
    """What a law of `<custom>` remembers, at times within a recording.

    Args:
        variants: one model with different parameters.
        which: of the laws that remember.
        delays: of each variant's controls, s, (variants, nu), on the clock of the motion.
        recording: its commands may be followed.
        motion: of the base joints.
        time: s, (n,).

    Returns:
        (variants, n).
    """
    model, laws = variants[0].model, [variant.remembering[which] for variant in variants]
    every = motion.spread(mjcf.spread_out(model))  # what follows a joint moves with it: no recording has a rotor
    own = every.position[:, model.joint(laws[0].at).id]
    out, alike = np.empty((len(variants), len(time))), dict[tuple[bytes, ...], list[int]]()
    for k, (variant, late) in enumerate(zip(variants, delays, strict=True)):
        alike.setdefault((laws[k].data.tobytes(), *_commanded(variant, which, late)), []).append(k)
    for rows in alike.values():
        k = rows[0]
        sees = _sees(variants[k], which, delays[k], recording, every)
        (along,) = recall(laws[k].effect, laws[k].data[None], motion.time, own, *sees)
        out[rows] = np.interp(time, motion.time, along)
    return out


def _commanded(variant: Physics, which: int, delays: Array) -> tuple[bytes, ...]:
    """What tells the commands that a law of a variant follows from those of another variant."""
    late = [delays[k].tobytes() for kind, k in variant.remembering[which].inputs if kind == "command"]
    if not late:
        return ()
    return (*late, *(end.tobytes() for end in variant.taken), changed_by(variant))


def _sees(variant: Physics, which: int, delays: Array, recording: Recording, motion: Motion) -> Array:
    """Velocity of the joint of a law that remembers, and what else it depends on, at each sample of a motion, (2, n).

    Args:
        variant: a model.
        which: of its laws that remember.
        delays: of its controls, s, (nu,).
        recording: its commands may be followed.
        motion: of all joints.
    """
    law, model, follows = variant.remembering[which], variant.model, np.zeros(len(motion.time))
    own = motion.velocity[:, model.joint(law.at).id]
    if law.entry.memory is resting:  # the noise of a reading would wake a joint that rests
        own = told_rests(law.data, own)
    for kind, k in law.inputs:
        if kind == "command":
            # It holds between stamps, and what follows it goes straight from sample to sample: where it changes, it is
            # taken half way, else it would come half a sample early.
            sides = [held_at(recording, motion.time - delays[k] + side) for side in (-INSTANT, INSTANT)]
            sent = [variant.command(one, motion.time)[:, k] for one in sides]
            follows = np.mean([np.clip(one, *(end[k] for end in variant.taken)) for one in sent], axis=0)
        else:
            follows = (motion.velocity if kind == "velocity" else motion.position)[:, k]
    return np.stack([own, follows])


# ------------------------------------------------------------------------------------------- how windows begin


class Following(NamedTuple):
    """Joints that follow others.

    Attributes:
        at: where they are.
        leaders: the joint that each follows.
        ratios: how many times as far it goes.
    """

    at: list[int]
    leaders: list[int]
    ratios: list[float]


class Joints(NamedTuple):
    """Where joints stand among positions, and likewise among velocities: all are hinges and slides.

    Attributes:
        base: joints that initial states describe.
        coupled: held in proportion to a base joint by an equality constraint, which gives way.
        hidden: behind a gap or a spring; no loads, which are where the motion before has brought them.
    """

    base: list[int]
    coupled: Following
    hidden: Following

    @classmethod
    def of(cls, model: mujoco.MjModel, base: Sequence[str]) -> Joints:
        """Those of a model, by the names of its base joints."""
        followed, ties = mjcf.followers(model), mjcf.coupled(model)
        hidden = {name: (followed[name], 1.0) for name in sorted(followed.keys() - loads(model).keys())}

        def at(names: Iterable[str]) -> list[int]:
            return [int(model.joint(name).dofadr[0]) for name in names]

        def following(led: Mapping[str, tuple[str, float]]) -> Following:
            return Following(at(led), at(leader for leader, _ in led.values()), [ratio for _, ratio in led.values()])

        return cls(at(base), following(ties), following(hidden))

    def apart(self, state: Array) -> list[Array]:
        """How far what follows is from where its leader would have it, in positions or velocities (..., nv)."""
        return [state[..., each.at] - state[..., each.leaders] * each.ratios for each in (self.coupled, self.hidden)]

    def follow(self, state: Array, apart: Sequence[Array | float]) -> None:
        """Put what follows that far from where its leader would have it, of positions or velocities (..., nv)."""
        for each, far in zip((self.coupled, self.hidden), apart, strict=True):  # what is coupled may lead others
            state[..., each.at] = state[..., each.leaders] * each.ratios + far


@dataclass(frozen=True)
class Places:
    """Where a simulator keeps what its windows begin with: views of its own arrays, in its own order.

    Attributes:
        position: of all joints, m or rad, (variants, n, nv).
        velocity: m/s or rad/s, (variants, n, nv).
        activation: of actuators, (variants, n, na); for a winding that heats, K above its surroundings.
        unbent: length at which each of the springs that yield is unbent, m or rad; (variants, n, k) with k times the
            same number.
        remembered: what each law of `<custom>` remembers, (variants, n) each.
    """

    position: Array
    velocity: Array
    activation: Array
    unbent: Sequence[Array]
    remembered: Sequence[Array]

    def put(self, joints: Joints, initial: Array, keep: NDArray[np.bool_] | bool = False) -> None:
        """Put base joints at positions and velocities (variants, n, 2 nb), and what follows where its leader is.

        Args:
            joints: which is which.
            initial: of the base joints.
            keep: whether what follows keeps how far it was from there, broadcast over (variants, n, k).
        """
        nb = len(joints.base)
        for state, at in ((self.position, initial[..., :nb]), (self.velocity, initial[..., nb:])):
            # A simulation that diverged on its way here is infinite.
            with np.errstate(invalid="ignore"):
                apart = [np.where(keep, far, 0.0) for far in joints.apart(state)]
            state[..., joints.base] = at
            joints.follow(state, apart)

    @property
    def memories(self) -> list[Array]:
        """All that goes with the motion before."""
        return [*self.unbent, *self.remembered]

    def stay_bent(self, model: mujoco.MjModel, moved: Array) -> None:
        """Let springs that yield stay as bent as they are, where joints were moved by `moved`, (variants, n, nv)."""
        for unbent, tendon in zip(self.unbent, mjcf.yielding(model), strict=True):
            for joint, coefficient in mjcf.along(model, tendon):
                unbent += (coefficient * moved[..., joint])[..., None]


def remembering(physics: Physics) -> bool:
    """Whether anything in a model begins with what the motion before has left, as `begin` has it."""
    model = physics.model
    return bool(heating_motors(model) or mjcf.yielding(model) or loads(model) or physics.remembering)


def begin(
    places: Places,
    initial: Array,
    variants: Sequence[Physics],
    windows: Windows,
    base: Sequence[str],
    delays: Array,
    time: Array,
) -> None:
    """Let windows begin as their initial states say, and with what the motion before has left.

    Args:
        places: to fill.
        initial: positions and velocities of the base joints, (variants, n, 2 nb).
        variants: one model with different parameters.
        windows: where recordings and their motions are.
        base: names of the nb base joints.
        delays: of each variant's controls, s, (variants, nu), as seen from the sensor that reads latest.
        time: at which each window begins in its recording, s, (n,).

    Raises:
        ValueError: what it begins with depends on the motion before, and the windows have no motions.
    """
    model = variants[0].model
    delays = delays - windows.late  # on the clock of the motions, of which the model's own lateness is taken out
    places.put(Joints.of(model, base), initial)
    for motor in heating_motors(model):
        temperature = places.activation[..., int(model.actuator_actadr[motor])]
        for mine, recording, motion in _passes(windows, f"how hot {model.actuator(motor).name} is"):
            temperature[:, mine] = winding_temperatures(variants, delays, motor, recording, motion, time[mine])
    for unbent, tendon in zip(places.unbent, mjcf.yielding(model), strict=True):
        joints, coefficients = zip(*mjcf.along(model, tendon), strict=True)
        length = places.position[..., list(joints)] @ np.array(coefficients)
        for mine, _, motion in _passes(windows, f"how far {model.tendon(tendon).name} is bent"):
            unbent[:, mine] = (length[:, mine] - bends(variants, tendon, motion, time[mine]))[..., None]
    leaders = mjcf.followers(model)
    for name, load in loads(model).items():
        for mine, _, motion in _passes(windows, f"how {name} swings"):
            # Against the motion that has carried it: how far an initial state is off, moves the joint and not the load.
            leads = motion.spread(mjcf.spread_out(model)[[model.joint(leaders[name]).id]])
            late = np.array([behind(variant, windows, leaders[name]) for variant in variants])
            when = time[mine] + late[:, None]
            apart, faster = swings(variants, load, 0, leads, when)
            carried = leads.at(when)
            places.position[:, mine, load.at] = carried[..., 0] + apart
            places.velocity[:, mine, load.at] = carried[..., 1] + faster
    for k, into in enumerate(places.remembered):
        law = variants[0].remembering[k]
        for mine, recording, motion in _passes(windows, f"what {law.effect} of {law.at} remembers"):
            into[:, mine] = memories(variants, k, delays, recording, motion, time[mine])


def forget(
    places: Places, initial: Array, variants: Sequence[Physics], windows: Windows, base: Sequence[str], delays: Array
) -> None:
    """Let windows with which a recording begins, or goes on after a gap, remember nothing of what was simulated before
    them: no recording says that it happened.

    Args:
        places: where windows begin, after they were run in.
        initial: positions and velocities of the base joints, (variants, n, 2 nb).
        variants: one model with different parameters.
        windows: where recordings and their motions are.
        base: names of the nb base joints.
        delays: of each variant's controls, s, (variants, nu).
    """
    first = ~windows.after_the_first(0.0)
    if not first.any() or not places.memories:
        return
    some = windows.pick(first)
    anew = Places(
        places.position[:, first],
        places.velocity[:, first],
        places.activation[:, first],
        [unbent[:, first] for unbent in places.unbent],
        [remembered[:, first] for remembered in places.remembered],
    )
    begin(anew, initial[:, first], variants, some, base, delays, some.start - some.late)
    for ours, theirs in zip(places.memories, anew.memories, strict=True):
        ours[:, first] = theirs


def behind(variant: Physics, windows: Windows, joint: str) -> float:
    """By how much the motion of a joint is late in a variant, s: its sensor lags there by more than in the model that
    the motion was told by.
    """
    late, model = 0.0, variant.model
    for lag in variant.stage("lag"):
        sensor = model.sensor(lag.at)
        if sensor.type[0] == mujoco.mjtSensor.mjSENS_JOINTPOS and sensor.objid[0] == model.joint(joint).id:
            late += float(lag.data[0]) - windows.lags.get(lag.at, 0.0)
    return late


def _passes(windows: Windows, what: str) -> Iterator[tuple[NDArray[np.bool_], Recording, Motion]]:
    """Which windows are of each recording, the recording, and its motion."""
    if len(windows.motions) != len(windows.recordings):
        raise ValueError(f"{what} depends on its motion; give the windows their recordings' motions")
    for i, (recording, motion) in enumerate(zip(windows.recordings, windows.motions, strict=True)):
        yield windows.source == i, recording, motion
