"""`dipc-gym export`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from dipc_gym.cli.options import free


@dataclass(frozen=True)
class Export:
    """Write estimator, controller and compensator for the rig's own computer, or a law that a diagnosis found.

    As a C99 header: one function that takes the three encoder readings and returns the motor voltage. It uses no heap
    and nothing of the C library beyond the exponential, in float or double. Beside it stands a C file that checks the
    header on known voltages. Or as an ONNX graph with the same inputs and its memory as a vector.

    FILE is a compensator, and the controller the paper's LQR unless --controller says another; or FILE is a policy.
    The state is estimated by filtered differences, unless --estimator has the file of another estimator.
    Or FILE is the diagnosis.json of `diagnose`, and what is written one law of it: a table, or a C function.

    Try:
        dipc-gym export llnf.json --to c --out rig.h
        dipc-gym export llnf.json --to c --out rig.h --controller policy.json --plant rig.json
        dipc-gym export mine.json --estimator mine_disturbance.json --controller lqr_cart --to c --out rig.h
        dipc-gym export runs/llnf/policy.json --compensator runs/llnf/compensator.json --to onnx --out rig.onnx
        dipc-gym export diagnosis/diagnosis.json --law friction.position@cart --to c --out friction.h
        dipc-gym export diagnosis/diagnosis.json --to csv --out law.csv
    """

    file: tyro.conf.Positional[Path]
    """a saved compensator, a saved policy, or a diagnosis (.json)"""
    to: Literal["c", "onnx", "csv"]
    """what to write"""
    out: Path
    """file to write: .h, .onnx or .csv"""
    law: str | None = None
    """with a diagnosis that holds several laws: which, as friction.position@cart"""
    controller: str | None = None
    """with a compensator: lqr, lqr_sampled, lqr_cart, lqr_quiet, or a policy (.json); without it lqr"""
    compensator: str | None = None
    """with a policy that commands force: the compensator's file"""
    estimator: str | None = None
    """file of an estimator that `train --estimator` wrote; without it, filtered differences"""
    plant: str | None = None
    """JSON file of the plant: encoders, control period, motor, supply"""
    model: str | None = None
    """MJCF file of the rig: a cart, two poles and a motor"""
    force_limit: float | None = None
    """largest force, N; without it, what the blocked motor exerts at full supply"""
    overwrite: bool = False
    """replace files that exist"""

    def run(self) -> int:
        """Write the files."""
        from dipc_gym.env import DoublePendulumEnv
        from dipc_gym.export import bundle
        from dipc_gym.export import law as laws

        suffix = {"c": ".h", "onnx": ".onnx", "csv": ".csv"}[self.to]
        if self.out.suffix != suffix:
            raise ValueError(f"{self.out}: --to {self.to} writes {suffix} files")
        free(self.out, self.overwrite)
        if self.law is not None or self.to == "csv" or laws.is_diagnosis(self.file):
            return self._law()
        if self.to == "c":
            free(bundle.checker(self.out), self.overwrite)
        plant = DoublePendulumEnv(plant=self.plant, model=self.model).plant
        found = bundle.bundle(
            self.file,
            plant,
            controller=self.controller,
            compensator=self.compensator,
            model=self.model,
            estimator=self.estimator,
            force_limit=self.force_limit,
        )
        if self.to == "onnx":
            bundle.write_onnx(found, self.out)
            print(f"{self.out}: inputs cart, pole1, pole2 and state; outputs voltage and next_state")
            return 0
        program, beside = bundle.write_c(found, self.out)
        cost = program.cost()
        print(f"{self.out}: {bundle.prefix(self.out)}_reset, {bundle.prefix(self.out)}_step")
        print(f"worst case of a call: {', '.join(f'{count} {kind}' for kind, count in cost.items())}")
        print(f"{beside}: checks it; cc -std=c99 {beside.name} -lm && ./a.out")
        return 0

    def _law(self) -> int:
        """Write a law of a diagnosis."""
        from dipc_gym.export import bundle
        from dipc_gym.export import law as laws
        from dipc_gym.safety.files import write_whole

        others = {
            "--controller": self.controller,
            "--compensator": self.compensator,
            "--estimator": self.estimator,
            "--plant": self.plant,
            "--model": self.model,
            "--force-limit": self.force_limit,
        }
        for option, value in others.items():
            if value is not None:
                raise ValueError(f"{option} {value}: a law is exported by itself; leave it out")
        if self.to == "onnx":
            raise ValueError(f"{self.file}: a law is written as csv or c, not as onnx")
        law = laws.read(self.file, self.law)
        name = bundle.prefix(self.out)
        write_whole(self.out, (law.csv() if self.to == "csv" else law.c(name)).encode())
        takes = [*(one.name for one in law.inputs), *(["speed"] if law.driven_up_to is not None else [])]
        called = "a table" if self.to == "csv" else f"{name}({', '.join(takes)})"
        print(f"{self.out}: {called}, {law.kind} of {law.key}{f' in {law.unit}' if law.unit else ''}")
        if self.to == "csv" and law.driven_up_to is not None:
            print(f"along the motion it fades from a speed of {law.driven_up_to:g} on, to nothing at twice that speed")
        if self.to == "csv":
            for one in law.inputs:
                print(f"data lie from {one.told[0]:g} to {one.told[1]:g} {one.unit} of {one.name}")
            print(f"beyond the table it {'stays as it ends' if law.outside == 'constant' else 'goes on in parallel'}")
        if law.remembers is not None:
            print(law.remembers)
        return 0
