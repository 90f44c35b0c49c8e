"""Which numbers an entry of `<custom>` may have: such that it gives a number wherever a joint is and whenever it is.

Each check says what is wrong with numbers, in words that go on after a colon; nothing where the formula's own first
line says enough, and None where nothing is wrong.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from dipc_gym.physics.formulas import SOONEST

Array = NDArray[np.float64]
Inputs = tuple[tuple[str, int], ...]
Check = Callable[[Array, Inputs], str | None]

LARGEST = 1e9  # of an entry's numbers; of what comes of them, its square
CLOSEST = 1e-12  # of a table's knots, as a share of what they are, or of 1
SHORTEST_LAG, LONGEST_LAG = 1e-9, 1e6  # time constants, s
MOST_KNOTS = 1024  # of a table in a file: 257 of the finest law, and as many beyond either end of it
MOST_LEVELS = 4096  # of a surface
FEWEST_EVEN = 4  # numbers of a table of equal distances: its ends, and two levels
MOST_NUMBERS = 3 * MOST_LEVELS  # of any entry


def bounded(numbers: Array, _: Inputs = ()) -> str | None:
    """What any entry's numbers are: some, not very many, and none that is huge or no number."""
    if not len(numbers):
        return ""
    if len(numbers) > MOST_NUMBERS:
        return f"{len(numbers):,} numbers, more than {MOST_NUMBERS:,}"
    wild = np.flatnonzero(~(np.abs(numbers) <= LARGEST))
    return f"number {wild[0] + 1} is {numbers[wild[0]]:g}" if len(wild) else None


def plain(count: int, never_negative: int | None = None) -> Check:
    """So many numbers, one of which, a width or a duration, is not negative."""

    def check(numbers: Array, _: Inputs) -> str | None:
        if len(numbers) != count:
            return f"it takes {count}"
        return "" if never_negative is not None and numbers[never_negative] < 0 else None

    return check


def lag(numbers: Array, _: Inputs) -> str | None:
    """A time constant."""
    return None if len(numbers) == 1 and SHORTEST_LAG <= numbers[0] <= LONGEST_LAG else ""


def table(numbers: Array, _: Inputs) -> str | None:
    """Knots, then as many values."""
    knots = numbers[: len(numbers) // 2]
    if len(numbers) % 2 or not 2 <= len(knots) <= MOST_KNOTS:
        return f"as many knots as values, 2 to {MOST_KNOTS:,} of them"
    return None if _increase(knots) else "its knots do not increase"


def even_table(numbers: Array, _: Inputs) -> str | None:
    """Two ends, then levels at equal distances."""
    if len(numbers) < FEWEST_EVEN:
        return f"it takes {FEWEST_EVEN} or more"
    return None if _increase(numbers[:2]) else f"it goes from {numbers[0]:g} to {numbers[1]:g}"


def surface(numbers: Array, inputs: Inputs) -> str | None:
    """A speed, how many knots there are along one input or two, the knots, and their levels."""
    if not 1 <= len(inputs) <= 2:
        return "what it depends on is not said"
    return _surface_of(numbers, len(inputs))


def recent_surface(numbers: Array, inputs: Inputs) -> str | None:
    """A time constant, then a surface over what was of late of its one input and over that input itself."""
    if len(inputs) != 1:
        return "it depends on one input"
    return _surface_of(numbers[1:], 2) if numbers[0] >= SOONEST else f"its time constant is below {SOONEST:g} s"


def _surface_of(numbers: Array, inputs: int) -> str | None:
    if len(numbers) < 3 or not np.all(numbers[1:3] == np.round(numbers[1:3])):
        return ""
    m, n = int(numbers[1]), int(numbers[2])
    if numbers[0] <= 0:
        return f"its speed is {numbers[0]:g}, and must be positive"
    if m < 2 or n < inputs or (inputs == 1 and n != 1):
        return f"a table of {m} x {n} over {inputs} input{'s' * (inputs > 1)}"
    if m * n > MOST_LEVELS:
        return f"a table of {m} x {n} is {m * n:,} levels, more than {MOST_LEVELS:,}"
    if len(numbers) != 3 + m + n + m * n:
        return f"a table of {m} x {n} has {3 + m + n + m * n} numbers, not {len(numbers)}"
    sorted_ = _increase(numbers[3 : 3 + m]) and _increase(numbers[3 + m : 3 + m + n])
    return None if sorted_ else "its knots do not increase"


def sag(numbers: Array, inputs: Inputs) -> str | None:
    """One that gives more the more was drawn would drive its joint for ever."""
    right = len(numbers) == 4 and numbers[2] >= 0 and numbers[3] >= SOONEST
    return _of_a_command(inputs) if right else ""


def sag_table(numbers: Array, inputs: Inputs) -> str | None:
    """As `sag`, with shares in a table."""
    right = len(numbers) >= 3 + FEWEST_EVEN and numbers[2] >= SOONEST and numbers[3] > CLOSEST
    return _of_a_command(inputs) if right and np.all(numbers[4:] >= 0) else ""


def _of_a_command(inputs: Inputs) -> str | None:
    return None if [kind for kind, _ in inputs] == ["command"] else "it depends on one command, which is not said"


def creep(numbers: Array, _: Inputs) -> str | None:
    """One that pushes, or stretches of its own, would drive its joint for ever."""
    return None if len(numbers) >= FEWEST_EVEN and np.all(numbers >= 0) and numbers[1] > CLOSEST else ""


def loop(numbers: Array, _: Inputs) -> str | None:
    """One that is stiffer loading than unloading would give energy away."""
    falls = len(numbers) >= FEWEST_EVEN and np.all(np.diff(numbers[1:]) <= 0)
    return None if falls and numbers[0] > CLOSEST and numbers[-1] == 0 else ""


def rest(numbers: Array, _: Inputs) -> str | None:
    """Level, rise, time constant, speed."""
    return None if len(numbers) == 4 and np.all(numbers[2:] > CLOSEST) else ""


def rest_table(numbers: Array, _: Inputs) -> str | None:
    """Level, longest, soon, speed, then rises."""
    return None if len(numbers) >= 2 + FEWEST_EVEN and np.all(numbers[1:4] > CLOSEST) else ""


def load_table(numbers: Array, _: Inputs) -> str | None:
    """Level, shares of the load, fastest and slow speed, then how much more at speeds between."""
    right = len(numbers) >= 3 + FEWEST_EVEN and np.all(numbers[3:5] > CLOSEST) and np.all(numbers >= 0)
    return None if right else ""


def _increase(knots: Array) -> bool:
    """Whether knots increase by steps that numbers of their size can tell, and that can be divided by."""
    return bool(np.all(np.diff(knots) > CLOSEST * np.maximum(1.0, np.abs(knots[1:]))))
