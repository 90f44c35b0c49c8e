"""What the search answers on small rigs: a cart with friction, a knock, or what no effect that is asked for explains.

Whole diagnoses are in test_diagnose.py.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from test_diagnose import FORCE, NOMINAL, run

from dipc_gym import mjcf
from dipc_gym.recording import Recording
from dipc_gym.sim2real import diagnosis
from dipc_gym.sim2real.effects import Effect, Evidence, Values, catalogue
from dipc_gym.sim2real.effects.friction_position_law import FrictionOfPosition
from dipc_gym.sim2real.effects.friction_time import FrictionOfTime
from dipc_gym.sim2real.effects.load_position_law import ForceOfPosition
from dipc_gym.sim2real.effects.motor_map import CommandMap
from dipc_gym.sim2real.effects.shared.law import Law
from dipc_gym.sim2real.effects.shared.surfaces import Surface
from dipc_gym.sim2real.effects.unknown_force import UnknownForce
from dipc_gym.sim2real.effects.unknown_recent import UnknownRecent
from dipc_gym.sim2real.estimation.fit import Fit, fit
from dipc_gym.sim2real.model.parameters import Wishes
from dipc_gym.sim2real.model.structure import Term, names
from dipc_gym.sim2real.selection import beside, choice, kinds, sketches
from dipc_gym.sim2real.selection.baseline import baseline
from dipc_gym.sim2real.selection.case import part
from dipc_gym.sim2real.selection.fitter import Fitter
from dipc_gym.sim2real.selection.hypotheses import Phase, Question
from dipc_gym.sim2real.selection.prune import _alike, prune
from dipc_gym.sim2real.selection.ranking import Start
from dipc_gym.sim2real.selection.score import Improvement, compare
from dipc_gym.sim2real.selection.scorer import earned, settled
from dipc_gym.sim2real.selection.screen import Tried
from dipc_gym.sim2real.selection.search import Search
from dipc_gym.sim2real.selection.settings import SEARCH
from dipc_gym.sim2real.selection.stop import Stop
from dipc_gym.sim2real.simulation.windows import Windows
from dipc_gym.sim2real.verdict.closed_form import Formula
from dipc_gym.sim2real.verdict.law_formulas import _from_the_start, _until_it_settles
from dipc_gym.sim2real.verdict.withheld import gather

PLAIN = ("friction.coulomb", "load.constant", "drag.quadratic", "motor.deadzone")
MANY = (*PLAIN, "friction.stribeck", "transmission.compliance", "disturbance.pulse")
KNOCK = 7.3  # s
PRESLIDING = {"level": 2.0, "static": 3.0, "velocity": 0.05, "stiffness": 3e4, "damping": 60.0}


def begun(runs: list[Recording], effects: tuple[str, ...]) -> Search:
    """A search that has not begun."""
    case = part(gather(mjcf.from_text(NOMINAL), runs, (), Wishes())[0], threads=1)
    return diagnosis.begin_search(case, baseline(case), [catalogue()[name] for name in effects], Stop(print))[0]


def ended(runs: list[Recording], effects: tuple[str, ...]) -> Search:
    """A search that came to its end."""
    search = begun(runs, effects)
    search.run()
    return search


@pytest.fixture(scope="module")
def dry() -> Search:
    """On a cart with Coulomb friction."""
    return ended([run(1, 12, 3.0)], MANY)


@pytest.fixture(scope="module")
def knocked() -> Search:
    """On two recordings of a cart with Coulomb friction, in one of which it was knocked once."""
    runs = [run(7, 16, 5.0, knock=(6.0, KNOCK, 0.08)), run(8, 16, 5.0)]
    return ended(runs, ("disturbance.pulse", "load.constant", "friction.coulomb"))


@pytest.fixture(scope="module")
def stronger_at_rest() -> Search:
    """On a cart whose friction is twice as large at rest as in motion."""
    return ended([run(4, 12, 3.0, bristles=(6.0, 0.1, 1e5, 300.0))], (*PLAIN, "friction.stribeck"))


@pytest.fixture(scope="module")
def sprung() -> Search:
    """On a cart with friction and on a spring, of which no effect that is asked for knows."""
    return ended([run(7, 12, 2.0, spring=60.0)], ("motor.deadzone", "load.constant", "drag.quadratic"))


def added(search: Search) -> list[str]:
    """Ids of the effects that it came to."""
    return [term.effect.id for term in search.progress.current.structure.terms]


def tried(search: Search, number: int) -> dict[str, Tried]:
    """What became of the hypotheses of a round, by the effect's id."""
    return {one.term.effect.id: one for one in search.progress.rounds[number]}


def test_a_search_ends_at_the_noise(dry: Search) -> None:
    """One round: what friction leaves is nothing beside what it took away, and is not asked about."""
    assert added(dry) == ["friction.coulomb"]
    assert dry.progress.current.error < 1.05
    assert len(dry.progress.rounds) == 1


def test_what_elaborates_the_right_one_is_not_fitted(dry: Search) -> None:
    """More friction at rest would predict as well, with a parameter that says nothing."""
    elaborate = tried(dry, 0)["friction.stribeck"]
    assert elaborate.predicted_gain > 1.0
    assert elaborate.fitted is None


def test_what_takes_fine_steps_is_not_tried_where_others_come_to_the_noise(dry: Search) -> None:
    assert tried(dry, 0)["transmission.compliance"].sketch is None


def test_the_elaborate_one_is_found_where_the_plain_one_does_not_do(stronger_at_rest: Search) -> None:
    assert added(stronger_at_rest) == ["friction.stribeck"]
    plain = tried(stronger_at_rest, 0)["friction.coulomb"].fitted
    assert plain is not None
    assert plain.error > 3 * stronger_at_rest.progress.path[1].error


def test_what_happened_once_is_asked_for_when_all_else_is_quiet(knocked: Search) -> None:
    """Before, a push in the right moment takes up a little of everything."""
    assert added(knocked) == ["friction.coulomb", "disturbance.pulse"]
    assert "disturbance.pulse" not in tried(knocked, 0)
    assert "disturbance.pulse" in tried(knocked, 1)
    assert knocked.progress.current.error < 1.2


def test_windows_beside_an_outlier_are_taken_in_and_its_echoes_left_aside(knocked: Search) -> None:
    """Those beside it tell when it began and ended; the other recording's clock says nothing of it."""
    partition = knocked.partition
    length = partition.problem.windows.times.max()

    def near(windows: Windows) -> list[int]:
        """Recordings of the windows that hold the knock or stand beside one that does."""
        centre = windows.start + length / 2
        return windows.source[np.abs(centre - KNOCK) < 1.4 * length].tolist()

    assert near(partition.problem.windows) == [0, 0, 0]
    assert near(partition.comparison.windows) == []
    assert near(partition.aside.windows) == []  # some of them validate, and would speak against the knock


@pytest.mark.parametrize("rig", ["dry", "knocked", "stronger_at_rest", "sprung"])
def test_all_that_is_added_earns_its_place(rig: str, request: pytest.FixtureRequest) -> None:
    """It comes down to the noise, or takes a tenth of what was above it."""
    search: Search = request.getfixturevalue(rig)
    for before, after in pairwise(search.progress.path):
        assert after.error < 1.2 or after.error - 1 < 0.9 * (before.error - 1)
        assert len(after.structure.terms) > len(before.structure.terms)


def test_what_nobody_asked_for_is_left(sprung: Search) -> None:
    """The best of what is asked for takes up a little of anything; that earns it no place."""
    assert added(sprung) == []
    assert max(one.predicted_gain for one in sprung.progress.rounds[0]) > 0.02


def test_a_full_fit_that_a_later_phase_asks_for_again_is_made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    search = begun([run(1, 12, 3.0)], ("friction.coulomb",))
    fitter, base = search.fitter, search.progress.current
    structure = base.structure.with_term(Term(catalogue()["friction.coulomb"], "cart", {"level": 1.0}))
    sketch = fitter.sketch(base, structure)
    assert sketch is not None
    with fitter.fitted([(base, sketch, base)]) as fit_of:
        made = fit_of(0)
    assert made is not None
    monkeypatch.setattr(Fitter, "full", lambda *_: pytest.fail("fitted again"))
    with fitter.fitted([(base, sketch.result(), base)]) as fit_of:
        assert fit_of(0) is made
    monkeypatch.undo()
    fewer = search.progress.keeping(np.arange(len(base.mse) + len(search.partition.comparison.windows)) > 0)
    with fitter.over(fewer.partition).fitted([(fewer.current, sketch, fewer.current)]) as fit_of:
        assert fit_of(0) is not made


@pytest.mark.parametrize("off", [-3.0, -1.0, 1.0, 3.0])
def test_several_effects_that_stay_above_the_noise_are_begun_anew(off: float) -> None:
    """What one took on while the other was missing holds no fit in a wrong valley."""
    search = begun([run(1, 12, 3.0, constant=2.0)], ("friction.coulomb", "load.constant"))
    found = search.run()
    assert sorted(added(search)) == ["friction.coulomb", "load.constant"]
    astray = fit(search.partition.problem, found.structure, found.z + off, most=0)
    assert astray.error > 100.0
    assert search.fitter.anew(astray).error == pytest.approx(found.error, rel=1e-3)
    assert search.fitter.anew(found) is found  # at the noise nothing is begun anew


@pytest.mark.parametrize(
    ("hidden", "reads", "knots", "levels", "kind"),
    [
        ({"most": 3.0}, "command motor", [-8.0, -3.0, 3.0, 8.0], [20.0, 0.0, 0.0, -20.0], "motor.map@motor"),
        ({"coulomb": 3.0}, "velocity cart", [-0.4, -2e-3, 2e-3, 0.4], [3.0, 3.0, -3.0, -3.0], "friction.speed@cart"),
        ({"coulomb": 3.0}, "velocity cart", [-0.4, -2e-3, 2e-3, 0.4], [3.0, 3.0, -3.0, -3.0], "friction.coulomb@cart"),
    ],
)
def test_what_a_law_depends_on_may_be_its_kind(
    hidden: dict[str, float], reads: str, knots: list[float], levels: list[float], kind: str
) -> None:
    """A force of the command to its own motor alone, or of its own velocity alone, gets the name of a law, or of an
    effect that does as much.
    """
    search = begun([run(3, 12, **{"coulomb": 0.0, **hidden})], ("residual.force", kind.partition("@")[0]))
    bare = search.progress.current
    shape = Surface((reads,), (np.array(knots),), np.array(levels))
    law = UnknownForce(shape, 1.0, ("",), "cart")
    structure = bare.structure.with_term(Term(law, "cart", law.first))
    modelled = fit(search.partition.problem, structure, None, bare.initial, most=8)
    told = list[str]()
    found = kinds.named(search.question, search.fitter, modelled, bare, told.append)
    assert [term.key for term in found.structure.terms] == [kind]
    assert len(told) == 1
    assert found.error < 1.1 * modelled.error


@pytest.mark.parametrize(
    ("before", "left", "most"),
    [
        (100.0, 20.0, 60.0),  # most of what a law without a name brings is half of it
        (100.0, 1.0, 3.0),  # where that leaves nothing, a name may leave a little
        (4.0, 1.0, 2.5),
    ],
)
def test_what_a_name_may_leave_to_go_before_a_law_without_one(before: float, left: float, most: float) -> None:
    """Errors in units of noise."""
    assert choice.before_unnamed(before, np.full(20, left**2)) == pytest.approx(most)


@pytest.mark.parametrize(
    ("named", "modelled", "end", "begin"),
    [
        ([150.0] * 33, [100.0] * 33, "named", 22600.0),  # a name goes before a law without one
        # unless it leads astray where windows are not its own
        ([800.0] * 20 + [20.0] * 13, [160.0] * 33, "modelled", 22600.0),
        ([1.2] * 33, [1.0] * 33, "named", 22600.0),
        ([2.5] * 33, [0.9] * 33, "named", 22600.0),
        ([3.5] * 33, [0.9] * 33, "modelled", 22600.0),
        ([6.5] * 33, [2.4] * 33, "modelled", 16.0),  # it brought less than half of what logarithms of errors count
        ([5.5] * 33, [2.4] * 33, "named", 16.0),
    ],
)
def test_which_of_two_ends_a_search_comes_to(named: list[float], modelled: list[float], end: str, begin: float) -> None:
    """From the error that each leaves of windows that it was not fitted to, in units of noise."""
    left = {"begin": [begin] * 33, "named": named, "modelled": modelled}
    fits = {name: SimpleNamespace(name=name, structure=SimpleNamespace(unnamed=name == "modelled")) for name in left}
    scorer = SimpleNamespace(unfitted_mse=lambda fitted: np.square(left[fitted.name]))
    paths = [(fits["begin"], fits[name]) for name in ("named", "modelled")]
    assert choice.of_ends(scorer, paths)[-1].name == end  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("one", "other", "far"),
    [
        ([100.0] * 33, [110.0] * 33, False),
        ([100.0] * 33, [160.0] * 33, True),
        ([100.0] * 33, [100.0] * 30 + [2000.0] * 3, True),  # the other is alike, and goes astray in three windows
    ],
)
def test_what_goes_astray_in_few_windows_leaves_far_more(one: list[float], other: list[float], far: bool) -> None:
    left = {"one": one, "other": other}
    scorer = SimpleNamespace(unfitted_mse=lambda fitted: np.square(left[fitted]))
    assert choice.leaves_far_less(scorer, "one", "other") is far  # type: ignore[arg-type]


def test_laws_of_no_kind_keep_none_of_a_kind_from_being_asked(monkeypatch: pytest.MonkeyPatch, dry: Search) -> None:
    """They take some of anything, so that screening foretells more of them than of the drive's curve, which it is."""
    base = dry.progress.path[0]
    laws = [effect for effect in catalogue().values() if effect.free]
    laws.sort(key=lambda effect: not effect.of_no_kind)
    ranked = [Start(Tried(Term(law, "cart", {}), 1.0 if k == 0 else 1e-6 / k), base) for k, law in enumerate(laws)]
    asked: list[str] = []
    monkeypatch.setattr(
        sketches, "_sketches", lambda fitter, first, *rest: asked.extend(one.key for one, _ in first) or []
    )
    sketches.in_turn(dry.fitter, ranked, {}, base)
    of_a_kind = [tried.key for tried, _ in ranked if not tried.term.effect.of_no_kind]
    assert set(of_a_kind[: SEARCH.shapes]) <= set(asked)
    assert len(laws) - len(of_a_kind) > 2


def test_names_that_would_go_before_a_law_of_no_kind_are_fitted_as_well() -> None:
    """By logarithms, a name that takes two thirds of the error is next to nothing beside a law that takes all."""
    left = {"friction.coulomb": 8100.0, "friction.time": 3700.0, "drag.quadratic": 14000.0, "residual.force": 63.0}
    found = catalogue()
    sketched = [
        Start(Tried(Term(found[name], "cart", {}), 1.0, sketch=SimpleNamespace(error=e, mse=np.full(9, e**2))), None)  # type: ignore[arg-type]
        for name, e in left.items()
    ]
    asked = sketches._going_before(sketched, 22600.0)  # type: ignore[arg-type]
    assert [tried.key for tried in asked] == ["friction.time@cart", "friction.coulomb@cart"]  # drag brings too little
    assert sketches._going_before(sketched[:-1], 22600.0) == []  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("asked", "kind"),
    [
        (("friction.speed", "load.constant"), ["friction.speed@cart", "load.constant@cart"]),
        (("friction.speed",), ["residual.force@cart"]),  # which leaves the load
    ],
)
def test_a_law_of_one_input_may_hold_a_plain_effect_as_well(asked: tuple[str, ...], kind: list[str]) -> None:
    """Friction and a constant load, seen as one force of velocity: neither alone does as much."""
    search = begun([run(3, 12, 3.0, constant=2.0)], ("residual.force", *asked))
    bare = search.progress.current
    shape = Surface(("velocity cart",), (np.array([-0.4, -2e-3, 2e-3, 0.4]),), np.array([5.0, 5.0, -1.0, -1.0]))
    law = UnknownForce(shape, 1.0, ("",), "cart")
    structure = bare.structure.with_term(Term(law, "cart", law.first))
    modelled = fit(search.partition.problem, structure, None, bare.initial, most=8)
    found = kinds.named(search.question, search.fitter, modelled, bare, print)
    assert sorted(names(found.structure.terms)) == kind


@pytest.mark.parametrize(
    ("uneven", "kind"),
    [
        (0.0016, "friction.position:law@cart"),  # a six hundredth of the friction, by a wave along the way
        (0.0, "friction.coulomb@cart"),
    ],
)
def test_a_formula_that_leaves_a_little_gives_way_to_the_law_that_holds_it(uneven: float, kind: str) -> None:
    """It ends the search near the noise; only beside nothing else missing is what it leaves the law's."""
    search = begun([run(4, 12, 3.0, uneven=(uneven, 0.2))], ("friction.coulomb", "friction.position:law"))
    plain = search._add(4)
    assert names(plain.structure.terms) == ["friction.coulomb@cart"]
    found = kinds.shaped(search.question, search.fitter, plain, print)
    assert names(found.structure.terms) == [kind]
    assert found.error == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize(
    ("asked", "kind"),
    [
        (("load.position:law", "friction.speed"), ["friction.speed@cart", "load.position:law@cart"]),
        (("load.position:law",), ["residual.force@cart"]),  # which leaves the friction
    ],
)
def test_a_law_of_two_inputs_may_be_the_sum_of_two_kinds(asked: tuple[str, ...], kind: list[str]) -> None:
    """A spring and Coulomb friction, seen as one force of position and velocity."""
    search = begun([run(7, 12, 2.0, spring=60.0)], ("residual.force", *asked))
    bare = search.progress.current
    places, speeds = np.linspace(-0.2, 0.2, 3), np.array([-0.4, -2e-3, 2e-3, 0.4])
    levels = -60.0 * places[:, None] - 2.0 * np.sign(speeds)
    law = UnknownForce(Surface(("position cart", "velocity cart"), (places, speeds), levels), 1.0, ("m", "m/s"), "cart")
    structure = bare.structure.with_term(Term(law, "cart", law.first))
    modelled = fit(search.partition.problem, structure, None, bare.initial, most=8)
    found = kinds.named(search.question, search.fitter, modelled, bare, print)
    assert sorted(term.key for term in found.structure.terms) == kind
    assert (found is modelled) == (len(asked) == 1)


@pytest.mark.parametrize(
    ("begin", "before", "after", "tells"),
    [
        (100.0, 10.0, 9.0, True),  # a tenth of what is left, which is a tenth of what the law brought
        (2000.0, 10.0, 7.0, False),  # a third, beside a law that left half a percent
        (2000.0, 10.0, 4.0, True),  # two thirds
        (100.0, 2.0, 1.4, False),  # near the noise, where nothing but the law's own fit may be missing
        (100.0, 2.0, 1.2, True),
    ],
)
def test_what_a_law_leaves_is_no_second_effects(
    sprung: Search, begin: float, before: float, after: float, tells: bool
) -> None:
    """Tables are off by a little between their knots, and whatever depends on the same quantities takes up some."""
    bare = sprung.progress.path[0]

    def leaving(error: float, *terms: Term) -> Fit:
        """A fit with these effects that leaves so much, times the noise."""
        return replace(bare, structure=replace(bare.structure, terms=terms), mse=np.full_like(bare.mse, error**2))

    drag = Term(catalogue()["drag.quadratic"], "cart", {"coefficient": 1.0})
    for law in (Term(catalogue()["friction.hysteresis"], "cart", {}), Term(catalogue()["motor.map"], "motor", {})):
        current, fitted = leaving(before, law), leaving(after, law, drag)
        assert choice.tells(drag, fitted, current, leaving(begin)) == tells
    assert choice.tells(drag, fitted, leaving(before), leaving(begin))  # beside formulas, any of it may be another's


@pytest.mark.parametrize(
    ("begin", "now", "after", "finer"),
    [
        (20000.0, 1700.0, 1500.0, False),  # much else is missing: it would take up what that does
        (20000.0, 60.0, 50.0, True),  # little beside what was found
        (100.0, 2.5, 2.0, True),  # it may yet come down to the noise
        (100.0, 7.0, 1.1, True),  # what was left was of the law alone
        (100.0, 7.0, 5.0, False),
    ],
)
def test_laws_are_finer_where_little_else_can_be_missing_then(
    dry: Search, monkeypatch: pytest.MonkeyPatch, begin: float, now: float, after: float, finer: bool
) -> None:
    """Errors in units of noise."""
    bare, law, better = (
        replace(dry.progress.current, mse=np.full_like(dry.progress.current.mse, error**2))
        for error in (begin, now, after)
    )
    monkeypatch.setattr("dipc_gym.sim2real.selection.search.refined", lambda *_: better)
    search = begun([run(1, 12, 3.0)], MANY)
    search.journal.progress = replace(search.progress, path=(bare,))
    assert search._finer(law) is (better if finer else law)


@pytest.mark.parametrize(
    ("small", "before", "after", "stays"),
    [
        (False, 10.0, 7.0, True),  # a third of what is left
        (False, 10.0, 8.5, True),  # a sixth
        (False, 10.0, 9.4, False),  # a fifteenth
        (True, 10.0, 2.0, False),  # small beside the motion: all or nothing
        (True, 10.0, 1.1, True),
        (False, 1.3, 1.1, True),
    ],
)
def test_what_earns_its_place(small: bool, before: float, after: float, stays: bool) -> None:
    """Errors in units of noise."""
    windows = np.ones(9)
    assert earned(after**2 * windows, before**2 * windows, small=small) is stays


@pytest.mark.parametrize(("after", "stays"), [(1.0, True), (1.3, False)])
def test_a_push_not_yet_found_does_not_speak_against_what_explains_the_rest(after: float, stays: bool) -> None:
    before, now = np.full(40, 1.5**2), np.full(40, after**2)
    before[7] = now[7] = 60.0**2
    assert earned(now, before, small=False) is stays


@pytest.mark.parametrize(
    ("scale", "worse", "better", "shows"),
    [
        (1.0, 3, 0, True),
        (1.0, 2, 0, False),  # may be chance
        (1.0, 3, 1, False),  # they contradict each other
        (9.0, 3, 0, False),  # away from the noise errors differ for many reasons
    ],
)
def test_a_few_windows_tell_at_the_noise(scale: float, worse: int, better: int, shows: bool) -> None:
    """An effect that acts in three of eighty windows, as break-away does, is there: ten times the error without it."""
    new, old = np.full(80, scale), np.full(80, scale)
    old[:worse] *= 100.0
    new[worse : worse + better] *= 100.0
    difference = compare(new, old, np.arange(80))
    assert difference.shows is shows
    assert difference.clear is shows
    assert difference.alike is not shows


@pytest.mark.parametrize(
    ("gain", "error", "goes"), [(0.9, 0.6, False), (0.9, 1.0, True), (0.3, 0.2, True), (0.3, 0.1, False)]
)
def test_an_effect_goes_out_by_no_more_standard_errors_than_it_came_in_with(
    gain: float, error: float, goes: bool
) -> None:
    assert _alike(Improvement(gain, error)) is goes


@pytest.mark.parametrize(
    ("after", "left"),
    [
        ((1.0, 1.0), False),  # a limit that is met in two windows, and explains both
        ((1.0, 60.0), True),  # one of them is left: a push would do as well
    ],
)
def test_what_acts_seldom_stands_out_where_it_leaves_no_outlier(after: tuple[float, float], left: bool) -> None:
    """Two of 72 windows are predicted badly, the others at the noise; by a standard error two are never clear."""
    before, now = np.append(np.ones(70), [400.0, 90.0]), np.append(np.ones(70), after)
    assert settled(now, before) is not left
    assert not compare(now, before, np.arange(72)).clear


def test_two_shapes_of_one_law_are_two_sketches(dry: Search) -> None:
    """Both begin with the same mapped parameters, and one had been taken for the other."""
    base, fitter = dry.progress.path[0], Fitter(dry.scorer)
    shapes = [
        Surface((one,), (np.array([-far, 0.0, far]),), np.array([1.0, 0.0, -1.0]))
        for one, far in (("position cart", 0.1), ("velocity cart", 0.5))
    ]
    laws = [UnknownForce(shape, 1.0, ("m",), "cart") for shape in shapes]
    along, against = (fitter.sketch(base, base.structure.with_term(Term(law, "cart", law.first))) for law in laws)
    assert along is not None
    assert against is not None
    assert against.structure.terms[-1].effect is laws[1]
    assert against.error < along.error  # friction goes with velocity


def test_what_is_simulated_as_another_is_has_a_sketch_of_its_own(dry: Search, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is written is the same, and steps and run-up are not; nor is a rival's, which may be given up, another's."""
    fitter, made, rough = Fitter(dry.scorer), [], Fitter._rough
    monkeypatch.setattr(Fitter, "_rough", lambda *given: made.append(given) or rough(*given))
    base = fitter.whole(dry.progress.current)
    rich = base.structure.with_term(Term(catalogue()["friction.stribeck:presliding"], "cart", PRESLIDING))
    plain = base.structure.with_term(Term(catalogue()["load.constant"], "cart", {"force": 0.1}))
    for structure in (plain, plain.simulated_as(rich)):
        found = fitter.sketch(base, structure)
        assert found is not None
        assert (found.structure.finest, found.structure.warm) == (structure.finest, structure.warm)
    other = base.structure.with_term(Term(catalogue()["load.constant"], "cart", {"force": 0.2}))
    for rival, count in ((True, 3), (False, 4), (True, 4)):
        fitter.sketch(base, other, rival=rival)
        assert len(made) == count


def test_no_sketch_of_the_present_fit_is_made_twice(dry: Search, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor of the fit without effects, which a search comes back to; of others none is kept."""
    fitter, made, rough = Fitter(dry.scorer), [], Fitter._rough
    monkeypatch.setattr(Fitter, "_rough", lambda *given: made.append(given) or rough(*given))
    bare, present = dry.progress.path[0], fitter.whole(dry.progress.current)
    tilted = Term(catalogue()["load.constant"], "cart", {"force": 0.1})
    for base in (bare, present, present, bare, replace(present), present):
        assert fitter.sketch(base, base.structure.with_term(tilted)) is not None
    assert len(made) == 4


def test_a_recording_that_comes_to_rest_is_divided_by_its_motion() -> None:
    """A third of it stands still: windows to fit and to validate by share what moves as in one that never rests."""
    moving = run(1, 24, 3.0)
    still = moving.time > moving.time[0] + 16.0
    commands, sensors = moving.commands.copy(), moving.sensors.copy()
    commands[still] = 0.0
    noise = np.random.default_rng(0).normal(0, 1e-5, (int(still.sum()), sensors.shape[1]))
    sensors[still] = sensors[~still][-1] + noise
    shares = []
    for recording in (moving, replace(moving, commands=commands, sensors=sensors)):
        case = part(gather(mjcf.from_text(NOMINAL), [recording, run(2, 12, 3.0)], (), Wishes())[0], threads=1)
        w = case.prepared.problem.windows
        moves = np.ptp(w.observed, axis=1).max(axis=1) > 1e-3
        first = w.source == 0
        shares.append(np.mean(w.start[first & moves] < case.borders[0]))
    assert shares[1] == pytest.approx(shares[0], abs=0.05)


def test_what_is_compared_may_be_simulated_as_the_other_is(dry: Search) -> None:
    """In its steps, and as long before each window: what finer steps and a run-up bring is no gain of an effect."""
    plain = dry.progress.path[0].structure
    rich = plain.with_term(Term(catalogue()["friction.stribeck:presliding"], "cart", PRESLIDING))
    alike = plain.simulated_as(rich)
    assert (alike.finest, alike.warm) == (rich.finest, rich.warm) != (plain.finest, plain.warm)
    assert alike.terms == plain.terms
    assert rich.simulated_as(plain) == rich


SAME_EVERYWHERE = ForceOfPosition([-0.2, 0.0, 0.2], [4.0, 4.0, 4.0])
SHIFTED = CommandMap([-9.0, 0.0, 9.0], (np.array([-9.0, 0.0, 9.0]) + 4.0 / FORCE).tolist())


@pytest.mark.parametrize(("law", "at"), [(SAME_EVERYWHERE, "cart"), (SHIFTED, "motor")])
def test_a_law_that_says_no_more_than_a_plain_effect_gives_way_to_it(law: Law, at: str) -> None:
    """A force that is the same wherever the cart is, and whatever the command, is a constant load, seen again once the
    law is out.
    """
    search = begun([run(3, 12, 0.0, constant=4.0)], ("load.constant", law.id))
    problem = search.partition.problem
    structure = search.progress.current.structure.with_term(Term(law, at, law.guess))
    fitted = fit(problem, structure, initial=problem.initial)
    assert fitted.error < 1.1
    assert names(prune(search.question, search.fitter, fitted, print).structure.terms) == ["load.constant@cart"]


class Broken(ForceOfPosition):
    """A law whose guesses cannot be worked out."""

    id = "load.broken"

    def proposals(self, evidence: Evidence) -> list[tuple[Effect, Values]]:
        raise ValueError("math domain error")


def test_an_error_among_laws_leaves_what_formulas_explain() -> None:
    """The search for laws begins anew, without the effects that were found before."""
    search = begun([run(9, 12, 4.0, uneven=(0.4, 0.05))], ("friction.coulomb",))
    search.question = replace(search.question, effects=[*search.question.effects, Broken()])
    with pytest.raises(ValueError, match="math domain"):
        search.run()
    assert added(search) == ["friction.coulomb"]


def test_what_is_modelled_may_have_asked_for_more_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    """The fit without effects, against which laws of a kind are counted in its place, knows them as well."""
    search = begun([run(9, 12, 4.0, uneven=(0.4, 0.05))], ("friction.coulomb", "residual.force"))
    few = len(search.partition.problem.windows)
    counted: list[int] = []

    def modelled(ends: Sequence[Sequence[Fit]], formulas: tuple[Fit, ...]) -> Fit:
        search._go_on(search.progress.with_first())
        return search._add(1)

    def least(question: Question, fitter: Fitter, current: Fit, begin: Fit, tell: object) -> Fit:
        counted.extend(len(fitted.mse) for fitted in (current, begin))
        return current

    monkeypatch.setattr(search, "_modelled", modelled)
    monkeypatch.setattr(kinds, "named", least)
    monkeypatch.setattr(beside, "least", least)
    search.run()
    assert counted[-4:] == [len(search.partition.problem.windows)] * 4
    assert counted[-1] > few


@pytest.mark.parametrize("where", ["within a round", "between rounds"])
def test_an_interrupt_among_laws_leaves_what_formulas_explain(where: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Laws begin anew: whoever presses Ctrl-C in their long rounds must not lose what was found before."""
    search = begun([run(9, 12, 4.0, uneven=(0.4, 0.05))], ("friction.coulomb", "friction.position:law"))
    step, back = search._step, search.journal.go_back

    def interrupted(**named: bool) -> bool:
        if search.phase > Phase.FORMULAS and where == "within a round":
            raise KeyboardInterrupt
        return step(**named)

    def go_back(path: tuple[Fit, ...]) -> None:
        back(path)
        if search.phase == Phase.SHAPES and where == "between rounds" and len(path) == 1:
            raise KeyboardInterrupt

    monkeypatch.setattr(search, "_step", interrupted)
    monkeypatch.setattr(search.journal, "go_back", go_back)
    if where == "within a round":
        search.run()
        assert search.stop.asked
    else:
        with pytest.raises(KeyboardInterrupt):
            search.run()
    assert added(search) == ["friction.coulomb"]


def test_as_many_windows_are_not_the_same_windows(dry: Search) -> None:
    """Nor are the same windows in other steps: a fit to others is worked out on these."""
    progress, current = dry.progress, dry.progress.current
    assert progress.informed([current]) == (current,)
    problem = progress.partition.problem
    one_less, other = np.arange(1, len(problem.windows)), np.arange(len(problem.windows) - 1)
    moved = replace(progress, partition=replace(progress.partition, problem=problem.pick(one_less)))
    again = moved.informed([current.pick(other)])[0]
    np.testing.assert_allclose(again.mse, current.mse[1:], rtol=1e-3)
    finer = replace(progress, partition=replace(progress.partition, problem=problem.halved_by(1)))
    assert finer.informed([current])[0].of(finer.partition.problem)


@pytest.mark.parametrize(("hidden", "level", "kept"), [(0.0, 1e-6, False), (3.0, 3.0, True)])
def test_a_name_that_does_nothing_beside_a_law_of_no_kind_goes(hidden: float, level: float, kept: bool) -> None:
    """That law would take over what friction does, so it is not asked to; nothing in its place tells."""
    search = begun([run(3, 12, hidden, constant=2.0)], ("residual.force", "friction.coulomb"))
    bare = search.progress.current
    law = UnknownForce(Surface(("velocity cart",), (np.array([-0.4, 0.4]),), np.full(2, 2.0)), 1.0, ("",), "cart")
    structure = bare.structure.with_term(Term(catalogue()["friction.coulomb"], "cart", {"level": level}))
    structure = structure.with_term(Term(law, "cart", law.first))
    both = fit(search.partition.problem, structure, None, bare.initial, most=0)
    left = names(prune(search.question, search.fitter, both, print).structure.terms)
    assert ("friction.coulomb@cart" in left) == kept
    assert "residual.force@cart" in left


@pytest.mark.parametrize(("uneven", "coarse"), [(0.02, 2.0), (0.003, 1.0)])
def test_what_a_coarse_law_left_is_no_physics_of_its_own(uneven: float, coarse: float) -> None:
    """A law of no kind that models it goes where the law of a kind, made finer, predicts as well; near the noise too,
    where no law is made finer for its own sake.
    """
    search = begun([run(9, 12, 4.0, uneven=(uneven, 0.2))], ("residual.force", "friction.position:law"))
    bare, way = search.progress.current, np.linspace(-0.06, 0.26, 5)
    law = FrictionOfPosition(way.tolist(), np.full(5, 4.0).tolist())
    axes = (np.array([-0.4, -0.01, 0.01, 0.4]), np.linspace(-0.3, 0.3, 13))
    rest = UnknownForce(Surface(("velocity cart", "position cart"), axes, np.zeros((4, 13))), 1.0, ("", ""), "cart")
    structure = bare.structure.with_term(Term(law, "cart", law.guess))
    assert fit(search.partition.problem, structure, None, bare.initial).error > coarse
    both = fit(search.partition.problem, structure.with_term(Term(rest, "cart", rest.first)), None, bare.initial)
    pruned = prune(search.question, search.fitter, both, print)
    assert names(pruned.structure.terms) == ["friction.position:law@cart"]
    assert pruned.error < 1.2


@pytest.mark.parametrize(("early", "taken"), [(4.0, True), (9.0, False)])
def test_a_formula_of_time_holds_from_the_start_if_that_predicts_beginnings(early: float, taken: bool) -> None:
    """Nothing is fitted to the first moments, in which other commands may act; they tell whether it goes on there."""
    search = begun([run(9, 12, 4.0)], ("friction.coulomb",))
    law = FrictionOfTime([2.0, 4.0, 12.0], [3.0, 4.0, 4.0])
    term = Term(law, "cart", law.guess)
    problem, first = search.partition.problem, search.partition.first
    assert len(first.windows)
    bare = search.progress.current
    fitted = fit(problem, bare.structure.with_term(term), None, bare.initial, most=0)
    formula = cast("Formula", lambda time: np.where(time < 2.0, early, 4.0))
    [after] = _from_the_start(fitted, problem, first, term, formula).structure.terms
    assert isinstance(after.effect, FrictionOfTime)
    assert (after.effect.knots[0] == 0.0) == taken
    assert after.effect.knots[-1] == 12.0


@pytest.mark.parametrize(
    ("kind", "parameters"),
    [
        ("exponential", {"scale": 0.2}),
        ("power", {"power": 0.5}),
        ("Gaussian", {"at": 0.4, "width": 0.02}),
        ("step", {"at": -0.1, "width": 0.01}),
    ],
)
def test_a_formula_of_the_past_holds_until_it_settles(kind: str, parameters: dict[str, float]) -> None:
    """Beyond the data it is told as well, for nobody sees what was of late; what may go on there as nothing tells is
    not.
    """
    search = begun([run(9, 12, 4.0)], ("friction.coulomb",))
    formula = Formula(-1.0, ((kind, (-2.0,), parameters),), (0.0, 0.36))
    knots = np.linspace(0.0, 0.6, 7)
    law = UnknownRecent(knots.tolist(), formula(knots**2).tolist(), ("velocity cart",) * 2, 1.0, 2.0, ("m/s",) * 2, 0.5)
    term = Term(law, "cart", {**law.guess, "time_constant": 1.3})
    problem, bare = search.partition.problem, search.progress.current
    fitted = fit(problem, bare.structure.with_term(term), None, bare.initial, most=0)
    after = _until_it_settles(fitted, problem, term, formula)
    if kind != "exponential":
        assert after is fitted
        return
    [longer] = after.structure.terms
    assert isinstance(longer.effect, UnknownRecent)
    assert longer.effect.places[-1] == pytest.approx(1.0)
    values = after.structure.term_values(after.z, longer)
    np.testing.assert_allclose(longer.effect.values(values), formula(longer.effect.places), rtol=1e-9)
    assert values["time_constant"] == pytest.approx(1.3)
    assert after.error == pytest.approx(fitted.error, rel=1e-3)
