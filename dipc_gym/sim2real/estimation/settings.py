"""What estimation decides by: numbers with their reasons, in one place."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class EstimationSettings:
    """Decision constants of estimation: windows, initial states, fits.

    Attributes:
        window_length: of a window, s, unless the rig asks for shorter ones: forces then move a joint by many times its
            noise, and what a model lacks has not yet led it elsewhere
        samples: that it holds all the same where recordings are long enough: of what is sampled slowly, fewer tell
            little more than the state that it begins with
        longest: of a window, s: until then no model is led elsewhere by what it lacks
        enough: windows that recordings must hold for that
        growth: times its size that an initial error may grow to within a window: beyond, a straight line no longer
            foretells what another initial state changes
        fewest_samples: that a window holds: its initial state alone takes up two for each joint
        steady: share of the windows that must stay below that growth; the rest may tumble over a dead centre
        finest_reading: share of a sensor's range: nothing real is read to more than 24 bits, and no simulation is as
            exact
        loose: times the noise by which an initial position may be off its estimate; the window's own samples know
            better
        differenced: time, s, over which a position's noise becomes a velocity's: a sample at 500 Hz, so that no
            estimated velocity is trusted too far
        rough_speed: share of the usual speed by which an initial velocity may be off as well: smoothing rounds off
            where motion turns round
        at_rest: standard deviations of an initial velocity, below which a joint may as well start at rest
        begins: first samples that are asked with what velocity a recording begins, by a cubic: twice as many as it has
            numbers
        on_it: times the noise, up to which readings are off a curve that they lie on: of four, nine in ten times
        surely: standard deviations of what they tell, from which that velocity is not none, and times the noise, from
            which they are off the smoothed curve
        sure: share of the usual speed, up to which they may leave it open so, to tell anything
        blown_up: times the noise; a simulation that blew up is no worse than this
        block: s, within which neighbouring windows count as one when errors are compared: what is wrong in one is as
            wrong in the next
        steps: of a fit, unless it is asked for more: from where others came to, most end sooner
        from_afar: steps of a fit from nominal parameters, or to other windows than before: these may be far off
        tolerance: share of its objective, by which a step must lower it to be followed by another: about a tenth of
            what is worth an effect
        tries: of a step, each more damped than the one before: the fifth is a fifth of a plain one, and where even that
            is no better, derivatives mislead
        damping: of the first step, and of the first after one that failed: a little: nearly a Newton step
        damped: times, by which damping grows and falls: from next to none to much in few tries
        least_damping: below it rounding decides, where parameters make up for each other
        reach: of a step, in mapped parameters: none may do more than double, or change by a factor of e
        singular: share of the largest curvature, below which a direction of the parameters is not known at all
        still: largest step, in mapped parameters, that counts as none: reports show three digits
        shorter: times, by which a step of the initial states is shorter that is tried beside the whole one: behind a
            gap that goes too far
        rounds: steps of the initial states of what is drawn or reported: what is left falls as the square with each
        simulated: the same, at most, where several forms of a model are compared by how they come out
        searched: lengths of the moves, in mapped parameters, by which parameters are searched that change readings by
            steps: from a third of what is sizeable down to what forces tell
        tells: position for each unit of a reading, from which a sensor tells where a joint is: less is rounding
        hidden: times the spread of an initial state, where a sensor with a bias or a lag tells the state only through
            the model
        near: usual square error up to which a fit is near the noise, where derivatives can be believed
        typical: share of the windows that the usual square error is not below: a fifth may be far off and do not set
            the scale
        trusted: share of the fall that derivatives foretold, from which they are good for another step: to work them
            out anew costs a simulation for each parameter
        lag: part of the log square error that initial states could still explain, from which they are corrected: as
            much is worth an effect
        far_out: times the usual square error, from which something else happened in a window: it is off by twice as
            much as the others
        touch: finite difference of a mapped parameter where only the model's parameters are differenced, and the engine
            knows the rest: small, for nothing has a kink there
        foretold: share of what values moved a parameter of the program by, to which slopes must foretell it: an affine
            map is known to the rounding of small differences
        rounding: share of itself, to which a parameter of the program is known: a few of the last bit
        moved: share of itself, from which a value has moved: beyond what rounding does
        groups: of the values of tables whose slopes are found at once: a knot moves the bends at itself and at both its
            neighbours, and no further
        grouped: values of tables from which groups are asked: nine models, and some that tell whether they may be
        probe: finite difference of a mapped parameter; smaller ones drown in the kinks of dry friction
        least_slope: of a scale: one that stands still or runs backwards has no inverse, and is taken to run on slowly
        newton: steps from a reading to what a straight scale would give: four for a wave, a few more for a table
        moves: samples, in which a joint that surely moves goes further than its noise; they are smoothed over more
        integration: root mean square, in units of noise, by which halving a step may change a window's readings: as
            much adds a thousandth to the error of a right model
        halvings: of a step at most: what converges no faster than a contact would take hours
        stretch: s of simulation before a window, after which joints are put back to where they were: what hides behind
            them needs longer, and a rig that is balanced falls
        averaged: time, s, over which forces are averaged: no acceleration is known faster than that
    """

    window_length: float = 0.25
    samples: int = 40
    longest: float = 2.0
    enough: int = 36
    growth: float = 10.0
    fewest_samples: int = 12
    steady: float = 0.9
    finest_reading: float = 2.0**-24
    loose: float = 5.0
    differenced: float = 0.002
    rough_speed: float = 0.05
    at_rest: float = 2.0
    begins: int = 8
    on_it: float = 1.5
    surely: float = 3.0
    sure: float = 0.15
    blown_up: float = 1e6
    block: float = 1.0
    steps: int = 8
    from_afar: int = 20
    tolerance: float = 2e-3
    tries: int = 5
    damping: float = 1e-3
    damped: float = 8.0
    least_damping: float = 1e-7
    reach: float = 1.0
    singular: float = 1e-10
    still: float = 1e-4
    shorter: float = 3.0
    rounds: int = 3
    simulated: int = 2
    searched: tuple[float, ...] = (0.3, 0.1, 0.03)
    tells: float = 1e-9
    hidden: float = 1e3
    near: float = 2.0
    typical: float = 0.8
    trusted: float = 0.5
    lag: float = 0.02
    far_out: float = 4.0
    touch: float = 1e-6
    foretold: float = 1e-7
    rounding: float = 4 * 2.0**-52
    moved: float = 1e-12
    groups: int = 4
    grouped: int = 24
    probe: float = 0.02
    least_slope: float = 0.1
    newton: int = 12
    moves: float = 1.5
    integration: float = 0.05
    halvings: int = 3
    stretch: float = 0.15
    averaged: float = 0.025


ESTIMATION = EstimationSettings()
