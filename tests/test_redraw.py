"""A diagnosis that was saved: its report is drawn again to the letter, and what was damaged is refused by name."""

from __future__ import annotations

import base64
import contextlib
import copy
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from test_report import RIGS, example

from dipc_gym import cli, mjcf, recording
from dipc_gym.safety.places import PlaceError
from dipc_gym.sim2real import Diagnosis, SavedError, Trace, catalogue, diagnose, redraw, save
from dipc_gym.sim2real.effects.shared.law import described
from dipc_gym.sim2real.report import page, saved
from dipc_gym.sim2real.report.folder import check_free
from dipc_gym.sim2real.verdict import details

ARM = Path(__file__).resolve().parent.parent / "examples" / "diagnose"
LAW: dict[str, Any] = described(
    "force",
    [{"name": "position x", "unit": "m", "knots": [0.0, 1.0, 3.0]}],
    [1.0, 2.0, 0.5],
    "N",
    passive=False,
)
TABLE = LAW["table"]


def keep(folder: Path, data: page.ReportData) -> Path:
    """Save what a page shows, as `save` does."""
    folder.mkdir(exist_ok=True)
    said = {"schema": "dipc-gym/diagnosis/3", **data.diagnosis, "notes": list(data.notes)}
    (folder / "diagnosis.json").write_text(json.dumps(said))
    (folder / "report.json").write_text(saved.text(saved.Drawn(data.model, data.command, data.details)))
    return folder


@pytest.fixture(scope="module")
def arm(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a real diagnosis."""
    out = tmp_path_factory.mktemp("arm") / "out"
    files = [str(ARM / name) for name in ("arm.xml", "run_1.csv", "run_2.csv")]
    assert (
        cli.main(["diagnose", *files, "--out", str(out), "--jobs", "1", "--design", str(out.parent / "next.csv")]) == 0
    )
    return out


@pytest.mark.parametrize("verdict", RIGS)
def test_a_page_is_drawn_again_to_the_letter(verdict: str, tmp_path: Path) -> None:
    data = example(verdict)
    drawn = redraw(keep(tmp_path, data)).read_text(encoding="utf-8")
    assert drawn == page.render(data)


def test_the_command_draws_a_diagnosis_again_with_no_model_beside_it(
    arm: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("diagnosis.json", "report.json"):
        shutil.copy(arm / name, tmp_path)
    assert cli.main(["report", str(tmp_path)]) == 0
    assert capsys.readouterr().out.strip() == str(tmp_path / "report.html")
    assert (tmp_path / "report.html").read_bytes() == (arm / "report.html").read_bytes()


def test_a_design_comes_with_the_diagnosis(arm: Path) -> None:
    table = np.genfromtxt(arm.parent / "next.csv", delimiter=",", names=True)
    assert table.dtype.names == ("time", "motor")
    assert 19.9 < table["time"][-1] < 20
    assert np.ptp(table["motor"]) > 1


def test_a_folder_that_is_not_there_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["report", str(tmp_path / "none")]) == 2
    assert "there is no such folder" in capsys.readouterr().err
    assert not (tmp_path / "none").exists()
    assert cli.main(["report", str(tmp_path)]) == 2
    assert "diagnosis.json: is not there, or no file; diagnose again" in capsys.readouterr().err


def changed(name: str, change: Callable[[Any], None], folder: Path) -> None:
    held = json.loads((folder / name).read_text())
    change(held)
    (folder / name).write_text(json.dumps(held))


def floats(*values: float) -> str:
    return base64.b64encode(np.array(values, dtype="<f8").tobytes()).decode()


DAMAGE: dict[str, tuple[str, Callable[[Any], None]]] = {
    r"diagnosis\.json: schema: is none of": ("diagnosis.json", lambda d: d.update(schema="dipc-gym/diagnosis/9")),
    r"diagnosis\.json: verdict: is none of consistent": ("diagnosis.json", lambda d: d.update(verdict="fine")),
    r"missing\[0\]\.share is 'much'": ("diagnosis.json", lambda d: d["missing"][0].update(share="much")),
    r"parameters\.static\.low is 'x'": (
        "diagnosis.json",
        lambda d: d["missing"][0]["parameters"]["static"].update(low="x"),
    ),
    r"located is 3; it must be a list": ("diagnosis.json", lambda d: d.update(located=3)),
    r"missing\[0\]\.law: is no table": (
        "diagnosis.json",
        lambda d: d["missing"][0].update(law={**LAW, "table": {**TABLE, "levels": [1.0]}}),
    ),
    r"missing\[0\]\.law\.table\.levels\[1\] is 'a'": (
        "diagnosis.json",
        lambda d: d["missing"][0].update(law={**LAW, "table": {**TABLE, "levels": [1.0, "a", 2.0]}}),
    ),
    r"report\.json: schema: is 'dipc-gym/report/2'": ("report.json", lambda d: d.update(schema="dipc-gym/report/2")),
    r"details\.traces\[0\]\.observed: is no base64": (
        "report.json",
        lambda d: d["details"]["traces"][0].update(observed="%%%"),
    ),
    r"details\.traces\[1\]\.time: does not rise": (
        "report.json",
        lambda d: d["details"]["traces"][1].update(
            time=floats(1, 0), observed=floats(1, 2), nominal=floats(1, 2), recalibrated=None, improved=None
        ),
    ),
    r"details\.maps\[0\]\.time: holds times that are no numbers": (
        "report.json",
        lambda d: d["details"]["maps"][0].update(time=floats(float("nan"))),
    ),
    r"details\.residuals\[0\]: SensorResidual: fields must be vectors of one length": (
        "report.json",
        lambda d: d["details"]["residuals"][0].update(before=floats(1, 2)),
    ),
    r"details\.candidates\[0\]: status of .* is none of chosen": (
        "report.json",
        lambda d: d["details"]["candidates"][0].update(status="<script>"),
    ),
    r"details: before: 'later' is none of": ("report.json", lambda d: d["details"].update(before="later")),
    r"details\.maps\[0\]\.'colour': is unknown": (
        "report.json",
        lambda d: d["details"]["maps"][0].update(colour="red"),
    ),
}


@pytest.mark.parametrize("said", DAMAGE)
def test_what_was_damaged_is_refused_by_file_and_field(said: str, tmp_path: Path) -> None:
    keep(tmp_path, example("partly explained"))
    (tmp_path / "report.html").write_text("old")
    name, change = DAMAGE[said]
    changed(name, change, tmp_path)
    with pytest.raises(SavedError, match=said):
        redraw(tmp_path)
    assert (tmp_path / "report.html").read_text() == "old"


def test_links_and_pipes_are_refused(tmp_path: Path) -> None:
    folder = keep(tmp_path / "found", example("partly explained"))
    (tmp_path / "mine.html").write_text("mine")
    (folder / "report.html").symlink_to(tmp_path / "mine.html")
    with pytest.raises(PlaceError, match="leads out of this folder"):
        redraw(folder)
    assert (tmp_path / "mine.html").read_text() == "mine"
    (folder / "report.json").unlink()
    os.mkfifo(folder / "report.json")
    with pytest.raises(SavedError, match=r"report\.json: is not there, or no file"):
        redraw(folder)


def test_a_link_that_leads_out_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    folder = keep(tmp_path / "found", example("partly explained"))
    (tmp_path / "mine.xml").write_text("mine")
    (folder / "improved.xml").symlink_to(tmp_path / "mine.xml")
    before = (folder / "diagnosis.json").read_text()
    for step in (lambda: check_free(folder, True), lambda: save(Diagnosis("consistent", "."), folder, overwrite=True)):
        with pytest.raises(PlaceError, match=r"'improved\.xml' leads out of this folder"):
            step()
    assert (tmp_path / "mine.xml").read_text() == "mine"
    assert (folder / "diagnosis.json").read_text() == before


NUMBERS = st.one_of(st.floats(), st.floats(-1e3, 1e3), st.just(0.0))
ODD = st.one_of(st.none(), st.booleans(), NUMBERS, st.text(max_size=20), st.just([]), st.just({}), st.just([[1]]))


def leaves(value: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Where everything stands in nested lists and objects."""
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    return [path, *(one for key, part in inner for one in leaves(part, (*path, key)))]


@given(data=st.data())
@settings(max_examples=120, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_change_is_drawn_or_refused_in_words(tmp_path: Path, data: st.DataObject) -> None:
    keep(tmp_path, example("partly explained"))
    name = data.draw(st.sampled_from(["diagnosis.json", "report.json"]))
    held = json.loads((tmp_path / name).read_text())
    if name == "diagnosis.json":
        held["missing"][0]["law"] = copy.deepcopy(LAW)
    *before, last = data.draw(st.sampled_from([path for path in leaves(held) if path]))
    place = held
    for key in before:
        place = place[key]
    if isinstance(place[last], str) and data.draw(st.booleans()):
        values = data.draw(st.lists(NUMBERS, max_size=12))
        for twin in ("observed", "nominal", "recalibrated", "improved", "position", "velocity", "before", "after"):
            if twin in place and last in place and data.draw(st.booleans()):
                place[twin] = floats(*values)
        place[last] = floats(*values)
    elif data.draw(st.booleans()):
        place[last] = data.draw(ODD)
    elif isinstance(place, dict):
        del place[last]
    (tmp_path / name).write_text(json.dumps(held))
    with contextlib.suppress(SavedError):
        assert "<html" in redraw(tmp_path).read_text(encoding="utf-8")


def test_what_is_kept_of_long_recordings_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of traces whole windows are kept, spread over the recording; of forces every few samples."""
    arm = mjcf.read(ARM / "arm.xml")
    runs = [recording.read(ARM / "run_1.csv", mjcf.compile(arm))]
    few = [catalogue()["friction.coulomb"]]
    whole = diagnose(arm, runs, effects=few).details
    monkeypatch.setattr(details, "MOST_SAMPLES", 300)
    some = diagnose(arm, runs, effects=few).details
    assert whole is not None
    assert some is not None
    for full, kept in ((whole.traces[0], some.traces[0]), (whole.residuals[0], some.residuals[0])):
        before, after = (one.nominal if isinstance(one, Trace) else one.before for one in (full, kept))
        assert np.isfinite(after).sum() <= 300 < np.isfinite(before).sum()
        assert set(after[np.isfinite(after)]) <= set(before)
        assert (kept.time[0], kept.time[-1]) == (full.time[0], full.time[-1])
        lengths = np.diff(np.flatnonzero(np.isnan(after)))
        assert len(set(lengths)) <= 1  # no window is cut
    assert len(some.maps[0].time) <= 300 < len(whole.maps[0].time)
    assert some.residuals[0].statement == whole.residuals[0].statement  # told by all samples


def test_a_diagnosis_of_an_earlier_schema_is_drawn_as_well(tmp_path: Path) -> None:
    """The first two call the errors on comparison windows `train`."""
    folder = keep(tmp_path, example(next(iter(RIGS))))
    said = json.loads((folder / "diagnosis.json").read_text())
    said["schema"], said["fit"]["train"] = "dipc-gym/diagnosis/2", said["fit"].pop("comparison")
    now = redraw(folder).read_text(encoding="utf-8")
    (folder / "diagnosis.json").write_text(json.dumps(said))
    assert redraw(folder).read_text(encoding="utf-8") == now
