"""A structure: the nominal model, those of its parameters that are free, and the effects added to it."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from dipc_gym import mjcf, physics
from dipc_gym.engine.constraints import relaxes, settles
from dipc_gym.mjcf.bare import bare
from dipc_gym.mjcf.edit import Document
from dipc_gym.physics import Physics
from dipc_gym.sim2real.effects.shared.base import Effect, Parameter
from dipc_gym.sim2real.effects.shared.settings import EFFECTS
from dipc_gym.sim2real.model.parameters import ModelParameter
from dipc_gym.sim2real.model.prior import Prior, product
from dipc_gym.sim2real.model.settings import MODEL
from dipc_gym.sim2real.unseen.parts import loads

Array = NDArray[np.float64]

_models: dict[tuple[int, bytes], Physics] = {}  # compiled lately; a fit asks for the same ones again
_numbers = itertools.count()


@dataclass(frozen=True)
class Term:
    """An effect at a place, with the guess it starts from; the guess also sets the scale of its parameters."""

    effect: Effect
    at: str
    guess: Mapping[str, float]

    @property
    def key(self) -> str:
        """`effect@place`."""
        return f"{self.effect.id}@{self.at}"


@dataclass(frozen=True)
class Slot:
    """One free parameter of a structure, mapped so that a unit step is a sizeable change.

    Attributes:
        key: `place.attribute` of a model parameter, or `effect@place.parameter`.
        unit: SI.
        low: smallest value.
        high: largest value.
        log: whether it is mapped to its logarithm.
        scale: what the mapped value 1 stands for, counted from `origin`; the value that 0 stands for if `log`.
        sigma: standard deviation of the mapped parameter's prior; infinite for effects that have none.
        centre: mean of that prior.
        fine: relative change that a unit step makes, if `log`.
        above: key of an earlier parameter that this one is never smaller than.
        origin: value that the mapped value 0 stands for (unless `log`).
    """

    key: str
    unit: str
    low: float
    high: float
    log: bool
    scale: float
    sigma: float = math.inf
    centre: float = 0.0
    fine: float = 1.0
    above: str = ""
    origin: float = 0.0

    @property
    def may_vanish(self) -> bool:
        """Whether the parameter can be zero; what is mapped to its logarithm cannot."""
        return not self.log

    def value(self, z: float) -> float:
        """The parameter of a mapped value."""
        return float(_unmapped(z, self.low, self.high, self.log, self.scale, self.fine, self.origin))

    def mapped(self, value: float) -> float:
        """The mapped value of a parameter."""
        return math.log(value / self.scale) / self.fine if self.log else (value - self.origin) / self.scale


@dataclass(frozen=True)
class Structure:
    """Nominal model, those of its parameters that are free, added effects.

    Attributes:
        document: the nominal model's text.
        model: the nominal model.
        base: names of its joints.
        model_parameters: those of its own that are free.
        terms: effects added, in the order in which they are written.
        longest: step in which it is simulated at most, s, whatever its effects bear.
        warmed: how long it is simulated before a window at least, s, whatever its effects need.
    """

    document: Document
    model: mujoco.MjModel
    base: tuple[str, ...]
    model_parameters: tuple[ModelParameter, ...] = ()
    terms: tuple[Term, ...] = ()
    longest: float = math.inf
    warmed: float = 0.0
    slots: tuple[Slot, ...] = field(init=False)

    def __post_init__(self) -> None:
        slots = []
        for n in self.model_parameters:
            centre, reach = math.log((n.expected or n.value) / n.value), MODEL.farthest * n.sigma
            low, high = n.value * math.exp(centre - reach), n.value * math.exp(centre + reach)
            slots.append(Slot(n.key, n.unit, low, high, True, n.value, n.sigma, centre))
        for term in self.terms:
            for p in _fitted(term.effect):
                guess = term.guess[p.name]
                scale = p.step or (abs(guess) if guess else _fallback(p.low, p.high))
                origin = guess if p.step else 0.0
                above = p.above and f"{term.key}.{p.above}"
                key = f"{term.key}.{p.name}"
                slots.append(
                    Slot(key, p.unit, p.low, p.high, p.log, scale, p.sigma, fine=p.fine, above=above, origin=origin)
                )
        object.__setattr__(self, "slots", tuple(slots))

    def __getstate__(self) -> dict[str, Any]:
        """What another process gets: all but the number that no other structure has, see `_own`."""
        return {each.name: getattr(self, each.name) for each in fields(self)} | {"worked_out": self.worked_out}

    @functools.cached_property
    def first(self) -> Array:
        """Mapped parameters at the nominal values and the guesses, (p,)."""
        z = [0.0] * len(self.model_parameters)
        for term in self.terms:
            for p in _fitted(term.effect):
                z.append(self.slots[len(z)].mapped(term.guess[p.name]))
        return np.array(z)

    @functools.cached_property
    def prior(self) -> Prior:
        """What is known of the mapped parameters before any data."""
        precision = np.diag([1 / slot.sigma**2 for slot in self.slots])
        prior = Prior(precision, np.array([slot.centre for slot in self.slots]))
        first = len(self.model_parameters)
        for term in self.terms:
            bends, count = term.effect.bends, len(_fitted(term.effect))
            if len(bends):
                own = list(range(first, first + count))[: bends.shape[1]]
                rows = np.zeros((len(bends), len(self.slots)))
                rows[:, own] = bends
                prior = product(prior, rows, bends @ [self.slots[i].mapped(0.0) for i in own])
            first += count
        return prior

    @functools.cached_property
    def tables(self) -> NDArray[np.intp]:
        """Which term each parameter is a value in the table of, -1 for those that are in none, (p,)."""
        out = [-1] * len(self.model_parameters)
        for k, term in enumerate(self.terms):
            out += [k if term.effect.free else -1] * len(_fitted(term.effect))
        return np.array(out, dtype=np.intp)

    @functools.cached_property
    def bounds(self) -> tuple[Array, Array]:
        """Smallest and largest mapped parameters, (p,) each."""
        low = [-math.inf if slot.log and slot.low <= 0 else slot.mapped(slot.low) for slot in self.slots]
        return np.array(low), np.array([slot.mapped(slot.high) for slot in self.slots])

    def clip(self, z: Array) -> Array:
        """The nearest mapped parameters within bounds."""
        out = z.copy()
        for i, (slot, value) in enumerate(zip(self.slots, self.all_values(z).tolist(), strict=True)):
            if value in (slot.low, slot.high) and (slot.may_vanish or value > 0):
                out[i] = slot.mapped(value)
            if slot.above:
                j = next(j for j, other in enumerate(self.slots) if other.key == slot.above)
                out[i] = max(out[i], slot.mapped(self.slots[j].value(out[j])))
        return out

    def with_term(self, term: Term) -> Structure:
        """This structure and one more effect, the newest; effects that the new one contains at that place go."""
        kept = tuple(t for t in self.terms if not (t.at == term.at and t.effect.id in term.effect.contains))
        return replace(self, terms=(*kept, term))

    @property
    def newest(self) -> Term:
        """The effect that came last."""
        return self.terms[-1]

    @property
    def newest_two(self) -> tuple[Term, ...]:
        """The two effects that came last."""
        return self.terms[-2:]

    def without(self, key: str) -> Structure:
        """This structure less one effect."""
        return replace(self, terms=tuple(t for t in self.terms if t.key != key))

    @property
    def unnamed(self) -> tuple[Term, ...]:
        """Its laws of no kind."""
        return tuple(term for term in self.terms if term.effect.of_no_kind)

    @property
    def named(self) -> tuple[Term, ...]:
        """Its effects with names."""
        return tuple(term for term in self.terms if not term.effect.of_no_kind)

    def elaborates(self, other: Structure) -> bool:
        """Whether this is another structure with effects in the place of plainer ones that they contain."""

        def plainer(term: Term) -> bool:
            return any(
                term.key == t.key or (term.at == t.at and t.effect.id in term.effect.contains) for t in other.terms
            )

        return len(self.terms) == len(other.terms) and all(plainer(term) for term in self.terms)

    def values(self, z: Array) -> dict[str, float]:
        """Every free parameter by key."""
        return dict(zip((slot.key for slot in self.slots), self.all_values(z).tolist(), strict=True))

    def all_values(self, z: Array) -> Array:
        """Every free parameter, (p,)."""
        return np.asarray(_unmapped(z, *self._mapping))

    @functools.cached_property
    def _mapping(self) -> tuple[Array, Array, NDArray[np.bool_], Array, Array, Array]:
        """What `_unmapped` needs of each slot, (p,) each."""
        low, high, scale, fine, origin = (
            np.array([(slot.low, slot.high, slot.scale, slot.fine, slot.origin) for slot in self.slots], dtype=float)
            .reshape(-1, 5)
            .T
        )
        return low, high, np.array([slot.log for slot in self.slots], dtype=bool), scale, fine, origin

    @property
    def stepwise(self) -> list[list[int]]:
        """Numbers of the mapped parameters of each effect that change readings by steps, see `Effect.by_steps`."""
        number = {slot.key: i for i, slot in enumerate(self.slots)}
        each = ([number[f"{term.key}.{name}"] for name in term.effect.by_steps] for term in self.terms)
        return [own for own in each if own]

    def sizes(self, z: Array) -> Array:
        """What steps of the mapped parameters are measured by, (p,): 1, or a parameter as large as it is."""
        vanishing = np.array([slot.may_vanish for slot in self.slots], dtype=bool)
        return np.asarray(np.maximum(1.0, np.abs(z) * vanishing))

    def term_values(self, z: Array, term: Term) -> dict[str, float]:
        """Parameters of one effect."""
        return self._values_of(term, self.values(z))

    @staticmethod
    def _values_of(term: Term, values: Mapping[str, float]) -> dict[str, float]:
        return {
            p.name: term.guess[p.name] if p.fixed else values[f"{term.key}.{p.name}"] for p in term.effect.parameters
        }

    def write(self, z: Array) -> Document:
        """The nominal document with these parameters and effects written in."""
        return self._written(self.document, z)

    def _written(self, document: Document, z: Array) -> Document:
        """A copy of a document of the nominal model with these parameters and effects written in."""
        document, values = document.copy(), self.values(z)
        for parameter in self.model_parameters:
            parameter.write(document, values[parameter.key])
        # A rotor of its own first: what acts on the drive acts on that, whichever of both was found before.
        for term in sorted(self.terms, key=lambda term: term.effect.one_of != "rotor"):
            term.effect.edit(document, term.at, self._values_of(term, values))
        return document

    def physics(self, z: Array) -> physics.Physics:
        """The compiled model.

        Raises:
            mjcf.MjcfError: an edit does not compile.
        """
        key = self._own, z.tobytes()
        made = _models.pop(key, None)
        if made is None:
            document = bare(self.document, self.model)
            source = document.source.edited(self._written(document, z).text())
            made = physics.from_model(mjcf.compile(source, trusted=True))
        _models[key] = made  # at the end, so that those go that nobody asked for lately
        while len(_models) > MODEL.kept:
            _models.pop(next(iter(_models)), None)
        return made

    @functools.cached_property
    def _own(self) -> int:
        """A number that no other structure has."""
        return next(_numbers)

    @functools.cached_property
    def worked_out(self) -> dict[type, object]:
        """What others found out about this structure and want to know again, by its type."""
        return {}

    @property
    def warm(self) -> float:
        """How long to simulate before a window, s."""
        return max([self._own_warm, self.warmed, *(term.effect.warm for term in self.terms)])

    @functools.cached_property
    def _own_warm(self) -> float:
        """How long the nominal model needs, s: windings, bristles, lagging sensors, joints behind a gap, ties that give
        way, and activations of muscles and cylinders remember.
        """
        # A tie without a damper never comes to rest: it is run in for as long as a load that swings.
        remembers = max(self.activated, min(EFFECTS.fades * relaxes(self.model), EFFECTS.swing))
        if self._hides:
            return max(remembers, EFFECTS.swing if np.any(self.model.tendon_stiffness > 0) else EFFECTS.settle)
        if self._filters:
            return max(remembers, EFFECTS.slow_current)
        return max(remembers, EFFECTS.warm if self.model.na > 0 or self._lagging else 0.0)

    @property
    def _filters(self) -> bool:
        """Whether a force of the nominal model follows its command by a winding's current or a filter."""
        kind = mujoco.mjtDyn
        filters = np.isin(self.model.actuator_dyntype, [kind.mjDYN_DCMOTOR, kind.mjDYN_FILTER, kind.mjDYN_FILTEREXACT])
        return bool((filters & (self.model.actuator_dynprm[:, 0] > 0)).any())

    @functools.cached_property
    def activated(self) -> float:
        """For how long an activation of the nominal model shows where it was, s; 0 where that is no longer than what a
        winding does.
        """
        slowest = mjcf.slowest_activation(self.model)
        return EFFECTS.fades * slowest if slowest > EFFECTS.short * EFFECTS.warm else 0.0

    @functools.cached_property
    def _hides(self) -> bool:
        """Whether joints hide behind a gap or a coupling; of a load that swings all is known, and of a joint that
        is held in proportion to another.
        """
        return len(self.base) + len(loads(self.model)) + len(mjcf.coupled(self.model)) < self.model.njnt

    @functools.cached_property
    def _lagging(self) -> frozenset[str]:
        """Sensors of the nominal model that lag."""
        return frozenset(extra.at for extra in physics.from_model(self.model).stage("lag"))

    @property
    def moved_sensors(self) -> set[str]:
        """Sensors that an effect, or their own lag or delay in the model, keeps from saying what state it is."""
        late = {self.model.sensor(int(k)).name for k in np.flatnonzero(self.model.sensor_delay > 0)}
        return late | self._lagging | {term.at for term in self.terms if term.effect.moves_readings}

    @property
    def finest(self) -> float:
        """Longest step at which every effect can be simulated, s."""
        return min([self.longest, *(term.effect.finest for term in self.terms)])

    def simulated_as(self, other: Structure) -> Structure:
        """The same in steps as fine as another one's, and simulated as long before a window."""
        return replace(self, longest=min(self.longest, other.finest), warmed=max(self.warmed, other.warm))

    @functools.cached_property
    def own_finest(self) -> float:
        """Longest step that the model's own currents, bristles, rotors, lags, limits and ties bear under explicit
        integration, s.
        """
        model, kind = self.model, mujoco.mjtDyn
        finest = EFFECTS.fast if self._hides or self._lagging else math.inf
        finest = min(finest, MODEL.settles * settles(model))
        for dynamics, numbers in zip(model.actuator_dyntype, model.actuator_dynprm, strict=True):
            if dynamics in (int(kind.mjDYN_DCMOTOR), int(kind.mjDYN_FILTEREXACT)) and numbers[0] > 0:
                finest = min(finest, EFFECTS.fast, numbers[0])
            if dynamics == kind.mjDYN_DCMOTOR and numbers[5] > 0:  # bristles
                finest = min(finest, EFFECTS.fast)
            if dynamics == kind.mjDYN_FILTER and numbers[0] > 0:
                finest = min(finest, numbers[0])
        return max(float(finest), EFFECTS.fastest)


def _unmapped(
    z: float | Array,
    low: float | Array,
    high: float | Array,
    log: bool | NDArray[np.bool_],
    scale: float | Array,
    fine: float | Array,
    origin: float | Array,
) -> Any:
    """Parameters within their bounds of mapped values, one or many; see `Slot`."""
    return np.clip(np.where(log, scale * np.exp(np.minimum(z * fine, MODEL.widest)), origin + scale * z), low, high)


def _fitted(effect: Effect) -> list[Parameter]:
    return [p for p in effect.parameters if not p.fixed]


def _fallback(low: float, high: float) -> float:
    finite = [abs(b) for b in (low, high) if math.isfinite(b) and b]
    return MODEL.fallback * max(finite) if finite else 1.0


def carry(old: Structure, z: Array, new: Structure) -> Array:
    """Mapped parameters of `new` that start where `old` stands, and at the guess where `old` has no such parameter."""
    values, out = old.values(z), new.first.copy()
    for i, slot in enumerate(new.slots):
        if slot.key in values and (slot.may_vanish or values[slot.key] > 0):
            out[i] = slot.mapped(values[slot.key])
    return out


def names(terms: Sequence[Term]) -> list[str]:
    """Keys of terms."""
    return [term.key for term in terms]
