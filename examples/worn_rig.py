"""A rig that has worn: a compensator trained when it was new, tried as friction grows.

Plants are frozen dataclasses; a changed one is made with `dataclasses.replace`, saved with `write`, and given to
`gymnasium.make` as object, dictionary or file. Run it: python examples/worn_rig.py
"""

import dataclasses
import warnings
from dataclasses import dataclass

import tyro

from dipc_gym.compensators import OutOfRangeWarning
from dipc_gym.controllers import LQR
from dipc_gym.plant import Friction, Plant
from dipc_gym.runs import balance, identify


@dataclass
class Arguments:
    compensator: str = "llnf"
    """what to train on the new rig"""
    seconds: float = 20.0
    """length of a run"""


if __name__ == "__main__":
    arguments = tyro.cli(Arguments)
    warnings.simplefilter("ignore", OutOfRangeWarning)
    new = Plant()
    trained = identify(new).fit(arguments.compensator)
    for wear in (0.5, 1.0, 1.5, 2.0):
        friction = Friction(coulomb=8.0 * wear, static=11.0 * wear)
        worn = dataclasses.replace(new, friction=friction)
        course = balance(LQR(), trained, seconds=arguments.seconds, seed=0, plant=worn)
        late = course.state[len(course.state) // 2 :]
        end = (
            f"fell after {course.time[-1]:.1f} s"
            if course.fell
            else f"cart up to {1000 * abs(late[:, 0]).max():.0f} mm"
        )
        print(f"friction x {wear:3.1f}: {end}")
