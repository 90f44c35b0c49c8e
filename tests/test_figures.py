"""Figures: one look for one compensator, which everybody can tell from the others, at the widths of a journal."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest
from paper import inches

from dipc_gym.compensators import Samples, StaticGain
from dipc_gym.drawing import style
from dipc_gym.experiments import figures
from dipc_gym.runs import Course

# Linear RGB as people without one kind of cone see it: Machado, Oliveira, Fernandes, "A physiologically-based model
# for simulation of color vision deficiency", IEEE Transactions on Visualization and Computer Graphics 15 (2009), at
# severity 1.
SEEN = {
    "all cones": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
    "protanopia": [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
    "deuteranopia": [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.01182, 0.04294, 0.968881]],
    "tritanopia": [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.3039]],
}


def lab(colour: str, cones: str) -> np.ndarray:
    """CIELAB of a colour as it is seen."""
    code = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
    linear = np.where(code <= 0.04045, code / 12.92, ((code + 0.055) / 1.055) ** 2.4)
    seen = np.clip(np.array(SEEN[cones]) @ linear, 0, 1)
    xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]) @ seen
    x, y, z = np.cbrt(xyz / (0.9505, 1.0, 1.089))
    return np.array([116 * y - 16, 500 * (x - y), 200 * (y - z)])


@pytest.mark.parametrize("cones", SEEN)
def test_everybody_tells_compensators_apart(cones: str) -> None:
    looks = [*style.LOOKS.values(), *style.OTHERS[:2]]
    for one, other in itertools.combinations(looks, 2):
        assert one != other
        apart = float(np.linalg.norm(lab(one.colour, cones) - lab(other.colour, cones)))
        assert apart > 10 or one.dash != other.dash, (one, other)
    mean = np.mean(
        [np.linalg.norm(lab(a.colour, cones) - lab(b.colour, cones)) for a, b in itertools.combinations(looks, 2)]
    )
    assert mean > 35


def test_what_looked_alike_does_no_more() -> None:
    """Feedforward and ideal, which stand side by side in every figure, also in print without colour."""
    one, other = style.of("feedforward"), style.of("ideal")
    assert one.dash != other.dash
    assert abs(lab(one.colour, "all cones")[0] - lab(other.colour, "all cones")[0]) > 30


def test_compensators_of_ones_own_look_each_different() -> None:
    names = ("llnf", "mine", "yours", "none")
    looks = [style.of(name, names) for name in names]
    assert len(set(looks)) == 4
    assert style.of("mine", names) == style.of("mine", ("mine",))


def run(amplitude: float) -> Course:
    time = np.arange(0.0, 20.0, 0.005)
    state = amplitude * np.sin(time)[:, None] * np.ones(6)
    zeros = np.zeros(len(time))
    return Course(time, state, zeros, zeros, state[:, :3], 0, False)


def samples() -> Samples:
    time = np.arange(0.0, 60.0, 0.005)
    v = np.sin(2 * time)
    return Samples(40 * v, v, v, 10 * v + 2 * np.tanh(v / 0.01), time // 1 % 2 == 0)


def test_a_compensator_looks_the_same_in_every_figure() -> None:
    courses = {"none": run(0.04), "feedforward": run(0.02), "llnf": run(0.01), "ideal": run(0.001)}
    balance = figures.balancing("lqr", courses)
    for axis in balance.axes:
        assert [line.get_color() for line in axis.lines] == [style.of(name).colour for name in courses]
    data = samples()
    output = figures.model_output(0.005 * np.arange(len(data.force)), data, StaticGain(newtons_per_volt=4.0), "llnf")
    drawn = {line.get_color() for line in output.axes[0].lines}
    assert style.of("llnf").colour in drawn


def test_the_error_is_drawn_below_the_output() -> None:
    data, gain = samples(), StaticGain(newtons_per_volt=4.0)
    time = 0.005 * np.arange(len(data.force))
    picture = figures.model_output(time, data, gain, "mlp")
    error = gain.volts(data.force, data.velocity, data.previous_velocity) - data.voltage
    for axis in picture.axes:
        if "error" in axis.get_ylabel():
            line = axis.lines[0]
            shown = ~np.isnan(line.get_ydata())
            at = np.round(line.get_xdata()[shown] / 0.005).astype(int)
            np.testing.assert_allclose(line.get_ydata()[shown], error[at])
            assert not data.train[at].any()
            break
    else:
        pytest.fail("no panel shows the error")


def test_balancing_has_its_end_enlarged() -> None:
    picture = figures.balancing("lqr", {"none": run(0.04)})
    whole, end = picture.axes[:2]
    assert whole.lines[0].get_xdata()[0] == 0.0
    assert end.lines[0].get_xdata()[0] == pytest.approx(20.0 - figures.BALANCE_ZOOM, abs=0.01)
    assert end.lines[0].get_xdata()[-1] == whole.lines[0].get_xdata()[-1]


def test_figures_are_written_at_the_widths_of_a_journal(tmp_path: Path) -> None:
    figures.write(lambda width: figures.balancing("lqr", {"none": run(0.04)}, width), tmp_path / "fig12")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["fig12-narrow.pdf", "fig12.pdf", "fig12.png"]
    for name, width in (("fig12.pdf", 7.0), ("fig12-narrow.pdf", 3.4)):
        assert inches(tmp_path / name) == pytest.approx(width)
        assert b"/Type3" not in (tmp_path / name).read_bytes()  # journals refuse such fonts
