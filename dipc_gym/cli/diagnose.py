"""`dipc-gym diagnose` and `dipc-gym report`."""

from __future__ import annotations

import sys
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import tyro

from dipc_gym.cli.options import free, pairs
from dipc_gym.cli.progress import Progress


@dataclass(frozen=True)
class Diagnose:
    """Find the physics that a model lacks, say it in a sentence, and write it back as MJCF.

    The model is any MuJoCo model of hinge and slide joints without contacts whose sensors determine the joints. The
    recordings are cut into windows of 0.25 s, longer ones below 160 Hz. First the model's parameters are refitted,
    which is the fair rival of any new physics. Then every effect of the catalogue is tried at every place it can act,
    and kept only if it predicts windows that no fit has seen clearly better. Validation data, the end of what is given
    to fit, may strike effects off, and add none. The error that is reported is of data that no fit has touched and
    that chose nothing: the recordings given with --held-out, else the last quarter of each.

    The folder gets diagnosis.json (all of it, for programs), improved.xml (your model with what was missing, which
    stock MuJoCo loads), report.html (to read) and report.json (what it draws: `dipc-gym report` draws it again).

    Try:
        dipc-gym diagnose rig.xml run_1.csv run_2.csv --out diagnosis
        dipc-gym diagnose rig.xml run_1.csv --held-out run_2.csv --out diagnosis
        dipc-gym diagnose rig.xml log.csv --unit theta1=deg --map u=motor --fix cart.mass --out diagnosis
        dipc-gym diagnose rig.xml log.csv --prior motor.resistance=1.2+-0.05 --design next.csv --out diagnosis
    """

    model: tyro.conf.Positional[Path]
    """MJCF file"""
    recordings: tyro.conf.Positional[tuple[Path, ...]]
    """recordings: .csv, .parquet or .npz"""
    out: Path
    """folder for the results"""
    held_out: tuple[Path, ...] = ()
    """recordings for judging only"""
    fix: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """parameter of the model that is right, as cart.mass; may be repeated"""
    prior: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """what you know of a parameter, as motor.resistance=1.2+-0.05; may be repeated"""
    map: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """column=name: which column of the files is which name in the model; may be repeated"""
    unit: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """name=unit: unit of a column, such as deg, mm or ms; may be repeated; rad also where angles look like degrees"""
    jobs: int = 0
    """threads of the simulations; 0 for all cores"""
    seed: int = 0
    """of the phases of what --design proposes; the diagnosis itself draws nothing at random"""
    design: Path | None = None
    """file for the command that the next experiment should send"""
    overwrite: bool = False
    """replace files that exist"""

    def run(self) -> int:
        """Diagnose, write, and say it in a sentence."""
        import shlex
        from json import dumps
        from math import isnan

        from dipc_gym import mjcf, recording
        from dipc_gym.recording.degrees import refuse_odd_units
        from dipc_gym.recording.tables import check_format
        from dipc_gym.safety.alone import alone
        from dipc_gym.safety.files import finite
        from dipc_gym.sim2real.diagnosis import diagnose
        from dipc_gym.sim2real.model.parameters import Wishes
        from dipc_gym.sim2real.report import folder

        if self.jobs < 0:
            raise ValueError(f"--jobs {self.jobs}: give the number of threads, or 0 for all cores")
        if not self.recordings:
            raise ValueError("name at least one recording after the model")
        folder.check_free(self.out, self.overwrite)
        given = [self.model, *self.recordings, *self.held_out]
        folder.check_given(self.out, given)
        if self.design is not None:
            check_format(self.design)
            free(self.design, self.overwrite)
            if self.design.resolve() in [Path(one).resolve() for one in given]:
                raise ValueError(f"--design {self.design}: that file is read; name another one")
        source = mjcf.read(self.model)
        folder.check_names(source.files)
        model = mjcf.compile(source)
        mjcf.check_supported(model, source.name)
        mapping, units = pairs("map", self.map), pairs("unit", self.unit)
        fitted = recording.read_all(self.recordings, model, mapping=mapping, units=units)
        judged = recording.read_all(self.held_out, model, mapping=mapping, units=units)
        refuse_odd_units([*fitted, *judged], model)
        wishes = Wishes(self.fix, {key: _spread(key, text) for key, text in pairs("prior", self.prior).items()})
        with alone(self.out):
            folder.check_free(self.out, self.overwrite)  # a run that was at work there may just have ended
            with Progress() as tell:
                found = diagnose(
                    source,
                    fitted,
                    judged,
                    wishes=wishes,
                    design=self.design is not None,
                    seed=self.seed,
                    threads=self.jobs,
                    tell=tell,
                )
            command = shlex.join(["dipc-gym", *sys.argv[1:]])
            try:
                folder.save(found, self.out, model=self.model.name, command=command, overwrite=self.overwrite)
            except (OSError, ValueError):  # a full disk, or a link that somebody put there meanwhile
                with suppress(OSError):
                    print(dumps(finite(found.to_dict()), indent=2))  # what took so long is not lost with the disk
                raise
        if self.design is not None and found.design is not None:
            recording.write(found.design.commands, self.design, overwrite=self.overwrite)
        for note in found.notes:  # nothing is printed before all is written: nobody may be there to read it
            print(f"note: {note}")
        print(f"\n{found.verdict.upper()}. {found.sentence}")
        for missing in found.missing:
            share = "?" if isnan(missing.share) else f"{100 * missing.share:.0f}"
            # What is not even modelled improves nothing; its share is what it leaves.
            of = (
                "of the mismatch is left"
                if missing.effect == "unknown" and missing.law is None
                else "of the improvement"
            )
            print(f"  {missing.effect} at {missing.at}, {share} % {of}")
        if found.next_experiment:
            print(f"Next: {found.next_experiment}")
        if found.needs_loader:
            lacking = ", ".join(one.replace("@", " at ") for one in found.needs_loader)
            print(f"Stock MuJoCo leaves out {lacking}; load improved.xml with dipc_gym.physics.load.")
        if self.design is not None and found.design is None:
            print(f"{self.design}: not written: nothing was fitted that a command could tell apart, or a note says why")
        elif self.design is not None and found.design is not None:
            print(f"{self.design}: {found.design.sentence}")
        print(f"results in {self.out}")
        return 0


def _spread(key: str, text: str) -> tuple[float, float]:
    """Mean and standard deviation of `1.2+-0.05`."""
    mean, between, spread = text.partition("+-")
    try:
        if not between:
            raise ValueError
        return float(mean), float(spread)
    except ValueError:
        raise ValueError(f"--prior {key}={text}: write it as {key}=1.2+-0.05, mean and standard deviation") from None


@dataclass(frozen=True)
class Report:
    """Draw the report of a diagnosis again, from what its folder holds; nothing is simulated.

    diagnosis.json and report.json of the folder are read, and report.html is replaced.

    Try:
        dipc-gym report diagnosis
    """

    folder: tyro.conf.Positional[Path]
    """that dipc-gym diagnose has filled"""

    def run(self) -> int:
        """Draw it."""
        from dipc_gym.safety.alone import alone
        from dipc_gym.sim2real.report.folder import redraw

        if not self.folder.is_dir():
            raise ValueError(f"{self.folder}: there is no such folder; name one that dipc-gym diagnose has filled")
        with alone(self.folder):
            print(redraw(self.folder))
        return 0
