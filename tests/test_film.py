"""Films: what they show of runs, and how they are written."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from dipc_gym import recording
from dipc_gym.cli import main
from dipc_gym.drawing import style
from dipc_gym.experiments import film
from dipc_gym.runs import Course


class Camera:
    """A rig that is drawn as nothing, and remembers how it stood."""

    def __init__(self) -> None:
        self.states: list[np.ndarray] = []

    def reset(self, *, options: dict[str, Any]) -> None:
        self.states.append(options["state"])

    def render(self) -> np.ndarray:
        return np.zeros((340, 300, 3), np.uint8)

    def close(self) -> None:
        pass


@pytest.fixture
def camera(monkeypatch: pytest.MonkeyPatch) -> Camera:
    one = Camera()
    monkeypatch.setattr(film.gymnasium, "make", lambda *_, **__: one)
    return one


def course(amplitude: float, seconds: float = 1.0, *, fell: bool = False) -> Course:
    time = np.arange(0.0, seconds, 0.005)
    state = np.zeros((len(time), 6))
    state[:, 0] = amplitude * np.sin(2 * np.pi * time)
    zeros = np.zeros(len(time))
    return Course(time, state, zeros, zeros, state[:, :3].copy(), 0, fell)


def test_motion_is_magnified_alike_in_all_panels(camera: Camera, tmp_path: Path) -> None:
    """By the largest of them, so that a steadier rig looks steadier."""
    courses = {"none": course(0.04), "llnf": course(0.01)}
    film.shoot(courses, tmp_path / "rig.gif")
    shown = np.array(camera.states)[:, 0].reshape(-1, 2)
    assert film.magnification(courses) == 10
    np.testing.assert_allclose(np.abs(shown).max(axis=0), [0.4, 0.1], rtol=0.02)
    assert film.magnification({"none": course(0.44)}) == 1
    film.shoot({"none": course(0.04)}, tmp_path / "true.gif", magnify=1.0)
    assert np.abs(np.array(camera.states)[len(shown) * 2 :, 0]).max() <= 0.04


def test_traces_of_carts_are_drawn_in_the_compensators_colours(camera: Camera, tmp_path: Path) -> None:
    film.shoot({"none": course(0.04), "llnf": course(0.01)}, tmp_path / "rig.gif")
    with Image.open(tmp_path / "rig.gif") as picture:
        picture.seek(picture.n_frames - 1)
        pixels = np.asarray(picture.convert("RGB"), dtype=int)[340:]
    heights = {}
    for name, left in (("none", 0), ("llnf", 300)):
        red, green, blue = (int(style.of(name).colour[i : i + 2], 16) for i in (1, 3, 5))
        mine = np.abs(pixels[:, left : left + 300] - (red, green, blue)).max(axis=2) < 24
        heights[name] = np.ptp(np.flatnonzero(mine.any(axis=1)))
    assert heights["none"] > 60
    assert 0.2 < heights["llnf"] / heights["none"] < 0.4


def test_a_gif_runs_in_real_time_and_a_run_of_one_period_is_drawn(camera: Camera, tmp_path: Path) -> None:
    film.shoot({"one": course(0.01, 2.0)}, tmp_path / "two.gif")
    with Image.open(tmp_path / "two.gif") as picture:
        assert picture.n_frames * picture.info["duration"] == pytest.approx(2000, rel=0.05)
    film.shoot({"one": course(0.01, 0.005)}, tmp_path / "rig.gif")
    assert (tmp_path / "rig.gif").read_bytes().startswith(b"GIF8")


def test_mp4(camera: Camera, tmp_path: Path) -> None:
    pytest.importorskip("imageio_ffmpeg")
    film.shoot({"one": course(0.01)}, tmp_path / "rig.gif", tmp_path / "rig.mp4")
    assert (tmp_path / "rig.mp4").read_bytes()[4:8] == b"ftyp"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["rig.gif", "rig.mp4"]


def test_mp4_says_what_it_needs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(film, "ffmpeg", lambda: False)
    with pytest.raises(ImportError, match=r"imageio-ffmpeg.*\[film\]"):
        film.shoot({"one": course(0.01)}, tmp_path / "rig.mp4")
    with pytest.raises(ValueError, match=r"\.gif or \.mp4"):
        film.shoot({"one": course(0.01)}, tmp_path / "rig.avi")
    assert not list(tmp_path.iterdir())


def test_a_recording_with_other_names_and_units_is_drawn(
    camera: Camera, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.undo()  # the names are the real rig's
    run = course(0.04)
    recording.write(run.recording("log"), log := tmp_path / "log.csv")
    text = log.read_text().replace("time,motor,cart", "time,u,x", 1)
    log.write_text(text)
    seen: dict[str, Course] = {}
    monkeypatch.setattr(film, "shoot", lambda courses, *_, **__: seen.update(courses))
    render = ["render", "--out", str(tmp_path / "rig.gif"), "--recording", str(log)]
    assert main(["render", "--out", str(tmp_path / "rig.gif"), "--recording", str(log)]) == 2
    render = [*render, "--map", "u=motor", "--map", "x=cart", "--unit", "x=cm"]
    assert main(render) == 0
    np.testing.assert_allclose(seen["log"].state[:, 0], 0.01 * run.state[:, 0], atol=1e-12)
