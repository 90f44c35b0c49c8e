"""Where what stands in the arrays that compiled code reads: the contract between `program` and `loop`."""

from __future__ import annotations

from enum import IntEnum

JOINTS = 16  # most joints of a model
STATES = 128  # most states
CONTROLS = 32  # most commands
SENSORS = 64  # most sensors
STOPS = 32  # most limits of joints and tendons, and ties of joints


class Head(IntEnum):
    """Whole numbers at the beginning of a program."""

    JOINTS = 0
    STATES = 1
    CONTROLS = 2
    ELEMENTS = 3
    ELEMENT_AT = 4  # index of the first element's numbers
    SENSORS = 5
    SENSOR_AT = 6
    LAWS = 7
    LAW_AT = 8
    WEIGHED = 9  # whether a law asks for the weight on a joint
    JOINT_NUMBERS = 10  # index of the first joint's parameters
    DELAYS = 11  # index of the controls' delays among the parameters
    PARAMETERS = 12  # how many there are
    SAMPLES = 13  # of each sensor in a window
    STOPS = 14  # how many elements are stops, which push on what the rest leaves
    LATE = 15  # index of the delay of the sensor that reads latest, among the parameters
    RANGES = 16  # index of the least and the most of each control that laws see, among the parameters
    TIES = 17  # how many elements are ties, which come after the stops
    BOUNDED = 18  # whether the force of all actuators of a joint has a least and a most
    SIZE = 19


class Joint(IntEnum):
    """Parameters of a joint."""

    DAMPING = 0  # and two more coefficients
    STIFFNESS = 3  # and two more
    REST = 6
    ARMATURE = 7
    FRICTION = 8
    LOWEST = 9  # position that it must not leave, which MuJoCo would act upon
    HIGHEST = 10
    WEAKEST = 11  # least and most of the force of all its actuators
    STRONGEST = 12
    SIZE = 13


class Kind(IntEnum):
    """What an element is."""

    PLAIN = 0
    FILTERED = 1
    INTEGRATED = 2
    MOTOR = 3
    SPRING = 4
    STOP = 5
    YIELDING = 6  # a spring whose unbent position goes along where it is bent further than it bears
    RAMPS = 7  # actuators of one joint that take no command: forces that rise along a stretch and are held beyond
    TIE = 8  # joints that are held in proportion: a stop with no way between its ends, which pulls as well


class Element(IntEnum):
    """Whole numbers of an element."""

    KIND = 0
    TERMS = 1  # joints that it acts on
    TERM_AT = 2  # index of the first term's joint
    CONTROL = 3  # -1 for none
    STATE = 4  # -1 for none
    NUMBERS = 5  # index of its first parameter
    FEATURES = 6  # of ramps how many there are
    SIZE = 7


class Feature(IntEnum):
    """What a motor has; bits."""

    WINDING = 1
    HEAT = 2
    BRISTLES = 4
    COGS = 8


class Force(IntEnum):
    """Parameters of an element; those of a term, its coefficient, follow."""

    LOWEST_COMMAND = 0
    HIGHEST_COMMAND = 1
    LOWEST = 2
    HIGHEST = 3
    GAIN = 4  # and by length and speed; of a motor resistance, constant, growth with temperature
    BIAS = 7  # and by length and speed; of a motor temperature at which the resistance holds, ambient
    TIME = 10  # constant of a filter or winding
    COGS = 11  # amplitude, poles, phase
    BRISTLES = 14  # Coulomb, static, Stribeck velocity, stiffness, damping
    HEAT = 19  # resistance, capacity
    SIZE = 21


class Spring(IntEnum):
    """Parameters of a tendon that is a spring with a gap."""

    LOWEST = 0  # length from which it pulls
    HIGHEST = 1
    STIFFNESS = 2  # and two more
    DAMPING = 5  # and two more
    YIELD = 8  # of a spring that yields: how far it bends
    SIZE = 9


class Stop(IntEnum):
    """Parameters of a limit: what MuJoCo makes of `solref`, `solimp` and the inverse inertia that it takes for it."""

    LOWEST = 0
    HIGHEST = 1
    PULL = 2  # wanted acceleration per depth and impedance, 1/s^2
    DRAG = 3  # and per speed, 1/s
    WEIGHT = 4  # inverse inertia
    FIRST = 5  # impedance where it is met
    LAST = 6  # impedance from a depth of `WIDTH` on
    WIDTH = 7
    MIDPOINT = 8  # share of the width at which the impedance bends the other way
    BENDS = 9  # whether it does; else it grows evenly
    SIZE = 10


class Ramp(IntEnum):
    """Parameters of a ramp; those of an element stand one after the other, behind its term's coefficient."""

    BIAS = 0  # and by length and speed
    LOWEST = 3
    HIGHEST = 4
    SIZE = 5


class Sensor(IntEnum):
    """Whole numbers of a sensor."""

    TERMS = 0  # states whose weighted sum it reads
    TERM_AT = 1  # index of the first one
    NUMBERS = 2  # index of the first one's weight
    LAG = 3  # index of the state that follows it, -1 for none
    TIME = 4  # index of the lag's time constant
    AHEAD = 5  # index of how much later than the window's samples it is read
    SIZE = 6


class Law(IntEnum):
    """Whole numbers of what `<custom>` adds to a joint."""

    RULE = 0
    JOINT = 1
    NUMBERS = 2  # index of its first number
    COUNT = 3
    FIRST = 4  # state that it depends on, or STATES and a command; and the next
    SECOND = 5
    STATE = 6  # what it remembers, -1 for nothing
    SIZE = 7


class Row(IntEnum):
    """Whole numbers of a simulation."""

    WINDOW = 0
    PARAMETERS = 1
    DIRECTIONS = 2
    COMMANDS = 3  # first sample in the table of commands
    STAMPS = 4  # first stamp in the table of stamps
    COUNT = 5  # of stamps
    SIZE = 6


class At(IntEnum):
    """Addresses that a run is given."""

    PROGRAM = 0
    PARAMETERS = 1
    PARAMETER_TANGENTS = 2
    INITIAL = 3
    INITIAL_TANGENTS = 4
    ENDS = 5
    END_TANGENTS = 6
    ROWS = 7
    STAMPS = 8
    COMMANDS = 9
    COMMAND_TANGENTS = 10
    TIMES = 11
    READINGS = 12
    READING_TANGENTS = 13
    STEP = 14  # longest step, s
    UNTIL = 15  # of each window, s after its start
    CLOCK = 16  # time at each window's start, s
    LEFT = 17  # of each simulation, whether a joint left its range
    SIZE = 18
