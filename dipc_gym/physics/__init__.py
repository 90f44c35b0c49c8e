"""The physics that MJCF cannot say, kept under `<custom>` of the same file and applied around MuJoCo's step.

MuJoCo has no dead zone in an amplifier, no sensor with a wrong gain, no friction that varies along a rail. Such
effects stand in the model file as

    <custom>
      <numeric name="dipc_gym:motor.deadzone:motor" data="0.4"/>
    </custom>

that is `dipc_gym:EFFECT:PLACE`, with the effect's numbers as data. Stock MuJoCo ignores the entry and simulates the
model without it; `load` applies it. Four kinds of effect exist, each a small function on arrays whose last axis is
the control, the sensor or the degree of freedom, so that one environment and a batch of a thousand run the same code:

    command    changes the command before the model sees it
    force      adds a generalised force that depends on time
    friction   sets the dry friction of a joint at each step
    sensor     changes a sensor's reading

and `timing.sensor_lag`, a sensor that follows its reading with a time constant, before its scale is bent. A force or
friction may remember one number, as how far a spring has crept or how long a joint has rested: it is kept in MuJoCo's
`userdata`, for which the file has to make room (`<size nuserdata="1"/>`), so that resets, copies and saved states
carry it.

`formulas` has the functions, `entries` says of each where it acts and what it takes, `numbers` which numbers it may
have, `custom` reads what stands in a file, and `applied` puts it around a model.
"""

from dipc_gym.physics.applied import Physics, from_model, load, stack
from dipc_gym.physics.entries import (
    RECENT,
    RESIDUAL,
    SAG,
    SAG_BY_LAW,
    Entry,
    Extra,
    Rule,
    Stage,
    entry_of,
    known,
    register,
)
from dipc_gym.physics.formulas import Moment

__all__ = [
    "RECENT",
    "RESIDUAL",
    "SAG",
    "SAG_BY_LAW",
    "Entry",
    "Extra",
    "Moment",
    "Physics",
    "Rule",
    "Stage",
    "entry_of",
    "from_model",
    "known",
    "load",
    "register",
    "stack",
]
