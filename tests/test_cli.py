"""The command line: help that teaches and comes at once, and errors without a traceback."""

from __future__ import annotations

import dataclasses
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import dipc_gym
from dipc_gym import compensators, estimators, policy, recording
from dipc_gym.cli import COMMANDS, main
from dipc_gym.plant import Friction, Plant
from dipc_gym.runs import identify


def test_help_loads_nothing_heavy() -> None:
    """What takes seconds to import is imported where it is needed."""
    code = "import sys; from dipc_gym.cli import main; main(['--help'])"
    watch = "import atexit, sys; atexit.register(lambda: print('loaded:', *sys.modules, file=sys.stderr)); "
    shown = subprocess.run([sys.executable, "-c", watch + code], capture_output=True, text=True, check=True)
    assert all(name in shown.stdout for name in COMMANDS)
    loaded = set(shown.stderr.split("loaded:")[1].split())
    assert not loaded & {"torch", "matplotlib", "scipy", "stable_baselines3", "ray", "numba"}


def test_help_does_not_load_what_it_does_not_need() -> None:
    code = (
        "import sys, dipc_gym.cli as c\ntry: c.main(['--help'])\nexcept SystemExit: pass\n"
        "print([m for m in ('torch', 'matplotlib', 'scipy', 'mujoco', 'joblib', 'PIL') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


@pytest.mark.parametrize("name", sorted(COMMANDS))
def test_every_command_teaches(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main([name, "--help"])
    assert stop.value.code == 0
    shown = capsys.readouterr().out
    assert f"dipc-gym {name}" in shown
    assert "Try:" in shown


def test_train_record_render_go_together(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plant, sweep, llnf, run = (str(tmp_path / name) for name in ("rig.json", "sweep.csv", "llnf.json", "run.csv"))
    Plant(friction=Friction(coulomb=6.0, static=8.0)).write(plant)
    assert main(["record", "--out", sweep, "--experiment", "identification", "--plant", plant]) == 0
    assert main(["train", "--out", llnf, "--recording", sweep, "--plant", plant]) == 0
    trained = compensators.load(llnf)
    assert trained.name == "llnf"
    assert main(["record", "--out", run, "--compensator", llnf, "--plant", plant, "--seconds", "2"]) == 0
    assert "400 samples" in capsys.readouterr().out
    assert len(Path(run).read_text().splitlines()) == 401
    # An estimator of the same run, saved beside.
    saved = str(tmp_path / "mine.json")
    fit = ["train", "--out", saved, "--compensator", "observed", "--estimator", "disturbance", "--recording", sweep]
    assert main([*fit, "--plant", plant]) == 0
    assert estimators.load(tmp_path / "mine_disturbance.json").dry.coulomb == pytest.approx(6.0, rel=0.05)
    assert main([*fit, "--plant", plant, "--overwrite"]) == 0
    Path(saved).unlink()
    assert main([*fit, "--plant", plant]) == 2
    assert "mine_disturbance.json exists" in capsys.readouterr().err
    # The simulated run, identified directly, trains nearly the same network as its recording, which is smoothed.
    assert main(["train", "--out", str(tmp_path / "direct.json"), "--plant", plant]) == 0
    direct = compensators.load(tmp_path / "direct.json")
    assert direct.figures.test_mse == pytest.approx(trained.figures.test_mse, rel=0.1)


def test_a_recording_in_another_unit_is_not_trained_from(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """And --map and --unit do what the refusal asks for."""
    run = identify(seed=1).run
    recording.write(run, tmp_path / "metres.csv")
    in_mm = dataclasses.replace(run, sensors=1000 * run.sensors)
    recording.write(in_mm, log := tmp_path / "log.csv")
    log.write_text(log.read_text().replace("time,motor,cart", "time,motor,x", 1))
    train = ["train", "--compensator", "feedforward", "--overwrite", "--out", str(tmp_path / "mine.json")]
    assert main([*train, "--recording", str(log), "--map", "x=cart"]) == 2
    assert "looks like millimetres; say --unit cart=mm" in capsys.readouterr().err
    assert main([*train, "--recording", str(log), "--map", "x=cart", "--unit", "cart=mm"]) == 0
    assert "millimetres" not in capsys.readouterr().out
    mine = compensators.load(tmp_path / "mine.json").to_dict()["parameters"]
    assert main([*train, "--recording", str(tmp_path / "metres.csv")]) == 0
    assert compensators.load(tmp_path / "mine.json").to_dict()["parameters"] == pytest.approx(mine)
    log.write_text(log.read_text().replace("time,motor,x", "time,motor,cart", 1))
    assert main(["compare", "--out", str(tmp_path / "out"), "--recording", str(log)]) == 2
    assert "looks like millimetres" in capsys.readouterr().err


OBSERVED = str(Path(policy.__file__).parent / "policies" / "ppo-observed.json")


def test_a_policy_sees_through_a_saved_estimator_of_its_kind(tmp_path: Path) -> None:
    saved = tmp_path / "filter.json"
    estimators.save(identify().fit_estimator("disturbance"), saved)
    seen = ["--controller", OBSERVED, "--estimator", str(saved), "--compensator", "observed"]
    assert main(["record", "--out", str(tmp_path / "run.csv"), *seen, "--seconds", "1"]) == 0


def test_a_policy_behind_another_compensator_is_said_to_be(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = ["record", "--out", str(tmp_path / "run.csv"), "--controller", OBSERVED, "--seconds", "0.1"]
    assert main(run) == 0
    assert "trained with" not in capsys.readouterr().out
    assert main([*run, "--overwrite", "--compensator", "none"]) == 0
    assert "was trained with the compensator 'observed', not with 'none'" in capsys.readouterr().out


@pytest.mark.parametrize("controller", ["lqr_cart", OBSERVED])
def test_a_run_is_recorded_through_an_estimator(controller: str, tmp_path: Path) -> None:
    """A policy brings its own, and its compensator. After 10 s the cart strays as docs/rejection.md has it, by the
    worst of its rigs: so does the middle one of five, for how far a limit cycle goes differs by a fifth by rounding.
    """
    out = tmp_path / "run.csv"
    seen = [] if controller == OBSERVED else ["--estimator", "disturbance"]
    behind = [] if controller == OBSERVED else ["--compensator", "observed"]
    run = ["record", "--out", str(out), "--overwrite", "--controller", controller, *seen, *behind, "--seconds", "20"]
    most = []
    for seed in range(5):
        assert main([*run, "--seed", str(seed)]) == 0
        cart = np.loadtxt(out, delimiter=",", skiprows=1)[:, 2]
        most.append(np.abs(cart[len(cart) // 2 :]).max())
    assert np.median(most) < (0.0115 if controller == "lqr_cart" else 0.045)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["compare", "--out", "full"], "choose another folder"),
        (["compare", "--out", "new", "--robustness", "all,scor"], "did you mean 'score'?"),
        (["train-policy", "--out", "new", "--plan", "over.json"], "say --task swing-up too"),
        (["render", "--magnify", "10"], "whatever --magnify says"),
        (["compare", "--out", "new", "--controller", "pid"], "there is no controller 'pid'"),
        (["compare", "--out", "new", "--controller", "lqrr"], "did you mean 'lqr'?"),
        (["compare", "--out", "new", "--estimator", "kalmann"], "did you mean 'kalman'?"),
        (["comapre", "--out", "new"], "did you mean 'compare'?"),
        (["compare", "--out", "new", "--compensator", "lnlf"], "did you mean 'llnf'?"),
        (["compare", "--out", "new", "--robustness", "fricton"], "did you mean 'friction'?"),
        (["train-policy", "--out", "new", "--algo", "pp0"], "did you mean 'ppo'?"),
        (["train-policy", "--out", "new", "--task=swingup"], "did you mean 'swing-up'?"),
        (["train-policy", "--out", "new", "--engine", "compield"], "did you mean 'compiled'?"),
        (["trial", "--out", "new", "--count", "0"], "1 or more"),
        (["train-policy", "--out", "new", "--resume"], "no training to go on with"),
        (["train", "--out", "new.txt"], "new.txt: this is written as .json"),
        (["render", "--out", "new.gif", "--map", "x=cart"], "--recording"),
        (["render", "--out", "new.gif", "--recording", "r.csv", "--controller", "x"], "whatever --controller says"),
        (["render", "--out", "new.gif", "--recording", "r.csv", "--seed", "5"], "whatever --seed says"),
        (["train", "--out", "new.json", "--map", "x=cart"], "of a --recording are; name one"),
        (["train", "--out", "new.json", "--seed", "-1"], "--seed -1: it must be a whole number from 0 on"),
        (
            ["record", "--out", "new.csv", "--experiment=identification", "--seconds=5", "--controller", "x"],
            "whatever --controller and --seconds say; leave it out",
        ),
        (["trial", "--out", "new", "--limit=-1"], "--limit is -1.0; it is a number of seconds above 0"),
        (["trial", "--out", "new", "--limit", "nan"], "--limit is nan"),
        (["trial", "--out", "new", "--rivals", "--limit", "60"], "leave one of them out"),
        (["trial", "--out", "new", "--count", "two"], "--count two: it must be a whole number"),
        (["trial", "--out", "new", "--limit=long"], "--limit long: it must be a number"),
        (["compare", "--out", "new", "--seeds", "0"], "--seeds is 0; it must be 1 or more"),
        (["compare", "--out", "new", "--seconds", "0"], "--seconds is 0; it must be more than 0"),
        (["compare", "--out", "new", "--estimator", ","], "--estimator names none"),
        (["compare", "--out", "new", "--compensator", "x,y"], "there is no compensator 'x'"),
        (["train", "--out", "full/file"], "exists"),
        (["train", "--out", "new.json", "--compensator", "x"], "there is no compensator 'x'"),
        (["train", "--out", "new.json", "--estimator", "x"], "there is no estimator 'x'"),
        (["train", "--out", "no/new.json"], "there is no folder"),
        (["train", "--out", "new.json", "--recording", "none.csv"], "none.csv"),
        (["record", "--out", "new.csv", "--plant", "full/file"], "not JSON"),
        (["record", "--out", "new.mat", "--seconds", "0.5"], "new.mat"),
        (["record", "--out", "new.csv", "--compensator", "none", "--seconds", "inf"], "must be finite"),
        (["record", "--out", "new.csv", "--compensator", "observed", "--seconds", "1"], "such as 'disturbance'"),
        (["record", "--out", "new.csv", "--estimator", "disturbanse"], "did you mean 'disturbance'?"),
        (["record", "--out", "new.csv", "--controller", OBSERVED, "--estimator", "kalman"], "--estimator disturbance"),
        (["render", "--out", "new.gif", "--compensator", "none", "--seconds", "0"], "at least one control period"),
        (["render", "--out", "new.png"], ".gif or .mp4"),
        (["render", "--out", "new.gif", "--model", "full/file"], "full/file"),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(
    arguments: list[str],
    says: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "file").write_text("precious")
    assert main(arguments) == 2
    said = capsys.readouterr().err
    assert says in said
    assert "Traceback" not in said
    assert (tmp_path / "full" / "file").read_text() == "precious"
    assert [path.name for path in tmp_path.iterdir()] == ["full"]


@pytest.mark.parametrize("name", sorted(COMMANDS.keys() - {"render"}))  # which opens a window
def test_a_command_without_arguments_says_which_it_needs(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main([name])
    assert stop.value.code == 2
    assert "required" in capsys.readouterr().err.lower()


def test_arguments_are_checked_before_what_has_to_be_installed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for module in ("dipc_gym.trials.run", "dipc_gym.trials.generate"):
        monkeypatch.setitem(sys.modules, module, None)  # as where numba is missing
    assert main(["trial", "--out", str(tmp_path / "new"), "--count", "0"]) == 2
    assert "--count is 0" in capsys.readouterr().err


def test_diagnose_says_what_is_wrong_with_its_files(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """What a first try gets wrong: the order of the files, the unit of time, an actuator without a name."""
    folder = Path(__file__).resolve().parent.parent / "examples" / "diagnose"
    model, good, late, bare = folder / "arm.xml", folder / "run_1.csv", tmp_path / "ms.csv", tmp_path / "bare.xml"
    header, *rows = good.read_text().splitlines()
    assert header.startswith("time,")
    cells = [row.split(",", 1) for row in rows]
    late.write_text("\n".join([header, *(f"{1e3 * float(time)!r},{rest}" for time, rest in cells)]))
    bare.write_text(model.read_text().replace('<dcmotor name="motor"', "<dcmotor"))
    for arguments, says in (
        ((good, model), "run_1.csv: is no MJCF"),
        ((model, late), "or is time in ms? Then say --unit time=ms"),
        ((bare, good), "bare.xml: actuator 0 has no name"),
    ):
        assert main(["diagnose", *map(str, arguments), "--out", str(tmp_path / "found")]) == 2
        assert says in capsys.readouterr().err


def test_no_result_takes_the_place_of_what_it_is_found_from(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A second pass on what the first one wrote, in the same folder."""
    folder = Path(__file__).resolve().parent.parent / "examples" / "diagnose"
    model, run = tmp_path / "improved.xml", tmp_path / "run.csv"
    model.write_text((folder / "arm.xml").read_text())
    run.write_text((folder / "run_1.csv").read_text())
    again = ["diagnose", str(model), str(run), "--out", str(tmp_path), "--overwrite"]
    assert main(again) == 2
    assert "improved.xml would be replaced by what is found from it" in capsys.readouterr().err
    assert main([*again[:-3], "--out", str(tmp_path / "out"), "--overwrite", "--design", str(run)]) == 2
    assert "run.csv: that file is read" in capsys.readouterr().err
    held = ["--fix", "arm.mass", "--prior", "arm.mass=1+-0.1"]
    assert main([*again[:-3], "--out", str(tmp_path / "out"), *held]) == 2
    assert "what is held has no spread" in capsys.readouterr().err
    assert model.read_text() == (folder / "arm.xml").read_text()


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"dipc-gym {dipc_gym.__version__}\n"


def test_a_fault_of_linear_algebra_keeps_its_traceback(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dipc_gym.runs.identify", lambda *_, **__: np.linalg.inv(np.zeros((2, 2))))
    with pytest.raises(np.linalg.LinAlgError):
        main(["train", "--out", str(tmp_path / "new.json")])


def test_window_needs_a_display(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    assert main(["render", "--seconds", "0.1"]) == 2
    assert "no display" in capsys.readouterr().err
