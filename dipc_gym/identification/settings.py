"""What an identification run is judged by: numbers with their reasons, in one place."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ExcitationSettings:
    """Decision constants of what a run excites, and whether anything can be learned from it.

    Attributes:
        rows: of the map, along force: odd, so that weak forces have one of their own
        columns: of the map, along velocity: more, for friction is steepest near zero
        full: samples from which on a cell of the map counts as covered
        fewest_reversals: of motion that a recording needs, for friction shows there
        slow: share of the largest speed below which motion is slow; friction is steepest there
        standstill: share of the largest speed, below which a change of sign is jitter and no reversal
        few: samples that a region needs: fewer are one passage through it
        middle: times, that force and speed are below their largest, from which both are weak, as they are in balancing
        one_sided: share of the largest speed that is to be reached the other way as well: friction differs between
            the two
        narrow: share of the map; the paper's sweep covers two thirds
        loudest: noise of the force beyond this share of the force itself leaves too little to learn
        least_own: share of the force that must vary independently of velocity; below it, the two are one number
        above_noise: times its noise, that this part must exceed as well: else it may be nothing but that
        least_explained: share of the voltage's variance that force and velocity explain in any run of a rig with the
            columns right
        weak: share of what the motor can exert, within which a force may be too small to set the cart sliding; above
            it, what is lost may follow position for another reason
        most: times what the motor exerts, that a cart's force may come to: a gain that is off by so much would be seen
        least: share of what the voltages exert, that it has to come to: friction that takes the rest lets no cart move
    """

    rows: int = 9
    columns: int = 25
    full: int = 5
    fewest_reversals: int = 4
    slow: float = 0.1
    standstill: float = 0.02
    few: int = 20
    middle: float = 3.0
    one_sided: float = 0.5
    narrow: float = 0.3
    loudest: float = 0.5
    least_own: float = 0.05
    above_noise: float = 2.0
    least_explained: float = 0.5
    weak: float = 0.1
    most: float = 3.0
    least: float = 0.01


EXCITATION = ExcitationSettings()


@dataclass(frozen=True)
class RunSettings:
    """Decision constants of what an identification run tells of mass, friction and delay.

    Attributes:
        fast: of the largest speed, above which dry friction is Coulomb's: below, it has a curve of its own
        longest_delay: s, that is looked for: no motor drive answers later
    """

    fast: float = 0.2
    longest_delay: float = 0.06


RUN = RunSettings()
