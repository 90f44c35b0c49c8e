"""Many experiments: some at a time, here or on a Ray cluster, and each one's result in a file of its own.

A sweep is a list of cells. A cell is a frozen dataclass of plain values, all that its result depends on, and `run` does
it. What a cell gave is written by the process that asked for it, so a cluster needs no shared disk for results. A sweep
that was killed goes on where it stopped, and a cell that fails takes no other with it.
"""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any, Generic, Literal, Protocol, TypeVar, get_args

from dipc_gym import __version__
from dipc_gym.safety import intact
from dipc_gym.safety.files import remove_partial
from dipc_gym.safety.intact import DamagedError
from dipc_gym.safety.interrupts import held_back
from dipc_gym.safety.places import inside

__all__ = ["Backend", "Cell", "Outcome", "SweepError", "finished", "run"]

Backend = Literal["local", "ray"]
LOCAL_JOBS = 2  # experiments at a time on this machine, where nothing else is said
HELD = {"parameters": {}, "failure": (None, str), "result": object}  # what the file of a cell holds


class Cell(Protocol):
    """One experiment: a frozen dataclass of numbers, strings, and tuples, dictionaries and dataclasses of these."""

    @property
    def name(self) -> str:
        """Stem of its file; no two cells of a sweep share it."""

    def run(self) -> Any:
        """Do it, and give the result as JSON holds it."""

    def check(self, result: Any) -> None:
        """Refuse what `run` cannot have given, for a result that is read again may be damaged or a stranger's.

        Raises:
            ValueError: in words that name the field.
        """


C = TypeVar("C", bound=Cell)


class SweepError(ValueError):
    """A sweep that cannot be run; the message names the file or the number, and the mend."""


@dataclass(frozen=True)
class Outcome(Generic[C]):
    """What became of a cell.

    Attributes:
        cell: the cell.
        result: what its `run` gave, as JSON gives it back; None if it failed.
        failure: the last line of the traceback, or None.
    """

    cell: C
    result: Any
    failure: str | None


def run(
    cells: Sequence[C],
    folder: str | Path,
    *,
    jobs: int | None = None,
    backend: Backend = "local",
    label: str = "sweep",
    ready: Callable[[], object] = dict,
) -> Iterator[Outcome[C]]:
    """Run the cells of a sweep that are not on disk yet, with a progress bar.

    Cells run through joblib, in processes that are given one thread each for linear algebra. A cell that failed before
    is tried again. One whose file is damaged is named on the standard error stream, set aside and run again.

    Args:
        cells: the experiments.
        folder: for `NAME.json` of every cell: its parameters, and its result or failure. Made if it is not there.
        jobs: cells at a time; None: 2, or on Ray as many as the cluster has CPUs.
        backend: `"local"`, or `"ray"`: the cluster that Ray is connected to or that `RAY_ADDRESS` names, else one that
            Ray starts on this machine.
        label: what the progress bar calls the sweep.
        ready: called before each cell where it runs, such as to register there what is registered here.

    Returns:
        Every cell's outcome: first those on disk, then the others as they finish.

    Raises:
        SweepError: `jobs` or `backend` is impossible, two cells share a name, or a file there is another sweep's.
        ImportError: Ray is asked for and not installed.

    Example:
        >>> import tempfile
        >>> @dataclass(frozen=True)
        ... class Square:
        ...     x: float
        ...     name: str
        ...     def run(self) -> float:
        ...         return self.x**2
        ...     def check(self, result: float) -> None:
        ...         intact.fit(result, float)
        >>> outcomes = run([Square(3.0, "three")], tempfile.mkdtemp(), jobs=1)
        >>> [outcome.result for outcome in outcomes]
        [9.0]
    """
    check(jobs, backend)
    folder = Path(folder)
    names = [cell.name for cell in cells]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise SweepError(f"two cells are called {twice[0]!r}; each needs a name of its own")
    done = finished(cells, folder)
    folder.mkdir(parents=True, exist_ok=True)
    remove_partial(folder)
    known = {outcome.cell.name for outcome in done}
    return _outcomes(done, [cell for cell in cells if cell.name not in known], folder, jobs, backend, label, ready)


def check(jobs: int | None, backend: str) -> None:
    """Refuse a number of jobs or a backend that cannot be.

    Raises:
        SweepError: see `run`.
        ImportError: Ray is asked for and not installed.
    """
    if jobs is not None and jobs < 1:
        raise SweepError(f"jobs is {jobs}; it is the number of experiments at a time, 1 or more")
    if backend not in get_args(Backend):
        raise SweepError(f"there is no backend {backend!r}; there are {' and '.join(get_args(Backend))}")
    if backend == "ray":
        _ray()


def finished(cells: Sequence[C], folder: str | Path) -> list[Outcome[C]]:
    """What is on disk of a sweep; failures are left out, as if they had not been tried, and damaged files set aside.

    Raises:
        SweepError: a file was made with other parameters.
        OSError: a damaged file cannot be set aside.
    """
    outcomes = []
    for cell in cells:
        path = inside(folder, f"{cell.name}.json")
        if not path.exists():
            continue
        try:
            held = intact.read(path, HELD)
        except DamagedError as damage:
            intact.set_aside(path, damage)
            continue
        if held["failure"] is not None:
            continue
        if change := _change(held["parameters"], parameters(cell)):
            where, was, now = change
            raise SweepError(
                f"{path}: was made with {where} = {_short(was)}, and this sweep has {_short(now)}; "
                "choose another folder, or say --overwrite to begin anew"
            )
        try:
            cell.check(held["result"])
        except (ValueError, RecursionError) as fault:
            intact.set_aside(path, DamagedError(f"{path}: result: {fault or 'nested too deeply'}"))
            continue
        outcomes.append(Outcome(cell, held["result"], None))
    return outcomes


def written(folder: str | Path) -> list[Path]:
    """Files of a folder that some sweep has written; JSON that is anything else is left out."""
    found = []
    for path in sorted(Path(folder).glob("*.json")):
        with contextlib.suppress(DamagedError):
            if intact.read(path, HELD).keys() == HELD.keys():
                found.append(path)
    return found


def parameters(cell: Cell) -> dict[str, Any]:
    """All that a cell's result depends on, versions of dipc-gym and MuJoCo included, as JSON gives it back."""
    made = {"dipc_gym": __version__, "mujoco": metadata.version("mujoco")}
    mine = {**made, **dataclasses.asdict(cell)}  # type: ignore[call-overload]
    plain: dict[str, Any] = json.loads(json.dumps(mine))
    return plain


# ------------------------------------------------------------------------------------------------ parts


def _outcomes(
    done: list[Outcome[C]],
    open_ones: list[C],
    folder: Path,
    jobs: int | None,
    backend: Backend,
    label: str,
    ready: Callable[[], object],
) -> Iterator[Outcome[C]]:
    from tqdm import tqdm

    yield from done
    if not open_ones:
        return
    bar = tqdm(total=len(done) + len(open_ones), initial=len(done), desc=label, unit="run", disable=None)
    with bar:
        for number, text, failure in _attempts(dict(enumerate(open_ones)), jobs, backend, ready):
            cell = open_ones[number]
            result = None if text is None else json.loads(text)
            held = {"parameters": parameters(cell), "failure": failure, "result": result}
            intact.write(inside(folder, f"{cell.name}.json"), held)
            bar.update()
            yield Outcome(cell, result, failure)


Attempt = tuple[int, str | None, str | None]


def _attempts(
    cells: Mapping[int, Cell], jobs: int | None, backend: Backend, ready: Callable[[], object]
) -> Iterator[Attempt]:
    """Number, result as JSON, and failure of each cell, as they finish."""
    from concurrent.futures import BrokenExecutor

    from joblib import Parallel, delayed, parallel_config

    settings: dict[str, Any]
    if backend == "ray":
        attempt, settings = _attempt_on_ray, {"backend": "threading"}  # threads that wait for Ray
        jobs = jobs or max(1, int(_ray().cluster_resources().get("CPU", 1)))
    else:
        attempt, settings = _attempt, {"backend": "loky", "inner_max_num_threads": 1}
        jobs = jobs or LOCAL_JOBS
    left = dict(cells)
    while left:
        sent: list[int] = []

        def tasks(todo: Sequence[int], sent: list[int] = sent) -> Iterator[Any]:
            for number in todo:
                sent.append(number)
                yield delayed(attempt)(number, cells[number], ready)

        try:
            with warnings.catch_warnings(), parallel_config(n_jobs=jobs, **settings):
                # A worker that has taken 300 MB since its first cell, as importing torch does, is replaced by another.
                warnings.filterwarnings("ignore", "A worker stopped while some jobs", UserWarning)
                # One cell a task, and none waiting in a worker: what is finished comes back at once.
                parallel = Parallel(batch_size=1, pre_dispatch=jobs, return_as="generator_unordered")
                with held_back():
                    results = parallel(tasks(list(left)))
                for done in results:
                    del left[done[0]]
                    yield done
        except BrokenExecutor as death:  # a process died and took all that ran beside it; who did it shows alone
            for number in [number for number in sent if number in left]:
                suspect = {number: left.pop(number)}
                if len(cells) > 1:
                    yield from _attempts(suspect, jobs, backend, ready)
                else:
                    yield number, None, f"its process died; {_last_line(death)}"


def _attempt(number: int, cell: Cell, ready: Callable[[], object]) -> Attempt:
    try:
        ready()
        return number, json.dumps(cell.run(), allow_nan=False), None
    except Exception as error:  # of whatever kind: it is reported, and the other cells go on
        return number, None, _last_line(error)


def _attempt_on_ray(number: int, cell: Cell, ready: Callable[[], object]) -> Attempt:
    """Have a task of Ray do it, on whichever node has a CPU free, and wait for it.

    Not by the joblib backend that Ray brings: that hands results out only when all are there, so that a killed sweep
    would lose them, and one process that dies there takes the sweep with it.
    """
    ray = _ray()
    wants = {"num_cpus": 1, "max_retries": 1, "runtime_env": {"env_vars": {"OMP_NUM_THREADS": "1"}}}
    try:
        done: Attempt = ray.get(ray.remote(_attempt).options(**wants).remote(number, cell, ready))
    except ray.exceptions.RayError as error:
        return number, None, f"Ray gave it up; {_last_line(error)}"
    return done


def _last_line(error: BaseException) -> str:
    """What a traceback ends with: kind of the error, and the first line of what it says."""
    said = str(error).strip().splitlines()
    return f"{type(error).__name__}: {said[0]}" if said else type(error).__name__


def _ray() -> Any:
    """Ray, connected."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # a Ray that starts here tells nobody, unless you want it to
    try:
        import ray
    except ImportError as missing:
        raise ImportError("the backend 'ray' needs Ray: add its extra: pip install '.[ray]' in a clone") from missing
    if not ray.is_initialized():
        ray.init(log_to_driver=False)
    return ray


def _change(was: Any, now: Any, where: str = "") -> tuple[str, Any, Any] | None:
    """The first place at which two values differ, as a dotted path, and what stands there."""
    if isinstance(was, Mapping) and isinstance(now, Mapping):
        for key in [*now, *(key for key in was if key not in now)]:
            path = f"{where}.{key}" if where else str(key)
            if change := _change(was.get(key), now.get(key), path):
                return change
        return None
    return None if was == now else (where, was, now)


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else text[:57] + "..."
