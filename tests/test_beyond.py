"""Data that go beyond what laws were fitted with: what a law leaves there is no physics that is missing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from test_diagnose import NOMINAL, run
from test_search import begun

from dipc_gym import mjcf
from dipc_gym.mjcf.edit import Document
from dipc_gym.sim2real import diagnose
from dipc_gym.sim2real.effects import catalogue
from dipc_gym.sim2real.effects.load_position_law import ForceOfPosition
from dipc_gym.sim2real.estimation.fit import fit
from dipc_gym.sim2real.estimation.problem import Problem
from dipc_gym.sim2real.model.structure import Structure, Term
from dipc_gym.sim2real.result import Beyond, Errors
from dipc_gym.sim2real.selection.search import Search
from dipc_gym.sim2real.selection.support import input_of
from dipc_gym.sim2real.simulation.memory import swings, swung
from dipc_gym.sim2real.simulation.motion import Motion
from dipc_gym.sim2real.unseen.parts import loads
from dipc_gym.sim2real.verdict import sentences
from dipc_gym.sim2real.verdict.beyond import beyond
from dipc_gym.trials.covered import error_within

SPRING = 60.0  # N/m


@pytest.fixture(scope="module")
def sprung() -> Search:
    """On a cart on a spring, of which the model knows nothing."""
    return begun([run(3, 20, 0.0, spring=SPRING)], ("load.position:law",))


def reach(problem: Problem, search: Search) -> np.ndarray:
    """How far from its middle the cart gets in each window, m."""
    x = input_of("position cart", search.progress.current, problem.windows)
    return np.abs(np.where(problem.windows.valid, x, 0.0)).max(axis=1)


def test_windows_beyond_a_law_are_told_apart_from_those_that_judge_it(sprung: Search) -> None:
    """Fitted to the inner half of the way, a law is right to the noise there, and ends where its data do."""
    bare, problem = sprung.progress.current, sprung.partition.problem
    far = reach(problem, sprung)
    inner = np.flatnonzero(far < np.median(far))
    end = float(far[inner].max())
    law = ForceOfPosition([-end, end], [SPRING * end, -SPRING * end])
    structure = bare.structure.with_term(Term(law, "cart", law.guess))
    fitted = fit(problem.pick(inner), structure, None, bare.initial[inner])
    found = beyond((bare, bare, fitted), problem.pick(inner), problem)
    assert found is not None
    assert found.of == len(far)
    assert 0 < found.count <= len(far) - len(inner)
    assert found.within.improved < 1.2
    assert found.there > 3 * found.within.improved
    (one,) = found.inputs
    assert one["name"] == "position cart"
    assert max(np.abs(one["fitted"])) == pytest.approx(end)
    assert max(np.abs(one["asked"])) == pytest.approx(far.max())


def test_where_nothing_goes_beyond_or_nothing_stays_within_all_windows_judge(sprung: Search) -> None:
    bare, problem = sprung.progress.current, sprung.partition.problem
    far = reach(problem, sprung)
    law = ForceOfPosition([-1.0, 1.0], [SPRING, -SPRING])
    fitted = fit(problem, bare.structure.with_term(Term(law, "cart", law.guess)), None, bare.initial, most=0)
    assert beyond((bare, bare, fitted), problem, problem) is None
    assert beyond((bare, bare, bare), problem.pick(np.argsort(far)[:9]), problem) is None  # no law, nothing beyond it
    few = np.argsort(far)
    assert beyond((bare, bare, fitted), problem.pick(few[:2]), problem.pick(few[-12:])) is None


def test_laws_that_are_written_go_as_far_as_all_that_was_recorded() -> None:
    """The last quarter, where the cart goes furthest, judges a law that ends before; then it is fitted there too."""
    given = run(3, 20, 0.0, spring=SPRING, backwards=True)
    found = diagnose(mjcf.from_text(NOMINAL), [given], effects=[catalogue()["load.position:law"]], threads=1)
    assert found.held_out is not None
    assert found.beyond is not None
    assert found.held_out.improved > 3.0  # as it was predicted
    assert any(note.endswith("were fitted to all of the recordings after that.") for note in found.notes)
    assert "That was before its parameters were fitted once more" in found.improved
    assert found.to_dict()["fit"]["as_written"]["fitted_to_the_end"] is True
    table = found.missing[0].law["table"]
    (knots,) = (np.array(one["knots"]) for one in table["inputs"])
    start = given.time[0] + 0.75 * given.duration
    assert knots.max() - knots.min() > 0.95 * np.ptp(given.sensors[given.time > start])
    middle = np.abs(knots) < 0.8 * np.abs(knots).max()
    np.testing.assert_allclose(
        np.array(table["levels"])[middle], -SPRING * knots[middle], atol=0.05 * SPRING * knots.max()
    )


def test_recordings_of_their_own_judge_and_are_not_fitted() -> None:
    given, kept = run(3, 14, 0.0, spring=SPRING), run(5, 14, 0.0, spring=SPRING, backwards=True)
    found = diagnose(mjcf.from_text(NOMINAL), [given], [kept], effects=[catalogue()["load.position:law"]], threads=1)
    assert "fitted once more" not in found.improved
    assert found.to_dict()["fit"]["as_written"]["fitted_to_the_end"] is False
    assert not any("after that" in note for note in found.notes)


@pytest.mark.parametrize("count", [1, 6])
def test_what_is_said_of_them(count: int) -> None:
    ranges = {"name": "position cart", "fitted": [-0.146, 0.209], "asked": [-0.355, 0.0713]}
    found = Beyond(count, 40, 32.5, Errors(140.0, 182.0, 1.0), (ranges,))
    said = sentences.in_one_sentence("explained", [], [], Errors(129.0, 130.0, 12.6), beyond=found)
    assert f"to 12.6 times the noise; in the {40 - count} of 40 windows that stay where its laws have data" in said
    assert said.endswith("from 140 to 1 times; what is left there is as small as noise.")
    note = sentences.goes_beyond(found, fitted=False)
    assert note.startswith(f"{count} of 40 held-out windows {'goes' if count == 1 else 'go'} beyond")
    assert "position of cart from -0.355 to 0.0713, fitted from -0.146 to 0.209" in note
    assert "position of cart from -0.355" in sentences.next_experiment("explained", [], beyond=found)


def test_a_trial_judges_windows_that_go_no_further_than_its_recordings(tmp_path: Path) -> None:
    """The third of four windows goes beyond them, in its reading; the last in how fast that changes."""
    time = np.arange(400) * 0.01
    seen = np.column_stack([time, np.sin(time), 0.2 * np.sin(2 * time)])
    asked = seen.copy()
    asked[220:240, 2] += 0.1 * np.hanning(20)
    asked[350:352, 2] -= 0.1
    for name, rows in (("seen", seen), ("asked", asked)):
        np.savetxt(tmp_path / f"{name}.csv", rows, delimiter=",", header="time,motor,cart", comments="")
    windows = [{"start": float(start), "error": error} for start, error in ((0, 1.0), (1, 2.0), (2, 30.0), (3, 40.0))]
    files = [tmp_path / "seen.csv"], tmp_path / "asked.csv"
    assert error_within(*files, {"window": 1.0, "windows": windows}) == pytest.approx(np.sqrt(2.5))
    assert error_within(*files, {"window": 1.0, "windows": windows[2:]}) is None


def test_how_wide_a_load_has_swung_fades_as_its_swing_does() -> None:
    """Kicked once: while it rings out, its law may be asked where it was only known from wide swings."""
    rate, ratio = 2 * np.pi * 2.0, 0.05
    document = Document(mjcf.from_text(NOMINAL))
    hangs = Term(catalogue()["load.swinging"], "cart", {"mass": 0.1, "frequency": 2.0, "damping_ratio": ratio})
    structure = Structure(document, mjcf.compile(document.text()), ("cart",), (), (hangs,))
    time = np.arange(0.0, 4.0, 0.002)
    position = np.where(time < 0.1, 0.5 * (1 - np.cos(np.pi * time / 0.1)) * 0.02, 0.02)[:, None]
    velocity = np.gradient(position[:, 0], time)[:, None]
    motion = Motion(time, position, velocity, np.gradient(velocity, axis=0) / 0.002, np.array([1e-5]))
    physics = structure.physics(structure.first)
    (load,) = loads(physics.model).values()
    apart = np.abs(swings([physics], load, 0, motion, time)[0, 0])
    wide = swung(physics, 0, "cart", motion)
    assert (wide >= apart - 1e-12).all()
    ringing = time > 1.0
    np.testing.assert_allclose(np.diff(np.log(wide[ringing])), -ratio * rate * 0.002, atol=ratio * rate * 0.002)
    assert wide[-1] == pytest.approx(wide[time < 1.0].max() * np.exp(-ratio * rate * 3.3), rel=0.5)
    assert swung(physics, 0, "pole", motion).max() == 0.0
