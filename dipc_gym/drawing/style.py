"""One look for all figures, and one for each compensator in every figure and film: a colour and a dash.

Colours are those of Okabe and Ito, "Color universal design" (2008), which people with any colour vision tell apart;
dashes tell curves apart in print without colour, and where two colours are equally dark.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, BinaryIO

from dipc_gym.drawing.canvas import settings

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "BLACK",
    "BLUE",
    "GREEN",
    "GREY",
    "LOOKS",
    "NARROW",
    "ORANGE",
    "OTHERS",
    "PURPLE",
    "SIZES",
    "SKY",
    "VERMILION",
    "WIDE",
    "YELLOW",
    "Look",
    "of",
    "text",
    "write",
]

Dash = str | tuple[float, tuple[float, ...]]

BLACK, ORANGE, SKY, GREEN, YELLOW, BLUE, VERMILION, PURPLE = (
    *("#000000", "#E69F00", "#56B4E9", "#009E73"),
    *("#F0E442", "#0072B2", "#D55E00", "#CC79A7"),
)
GREY = "#8A8F98"
NARROW, WIDE = 3.4, 7.0  # inches: one column of a journal, and two
SIZES = ((WIDE, ".png", 9), (WIDE, ".pdf", 8), (NARROW, "-narrow.pdf", 6))
"""Of a figure: inches, what follows the stem of its file's name, points of its text."""


@dataclass(frozen=True)
class Look:
    """How the curves of one compensator are drawn.

    Attributes:
        colour: hexadecimal, as matplotlib and Pillow read it.
        dash: a line style of matplotlib.
    """

    colour: str
    dash: Dash

    @property
    def line(self) -> dict[str, Any]:
        """Keywords for `Axes.plot`."""
        return {"color": self.colour, "linestyle": self.dash}


LOOKS = {
    "none": Look(VERMILION, "-"),
    "feedforward": Look(PURPLE, (0, (5, 1.5, 1, 1.5))),
    "mlp": Look(BLUE, "--"),
    "llnf": Look(GREEN, "-"),
    "ideal": Look(BLACK, (0, (1, 1.2))),
}
OTHERS = (Look(ORANGE, "--"), Look(SKY, "-."), Look(GREY, "-"), Look(YELLOW, "--"))
"""For compensators of one's own."""


def of(name: str, among: tuple[str, ...] = ()) -> Look:
    """How a compensator looks.

    Args:
        name: what tables call it.
        among: all names of the figure, in its order; those of one's own take the spare looks in this order.

    Example:
        >>> of("llnf").colour
        '#009E73'
    """
    if name in LOOKS:
        return LOOKS[name]
    own = [other for other in among if other not in LOOKS] or [name]
    return OTHERS[own.index(name) % len(OTHERS)]


@contextmanager
def text(points: float, **own: Any) -> Iterator[None]:
    """Set type and lines for paper, with fonts that journals take (TrueType, not Type 3).

    Args:
        points: size of the text.
        own: more settings of matplotlib, dots in their names as two underscores.
    """
    look: Any = {"axes.linewidth": 0.6, "lines.linewidth": 1.0, "pdf.fonttype": 42, "grid.linewidth": 0.5}
    look |= {"font.size": points, "axes.titlesize": points, "legend.fontsize": points}
    with settings(look | {name.replace("__", "."): value for name, value in own.items()}):
        yield


def write(made: Figure, file: BinaryIO, kind: str) -> None:
    """Write a figure, without its date: the same figure is the same file.

    Args:
        made: the figure.
        file: open for writing.
        kind: `png`, `pdf` or `svg`.

    Raises:
        ValueError: matplotlib cannot write such a file.
    """
    dates = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}
    made.savefig(file, dpi=160, format=kind, metadata=dates.get(kind))
