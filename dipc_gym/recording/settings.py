"""What recordings are checked by: numbers with their reasons, in one place."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class NoiseSettings:
    """Decision constants of how large the noise of a sensor is, and whether it counts in steps.

    Attributes:
        orders: of the differences that remove the motion: lower ones leave some of it, higher ones gain nothing
        fewest: samples that noise can be estimated from: the highest order takes eight for one value
        block: samples over which the differences are averaged before the median is taken: short, so that an impact
            spoils few of them
        as_good: times the least estimate, up to which a lower order is as good: the least itself is too small by chance
        rounding: times the smallest step of a number, below which a change is one of rounding
        near: times the smallest change, up to which changes are asked whether they are multiples of it: of larger ones
            everything is a multiple
        off: of a step, by which a change may miss a multiple: files keep few digits
        nearly_all: share of the changes that must be multiples: a sample may have been averaged
    """

    orders: tuple[int, ...] = (3, 4, 5, 6, 7)
    fewest: int = 10
    block: int = 32
    as_good: float = 1.05
    rounding: float = 64.0
    near: float = 50.0
    off: float = 0.05
    nearly_all: float = 0.95


NOISE = NoiseSettings()


@dataclass(frozen=True)
class CheckSettings:
    """Decision constants of what the owner of a recording is told of. None of it stops an analysis.

    Attributes:
        switched: share of samples at either extreme, from which a channel is switched between two levels, not cut off
        slow: s between samples, beyond which time is more likely in milliseconds: no rig is recorded at less than 5 Hz
        rate: samples a second that the documentation asks for, Hz: within 5 ms a command that changes meanwhile moves
            next to nothing
        few: share of it below which a recording is said to be sampled slowly: clocks are off by a little
        gap: times the usual, beyond which samples are missing between two: jitter is less
        steady_clock: of the steps from sample to sample, the quantile that is usual still: where samples come when
            something happens, few are longer than several times that
        spread: share of the usual time between samples, by which the middle nine tenths of them may differ: commands
            are averaged over steps from there on
        plateau: samples in a row at an extreme, and times the usual run, from which it is one: commands that move in
            steps have shorter runs everywhere
        kink: share of the largest change, above which a plateau is entered with a kink: what comes to rest slows down
        steps: of a quantised signal, that a change must exceed to be a kink: smaller ones are of rounding
        refreshed: changes of a channel, or bends of it, from which it can be told how often it was read
        regular: share of them that come the same number of rows apart, from which it was read every so many rows
        straight: of the largest change from row to row, below which a channel does not bend
        clipped: share of the samples on plateaus, from which it is told: less spoils no fit
        far_hinge: rad that a hinge without limits seldom goes beyond: two turns
        far_slide: m that a slide without limits seldom goes beyond: a room has no more
        far_command: times the range of a joint, that a servo is seldom asked for: it would stand at a stop
        arrives: samples in which a joint comes to its limit from within: one that stays there did not arrive
        within: share of its range by which it was within before
        past: share of its range by which it goes beyond: less is its zero or its noise
        steady: rad a sample, below which an angle that starts again can be counted on: one that turns by more may have
            gone either way
        rounded: share of the rows that repeat a time, from which on stamps are rounded: a stuttering logger repeats few
        rarely: share of its steps that may be larger: glitches, and gaps in time
        moves: times its noise: a position that moves less tells nothing of its rate
        like: share of the variance from which one curve is another, scaled
        times: between which a rate goes the way of its position: less or more is a unit or a gear, not a calibration
    """

    switched: float = 0.95
    slow: float = 0.2
    rate: float = 200.0
    few: float = 0.9
    gap: float = 3.0
    steady_clock: float = 0.95
    spread: float = 0.05
    plateau: int = 5
    kink: float = 0.05
    steps: float = 5.0
    refreshed: int = 20
    regular: float = 0.8
    straight: float = 1e-6
    clipped: float = 0.01
    far_hinge: float = 4 * math.pi
    far_slide: float = 5.0
    far_command: float = 3.0
    arrives: int = 10
    within: float = 0.01
    past: float = 1e-3
    steady: float = math.pi / 2
    rounded: float = 0.1
    rarely: float = 0.01
    moves: float = 10.0
    like: float = 0.5
    times: tuple[float, float] = (0.5, 2.0)


CHECKS = CheckSettings()


@dataclass(frozen=True)
class DegreesSettings:
    """Decision constants of which angles were most likely recorded in degrees.

    Attributes:
        turns: either way, that a joint with a weight on it seldom makes: cables would wind up
        beyond: times its range, where a joint has one: zeros are off, and no stop gives way by as much
        most: rad; beyond this it would be many turns in degrees too
        smooth: s over which a reading is taken for a cubic, to know its acceleration: longer bends a swing, shorter
            leaves its noise
        samples: at which accelerations are compared: more cost time and tell the same
        clearly: share of the error in degrees, below which a model's accelerations say that an angle is in radians: the
            wrong unit is off by a factor of 57, and the model itself may be far off
        drives: share of a slide's measured accelerations, below which its model's forces cannot have driven it: in the
            wrong unit they are a thousandth
        weight: N m, above which a torque that changes with the angle is one of gravity and not of rounding
    """

    turns: float = 2.0
    beyond: float = 3.0
    most: float = 1.1 * 360.0
    smooth: float = 0.05
    samples: int = 2000
    clearly: float = 0.5
    drives: float = 0.03
    weight: float = 1e-9


DEGREES = DegreesSettings()


@dataclass(frozen=True)
class ClockSettings:
    """Decision constants of whether rows were read evenly and stamped unevenly.

    Attributes:
        least: share of a period that stamps are off even ones, below which it makes no difference
        smoother: times that a sensor is as smooth under even stamps, from which these are the right ones: under stamps
            that are right, even ones make it rougher
        rougher: times, below which a sensor is rougher under them and speaks against them: by chance one is a little so
        fewest: samples, in which noise and evenness can be told
    """

    least: float = 0.005
    smoother: float = 2.0
    rougher: float = 0.9
    fewest: int = 50


CLOCK = ClockSettings()


@dataclass(frozen=True)
class GlitchSettings:
    """Decision constants of which samples are glitches.

    Attributes:
        far: times the noise that a sample is off by: chance and a last digit do not bring it there
        beside: times the noise that its neighbours may be off by without it
        left: share of what it is off by, that these may be off by instead: beside where a joint hits something, they
            are off by a sixth
        longest: samples in a row: a serial line or a counter is off for a few, and longer a motion may be what it seems
        most: times that it happens, as a share of the samples, but for a single one: what happens more often is how
            the sensor reads
        span: periods that two samples before and two after one may be apart: of a longer gap a cubic foretells little
        fewest: samples in which noise can be told from motion
    """

    far: float = 50.0
    beside: float = 5.0
    left: float = 0.05
    longest: int = 3
    most: float = 0.01
    span: float = 6.0
    fewest: int = 20


GLITCHES = GlitchSettings()
