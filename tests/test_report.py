"""The report: every verdict, strangers' strings, telephone, desk and paper."""

from __future__ import annotations

import difflib
import functools
import json
import re
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dipc_gym.sim2real.effects.shared.law import described
from dipc_gym.sim2real.report import folder, page, plots
from dipc_gym.sim2real.report.page import VERDICTS, ReportData, render
from dipc_gym.sim2real.result import Candidate, Details, Diagnosis, Errors, Mismatch, Missing, SensorResidual, Trace

WIDTHS = (390, 1280)
HOSTILE = (
    "<script>fetch('http://evil.test/')</script>",
    '"><img src=http://evil.test/x onerror=alert(1)>',
    r"$\alpha_{1}$ & \frac{a}{b}",
    "'\"&{{ 7*7 }}{% raw %}",
    "x" * 300,
    "مفصل-السلة \u202eevil\u202c",
    "🛒🔧 cart 👩‍🔬",
    "a\x00b\x1b[31m\ud800c",
)

# ------------------------------------------------------------------------------------------------ a cart as an example


@dataclass(frozen=True)
class Cart:
    """Cart on a rail: kg, N s/m, N, N above Coulomb at rest, m/s."""

    mass: float = 1.26
    viscous: float = 40.0
    coulomb: float = 0.0
    excess: float = 0.0
    stribeck: float = 0.02

    def run(self, force: np.ndarray, x: float, v: float, dt: float) -> tuple[np.ndarray, np.ndarray]:
        xs, vs = np.empty(len(force)), np.empty(len(force))
        for k, f in enumerate(force):
            xs[k], vs[k] = x, v
            hold = self.coulomb + self.excess * np.exp(-((v / self.stribeck) ** 2))
            rate = f - self.viscous * v
            free = v + dt * rate / self.mass
            v = np.sign(free) * max(abs(free) - dt * hold / self.mass, 0.0)
            x += dt * v
        return xs, vs


DT, NOISE, WINDOW = 0.002, 4e-4, 125
STICKY = Cart(coulomb=8.0, excess=3.0)
NAMES = ("nominal", "recalibrated", "improved")
RIGS = {  # truth, nominal, recalibrated, improved
    "consistent": (Cart(), Cart(), Cart(), Cart()),
    "recalibrated": (Cart(), Cart(viscous=36.0), Cart(), Cart()),
    "cannot tell": (Cart(), Cart(), Cart(), Cart()),
    "explained": (STICKY, Cart(viscous=36.0), Cart(viscous=58.0), STICKY),
    "modelled": (STICKY, Cart(viscous=36.0), Cart(viscous=58.0), STICKY),
    "partly explained": (STICKY, Cart(viscous=36.0), Cart(viscous=58.0), Cart(coulomb=8.6)),
    "unexplained": (STICKY, Cart(viscous=36.0), Cart(viscous=58.0), Cart(viscous=58.0)),
}


@functools.cache
def simulated(verdict: str, seconds: float = 10.0, seed: int = 0) -> dict[str, np.ndarray]:
    """Readings of the true cart and each model's predictions in windows, NaN between."""
    rng = np.random.default_rng(seed)
    n = int(seconds / DT)
    time = DT * np.arange(n)
    force = 16 * np.sin(2 * np.pi * 0.45 * time) + 9 * np.sin(2 * np.pi * 1.3 * time + 1)
    true, *models = RIGS[verdict]
    x, v = true.run(force, 0.0, 0.0, DT)
    found = {"time": time, "x": x, "v": v, "observed": x + NOISE * rng.standard_normal(n)}
    for name, model in zip(NAMES, models, strict=True):
        prediction = np.full(n, np.nan)
        for k in range(0, n - WINDOW, WINDOW + 5):
            prediction[k : k + WINDOW] = model.run(force[k : k + WINDOW], x[k], v[k], DT)[0]
        found[name] = prediction
        a = np.gradient(v, DT)
        hold = model.coulomb + model.excess * np.exp(-((v / model.stribeck) ** 2))
        lacking = force - model.mass * a - model.viscous * v - hold * np.sign(v)
        found[f"force {name}"] = lacking + 0.4 * rng.standard_normal(n)
    return found


def autocorrelation(values: np.ndarray, lags: int) -> np.ndarray:
    fine = np.nan_to_num(values - np.nanmean(values))
    return np.array([np.dot(fine[: len(fine) - k], fine[k:]) for k in range(lags)]) / np.dot(fine, fine)


def error(s: dict[str, np.ndarray], name: str) -> float:
    return float(np.sqrt(np.nanmean((s[name] - s["observed"]) ** 2) / np.nanmean((s["nominal"] - s["observed"]) ** 2)))


BEFORE_XML = """<mujoco model="cart">
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody>
    <body name="cart">
      <joint name="slide" type="slide" axis="1 0 0" damping="36"/>
      <geom type="box" size="0.1 0.05 0.05" mass="1.26"/>
    </body>
  </worldbody>
  <actuator>
    <motor name="drive" joint="slide"/>
  </actuator>
</mujoco>
"""
AFTER_XML = BEFORE_XML.replace(
    'damping="36"/>',
    'damping="40.1" frictionloss="11.02" solreffriction="0.002 1"/>'
    " <!-- friction.stribeck at slide: static 11.0 N, kinetic 8.0 N, Stribeck velocity 0.020 m/s -->",
).replace(
    "  </actuator>",
    '    <general name="slide_stribeck" joint="slide" gainprm="1" biasprm="0 0 310"'
    ' forcelimited="true" forcerange="-3.02 3.02"/>\n  </actuator>',
)


def interval(value: float, spread: float, unit: str) -> dict[str, Any]:
    return {"value": value, "low": value - spread, "high": value + spread, "level": 0.9, "unit": unit}


STRIBECK = {
    "effect": "friction.stribeck",
    "at": "slide",
    "sentence": "The rail holds the cart with 11.0 N at rest, but only 8.0 N once it moves.",
    "share": 0.87,
    "same_here": [{"effect": "friction.load", "at": "slide"}],
    "parameters": {
        "static": interval(11.02, 0.2, "N"),
        "kinetic": interval(8.01, 0.1, "N"),
        "stribeck_velocity": interval(0.0203, 0.004, "m/s"),
    },
    "rivals": [
        {"effect": "motor.deadzone", "at": "drive", "held_out": 0.31, "ruled_out": True},
        {"effect": "friction.coulomb", "at": "slide", "held_out": 0.17, "ruled_out": True},
        {"effect": "transmission.backlash", "at": "slide", "held_out": 0.095, "ruled_out": False},
    ],
}
DELAY = {
    "effect": "timing.delay",
    "at": "drive",
    "sentence": "The command reaches the motor 3.1 ms late.",
    "share": 0.06,
    "same_here": [],
    "parameters": {"delay": {"value": 0.0031, "low": None, "high": None, "unit": "s"}},
    "rivals": [],
}
UNKNOWN = {
    "effect": "unknown",
    "at": "slide",
    "sentence": "A force on the cart of up to 9 N that no known effect accounts for.",
    "share": None,
    "same_here": [],
    "parameters": {},
    "rivals": [],
}
SENTENCES = {
    "consistent": "Nothing is missing: the model predicts both recordings to within the encoder's noise.",
    "recalibrated": "The damping of the rail is 40 N s/m, not 36; with that, nothing is missing.",
    "explained": "Dry friction on the cart is missing: the rail holds with 11 N at rest and 8 N once it moves. "
    "With it, the error on held-out data falls by 98 %.",
    "partly explained": "Dry friction on the cart is missing and a late command is likely; together they take away "
    "80 % of the error, and something near the rail's ends remains.",
    "modelled": "A law at the cart that has no name takes the error down to the noise.",
    "unexplained": "Something acts on the cart that no known effect accounts for, mostly at velocity reversals.",
    "cannot tell": "The cart hardly moved, so these recordings cannot tell friction from a dead zone.",
}


def example(verdict: str = "explained", seed: int = 0) -> ReportData:
    """A report as the tool would fill it, from the simulated cart."""
    s = simulated(verdict, seed=seed)
    found = verdict in ("explained", "partly explained")
    refit = verdict not in ("consistent", "cannot tell")
    recalibrated = s["recalibrated"] if refit else None
    improved = s["improved"] if found else None
    first = "recalibrated" if refit else "nominal"
    held_out = {name: error(s, name) for name in NAMES}
    if not found:
        held_out["improved"] = held_out[first]
    noise = NOISE / float(np.sqrt(np.nanmean((s["nominal"] - s["observed"]) ** 2)))
    missing = {"explained": [STRIBECK], "partly explained": [STRIBECK, DELAY, UNKNOWN], "unexplained": [UNKNOWN]}
    diagnosis: dict[str, Any] = {
        "schema": "dipc-gym/diagnosis/3",
        "verdict": verdict,
        "sentence": SENTENCES[verdict],
        "located": [
            {"at": "slide", "kind": "joint", "share": 0.93, "where": "at velocity reversals, below 0.02 m/s"},
            {"at": "drive", "kind": "actuator", "share": 0.07, "where": "everywhere"},
        ]
        if verdict not in ("consistent", "cannot tell")
        else [],
        "missing": missing.get(verdict, []),
        "recalibrated": [{"parameter": "damping", "at": "slide", "was": 36.0, **interval(40.1, 0.4, "N s/m")}]
        if refit
        else [],
        "fit": {"comparison": dict(held_out), "held_out": held_out, "noise_floor": noise}
        if verdict != "cannot tell"
        else None,
        "next_experiment": "Move the cart at a steady 0.005, 0.01, 0.02 and 0.04 m/s in both directions, 10 s each: "
        "that tells a Stribeck curve from backlash.",
        "improved_model": "improved.xml",
        "needs_dipc_gym": ["motor.deadzone@drive"] if verdict == "partly explained" else [],
        "provenance": {
            "versions": {"dipc-gym": "0.1.0", "mujoco": "4.0.0", "numpy": "2.3.1"},
            "timestep": 0.001,
            "inputs": {
                f: f"{k}e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b85"[:64]
                for k, f in enumerate(("cart.xml", "sweep.csv", "steps.csv"))
            },
            "seed": 0,
        },
    }
    scaled = {name: (s[name] - s["observed"]) / NOISE for name in NAMES}
    lags = 120
    words = {
        "friction.coulomb": "Dry friction of one level",
        "friction.stribeck": "More friction at rest than in motion",
        "friction.load": "Friction that grows with load",
        "transmission.backlash": "A gap between motor and cart",
        "motor.deadzone": "The amplifier ignores small commands",
        "friction.viscous": "Drag in proportion to velocity",
    }
    rows = [
        Candidate("friction.stribeck", "slide", words["friction.stribeck"], "chosen", 1.04, 4.81, 0.12),
        Candidate("friction.load", "slide", words["friction.load"], "same model here", 1.04, 4.80, 0.12),
        Candidate("transmission.backlash", "slide", words["transmission.backlash"], "not told apart", 1.2, 4.43, 0.22),
        Candidate("friction.coulomb", "slide", words["friction.coulomb"], "ruled out", 2.4, 3.1, 0.16),
        Candidate("motor.deadzone", "drive", words["motor.deadzone"], "ruled out", 5.2, 1.9, 0.3),
        Candidate("friction.viscous", "slide", words["friction.viscous"], "ruled out", 12.3, -0.02, 0.04),
        *(Candidate(e, "slide", "x", "screened out") for e in ("load.tilt", "load.spring", "drag.quadratic")),
    ]
    return ReportData(
        model="cart.xml",
        diagnosis=diagnosis,
        details=Details(
            before=first,
            traces=(
                Trace(
                    "cart_position", "m", "steps.csv", s["time"], s["observed"], s["nominal"], recalibrated, improved
                ),
                Trace("cart_again", "m", "sweep.csv", s["time"], s["observed"], s["nominal"], recalibrated, improved),
            ),
            maps=(
                Mismatch(
                    "slide",
                    "N",
                    "m",
                    np.concatenate([s["time"][:2500], s["time"][:2500]]),
                    s["x"],
                    s["v"],
                    s[f"force {first}"],
                    s["force improved"] if found else None,
                ),
            ),
            candidates=tuple(rows[0 if found else 3 :]) if refit else (),
            residuals=(
                SensorResidual(
                    "cart_position",
                    s["time"],
                    scaled[first],
                    scaled["improved"] if found else None,
                    DT * np.arange(lags),
                    autocorrelation(scaled[first], lags),
                    autocorrelation(scaled["improved"], lags) if found else None,
                    1.96 / np.sqrt(len(s["time"])),
                    "What is left looks like noise: 96 % of the autocorrelation lies inside the band."
                    if verdict not in ("partly explained", "unexplained")
                    else "What is left does not look like noise: it remembers itself for 40 ms.",
                ),
            ),
            difference="".join(
                difflib.unified_diff(
                    BEFORE_XML.splitlines(keepends=True),
                    AFTER_XML.splitlines(keepends=True),
                    "cart.xml",
                    "improved.xml",
                )
            )
            if found
            else "",
        ),
        command="dipc-gym diagnose cart.xml sweep.csv --held-out steps.csv --out diagnosis --seed 0",
        notes=[
            "steps.csv: cart_position stays at its largest value in 3 % of the samples; these were left out.",
            "At half the time step the static level moves by 0.4 % and the verdict stays.",
        ],
    )


# ---------------------------------------------------------------------------------------------------------- in Chromium

# Rectangles of every visible piece of text, shrunk to its letters and cut by the boxes that scroll; then what is wrong.
CHECK = """
() => {
  const texts = [], wrong = [];
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  const width = document.documentElement.clientWidth;
  const background = element => {
    for (; element; element = element.parentElement) {
      const colour = getComputedStyle(element).backgroundColor;
      if (!/, 0\\)$|transparent/.test(colour)) return colour;
    }
    return 'rgb(255, 255, 255)';
  };
  const light = colour => {
    const c = colour.match(/[\\d.]+/g).slice(0, 3).map(v => v / 255);
    const [r, g, b] = c.map(v => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  while (walker.nextNode()) {
    const node = walker.currentNode, element = node.parentElement;
    if (!node.data.trim() || !element.checkVisibility() || element.closest('.off, thead')) continue;
    const style = getComputedStyle(element);
    const [a, b] = [light(style.color), light(background(element))].sort((p, q) => q - p);
    if ((a + 0.05) / (b + 0.05) < 4.5) wrong.push(`contrast: ${node.data.slice(0, 40)}`);
    const box = element.closest('[data-scroll]')?.getBoundingClientRect();
    const range = document.createRange();
    range.selectNodeContents(node);
    for (const r of range.getClientRects()) {
      const t = {node, text: node.data.trim().slice(0, 40), left: r.left, right: r.right,
                 top: r.top + r.height / 4, bottom: r.bottom - r.height / 4};
      if (box && matchMedia('screen').matches) {
        t.left = Math.max(t.left, box.left); t.right = Math.min(t.right, box.right);
        if (t.right <= t.left) continue;
      }
      if (t.left < -0.5 || t.right > width + 0.5) wrong.push(`cut off by the window: ${t.text}`);
      for (let e = element; e && !e.matches('[data-scroll]'); e = e.parentElement) {
        if (getComputedStyle(e).overflowX === 'visible') continue;
        const c = e.getBoundingClientRect();
        if (t.left < c.left - 1 || t.right > c.right + 1 || t.top < c.top - 1 || t.bottom > c.bottom + 1)
          wrong.push(`cut off by ${e.tagName}: ${t.text}`);
      }
      texts.push(t);
    }
  }
  texts.sort((a, b) => a.top - b.top);
  texts.forEach((a, i) => {
    for (let j = i + 1; j < texts.length && texts[j].top < a.bottom - 1; j++) {
      const b = texts[j];
      if (a.node !== b.node && Math.min(a.right, b.right) - Math.max(a.left, b.left) > 1
          && Math.min(a.bottom, b.bottom) - b.top > 1) wrong.push(`overlap: ${a.text} | ${b.text}`);
    }
  });
  for (const svg of document.querySelectorAll('svg')) {
    const r = svg.getBoundingClientRect();
    if (r.left < 0 || r.right > width || r.width < 150 || r.height < 80) wrong.push('chart out of place');
    for (const t of texts)
      if (t.left < r.right - 1 && t.right > r.left + 1 && t.top < r.bottom - 1 && t.bottom > r.top + 1)
        wrong.push(`text on a chart: ${t.text}`);
  }
  if (document.documentElement.scrollWidth > width) wrong.push('the page scrolls sideways');
  return {wrong: [...new Set(wrong)], seen: texts.length};
}
"""


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    path = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if path is None:
        pytest.skip("no Chromium on this computer")
    with sync_api.sync_playwright() as driver:
        chromium = driver.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield chromium
        chromium.close()


class Visit:
    """A page in the browser, and all that it tried: requests, messages, dialogs."""

    def __init__(self, browser: Any, data: ReportData, folder: Path):
        self.file = folder / "report.html"
        self.file.write_text(render(data), encoding="utf-8")
        self.requests: list[str] = []
        self.trouble: list[str] = []
        self.page = browser.new_page(viewport={"width": WIDTHS[0], "height": 800})
        self.page.route("**/*", self._asked)
        self.page.on("console", lambda message: self.trouble.append(message.text))
        self.page.on("pageerror", lambda error: self.trouble.append(str(error)))
        self.page.on("dialog", lambda dialog: (self.trouble.append(dialog.message), dialog.dismiss()))
        self.page.goto(self.file.as_uri())

    def _asked(self, route: Any) -> None:
        if route.request.url == self.file.as_uri():
            route.continue_()
        else:
            self.requests.append(route.request.url)
            route.abort()

    def looks(self) -> None:
        """Assert that all can be read at both widths and on paper, and that nothing was asked for."""
        for width in WIDTHS:
            self.page.set_viewport_size({"width": width, "height": 800})
            found = self.page.evaluate(CHECK)
            assert found["wrong"] == [], f"at {width} px"
            assert found["seen"] > 20
        self.page.emulate_media(media="print")
        self.page.set_viewport_size({"width": 680, "height": 960})  # A4 without its margins
        assert self.page.evaluate(CHECK)["wrong"] == [], "on paper"
        self.page.emulate_media(media="screen")
        assert self.requests == []
        assert self.trouble == []


@pytest.mark.parametrize("verdict", VERDICTS)
def test_every_verdict_reads_well(browser: Any, tmp_path: Path, verdict: str) -> None:
    visit = Visit(browser, example(verdict), tmp_path)
    visit.looks()
    page = visit.page
    assert page.locator("h1").inner_text().replace("\xa0", " ") == SENTENCES[verdict]
    assert verdict in page.locator(".badge").inner_text()
    assert page.locator("#missing").count() == (verdict in ("explained", "partly explained", "unexplained"))
    assert page.locator("#change").count() == (verdict in ("explained", "partly explained"))
    levels = page.evaluate("[...document.querySelectorAll('h1, h2, h3')].map(h => +h.tagName[1])")
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(b - a <= 1 for a, b in pairwise(levels))
    assert page.evaluate("[...document.querySelectorAll('svg')].every(s => s.getAttribute('aria-label').length > 10)")
    assert page.locator("th:not([scope])").count() == 0
    targets = page.evaluate("[...document.querySelectorAll('nav a')].map(a => a.getAttribute('href'))")
    assert all(page.locator(target).count() == 1 for target in targets)
    page.close()


def test_held_out_bars_are_to_scale(browser: Any, tmp_path: Path) -> None:
    data = example("explained")
    visit = Visit(browser, data, tmp_path)
    for width in WIDTHS:
        visit.page.set_viewport_size({"width": width, "height": 800})
        size = {
            name: visit.page.locator(f".bars .{name} i").bounding_box()["width"] for name in ("nominal", "recalibrated")
        }
        held_out = data.diagnosis["fit"]["held_out"]
        assert size["recalibrated"] / size["nominal"] == pytest.approx(held_out["recalibrated"], abs=0.01)
        bar, line = visit.page.locator(".bars .nominal i").bounding_box(), visit.page.locator(".bars s").first
        floor = (line.bounding_box()["x"] - bar["x"]) / bar["width"]
        assert floor == pytest.approx(data.diagnosis["fit"]["noise_floor"], abs=0.01)
    visit.page.close()


def test_the_check_finds_what_is_wrong(browser: Any, tmp_path: Path) -> None:
    visit = Visit(browser, example(), tmp_path)
    for style, complaint in {
        "h1 { margin-bottom: -60px }": "overlap",
        ".kicker { white-space: nowrap; margin-left: 330px }": "cut off",
        ".bars dt { white-space: nowrap; width: 30px; overflow: hidden }": "cut off by DT",
        "footer { width: 2000px; max-width: none }": "sideways",
        ".chart .y span { margin-right: -30px }": "text on a chart",
        "h2 { color: #ccc }": "contrast",
    }.items():
        style_tag = visit.page.add_style_tag(content=style)
        assert any(complaint in w for w in visit.page.evaluate(CHECK)["wrong"]), style
        style_tag.evaluate("element => element.remove()")
    assert visit.page.evaluate(CHECK)["wrong"] == []
    visit.page.close()


def haunted(value: Any, text: str) -> Any:
    """The same data with every string that a stranger may choose replaced."""
    if isinstance(value, str):
        return text
    if isinstance(value, dict):
        fixed = ("verdict", "schema", "kind")
        free = ("parameters", "inputs", "versions")
        return {
            key: {f"{text}{i}": haunted(v, text) for i, v in enumerate(part.values())}
            if key in free
            else part
            if key in fixed or (key == "effect" and part == "unknown")
            else haunted(part, text)
            for key, part in value.items()
        }
    if isinstance(value, list | tuple):
        return [haunted(part, text) for part in value]
    if isinstance(value, ReportData):
        return replace(
            value,
            **{name: haunted(getattr(value, name), text) for name in ("model", "diagnosis", "details")},
            **{name: haunted(getattr(value, name), text) for name in ("command", "notes")},
        )
    if isinstance(value, Details):
        return replace(
            value,
            **{name: haunted(getattr(value, name), text) for name in ("traces", "maps", "candidates", "residuals")},
            difference=f"--- {text}\n+++ {text}\n@@\n-{text}\n+{text}",
        )
    names = {Trace: ("sensor", "unit", "recording"), Mismatch: ("joint", "unit", "position_unit")}
    names |= {Candidate: ("effect", "at", "words"), SensorResidual: ("sensor", "statement")}
    return replace(value, **dict.fromkeys(names[type(value)], text)) if type(value) in names else value


@pytest.mark.parametrize("text", HOSTILE, ids=range(len(HOSTILE)))
def test_strangers_strings_stay_text(browser: Any, tmp_path: Path, text: str) -> None:
    visit = Visit(browser, haunted(example("partly explained"), text), tmp_path)
    visit.looks()
    page = visit.page
    assert page.locator("script, img, iframe, object, link:not([rel=icon])").count() == 0
    assert page.evaluate(
        "[...document.querySelectorAll('*')].every(e => ![...e.attributes].some(a => /^on/.test(a.name)))"
    )
    if text.isprintable() and len(text) < 60:
        for where in ("h1", ".missing h3", "#candidates th .words, #candidates th.words", "pre .add", "#notes li"):
            assert text.replace(" ", "") in re.sub(r"\s", "", page.locator(where).first.inner_text()), where
    assert not set("\u202e\x00\x1b") & set(visit.file.read_text(encoding="utf-8"))
    page.close()


def test_paper_has_sensible_pages(browser: Any, tmp_path: Path) -> None:
    visit = Visit(browser, example("partly explained"), tmp_path)
    pdf = visit.page.pdf(prefer_css_page_size=True)
    assert 3 <= len(re.findall(rb"/Type\s*/Page\b", pdf)) <= 6
    visit.page.emulate_media(media="print")
    assert visit.page.locator("details p").is_visible()
    visit.page.close()


# ------------------------------------------------------------------------------------------------------------- the file


def test_page_is_one_file_that_asks_for_nothing() -> None:
    page = render(example())
    assert "<script" not in page
    assert set(re.findall(r"(?:href|src)=\"([^\"#]*)", page)) == {"", "data:,"}
    assert "url(" not in page
    assert "@import" not in page
    assert "default-src 'none'" in page


def test_largest_page_stays_below_two_megabytes() -> None:
    rng = np.random.default_rng(1)
    n, name = 60_000, "n" * 300
    time = DT * np.arange(n)
    wild = [rng.standard_normal(n) for _ in range(4)]
    for w in wild[1:]:
        w[::7] = np.nan
    details = Details(
        traces=(Trace(name, "m", name, time, *wild),) * 60,
        maps=(Mismatch(name, "N", "m", time, *wild),) * 30,
        residuals=(SensorResidual(name, time, wild[1], wild[2], time, wild[1], wild[2], 0.1, name),) * 60,
        candidates=(Candidate(name, name, name, "ruled out", 1.0, 2.0, 0.1),) * 100
        + (Candidate(name, name, name, "screened out"),) * 500,
        difference="\n".join(["+" + name] * 20_000),
    )
    data = replace(haunted(example("partly explained"), name), details=details)
    drawn = render(data)
    assert len(drawn.encode()) <= 2_000_000
    assert "44 more sensors" in drawn  # what is not drawn is said
    assert "19600 more lines" in drawn


def test_unknown_words_are_refused() -> None:
    data = example()
    with pytest.raises(ValueError, match="verdict 'fine' is none of consistent"):
        render(replace(data, diagnosis={**data.diagnosis, "verdict": "fine"}))
    with pytest.raises(ValueError, match=r"status of friction\.load: 'good'"):
        Candidate("friction.load", "slide", "words", "good")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="Trace: fields must be vectors of one length"):
        Trace("x", "m", "a.csv", np.zeros(4), np.zeros(4), np.zeros(3))


def test_what_was_fitted_is_not_called_unseen() -> None:
    data = example()
    drawn = render(data)
    assert "Error on data that was not used" in drawn
    assert "on held-out data" in drawn
    fitted = {**data.diagnosis, "fit": {**data.diagnosis["fit"], "held_out_was_fitted": True}}
    drawn = render(replace(data, diagnosis=fitted))
    assert "Error on data that was fitted as well" in drawn
    assert "no fit has touched" not in drawn
    assert "on data that was fitted as well</h2>" in drawn


def test_a_model_that_diverges_is_still_given_in_multiples_of_the_noise() -> None:
    """An error that was cut off at a million, and 1.4 with the missing physics: the quotient of two small shares."""
    told = Diagnosis("explained", "", comparison=Errors(1e6, 1e5, 1.4), held_out=Errors(1e6, 1e5, 1.4)).to_dict()["fit"]
    assert told["held_out"]["improved"] / told["noise_floor"] == pytest.approx(1.4, rel=1e-5)


def test_what_was_left_out_is_called_ruled_out_where_it_was() -> None:
    data = example()
    many = [Candidate("friction.load", f"joint {k}", "words", "ruled out") for k in range(40)]
    told = {"ruled out": "10 more were fitted and ruled out.", "not told apart": "10 more were fitted."}
    for status, said in told.items():
        rows = tuple(replace(one, status=status) for one in many)
        assert said in render(replace(data, details=replace(data.details, candidates=rows)))


@pytest.mark.parametrize("broken", ["law", "trace", "render"])
def test_a_figure_that_cannot_be_drawn_loses_no_diagnosis(
    broken: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: object, **__: object) -> None:
        raise ArithmeticError("<nothing> to draw")

    data = example()
    monkeypatch.setattr(page if broken == "render" else plots, broken, fails)
    along = [{"name": "position x", "unit": "m", "knots": [0.0, 1.0]}]
    table = described("force", along, [1.0, 2.0], "N", passive=True)
    lacking = Missing("friction.position", "x", "Friction at x.", 1.0, law=table)
    found = Diagnosis("explained", "Friction & more.", missing=(lacking,), improved="<mujoco/>", details=data.details)
    folder.save(found, tmp_path, model="x.xml", command="dipc-gym diagnose")
    assert json.loads((tmp_path / "diagnosis.json").read_text())["missing"][0]["law"]["table"]
    assert (tmp_path / "improved.xml").read_text() == "<mujoco/>"
    said = (tmp_path / "report.html").read_text()
    assert "could not be drawn (ArithmeticError: &lt;nothing&gt; to draw)" in said
    assert "Friction &amp; more." in said


def test_a_model_s_own_file_is_not_replaced_by_one_of_the_diagnosis(tmp_path: Path) -> None:
    found = Diagnosis("consistent", "Nothing is missing.", improved="<mujoco/>", files={"report.json": b"mine"})
    with pytest.raises(ValueError, match=r"own file report\.json is called as a file of the diagnosis"):
        folder.save(found, tmp_path / "out", model="x.xml", command="")
    assert not (tmp_path / "out").exists()


def test_while_results_are_replaced_a_folder_has_no_diagnosis(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Killed in between, it holds what is new beside what is old: nobody takes that for one diagnosis."""
    found = Diagnosis("consistent", "Nothing is missing.", improved="<mujoco/>")
    folder.save(found, tmp_path, model="x.xml", command="")

    replace_file = Path.replace

    def stop(self: Path, target: Path) -> Path:
        if target.parent == tmp_path:
            raise KeyboardInterrupt
        return replace_file(self, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", stop)
        with pytest.raises(KeyboardInterrupt):
            folder.save(found, tmp_path, model="x.xml", command="", overwrite=True)
    assert not (tmp_path / "diagnosis.json").exists()


@pytest.mark.parametrize("nominal", [None, 1.0])
def test_sparse_and_broken_numbers_still_make_a_page(browser: Any, tmp_path: Path, nominal: float | None) -> None:
    gone = np.full(50, np.nan)
    huge = np.linspace(-1e300, 1e300, 50)
    time = np.arange(50.0)
    data = ReportData(
        "cart.xml",
        {
            "verdict": "cannot tell",
            "sentence": "Nothing moved.",
            "fit": {
                "held_out": {"nominal": nominal, "recalibrated": float("inf")},
                "noise_floor": None,
                "held_out_by_sensor": {  # of a model whose predictions diverge, and a sensor that never changes
                    "x": {
                        "unit": "rad",
                        "noise": None,
                        "motion": 0.0,
                        "error": {"nominal": None, "recalibrated": float("inf"), "improved": 0.01},
                        "share_of_motion": {"nominal": None, "recalibrated": None, "improved": None},
                    }
                },
            },
        },
        Details(
            traces=(Trace("x", "m", "a.csv", time, gone, gone), Trace("x", "m", "a.csv", time, time, huge, gone, huge)),
            maps=(Mismatch("j", "N", "m", time, gone, 0 * time, huge),),
            residuals=(SensorResidual("x", time, gone, None, time, gone, None, np.nan, "Cannot be told."),),
            candidates=(Candidate("a", "b", "c", "ruled out", float("inf"), float("nan"), None),),
        ),
    )
    visit = Visit(browser, data, tmp_path)
    visit.looks()
    assert "nan" not in visit.page.locator("main").inner_text().lower()
    assert ("0.573 degrees" in visit.page.locator("main").inner_text()) == (nominal is not None)
    assert not re.search(r"\b(nan|inf)\b", "".join(re.findall(r'(?: d|style)="([^"]*)"', visit.file.read_text())))
    visit.page.close()
