"""What effects decide by where several share it, and how tables are grown: numbers with their reasons, in one place.

Facts of one effect alone, as the temperature of a motor's surroundings, stand in its file.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class EffectSettings:
    """Decision constants that effects share.

    Attributes:
        leaves: share of the excess error that effects may leave and be named. In 160 blind trials, those that were
            there left 0.19 at most, and those that stood in for physics of no catalogue 0.4 to 0.7, save one that left
            0.2; what real rigs leave beside friction that is known to be there is 0.25. Effects that are told by when
            they act alone may leave less; all others are named however much they leave
        settle: s of simulation until a rotor is where it would be, whatever it was given to start with: half of that
            leaves one with much play far off, at the parameters that it was simulated with
        swing: s of it until a rotor on a spring is, which swings on: with a twentieth of critical damping at 10 Hz,
            three per cent of how it began are left
        warm: s that bristles, currents, lags and delays need to reach their state: they take milliseconds, and the
            slowest of them a few tens
        slow_current: the same of a current behind a filter or a weak loop, which take tens of milliseconds
        short: of that time, the share that a command's filter is short by: it needs no more
        fades: time constants that a longer one is simulated for before a window: no recording says where it was, and
            what it was off by shows until next to nothing of that is left
        fast: s, longest step for what moves within milliseconds, which a longer one would step over
        fastest: s, shortest step that a model's own time constants ask for: what follows faster has come to rest within
            it, and is simulated as if it were as slow
        fine: relative change of a wavelength that is a sizeable one: it shifts the tenth wave by half of one
        faint: of what a joint transmits, below which an unexplained force gives no scale: it may be all noise
        uncertain: of the usual speed, over which the direction of motion is smoothed: an estimated velocity is off by
            about as much
        dry: shares of the unexplained force between which a first level of dry friction is kept: a regression may give
            none, or a wrong sign, and what does nothing has no slope to begin with
        there: N or N m, least level of it that is written where something else sets the level: a joint without any is
            another model to MuJoCo
    """

    leaves: float = 1 / 3
    settle: float = 0.3
    swing: float = 1.2
    warm: float = 0.06
    slow_current: float = 0.25
    short: float = 0.2
    fades: float = 8.0
    fast: float = 5e-4
    fastest: float = 2e-5
    fine: float = 0.05
    faint: float = 0.01
    uncertain: float = 0.05
    dry: tuple[float, float] = (0.1, 2.0)
    there: float = 1e-9


EFFECTS = EffectSettings()


@dataclass(frozen=True)
class LawSettings:
    """Decision constants of laws of any shape: how far their values may move, and how fine they may become.

    Attributes:
        step: sizeable change of a value, in sizes of the whole law: values differ by about as much from one to another
        loose: standard deviation of a value's prior, in sizes of the whole law: it holds a knot that no motion comes
            near, and hardly any other
        new: of a knot that is put between two others: where no data are, the law stays as it was
        walks: standard deviation, in sizes of the whole law, of how far Brownian motion goes from one end of a law to
            the other, as its values lie off the lines between their neighbours: about as far as the law itself goes
        narrowest: of a table's length: no stretch is bisected to less, for laws are written over as many even ones
        twice: times the narrowest stretch, from which one is bisected; two would leave out, by rounding, a stretch that
            is exactly twice as long
        most_levels: of a table of two inputs that fits make finer: each costs a simulation for its derivatives
        beyond: share of a table's length that its input has to go beyond an end of it for the table to be made longer
        most_beyond: stretches by which it is made longer at an end: what goes far is told by few data
        untold: sizeable changes, from which a value's standard error says that no data tell it: it may then be that of
            any law
        driest: share of the dry friction that forces tell, below which no first level lies: what does nothing has no
            slope to begin with
    """

    step: float = 0.3
    loose: float = 5.0
    new: float = 0.3
    walks: float = 1.0
    narrowest: int = 256
    twice: float = 1.9
    most_levels: int = 144
    beyond: float = 0.02
    most_beyond: int = 8
    untold: float = 1.0
    driest: float = 0.05


LAWS = LawSettings()


@dataclass(frozen=True)
class SmoothingSettings:
    """Decision constants of how forces are smoothed before a law is looked for in them.

    Attributes:
        noisy: share of the force that is sought, to which the encoders' noise in it may come: more would hide what
            takes a few hundredths of it
        widest: s, standard deviation of the bell curve that samples are weighted by, at most: of a force at 8 Hz, as
            fast as most rigs move, it leaves more than half
        narrowest: the same in periods of the recording, at least: so narrow that every sample stays as it is
        every: widths from one smoothed sample to the next: closer ones tell nothing new
        reach: widths to either side, beyond which a sample counts for nothing: a curve that ends at three has an edge
            there, which lets more noise through than the rest of it
    """

    noisy: float = 0.01
    widest: float = 0.02
    narrowest: float = 0.1
    every: float = 0.5
    reach: float = 4.0


SMOOTHING = SmoothingSettings()


@dataclass(frozen=True)
class TableSettings:
    """Decision constants of how a table of one input is grown from the unexplained force.

    Attributes:
        bins: of the range of the input; no knot lies closer to another than one of them, for a force that was worked
            out from motion is too rough to tell finer shapes
        most_knots: of a table: simulation tells where more are needed
        fewest: samples between two knots: of fewer, noise decides what the table says there
        block: s; alternating blocks choose knots and confirm them: errors of an estimated force last for a part of a
            second, so that neighbouring samples would confirm each other's noise
        spare: share of what knots gain on the confirming blocks that a table with fewer of them may forgo, so that
            noise adds no knots
        near: share of what the best table leaves that one with fewer knots may leave more: where a table takes nearly
            all, a share of what it takes would leave a large law coarse
        covered: share of the samples beyond either end of a table: the few fastest and farthest would stretch it over
            where nearly none are
        ridge: weight of a value's size, in that of the samples: a trace of it gives bins without samples a value
        between: lines that stand for a smooth law from one knot to the next: they miss it by a sixteenth of what one
            would
        stiff: weight of the bends of a smooth table, likewise: where nearly no samples are, it goes on as beside them
    """

    bins: int = 64
    most_knots: int = 24
    fewest: int = 20
    block: float = 1.0
    spare: float = 0.03
    near: float = 0.1
    covered: float = 0.005
    ridge: float = 1e-6
    between: int = 4
    stiff: float = 1e-3


TABLES = TableSettings()


@dataclass(frozen=True)
class SurfaceSettings:
    """Decision constants of which inputs a force without a name depends on, and of the table over them.

    Attributes:
        alone: bins along one input; no knots lie closer, for the force is known too roughly
        both: bins along each of two, which have their square: fewer, so that samples fall into most of them
        paired: of the better inputs, that are tried in pairs: what tells least alone seldom tells most beside another,
            and pairs grow as the square
        tells: share of what one input takes, by which two have to take more: a second one always takes a little noise
        stiff: of an even table: weight of its bends, against that of its samples; three sizes, for how wavy a force is
            is not known before
        smooth: weight of a grown table's bends: where nearly no samples are, it goes on as it does beside them
        timid: weight of a level's size, far less: it only keeps a level of no samples from being anything
        untold: share of all samples' weight: a level of less lies in no data, and within those that do
        nearly: of what the best inputs take, from which others are asked as well: under feedback all move together,
            and which of them a force follows only a fit tells
        rivals: tables that are asked for: each costs a fit
        least: share of the variance that a table must take of blocks that it did not see; less is chance
        most_levels: of a table: each costs a simulation for its derivatives
    """

    alone: int = 32
    both: int = 16
    paired: int = 8
    tells: float = 0.1
    stiff: tuple[float, ...] = (1e-3, 0.1, 10.0)
    smooth: float = 1e-3
    timid: float = 1e-4
    untold: float = 1e-5
    nearly: float = 0.7
    rivals: int = 3
    least: float = 0.002
    most_levels: int = 72


SURFACES = SurfaceSettings()


@dataclass(frozen=True)
class WaveSettings:
    """Decision constants of which waves over position are found in the unexplained force.

    Attributes:
        most: waves over the range of position; an axis that turns many times has hundreds
        bins: of position, sixteen to the shortest wave: a sum over bins then loses nothing of it
        finer: times as many are tried as the range tells apart, so that one lies near the top of every peak
        resolved: waves that may pass in a sample at the usual speed: of such nothing is left in the force, but slower
            stretches have them
        small: share of the force, to which a sine or cosine is raised: a fit moves away from none only slowly
        kept: waves that are tried: what drives a joint makes waves of its own, so the best need not be the one
        steepest: slope of a wave in a reading, at first: a scale of less than none runs backwards
    """

    most: int = 1000
    bins: int = 16384
    finer: int = 10
    resolved: float = 0.25
    small: float = 0.02
    kept: int = 3
    steepest: float = 0.3


WAVES = WaveSettings()
