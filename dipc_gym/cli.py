"""The command line. Every subcommand is a dataclass: fields are its options, `run` does the work.

What a subcommand needs is imported when it runs, so that help comes at once.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, Protocol

import tyro


class Command(Protocol):
    """What `main` asks of a subcommand."""

    def run(self) -> int:
        """Do it; the exit code."""


@dataclass(frozen=True)
class Compare:
    """Run the paper's experiment over many rigs and compare friction compensators.

    On each rig: record the identification run (poles locked, a voltage swept from 0.3 to 10 Hz in 60 s), train the
    compensators on it, and balance the pendulum for 80 s with every controller and compensator. The folder gets
    summary.json, table.txt, figures, a GIF, the trained compensators and recordings of the first rig's runs. Killed, it
    goes on where it stopped when started again; what failed is listed and tried again, and the exit code is then 1.

    With --robustness, every pair then balances the same rigs, changed more and more after training: how far it holds
    stands in robustness.txt, robustness.json and figures/robustness.pdf.

    Try:
        dipc-gym compare --out runs/compare
        dipc-gym compare --out runs/compare --robustness all
        dipc-gym compare --out runs/mine --compensator none,llnf,mine.json --controller lqr,policy.json --seeds 20
    """

    out: Path
    """folder for the results: new, empty, or begun by the same command"""
    controller: str = "lqr"
    """names with commas between: lqr, or policies: our own (.json), or stable-baselines3's (.zip)"""
    compensator: str = "none,feedforward,mlp,llnf,ideal"
    """names with commas between; or saved compensators (.json)"""
    seeds: int = 10
    """number of rigs; friction, encoder noise and starting state differ"""
    seconds: float = 80.0
    """length of a balancing run, s"""
    recording: str | None = None
    """train from this recording (time, motor, cart; poles locked) instead of simulated identification runs"""
    plant: str | None = None
    """JSON file of the plant that all rigs vary about"""
    model: str | None = None
    """MJCF file of another rig, with the actuator motor and the sensors cart, pole1, pole2"""
    exact_state: bool = False
    """balance with the exact state: what encoder noise costs is then left out"""
    robustness: str = ""
    """with commas between: friction, encoder, period, supply, impulse; or all"""
    jobs: int | None = None
    """experiments at a time; without it 2, or on Ray as many as the cluster has CPUs"""
    backend: Literal["local", "ray"] = "local"
    """ray: on the cluster that RAY_ADDRESS names, or a Ray that is started on this machine"""
    overwrite: bool = False
    """begin anew instead of going on with what the folder holds"""

    def run(self) -> int:
        """Compare, and print the table."""
        from dipc_gym import compare
        from dipc_gym.robustness import AXES
        from dipc_gym.summary import table

        comparison = compare.Comparison(
            controllers=_listed(self.controller),
            compensators=_listed(self.compensator),
            seeds=self.seeds,
            seconds=self.seconds,
            plant=self.plant,
            model=self.model,
            recording=self.recording,
            exact_state=self.exact_state,
            robustness=tuple(AXES) if self.robustness == "all" else _listed(self.robustness),
        )
        try:
            summary = compare.run(comparison, self.out, jobs=self.jobs, backend=self.backend, overwrite=self.overwrite)
        except KeyboardInterrupt:
            print(f"\ninterrupted; what was finished is in {self.out / 'summary.json'}", file=sys.stderr)
            return 130
        print(table(summary))
        if comparison.robustness:
            print("\n" + (self.out / "robustness.txt").read_text(encoding="utf-8").rstrip())
        print(f"\nresults in {self.out}")
        if summary["failures"]:
            print(f"{len(summary['failures'])} failed, as listed; the same command tries them again", file=sys.stderr)
        return 1 if summary["failures"] else 0


@dataclass(frozen=True)
class Train:
    """Train a friction compensator and save it as JSON.

    It is trained on a simulated identification run, or on a recording of your rig made with the poles locked.

    Try:
        dipc-gym train --out llnf.json
        dipc-gym train --out mine.json --compensator mlp --recording sweep.csv --plant rig.json
    """

    out: Path
    """file for the compensator"""
    compensator: str = "llnf"
    """none, feedforward, mlp (needs torch), llnf or ideal"""
    recording: str | None = None
    """recording with columns time, motor (V) and cart (m)"""
    plant: str | None = None
    """JSON file of the plant"""
    model: str | None = None
    """MJCF file of the rig"""
    seed: int = 0
    """of training and of the simulated encoders' noise"""
    overwrite: bool = False
    """replace the file if it exists"""

    def run(self) -> int:
        """Train and save."""
        from dipc_gym import compensators
        from dipc_gym.runs import identify

        _free(self.out, self.overwrite)
        compensators.registry.kind(self.compensator)  # refuse an unknown name before anything is simulated
        found = identify(self.plant, model=self.model, from_recording=self.recording, seed=self.seed)
        trained = found.fit(self.compensator, seed=self.seed)
        compensators.save(trained, self.out)
        print(f"{self.out}: {self.compensator}, {trained.parameters} numbers")
        if trained.figures is not None:
            fit = trained.figures
            print(f"mean square error: training {fit.train_mse:.4g} V^2, test {fit.test_mse:.4g} V^2")
        return 0


@dataclass(frozen=True)
class TrainPolicy:
    """Train a policy that balances the rig, and try it.

    The rig is identified and its compensator fitted; the policy then learns to command force through it, or, with
    --compensator none, the motor's voltage itself. The folder gets policy.json (small, runs on NumPy, the best of
    eight trials on the way), curve.csv, compensator.json, TensorBoard's files and a checkpoint. Killed, it goes on
    with --resume, to the same policy.

    Try:
        dipc-gym train-policy --out runs/llnf
        dipc-gym train-policy --out runs/direct --compensator none --seed 3
        dipc-gym train-policy --out runs/llnf --resume
        tensorboard --logdir runs
    """

    out: Path
    """folder for the results, new or empty"""
    algo: Literal["ppo", "sac"] = "ppo"
    """proximal policy optimisation, or soft actor-critic, which takes fewer but slower steps"""
    compensator: str = "llnf"
    """none, feedforward, mlp (needs torch), llnf or ideal, identified for this; or a saved compensator (.json)"""
    seed: int = 0
    """of weights, exploration, starting states and identification"""
    steps: int | None = None
    """control periods to train for; without it the algorithm's own number"""
    rigs: int | None = None
    """rigs that are simulated side by side; without it the algorithm's own number"""
    limit: float = 60.0
    """largest force, N; for voltage, what exerts it on the blocked cart"""
    plant: str | None = None
    """JSON file of the plant; numbers may be distributions, drawn anew in every episode"""
    model: str | None = None
    """MJCF file of the rig"""
    resume: bool = False
    """go on from the folder's checkpoint; all other options as they were"""
    overwrite: bool = False
    """replace what an earlier training left in the folder"""

    def run(self) -> int:
        """Train, try, and say how it did."""
        from dipc_gym import train

        changes = {key: value for key, value in (("steps", self.steps), ("rigs", self.rigs)) if value is not None}
        training = train.Training(
            algorithm=self.algo,
            compensator=self.compensator,
            seed=self.seed,
            limit=self.limit,
            plant=self.plant,
            model=self.model,
            recipe=replace(train.RECIPES[self.algo], **changes),
        )
        try:
            policy = train.run(training, self.out, resume=self.resume, overwrite=self.overwrite)
        except KeyboardInterrupt:
            print(f"\ninterrupted; go on from the last checkpoint in {self.out} with --resume", file=sys.stderr)
            return 130
        print(f"{self.out / 'policy.json'}: {policy.summary()}")
        return 0


@dataclass(frozen=True)
class Record:
    """Simulate a run of the rig and write it as a recording.

    A balancing run has the columns time, motor, cart, pole1 and pole2: replay, diagnose or render it. In an
    identification run the poles are locked and have no columns: train from it. To replay it takes a model without them.

    Try:
        dipc-gym record --out balance.csv --compensator llnf --seconds 20
        dipc-gym record --out sweep.parquet --experiment identification
    """

    out: Path
    """file to write: .csv, .npz or .parquet"""
    experiment: Literal["balance", "identification"] = "balance"
    """balance the poles, or sweep the voltage with the poles locked"""
    controller: str = "lqr"
    """lqr, or a policy: our own (.json), or one of stable-baselines3 (.zip)"""
    compensator: str = "none"
    """a name, trained for this on a simulated run, or a saved compensator (.json)"""
    seconds: float = 80.0
    """length of a balancing run, s"""
    plant: str | None = None
    """JSON file of the plant"""
    model: str | None = None
    """MJCF file of the rig"""
    seed: int = 0
    """of starting state and noise"""
    overwrite: bool = False
    """replace the file if it exists"""

    def run(self) -> int:
        """Simulate and write."""
        from dipc_gym import controllers, runs
        from dipc_gym.sim2real import recording

        _free(self.out, self.overwrite)
        if self.experiment == "identification":
            run = runs.identify(self.plant, model=self.model, seed=self.seed).run
        else:
            brain = controllers.load(self.controller)
            compensator = runs.compensator(self.compensator, self.plant, model=self.model, seed=self.seed)
            course = runs.balance(
                brain, compensator, seconds=self.seconds, seed=self.seed, plant=self.plant, model=self.model
            )
            run = course.recording(self.out.stem)
            if course.fell:
                print(f"fell after {course.time[-1]:.2f} s")
        recording.write(run, self.out, overwrite=self.overwrite)
        print(f"{self.out}: {len(run)} samples, {run.duration:.1f} s")
        return 0


@dataclass(frozen=True)
class Render:
    """Draw a run of the rig as an animated GIF, or in a window.

    Works without a display too. The run is simulated, or taken from a recording that has all three encoders.

    Try:
        dipc-gym render --out rig.gif --compensator llnf
        dipc-gym render --out run.gif --recording balance.csv
        dipc-gym render
    """

    out: Path | None = None
    """GIF to write; without it a window opens"""
    recording: str | None = None
    """recording to draw instead of a simulated run"""
    controller: str = "lqr"
    """lqr, or a policy: our own (.json), or one of stable-baselines3 (.zip)"""
    compensator: str = "none"
    """a name, trained for this on a simulated run, or a saved compensator (.json)"""
    seconds: float = 10.0
    """length, s"""
    plant: str | None = None
    """JSON file of the plant"""
    model: str | None = None
    """MJCF file of the rig"""
    seed: int = 0
    """of starting state and noise"""
    overwrite: bool = False
    """replace the file if it exists"""

    def run(self) -> int:
        """Draw."""
        from dipc_gym import controllers, figures, runs

        if self.out is not None:
            _free(self.out, self.overwrite)
            if self.out.suffix.lower() != ".gif":
                raise ValueError(f"{self.out}: only .gif can be written")
        if self.recording is not None:
            course = runs.recorded(self.recording, model=self.model)
        else:
            course = runs.balance(
                controllers.load(self.controller),
                runs.compensator(self.compensator, self.plant, model=self.model, seed=self.seed),
                seconds=self.seconds,
                seed=self.seed,
                plant=self.plant,
                model=self.model,
            )
        if self.out is None:
            figures.show(course, model=self.model, seconds=self.seconds)
        else:
            caption = Path(self.recording).stem if self.recording else f"{self.controller}, {self.compensator}"
            figures.animate({caption: course}, self.out, model=self.model, seconds=self.seconds)
            print(f"{self.out}: {min(self.seconds, course.time[-1]):.1f} s")
        return 0


@dataclass(frozen=True)
class Replay:
    """Replay a recording in a model and show where the two part.

    The recording is cut into short windows. Each starts from the state that its sensors show, corrected so that the
    model predicts this window best; what is left then is the model's. The table gives, for each sensor, how far
    predictions are off (rms, SI units), the sensor's own noise, and their ratio: near 1, the model lacks nothing that
    this recording shows; far above, numbers are wrong or physics is absent, and the worst windows say when.

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
    """length of a window, s; without it 0.25, or less where an unstable rig amplifies its start more than tenfold"""
    step: float | None = None
    """simulate as exactly as this step (s) allows; without it, with the model's own integrator and step"""
    json: Path | None = None
    """file for all figures, window by window"""
    plot: Path | None = None
    """picture of observed against predicted: .png, .pdf or .svg"""
    map: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """column=name: which column of the file is which name in the model; may be repeated"""
    unit: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """name=unit: unit of a column, such as deg, mm, ms or counts as a factor; may be repeated"""
    overwrite: bool = False
    """replace files that exist"""

    def run(self) -> int:
        """Replay, print the table, write what was asked for."""
        from json import dumps

        from dipc_gym.sim2real.replay import replay

        for path in (self.json, self.plot):
            if path is not None:
                _free(path, self.overwrite)
        if self.plot is not None and self.plot.suffix.lower() not in (".png", ".pdf", ".svg"):
            raise ValueError(f"{self.plot}: pictures are written as .png, .pdf or .svg")
        mapping, units = _pairs("map", self.map), _pairs("unit", self.unit)
        done = replay(self.model, self.recording, window=self.window, step=self.step, mapping=mapping, units=units)
        for note in done.recording.notes:
            print(f"note: {note}")
        print(done.table())
        if self.json is not None:
            self.json.write_text(dumps(done.to_dict(), indent=1, allow_nan=False) + "\n")
        if self.plot is not None:
            done.plot(self.plot)
        return 0


@dataclass(frozen=True)
class Diagnose:
    """Find the physics that a model lacks, say it in a sentence, and write it back as MJCF.

    The model is any MuJoCo model of hinge and slide joints without contacts whose sensors determine the joints. The
    recordings are cut into windows of 0.25 s. First the model's own numbers are refitted, which is the fair rival of
    any new physics. Then every effect of the catalogue is tried at every place it can act, and kept only if it
    predicts windows that no fit has seen clearly better. What is reported was judged on data that no choice has
    touched: the recordings given with --held-out, else the last quarter of each.

    The folder gets diagnosis.json (all of it, for programs), improved.xml (your model with what was missing, which
    stock MuJoCo loads) and report.html (to read).

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
    """number of the model that is right, as cart.mass; may be repeated"""
    prior: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """what you know of a number, as motor.resistance=1.2+-0.05; may be repeated"""
    map: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """column=name: which column of the files is which name in the model; may be repeated"""
    unit: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    """name=unit: unit of a column, such as deg, mm or ms; may be repeated"""
    jobs: int = 0
    """threads of the simulations; 0 for all cores"""
    seed: int = 0
    """kept in the provenance; the diagnosis draws nothing at random"""
    design: Path | None = None
    """file for the command that the next experiment should send"""
    overwrite: bool = False
    """replace files that exist"""

    def run(self) -> int:
        """Diagnose, write, and say it in a sentence."""
        import shlex

        from dipc_gym import mjcf
        from dipc_gym.sim2real import present, recording
        from dipc_gym.sim2real.diagnosis import Wishes, diagnose

        if self.jobs < 0:
            raise ValueError(f"--jobs {self.jobs}: give the number of threads, or 0 for all cores")
        if not self.recordings:
            raise ValueError("name at least one recording after the model")
        present.check_free(self.out, self.overwrite)
        if self.design is not None:
            _free(self.design, self.overwrite)
        source = mjcf.read(self.model)
        model = mjcf.compile(source)
        mapping, units = _pairs("map", self.map), _pairs("unit", self.unit)
        fitted = recording.read_all(self.recordings, model, mapping=mapping, units=units)
        judged = recording.read_all(self.held_out, model, mapping=mapping, units=units)
        wishes = Wishes(self.fix, {key: _spread(key, text) for key, text in _pairs("prior", self.prior).items()})
        found = diagnose(source, fitted, judged, wishes=wishes, seed=self.seed, threads=self.jobs, tell=_progress())
        for note in found.notes:
            print(f"note: {note}")
        command = shlex.join(["dipc-gym", *sys.argv[1:]])
        present.save(found, self.out, model=self.model.name, command=command, overwrite=self.overwrite)
        print(f"\n{found.verdict.upper()}. {found.sentence}")
        for missing in found.missing:
            print(f"  {missing.effect} at {missing.at}, {100 * missing.share:.0f} % of the improvement")
        if found.next_experiment:
            print(f"Next: {found.next_experiment}")
        lacking = [f"{m.effect} at {m.at}" for m in found.missing if m.needs_loader]
        if lacking:
            print(f"Stock MuJoCo leaves out {', '.join(lacking)}; load improved.xml with dipc_gym.physics.load.")
        if self.design is not None and found.work is not None:
            from dipc_gym.sim2real import design

            work = found.work
            proposed = design.propose(
                work.contenders(), work.prepared.problem, work.recordings, work.prepared.motions, seed=self.seed
            )
            recording.write(proposed.commands, self.design, overwrite=self.overwrite)
            print(f"{self.design}: {proposed.sentence}")
        print(f"results in {self.out}")
        return 0


@dataclass(frozen=True)
class Trial:
    """Run the blind trial of the diagnosis, which anybody can repeat.

    A generator that knows neither the tool nor MuJoCo simulates rigs with concealed physics and writes recordings and
    a nominal model; the tool diagnoses these files in folders of their own; a scorer then opens the sealed answers.
    Interrupted, it scores what is done, and goes on where it stopped when started again.

    Try:
        dipc-gym trial --out trial
        dipc-gym trial --out trial --rivals
        dipc-gym trial --out trial --count 12 --seed 7
        dipc-gym trial --out big --full --jobs 2
    """

    out: Path
    """folder for trials, sealed answers, results and the table"""
    seed: int = 1
    """determines every trial; 1 is that of the published table"""
    count: int | None = None
    """number of trials; without it 42, or 430 with --full"""
    full: bool = False
    """the long version"""
    jobs: int = 1
    """trials at a time, each on one core"""
    limit: float = 1800.0
    """seconds after which a diagnosis is stopped and counts as failed"""
    rivals: bool = False
    """give the same trials to mujoco.sysid and to a residual network instead, and add their table"""

    def run(self) -> int:
        """Generate, diagnose, score, print the table."""
        if self.rivals:
            from dipc_gym.trials.rivals import compare

            compare(self.out, seed=self.seed, count=self.count, full=self.full, jobs=self.jobs)
            print((self.out / "rivals.md").read_text())
            return 0
        from dipc_gym.trials.run import trial

        trial(self.out, seed=self.seed, count=self.count, full=self.full, jobs=self.jobs, patience=self.limit)
        print((self.out / "report.md").read_text())
        return 0


COMMANDS: dict[str, type[Command]] = {
    "compare": Compare,
    "train": Train,
    "train-policy": TrainPolicy,
    "record": Record,
    "replay": Replay,
    "diagnose": Diagnose,
    "trial": Trial,
    "render": Render,
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; the exit code is 0, 1 if part of it failed, 2 for bad input, 130 after Ctrl-C."""
    command = tyro.extras.subcommand_cli_from_dict(
        COMMANDS,  # type: ignore[arg-type]
        prog="dipc-gym",
        description=(
            "A double inverted pendulum on a cart with stick-slip friction: an environment, friction compensators, "
            "and a tool that names the physics a simulator leaves out."
        ),
        args=arguments,
        config=(tyro.conf.FlagCreatePairsOff,),
    )
    try:
        return command.run()
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return 130
    except (ValueError, OSError, ImportError) as error:  # what the package raises for input it cannot use
        print(f"dipc-gym: {error}", file=sys.stderr)
        return 2


def _listed(names: str) -> tuple[str, ...]:
    return tuple(dict.fromkeys(name.strip() for name in names.split(",") if name.strip()))


def _pairs(option: str, texts: Sequence[str]) -> dict[str, str]:
    """The two sides of options like `--unit theta1=deg`."""
    pairs = {}
    for text in texts:
        left, equals, right = text.rpartition("=")
        if not (left and equals and right):
            raise ValueError(f"--{option} {text}: write it with an equals sign between, such as --{option} a=b")
        if left in pairs:
            raise ValueError(f"--{option} names {left!r} twice")
        pairs[left] = right
    return pairs


def _spread(key: str, text: str) -> tuple[float, float]:
    """Mean and standard deviation of `1.2+-0.05`."""
    mean, between, spread = text.partition("+-")
    try:
        if not between:
            raise ValueError
        return float(mean), float(spread)
    except ValueError:
        raise ValueError(f"--prior {key}={text}: write it as {key}=1.2+-0.05, mean and standard deviation") from None


def _progress() -> Callable[[str], None]:
    """Prints lines of progress with the seconds since the start."""
    import time

    began = time.monotonic()
    return lambda line: print(f"[{time.monotonic() - began:5.1f} s] {line}", file=sys.stderr, flush=True)


def _free(path: Path, overwrite: bool) -> None:
    """Refuse to write over a file, before any work is done."""
    if path.exists() and not overwrite:
        raise FileExistsError(f"{path} exists; choose another name or say --overwrite")
    if not path.absolute().parent.is_dir():
        raise FileNotFoundError(f"{path}: there is no folder {path.absolute().parent}")
