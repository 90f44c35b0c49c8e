"""Numbers and strangers' strings as a reader should meet them in the report."""

from __future__ import annotations

import math
import re
import unicodedata

from dipc_gym.sim2real.report.charts import superscript

NBSP = "\u00a0"  # a space that does not break
MOST_CHARACTERS = 4000  # of any one text


def number(value: float | None, digits: int = 3) -> str:
    """A few digits that count, with a true minus and raised powers; a dash if there is no value."""
    if value is None or math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    if value == 0:
        return "0"
    if 1e-3 <= abs(value) < 1e5:
        text = f"{value:#.{digits}g}"
        return (f"{value:.0f}" if "e" in text else text.rstrip(".")).replace("-", "−")
    mantissa, power = f"{value:.{digits - 1}e}".split("e")
    return f"{mantissa} × 10{superscript(int(power))}".replace("-", "−").replace(" ", NBSP)


def percent(share: float | None) -> str:
    """A share in whole percent."""
    return "–" if share is None or not math.isfinite(share) else f"{100 * share:.0f}{NBSP}%".replace("-", "−")


def fine_percent(share: float | None) -> str:
    """A share in percent, to two digits however small it is."""
    return "–" if share is None or not math.isfinite(share) else f"{number(100 * share, 2)}{NBSP}%"


def measured(value: float | None, error: float | None) -> str:
    """A number with its standard error, both to the second digit of the error."""
    if value is None or error is None or not (math.isfinite(value) and 0 < error < 1e5):
        return number(value)
    decimals = max(0, 1 - math.floor(math.log10(error)))
    return f"{value:.{decimals}f}{NBSP}±{NBSP}{error:.{decimals}f}".replace("-", "−")


def tied(text: str) -> str:
    """A sentence whose numbers stay on one line with their short units."""
    return re.sub(r"(?<=\d) (?=\S{1,4}(?:[\s.,;:)]|$))", NBSP, text)


def short(text: object, most: int = 48) -> str:
    """A name with its middle left out if it is too long for a label."""
    text = str(text)
    return text if len(text) <= most else f"{text[: most // 2]}…{text[-most // 2 + 1 :]}"


def clean(value: object) -> object:
    """Of a text: nothing that turns the direction of a line, is invisible control, or has no encoding."""
    if not isinstance(value, str) or hasattr(value, "__html__"):
        return value
    if len(value) > MOST_CHARACTERS:
        value = value[:MOST_CHARACTERS] + "…"
    return "".join(_visible(c) for c in value)


def _visible(c: str) -> str:
    turns = unicodedata.bidirectional(c) in ("LRE", "RLE", "LRO", "RLO", "PDF", "LRI", "RLI", "FSI", "PDI")
    hidden = unicodedata.category(c) in ("Cc", "Cs") and c not in "\n\t"
    return "\ufffd" if turns or hidden else c
