"""What the model of a structure decides by: numbers with their reasons, in one place."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ModelSettings:
    """Decision constants of structures and their parameters.

    What is said of a prior is its standard deviation, as a logarithm: how far a parameter of a kind may plausibly be
    off.

    Attributes:
        friction: of damping and dry friction, the least known of all: a bearing's damping may be a guess that is off by
            a factor of fifty
        springs: of stiffness and armature, which no data sheet gives for a whole assembly
        motors: of a motor's resistance, constant and gear: copper that warms by 60 K resists by a quarter more
        servos: of a servo's gains: numbers of a register, in a unit of its maker's
        mass: of a body's mass, which a balance tells; what is fixed to it later is about a tenth of it
        centre: of how far a body's centre of mass is from its axis: a drawing tells it, to a twentieth
        least_arm: m; a rotor whose centre of mass is on its axis has none that could be off
        farthest: standard deviations of its prior by which a model parameter may move: beyond, it would be another part
        widest: as a logarithm, no parameter is mapped further, and an interval of more than that half width says
            nothing: no rig has a ratio of twenty digits
        settles: times in which a limit or a tie settles, that a step may take at most: Runge-Kutta makes a half of what
            is left in that, and more than there was at 2.8
        fallback: share of its bound that a parameter whose first guess is zero is measured in: that is small, and yet
            felt
        kept: models that stay compiled, of all structures: a fit asks for the same ones again, and each takes a tenth
            of a megabyte
    """

    friction: float = 1.5
    springs: float = 0.5
    motors: float = 0.3
    servos: float = 0.7
    mass: float = 0.1
    centre: float = 0.05
    least_arm: float = 1e-4
    farthest: float = 4.0
    widest: float = 50.0
    settles: float = 2.2
    fallback: float = 0.1
    kept: int = 64


MODEL = ModelSettings()
