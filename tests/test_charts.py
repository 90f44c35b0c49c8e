"""Charts of the report: no peak is lost, ticks say the truth, bins find a law."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from dipc_gym.sim2real.report import charts
from dipc_gym.sim2real.report.wording import measured, number, percent, short, tied

FINITE = st.floats(-1e6, 1e6)


def points(layer: charts.Layer) -> list[np.ndarray]:
    """Coordinates of each stretch of a path."""
    return [np.array(piece.split(), float).reshape(-1, 2) for piece in layer.d.split("M") if piece]


@given(arrays(float, st.integers(2, 3000), elements=FINITE), st.integers(20, 400))
def test_thinned_line_keeps_every_peak(y: np.ndarray, most: int) -> None:
    x = np.arange(float(len(y)))
    across, up = charts.axis(0, len(y) - 1.0, "", ""), charts.axis(*charts.span([y]), "", "")
    drawn = np.concatenate(points(charts.line("after", x, y, across, up, most)))
    expected = charts.HEIGHT * (1 - up.fraction(y))
    assert drawn[:, 1].min() == pytest.approx(expected.min(), abs=0.51)
    assert drawn[:, 1].max() == pytest.approx(expected.max(), abs=0.51)
    assert np.all(np.diff(drawn[:, 0]) >= 0)
    assert len(drawn) <= max(most, 2)


@pytest.mark.parametrize("n", [400, 40_000])
def test_line_breaks_where_values_are_missing(n: int) -> None:
    x = np.arange(float(n))
    y = np.sin(x / n * 20)
    for k in range(1, 5):
        y[k * n // 5] = np.nan
    across, up = charts.axis(0, n - 1.0, "", ""), charts.axis(-1, 1, "", "")
    assert len(points(charts.line("after", x, y, across, up))) == 5
    assert charts.line("after", x, y * np.nan, across, up).d == ""


def test_gaps_finer_than_the_drawing_do_not_swell_it() -> None:
    n = 200_000
    x, y = np.arange(float(n)), np.random.default_rng(0).standard_normal(n)
    y[::3] = np.nan
    layer = charts.line("after", x, y, charts.axis(0, n - 1.0, "", ""), charts.axis(-5, 5, "", ""), 500)
    assert sum(len(p) for p in points(layer)) <= 500


@given(FINITE, st.floats(1e-9, 1e9), st.integers(3, 7))
def test_ticks_stand_where_they_say(low: float, width: float, count: int) -> None:
    axis = charts.axis(low, low + width, "reading", "m", count)
    texts = [text for _, text in axis.ticks]
    places = np.array([place for place, _ in axis.ticks])
    assert 1 <= len(texts) <= count
    assert len(set(texts)) == len(texts)
    assert np.all((places > -0.01) & (places < 100.01))
    label = re.fullmatch(r"reading(?: ([−+]) ([\d.]+) m)?, (?:(n|µ|m|k|M)?m|10([⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+) m)", axis.label)
    assert label, axis.label
    sign, offset, prefix, power = label.groups()
    raised = int(power.translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789"))) if power else 0
    scale = 10.0 ** {None: raised, "n": -9, "µ": -6, "m": -3, "k": 3, "M": 6}[prefix]
    start = float(offset or 0) * (-1 if sign == "+" else 1)
    values = np.array([float(text.replace("−", "-")) for text in texts]) * scale + start
    shown = axis.low + places / 100 * (axis.high - axis.low)
    assert values == pytest.approx(shown, abs=0.002 * (axis.high - axis.low))


def test_axis_speaks_of_small_things_in_small_units() -> None:
    assert charts.axis(-2e-5, 2e-5, "error", "rad").label == "error, µrad"
    assert charts.axis(0, 4e4, "force", "N").label == "force, kN"
    assert charts.axis(0, 1e-6, "reading", "counts").label == "reading, 10⁻⁶ counts"
    assert charts.axis(3.14159, 3.14161, "reading", "rad").label.startswith("reading − 3.1415")
    flat = charts.axis(2.0, 2.0, "", "")
    assert flat.low < 2 < flat.high
    assert charts.axis(math.nan, math.inf, "", "").high == 1


def test_bins_find_dry_friction_in_noise() -> None:
    rng = np.random.default_rng(3)
    v = rng.normal(0, 0.2, 20_000)
    centre, mean, spread = charts.binned(v, 8 * np.sign(v) + 3 * v + rng.standard_normal(len(v)), 40)
    away = np.abs(centre) > 0.02
    assert mean[away] == pytest.approx(8 * np.sign(centre[away]) + 3 * centre[away], abs=0.5)
    middle = away & (np.abs(centre) < 0.4)  # enough samples for a spread
    assert spread[middle] == pytest.approx(1.0, abs=0.15)


@given(arrays(float, st.integers(5, 300), elements=FINITE), FINITE)
def test_bins_of_a_constant_are_the_constant(x: np.ndarray, level: float) -> None:
    centre, mean, spread = charts.binned(x, np.full(len(x), level), 40)
    fine = np.isfinite(mean)
    assert mean[fine] == pytest.approx(np.full(fine.sum(), level), rel=1e-9, abs=1e-9)
    assert np.all(spread[fine] <= 1e-6 * max(1.0, abs(level)))
    assert np.all(np.diff(centre[fine]) > 0)


def test_scatter_stays_inside_and_thin() -> None:
    rng = np.random.default_rng(4)
    x, y = rng.standard_normal((2, 10_000)) * 3
    layer = charts.dots("before", x, y, charts.axis(-1, 1, "", ""), charts.axis(-1, 1, "", ""), 300)
    found = np.array([pair.split() for pair in re.findall(r"M([\d ]+)h0", layer.d)], float)
    assert len(found) == 300
    assert found.min() >= 0
    assert np.all(found <= (charts.WIDTH, charts.HEIGHT))


@given(st.floats(-1e300, 1e300))
def test_numbers_are_printed_to_three_digits(value: float) -> None:
    text = number(value).replace("−", "-").replace("\xa0", "")
    mantissa, _, power = text.partition("×10")
    raised = int(power.translate(str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789"))) if power else 0
    assert float(f"{mantissa}e{raised}") == pytest.approx(value, rel=0.0051)
    assert len(text) <= 14


def test_words_around_numbers() -> None:
    assert [number(v) for v in (None, math.nan, math.inf, 999.7, 0.0)] == ["–", "–", "∞", "1000", "0"]
    assert measured(4.8123, 0.1234).replace("\xa0", " ") == "4.81 ± 0.12"
    assert measured(4.8, None) == "4.80"
    assert percent(0.874) == "87\xa0%"
    assert percent(None) == "–"
    assert tied("11 N at rest, 0.04 m/s later") == "11\xa0N at rest, 0.04\xa0m/s later"
    assert short("a" * 30 + "b" * 30, 11) == "aaaaa…bbbbb"
