"""A compiled `mjModel` as a program of the engine: whole numbers that say what is there, and parameters."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf, physics
from dipc_gym.engine import constraints, layout, rigid
from dipc_gym.engine.laws import Rule, written
from dipc_gym.engine.layout import STATES, Element, Feature, Force, Head, Kind, Law, Sensor
from dipc_gym.engine.uncovered import Uncovered
from dipc_gym.physics import Physics

Array = NDArray[np.float64]
Whole = NDArray[np.int64]

_KEPT = 64  # models that were read lately: as many as stay compiled in a fit
_LIMITLESS = 1e30  # stands for no limit: no state comes near it


@dataclass(frozen=True)
class Program:
    """What a model has, without its numbers.

    Attributes:
        tree: joints and links.
        codes: whole numbers that the compiled loop reads.
        sensors: names, in the order in which they are read.
        states: hidden states.
        actuators: number of each one's element, -1 for a ramp, which shares one with others.
    """

    tree: rigid.Tree
    codes: Whole = field(repr=False)
    sensors: tuple[str, ...]
    states: int
    actuators: tuple[int, ...]

    @property
    def nx(self) -> int:
        """States, lags of sensors included."""
        return int(self.codes[Head.STATES])


def read(variants: Sequence[Physics]) -> tuple[Program, Array]:
    """The program of a model and its parameters in several variants, (variants, parameters).

    Args:
        variants: one structure with different numbers.

    Raises:
        Uncovered: the engine does not simulate something in it, or the variants have different structures.
    """
    written = [_written(variant) for variant in variants]
    first = written[0]
    for one in written[1:]:
        if one.tree != first.tree or one.ints != first.ints:
            raise Uncovered("variants differ in more than numbers")
    parameters = np.array([one.numbers for one in written])
    tree = rigid.fix(first.tree, parameters[:, : first.tree.count])
    codes = np.array(first.ints, dtype=np.int64)
    names = tuple(mjcf.scalar_sensors(variants[0].model))
    return Program(tree, codes, names, first.hidden, tuple(first.element_of)), parameters


def parameters_of(program: Program, variant: Physics) -> Array | None:
    """Parameters (k,) of another variant of a program's structure; None where it has another one."""
    one = _written(variant)
    numbers, fixed = np.array(one.numbers), program.tree.fixed
    same = (one.tree.parents, one.tree.slides) == (program.tree.parents, program.tree.slides)
    if not same or one.ints != program.codes.tolist() or any(numbers[k] != value for k, value in fixed):
        return None
    return numbers


@functools.lru_cache(maxsize=_KEPT)
def _written(variant: Physics) -> _Writer:
    """What a model has; a fit asks for the same ones again, and who changes one for a moment puts it back."""
    return _Writer(variant)


class _Writer:
    """Reads one model."""

    def __init__(self, source: Physics) -> None:
        model = source.model
        self.model, self.physics = model, source
        _check_covered(model)
        self.tree, numbers = rigid.tree_of(model)
        self.numbers: list[float] = numbers.tolist()
        self.ints: list[int] = [0] * int(Head.SIZE)
        self.controls = mjcf.commanded(model)  # what comes after them nobody commands; it stays at zero
        self.yielding = 0  # springs, whose rests are hidden states behind MuJoCo's activations; then what laws remember
        self.remembering = len(source.remembering)
        self.ranges = np.clip(np.stack(mjcf.command_ranges(model), axis=1), -_LIMITLESS, _LIMITLESS)
        self.element_of = [-1] * int(model.nactuator)
        self._joints()
        elements = self._tendons()
        elements += self._actuators(len(elements))
        self.ints[Head.DELAYS] = len(self.numbers)
        delays = mjcf.control_delays(model)[: self.controls]
        # Seen from the sensor that reads latest, commands act later by as much.
        self.numbers += (delays + mjcf.latest_sensor(model)).tolist()
        self.ints[Head.RANGES] = len(self.numbers)
        self.numbers += self.ranges[: self.controls].ravel().tolist()
        lags = self._sensors()
        self._laws()
        self.ints[Head.ELEMENT_AT], self.ints[Head.ELEMENTS] = len(self.ints), len(elements)
        self.ints += [number for element in elements for number in element]
        self.ints[Head.JOINTS] = model.nv
        self.ints[Head.CONTROLS] = self.controls
        self.ints[Head.STATES] = 2 * model.nv + self.hidden + lags
        self.ints[Head.PARAMETERS] = len(self.numbers)
        for what, most, count in (
            ("joints", layout.JOINTS, model.nv),
            ("states", layout.STATES, self.ints[Head.STATES]),
            ("controls", layout.CONTROLS, self.controls),
            ("sensors", layout.SENSORS, self.ints[Head.SENSORS]),
            ("limits and equality constraints", layout.STOPS, self.ints[Head.STOPS] + self.ints[Head.TIES]),
        ):
            if count > most:
                raise Uncovered(f"{count} {what}, more than {most}")

    @property
    def hidden(self) -> int:
        """Hidden states: MuJoCo's activations, rests of springs that yield, and what laws remember."""
        return int(self.model.na) + self.yielding + self.remembering

    def _joints(self) -> None:
        model = self.model
        self.ints[Head.JOINT_NUMBERS] = len(self.numbers)
        stiff = constraints.stiff_limits(model)
        damped = not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_DAMPER
        sprung = not model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_SPRING
        for k in range(model.nv):
            damping = [float(model.dof_damping[k]), *np.ravel(model.dof_dampingpoly[k]).tolist()]
            armature, by = float(model.dof_armature[k]), int(model.jnt_actuatorid[k])
            if by >= 0:  # the one actuator whose damping and armature the joint feels
                gear = mjcf.gear(model, by)
                armature += float(model.actuator_armature[by]) * gear**2
                more = [float(model.actuator_damping[by]), *np.ravel(model.actuator_dampingpoly[by]).tolist()]
                damping = [x + y * gear**2 for x, y in zip(damping, more, strict=True)]
            stiffness = [float(model.jnt_stiffness[k]), *np.ravel(model.jnt_stiffnesspoly[k]).tolist()]
            unbent = float(model.qpos_spring[model.jnt_qposadr[k]])
            friction = float(model.dof_frictionloss[k])
            self.numbers += [x * damped for x in damping] + [x * sprung for x in stiffness]
            free = -_LIMITLESS, _LIMITLESS
            ends = constraints.within(model.jnt_range[k], model.jnt_margin[k]) if stiff[k] else free
            bounded = bool(model.jnt_actfrclimited[k])
            if bounded and model.jnt_actgravcomp[k]:
                raise Uncovered("a limited actuator force at a joint whose actuators carry its weight")
            forces = model.jnt_actfrcrange[k].tolist() if bounded else free
            self.ints[Head.BOUNDED] |= bounded
            self.numbers += [unbent, armature, friction, *ends, *forces]

    def _element(
        self, kind: Kind, dofs: Sequence[int], coefficients: Sequence[float], numbers: Sequence[float], **more: int
    ) -> list[int]:
        element = [0] * int(Element.SIZE)
        element[Element.KIND] = int(kind)
        element[Element.TERMS], element[Element.TERM_AT] = len(dofs), len(self.ints)
        element[Element.CONTROL], element[Element.STATE] = more.get("control", -1), more.get("state", -1)
        element[Element.NUMBERS], element[Element.FEATURES] = len(self.numbers), more.get("features", 0)
        self.ints += list(dofs)
        self.numbers += [*numbers, *coefficients]
        return element

    def _along(self, tendon: int) -> tuple[list[int], list[float]]:
        """Joints of a fixed tendon, and their coefficients."""
        model, found = self.model, mjcf.along(self.model, tendon)
        if len(found) < model.tendon_num[tendon]:
            raise Uncovered(f"tendon {model.tendon(tendon).name!r} is not a fixed one")
        return [joint for joint, _ in found], [coefficient for _, coefficient in found]

    def _tendons(self) -> list[list[int]]:
        model, elements = self.model, []
        stops = [constraints.of_joint(model, k) for k in constraints.soft_limits(model).tolist()]
        for t in range(model.ntendon):
            name = model.tendon(t).name
            dofs, coefficients = self._along(t)
            if model.tendon_frictionloss[t] or model.tendon_armature[t] or model.tendon_actfrclimited[t]:
                raise Uncovered(f"tendon {name!r} has friction, armature or a limited force")
            low, high = model.tendon_lengthspring[t]
            stiffness = [float(model.tendon_stiffness[t]), *np.ravel(model.tendon_stiffnesspoly[t]).tolist()]
            damping = [float(model.tendon_damping[t]), *np.ravel(model.tendon_dampingpoly[t]).tolist()]
            spring = [float(low), float(high), *stiffness, *damping, float(model.tendon_springyield[t])]
            if model.tendon_plasticadr[t] >= 0:
                if low != high:
                    raise Uncovered(f"tendon {name!r} has a spring that yields, and a gap")
                elements.append(
                    self._element(Kind.YIELDING, dofs, coefficients, spring, state=model.na + self.yielding)
                )
                self.yielding += 1
            # One with a gap is meant to pull, also where its stiffness is nothing: a variant may have some.
            elif any(stiffness) or any(damping) or low != high:
                elements.append(self._element(Kind.SPRING, dofs, coefficients, spring))
            if model.tendon_limited[t]:
                stops.append(constraints.of_tendon(model, t, dofs, coefficients))
        ties = constraints.ties(model)
        self.ints[Head.STOPS], self.ints[Head.TIES] = len(stops), len(ties)
        elements += [self._element(Kind.STOP, *stop) for stop in stops]
        return elements + [self._element(Kind.TIE, *tie) for tie in ties]

    def _actuators(self, first: int) -> list[list[int]]:
        """Elements of actuators, which come from number `first` on; ramps last."""
        ramps = self._ramps()
        others = sorted(set(range(self.model.nactuator)).difference(*ramps.values()))
        alone = [self._actuator(i) for i in others]
        for k, i in enumerate(others):
            self.element_of[i] = first + k
        return alone + [self._as_one(dof, which, gear) for (dof, gear), which in ramps.items()]

    def _ramps(self) -> dict[tuple[int, float], list[int]]:
        """Actuators that are a force of a joint's position and speed between limits, by joint and gear.

        Laws over position and speed have one for each stretch. They are one element, for most of what an actuator costs
        is what it might be.
        """
        model = self.model
        gears, joints = model.actuator_gear[model.actuator_outadr, 0], model.actuator_trnid[:, 0]
        are = (
            (model.actuator_trntype == mujoco.mjtTrn.mjTRN_JOINT)
            & ((model.actuator_ctrlnum == 0) | (model.actuator_ctrladr >= self.controls))
            & (model.actuator_dyntype == mujoco.mjtDyn.mjDYN_NONE)
            & (model.actuator_gaintype == mujoco.mjtGain.mjGAIN_FIXED)
            & (model.actuator_biastype == mujoco.mjtBias.mjBIAS_AFFINE)
            & (model.actuator_forcelimited != 0)
            & (model.actuator_actlimited == 0)
            & (model.actuator_plugin < 0)
        )
        which = np.flatnonzero(are)
        found = dict[tuple[int, float], list[int]]()
        dofs = model.jnt_dofadr[joints[which]].tolist()
        for i, dof, gear in zip(which.tolist(), dofs, gears[which].tolist(), strict=True):
            found.setdefault((dof, gear), []).append(i)
        return found

    def _as_one(self, dof: int, which: list[int], gear: float) -> list[int]:
        """An element of ramps."""
        model = self.model
        ramps = np.concatenate([model.actuator_biasprm[which, :3], model.actuator_forcerange[which]], axis=1)
        element = self._element(Kind.RAMPS, [dof], [gear], [], features=len(which))
        self.numbers += ramps.ravel().tolist()
        return element

    def _actuator(self, i: int) -> list[int]:
        model, kinds = self.model, mujoco.mjtDyn
        name = model.actuator(i).name
        where = f"actuator {name!r}"
        dofs, coefficients = self._driven(i, where)
        if model.actuator_trntype[i] == mujoco.mjtTrn.mjTRN_TENDON and (
            model.actuator_damping[i] or model.actuator_armature[i] or np.any(model.actuator_dampingpoly[i])
        ):
            raise Uncovered(f"{where} has damping or armature on a tendon")
        if model.actuator_actlimited[i]:
            raise Uncovered(f"{where} has a limited activation")
        if model.actuator_plugin[i] >= 0:
            raise Uncovered(f"{where} is a plugin")
        numbers = [0.0] * int(Force.SIZE)
        control = self._control(i, where, numbers)
        if model.actuator_forcelimited[i]:
            numbers[Force.LOWEST], numbers[Force.HIGHEST] = (float(x) for x in model.actuator_forcerange[i])
        else:
            numbers[Force.LOWEST], numbers[Force.HIGHEST] = -_LIMITLESS, _LIMITLESS
        dynamics = int(model.actuator_dyntype[i])
        if model.actuator_gaintype[i] == mujoco.mjtGain.mjGAIN_DCMOTOR:
            return self._motor(i, where, numbers, dofs, coefficients, control)
        gains, biases = mujoco.mjtGain, mujoco.mjtBias
        if model.actuator_gaintype[i] == gains.mjGAIN_FIXED:
            numbers[Force.GAIN] = float(model.actuator_gainprm[i, 0])
        elif model.actuator_gaintype[i] == gains.mjGAIN_AFFINE:
            numbers[Force.GAIN : Force.GAIN + 3] = model.actuator_gainprm[i, :3].tolist()
        else:
            raise Uncovered(f"{where} has a gain that is neither fixed nor affine")
        if model.actuator_biastype[i] == biases.mjBIAS_AFFINE:
            numbers[Force.BIAS : Force.BIAS + 3] = model.actuator_biasprm[i, :3].tolist()
        elif model.actuator_biastype[i] != biases.mjBIAS_NONE:
            raise Uncovered(f"{where} has a bias that is not affine")
        if dynamics == kinds.mjDYN_NONE:
            return self._element(Kind.PLAIN, dofs, coefficients, numbers, control=control)
        found = {
            int(kinds.mjDYN_INTEGRATOR): Kind.INTEGRATED,
            int(kinds.mjDYN_FILTER): Kind.FILTERED,
            int(kinds.mjDYN_FILTEREXACT): Kind.FILTERED,
        }.get(dynamics)
        if found is None or model.actuator_actnum[i] != 1:
            raise Uncovered(f"{where} has dynamics that are neither a filter nor an integrator")
        numbers[Force.TIME] = max(float(model.actuator_dynprm[i, 0]), 1e-12)
        return self._element(found, dofs, coefficients, numbers, control=control, state=self._state(i))

    def _driven(self, i: int, where: str) -> tuple[list[int], list[float]]:
        """Joints that an actuator moves, and how far it goes with each."""
        model, kinds = self.model, mujoco.mjtTrn
        gear, at = mjcf.gear(model, i), int(model.actuator_trnid[i, 0])
        if model.actuator_trntype[i] == kinds.mjTRN_JOINT:
            return [int(model.jnt_dofadr[at])], [gear]
        if model.actuator_trntype[i] == kinds.mjTRN_TENDON:
            dofs, along = self._along(at)
            return dofs, [gear * c for c in along]
        raise Uncovered(f"{where} acts neither on a joint nor on a tendon")

    def _control(self, i: int, where: str, numbers: list[float]) -> int:
        """Index of an actuator's control, -1 if nobody commands it; its limits go into `numbers`."""
        model = self.model
        numbers[Force.LOWEST_COMMAND], numbers[Force.HIGHEST_COMMAND] = -_LIMITLESS, _LIMITLESS
        count = int(model.actuator_ctrlnum[i])
        if count > 1:
            raise Uncovered(f"{where} takes {count} commands")
        control = int(model.actuator_ctrladr[i])
        if not count or control >= self.controls:
            return -1
        numbers[Force.LOWEST_COMMAND], numbers[Force.HIGHEST_COMMAND] = self.ranges[control].tolist()
        return control

    def _motor(
        self, i: int, where: str, numbers: list[float], dofs: list[int], coefficients: list[float], control: int
    ) -> list[int]:
        model = self.model
        if int(model.actuator_ctrlspec[i]) not in (
            mujoco.mjtCtrlInput.mjINPUT_VOLTAGE,
            mujoco.mjtCtrlInput.mjINPUT_NONE,
        ):
            raise Uncovered(f"{where} has a controller on board")
        gain, bias, dynamics = (
            np.asarray(x[i], dtype=float).tolist()
            for x in (model.actuator_gainprm, model.actuator_biasprm, model.actuator_dynprm)
        )
        if any(gain[4:]) or any(bias[6:]) or any(dynamics[7:]):
            raise Uncovered(f"{where} has a controller on board")
        if dynamics[1]:
            raise Uncovered(f"{where} has a limited rate of its current")
        numbers[Force.GAIN : Force.GAIN + 3] = gain[:3]
        numbers[Force.BIAS], numbers[Force.BIAS + 1] = gain[3], dynamics[4]
        numbers[Force.TIME] = dynamics[0]
        numbers[Force.COGS : Force.COGS + 3] = bias[:3]
        numbers[Force.BRISTLES : Force.BRISTLES + 5] = [*bias[3:6], dynamics[5], dynamics[6]]
        numbers[Force.HEAT : Force.HEAT + 2] = dynamics[2:4]
        features = 0
        for feature, there in (
            (Feature.WINDING, dynamics[0] > 0),
            (Feature.HEAT, dynamics[2] > 0),
            (Feature.BRISTLES, dynamics[5] > 0),
            (Feature.COGS, True),
        ):
            features |= int(feature) * bool(there)
        counted = bin(features & ~int(Feature.COGS)).count("1")
        if counted != int(model.actuator_actnum[i]):
            raise Uncovered(f"{where} has {model.actuator_actnum[i]} hidden states where {counted} are known")
        state = self._state(i) if counted else -1
        return self._element(Kind.MOTOR, dofs, coefficients, numbers, control=control, state=state, features=features)

    def _state(self, i: int) -> int:
        """Index of an actuator's first hidden state, which is MuJoCo's."""
        return int(self.model.actuator_actadr[i])

    def _sensors(self) -> int:
        """Sensors; how many of them lag."""
        model = self.model
        lags = {extra.index: float(extra.data[0]) for extra in self.physics.stage("lag")}
        found, late = [], 0
        latest = mjcf.latest_sensor(model)
        self.ints[Head.LATE] = len(self.numbers)
        self.numbers.append(latest)
        for name in mjcf.scalar_sensors(model):
            sensor = model.sensor(name).id
            if model.sensor_interval[sensor].any():
                raise Uncovered(f"sensor {name!r} has an interval")
            states, weights = self._read_by(sensor, name)
            numbers = [0] * int(Sensor.SIZE)
            numbers[Sensor.TERMS], numbers[Sensor.TERM_AT] = len(states), len(self.ints)
            self.ints += states
            numbers[Sensor.NUMBERS] = len(self.numbers)
            self.numbers += weights
            numbers[Sensor.LAG], numbers[Sensor.TIME] = -1, len(self.numbers)
            numbers[Sensor.AHEAD] = len(self.numbers) + 1
            tau = lags.get(int(model.sensor_adr[sensor]))
            if tau is not None:
                numbers[Sensor.LAG] = 2 * model.nv + self.hidden + late
                late += 1
            self.numbers += [tau or 0.0, latest - float(model.sensor_delay[sensor])]
            found.append(numbers)
        self.ints[Head.SENSOR_AT], self.ints[Head.SENSORS] = len(self.ints), len(found)
        self.ints += [number for numbers in found for number in numbers]
        return late

    def _read_by(self, sensor: int, name: str) -> tuple[list[int], list[float]]:
        """States whose sum a sensor reads, and their weights: of a joint, a fixed tendon, or an actuator on one."""
        model, kinds = self.model, mujoco.mjtSensor
        what, at = int(model.sensor_type[sensor]), int(model.sensor_objid[sensor])
        speed = what in (kinds.mjSENS_JOINTVEL, kinds.mjSENS_TENDONVEL, kinds.mjSENS_ACTUATORVEL)
        if model.sensor_cutoff[sensor]:
            raise Uncovered(f"sensor {name!r} has a cutoff")
        if what in (kinds.mjSENS_JOINTPOS, kinds.mjSENS_JOINTVEL):
            dofs, weights = [int(model.jnt_dofadr[at])], [1.0]
        elif what in (kinds.mjSENS_TENDONPOS, kinds.mjSENS_TENDONVEL):
            dofs, weights = self._along(at)
        elif what in (kinds.mjSENS_ACTUATORPOS, kinds.mjSENS_ACTUATORVEL):
            dofs, weights = self._driven(at, f"sensor {name!r}")
        else:
            raise Uncovered(f"sensor {name!r} reads neither a position nor a speed of a joint, tendon or actuator")
        return [dof + model.nv * speed for dof in dofs], weights

    def _laws(self) -> None:
        known, laws = [one.effect for one in rules()], []
        first = 2 * self.model.nv + self.hidden - self.remembering
        memories = {id(extra): first + k for k, extra in enumerate(self.physics.remembering)}
        for extra in self.physics.extras:
            if extra.stage not in ("friction", "force"):
                continue
            if extra.effect not in known:
                raise Uncovered(f"the law of {extra.effect}, which does more than arithmetic on numbers,")
            law = [0] * int(Law.SIZE)
            law[Law.RULE], law[Law.JOINT] = known.index(extra.effect), extra.index
            law[Law.NUMBERS], law[Law.COUNT] = len(self.numbers), len(extra.data)
            seen = [self._input(extra.effect, kind, k) for kind, k in extra.inputs]
            law[Law.FIRST : Law.SECOND + 1] = [*seen, 0, 0][:2]
            law[Law.STATE] = memories.get(id(extra), -1)
            self.numbers += extra.data.tolist()
            laws.append(law)
        self.ints[Head.LAW_AT], self.ints[Head.LAWS] = len(self.ints), len(laws)
        self.ints[Head.WEIGHED] = int(self.physics.pressed)
        self.ints += [number for law in laws for number in law]

    def _input(self, effect: str, kind: str, k: int) -> int:
        """Where the loop finds what a law depends on."""
        model = self.model
        if kind == "command":
            if model.actuator_delay.any():
                raise Uncovered(f"the law of {effect}, which depends on a command beside delayed ones,")
            return STATES + k
        if kind == "velocity":
            return int(model.nv) + k
        return int(model.jnt_dofadr[int(np.flatnonzero(model.jnt_qposadr == k)[0])])


def rules() -> tuple[Rule, ...]:
    """What `<custom>` may add to joints and becomes code as it stands: all that is registered now."""
    return _rules(physics.known())


@functools.lru_cache(maxsize=4)
def _rules(known: tuple[physics.Entry, ...]) -> tuple[Rule, ...]:
    return tuple(
        Rule(one.effect, one.rule, one.stage == "friction", one.memory)
        for one in known
        if one.stage in ("friction", "force") and written(one.rule) and (one.memory is None or written(one.memory))
    )


def _check_covered(model: mujoco.MjModel) -> None:
    """Raise for what the engine leaves out."""
    kinds = mujoco.mjtJoint
    if any(int(kind) not in (kinds.mjJNT_HINGE, kinds.mjJNT_SLIDE) for kind in model.jnt_type):
        raise Uncovered("a joint that is neither hinge nor slide")
    for what, there in (
        ("a spring of a joint that yields", bool(np.any(model.jnt_springyield))),
        ("a medium with density, viscosity or wind", bool(model.opt.density or model.opt.viscosity)),
        ("a flexible body", model.nflex > 0),
        ("a mocap body", model.nmocap > 0),
        ("a plugin", model.nplugin > 0),
        ("actuation switched off", bool(model.opt.disableactuator)),
    ):
        if there:
            raise Uncovered(what)
    switches = mujoco.mjtDisableBit
    for switch in (switches.mjDSBL_ACTUATION, switches.mjDSBL_CLAMPCTRL, switches.mjDSBL_LIMIT):
        if model.opt.disableflags & switch:
            raise Uncovered(f"the flag {switch.name}")
