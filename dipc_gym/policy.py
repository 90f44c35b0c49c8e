"""Learned policies: small networks, run by NumPy alone, each in one JSON file that executes nothing."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from dipc_gym.mechanics.motion import POSTURES
from dipc_gym.safety import untrusted
from dipc_gym.safety.files import write_whole
from dipc_gym.safety.untrusted import Format

if TYPE_CHECKING:
    from dipc_gym.dataflow import Program, Value

__all__ = ["ControllerError", "Evaluation", "Policy", "shipped"]

Array = NDArray[np.float64]


class ControllerError(ValueError):
    """A controller that cannot be had; the message names file, part and mend."""


Commands = Literal["force", "voltage"]

SCHEMA = "dipc-gym/policy/1"
UNITS = {"force": "N", "voltage": "V"}
OBSERVATION = (("cart", "m"), ("pole1", "rad"), ("pole2", "rad"))
"""Positions that are observed, with their units; their rates follow in the same order."""
RATES = tuple((f"{name}_rate", f"{unit}/s") for name, unit in OBSERVATION)
INPUTS = (*OBSERVATION, *RATES)
SWING_UP_INPUTS = (
    ("cart", "m"),
    *((f"{name}_{part}", "1") for name in ("pole1", "pole2") for part in ("cosine", "sine")),
    *RATES,
)
KINDS = {len(INPUTS): INPUTS, len(SWING_UP_INPUTS): SWING_UP_INPUTS}
"""What a network may be given, by how many numbers that are: what one environment or the other observes."""
FORMAT = Format("policy file", "train-policy", "copy or train the policy again", 5_000_000, ControllerError)
"""A policy of two layers of 64 takes a tenth of a million bytes."""
PLACES = ("start", "goal")
LATER = ("estimator", *PLACES)
"""Fields that older files lack."""
WIDEST = 1024
DEEPEST = 8
LARGEST = 1e300
"""Of a learned number; sums of larger ones may overflow."""


@dataclass(frozen=True)
class Evaluation:
    """How a policy did, on rigs that it was not chosen on.

    Attributes:
        seconds: length of a run, s.
        seeds: of starting states and noise, one for each run.
        held: time until each run ended, s; of a swing-up, how long it stayed at the goal, or 0 if that was too short.
        reward: median over the runs of their return, in shares of the largest possible.
    """

    seconds: float
    seeds: tuple[int, ...]
    held: tuple[float, ...]
    reward: float

    @property
    def standing(self) -> int:
        """Number of runs that stood to their end."""
        return sum(held >= self.seconds for held in self.held)


@dataclass(frozen=True, eq=False)
class Policy:
    """A network of tanh layers that turns an observation into a command.

    It computes `limit * squash(network(observation / scales))`, its most likely action. `force` is what `compare` asks
    of every controller. A policy that commands voltage has been trained without any compensator, so its force is the
    voltage times the motor's gain, and the compensator `none`, which divides by that gain, gives the voltage back.

    Attributes:
        name: what tables call it; of a file, its stem.
        commands: `"force"`, through a compensator, or `"voltage"`, straight to the motor.
        limit: largest command either way, N or V.
        newtons_per_volt: the motor's gain on the rig that it was trained on, N/V.
        compensator: name of the compensator that it was trained with.
        estimator: name of the one through which it is to see the rig; None is the environment's own observation.
        start: equilibrium that it learned to leave, a name of `motion.POSTURES`; None where it balances.
        goal: equilibrium that it learned to hold, likewise.
        scales: (6,) for `DIPC-Friction-v0`, (8,) for `DIPC-Friction-SwingUp-v0`: what the observation is divided by.
        layers: weights (out, in) and biases (out,), from first to last.
        squash: what follows the last layer: `"clip"` to -1..1, or `"tanh"`.
        algorithm: `"ppo"`, `"sac"` or `"dagger"`.
        seed: of its training.
        steps: control periods that it was trained for.
        evaluation: how it did, if it was tried.

    Raises:
        ValueError: layers do not fit each other, or a number is not what it must be.

    Example:
        >>> layers = ((np.full((1, 6), -0.5), np.zeros(1)),)
        >>> policy = Policy(layers=layers, commands="force", limit=40.0, compensator="llnf")
        >>> policy.force(np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0])).__round__(6)
        -2.0
    """

    layers: tuple[tuple[Array, Array], ...]
    commands: Commands
    limit: float
    compensator: str
    newtons_per_volt: float = 1.0
    scales: Array = field(default_factory=lambda: np.ones(6))
    squash: Literal["clip", "tanh"] = "clip"
    algorithm: str = "ppo"
    seed: int = 0
    steps: int = 0
    evaluation: Evaluation | None = None
    estimator: str | None = None
    start: str | None = None
    goal: str | None = None
    name: str = "policy"

    def __post_init__(self) -> None:
        if self.commands not in UNITS:
            raise ValueError(f"commands is {self.commands!r}; it can be 'force' or 'voltage'")
        if self.commands == "voltage" and self.compensator != "none":
            raise ValueError(f"a policy that commands voltage has the compensator 'none', not {self.compensator!r}")
        for place in PLACES:
            if getattr(self, place) not in (None, *POSTURES):
                raise ValueError(f"{place} is {getattr(self, place)!r}; it can be {', '.join(POSTURES)}")
        if self.squash not in ("clip", "tanh"):
            raise ValueError(f"squash is {self.squash!r}; it can be 'clip' or 'tanh'")
        for name in ("limit", "newtons_per_volt"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name} is {value}; it must be a finite number above zero")
        size = len(self.scales)
        if self.scales.ndim != 1 or size not in KINDS or not (np.isfinite(self.scales) & (self.scales > 0)).all():
            raise ValueError("scales must be six finite numbers above zero, or eight for a policy that swings up")
        for i, (weights, biases) in enumerate(self.layers):
            if weights.ndim != 2 or weights.shape[1] != size or biases.shape != weights.shape[:1]:
                raise ValueError(
                    f"layer {i} has weights {weights.shape} and biases {biases.shape}, and gets {size} inputs"
                )
            if not all((np.abs(numbers) < LARGEST).all() for numbers in (weights, biases)):
                raise ValueError(f"layer {i} has numbers that are not finite, or beyond {LARGEST:g}")
            size = len(biases)
        if not self.layers or size != 1:
            raise ValueError(f"the last layer must give one number, the command; this one gives {size}")

    @property
    def swings_up(self) -> bool:
        """Whether it is of `DIPC-Friction-SwingUp-v0`."""
        return len(self.scales) == len(SWING_UP_INPUTS)

    @property
    def parameters(self) -> int:
        """Number of learned numbers."""
        return sum(weights.size + biases.size for weights, biases in self.layers)

    def command(self, observations: Array) -> Array:
        """The commands (...) for observations (..., k) of its environment, N or V as `commands` says."""
        x = observations / self.scales
        for weights, biases in self.layers[:-1]:
            x = np.tanh(x @ weights.T + biases)
        weights, biases = self.layers[-1]
        out = (x @ weights.T + biases)[..., 0]
        return self.limit * (np.tanh(out) if self.squash == "tanh" else np.clip(out, -1.0, 1.0))

    def force(self, observation: Array) -> float:
        """The command for an observation (k,) as a force, N; a voltage counts as what it exerts on the blocked cart."""
        command = float(self.command(observation))
        return command if self.commands == "force" else command * self.newtons_per_volt

    def express(self, program: Program, observation: Value) -> Value:
        """The force, written into a program that can be exported."""
        x = observation / program.constant(self.scales)
        for weights, biases in self.layers[:-1]:
            x = x.affine(weights, biases).tanh()
        out = x.affine(*self.layers[-1])
        command = self.limit * (out.tanh() if self.squash == "tanh" else out.clip(-1.0, 1.0))
        return command if self.commands == "force" else command * self.newtons_per_volt

    def require(self, compensator: str) -> None:
        """Refuse another compensator than the policy's own.

        Args:
            compensator: name of the one that is to stand behind it.

        Raises:
            ControllerError: it is another; the message says which one the policy was trained with.
        """
        if compensator != self.compensator:
            own = (
                "directly on the voltage"
                if self.commands == "voltage"
                else f"with the compensator {self.compensator!r}"
            )
            raise ControllerError(
                f"policy {self.name!r} was trained {own} and is to run with {compensator!r}; "
                f"say --compensator {self.compensator}, or train one with {compensator!r}"
            )

    def require_estimator(self, estimator: str | None) -> None:
        """Refuse to see through another estimator than the policy's own, if it has one.

        Args:
            estimator: name of the one that is to stand before it; None is the environment's own observation.

        Raises:
            ControllerError: it is another; the message says which one the policy was trained with.
        """
        if self.estimator is not None and estimator != self.estimator:
            sees = "the environment's own observation" if estimator is None else repr(estimator)
            raise ControllerError(
                f"policy {self.name!r} was trained to see through {self.estimator!r} and is to see through {sees}; "
                f"say --estimator {self.estimator}"
            )

    def summary(self) -> str:
        """What it is and how it did, in a line."""
        what = f"{self.commands} through {self.compensator}" if self.commands == "force" else "voltage"
        seen = "" if self.estimator is None else f", seen through {self.estimator}"
        text = (
            f"{self.algorithm}, {what}{seen}, {self.parameters:,} numbers, chosen after {self.steps:,} control periods"
        )
        if (tried := self.evaluation) is None:
            return text
        did = "swung up and held" if self.swings_up else "stood"
        return (
            f"{text}; {did} for {tried.seconds:g} s in {tried.standing} of {len(tried.held)} runs, "
            f"{tried.reward:.3f} of the largest return"
        )

    # ------------------------------------------------------------------------------------------------- files

    def save(self, path: str | Path) -> None:
        """Write the policy to a JSON file, which appears whole or not at all.

        Raises:
            OSError: it cannot be written.
        """
        entries = ",\n".join(f"{json.dumps(k)}: {json.dumps(v, allow_nan=False)}" for k, v in self.to_dict().items())
        write_whole(path, f"{{\n{entries}\n}}\n".encode())

    @classmethod
    def load(cls, path: str | Path) -> Policy:
        """Read a policy; nothing in the file is executed, and everything is checked.

        Raises:
            ControllerError: the file cannot be read, or a field is missing, unknown, or not what it must be. The
                message names file, field and mend.
        """
        path = Path(path)
        return _Reader(FORMAT, str(path)).policy(FORMAT.read(path), path.stem)

    def to_dict(self) -> dict[str, Any]:
        """What the file holds."""
        return {
            "schema": SCHEMA,
            "algorithm": self.algorithm,
            "seed": self.seed,
            "steps": self.steps,
            "compensator": self.compensator,
            "estimator": self.estimator,
            "start": self.start,
            "goal": self.goal,
            "commands": {"name": self.commands, "unit": UNITS[self.commands], "limit": self.limit},
            "newtons_per_volt": self.newtons_per_volt,
            "observation": [
                {"name": name, "unit": unit, "scale": scale}
                for (name, unit), scale in zip(KINDS[len(self.scales)], self.scales.tolist(), strict=True)
            ],
            "evaluation": None
            if self.evaluation is None
            else {
                "seconds": self.evaluation.seconds,
                "seeds": list(self.evaluation.seeds),
                "held": list(self.evaluation.held),
                "reward": self.evaluation.reward,
            },
            "activation": "tanh",
            "squash": self.squash,
            "layers": [{"weights": w.tolist(), "biases": b.tolist()} for w, b in self.layers],
        }


def shipped(name: str) -> Policy:
    """A policy that comes with the package, by its file's stem.

    Raises:
        ControllerError: there is none of that name.

    Example:
        >>> shipped("ppo-llnf").compensator
        'llnf'
    """
    folder = Path(__file__).parent / "policies"
    names = sorted(path.stem for path in folder.glob("*.json"))
    if name not in names:
        raise ControllerError(f"no policy {name!r} comes with the package; there are {', '.join(names)}")
    return Policy.load(folder / f"{name}.json")


class _Reader(untrusted.Reader):
    """Takes a policy from untrusted data."""

    def policy(self, data: Any, name: str) -> Policy:
        fields = "algorithm seed steps compensator commands newtons_per_volt observation evaluation activation squash"
        if isinstance(data, dict):
            data = dict.fromkeys(LATER) | data  # files may be older
        self.document(data, SCHEMA, [*fields.split(), "layers", *LATER])
        commands = self.members(data["commands"], ("name", "unit", "limit"), "commands")
        what = self.one_of(commands["name"], tuple(UNITS), "commands.name")
        self.one_of(commands["unit"], (UNITS[what],), "commands.unit")
        self.one_of(data["activation"], ("tanh",), "activation")
        values: dict[str, Any] = {
            "layers": self.layers(data["layers"], data["observation"]),
            "commands": what,
            "limit": self.positive(commands["limit"], "commands.limit"),
            "newtons_per_volt": self.positive(data["newtons_per_volt"], "newtons_per_volt"),
            "compensator": self.text(data["compensator"], "compensator"),
            "estimator": None if data["estimator"] is None else self.text(data["estimator"], "estimator"),
            **{key: None if data[key] is None else self.one_of(data[key], tuple(POSTURES), key) for key in PLACES},
            "scales": self.scales(data["observation"]),
            "squash": self.one_of(data["squash"], ("clip", "tanh"), "squash"),
            "algorithm": self.one_of(data["algorithm"], ("ppo", "sac", "dagger"), "algorithm"),
            "seed": self.count(data["seed"], "seed"),
            "steps": self.count(data["steps"], "steps"),
            "evaluation": self.evaluation(data["evaluation"]),
        }
        try:
            return Policy(**values, name=name)
        except ValueError as error:
            raise ControllerError(f"{self.source}: {error}; {self.format.mend}") from None

    def inputs(self, entries: Any) -> tuple[tuple[str, str], ...]:
        known = SWING_UP_INPUTS if isinstance(entries, list) and len(entries) == len(SWING_UP_INPUTS) else INPUTS
        self.entries(entries, "observation", len(known))
        return known

    def scales(self, entries: Any) -> Array:
        scales = []
        for i, (entry, (name, unit)) in enumerate(zip(entries, self.inputs(entries), strict=True)):
            where = f"observation[{i}]"
            self.members(entry, ("name", "unit", "scale"), where)
            self.one_of(entry["name"], (name,), f"{where}.name")
            self.one_of(entry["unit"], (unit,), f"{where}.unit")
            scales.append(self.positive(entry["scale"], f"{where}.scale"))
        return np.array(scales)

    def layers(self, entries: Any, inputs: Any) -> tuple[tuple[Array, Array], ...]:
        size, layers = len(self.inputs(inputs)), []
        if len(self.entries(entries, "layers")) > DEEPEST:
            self.fail("layers", f"has {len(entries)} layers; at most {DEEPEST} are read")
        for i, entry in enumerate(entries):
            where = f"layers[{i}]"
            self.members(entry, ("weights", "biases"), where)
            biases = self.numbers(entry["biases"], f"{where}.biases")
            if len(biases) > WIDEST:
                self.fail(f"{where}.biases", f"has {len(biases)} entries; at most {WIDEST} are read")
            rows = self.entries(entry["weights"], f"{where}.weights", len(biases))
            weights = np.stack([self.numbers(row, f"{where}.weights[{k}]", size) for k, row in enumerate(rows)])
            layers.append((weights, biases))
            size = len(biases)
        return tuple(layers)

    def evaluation(self, entry: Any) -> Evaluation | None:
        if entry is None:
            return None
        self.members(entry, ("seconds", "seeds", "held", "reward"), "evaluation")
        seeds = self.entries(entry["seeds"], "evaluation.seeds")
        return Evaluation(
            seconds=self.positive(entry["seconds"], "evaluation.seconds"),
            seeds=tuple(self.count(seed, f"evaluation.seeds[{i}]") for i, seed in enumerate(seeds)),
            held=tuple(self.numbers(entry["held"], "evaluation.held", len(seeds)).tolist()),
            reward=self.number(entry["reward"], "evaluation.reward"),
        )

    def numbers(self, value: Any, where: str, length: int | None = None) -> Array:
        return np.array([self.number(v, f"{where}[{i}]") for i, v in enumerate(self.entries(value, where, length))])
