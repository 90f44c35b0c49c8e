"""Which column of a file is which command or sensor of the model, and in which unit."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence

from dipc_gym.recording.tables import RecordingError
from dipc_gym.recording.units import check_kind, factor
from dipc_gym.safety.naming import suggestion

COMMAND, SENSOR = "ctrl:", "sensor:"  # prefixes that tell an actuator and a sensor of one name apart


def called(prefix: str, name: str, others: Sequence[str]) -> str:
    """How `--unit` and `--map` call a command or a sensor: with its prefix where `others`, of the other kind, have one
    of that name.

    Example:
        >>> called(COMMAND, "arm", ["arm"]), called(COMMAND, "motor", ["arm"])
        ('ctrl:arm', 'motor')
    """
    return prefix + name if name in others else name


def match_columns(
    where: str, names: Sequence[str], ctrl: Sequence[str], sensor: Sequence[str], mapping: Mapping[str, str]
) -> dict[str, str]:
    """Which file column holds which channel; time first, then the model's order."""
    sides = f"the file has {list(names)}; the model wants ['time'], controls {list(ctrl)} and sensors {list(sensor)}"
    channels_of: dict[str, list[str]] = {"time": ["time"]}
    for prefix, wanted in ((COMMAND, ctrl), (SENSOR, sensor)):
        for name in wanted:
            channels_of.setdefault(prefix + name, []).append(prefix + name)
            if name != "time" and not name.startswith((COMMAND, SENSOR)):
                channels_of.setdefault(name, []).append(prefix + name)
    for column, name in mapping.items():
        if column not in names:
            turned = name in names and column in channels_of
            hint = " (a mapping is FILE_COLUMN=MODEL_NAME)" if turned else ""
            near = "" if turned else suggestion(column, names)
            raise RecordingError(f"{where}: there is no column {column!r} to map to {name!r}{hint}; {sides}{near}")
        if name not in channels_of:
            raise RecordingError(
                f"{where}: column {column!r} is mapped to {name!r}, which is not in the model; {sides}"
                f"{suggestion(name, channels_of)}"
            )
    found: dict[str, str] = {}
    for column in names:
        meant = channels_of.get(mapping.get(column, column), [])
        if len(meant) > 1:
            raise RecordingError(
                f"{where}: column {column!r} may be an actuator or a sensor, the model has both; "
                f"name it {meant[0]!r} or {meant[1]!r}"
            )
        for channel in meant:
            if channel in found:
                raise RecordingError(f"{where}: columns {found[channel]!r} and {column!r} both mean {channel!r}")
            found[channel] = column
    order = ["time", *(COMMAND + name for name in ctrl), *(SENSOR + name for name in sensor)]
    missing = [channel for channel in order if channel not in found]
    if missing:
        # As a file and --map may call them: without a prefix where the model has one of that name alone.
        plain = [next((n for n, meant in channels_of.items() if meant == [c] and n != c), c) for c in missing]
        left = [column for column in names if column not in found.values()]
        raise RecordingError(
            f"{where}: no column for {plain}; {sides}; rename them, use --map COLUMN=NAME, or take a sensor "
            f"that nobody recorded out of the model{_near(plain, left)}"
        )
    return {channel: found[channel] for channel in order}


def _near(missing: Sequence[str], left: Sequence[str]) -> str:
    """The end of a message about names without a column: the mapping that was probably meant."""
    for name in missing:
        near = difflib.get_close_matches(name.removeprefix(COMMAND).removeprefix(SENSOR), left, n=1)
        if near:
            return f"; did you mean --map {near[0]}={name}?"
    return ""


def unit_factors(
    where: str, wanted: Mapping[str, str], units: Mapping[str, str], measured: Mapping[str, str]
) -> dict[str, float]:
    """Factor to SI of each channel that a unit is given for.

    Args:
        where: the file.
        wanted: its column for each channel.
        units: by a column or a name of the model.
        measured: SI unit of each channel, where that is known.
    """
    factors: dict[str, float] = {}
    for key, unit in units.items():
        meant = [c for c, column in wanted.items() if key in (column, c)] or [
            c for c in wanted if key in (c.removeprefix(COMMAND), c.removeprefix(SENSOR))
        ]
        if not meant:
            raise RecordingError(
                f"{where}: a unit is given for {key!r}, which is neither a column that is used nor a name of the "
                f"model; there are {list(wanted.values())}{suggestion(key, wanted.values())}"
            )
        if len(meant) > 1:
            raise RecordingError(f"{where}: the unit of {key!r} may mean {meant[0]!r} or {meant[1]!r}; say which")
        if meant[0] in factors:
            raise RecordingError(f"{where}: {key!r} means {meant[0]!r}, whose unit is given by another name already")
        try:
            factors[meant[0]] = factor(unit)
            check_kind(unit, measured.get(meant[0], ""))
        except ValueError as error:
            raise RecordingError(f"{where}: unit of {key!r}: {error}") from None
    return factors
