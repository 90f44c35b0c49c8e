"""`dipc-gym replay`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from dipc_gym.cli.options import ending, free, pairs


@dataclass(frozen=True)
class Replay:
    """Replay a recording in a model and show where the two part.

    The recording is cut into short windows. Each has an initial state of its own: the one that its sensors show,
    corrected so that the model predicts this window best. What is left then is the model's. The table gives, for each
    sensor, how far predictions are off (rms, SI units), the sensor's own noise, and their ratio: near 1, the model
    lacks nothing that this recording shows; far above, parameters are wrong or physics is absent, and the worst windows
    say when.

    A recording is a CSV, Parquet or npz table in SI units with the column time, one column for each actuator and one
    for each scalar sensor, by their names in the model. Other names and units are translated by --map and --unit.

    Try:
        dipc-gym replay rig.xml balance.csv
        dipc-gym replay rig.xml balance.csv --window 0.1 --json replay.json --plot replay.png
        dipc-gym replay rig.xml balance.csv --step 0.001
        dipc-gym replay rig.xml log.csv --map pos_cart=cart --map u=motor --unit pole1=deg --unit time=ms
    """

    model: tyro.conf.Positional[Path]
    """MJCF file"""
    recording: tyro.conf.Positional[Path]
    """recording: .csv, .parquet or .npz"""
    window: float | None = None
    """length of a window, s; without it 0.25, or less where an unstable rig amplifies initial errors over tenfold"""
    step: float | None = None
    """simulate as exactly as this step (s) allows; without it, with the model's own integrator and step"""
    json: Path | None = None
    """file for all figures, window by window"""
    plot: Path | None = None
    """picture of observed against predicted: .png, .pdf or .svg"""
    width: float = 7.0
    """of the picture, inches: 7 is two columns of a journal, 3.4 is one"""
    map: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """column=name: which column of the file is which name in the model; may be repeated"""
    unit: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """name=unit: unit of a column, such as deg, mm, ms or counts as a factor; may be repeated"""
    overwrite: bool = False
    """replace files that exist"""

    def run(self) -> int:
        """Replay, print the table, write what was asked for."""
        from dipc_gym.safety.files import write_json
        from dipc_gym.sim2real.replay import check_width, replay

        for path in (self.json, self.plot):
            if path is not None:
                free(path, self.overwrite)
        if self.json is not None:
            ending(self.json, ".json")
        if self.plot is not None:
            ending(self.plot, ".png", ".pdf", ".svg")
            check_width(self.width)
        elif self.width != type(self).width:
            raise ValueError(f"--width {self.width:g}: it is that of the picture; add --plot FILE or leave it out")
        mapping, units = pairs("map", self.map), pairs("unit", self.unit)
        done = replay(self.model, self.recording, window=self.window, step=self.step, mapping=mapping, units=units)
        if self.json is not None:
            write_json(self.json, done.to_dict())
        if self.plot is not None:
            done.plot(self.plot, width=self.width)
        for note in done.recording.notes:
            print(f"note: {note}")
        print(done.table())
        return 0
