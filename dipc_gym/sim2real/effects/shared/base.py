"""What an effect is: an edit of the MJCF with named parameters, and a sentence that says it in words."""

from __future__ import annotations

import copy
import math
import xml.etree.ElementTree as ET
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.settings import EFFECTS, SMOOTHING

DEAF = 1e-12  # N or N m for each unit of a command that nobody is to give

Array = NDArray[np.float64]
Values = Mapping[str, float]


@dataclass(frozen=True)
class Parameter:
    """A parameter of an effect.

    Attributes:
        name: as reports call it.
        unit: SI, as for a slide; where the joint is a hinge, N becomes N m, m rad, and kg kg m^2.
        low: smallest allowed value.
        high: largest allowed value.
        log: whether ratios rather than differences matter, as for stiffnesses and time constants.
        fine: relative change that is already a sizeable one, where `log`: a frequency that is off by a hundredth is out
            of step soon.
        fixed: whether it stays at its guess, as the range that a table covers.
        above: name of an earlier parameter of the effect that it is never smaller than.
        step: a sizeable change of a parameter that has no natural zero, as a time; 0 where its own size tells.
        sigma: standard deviation, in steps, of its prior about the first guess; values of a table have one, for a knot
            that no motion comes near would else be free.
        translated: whether its unit is another one at a hinge; False for a mass that stays one in kg, an arm in m.
    """

    name: str
    unit: str
    low: float = -math.inf
    high: float = math.inf
    log: bool = False
    fine: float = 1.0
    fixed: bool = False
    above: str = ""
    step: float = 0.0
    sigma: float = math.inf
    translated: bool = True


@dataclass(frozen=True)
class Misread:
    """What is left of a sensor's readings in the windows of a fit, and how an error of its own would show there.

    Attributes:
        time: s, (n, m).
        reading: what it read, (n, m).
        present: of that, the error that the structure says it has already, (n, m).
        left: what is left of all sensors' readings in units of noise, beyond what initial states could explain, (n, M).
        sensitivity: of these to the initial states, orthonormal in each window, (n, M, 2 nb).
        rows: of these that are the sensor's, (m,).
        scale: that an error of the sensor is multiplied by there, 0 where nothing was read, (n, m).
    """

    time: Array
    reading: Array
    present: Array
    left: Array
    sensitivity: Array
    rows: NDArray[np.intp]
    scale: Array

    def asked(self, errors: Array, windows: NDArray[np.bool_]) -> tuple[Array, Array, float]:
        """Normal equations of errors (n, m, k) of the reading that explain what is left of some windows, (n,).

        Returns:
            Normal matrix (k, k), right-hand side (k,), and the sum of squares to be explained. Each window weighs as in
            a fit, so that few that are far off do not decide.
        """
        Q, scale = self.sensitivity[windows], self.scale[windows][..., None]
        weight = 1.0 / (1.0 + np.mean(self.left[windows] ** 2, axis=1))
        own = scale * np.concatenate([errors[windows], self.present[windows][..., None]], axis=2)
        # Less what initial states could explain; what is left is free of that already.
        of_states = np.swapaxes(Q[:, self.rows], 1, 2) @ own
        normal = np.einsum("n,nmi,nmj->ij", weight, own, own, optimize=True)
        normal -= np.einsum("n,nsi,nsj->ij", weight, of_states, of_states, optimize=True)
        right = np.einsum("n,nmi,nm->i", weight, own, self.left[windows][:, self.rows], optimize=True)
        total = float(weight @ np.sum(self.left[windows] ** 2, axis=1))
        return normal[:-1, :-1], right[:-1] + normal[:-1, -1], total + 2 * float(right[-1]) + float(normal[-1, -1])


@dataclass(frozen=True)
class Together:
    """All base joints at once, (n, nb) each.

    Attributes:
        position: m or rad.
        velocity: m/s or rad/s.
        force: that the model does not explain, N or N m.
    """

    position: Array
    velocity: Array
    force: Array


@dataclass(frozen=True)
class Evidence:
    """What is known at one place before an effect is fitted there; first guesses come from it.

    Attributes:
        model: the nominal model, compiled.
        force: force at the joint that the model does not explain, N or N m, (n,).
        velocity: of the joint, m/s or rad/s, (n,).
        position: m or rad, (n,).
        load: what the joint transmits, N or N m, (n,).
        time: s, (n,).
        command: the actuator's command, (n,); empty where the joint has none.
        reading: the sensor's reading, (n,); empty where the place is no sensor.
        gear: of the actuator's transmission, 0 where there is none.
        inertia: what the joint moves, kg or kg m^2.
        period: of the recording, s.
        level: of dry friction that the structure has there already, N or N m; None without.
        at: name of the place.
        outliers: times at which outlier windows begin, the worst first, s.
        inputs: what a law may depend on, (n,) each: `position cart`, `velocity pole1`, `command motor`.
        misread: what is left of the sensor's readings; None where the place is no sensor.
        width: s, to which the force has to be smoothed, so that little of it is noise; see `effects.shared.smoothing`.
        resisting: force of the dry friction that the model has there already, N or N m, (n,); empty without.
        together: the same of all joints; None where one alone is looked at.
    """

    model: mujoco.MjModel
    force: Array
    velocity: Array
    position: Array
    load: Array
    time: Array
    command: Array
    reading: Array
    gear: float
    inertia: float
    period: float
    level: float | None = None
    at: str = ""
    outliers: tuple[float, ...] = ()
    inputs: Mapping[str, Array] = field(default_factory=dict)
    misread: Misread | None = None
    width: float = SMOOTHING.widest
    resisting: Array = field(default_factory=lambda: np.zeros(0))
    together: Together | None = None

    @property
    def force_scale(self) -> float:
        """Size of the unexplained force, at least a hundredth of what the joint transmits."""
        return max(rms(self.force), EFFECTS.faint * rms(self.load), 1e-12)

    @property
    def speed_scale(self) -> float:
        """Size of the joint's velocity."""
        return max(rms(self.velocity), 1e-9)

    def along(self, *shapes: Array) -> Array:
        """Least-squares weights with which these shapes (n,) make up the unexplained force, a constant beside them."""
        columns = np.stack([*shapes, np.ones_like(self.force)], axis=1)
        return np.asarray(np.linalg.lstsq(columns, self.force, rcond=None)[0][:-1])

    @property
    def direction(self) -> Array:
        """Sign of the velocity, smoothed at speeds where it is uncertain, (n,)."""
        return np.asarray(np.tanh(self.velocity / (EFFECTS.uncertain * self.speed_scale)))

    @property
    def runs(self) -> list[NDArray[np.intp]]:
        """Samples of each recording, one after another."""
        return runs_of(self.time)

    @property
    def foretold(self) -> Array:
        """Acceleration that the model gives the joint, m/s^2 or rad/s^2, (n,).

        That of the motion holds the noise of the encoders, and so does the unexplained force: what is asked of one by
        the other would be answered by noise. Less that force they share none.
        """
        moved = np.concatenate([np.gradient(self.velocity[run], self.time[run]) for run in self.runs])
        return moved - self.force / self.inertia

    @property
    def driven(self) -> Array:
        """Force that drives the joint beside all dry friction, N or N m, (n,): at rest it is what friction holds."""
        beside = self.inertia * self.foretold
        return np.asarray(beside - self.resisting) if len(self.resisting) else beside

    @property
    def dry_level(self) -> float:
        """Level of dry friction: the known one, or the part of the unexplained force that opposes motion."""
        if self.level is not None:
            return self.level
        level, _ = self.along(-self.direction, -self.velocity)
        low, high = EFFECTS.dry
        return float(np.clip(level, low * self.force_scale, high * self.force_scale))


def runs_of(time: Array) -> list[NDArray[np.intp]]:
    """Samples of each recording, of times (n,) that begin anew with each."""
    begins = np.flatnonzero(np.diff(time, prepend=np.inf) <= 0)
    return np.split(np.arange(len(time)), begins[begins > 0])


def rms(values: Array) -> float:
    """Root of the mean square, 0 for nothing."""
    return float(np.sqrt(np.mean(values**2))) if len(values) else 0.0


Place = Literal["joint", "actuator", "sensor", "world"]


class Effect(ABC):
    """A piece of physics that a model may lack.

    Attributes:
        id: name in reports, `friction.coulomb`; a colon sets off a form of it, which `name` leaves out.
        place: what it acts at.
        parameters: its parameters.
        rivals: ids of effects it is easily mistaken for.
        contains: ids of effects that are this one with a parameter at its limit; adding this one replaces them.
        at_its_joint: ids of effects of the joint that its actuator drives, which it may be nothing else than.
        one_of: of which kind a place has one alone, as `dry friction`: two effects of it exclude each other.
        finest: longest step at which it can be simulated, s.
        warm: s of simulation before a window, so that hidden states settle.
        needs_loader: whether stock MuJoCo leaves it out.
        moves_readings: whether it changes what sensors say of a state, so that estimated initial states mean little.
        linear: parameters in proportion to which, taken together, its response grows from nothing.
        levels: parameters that are levels of dry friction.
        valleys: parameters that a fit hardly moves from where it begins: each of their guesses is fitted.
        by_steps: parameters that change readings by steps, if at all: a fit searches for them, for slopes tell nothing.
        free: whether its law takes any shape, as a table; such effects are asked where no formula comes to the noise.
        once: whether it happened once, so that other recordings cannot confirm it.
        of_no_kind: whether it only models what nothing accounts for, as a law that predicts it: asked last, no name.
        of_the_clock: whether it depends on time and not on the state, so that no other recording shares it.
        of_the_past: whether it goes with what was of late, which is nothing where a recording begins at rest.
        shown_by: what to record to tell it from what is the same model on what was recorded.
        element: of MJCF that it is written as, in words, where its effect has more than one form.
        leaves: share of a mismatch that it may leave and be named. Small for an effect that is told from others by when
            it acts alone: what it leaves may act then as well.
    """

    id: ClassVar[str]
    place: ClassVar[Place]
    parameters: tuple[Parameter, ...]
    rivals: ClassVar[tuple[str, ...]] = ()
    contains: ClassVar[tuple[str, ...]] = ()
    at_its_joint: ClassVar[tuple[str, ...]] = ()
    one_of: ClassVar[str] = ""
    finest: ClassVar[float] = math.inf
    warm: ClassVar[float] = 0.0
    needs_loader: ClassVar[bool] = False
    moves_readings: ClassVar[bool] = False
    linear: tuple[str, ...] = ()
    levels: tuple[str, ...] = ()
    valleys: ClassVar[tuple[str, ...]] = ()
    by_steps: tuple[str, ...] = ()
    free: ClassVar[bool] = False
    once: ClassVar[bool] = False
    of_the_clock: ClassVar[bool] = False
    of_the_past: ClassVar[bool] = False
    of_no_kind: ClassVar[bool] = False
    leaves: ClassVar[float] = EFFECTS.leaves
    shown_by: ClassVar[str] = (
        "what moves one and not the other: other speeds, other positions, another load, or a second sensor"
    )
    element: str = ""

    @property
    def name(self) -> str:
        """The id without the form: what diagnosis.json calls the effect."""
        return self.id.partition(":")[0]

    def fits(self, model: mujoco.MjModel, at: str) -> bool:
        """Whether it can be missing there: False where the model has it already, or it makes no sense."""
        return True

    def proposals(self, evidence: Evidence) -> Sequence[tuple[Effect, Values]]:
        """The effect with its first guesses; one with a free shape takes the shape that the evidence asks for."""
        effect: Effect = self
        if self.own(evidence.model, evidence.at):
            effect = copy.copy(self)
            effect.linear = ()  # what it does goes with how much more of it there is than the model has
        return [(effect, values) for values in self.guesses(evidence)]

    def own(self, model: mujoco.MjModel, at: str) -> float:
        """How much of the effect a model has already where it sets, and does not add, it; 0 for none."""
        return 0.0

    @abstractmethod
    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """First guesses, small enough that the response is nearly linear; each is tried."""

    def unseen(self, evidence: Evidence, plain: Values) -> Values | None:
        """A size at which it would matter elsewhere, where one that it contains was found: windows that are predicted
        as well with that do not say whether it is there. None for what shows wherever the other does.

        Args:
            evidence: of its place.
            plain: values of the effect that was found.
        """
        return None

    @property
    def bends(self) -> Array:
        """What a law is known to be before any data: sums of its first mapped parameters that are about zero where
        these are counted from a law that is nothing, each over its standard deviation, (m, k).
        """
        return np.zeros((0, 0))

    def finer(self, values: Values, told: NDArray[np.bool_] | None = None) -> Sequence[tuple[Effect, Values]]:
        """The same law with more parameters, which begins as this one with these values; each is tried.

        Forces are known too roughly for where its knots lie; how many there are, fits in simulation tell.

        Args:
            values: of the parameters.
            told: which of them data moved from where they began, (p,): beside those it is made finer; None is all.
        """
        return ()

    def happened(self, values: Values) -> tuple[float, float]:
        """From when and until when it acts, s on the clock of its recording, where it happened `once`: other recordings
        are not held to that. Never, where it does not say.
        """
        return math.inf, -math.inf

    def forms(self) -> Sequence[Form]:
        """The same effect in other elements of MJCF: parameters of the same names, some of them fixed, another edit.

        At the step of a file one may predict where another is off by fifty times the noise: bristles too stiff for it,
        friction whose peak lasts less than a step. Which is written back is measured.
        """
        return ()

    def law_of(self, values: Values, unit: Mapping[str, str]) -> dict[str, Any] | None:
        """The law as diagnosis.json holds it, where it is a table; see `law.described`."""
        return None

    def inputs(self, at: str) -> tuple[str, ...]:
        """What its law depends on, where it is a table, as `support.input_of` knows it: it knows nothing elsewhere."""
        return ()

    @abstractmethod
    def edit(self, document: Document, at: str, values: Values) -> None:
        """Write the effect into the model."""

    @abstractmethod
    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """The effect in one plain sentence."""


class Form(Effect):
    """An effect in other elements of MJCF than it has in the catalogue, which passes over it: it is no hypothesis."""

    def guesses(self, evidence: Evidence) -> Sequence[Values]:
        """None; it takes the values of the effect that it is a form of."""
        return ()


def dof(model: mujoco.MjModel, joint: str) -> int:
    """Degree of freedom of a joint."""
    return int(model.joint(joint).dofadr[0])


def is_dcmotor(model: mujoco.MjModel, actuator: str) -> bool:
    """Whether an actuator is MuJoCo's DC motor."""
    return bool(model.actuator_gaintype[model.actuator(actuator).id] == mujoco.mjtGain.mjGAIN_DCMOTOR)


def joint_of(model: mujoco.MjModel, actuator: str) -> str | None:
    """The joint that an actuator drives, or None for tendons and sites."""
    i = model.actuator(actuator).id
    if model.actuator_trntype[i] != mujoco.mjtTrn.mjTRN_JOINT:
        return None
    return str(model.joint(int(model.actuator_trnid[i, 0])).name)


def acts_on(model: mujoco.MjModel, effect: Effect, at: str) -> str | None:
    """The joint that an effect acts at, or its actuator does; None for sensors, bodies and other actuators."""
    if effect.place == "actuator":
        return joint_of(model, at)
    return at if effect.place == "joint" else None


def sensed_joint(model: mujoco.MjModel, sensor: str) -> str | None:
    """The joint whose position or velocity a sensor reads, or None for one of tendons and actuators."""
    one, kinds = model.sensor(sensor), mujoco.mjtSensor
    if int(one.type[0]) not in (int(kinds.mjSENS_JOINTPOS), int(kinds.mjSENS_JOINTVEL)):
        return None
    return str(model.joint(int(one.objid[0])).name)


def joint_at(model: mujoco.MjModel, effect: Effect, at: str) -> str | None:
    """The joint that an effect acts at, its actuator does, or its sensor reads; None for bodies and all else."""
    return sensed_joint(model, at) if effect.place == "sensor" else acts_on(model, effect, at)


def sensed_position(model: mujoco.MjModel, sensor: str) -> bool:
    """Whether a sensor reads the position of one joint."""
    return bool(model.sensor(sensor).type[0] == mujoco.mjtSensor.mjSENS_JOINTPOS)


def passive_force(document: Document, name: str, joint: str, force: float) -> None:
    """A constant force on a joint: the cogging torque of a motor with no poles."""
    passive_wave(document, name, joint, force, 0.0, math.pi / 2)


def passive_wave(document: Document, name: str, joint: str, size: float, per_unit: float, phase: float) -> None:
    """A force size * sin(per_unit * position + phase) on a joint, by the cogging torque of a passive motor."""
    passive_motor(document, name, joint, cogging=(size, per_unit, phase))


def passive_motor(document: Document, name: str, joint: str, **physics: Sequence[float]) -> None:
    """A DC motor without winding or command, for what MuJoCo's motors have beside them: `cogging` or `lugre`."""
    limit_the_drive(document, joint)
    element = document.add(
        "actuator",
        "dcmotor",
        name=document.fresh(name),
        joint=joint,
        input="none",
        resistance=1,
        motorconst="0 0",
        **physics,
    )
    none = {"inductance": "0 0", "thermal": "0 0 0 0 0 0", "cogging": "0 0 0", "lugre": "0 0 0 0 0"}
    document.plain(
        element, controller="0 0 0 0 0 0", **{key: zeros for key, zeros in none.items() if key not in physics}
    )
    if document.effective(element, "forcerange") or document.effective(element, "saturation"):
        document.set(element, saturation="0 0 0")
    shield(document, element)


def passive_rate(document: Document, name: str, joint: str, rate: float, limits: tuple[float, float]) -> None:
    """A force rate * velocity on a joint, held between limits."""
    passive_ramp(document, name, joint, (0, 0, rate), limits)


def passive_ramp(
    document: Document, name: str, joint: str, ramp: tuple[float, float, float], limits: tuple[float, float]
) -> None:
    """A force constant + per_position * position + per_speed * velocity on a joint, held between limits.

    MuJoCo drops the last two where the gain is zero, and takes no empty range. A gain this small lets whoever writes
    commands into all controls of the file move nothing.
    """
    limit_the_drive(document, joint)
    name = document.fresh(name)
    element = document.add(
        "actuator",
        "general",
        name=name,
        joint=joint,
        gainprm=DEAF,
        biastype="affine",
        biasprm=ramp,
        forcelimited="true",
        forcerange=(limits[0], max(limits[1], float(np.nextafter(limits[0] + 1e-12, np.inf)))),
    )
    document.plain(element, dyntype="none", gaintype="fixed", actdim="-1")
    shield(document, element)
    document.passive(name)


def limit_the_drive(document: Document, joint: str) -> None:
    """Give the one actuator of a joint the limit that the joint sets on all of its actuators' forces.

    With an actuator that stands for a force beside it, the sum would be held within the limit, and not the drive. Where
    several drive it, none of them has the limit alone, and it stays; as it does where a DC motor, whose torque has one
    limit for both ways, would need two.
    """
    element = document.joint(joint)
    limits = document.limits(element, "actuatorfrc")
    drives = [e for e in document.root.iterfind("actuator/*") if e.get("joint") == joint]
    if limits is None or len(drives) != 1:
        return
    (drive,) = drives
    gear = float((document.effective(drive, "gear", "1").split() or ["1"])[0])
    if not gear:
        return
    low, high = sorted(limit / gear for limit in limits)
    if drive.tag == "dcmotor":
        if low == -high:
            limit_the_motor(document, drive, high)
            document.set(element, actuatorfrclimited="false")
        return
    own = document.limits(drive, "force")
    if own is not None:
        low, high = max(low, own[0]), min(high, own[1])
    if low < high:
        document.set(drive, forcelimited="true", forcerange=(low, high))
        document.set(element, actuatorfrclimited="false")


def limit_the_motor(document: Document, motor: ET.Element, torque: float) -> None:
    """Limit a DC motor's torque, N m, within the limits that it has: of its torque, or of its current."""
    given, *others = [float(x) for x in document.effective(motor, "saturation", "0 0 0").split()]
    if not given and others and others[0]:
        constant = float((document.effective(motor, "motorconst", "1").split() or ["1"])[0])
        given = constant * others[0]
    document.set(motor, saturation=[min(torque, given or torque), *others])


def shield(document: Document, element: ET.Element) -> None:
    """Keep from an actuator that stands for a force what default classes give to the motors of the file."""
    document.plain(element, gear="1", damping="0 0 0", armature="0", delay="0", ctrllimited="auto", ctrlrange="0 0")


def dry(document: Document, joint: str, level: float) -> None:
    """Dry friction that holds: stiff within two steps, and iterated so that joints do not creep.

    Where recordings are a simulation's, MuJoCo's own: soft, as whoever writes `frictionloss` gets it.
    """
    document.set(document.joint(joint), frictionloss=level)
    if not document.simulated:
        document.set(document.joint(joint), solreffriction=(2 * document.timestep, 1))
        document.at_least(noslip_iterations=3, iterations=100)


def dry_beside(document: Document, joint: str, level: float) -> None:
    """The same where something beside it sets the level: never none, which to MuJoCo is another model."""
    dry(document, joint, max(level, EFFECTS.there))
