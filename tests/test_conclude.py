"""What a search comes to: what validation data strike off, and what takes the place of what was found.

Every test has recordings of a simulated cart. A search runs one round on them, so that all hypotheses are tried; then
it is put where the test wants it, as if it had accepted these effects, with fits of its own.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from sim2real_rigs import HANGING
from test_diagnose import NOMINAL, run

from dipc_gym import mjcf
from dipc_gym.recording import Recording
from dipc_gym.sim2real import diagnosis
from dipc_gym.sim2real.effects import Values, catalogue
from dipc_gym.sim2real.estimation.fit import Fit, fit
from dipc_gym.sim2real.model.parameters import Wishes
from dipc_gym.sim2real.model.structure import Term, names
from dipc_gym.sim2real.selection.baseline import baseline
from dipc_gym.sim2real.selection.case import part
from dipc_gym.sim2real.selection.fitter import Fitter
from dipc_gym.sim2real.selection.hypotheses import Phase
from dipc_gym.sim2real.selection.progress import Journal
from dipc_gym.sim2real.selection.rounds import addition
from dipc_gym.sim2real.selection.search import Search, Searched
from dipc_gym.sim2real.selection.settings import SCORE
from dipc_gym.sim2real.selection.stop import Stop
from dipc_gym.sim2real.verdict import last_choice, sparse, stand_ins, untouched
from dipc_gym.sim2real.verdict.conclude import Conclusion, conclude, without_idle
from dipc_gym.sim2real.verdict.settings import VERDICT
from dipc_gym.sim2real.verdict.withheld import gather


@dataclass(frozen=True)
class Ready:
    """A search whose first round is over, whatever it accepted."""

    search: Search

    def accepting(self, *effects: str, **guesses: Values) -> Searched:
        """A search of its own that accepted these effects one after another.

        Args:
            effects: ids.
            guesses: where to begin, by id with an underscore for the dot; otherwise where the round began.
        """
        old = self.search
        path, rounds = [old.progress.path[0]], [list(old.progress.rounds[0])]
        for effect in effects:
            tried = next((one for one in rounds[0] if one.term.effect.id == effect), None)
            guess = guesses.get(effect.replace(".", "_"))
            term = tried.term if tried and guess is None else Term(catalogue()[effect], "cart", guess or {})
            path.append(self._fitted(path[-1], term))
            if tried is not None:
                rounds[0][rounds[0].index(tried)] = replace(tried, fitted=path[-1])
        journal = Journal(replace(old.progress, path=tuple(path), rounds=tuple(rounds)))
        return Search(old.question, old.scorer, journal, Stop(lambda _: None)).outcome

    def _fitted(self, base: Fit, term: Term) -> Fit:
        """A fit with one effect more."""
        fitter = Fitter(self.search.scorer)
        sketch = fitter.sketch(base, base.structure.with_term(term))
        assert sketch is not None
        full = fitter.full(base, sketch)
        assert full is not None
        return full


def ready(text: str, runs: Sequence[Recording], *effects: str, fix: tuple[str, ...] = ()) -> Ready:
    """Read, part, fit the model itself, and try every effect once."""
    given, _ = gather(mjcf.from_text(text), runs, (), Wishes(fix=fix))
    case = part(given, threads=1)
    base = baseline(case)
    search, _ = diagnosis.begin_search(case, base, [catalogue()[effect] for effect in effects], Stop(lambda _: None))
    addition(search.question, Phase.FORMULAS, search.fitter, search.journal)
    return Ready(search)


def found(fitted: Fit) -> list[str]:
    """Effects of a fit, whose place is the cart or its drive."""
    return [name.split("@")[0] for name in names(fitted.structure.terms)]


@functools.cache
def sticky() -> Ready:
    """Coulomb friction of 3 N."""
    effects = ("friction.coulomb", "friction.asymmetric", "friction.viscous", "motor.deadzone", "drag.quadratic")
    return ready(NOMINAL, [run(1, 20, 3.0)], *effects, "disturbance.pulse")


@functools.cache
def pushed_early() -> Ready:
    """Coulomb friction of 3 N; a steady force of 2 N before the validation data, which begin at 12 s."""
    early = run(2, 20, 3.0, knock=(2.0, 0.0, 12.0))
    return ready(NOMINAL, [early], "friction.coulomb", "load.constant", "friction.viscous")


def test_a_rival_that_predicts_better_takes_the_place() -> None:
    """It is asked in its turn what could stand in for it, and nothing predicts better than it."""
    wrong = "motor.deadzone"
    concluded = conclude(sticky().accepting(wrong))[1]
    assert found(concluded.fitted) == ["friction.coulomb"]
    assert concluded.fitted.error < 1.2
    rivals = concluded.rivals["friction.coulomb@cart"]
    assert {rival.term.effect.id for rival in rivals} >= {wrong}
    assert not any(rival.better for rival in rivals)
    assert all(rival.ruled_out for rival in rivals if rival.term.effect.id == wrong)
    assert concluded.notes == []


@pytest.mark.parametrize("chosen", ["friction.asymmetric", "friction.coulomb"])
def test_of_names_for_one_model_the_plainer_one_stays(chosen: str) -> None:
    """Friction of two levels, one for each direction, that came out alike is friction of one."""
    concluded = conclude(sticky().accepting(chosen))[1]
    assert found(concluded.fitted) == ["friction.coulomb"]


def test_what_validation_data_strike_off_is_not_asked_for_rivals() -> None:
    """Neither is it added again."""
    concluded = conclude(pushed_early().accepting("friction.coulomb", "load.constant"))[1]
    assert found(concluded.fitted) == ["friction.coulomb"]
    assert list(concluded.rivals) == ["friction.coulomb@cart"]
    (note,) = concluded.notes
    assert note.startswith("load.constant@cart would explain the recordings that were fitted, but validation data")


def test_effects_that_validation_data_strike_off_altogether() -> None:
    """Then nothing is named, and nothing is asked."""
    steady = ready(NOMINAL, [run(2, 20, 0.0, knock=(2.0, 0.0, 12.0))], "load.constant", "friction.coulomb")
    concluded = conclude(steady.accepting("load.constant"))[1]
    assert found(concluded.fitted) == []
    assert concluded.rivals == {}
    assert len(concluded.notes) == 1


def test_a_name_that_needs_nothing_beside_it_goes_before_two() -> None:
    """Beside a spring a steady force is a sensor's bias. The friction that was accepted with the force is idle.

    As one of a pair, neither was ever compared with what would do alone. Which of the two that do is named, is chance;
    the other is told beside it.
    """
    sprung = NOMINAL.replace('damping="40"', 'damping="40" stiffness="200"')
    seen = run(3, 20, 0.0, spring=200.0)
    seen = replace(seen, sensors=seen.sensors + 0.02)
    effects = ("load.constant", "friction.coulomb", "sensor.bias")
    both = ready(sprung, [seen], *effects, fix=("cart.mass", "motor.gear"))
    pair = both.accepting("load.constant", "friction.coulomb", friction_coulomb={"level": 1e-3})
    assert found(pair.progress.current) == ["load.constant", "friction.coulomb"]
    concluded = conclude(pair)[1]
    (one,) = found(concluded.fitted)
    other = {"sensor.bias": "load.constant", "load.constant": "sensor.bias"}[one]
    assert other in {rival.term.effect.id for group in concluded.rivals.values() for rival in group if rival.same}
    assert concluded.fitted.error < 1.2


def test_a_push_is_named_only_where_next_to_nothing_is_left() -> None:
    """One of several windows that stand out could always be a push: it is no law that another recording shares."""
    effects = ("friction.coulomb", "disturbance.pulse")
    knock = (6.0, 5.0, 0.08)
    plain = ready(NOMINAL, [run(7, 20, 3.0, knock=knock)], *effects)
    push = {"force": 4.0, "start": 4.95, "duration": 0.1}
    kept = conclude(plain.accepting(*effects, disturbance_pulse=push))[1]
    assert found(kept.fitted) == ["friction.coulomb", "disturbance.pulse"]
    assert kept.notes == []
    uneven = ready(NOMINAL, [run(7, 20, 3.0, knock=knock, uneven=(0.5, 0.02))], *effects)
    struck = conclude(uneven.accepting(*effects, disturbance_pulse=push))[1]
    assert found(struck.fitted) == ["friction.coulomb"]
    assert struck.notes[0].startswith("disturbance.pulse@cart would explain a part")


def test_what_improves_predictions_by_too_little_has_no_name() -> None:
    """Drag that takes up a little of friction that is uneven: it stays in the model, or goes, and is never named."""
    effects = ("friction.coulomb", "drag.quadratic")
    uneven = ready(NOMINAL, [run(7, 20, 3.0, uneven=(0.5, 0.02))], *effects)
    concluded = conclude(uneven.accepting(*effects))[1]
    assert found(concluded.fitted)[0] == "friction.coulomb"
    named = [name for name in names(concluded.fitted.structure.terms) if name not in concluded.unnamed]
    assert named == ["friction.coulomb@cart"]


def test_what_predicts_nothing_elsewhere_goes_and_what_happened_once_stays() -> None:
    """A coupling so stiff that it does nothing, and a push that no other window shows."""
    values = {"stiffness": 1e5, "damping": 50.0, "rotor_inertia": 0.1}
    push = {"force": 4.0, "start": 4.95, "duration": 0.1}
    search = sticky().accepting("friction.coulomb")
    structure = search.progress.current.structure
    structure = structure.with_term(Term(catalogue()["transmission.compliance"], "motor", values))
    structure = structure.with_term(Term(catalogue()["disturbance.pulse"], "cart", push))
    every = fit(search.partition.problem, structure, most=2)
    assert search.scorer.comparison_error(every) < SCORE.at_floor
    assert found(without_idle(search, every)) == ["friction.coulomb", "disturbance.pulse"]


def test_ctrl_c_while_effects_are_judged_keeps_them(monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(*_: Any) -> Fit:
        raise KeyboardInterrupt

    search = sticky().accepting("friction.coulomb")
    monkeypatch.setattr(sparse, "fewest_parameters", stopped)
    concluded = conclude(search)[1]
    assert found(concluded.fitted) == ["friction.coulomb"]
    assert concluded.rivals == {"friction.coulomb@cart": []}
    assert search.stop.asked
    assert np.isfinite(concluded.fitted.error)


@pytest.mark.parametrize("accepted", [("load.constant",), ("friction.coulomb", "load.constant"), ("friction.coulomb",)])
def test_what_is_concluded_predicts_validation_data_no_worse_than_what_was_there(accepted: tuple[str, ...]) -> None:
    """Whatever a conclusion came to: beside it stand the model as given and with its own parameters refitted."""
    search = pushed_early().accepting(*accepted)
    before, *_, last = search.progress.path
    best = last_choice.best_on_validation(search, Conclusion(last), [before])
    reached, *others = (untouched.error_on(search.partition.validation, one) for one in (best.fitted, last, before))
    least = max(VERDICT.worse * min(others), SCORE.at_floor)
    assert reached <= least
    assert (best.fitted is last) == (others[0] <= least)
    assert bool(best.notes) == (best.fitted is before)


@pytest.mark.parametrize(
    ("one", "other", "apart"),
    [
        ("friction.coulomb@pole1", "motor.deadzone@motor", True),  # which drives the cart
        ("friction.coulomb@cart", "motor.deadzone@motor", False),
        ("friction.coulomb@pole1", "friction.viscous@pole2", True),
        ("load.constant@cart", "sensor.bias@pole1", False),  # a sensor that is off pushes all joints
    ],
)
def test_what_an_effect_is_mistaken_for_acts_at_its_joint(one: str, other: str, apart: bool) -> None:
    terms = [Term(catalogue()[name], at, {}) for name, _, at in (text.partition("@") for text in (one, other))]
    assert stand_ins._apart(mjcf.compile(HANGING), *terms) == apart
