"""The next experiment: the command whose recording would settle what is still open.

A handful of commands is tried in simulation. Each is made as large as the range that the rig has visited allows. What
the likeliest structure would then record is given to its rivals, their parameters and initial states are refitted to
it, and the command that leaves the closest rival furthest off, in units of noise, is proposed (Box and Hill 1967,
with the refitted residual in the place of their criterion). With no rival, the command that determines the
structure's own parameters best is.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf
from dipc_gym.recording import Recording
from dipc_gym.recording.units import of_command
from dipc_gym.sim2real.estimation import states
from dipc_gym.sim2real.estimation.fit import fit
from dipc_gym.sim2real.estimation.problem import Problem
from dipc_gym.sim2real.estimation.segments import position_noise
from dipc_gym.sim2real.model.parameters import model_parameters
from dipc_gym.sim2real.model.structure import Structure, names
from dipc_gym.sim2real.result import Design
from dipc_gym.sim2real.simulation.batch import simulate
from dipc_gym.sim2real.simulation.motion import Motion
from dipc_gym.sim2real.simulation.windows import Windows, cut

Array = NDArray[np.float64]


@dataclass(frozen=True)
class DesignSettings:
    """Decision constants of which experiment is proposed next.

    Attributes:
        duration: of the command, s: two slow ramps and more
        warming: the same where a temperature is in question, s: windings take about as long to warm
        sizes: shares of the largest command that are tried: each is 0.7 of the one before, down to a twentieth
        beyond: times the range visited that a command may use: what lies further on is not known, and may be a stop
        told: times its noise that a joint has to leave its range by, to have left it
        enough: windows that a command is judged on: more say little more, and each command costs a fit for each rival
        telling: times the noise that a rival must be off by to be told from the likeliest in a minute or so
        loosest: standard deviation of a mapped parameter of which nothing is known: loose, and yet a number
        open_loop: share of the usual command that may be added where a controller has to keep the rig up: more might
            throw it over
        ramps: s, of one ramp up and down and back: slow, so that friction and gravity show and inertia does not
        triangles: s, of one triangle: many reversals, where friction shows
        steps: s, from one step to the next of the same sign: what swings or lags settles in the rest after it
        pause: of the wave, below which a step rests: a third of the time
        sweep: Hz, from and to: from slow swings to where inertia takes nearly all
        tones: Hz, from and to: as the sweep, all at once
        count: of the tones, about half an octave from one to the next
        small: share of the largest command, for tones that stay within play, or before friction slips
        fade: s, in which a command begins and ends: a rig at rest is not knocked
        sent: times what was sent, that is tried where no range limits commands
        exact: times the noise, that a simulated recording is taken to have: it has none, but readings are weighed by it
        refits: steps of a rival's fit to what a command would record: it begins where recordings left it
    """

    duration: float = 20.0
    warming: float = 60.0
    sizes: tuple[float, ...] = tuple((0.5 ** np.arange(0.0, 5.0, 0.5)).tolist())
    beyond: float = 1.05
    told: float = 10.0
    enough: int = 24
    telling: float = 0.3
    loosest: float = 10.0
    open_loop: float = 0.2
    ramps: float = 8.0
    triangles: float = 1.3
    steps: float = 1.6
    pause: float = 0.5
    sweep: tuple[float, float] = (0.3, 8.0)
    tones: tuple[float, float] = (0.4, 9.0)
    count: int = 9
    small: float = 0.3
    fade: float = 0.5
    sent: float = 2.0
    exact: float = 1e-2
    refits: int = 3


DESIGN = DesignSettings()


@dataclass(frozen=True)
class _Candidate:
    """A command of one actuator."""

    words: str
    actuator: int
    values: Array

    @property
    def reach(self) -> str:
        """From its least to its most, in words."""
        low, high = self.values.min(), self.values.max()
        return f"up to {high:.3g}" if np.isclose(-low, high, rtol=0.05) else f"{low:.3g} to {high:.3g}"


def _ramps(t: Array, rng: np.random.Generator) -> Array:
    return np.asarray(2 / np.pi * np.arcsin(np.sin(2 * np.pi * t / DESIGN.ramps)))


def _triangles(t: Array, rng: np.random.Generator) -> Array:
    return np.asarray(2 / np.pi * np.arcsin(np.sin(2 * np.pi * t / DESIGN.triangles)))


def _steps(t: Array, rng: np.random.Generator) -> Array:
    wave = np.sin(2 * np.pi * t / DESIGN.steps)
    return np.sign(wave) * (np.abs(wave) > DESIGN.pause)


def _sweep(t: Array, rng: np.random.Generator) -> Array:
    (low, high), span = DESIGN.sweep, t[-1] + 1e-9
    return np.sin(2 * np.pi * low * span / np.log(high / low) * ((high / low) ** (t / span) - 1))


def _tones(t: Array, rng: np.random.Generator) -> Array:
    frequency = np.geomspace(*DESIGN.tones, DESIGN.count)
    wave = np.sin(2 * np.pi * np.outer(t, frequency) + rng.uniform(0, 2 * np.pi, DESIGN.count)) @ frequency**-0.5
    return np.asarray(wave / np.abs(wave).max())


TONES = f"{DESIGN.count} {{}}tones from {DESIGN.tones[0]:g} to {DESIGN.tones[1]:g} Hz"
"""How tones are asked for in words, with room for their size."""

# In words: the shape, and its share of the largest command.
SHAPES: dict[str, tuple[Callable[[Array, np.random.Generator], Array], float]] = {
    f"slow ramps up and down, one every {DESIGN.ramps / 2:g} s": (_ramps, 1.0),
    f"triangles of {DESIGN.triangles:g} s, for many reversals": (_triangles, 1.0),
    "steps with rests between them": (_steps, 1.0),
    "a sweep from {:g} to {:g} Hz".format(*DESIGN.sweep): (_sweep, 1.0),
    TONES.format(""): (_tones, 1.0),
    TONES.format("small "): (_tones, DESIGN.small),
}


def propose(
    structures: Sequence[tuple[Structure, Array]],
    problem: Problem,
    recordings: Sequence[Recording],
    motions: Sequence[Motion],
    *,
    seed: int = 0,
) -> Design:
    """The command that tells structures apart, or determines the parameters of a single one.

    Args:
        structures: with their fitted parameters, the likeliest first, then its rivals.
        problem: windows they were fitted to; gives noise, window length and step.
        recordings: that were made so far; give range and sample period.
        motions: of the base joints in them.
        seed: of the tones' phases.

    Raises:
        ValueError: no structure, or a rig without an actuator to command.

    Example:
        >>> design = propose([(friction, z), (dead_zone, y)], problem, recordings, motions)    # doctest: +SKIP
        >>> recording.write(design.commands, "next.csv")                                       # doctest: +SKIP
    """
    if not structures:
        raise ValueError("a design needs at least one structure")
    if not recordings[0].actuator_names:
        raise ValueError("the rig has no actuator that could be commanded")
    likeliest, rivals = structures[0], structures[1:]
    period = min(recording.period for recording in recordings)
    warms = any(term.effect.id == "motor.thermal" for structure, _ in structures for term in structure.terms)
    count = round((DESIGN.warming if warms else DESIGN.duration) / period)
    time = np.round(np.arange(count) * period, 9)
    usual, low, high = _visited(motions, position_noise(likeliest[0].physics(likeliest[1]), problem.windows.noise))
    rig = _Rig(likeliest, problem, recordings[0], time, usual, low, high)
    if not rig.stays(np.zeros((1, len(time), len(recordings[0].actuator_names))))[0]:
        return _beside_a_controller(structures, rig, recordings, "leaves its range when left alone", seed)
    tried = list(_sized(rig, recordings, time, seed))
    if not tried:
        why = "would leave its range under the smallest of the commands that were tried"
        return _beside_a_controller(structures, rig, recordings, why, seed)
    if rivals:
        left = [_left_of(rivals, likeliest, rig, one) for one in tried]
        worth, best = max(left), tried[int(np.argmax(left))]
    else:
        worth, best = math.nan, min(tried, key=partial(_doubt, *likeliest, rig))
    moved = np.ptp(rig.positions(rig.commands(best)[None])[0], axis=0)
    units = [_length(likeliest[0], name) for name in likeliest[0].base]
    reach = [f"{name} over {way:.3g} {u}" for name, way, u in zip(likeliest[0].base, moved, units, strict=True)]
    begin = [f"{name} at {at:.3g} {u}" for name, at, u in zip(likeliest[0].base, usual, units, strict=True)]
    return Design(
        f"{_question(structures)} send {recordings[0].actuator_names[best.actuator]} {best.words}, of "
        f"{best.reach}{_unit(likeliest[0], recordings[0], best.actuator)}, for {time[-1] + period:.0f} s, from rest "
        f"with {', '.join(begin)}. That moves {', '.join(reach)}, hardly further than the recordings did. "
        + _outlook(worth),
        _recording(recordings[0], time, rig.commands(best)),
        worth,
    )


def _outlook(worth: float) -> str:
    if math.isnan(worth):
        return "Of the commands tried it determines the parameters best."
    if worth < DESIGN.telling:
        return (
            f"Do not expect much: within this range no command leaves the closest rival off by more than {worth:.2g} "
            "times the noise. Go beyond the range, change the load, or add a sensor."
        )
    return f"The closest rival, refitted to what this would record, is then off by {worth:.3g} times the noise."


def _visited(motions: Sequence[Motion], noise: Array) -> tuple[Array, Array, Array]:
    """Usual, lowest and highest position of each base joint, (nb,) each.

    A joint that never moved, as a locked one, has visited what its noise (nb,) says.
    """
    position = np.concatenate([motion.position for motion in motions])
    low, high = position.min(axis=0), position.max(axis=0)
    spare = np.maximum((DESIGN.beyond - 1) / 2 * (high - low), DESIGN.told * noise)
    return np.median(position, axis=0), low - spare, high + spare


class _Rig:
    """The likeliest structure as a stand-in for the rig."""

    def __init__(
        self,
        likeliest: tuple[Structure, Array],
        problem: Problem,
        like: Recording,
        time: Array,
        usual: Array,
        low: Array,
        high: Array,
    ) -> None:
        self.structure, self.problem, self.like, self.time, self.usual = likeliest[0], problem, like, time, usual
        self.physics = self.structure.physics(likeliest[1])
        self.low, self.high = low, high

    def instead(self, other: tuple[Structure, Array]) -> _Rig:
        """Another structure in its place."""
        return _Rig(other, self.problem, self.like, self.time, self.usual, self.low, self.high)

    def commands(self, candidate: _Candidate) -> Array:
        """All actuators' commands (m, nu) of a candidate."""
        out = np.zeros((len(self.time), len(self.like.actuator_names)))
        out[:, candidate.actuator] = candidate.values
        return out

    def readings(self, commands: Array) -> Array:
        """What the sensors would read (k, m, ns) under commands (k, m, nu), from rest at the usual positions."""
        nb, m = len(self.usual), len(self.time)
        still = Motion(self.time, np.tile(self.usual, (m, 1)), np.zeros((m, nb)), np.zeros((m, nb)), np.zeros(nb))
        runs = tuple(_recording(self.like, self.time, c) for c in commands)
        k = len(runs)
        windows = Windows(
            runs,
            np.arange(k),
            np.zeros(k),
            np.tile(self.time, (k, 1)),
            np.zeros((k, m, len(self.like.sensor_names))),
            np.ones((k, m), dtype=bool),
            self.problem.windows.noise,
            (still,) * k,
        )
        initial = np.tile(np.concatenate([self.usual, np.zeros(nb)]), (1, k, 1))
        finest = min(self.structure.finest, self.structure.own_finest, self.problem.stepping.timestep)
        stepping = replace(self.problem.stepping, timestep=finest)
        return simulate(
            [self.physics], windows, initial, stepping, base=self.structure.base, threads=self.problem.threads
        )[0]

    def positions(self, commands: Array) -> Array:
        """Joint positions (k, m, nb) under commands (k, m, nu), as the sensors tell them."""
        readings = states.straightened(self.physics, self.readings(commands))
        return states.seen(self.physics).positions(self.time, readings, self.problem.windows.noise)

    def stays(self, commands: Array) -> NDArray[np.bool_]:
        """Whether the joints keep to the range that was visited, (k,)."""
        position = self.positions(commands)
        inside = (position >= self.low) & (position <= self.high)
        return np.asarray(inside.all(axis=(1, 2)))

    def would_record(self, candidate: _Candidate) -> Problem:
        """Windows of the recording that a candidate would give, without noise."""
        commands = self.commands(candidate)
        run = replace(
            self.like,
            name="design",
            time=self.time,
            commands=commands,
            sensors=self.readings(commands[None])[0],
            path=None,
            sha256="",
        )
        noise = self.problem.windows.noise
        motion = states.estimate(run, self.physics, DESIGN.exact * noise)
        length = float(self.problem.windows.times.max()) + run.period
        late = mjcf.latest_sensor(self.physics.model)
        windows = replace(cut([run], noise, length, (0.0, 1.0)), motions=(motion,), late=late)
        whole = replace(self.problem, windows=windows, initial=windows.begun())
        return whole.pick(np.unique(np.linspace(1, len(windows) - 1, DESIGN.enough).round().astype(np.intp)))


def _sized(rig: _Rig, recordings: Sequence[Recording], time: Array, seed: int) -> list[_Candidate]:
    """Every shape at every actuator, as large as the range allows; those that fit at no size are left out."""
    fade = np.minimum(np.minimum(time, time[-1] - time) / DESIGN.fade, 1.0)  # begins and ends gently
    tried = []
    for k in range(len(recordings[0].actuator_names)):
        least, middle, most = _range(rig, recordings, k)
        for words, (shape, share) in SHAPES.items():
            wave = (middle - least + share * most * shape(time, np.random.default_rng(seed))) * fade
            tried += [_Candidate(words, k, least + size * wave) for size in DESIGN.sizes]
    stays = rig.stays(np.stack([rig.commands(candidate) for candidate in tried])).reshape(-1, len(DESIGN.sizes))
    return [tried[i * len(DESIGN.sizes) + int(np.argmax(row))] for i, row in enumerate(stays) if row.any()]


def _range(rig: _Rig, recordings: Sequence[Recording], actuator: int) -> tuple[float, float, float]:
    """The smallest command, the one to swing about, and how far: as the control range has it, about no command where
    that lies within, or twice what was sent where there is none.
    """
    model = rig.physics.model
    if not model.actuator_ctrllimited[actuator]:
        sent = max(float(np.abs(r.commands[:, actuator]).max()) for r in recordings)
        return 0.0, 0.0, DESIGN.sent * sent or 1.0
    low, high = (float(x) for x in model.actuator_ctrlrange[actuator])
    if low < 0 < high:
        return 0.0, 0.0, min(-low, high)
    return min(max(0.0, low), high), (low + high) / 2, (high - low) / 2


def _left_of(
    rivals: Sequence[tuple[Structure, Array]], likeliest: tuple[Structure, Array], rig: _Rig, candidate: _Candidate
) -> float:
    """Error that the closest rival is left with, in units of noise."""
    would = rig.would_record(candidate)
    return min(_apart(likeliest, rival, rig, candidate, would) for rival in rivals)


def _doubt(structure: Structure, z: Array, rig: _Rig, candidate: _Candidate) -> float:
    """Standard deviation of the parameter that a recording would tell least, in what is sizeable for it."""
    would = rig.would_record(candidate)
    if not structure.slots:
        structure = replace(structure, model_parameters=tuple(model_parameters(structure.document, structure.model)))
        z = structure.first
    A = fit(would, structure, z, most=0).quadratics.A.sum(axis=0)
    precision = structure.prior.precision
    at_least = np.diag(np.maximum(1 / DESIGN.loosest**2 - np.diag(precision), 0.0))
    known = replace(structure.prior, precision=precision + at_least)
    return float(np.sqrt(np.diag(np.linalg.inv(known.in_covariance(A, np.ones(1)))).max()))


def _apart(
    likeliest: tuple[Structure, Array],
    rival: tuple[Structure, Array],
    rig: _Rig,
    candidate: _Candidate,
    would: Problem,
) -> float:
    """Error that a rival is left with; one that contains the likeliest is itself the rig, else it is never off."""
    if not _contains(rival[0], likeliest[0]):
        return fit(would, *rival, most=DESIGN.refits).error
    turned = rig.instead(rival).would_record(candidate)
    return fit(turned, *likeliest, most=DESIGN.refits).error


def _contains(wide: Structure, narrow: Structure) -> bool:
    """Whether a structure is the other one with more to it."""
    more = {(inner, term.at) for term in wide.terms for inner in (term.effect.id, *term.effect.contains)}
    return all((term.effect.id, term.at) in more for term in narrow.terms)


def _beside_a_controller(
    structures: Sequence[tuple[Structure, Array]], rig: _Rig, recordings: Sequence[Recording], why: str, seed: int
) -> Design:
    """For a rig that does not keep to its range: tones to be added to what its controller sends, of a size that goes by
    what that usually is, or by what the rig takes where it never sent anything.
    """
    like, time = recordings[0], rig.time
    usual = np.sqrt(np.mean(np.concatenate([r.commands for r in recordings]) ** 2, axis=0)).tolist()
    usual = [size or _range(rig, recordings, k)[2] for k, size in enumerate(usual)]
    rng = np.random.default_rng(seed)
    commands = np.stack([DESIGN.open_loop * size * _tones(time, rng) for size in usual], axis=1)
    sizes = " and ".join(
        f"{DESIGN.open_loop * size:.3g}{_unit(structures[0][0], like, k)} to {name}"
        for k, (size, name) in enumerate(zip(usual, like.actuator_names, strict=True))
    )
    return Design(
        f"{_question(structures)} let a controller hold the rig, which {why}, and add {TONES.format('')}, of up to "
        f"{sizes}, for {time[-1]:.0f} s; record the sum as the command.",
        _recording(like, time, commands),
    )


def _question(structures: Sequence[tuple[Structure, Array]]) -> str:
    if len(structures) == 1:
        return "To determine the model's parameters better,"
    mine = set(names(structures[0][0].terms))
    others = sorted({key for structure, _ in structures[1:] for key in names(structure.terms) if key not in mine})
    theirs = [set(names(structure.terms)) for structure, _ in structures[1:]]
    own = sorted(key for key in mine if any(key not in keys for keys in theirs))
    return f"To tell {_listed(own)} from {_listed(others)},"


def _listed(keys: Sequence[str]) -> str:
    return " and ".join(key.replace("@", " at ") for key in keys) or "the model as it is"


def _length(structure: Structure, joint: str) -> str:
    return mjcf.units(structure.model, joint).length


def _unit(structure: Structure, like: Recording, actuator: int) -> str:
    unit = of_command(structure.model, like.actuator_names[actuator])
    return f" {unit}" if unit else ""


def _recording(like: Recording, time: Array, commands: Array) -> Recording:
    return Recording("design", time, commands, np.zeros((len(time), 0)), like.actuator_names, ())
