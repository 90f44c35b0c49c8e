"""Judge a finished search: how sure each parameter is, what could stand in an effect's place, and the verdict."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial, reduce

import mujoco
import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from dipc_gym.sim2real.effects.base import acts_on
from dipc_gym.sim2real.estimation.fit import Fit, evaluate, weights
from dipc_gym.sim2real.estimation.problem import Problem
from dipc_gym.sim2real.estimation.unexplained import Scene
from dipc_gym.sim2real.model.structure import Structure, Term, names
from dipc_gym.sim2real.result import Located
from dipc_gym.sim2real.selection.score import Improvement
from dipc_gym.sim2real.selection.scorer import compare_on
from dipc_gym.sim2real.selection.screen import Tried, excludes
from dipc_gym.sim2real.selection.search import Searched
from dipc_gym.sim2real.selection.settings import SCORE
from dipc_gym.sim2real.selection.support import supported
from dipc_gym.sim2real.verdict.settings import VERDICT

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Rival:
    """Another effect in the place of one that was chosen.

    Attributes:
        term: what was tried instead.
        fitted: the structure with it; to a subset of the windows only, where that was enough to rule it out.
        same: whether it is the same model here: at the noise, and no window tells the two apart.
        ruled_out: whether it predicts clearly worse.
        better: whether it predicts clearly better.
    """

    term: Term
    fitted: Fit
    same: bool
    ruled_out: bool
    better: bool = False


def intervals(fitted: Fit, problem: Problem) -> Array:
    """Half widths of 90 % intervals of the mapped parameters, (p,), from blocks of a second, whatever is left over.

    The delete-one jackknife over blocks: correlation within a block is allowed for, a wrong model is not. Where few
    blocks carry most of what is known of a parameter, it is wider than the sandwich estimator, which is then too narrow
    (MacKinnon and White 1985). On the windows' quadratics it costs no simulation. Infinite where there are too few
    blocks, or where no reading depends on a parameter.
    """
    return _jackknife(fitted, problem, problem.blocks)


def between_regimes(fitted: Fit, problem: Problem) -> Array:
    """The same from windows that begin at alike places, or speeds, instead of seconds; the widest of these.

    What a model leaves out acts here and not there, and parameters make up for it: without the fast windows they are
    others. No resampling of seconds shows that, for each second has some of both.
    """
    joints = problem.initial.shape[1] // 2
    wide = np.zeros(len(fitted.z))
    for feature in np.append(problem.initial[:, :joints], np.abs(problem.initial[:, joints:]), axis=1).T:
        regime = np.argsort(np.argsort(feature, kind="stable")) * VERDICT.regimes // len(feature)
        wide = np.maximum(wide, _jackknife(fitted, problem, regime))
    return wide


def _jackknife(fitted: Fit, problem: Problem, blocks: NDArray[np.intp]) -> Array:
    """Half widths of 90 % intervals, (p,), from fits that each leave out the windows of one block."""
    q, counts = fitted.quadratics, problem.counts
    if not len(fitted.z):
        return np.zeros(0)
    w = weights(fitted.mse) / counts
    _, block = np.unique(blocks, return_inverse=True)
    count, p = int(block.max()) + 1, len(fitted.z)
    if count < SCORE.fewest_blocks:
        return np.full(p, np.inf)
    curvature, slope = np.zeros((count, p, p)), np.zeros((count, p))
    np.add.at(curvature, block, w[:, None, None] * q.A)
    np.add.at(slope, block, w[:, None] * q.b)
    without = fitted.structure.prior.in_covariance(curvature.sum(axis=0) - curvature, w)
    inverse = np.linalg.pinv(without, hermitian=True)
    moved = np.einsum("bij,bj->bi", inverse, slope)
    half = stdtrit(count - 1, VERDICT.sure) * np.sqrt((count - 1) / count * np.sum(moved**2, axis=0))
    # Else doubling a parameter would change less than the noise of one reading.
    told = np.einsum("nii->i", q.A) > VERDICT.told
    return np.where(told, half, np.inf)


def share(search: Searched, full: Fit, key: str) -> float:
    """How much of the improvement over the recalibrated model is lost without one effect, all else refitted."""
    if len(full.structure.terms) == 1:
        return 1.0
    best, worst = search.scorer.comparison_error(full), search.scorer.comparison_error(search.progress.path[0])
    without = search.scorer.comparison_error(search.fitter.roughly_without(full, key))
    return float(np.clip((without - best) / max(worst - best, 1e-9), 0.0, 1.0))


def rivals(search: Searched, full: Fit, term: Term) -> list[Rival]:
    """Try other effects in the place of one.

    Those that came close in its round, those it is mistaken for, a single effect that stands for it and another one,
    and two that stand for it alone.
    """
    search.tell(f"what could stand in for {term.key}?")
    error = search.scorer.comparison_error(full)
    found: list[Rival] = []
    search.fitter.remember(full)
    asked = list(_stand_ins(search, full, term, provisional=error > SCORE.at_floor))
    tasks = [partial(_swapped, search, full, structure, before) for _, structure, before in asked]
    with search.fitter.side_by_side(tasks, [full]) as result:
        for k, (others, structure, before) in enumerate(asked):
            known = before.fitted if before else search.fitter.remembered(structure)
            swapped, compared = result(k) if known is None else (known, None)
            if swapped is None:
                continue
            if known is None and compared is None:
                if len(others) == 1:
                    found.append(Rival(others[0], swapped, same=False, ruled_out=True))
                continue
            if compared is not None:
                search.scorer.know(swapped, compared)
            search.fitter.remember(swapped)
            difference = search.scorer.compare(full, swapped)
            reached = search.scorer.comparison_error(swapped)
            close = difference.alike and difference.gain < VERDICT.told_apart * SCORE.worth
            same = close and difference.gain < SCORE.worth and reached < max(SCORE.at_floor, VERDICT.same * error)
            better = len(others) == 1 and _better(search, swapped, full)
            if same or len(others) == 1:
                found += [Rival(other, swapped.result(), same, not close, better) for other in others]
    return found


def unseen(search: Searched, full: Fit, term: Term) -> list[Rival]:
    """Effects that hold one in them, and more that no window tells: they are the same model here.

    Asked at the noise, with what would matter elsewhere and without a fit, which would only make it vanish.
    """
    error = search.scorer.comparison_error(full)
    wider = [effect for effect in search.question.effects if term.effect.id in effect.contains]
    if error > SCORE.at_floor or not wider:
        return []
    scene, plain = search.question.look(full), full.structure.term_values(full.z, term)
    found: list[Rival] = []
    for effect in wider:
        values = effect.unseen(scene.at(effect.place, term.at, {}), plain)
        if values is None:
            continue
        more = Term(effect, term.at, values)
        fitted = search.fitter.as_it_is(full, full.structure.with_term(more))
        lost = search.scorer.compare(full, fitted)
        if lost.alike and lost.gain < SCORE.worth:
            found.append(Rival(more, fitted.result(), same=True, ruled_out=False))
    return found


def _swapped(
    search: Searched, full: Fit, structure: Structure, before: Tried | None
) -> tuple[Fit | None, Array | None]:
    """A structure with a rival fitted to all windows, and its mean square errors on those compared on; a sketch, and
    nothing, where that was enough to rule it out.
    """
    fitter = search.fitter
    if (before.fitted if before else fitter.remembered(structure)) is not None:
        return None, None  # nobody will ask
    sketch = before.sketch if before else fitter.sketch(full, structure, rival=True)
    if sketch is None or fitter.behind(sketch, full):
        return sketch and sketch.result(), None
    swapped = fitter.full(full, sketch)
    return (None, None) if swapped is None else (swapped.result(), search.scorer.comparison_mse(swapped))


def _better(search: Searched, swapped: Fit, full: Fit) -> bool:
    """Whether a rival predicts clearly better; at the noise, with no more parameters, beyond chance is enough."""
    gained = search.scorer.compare(swapped, full)
    if gained.clear:
        return search.scorer.confirmed(swapped, full)
    closely = search.scorer.comparison_error(swapped) < SCORE.at_floor and len(swapped.z) <= len(full.z)
    return closely and gained.told and search.scorer.compare_on_others(swapped, full).gain > 0


def _stand_ins(
    search: Searched, full: Fit, term: Term, *, provisional: bool
) -> Iterator[tuple[list[Term], Structure, Tried | None]]:
    """Effects to try in the place of one, the structure with them, and what its round made of it if it was tried.

    Where structure is left, names are provisional, and fewer rivals are tried.
    """
    everything = {t.key: t for round_ in search.progress.rounds for t in round_}
    own = next((r for r in search.progress.rounds if any(t.key == term.key and t.fitted for t in r)), [])
    present = {x.key for x in full.structure.terms}
    listed = set(term.effect.rivals)
    others = [
        t
        for t in own
        if t.key not in present
        and not t.term.effect.of_no_kind
        and term.effect.id not in t.term.effect.contains
        and (t.fitted is not None or (t.term.effect.id in listed and (t.sketch is not None or not provisional)))
        # What came close may act anywhere; what an effect is mistaken for acts at its joint.
        and (t.fitted is not None or not _apart(full.structure.model, term, t.term))
    ]
    others.sort(key=lambda t: (t.score, -t.predicted_gain))
    remaining = full.structure.without(term.key)
    fitting = (
        t for t in others if not any(t.term.at == x.at and excludes(x.effect, t.term.effect) for x in remaining.terms)
    )
    for other in itertools.islice(fitting, VERDICT.rivals_left if provisional else VERDICT.rivals):
        structure = remaining.with_term(other.term)
        same = other.sketch is not None and set(names(other.sketch.structure.terms)) == set(names(structure.terms))
        yield [other.term], structure, other if same else None
    for tried in everything.values():
        inside = [
            t for t in full.structure.terms if t.at == tried.term.at and t.effect.id in tried.term.effect.contains
        ]
        if len(inside) > 1 and term.key in {t.key for t in inside}:
            yield [tried.term], full.structure.with_term(tried.term), None
    parts = [everything.get(f"{inner}@{term.at}") for inner in term.effect.contains]
    if len(parts) > 1 and all(part is not None and part.key not in present for part in parts):
        terms = [part.term for part in parts if part is not None]
        yield terms, reduce(Structure.with_term, terms, remaining), None


def _apart(model: mujoco.MjModel, one: Term, other: Term) -> bool:
    """Whether two effects act at joints, or at motors of joints, that are not the same."""
    joints = [acts_on(model, term.effect, term.at) for term in (one, other)]
    return None not in joints and joints[0] != joints[1]


def locate(scene: Scene, joints: Sequence[str]) -> list[Located]:
    """Which joints carry the unexplained force, and in which region of motion; the largest share first."""
    size = np.sqrt(np.mean(scene.force**2, axis=0))
    scale = (
        np.sqrt(np.mean(scene.load**2, axis=0)) + VERDICT.light * np.sqrt(np.mean(scene.load**2, axis=0)).max() + 1e-12
    )
    power = (size / scale) ** 2
    total = float(power.sum()) or 1.0
    found = [Located(joint, float(power[j] / total), *_region(scene, j)) for j, joint in enumerate(joints)]
    return sorted(found, key=lambda x: -x.share)


def _region(scene: Scene, j: int) -> tuple[str, float]:
    """What the unexplained force at a joint goes with, and how far: the quantity whose bins explain most of it."""
    force = scene.force[:, j]
    if not np.any(force):
        return "nowhere", 0.0
    v, q, load, t = scene.velocity[:, j], scene.position[:, j], scene.load[:, j], scene.time
    explained = {
        name: _explained(force, quantity)
        for name, quantity in (("velocity", v), ("position", q), ("load", load), ("time", t))
    }
    best = max(explained, key=lambda name: explained[name])
    most, percent = explained[best], f"{100 * explained[best]:.0f} % of its variance"
    if most < VERDICT.pattern:
        return "spread over position, velocity, load and time alike", most
    if best != "velocity":
        return f"goes with {best} ({percent})", most
    slow = np.abs(v) < VERDICT.slow * np.std(v)
    forward, backward = force[~slow & (v > 0)], force[~slow & (v < 0)]
    step = abs(float(np.mean(forward) - np.mean(backward))) if len(forward) and len(backward) else 0.0
    slope = abs(float(np.polyfit(v, force, 1)[0])) * 2 * float(np.std(v))
    at_rest = np.mean(np.abs(force[slow]))
    if step > VERDICT.step * slope or at_rest > VERDICT.stronger * np.mean(np.abs(force[~slow])):
        return f"changes sign with velocity, at reversals ({percent})", most
    return f"grows with velocity ({percent})", most


def _explained(force: Array, quantity: Array, bins: int = VERDICT.bins) -> float:
    """Share of the variance of the force between bins of a quantity (correlation ratio)."""
    edges = np.quantile(quantity, np.linspace(0, 1, bins + 1)[1:-1])
    which = np.searchsorted(edges, quantity)
    counts = np.bincount(which, minlength=bins)
    means = np.bincount(which, force, minlength=bins) / np.maximum(counts, 1)
    variance = float(np.var(force))
    return float(np.sum(counts * (means - np.mean(force)) ** 2) / len(force) / variance) if variance > 0 else 0.0


def negligible(recalibrated: float, motion: float, located: Located) -> bool:
    """Whether a mismatch beyond the noise is not worth a name: small beside the motion, and without a pattern.

    Real recordings always hold a little structure beyond noise, and the best of dozens of effects takes up some of it.

    Args:
        recalibrated: error of the refitted model, in units of noise.
        motion: within a window, in units of noise.
        located: where the mismatch sits, the joint that carries most of it.
    """
    return recalibrated < VERDICT.small * motion and located.explained < VERDICT.pattern


def refuted(without: float, error: float) -> bool:
    """Whether validation data speak against an effect: they are predicted clearly worse than without it."""
    return error > SCORE.at_floor and error > VERDICT.refuted * without


def error_on(problem: Problem, fitted: Fit) -> float:
    """Root mean square error on windows that no fit has touched, in units of noise."""
    mse, _ = evaluate(problem, fitted.structure, fitted.z)
    return float(np.sqrt(np.mean(mse)))


def fair(search: Searched, fitted: Fit) -> Problem:
    """The validation data that may speak against a fit: windows in which its laws are asked where they have data.

    Where there are none, those that were compared on.
    """
    validation = search.partition.validation
    there = supported(fitted, search.partition.problem, validation)
    return validation.pick(there) if there.any() else search.partition.comparison


def on(problem: Problem, new: Fit, old: Fit) -> Improvement:
    """How much better one fit predicts windows than another."""
    (after, _), (before, _) = (evaluate(problem, one.structure, one.z) for one in (new, old))
    return compare_on(problem, new, old, after, before, problem.blocks)


def on_untouched(search: Searched, new: Fit, old: Fit) -> Improvement:
    """How much better one fit predicts than another on windows that no fit has touched, validation among them."""
    untouched, validation = search.partition.comparison, fair(search, new)
    after, before = search.scorer.comparison_mse(new), search.scorer.comparison_mse(old)
    if validation is not untouched:
        untouched = untouched.join(validation)
        after, before = (
            np.append(known, evaluate(validation, one.structure, one.z)[0])
            for known, one in ((after, new), (before, old))
        )
    return compare_on(untouched, new, old, after, before, untouched.blocks)


def verdict(
    errors: Sequence[float],
    small: bool,
    terms: int,
    changed: int,
    unnamed: int = 0,
    modelled: int = 0,
    elsewhere: float = 1.0,
) -> str:
    """The verdict from errors on held-out windows, in units of noise.

    Args:
        errors: of the model as given, of the recalibrated and of the improved one.
        small: whether what refitted parameters leave is `negligible`.
        terms: how many effects were found and named.
        unnamed: how many improve predictions without a name.
        modelled: laws of no kind.
        elsewhere: error of the recalibrated model on the windows compared on: test data may not show what acts there.
        changed: how many model parameters had to change, as validation data have it.
    """
    nominal, recalibrated, improved = errors
    if modelled:
        much = improved <= SCORE.at_floor or improved - 1 < VERDICT.modelled * (recalibrated - 1)
        return "partly explained" if terms else "modelled" if much else "unexplained"
    if terms:
        return "explained" if improved <= SCORE.at_floor else "partly explained"
    if unnamed:
        return "modelled" if improved <= SCORE.at_floor else "unexplained"
    if (min(nominal, recalibrated) <= SCORE.at_floor and elsewhere <= VERDICT.elsewhere) or small:
        return "recalibrated" if changed else "consistent"
    return "unexplained"
