"""The word of the verdict, from errors on data that nothing was fitted to."""

from __future__ import annotations

from dipc_gym.sim2real.result import Errors, Located, Verdict
from dipc_gym.sim2real.selection.settings import SCORE
from dipc_gym.sim2real.verdict.settings import VERDICT


def negligible(recalibrated: float, motion: float, located: Located) -> bool:
    """Whether a mismatch beyond the noise is not worth a name: small beside the motion, and without a pattern.

    Real recordings always hold a little structure beyond noise, and the best of dozens of effects takes up some of it.

    Args:
        recalibrated: error of the refitted model, in units of noise.
        motion: within a window, in units of noise.
        located: where the mismatch sits, the joint that carries most of it.
    """
    patterned = located.explained >= VERDICT.pattern or located.of_late >= VERDICT.of_late
    return recalibrated < VERDICT.small * motion and not patterned


def verdict(
    errors: Errors, *, small: bool, terms: int, unnamed: int, modelled: int, changed: int, elsewhere: float
) -> Verdict:
    """The verdict from errors on held-out windows, in units of noise.

    Args:
        errors: of the model as given, of the recalibrated and of the improved one.
        small: whether what refitted parameters leave is `negligible`.
        terms: how many effects were found and named.
        unnamed: how many improve predictions without a name.
        modelled: how many laws of no kind improve them.
        changed: how many model parameters had to change, as validation data have it.
        elsewhere: error of the recalibrated model on the windows compared on: test data may not show what acts there.
    """
    nominal, recalibrated, improved = errors.nominal, errors.recalibrated, errors.improved
    if modelled:
        much = improved <= SCORE.at_floor or improved - 1 < VERDICT.modelled * (recalibrated - 1)
        return "partly explained" if terms else "modelled" if much else "unexplained"
    if terms:
        return "explained" if improved <= SCORE.at_floor else "partly explained"
    if unnamed:
        return "modelled" if improved <= SCORE.at_floor else "unexplained"
    # Refitted in all its parameters a model may predict other data worse than with those alone that had to change.
    if (min(nominal, recalibrated, improved) <= SCORE.at_floor and elsewhere <= VERDICT.elsewhere) or small:
        return "recalibrated" if changed else "consistent"
    return "unexplained"
