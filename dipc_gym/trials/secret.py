"""One trial's secret: what is hidden in a rig, its recordings, and the answer that the scorer will open."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dipc_gym.trials import rigs, shapes
from dipc_gym.trials.catalogue import effects, unknowns
from dipc_gym.trials.entries import index
from dipc_gym.trials.hidden import RIVALS, SETS, Effect, Hidden, draw
from dipc_gym.trials.prediction import ONES, WINDOW, Recording, Windows, fit, predict, record, rms, standard_parameters
from dipc_gym.trials.rigs import SAMPLE_TIME, SAMPLES, Array, Rig, excitation

LEVELS = ("friction.coulomb", "friction.stribeck", "friction.asymmetric", "friction.position", "friction.resting")
USUAL = ("friction.coulomb", "drag.quadratic", "load.constant")
"""What is hidden beside a law; viscous friction is a parameter that models have already."""
WITHIN = (
    ("friction.speed", ("friction.coulomb", "drag.quadratic")),
    ("friction", ("friction.coulomb",)),
    ("dry friction", ("friction.coulomb",)),
    ("hysteresis", ("friction.coulomb",)),
    ("drag", ("drag.quadratic",)),
    ("load", ("load.constant",)),
    ("spring", ("load.constant",)),
    ("torque", ("load.constant",)),
)
"""How the kind of a law begins, and which of these it may hold in itself."""
SAME = 0.1
"""Two models are the same on a rig when their predictions differ by less than this many noise standard deviations
(and by less than this share of the effect, where the effect itself is smaller than the noise)."""
FAINTEST = 0.3
"""An effect that changes no prediction by this many noise standard deviations is drawn again."""


@dataclass(frozen=True)
class Plan:
    """What a trial is to be.

    Attributes:
        number: counted from 1.
        kind: `null`, `single`, `pair`, `unknown` or `wrong`.
        rig: its name.
        effect: id for a single, else empty.
        tuned: refit the nominal model's damping and motor constant to the training recordings beforehand.
        laws: of the trial of laws; what is hidden has a shape of its own.
        beside: of these, whether an effect with a name is hidden as well that most machines have.
    """

    number: int
    kind: str
    rig: str
    effect: str
    tuned: bool
    laws: bool = False
    beside: bool = False

    @property
    def name(self) -> str:
        """Folder name; it says no more than the rig."""
        return f"t{self.number:03d}_{self.rig}"


@dataclass
class Secret:
    """A rig with its secret, and its recordings."""

    rig: Rig
    hidden: list[Hidden]
    nominal: Array
    known_friction: bool
    tuned: bool
    wrong: list[dict[str, float | str]]
    recordings: list[Recording]
    once: bool

    @classmethod
    def drawn(cls, plan: Plan, rng: np.random.Generator) -> Secret:
        """Draw rig, effects, commands and noise; simulate."""
        rig = rigs.RIGS[plan.rig](rng)
        while plan.effect and plan.effect not in {e.name for e in (shapes.named if plan.laws else effects)(rig)}:
            # A torque motor has no winding: draw the other kind.
            rig = rigs.RIGS[plan.rig](rng)
        # Some simulators know of dry friction already; not where the secret is a level of its own.
        known = bool(rng.random() < 0.15) and plan.rig in ("cart", "motor_axis", "pendulum")
        known = known and plan.effect not in LEVELS and not plan.laws
        if known:
            parameters = rig.parameters.copy()
            parameters[index("coulomb", 0)] = rig.force[0] * np.exp(rng.uniform(np.log(0.05), np.log(0.25)))
            rig = rigs.with_parameters(rig, parameters)
        hidden = _choose(plan, rig, rng, known)
        if plan.beside:
            hidden.append(_usual(rig, hidden[0], rng))
        once = any(h.effect.name == "disturbance.pulse" for h in hidden) and bool(rng.random() < 0.5)
        true = rig.parameters
        for one in hidden:
            true = one.apply(true)
        recordings = []
        kinds = (
            ["chirp", "noise", "steps"]
            if rng.random() < 0.7
            else list(rng.permutation(["chirp", "noise", "steps", "sines"])[:3])
        )
        for number, kind in enumerate(kinds):
            gain = _wander(rng) if any("wanders" in h.effect.kind for h in hidden) else ONES
            parameters = true.copy()
            if once and number != 0:
                parameters[[index("pulse_size", j) for j in range(rig.count)]] = 0.0
            recordings.append(record(rig, parameters, excitation(rig, str(kind), rng), gain, rng))
        nominal = rig.parameters
        wrong: list[dict[str, float | str]] = []
        if plan.kind == "wrong":
            nominal, wrong = _perturb(rig, rng)
        trial = cls(rig, hidden, nominal, known, False, wrong, recordings, once)
        if plan.tuned and trial.sound():
            trial._tune()
        return trial

    def _tune(self) -> None:
        """Refit the simulator to the recordings, as its owner would, unless nothing would be left to find."""
        rig, train = self.rig, self.recordings[:2]
        windows = [Windows(rig, r, rig.parameters) for r in train]
        own = [
            n for n in standard_parameters(rig, rig.parameters) if n.name.split(".")[0] in ("damping", "motor_constant")
        ]
        nominal = fit(windows, [r.measured for r in train], rig.parameters, [], [], effort=8, own=own).parameters
        left = [w.residual(predict(rig, nominal, r), r.reading) for w, r in zip(windows, train, strict=True)]
        if rms(np.concatenate(left)) > FAINTEST:
            self.nominal, self.tuned = nominal, True

    def sound(self) -> bool:
        """Whether the rig stayed on its rail and upright."""
        for recording in self.recordings:
            if not np.all(np.isfinite(recording.q)):
                return False
            travel = np.abs(recording.q - np.asarray(self.rig.start)).max(axis=0)
            if self.rig.linear and travel[0] > 0.6:
                return False
            if self.rig.name == "upright" and travel[1:].max() > 0.35:
                return False
        return True

    @property
    def shown(self) -> int:
        """How many recordings, from the first on, effects may be fitted to; a knock struck the first one only."""
        return 1 if self.once else 2

    def worth_keeping(self) -> bool:
        """Whether the rig behaved and the secret shows at all."""
        if not self.sound():
            return False
        if not self.hidden and not self.wrong:
            return True
        moved = 0.0
        for recording in self.recordings[:2]:
            windows = Windows(self.rig, recording, self.rig.parameters)
            # A tuned or a wrong simulator says nothing about the effect itself: compare with the rig's parameters.
            base = self.nominal if self.wrong else self.rig.parameters
            moved = max(moved, rms(windows.residual(predict(self.rig, base, recording), recording.reading)))
        return moved > FAINTEST

    def answer(self, plan: Plan) -> dict[str, object]:
        """Everything the scorer needs."""
        rig, train, test = self.rig, self.recordings[:2], self.recordings[2]
        windows = [Windows(rig, r, rig.parameters) for r in self.recordings]
        references = [r.reading for r in train]
        refit = fit(windows[:2], references, self.nominal, [], [])

        def moved(parameters: Array, which: int) -> float:
            recording = self.recordings[which]
            return rms(windows[which].residual(predict(rig, parameters, recording), recording.reading))

        def error(parameters: Array, *, truth: bool = False) -> float:
            gain = test.gain if truth else ONES
            prediction = predict(rig, parameters, test, gain=gain, true_initial=truth)
            return rms(windows[2].residual(prediction, test.measured))

        # A knock that struck one training recording is to be found there; the held-out one has none.
        judged = 0 if self.once else 2
        share = moved(refit.parameters, judged)
        from_nominal = moved(self.nominal, judged)
        limit = SAME * min(1.0, from_nominal)
        shown = windows[: self.shown], references[: self.shown]
        equal = {
            f"{h.effect.name}@{h.effect.at}": self._equivalents(
                h, windows[: self.shown], references[: self.shown], refit.error
            )
            for h in self.hidden
        }
        return {
            "rig": rig.name,
            "kind": plan.kind,
            "tuned": self.tuned,
            "known_friction": self.known_friction,
            "missing": [
                {
                    "effect": h.effect.name,
                    "at": h.effect.at,
                    "also_at": list(h.effect.also_at),
                    "kind": h.effect.kind,
                    "alike": list(h.effect.alike),
                }
                for h in self.hidden
            ],
            "all_of": len(self.hidden) > 1,
            "beside": plan.beside,
            "wrong": self.wrong,
            "includes": sorted({name for h in self.hidden for name in h.effect.includes}),
            "parameters": {f"{h.effect.name}@{h.effect.at}": h.parameters() for h in self.hidden},
            "equivalents": equal,
            "equivalent_sets": {
                f"{h.effect.name}@{h.effect.at}": self._equivalent_sets(h, *shown, refit.error) for h in self.hidden
            },
            "recalibrated_suffices": bool(self.hidden) and share <= limit,
            "share_of_signal": share,
            "share_of_each": self._shares(windows, references, judged),
            "moved_from_nominal": from_nominal,
            "signal": self._signal(windows[judged]),
            "drive": {
                "gear": rig.gear,
                "rotor": rig.rotor,
                **{name: float(rig.parameters[index(name)]) for name in ("kt", "resistance")},
            },
            "held_out_predictable": not self.once and (plan.kind != "unknown" or plan.laws),
            "test_error": {
                "nominal": error(self.nominal),
                "recalibrated": error(refit.parameters),
                "truth": error(test.parameters, truth=True),
            },
            "noise": dict(zip(rig.joints, rig.noise.tolist(), strict=True)),
            "window": WINDOW * SAMPLE_TIME,
        }

    def _signal(self, windows: Windows) -> float:
        """What the command does within a window, in noise units: recorded motion less the free motion of the rig."""
        recording = windows.recording
        free = predict(self.rig, self.rig.parameters, replace(recording, command=np.zeros(SAMPLES)))
        return rms(windows.residual(free, recording.reading))

    def _shares(self, windows: Sequence[Windows], references: Sequence[Array], judged: int) -> dict[str, float]:
        """For several effects: what the judged prediction loses when one is taken out and all else refitted."""
        shares: dict[str, float] = {}
        if len(self.hidden) < 2:
            return shares
        for out in self.hidden:
            others = [h for h in self.hidden if h is not out]
            start = [value for h in others for value in h.values]
            found = fit(
                windows[: self.shown],
                references[: self.shown],
                self.rig.parameters,
                [h.effect for h in others],
                start,
                effort=6,
            )
            recording = self.recordings[judged]
            difference = windows[judged].residual(predict(self.rig, found.parameters, recording), recording.reading)
            shares[f"{out.effect.name}@{out.effect.at}"] = rms(difference)
        return shares

    def _equivalents(
        self, hidden: Hidden, windows: Sequence[Windows], references: Sequence[Array], recalibrated: float
    ) -> list[dict[str, str]]:  # fmt: skip
        """Other names that explain the noise-free training readings as well as the truth does."""
        others = [h for h in self.hidden if h is not hidden]
        base = self.rig.parameters
        without = rms(
            np.concatenate(
                [w.residual(predict(self.rig, base, w.recording), r) for w, r in zip(windows, references, strict=True)]
            )
        )
        # Where a refit explains everything, any name would do beside it: then names compete without a refit.
        refit = recalibrated > SAME * min(1.0, without)
        own = None if refit else ()
        scale = recalibrated if refit else without
        limit = SAME * min(1.0, scale)
        kept = [value for h in others for value in h.values]
        places = (hidden.effect.at, *hidden.effect.also_at)
        found = [{"effect": name, "at": at} for name in hidden.effect.alike for at in places]
        # What an unknown includes may be all of it that shows: friction that grows at rest, on a rig that never rests.
        names = (*RIVALS.get(hidden.effect.name, ()), *hidden.effect.includes)
        for rival in effects(self.rig):
            entry = {"effect": rival.name, "at": rival.at}
            itself = (rival.name, rival.at) == (hidden.effect.name, hidden.effect.at)
            # Bristles are the same name as the curve without them, and a hundred times slower to fit.
            if rival.name not in names or itself or entry in found or rival.kind == "bristle":
                continue
            together = [*(h.effect for h in others), rival]
            best = np.inf
            for start in _starts(rival, hidden):
                place = [*kept, *start]
                trying = fit(windows, references, base, together, place, effort=3, own=own)
                if limit < trying.error < 0.7 * scale and not trying.converged:
                    trying = fit(windows, references, base, together, place, effort=6, own=own, onward=trying)
                best = min(best, trying.error)
                if best <= limit:
                    found.append(entry)
                    break
                if best > 0.7 * scale:
                    # Nowhere near: the other starts differ in size only.
                    break
        return found

    def _equivalent_sets(
        self, hidden: Hidden, windows: Sequence[Windows], references: Sequence[Array], recalibrated: float
    ) -> list[list[dict[str, str]]]:
        """Several effects that together explain the noise-free training readings as well as the truth does."""
        found = []
        others = [h for h in self.hidden if h is not hidden]
        kept = [value for h in others for value in h.values]
        limit = SAME * min(1.0, recalibrated)
        for names in SETS.get(hidden.effect.name, ()):
            for rivals in itertools.product(*(self._places_of(name, hidden) for name in names)):
                start = [value for rival in rivals for value in _starts(rival, hidden)[0]]
                together = [*(h.effect for h in others), *rivals]
                trying = fit(windows, references, self.rig.parameters, together, [*kept, *start], effort=4)
                if limit < trying.error < 0.3 * recalibrated and not trying.converged:
                    trying = fit(windows, references, self.rig.parameters, together, [*kept, *start], onward=trying)
                if trying.error <= limit:
                    found.append([{"effect": rival.name, "at": rival.at} for rival in rivals])
        return found

    def _places_of(self, name: str, hidden: Hidden) -> list[Effect]:
        """An effect where it could stand in for a part of a hidden one: there, at the drive, or at any sensor."""
        near = {hidden.effect.at, self.rig.joints[0], "world"}
        everywhere = name.startswith("sensor.")
        if name.startswith("friction."):
            near = {hidden.effect.at}
        return [e for e in effects(self.rig) if e.name == name and (everywhere or e.at in near)]


def _starts(rival: Effect, hidden: Hidden) -> list[list[float]]:
    """A few places to start a rival's fit from; parameters of the same name and unit start from the truth.

    A single parameter is found from anywhere, save in the transmission, where contacts hide it.
    """
    known = {(n.name, n.unit): v for n, v in zip(hidden.effect.parameters, hidden.values, strict=True)}

    def middle(position: float) -> list[float]:
        values = []
        for parameter in rival.parameters:
            if (parameter.name, parameter.unit) in known:
                values.append(known[parameter.name, parameter.unit])
            elif parameter.kind == "uniform":
                values.append(0.5 * (parameter.low + parameter.high))
            else:
                values.append(float(parameter.low ** (1 - position) * parameter.high**position))
        return values

    single = len(rival.parameters) == 1 and not rival.name.startswith("transmission.")
    if single or known.keys() >= {(n.name, n.unit) for n in rival.parameters}:
        return [middle(0.5)]
    return [middle(0.5), middle(0.85), middle(0.2)]


def _choose(plan: Plan, rig: Rig, rng: np.random.Generator, known: bool) -> list[Hidden]:
    """Draw the effects of a trial."""
    if plan.kind in ("null", "wrong"):
        return []
    if plan.kind == "unknown":
        candidates = shapes.nameless(rig) if plan.laws else unknowns(rig)
        picked = draw(candidates[rng.integers(len(candidates))], rng)
        return [_without_level(picked) if known or rng.random() < 0.5 else picked]
    catalogue = shapes.named(rig) if plan.laws else effects(rig)
    if known:
        catalogue = [e for e in catalogue if e.name not in LEVELS]
    if plan.kind == "single":
        choices = [e for e in catalogue if e.name == plan.effect]
        driven = [e for e in choices if e.at in (rig.joints[0], "motor", "world")]
        if driven and rng.random() < 0.6:
            choices = driven
        return [draw(choices[rng.integers(len(choices))], rng)]
    # A pair: two different families, neither of them a mere parameter of the model.
    strong = [
        e for e in catalogue if e.name not in ("friction.viscous", "inertia.mass", "motor.back_emf", "sensor.gain")
    ]
    while True:
        first, second = (strong[i] for i in rng.integers(len(strong), size=2))
        family, other = first.name.split(".")[0], second.name.split(".")[0]
        together = {first.name, second.name}
        merges = any(together == set(names) for sets in SETS.values() for names in sets)
        if family != other and second.name not in RIVALS.get(first.name, ()) and not merges:
            return [draw(first, rng), draw(second, rng)]


def _usual(rig: Rig, law: Hidden, rng: np.random.Generator) -> Hidden:
    """An effect that most machines have, at the driven joint, from the upper half of its range; none that a law of this
    kind has in it already.
    """
    within = next((names for begins, names in WITHIN if (law.effect.kind or law.effect.name).startswith(begins)), ())
    usual = [e for e in effects(rig) if e.name in USUAL and e.name not in within and e.at == rig.joints[0]]
    picked = usual[rng.integers(len(usual))]
    upper = tuple(replace(p, low=math.sqrt(p.low * p.high)) for p in picked.parameters)
    return draw(replace(picked, parameters=upper), rng)


def _without_level(hidden: Hidden) -> Hidden:
    """The same unknown without dry friction under it (left in where it could not act without)."""
    parameters = hidden.effect.parameters
    if not parameters or parameters[-1].name != "level" or "rest" in hidden.effect.kind:
        return hidden
    return Hidden(replace(hidden.effect, parameters=parameters[:-1], includes=()), hidden.values[:-1])


def _wander(rng: np.random.Generator) -> Array:
    """A gain that drifts at random about one, with a correlation time of some seconds."""
    from scipy.signal import lfilter

    keep = np.exp(-SAMPLE_TIME / rng.uniform(1.0, 4.0))
    raw = lfilter([np.sqrt(1 - keep**2)], [1, -keep], rng.standard_normal(3 * SAMPLES))[-SAMPLES:]
    return np.asarray(1 + np.exp(rng.uniform(np.log(0.01), np.log(0.12))) * raw)


def _perturb(rig: Rig, rng: np.random.Generator) -> tuple[Array, list[dict[str, float | str]]]:
    """A simulator with the right structure and one or two wrong parameters."""
    nominal = rig.parameters.copy()
    at = rig.joints[0]
    places: dict[str, tuple[str, list[int]]] = {
        "damping": (at, [index("damping", 0)]),
        "motorconst": ("motor", [index("kt"), index("ke")]),
        "mass": (at, [index("m0")]),
    }
    if rig.voltage_driven:
        places["resistance"] = ("motor", [index("resistance")])
    if rig.name == "pendulum":
        # The pendulum's mass stands in its inertia and in its weight.
        places["mass"] = (at, [index("m0"), index("m1"), index("mgl")])
    wrong: list[dict[str, float | str]] = []
    for name in rng.permutation(sorted(places))[: rng.integers(1, 3)]:
        where, entries = places[str(name)]
        factor = float(np.exp(rng.choice([-1, 1]) * np.exp(rng.uniform(np.log(0.03), np.log(0.4)))))
        true = float(nominal[entries[0]])
        nominal[entries] *= factor
        if rig.name == "motor_axis" and str(name) == "mass":
            nominal[index("m0")] = rig.rotor + (true - rig.rotor) * factor
        label = "gear" if name == "motorconst" and not rig.voltage_driven else str(name)
        wrong.append({"parameter": label, "at": where, "factor": factor})
    return nominal, wrong
