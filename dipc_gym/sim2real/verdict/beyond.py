"""Test data that go where no law was fitted: what is left there is no physics that is missing."""

from __future__ import annotations

import numpy as np

from dipc_gym.sim2real.estimation.fit import Fit
from dipc_gym.sim2real.estimation.problem import Problem
from dipc_gym.sim2real.result import Beyond, Errors
from dipc_gym.sim2real.selection.settings import WINDOWS
from dipc_gym.sim2real.selection.support import inputs_of, span, supported
from dipc_gym.sim2real.verdict import untouched


def beyond(fits: tuple[Fit, Fit, Fit], seen: Problem, test: Problem) -> Beyond | None:
    """What test windows say that go beyond what the laws of a fit were fitted with; None where none of them does.

    None as well where too few windows stay within: then all of them judge, for nothing else can.

    Args:
        fits: the model as given, recalibrated, and improved.
        seen: windows that the last was fitted to.
        test: windows to judge by.
    """
    improved = fits[-1]
    there = supported(improved, seen, test)
    if there.all() or there.sum() < WINDOWS.fewest:
        return None
    within, outside = test.pick(np.flatnonzero(there)), test.pick(np.flatnonzero(~there))
    return Beyond(
        int((~there).sum()),
        len(there),
        untouched.error_on(outside, improved),
        Errors(*(untouched.error_on(within, one) for one in fits)),
        tuple(
            {"name": name, "fitted": list(fitted), "asked": list(asked)}
            for name in inputs_of(improved)
            for fitted, asked in [(span(name, improved, seen.windows), span(name, improved, test.windows))]
            if asked[0] < fitted[0] or asked[1] > fitted[1]
        ),
    )
