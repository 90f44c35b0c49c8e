"""Friction that remembers where the motion turned round."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real.effects.shared.base import Effect, Evidence, Values
from dipc_gym.sim2real.effects.shared.law import Array, Law, described, either_way
from dipc_gym.sim2real.effects.shared.tables import odd_blocks, spared
from dipc_gym.sim2real.unseen.play import play

WIDTHS = np.geomspace(2e-3, 1.0, 28)  # over which an element is bent, in ranges of the joint's motion
MOST, MOST_ELEMENTS = 6, 12  # elements that forces tell of, and that simulation may
LEAST_SHARE = 1e-3  # share of the force that an element must give


class Hysteresis(Law):
    """Maxwell-slip elements side by side: springs that slip, each at a force and a distance of its own.

    After a reversal the force builds up along a curve, over more distance the softer the elements are. Any such curve
    that bends one way only can be made of them (Iwan 1966). In MJCF an element is a fixed tendon with `springyield`.
    """

    id = "friction.hysteresis"
    place = "joint"
    one_of = "hysteresis"
    of, slide = "distance from rest", "m"
    unit = "N"
    lowest = 0.0
    kind = "friction with memory"
    rivals = ("friction.stribeck", "friction.coulomb", "load.position:law", "load.swinging")

    def table(self, evidence: Evidence) -> tuple[Array, Array] | None:
        """Distances and forces of the elements, chosen one at a time; alternating blocks tell how many."""
        span = float(np.ptp(evidence.position))
        if not span > 0:
            return None
        widths = WIDTHS * span
        bent = -_bent(evidence, widths)
        beside = np.stack([np.ones_like(evidence.force), evidence.velocity, -evidence.direction], axis=1)
        late = odd_blocks(evidence.time)
        if late.all() or not late.any():
            return None
        chosen: list[int] = []
        path: list[tuple[list[int], float]] = []
        while len(chosen) < MOST:
            tries = [sorted([*chosen, k]) for k in range(len(widths)) if k not in chosen]
            chosen = min(tries, key=lambda one: _left(bent[:, one], beside, evidence.force, ~late, ~late))
            path.append((chosen, _left(bent[:, chosen], beside, evidence.force, ~late, late)))
        nothing = _left(bent[:, :0], beside, evidence.force, ~late, late)
        enough = spared(nothing, min(left for _, left in path))
        kept = next(one for one, left in path if left <= enough)
        forces = _weights(bent[:, kept], beside, evidence.force)[: len(kept)]
        strong = forces > LEAST_SHARE * evidence.force_scale
        if not strong.any():
            return None
        return widths[kept][strong], forces[strong]

    def shortened(self, values: Values, told: NDArray[np.bool_]) -> None:
        """None: springs that slip are no table, and each of them acts at any distance."""

    def finer(self, values: Values, told: NDArray[np.bool_] | None = None) -> Sequence[tuple[Effect, Values]]:
        """Elements between those that are there, and on either side of them, that bear nothing yet."""
        old = np.array(self.knots)
        between = np.sqrt(np.append(old[0] / 2, old) * np.append(old, 2 * old[-1]))
        knots = np.sort(np.append(old, between))
        if len(knots) > MOST_ELEMENTS:
            return []
        new = np.isin(knots, between)
        forces = np.zeros(len(knots))
        forces[~new] = self.values(values)
        return [self._begun(knots, forces, new)]

    def edit(self, document: Document, at: str, values: Values) -> None:
        """A tendon for each element."""
        for k, (width, force) in enumerate(zip(self.knots, self.values(values), strict=True)):
            tendon = document.add(
                "tendon",
                "fixed",
                name=document.fresh(f"{at}_slips_{k + 1}"),
                stiffness=(force / width, 0.0, 0.0),
                springlength="0",
                springyield=width,
            )
            document.plain(tendon, limited="auto", range="0 0", frictionloss="0", armature="0", damping="0 0 0")
            document.add(tendon, "joint", joint=at, coef=1)

    def curve(self, values: Values) -> tuple[Array, Array]:
        """Distances from rest, and the force that has built up there."""
        knots, forces = np.array(self.knots), np.array(self.values(values))
        along = np.append(0.0, knots)
        return along, np.minimum(along[:, None] / knots, 1.0) @ forces

    def law_of(self, values: Values, unit: Mapping[str, str]) -> dict[str, Any]:
        """The curve along which the force builds up from rest."""
        along, force = self.curve(values)
        inputs = [{"name": self.of, "unit": self.per(unit), "knots": either_way(along.tolist())}]
        how = (
            "It holds from rest on. Where the motion turns round, the force goes back along the same curve, twice as "
            "large in both directions."
        )
        levels, per = either_way(force.tolist()), unit[self.parameters[0].name]
        return described(self.kind, inputs, levels, per, passive=self.passive, remembers=how)

    def sentence(self, at: str, values: Values, unit: Mapping[str, str]) -> str:
        """In words."""
        along, force = self.curve(values)
        half = float(np.interp(force[-1] / 2, force, along))
        return (
            f"Friction with memory (Maxwell-slip) at {at}: {force[-1]:.3g} {unit[self.parameters[0].name]} that builds "
            f"up from where the motion turned round, half of it within {2 * half:.3g} {self.per(unit)}."
        )


def _bent(evidence: Evidence, widths: Array) -> Array:
    """How far springs that slip are bent, as a share of what they bear, (n, k)."""
    out = np.empty((len(evidence.time), len(widths)))
    for part in evidence.runs:
        q = evidence.position[part]
        out[part] = (q[:, None] - play(q, widths, np.zeros(len(widths)))) / widths
    return out


def _weights(bent: Array, beside: Array, force: Array) -> Array:
    """Forces of elements, never negative, and weights of what goes beside them."""
    both = np.concatenate([bent, beside, -beside], axis=1)
    normal = both.T @ both
    size = float(np.trace(normal)) / len(normal) or 1.0
    root = np.linalg.cholesky(normal + 1e-9 * size * np.eye(len(normal))).T
    found, _ = nnls(root, np.linalg.solve(root.T, both.T @ force))
    k, m = bent.shape[1], beside.shape[1]
    return np.append(found[:k], found[k : k + m] - found[k + m :])


def _left(bent: Array, beside: Array, force: Array, fitted: NDArray[np.bool_], told: NDArray[np.bool_]) -> float:
    """Sum of squares that elements fitted to some samples leave of others."""
    weights = _weights(bent[fitted], beside[fitted], force[fitted])
    return float(np.sum((force[told] - np.concatenate([bent, beside], axis=1)[told] @ weights) ** 2))
