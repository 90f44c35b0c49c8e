"""What is looked at in figures for paper."""

from __future__ import annotations

import re
from pathlib import Path


def inches(pdf: Path) -> float:
    """Width of the first page of a PDF."""
    box = re.search(rb"/MediaBox \[ *0 0 ([0-9.]+) ", pdf.read_bytes())
    assert box is not None, pdf
    return round(float(box[1]) / 72, 6)
