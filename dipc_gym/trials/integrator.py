"""The rigs' equations of motion with every hidden effect in them, and an integrator for them.

This is written from the equations, apart from MuJoCo and from the diagnosis tool, so that a blind trial
compares two independent pieces of work.

Between events the state is advanced by a fourth-order Runge-Kutta step. Dry friction is a hybrid automaton
(cf. Karnopp, "Computer simulation of stick-slip friction in mechanical dynamic systems", 1985, but without his
velocity band): a joint slides in one direction or is held exactly; the instant at which a sliding velocity
crosses zero is found, the joint is then held, and it breaks away when the force that holds it exceeds the
static level. Parameters are one flat vector, see `dipc_gym.trials.entries`.
"""

from __future__ import annotations

import numpy as np

from dipc_gym.trials.compiler import numba
from dipc_gym.trials.entries import GLOBAL, JOINT, JOINT_BASE, JOINT_SIZE, MAX_JOINTS

# Places in the vector of parameters, and within a joint's part of it.
(
    M0, M1, M2, COM1, COM2, INERTIA1, INERTIA2, LENGTH1, GRAVITY, TILT, MGL,
    KT, KE, RESISTANCE, INDUCTANCE, DEAD, VLIMIT, FLIMIT, COG_SIZE, COG_WAVE, COG_PHASE,
    HEAT_COEFFICIENT, HEAT_RESISTANCE, HEAT_TIME, DELAY,
    ROTOR, GAP, STIFFNESS, SHAFT_DAMPING,
    DRIFT, DRIFT_TIME, DWELL, DWELL_TIME, DWELL_POWER, SLOSH_MASS, SLOSH_RATE, SLOSH_DAMPING, SLOSH_BEND,
    SLOSH_POWER,
    CREEP_STIFFNESS, CREEP_TIME, CREEP_WIDTH, LEAK, ENCODER_SIZE, ENCODER_WAVE, ENCODER_PHASE,
    LAW, BUMP1, CENTRE1, WIDTH1, BUMP2, CENTRE2, WIDTH2, BUMP3, CENTRE3, WIDTH3,
    FALL, FALL_SPEED, FALL_POWER, RISE, RISE_SPEED, RISE_POWER,
    HYSTERESIS, HYSTERESIS_WIDTH, HYSTERESIS_POWER, CARRIED, SAG, SAG_CURRENT, SAG_TIME, SAG_POWER,
    THIN, THIN_TIME, THIN_SHEAR,
) = range(len(GLOBAL))  # fmt: skip
(
    DAMPING, QUADRATIC, COULOMB, ASYMMETRY, EXCESS, STRIBECK_SPEED, BRISTLE, BRISTLE_DAMPING,
    PLACE_SIZE, PLACE_WAVE, PLACE_PHASE, PER_LOAD, CONSTANT, SPRING, FORCE_SIZE, FORCE_WAVE, FORCE_PHASE,
    PERIODIC_SIZE, PERIODIC_RATE, PERIODIC_PHASE, PULSE_SIZE, PULSE_START, PULSE_LENGTH, PULSE_SQUARE,
    BIAS, GAIN, LAG, FILTER,
    STOP, STOP_STIFFNESS, STOP_DRAG,
) = range(len(JOINT))  # fmt: skip
# The state: joint positions, joint velocities, rotor angle and speed, current, bristle, winding heat,
# sloshing mass and its speed, creeping spring, hysteresis, how fast it moved and what it drew of late.
V, ROTOR_Q, ROTOR_V, CURRENT, BRISTLE_Z, HEAT, SLOSH_Q, SLOSH_V, CREEP, BENT, SHEARED, DRAWN = (
    3,
    6,
    7,
    8,
    9,
    10,
    11,
    12,
    13,
    14,
    15,
    16,
)
STATE_SIZE = 17  # numbers of a state
# What a law of any shape is: of the driven joint, but for the last, which acts on the first pole.
(
    NO_LAW, LEVEL_OF_PLACE, LEVEL_OF_SPEED, FORCE_OF_PLACE, AMPLIFIER, DRAG_OF_PLACE, GAIN_OF_PLACE, PULL_OF_CART,
    SCALE, LEVEL_UNDER_LOAD,
) = range(10)  # fmt: skip
FREE = 2  # mode of a joint without dry friction; -1 and 1: sliding; 0: held
SEEN = 64  # samples before a restart that a late sensor may still read

NO_FEEDBACK = np.zeros(2 * MAX_JOINTS + 2)


_jit = numba.njit(cache=True, fastmath=False, error_model="numpy")


@_jit
def _bumps(p, x):  # type: ignore[no-untyped-def]
    """A sum of three bell curves."""
    out = 0.0
    for k in range(BUMP1, WIDTH3 + 1, 3):
        if p[k] != 0.0:
            out += p[k] * np.exp(-(((x - p[k + 1]) / p[k + 2]) ** 2))
    return out


@_jit
def _bumps_slope(p, x):  # type: ignore[no-untyped-def]
    """Slope of that sum."""
    out = 0.0
    for k in range(BUMP1, WIDTH3 + 1, 3):
        if p[k] != 0.0:
            along = (x - p[k + 1]) / p[k + 2]
            out -= 2.0 * p[k] * along / p[k + 2] * np.exp(-(along**2))
    return out


@_jit
def _level(p, j, position, speed, direction, time, load):  # type: ignore[no-untyped-def]
    """Dry friction level of joint `j` for motion towards `direction`, N or N m."""
    b = JOINT_BASE + j * JOINT_SIZE
    level = p[b + COULOMB] * (1.0 + direction * p[b + ASYMMETRY])
    if p[b + PLACE_SIZE] != 0.0:
        level *= 1.0 + p[b + PLACE_SIZE] * np.sin(p[b + PLACE_WAVE] * position + p[b + PLACE_PHASE])
    level += p[b + PER_LOAD] * abs(load)
    if p[b + EXCESS] != 0.0:
        level += p[b + EXCESS] * np.exp(-((speed / p[b + STRIBECK_SPEED]) ** 2))
    if j == 0 and p[LAW] == LEVEL_OF_PLACE:
        level += _bumps(p, position)
    if j == 0 and p[LAW] == LEVEL_OF_SPEED:
        level += p[FALL] * np.exp(-((abs(speed) / p[FALL_SPEED]) ** p[FALL_POWER]))
        level += p[RISE] * (abs(speed) / p[RISE_SPEED]) ** p[RISE_POWER]
    if j == 0 and p[LAW] == LEVEL_UNDER_LOAD:
        sticks = p[FALL] * np.exp(-((abs(speed) / p[FALL_SPEED]) ** p[FALL_POWER]))
        level += p[CARRIED] * abs(load) * (1.0 + sticks)
    if j == 0 and p[DRIFT] != 0.0:
        level += p[DRIFT] * (1.0 - np.exp(-time / p[DRIFT_TIME]))
    return max(level, 0.0)


@_jit
def _dry(p, j):  # type: ignore[no-untyped-def]
    """Whether joint `j` has dry friction that can hold it (bristles never hold)."""
    b = JOINT_BASE + j * JOINT_SIZE
    if p[b + BRISTLE] > 0.0:
        return False
    there = p[b + COULOMB] > 0.0 or p[b + PER_LOAD] > 0.0 or p[b + EXCESS] > 0.0
    law = p[LAW] == LEVEL_OF_PLACE or p[LAW] == LEVEL_OF_SPEED or p[LAW] == LEVEL_UNDER_LOAD
    return there or (j == 0 and (p[DRIFT] > 0.0 or p[DWELL] > 0.0 or law))


@_jit
def amplifier(p, command, gain):  # type: ignore[no-untyped-def]
    """Voltage (or torque command) that reaches the motor."""
    u = command
    dead = p[DEAD]
    if dead > 0.0:
        u = u - min(max(u, -dead), dead)
    if p[VLIMIT] > 0.0:
        u = min(max(u, -p[VLIMIT]), p[VLIMIT])
    if p[LAW] == AMPLIFIER:
        u += _bumps(p, u)
    return u * gain


@_jit
def derivative(time, s, u, p, n, mode, out, hold, mass, rhs):  # type: ignore[no-untyped-def]
    """Rate of the state into `out`; the force that holds each held joint into `hold`.

    Returns the force that the first joint is driven by, what its motor's transmission passes on, N or N m.
    """
    for k in range(STATE_SIZE):
        out[k] = 0.0
    if p[SAG] > 0.0:
        u = u * (1.0 - min(p[SAG] * s[DRAWN], 0.9))
    drive = _transmitted(s, _motor(s, u, p, out), p, out)
    for j in range(n):
        rhs[j] = _along_joint(time, s, p, j, mode[j], drive)
    rhs[0] += drive
    _bend(time, s, p, drive, out, rhs)
    _push(s, u, p, rhs)
    _creep(s, p, out, rhs)

    own = p[M0] * (1.0 + p[LEAK] * time)
    for j in range(n):
        out[j] = s[V + j]
        hold[j] = 0.0
    if n > 1:
        _accelerate_poles(s, own, p, mode, out, hold, mass, rhs)
        return drive
    # A cart feels a tilt as a part of its weight; a pendulum has MGL in place of it, its gravity torque.
    rhs[0] += own * p[GRAVITY] * np.sin(p[TILT]) - p[MGL] * np.sin(s[0] + p[TILT])
    if mode[0] == 0:
        hold[0] = -rhs[0]
    else:
        out[V] = rhs[0] / own
    return drive


@_jit
def _motor(s, u, p, out):  # type: ignore[no-untyped-def]
    """Force of a motor at the voltage `u`, with its winding, heat, limit and cogging."""
    has_rotor = p[STIFFNESS] > 0.0
    motor_q = s[ROTOR_Q] if has_rotor else s[0]
    motor_v = s[ROTOR_V] if has_rotor else s[V]
    resistance = p[RESISTANCE] * (1.0 + p[HEAT_COEFFICIENT] * s[HEAT])
    if p[INDUCTANCE] > 0.0:
        current = s[CURRENT]
        out[CURRENT] = (u - p[KE] * motor_v - resistance * current) / p[INDUCTANCE]
    else:
        current = (u - p[KE] * motor_v) / resistance
    if p[SAG] > 0.0:
        out[DRAWN] = ((abs(current) / p[SAG_CURRENT]) ** p[SAG_POWER] - s[DRAWN]) / p[SAG_TIME]
    if p[HEAT_COEFFICIENT] > 0.0:
        out[HEAT] = (resistance * current * current * p[HEAT_RESISTANCE] - s[HEAT]) / p[HEAT_TIME]
    force = p[KT] * current
    if p[FLIMIT] > 0.0:
        force = min(max(force, -p[FLIMIT]), p[FLIMIT])
    if p[COG_SIZE] != 0.0:
        force += p[COG_SIZE] * np.sin(p[COG_WAVE] * motor_q + p[COG_PHASE])
    return force


@_jit
def _transmitted(s, force, p, out):  # type: ignore[no-untyped-def]
    """What a shaft, maybe with a gap, passes on of the motor's force."""
    if not p[STIFFNESS] > 0.0:
        return force
    stretch = s[ROTOR_Q] - s[0]
    rate = s[ROTOR_V] - s[V]
    half = 0.5 * p[GAP]
    drive = 0.0
    if half == 0.0:
        drive = p[STIFFNESS] * stretch + p[SHAFT_DAMPING] * rate
    elif stretch > half:
        drive = max(0.0, p[STIFFNESS] * (stretch - half) + p[SHAFT_DAMPING] * rate)
    elif stretch < -half:
        drive = min(0.0, p[STIFFNESS] * (stretch + half) + p[SHAFT_DAMPING] * rate)
    out[ROTOR_Q] = s[ROTOR_V]
    out[ROTOR_V] = (force - drive) / p[ROTOR]
    return drive


@_jit
def _along_joint(time, s, p, j, mode, drive):  # type: ignore[no-untyped-def]
    """Smooth forces at a joint, and dry friction where it slides."""
    b = JOINT_BASE + j * JOINT_SIZE
    q, v = s[j], s[V + j]
    f = -p[b + DAMPING] * v - p[b + QUADRATIC] * v * abs(v) + p[b + CONSTANT] - p[b + SPRING] * q
    if p[b + FORCE_SIZE] != 0.0:
        f += p[b + FORCE_SIZE] * np.sin(p[b + FORCE_WAVE] * q + p[b + FORCE_PHASE])
    if p[b + PERIODIC_SIZE] != 0.0:
        f += p[b + PERIODIC_SIZE] * np.sin(p[b + PERIODIC_RATE] * time + p[b + PERIODIC_PHASE])
    since = time - p[b + PULSE_START]
    if p[b + PULSE_SIZE] != 0.0 and since >= 0.0 and since < p[b + PULSE_LENGTH]:
        round_pulse = np.sin(np.pi * since / p[b + PULSE_LENGTH])
        f += p[b + PULSE_SIZE] * (1.0 if p[b + PULSE_SQUARE] > 0.0 else round_pulse)
    if p[b + STOP_STIFFNESS] > 0.0:
        side = 1.0 if p[b + STOP] > 0.0 else -1.0
        deep = side * (q - p[b + STOP])
        if deep > 0.0:  # it only pushes, and does not hold what leaves it
            f -= side * max(0.0, p[b + STOP_STIFFNESS] * deep + p[b + STOP_DRAG] * side * v)
    if mode == 1 or mode == -1:
        f -= mode * _level(p, j, q, v, mode, time, drive)
    return f


@_jit
def _bend(time, s, p, drive, out, rhs):  # type: ignore[no-untyped-def]
    """What acts on the driven joint and remembers: bristles, a sloshing mass, hysteresis, a film that thins."""
    b = JOINT_BASE
    if p[b + BRISTLE] > 0.0:
        direction = 1.0 if s[V] >= 0.0 else -1.0
        level = _level(p, 0, s[0], s[V], direction, time, drive)
        rate = s[V] - p[b + BRISTLE] * abs(s[V]) * s[BRISTLE_Z] / max(level, 1e-9)
        out[BRISTLE_Z] = rate
        rhs[0] -= p[b + BRISTLE] * s[BRISTLE_Z] + p[b + BRISTLE_DAMPING] * rate
    if p[SLOSH_MASS] > 0.0:
        held = p[SLOSH_RATE] ** 2 * (s[SLOSH_Q] - s[0])
        if p[SLOSH_BEND] > 0.0:
            held *= (1.0 + (held / p[SLOSH_BEND]) ** 2) ** p[SLOSH_POWER]
        pull = held + 2.0 * p[SLOSH_DAMPING] * p[SLOSH_RATE] * (s[SLOSH_V] - s[V])
        out[SLOSH_Q] = s[SLOSH_V]
        out[SLOSH_V] = -pull
        rhs[0] += p[SLOSH_MASS] * pull
    if p[HYSTERESIS] > 0.0:
        # Bouc and Wen's: the force bends with the way, and less the further it is bent that way.
        share = s[BENT] / p[HYSTERESIS_WIDTH]
        out[BENT] = s[V] - (0.5 * abs(s[V]) * share + 0.5 * s[V] * abs(share)) * abs(share) ** (p[HYSTERESIS_POWER] - 1)
        rhs[0] -= p[HYSTERESIS] * share
    if p[THIN] > 0.0:
        out[SHEARED] = (abs(s[V]) - s[SHEARED]) / p[THIN_TIME]
        rhs[0] -= p[THIN] * np.exp(-s[SHEARED] / p[THIN_SHEAR]) * s[V]


@_jit
def _push(s, u, p, rhs):  # type: ignore[no-untyped-def]
    """The force of a law of any shape."""
    if p[LAW] == FORCE_OF_PLACE:
        rhs[0] += _bumps(p, s[0])
    elif p[LAW] == DRAG_OF_PLACE:
        rhs[0] -= _bumps(p, s[0]) * s[V]
    elif p[LAW] == GAIN_OF_PLACE:
        rhs[0] += _bumps(p, s[0]) * u
    elif p[LAW] == PULL_OF_CART:
        rhs[1] += _bumps(p, s[0]) * np.sin(2.0 * s[1])


@_jit
def _creep(s, p, out, rhs):  # type: ignore[no-untyped-def]
    """The force of a spring that gives way."""
    if p[CREEP_STIFFNESS] > 0.0:
        gives = s[CREEP]
        if p[CREEP_WIDTH] > 0.0:  # after Eyring
            gives = p[CREEP_WIDTH] * np.sinh(s[CREEP] / p[CREEP_WIDTH])
        out[CREEP] = s[V] - gives / p[CREEP_TIME]
        rhs[0] -= p[CREEP_STIFFNESS] * s[CREEP]


@_jit
def _accelerate_poles(s, own, p, mode, out, hold, mass, rhs):  # type: ignore[no-untyped-def]
    """Accelerations of two poles on a cart, in absolute angles from upright, then turned into joint angles."""
    d2 = p[M1] * p[COM1] + p[M2] * p[LENGTH1]
    d3 = p[M2] * p[COM2]
    d5 = p[M2] * p[LENGTH1] * p[COM2]
    a1, a2 = s[1], s[1] + s[2]
    w1, w2 = s[V + 1], s[V + 1] + s[V + 2]
    m12, m13, m23 = d2 * np.cos(a1), d3 * np.cos(a2), d5 * np.cos(a1 - a2)
    m22 = p[M1] * p[COM1] ** 2 + p[INERTIA1] + p[M2] * p[LENGTH1] ** 2
    m33 = p[M2] * p[COM2] ** 2 + p[INERTIA2]
    total = own + p[M1] + p[M2]
    twist = d5 * np.sin(a1 - a2)
    fx = d2 * np.sin(a1) * w1 * w1 + d3 * np.sin(a2) * w2 * w2 + total * p[GRAVITY] * np.sin(p[TILT])
    f1 = -twist * w2 * w2 + d2 * p[GRAVITY] * np.sin(a1 + p[TILT])
    f2 = twist * w1 * w1 + d3 * p[GRAVITY] * np.sin(a2 + p[TILT])
    rhs[0] += fx
    rhs[1] += f1 + f2
    rhs[2] += f2
    mass[0, 0], mass[0, 1], mass[0, 2] = total, m12 + m13, m13
    mass[1, 1], mass[1, 2], mass[2, 2] = m22 + 2.0 * m23 + m33, m23 + m33, m33
    mass[1, 0], mass[2, 0], mass[2, 1] = mass[0, 1], mass[0, 2], mass[1, 2]
    _accelerate(mass, rhs, mode, out)
    for j in range(3):
        if mode[j] == 0:
            hold[j] = -rhs[j]
            for k in range(3):
                hold[j] += mass[j, k] * out[V + k]


@_jit
def _accelerate(mass, rhs, mode, out):  # type: ignore[no-untyped-def]
    """Solve `mass @ a = rhs` with a = 0 for held joints (Cramer's rule, rows of held joints made trivial)."""
    a, b, c = mass[0, 0], mass[0, 1], mass[0, 2]
    d, e, f = mass[1, 1], mass[1, 2], mass[2, 2]
    r0, r1, r2 = rhs[0], rhs[1], rhs[2]
    if mode[0] == 0:
        a, b, c, r0 = 1.0, 0.0, 0.0, 0.0
    if mode[1] == 0:
        d, b, e, r1 = 1.0, 0.0, 0.0, 0.0
    if mode[2] == 0:
        f, c, e, r2 = 1.0, 0.0, 0.0, 0.0
    i00, i01, i02 = d * f - e * e, c * e - b * f, b * e - c * d
    det = a * i00 + b * i01 + c * i02
    out[V] = (i00 * r0 + i01 * r1 + i02 * r2) / det
    out[V + 1] = (i01 * r0 + (a * f - c * c) * r1 + (b * c - a * e) * r2) / det
    out[V + 2] = (i02 * r0 + (b * c - a * e) * r1 + (a * d - b * b) * r2) / det


@_jit
def _runge_kutta(time, h, s, u, p, n, mode, k1, k2, k3, k4, x, hold, mass, rhs):  # type: ignore[no-untyped-def]
    derivative(time, s, u, p, n, mode, k1, hold, mass, rhs)
    for i in range(STATE_SIZE):
        x[i] = s[i] + 0.5 * h * k1[i]
    derivative(time + 0.5 * h, x, u, p, n, mode, k2, hold, mass, rhs)
    for i in range(STATE_SIZE):
        x[i] = s[i] + 0.5 * h * k2[i]
    derivative(time + 0.5 * h, x, u, p, n, mode, k3, hold, mass, rhs)
    for i in range(STATE_SIZE):
        x[i] = s[i] + h * k3[i]
    derivative(time + h, x, u, p, n, mode, k4, hold, mass, rhs)
    for i in range(STATE_SIZE):
        x[i] = s[i] + h / 6.0 * (k1[i] + 2.0 * k2[i] + 2.0 * k3[i] + k4[i])


@_jit
def _break_away(time, s, u, p, n, mode, rested, k1, hold, mass, rhs):  # type: ignore[no-untyped-def]
    """Let go of held joints whose holding force exceeds the static level, the most overloaded first."""
    for _ in range(n):
        drive = derivative(time, s, u, p, n, mode, k1, hold, mass, rhs)
        worst, excess, towards = -1, 0.0, 0
        for j in range(n):
            if mode[j] == 0:
                direction = -1 if hold[j] > 0.0 else 1
                limit = _level(p, j, s[j], 0.0, direction, time, drive)
                if j == 0 and p[DWELL] > 0.0:
                    aged = rested[0] / p[DWELL_TIME]
                    if p[DWELL_POWER] > 0.0:
                        aged = aged ** p[DWELL_POWER]
                    limit += p[DWELL] * (1.0 - np.exp(-aged))
                if abs(hold[j]) - limit > excess:
                    worst, excess, towards = j, abs(hold[j]) - limit, direction
        if worst < 0:
            return
        mode[worst] = towards
        rested[worst] = 0.0


@_jit
def _crossing(begin, middle, end, part):  # type: ignore[no-untyped-def]
    """Where a parabola through the values at 0, `part` and 1 crosses zero; `part` where it bends too much to say."""
    if part <= 0.0 or part >= 1.0:
        return part
    slope = (middle - begin) / part
    bend = (end - middle) / (1.0 - part) - slope
    # Newton's step on the parabola from `part`, where it is nearly zero already.
    steep = slope + bend * part
    if steep * begin >= 0.0:
        return part
    return min(max(part - middle / steep, 0.0), 1.0)


@_jit
def _advance(time, span, step, s, u, p, n, mode, rested, work, mass):  # type: ignore[no-untyped-def]
    """Integrate over `span` seconds under a constant input, in equal steps of at most `step` seconds."""
    k1, k2, k3, k4, x, hold, rhs = work[0], work[1], work[2], work[3], work[4], work[5], work[6]
    steps = max(1, int(np.ceil(span / step - 1e-9)))
    h = span / steps
    for _ in range(steps):
        left = h
        for _event in range(6 * n + 2):
            held = False
            for j in range(n):
                held = held or mode[j] == 0
            if held:
                _break_away(time, s, u, p, n, mode, rested, k1, hold, mass, rhs)
            _runge_kutta(time, left, s, u, p, n, mode, k1, k2, k3, k4, x, hold, mass, rhs)
            part, which = 1.0, -1
            for j in range(n):
                if (mode[j] == 1 or mode[j] == -1) and x[V + j] * mode[j] < 0.0:
                    share = s[V + j] / (s[V + j] - x[V + j]) if s[V + j] * mode[j] > 0.0 else 0.0
                    if share < part:
                        part, which = share, j
            if which >= 0:
                end = x[V + which]
                _runge_kutta(time, part * left, s, u, p, n, mode, k1, k2, k3, k4, x, hold, mass, rhs)
                part = _crossing(s[V + which], x[V + which], end, part)
                _runge_kutta(time, part * left, s, u, p, n, mode, k1, k2, k3, k4, x, hold, mass, rhs)
                x[V + which] = 0.0
                mode[which] = 0
            for i in range(STATE_SIZE):
                s[i] = x[i]
            time += part * left
            for j in range(n):
                if mode[j] == 0:
                    s[V + j] = 0.0
                    rested[j] += part * left
            left *= 1.0 - part
            if left <= 0.0:
                break
    return time


@_jit
def _between(q0, v0, q1, v1, dt, x):  # type: ignore[no-untyped-def]
    """Cubic Hermite value and slope at the fraction `x` of an interval of `dt` seconds."""
    value = (
        (1.0 + 2.0 * x) * (1.0 - x) ** 2 * q0
        + x * (1.0 - x) ** 2 * dt * v0
        + x * x * (3.0 - 2.0 * x) * q1
        + x * x * (x - 1.0) * dt * v1
    )
    slope = 6.0 * x * (x - 1.0) * (q0 - q1) / dt + (1.0 - x) * (1.0 - 3.0 * x) * v0 + x * (3.0 * x - 2.0) * v1
    return value, slope


@_jit
def unscaled(p, y, slope):  # type: ignore[no-untyped-def]
    """What an encoder makes its readings of, in place: an eccentric one, or one whose scale is a law.

    Args:
        p: parameters, see `dipc_gym.trials.entries`.
        y: readings of the first joint, free of gain and bias, shape (samples,).
        slope: their rates.
    """
    for i in range(len(y)):
        x = y[i]
        for _ in range(50):  # a scale is off by less than it goes: each step comes nearer
            before = x
            if p[ENCODER_SIZE] != 0.0:
                x = y[i] - p[ENCODER_SIZE] * np.sin(p[ENCODER_WAVE] * x + p[ENCODER_PHASE])
            elif p[LAW] == SCALE:
                x = y[i] - _bumps(p, x)
            if abs(x - before) < 1e-12:
                break
        y[i] = x
        if p[ENCODER_SIZE] != 0.0:
            slope[i] /= 1.0 + p[ENCODER_SIZE] * p[ENCODER_WAVE] * np.cos(p[ENCODER_WAVE] * x + p[ENCODER_PHASE])
        elif p[LAW] == SCALE:
            slope[i] /= 1.0 + _bumps_slope(p, x)


@_jit
def _restart(k, s, p, n, mode, filtered, seen_q, seen_v, start_q, start_v, start_y):  # type: ignore[no-untyped-def]
    """Set positions and velocities to those of sample `k`; rotor and sloshing mass stay where they are beside them."""
    lead_q, lead_v = s[ROTOR_Q] - s[0], s[ROTOR_V] - s[V]
    away_q, away_v = s[SLOSH_Q] - s[0], s[SLOSH_V] - s[V]
    for j in range(n):
        s[j], s[V + j] = start_q[k, j], start_v[k, j]
        filtered[j] = start_y[k, j]
        mode[j] = FREE
        if _dry(p, j):
            mode[j] = 0 if abs(s[V + j]) < 1e-12 else (1 if s[V + j] > 0.0 else -1)
    s[ROTOR_Q], s[ROTOR_V] = s[0] + lead_q, s[V] + lead_v
    s[SLOSH_Q], s[SLOSH_V] = s[0] + away_q, s[V] + away_v
    for i in range(max(0, k - SEEN), k):
        for j in range(n):
            seen_q[i, j], seen_v[i, j] = start_q[i, j], start_v[i, j]


@_jit
def _read(k, j, dt, begins, s, p, filtered, seen_q, seen_v):  # type: ignore[no-untyped-def]
    """What a sensor that is late, lags, is eccentric or has a scale of its own says of joint `j`, and its slope.

    Gain and bias come after that. `begins` tells whether its filter was set just now.
    """
    b = JOINT_BASE + j * JOINT_SIZE
    y, slope = s[j], s[V + j]
    if p[b + LAG] > 0.0:
        back = p[b + LAG] / dt
        whole = int(back)
        i = k - whole - 1
        if i < 0:
            y, slope = seen_q[0, j], seen_v[0, j]
        else:
            y, slope = _between(
                seen_q[i, j], seen_v[i, j], seen_q[i + 1, j], seen_v[i + 1, j], dt, 1.0 - (back - whole)
            )
    if p[b + FILTER] > 0.0:
        if not begins:
            parts = 8
            keep = np.exp(-dt / parts / p[b + FILTER])
            lag = p[b + FILTER] * (1.0 - keep) / (dt / parts)
            q0 = seen_q[k - 1, j]
            for i in range(parts):
                q1, _ = _between(seen_q[k - 1, j], seen_v[k - 1, j], s[j], s[V + j], dt, (i + 1.0) / parts)
                filtered[j] = keep * filtered[j] + (lag - keep) * q0 + (1.0 - lag) * q1
                q0 = q1
        y, slope = filtered[j], (s[j] - filtered[j]) / p[b + FILTER]
    if j == 0 and p[ENCODER_SIZE] != 0.0:
        wave, angle = p[ENCODER_WAVE], p[ENCODER_WAVE] * y + p[ENCODER_PHASE]
        y += p[ENCODER_SIZE] * np.sin(angle)
        slope *= 1.0 + p[ENCODER_SIZE] * wave * np.cos(angle)
    if j == 0 and p[LAW] == SCALE:
        slope *= 1.0 + _bumps_slope(p, y)
        y += _bumps(p, y)
    return y, slope


@_jit
def _fed_back(k, dt, drive, feedback, n, measured, rate):  # type: ignore[no-untyped-def]
    """The command: what was planned, less feedback of measured positions and of their filtered slopes."""
    u = drive
    pole = feedback[6]
    for j in range(n):
        if k > 0:
            rate[j] = pole * rate[j] + (1.0 - pole) * (measured[k, j] - measured[k - 1, j]) / dt
        u -= feedback[j] * measured[k, j] + feedback[3 + j] * rate[j]
    if feedback[7] > 0.0:
        u = min(max(u, -feedback[7]), feedback[7])
    return u


@_jit
def simulate(p, n, dt, step, drive, amplifier_gain, feedback, quantum, noise, start_q, start_v, start_y, every):  # type: ignore[no-untyped-def]
    """Run a rig, or its windows, over a whole recording.

    Args:
        p: parameters, see `dipc_gym.trials.entries`.
        n: number of joints, 1 or 3.
        dt: sample time, s. Commands are held for one sample.
        step: largest integration step, s.
        drive: command or, with feedback, what is added to it, shape (samples,).
        amplifier_gain: factor on the command at each sample, shape (samples,).
        feedback: three gains on the measured position, three on its filtered slope, the filter's pole, the
            command limit (0: none).
        quantum: encoder steps, shape (n,).
        noise: added before quantisation, shape (samples, n).
        start_q: joint positions at the samples where a window starts, shape (samples, n).
        start_v: joint velocities there, shape (samples, n).
        start_y: sensor filter outputs there, shape (samples, n).
        every: samples between restarts; 0 for one long run. A restart sets positions and velocities and
            carries everything else (current, heat, bristle, rotor lead) on.

    Returns:
        Joint positions, velocities, noise-free readings and their slopes, measured values, each of shape
        (samples, n), and commands of shape (samples,).
    """
    count = drive.shape[0]
    q_log, v_log = np.zeros((count, n)), np.zeros((count, n))
    y_log, slope_log, measured = np.zeros((count, n)), np.zeros((count, n)), np.zeros((count, n))
    seen_q, seen_v = np.zeros((count, n)), np.zeros((count, n))
    command = np.zeros(count)
    s, work, mass = np.zeros(STATE_SIZE), np.zeros((7, STATE_SIZE)), np.zeros((3, 3))
    mode, rested = np.zeros(n, dtype=np.int64), np.zeros(n)
    filtered, rate = np.zeros(n), np.zeros(n)
    late = int(p[DELAY] / dt + 1e-9)
    remainder = p[DELAY] - late * dt
    if remainder < 1e-12:
        remainder = 0.0
    for k in range(count):
        time = k * dt
        begins = k == 0 or (every > 0 and k % every == 0)
        if begins:
            _restart(k, s, p, n, mode, filtered, seen_q, seen_v, start_q, start_v, start_y)
        for j in range(n):
            b = JOINT_BASE + j * JOINT_SIZE
            q_log[k, j], v_log[k, j] = s[j], s[V + j]
            seen_q[k, j], seen_v[k, j] = s[j], s[V + j]
            y, slope = _read(k, j, dt, begins, s, p, filtered, seen_q, seen_v)
            y_log[k, j] = (1.0 + p[b + GAIN]) * y + p[b + BIAS]
            slope_log[k, j] = (1.0 + p[b + GAIN]) * slope
            measured[k, j] = np.round((y_log[k, j] + noise[k, j]) / quantum[j]) * quantum[j]
        command[k] = _fed_back(k, dt, drive[k], feedback, n, measured, rate)
        before = command[k - late - 1] if k - late - 1 >= 0 else 0.0
        now = command[k - late] if k - late >= 0 else 0.0
        if remainder > 0.0:
            held = amplifier(p, before, amplifier_gain[k])
            time = _advance(time, remainder, step, s, held, p, n, mode, rested, work, mass)
        held = amplifier(p, now, amplifier_gain[k])
        _advance(time, dt - remainder, step, s, held, p, n, mode, rested, work, mass)
    return q_log, v_log, y_log, slope_log, measured, command
