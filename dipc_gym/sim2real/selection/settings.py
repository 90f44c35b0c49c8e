"""What the choice of windows, the comparison of fits and the search decide by: numbers with their reasons."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class WindowSettings:
    """Decision constants of which windows are fitted, compared on, validated by and tested with.

    Attributes:
        test: share of each recording that comes before what is tested on, where no recording is held out for that: more
            to test with would be missing where the physics is to be found
        fit: share of what comes before the test data that is fitted; the rest validates: that only has to speak against
            an effect, and needs less
        coarsest: longest step of the analysis, s: Runge-Kutta follows a swing of 5 Hz over a window to a millionth
        still: times its noise that a joint has to move to tell anything: an encoder goes a few steps in less
        most: windows fitted and compared on, two thirds and one third; more say little more
        fewest: windows, six to fit and three to compare on: blocks of fewer give no standard error
        every: so many-th window is compared on, is sketched with, and tells what a step costs: a third is enough to
            confirm what two thirds found
        outliers: windows in which something else happened, at most: what happens more often is no event, and has to be
            explained
        plenty: windows, from which on the first ones can be spared: half of those that are used at most
        late: time before a window, s, in which commands must be known: they may act late
        apart: time, s, from one window to another that is not beside it: a fifth of a window, so that a few missing
            samples do not part neighbours
    """

    test: float = 0.75
    fit: float = 0.8
    coarsest: float = 2e-3
    still: float = 10.0
    most: int = 72
    fewest: int = 9
    every: int = 3
    outliers: int = 6
    plenty: int = 36
    late: float = 0.05
    apart: float = 0.05


WINDOWS = WindowSettings()


@dataclass(frozen=True)
class ScoreSettings:
    """Decision constants of whether one fit predicts better than another, and of what is at the noise.

    Attributes:
        clear: standard errors by which an improvement must stand out: of dozens of hypotheses, the best comes to two by
            chance
        clear_at_large: the same of a large one, which need not be as even over the windows
        many: blocks of a second in a recording of the usual length; of fewer, more standard errors are asked for
        large: improvement of the mean log square error (an error one fifth smaller) that no chance brings about
        alike: standard errors within which two fits are not told apart: chance stays within them nineteen times in
            twenty
        worth: smallest improvement of the mean log square error that is worth an effect: an error a hundredth smaller;
            less shows in no use of a model
        hardly: mean log square error, half of that: a gain of less is as good as none, and a hypothesis that foretells
            less is not sketched
        told_apart: the same, a quarter: simulations of one and the same model may differ by as much
        share: part of a gain within which another fit predicts as well: how fits end makes as much of a difference
        usual: usual square error up to which windows are at the noise: the noise itself may be off by a fifth
        fewest_blocks: blocks that a standard error or an interval is taken from: two hardly have a spread
        blocks: blocks that tell two fits apart at the noise, if no other says the opposite: chance does not bring about
            so large a gain in as many
        at_floor: times the noise: a structure that predicts as well as this lacks nothing that could be told from noise
            estimated too low
        at_noise: times the noise: nothing is left that would tell an elaboration from what it elaborates
    """

    clear: float = 2.5
    clear_at_large: float = 1.0
    many: int = 40
    large: float = 0.5
    alike: float = 2.0
    worth: float = 0.02
    hardly: float = 0.01
    told_apart: float = 0.005
    share: float = 0.02
    usual: float = 1.5
    fewest_blocks: int = 3
    blocks: int = 3
    at_floor: float = 1.2
    at_noise: float = 1.05


SCORE = ScoreSettings()


@dataclass(frozen=True)
class SearchSettings:
    """Decision constants of the search for effects.

    Attributes:
        subset: windows that a sketch has at least: fewer do not tell structures with a dozen parameters apart
        worst: windows with the largest errors, that are among these: what is missing may act there alone
        finalists: hypotheses, or pairs, sketched in a round: a straight line through a first guess ranks them only
            roughly, and each more costs a fit
        finalists_at_noise: the same where nothing is left that they could explain
        foretold: share of the largest predicted gain from which a hypothesis is sketched: predictions are seldom off
            by a factor of ten
        moved: of a mapped parameter, from which effects are also tried on top of the nominal ones: refitted ones may
            have taken over what an effect does
        largest: times a first guess, up to which its best size by a straight line is believed: no line goes as far
        trusted: steps of mapped parameters, up to which a straight line is believed of those that move beside: one is
            a sizeable change
        scaled: share of a first guess, below which its best size by a straight line is not believed: a fit that begins
            at next to nothing hardly moves
        twin: cosine between the responses to two hypotheses from which they are one and the same: no data like these
            tell them apart
        rough: share of its objective by which a step must lower it where fits only compete: who wins is seldom decided
            by less
        most_effects: effects that are added: each later one is told from less, and beside more that could make up for
            it
        fully: sketches that are fitted to all windows, beside the plainer ones that they elaborate: a full fit costs as
            much as three sketches or more
        keeps_up: share of the best sketch's improvement from which a hypothesis is fitted fully: other windows do not
            make up for half
        in_turn: share of the largest predicted gain from which what takes fine steps is sketched, if nothing else does:
            it costs several times as much
        names: effects with a name that are tried in the place of a law of no kind: what screening promises with the
            rest in place is nearly what comes
        shapes: laws of a kind but of any shape that are sketched in a round whatever their predicted gain: that is told
            from a force known roughly
        shapeless: laws of no kind that are sketched beside these
        kinds_lead: laws of a kind after which they are compared with laws of no kind alone: where few things are
            missing, as many come near the noise
        once: improvement of the log square errors, summed over windows, by which an event that happened once stands
            out: it has no other blocks that could confirm it
        main_part: share of the improvement that a plain effect must bring to go before one that elaborates it: else it
            is not the main part of that
        far_better: share of what a plain effect leaves, below which one that elaborates it leaves so little that its
            shape is no accident: it does not wait for the plain one
        in_reach: times the noise, from which a fit may yet come down to it: one that leaves more lacks something, not
            steps
        earns: share of the excess error, or of the error of most windows, that an effect must remove where it does not
            come down to the noise: the best of dozens takes up some of anything
        sketch_steps: steps of a sketch: enough to tell which hypotheses keep up, and no more
        hopeless: mean log square error, by which derivatives foretell a rival, or a fit without an effect, to stay
            behind (an error seven times as large) where it is not fitted on: from afar they are off by less
        onward_steps: steps of a sketch or fit that was still on its way, or whose windows are others now: a long valley
            takes more than a fit has elsewhere
        polish_steps: steps of a fit that goes on until nothing changes; few fits need as many
        anew_steps: steps of a fit that is begun anew, from guesses that may be far off
        laws: share of what effects brought, that their laws may leave: tables are off by about as much between their
            knots
        kinds: of effects at all joints that are tried together in a round, the second beside the best one: bearings
            have dry and viscous friction
        pairs: pairs that predict alike and are fitted to all windows, the plainest first: each costs full fits
        held_to: standard deviations, in sizes of the law, with which one of no kind is held to nothing beside effects
            with names, the tightest first: the last hardly holds, as when the law was found
        as_near: times the error of what was accepted, below which what it was accepted before may be as right
        steps_cost: times the noise, by which the model's own steps predict otherwise where an effect may stand for them
        short: share of the predicted gain of a pair that its sketch must bring: of less, the straight lines misled
        halvings: of the stretches between the knots of a law, at most: six make 64 of one, as many as forces tell apart
        coarser: times the error that a law of lines leaves if its knots are twice as far apart: a chord misses a curve
            by the square of its length
        beyond: share of the range of a law's input in the fitted windows, from which another input is far from all of
            these: what a law says there was never asked
        ahead: halvings that are tried before a law is as fine as it may be: a narrow spot shows only when knots lie as
            near as it is wide
        fine_law: parameters of a law, from which on only one more: each costs a simulation in every step of a fit
    """

    subset: int = 18
    worst: int = 4
    finalists: int = 6
    finalists_at_noise: int = 3
    foretold: float = 0.1
    moved: float = 0.1
    largest: float = 100.0
    trusted: float = 1.0
    scaled: float = 0.05
    twin: float = 0.999
    rough: float = 5e-3
    most_effects: int = 6
    fully: int = 3
    keeps_up: float = 0.5
    in_turn: float = 0.25
    names: int = 3
    shapes: int = 6
    shapeless: int = 3
    kinds_lead: int = 2
    once: float = 1.5
    main_part: float = 0.5
    far_better: float = 0.3
    in_reach: float = 3.0
    earns: float = 0.1
    sketch_steps: int = 5
    hopeless: float = 4.0
    onward_steps: int = 15
    polish_steps: int = 25
    anew_steps: int = 30
    laws: float = 0.02
    kinds: int = 2
    pairs: int = 2
    held_to: tuple[float, ...] = (0.3, 1.0, 5.0)
    as_near: float = 1.5
    steps_cost: float = 0.1
    short: float = 0.5
    halvings: int = 6
    coarser: float = 4.0
    beyond: float = 0.02
    ahead: int = 2
    fine_law: int = 32


SEARCH = SearchSettings()
