"""What the verdict decides by: numbers with their reasons, in one place."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ConventionSettings:
    """Decision constants of whether recordings count otherwise than the model.

    Attributes:
        decides: share of the error of the model as given, and with its parameters refitted, below which the error must
            fall with a convention changed, and no parameter. In 50 blind trials none of those that were right brought
            it below the former.
        seconds: of recordings that conventions are tried on: there are dozens, and a wrong sign shows in the first
            swing
        every: which of their windows are tried first
        hopeless: times the error that decides, above which these are enough to see that a convention does not
        gross: share of the motion: a smaller mismatch is none of conventions, for a wrong sign or axis is off by as
            much as moves
        parallel: cosine between two axes, from which readings about one could be of the other
        alike: times the least error, up to which conventions cannot be told apart: what the model lacks makes as much
            difference
        thousandth: of a volt or a newton metre: the unit that drives log instead
        early: rows by which commands may act before their stamps: one where an action is logged with what it led to,
            more where it waits for its turn to be written
    """

    decides: float = 0.5
    seconds: float = 12.0
    every: int = 4
    hopeless: float = 2.0
    gross: float = 0.005
    parallel: float = 0.99
    alike: float = 1.1
    thousandth: float = 1e-3
    early: tuple[int, ...] = (1, 2, 3)


CONVENTIONS = ConventionSettings()


@dataclass(frozen=True)
class FormulaSettings:
    """Decision constants of which formula says what a table says.

    Attributes:
        places: starts along the input, for a formula of what sits somewhere: no two of its widest start further apart
            than they are wide
        widths: starts for its width, in lengths of the table: of a narrow spot, a usual one, and one that fills it
        narrowest: the same, at least: a narrower spot lies between two knots
        aside: of the same, by which what sits somewhere may lie beside the table: its top is just seen from there
        longest: a wave and the length over which something falls, in lengths of the table: of a longer one it shows a
            bend, which a power says as well
        waves: starts of a sine, in waves to the length of a table: more than eight no table of few knots tells
        powers: starts of a power: a root, and what drags and bearings are said to have
        flattest: power, below which one is a step
        steepest: power, above which one is a wall
        singular: share of the largest, below which a direction of a table is not known at all
        over: lengths over which something falls, after which less than a hundredth of it is left
        followed: starts that are followed, of those that begin best: two terms have hundreds
        most_values: values of a formula that a start may ask for: those that have not settled by then, wander
    """

    places: int = 7
    widths: tuple[float, ...] = (0.02, 0.07, 0.25)
    narrowest: float = 0.005
    aside: float = 0.2
    longest: float = 2.0
    waves: tuple[float, ...] = (0.7, 1, 1.5, 2, 3, 4, 6, 8)
    powers: tuple[float, ...] = (0.5, 1.5, 2.0, 3.0)
    flattest: float = 0.05
    steepest: float = 8.0
    singular: float = 1e-10
    over: float = 5.0
    followed: int = 6
    most_values: int = 60


FORMULAS = FormulaSettings()


@dataclass(frozen=True)
class VerdictSettings:
    """Decision constants of what is named, how sure it is, and the verdict.

    Attributes:
        swaps: effects that may give way to rivals after the search: after each, all the others are judged anew
        rivals: effects of its round that are tried in the place of one, the likeliest first, for each costs a fit
        rivals_left: the same where structure is left: names are provisional then, and telling them apart is worth less
        windows: of the test data, at most, on which each rival is judged: how far off it is shows in a few
        light: of the largest load, added to each joint's before unexplained forces are compared with them: a joint that
            carries next to nothing would have the largest share of any mismatch
        bins: of a quantity, between which a force's variance is told: enough for a narrow pattern, and few enough for
            hundreds of samples in each
        sure: quantile to which an interval reaches on either side: 90 % lie within, which a dozen blocks can tell
        regimes: into which windows are parted by where they begin, and by how fast, to see what parameters are in each:
            as many as have half a dozen windows
        known: squares of one reading's noise, that doubling a parameter has to change for data to know of it
        small: share of the motion within a window: a smaller mismatch is called missing physics only if it has a
            pattern, for every real recording holds a little
        pattern: share of the variance of the unexplained force that goes with something, from which it has one: chance
            leaves a few hundredths
        late: s, over which what was of late is a mean
        of_late: likewise, of a drag that changes with how fast the joint was: one number takes less by chance than bins
            do, of the forces of 1,600 stretches a few thousandths
        refuted: times the error on validation data without an effect, from which it is not named after all: those are
            few, and a little is chance
        worse: times the error of a plainer model, from which a model predicts worse; less is how a fit ended
        coarse: the same at a step that costs more than what is missing does: on fast axes that of a plainer model is as
            much chance as its own
        costs: share of the error at a file's own step, below which the error that fine steps allow says that the step
            costs most of it
        made_up: times the error of a plainer file, below which one is written whose parameters make up for the step:
            they are wrong at any other, and half of it is worth that
        differs: share of itself, from which such a parameter is said beside what was found: by less it moves in any fit
        happened: share of what an event brings in the recording that it brings most to, from which it was in another
            one as well
        named: fall of the mean log square error by which an effect must improve predictions to be named: an error a
            twentieth smaller; what brings less may stand for much else
        whole: attributes of a joint, an actuator or a sensor that an effect writes over, and the first of their numbers
            that counts: a joint's first damping is a parameter of the model, those of higher powers are not
        refitted: share of what the model as given leaves beyond the noise, that refitted parameters must take for them
            to have been wrong: they take up a little of whatever is missing
        modelled: share of the error beyond the noise that a law without a name may leave to have modelled it: else most
            is still missing
        elsewhere: times the noise on windows compared on, from which test data at the noise give no all-clear
        stands_in: share of the error left over from which a named effect merely stands in for something unknown: those
            that were there left less in blind trials
        told_apart: times the smallest gain that is worth an effect, from which a rival is ruled out: its error is a
            twentieth larger
        same: times the error that a rival may leave and be the same model: how fits end makes as much of a difference
        slow: share of the spread of velocities, below which motion is slow: near reversals
        step: times what a force grows by with velocity, that it must change by with its sign to change at reversals:
            one in proportion to velocity changes by 0.8
        stronger: times the mean force of fast motion, that it must have in slow motion to be one of reversals: a force
            of another kind has no more there
        disagree: times the error of the recalibrated model, from which motion or forces are better, or worse,
            explained: less than a tenth is how fits end
        white: of the autocorrelation at every lag shown, below which residuals pass for noise; quantisation leaves a
            little
        lags: of the autocorrelation shown: half of a window of 0.25 s at 500 Hz
        at_limit: share of itself, from which a parameter stands at its limit: a fit that is held there stops within
            rounding of it
        free: standard deviation, as a logarithm, of a parameter of which nothing is known: a factor of three either way
        negligible: share of itself; a parameter that moves by less was right: few are known to three digits
        shorter: parts of the model's own step that are tried in turn where that is too coarse: the longest that does
            costs least
        worst: share of the windows, the worst at the model's own step, which alone tell that a shorter one will not do
        refit: windows that tell whether other parameters make up for the model's own step: half of those that are used
            at most
        refit_steps: steps of that fit: it begins where the parameters are that fine steps ask for
        choices: of other parameters that are foretold at most: each takes a third of a millisecond
        others: choices of parameters that are tried in place of those that changed, the likeliest first: each costs a
            refit
    """

    swaps: int = 3
    rivals: int = 5
    rivals_left: int = 3
    windows: int = 24
    light: float = 0.05
    bins: int = 24
    sure: float = 0.95
    regimes: int = 8
    known: float = 1.0
    small: float = 1e-3
    pattern: float = 0.1
    late: tuple[float, ...] = (0.3, 1.0, 3.0, 10.0)
    of_late: float = 0.05
    refuted: float = 1.05
    worse: float = 1.005
    coarse: float = 1.5
    costs: float = 0.5
    made_up: float = 0.5
    differs: float = 0.05
    happened: float = 0.5
    named: float = 0.1
    whole: tuple[tuple[str, int], ...] = (
        ("delay", 0),
        ("cogging", 0),
        ("saturation", 0),
        ("damping", 1),
        ("solreflimit", 0),
    )
    refitted: float = 0.2
    modelled: float = 0.5
    elsewhere: float = 2.0
    stands_in: float = 0.2
    told_apart: float = 5.0
    same: float = 1.02
    slow: float = 0.2
    step: float = 1.5
    stronger: float = 1.3
    disagree: tuple[float, float] = (0.9, 1.1)
    white: float = 0.1
    lags: int = 60
    at_limit: float = 1e-3
    free: float = 1.0
    negligible: float = 2e-3
    shorter: tuple[int, ...] = (2, 4, 8, 16, 32)
    worst: float = 0.2
    refit: int = 36
    refit_steps: int = 4
    choices: int = 20_000
    others: int = 4


VERDICT = VerdictSettings()
