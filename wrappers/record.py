"""The wrapper that writes runs as recordings."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from dipc_gym import recording
from dipc_gym.recording import tables

Array = NDArray[np.float64]
SENSORS = ("cart", "pole1", "pole2")


class RecordRun(
    gymnasium.Wrapper[Array, NDArray[np.float32], Array, NDArray[np.float32]], gymnasium.utils.RecordConstructorArgs
):
    """Write every episode as a recording: time, the motor's voltage, and what the encoders read.

    A row holds the readings at its time and the voltage that was applied from then on (after compensator and supply
    limit). The angle of the second pole is relative to the first, as its encoder measures it. Files are called
    `NAME-0.csv`, `NAME-1.csv` and so on, and appear when their episode ends, or at the next `reset` or `close`.

    Args:
        env: `DIPC-Friction-v0`, wrapped or not.
        folder: where the files go; made if missing.
        name: what the files are called.
        suffix: `"csv"`, `"npz"`, or `"parquet"` (with the `parquet` extra).
        overwrite: replace files of an earlier run instead of refusing.

    Raises:
        FileExistsError: the folder has recordings of that name, and `overwrite` is not set.
        ValueError: the suffix is not known, or the name is none of a file in the folder.
        TypeError: `env` has no encoders to read.

    Example:
        >>> import gymnasium, dipc_gym, tempfile
        >>> from dipc_gym.wrappers import RecordRun
        >>> env = RecordRun(gymnasium.make("DIPC-Friction-v0"), folder := tempfile.mkdtemp())
        >>> observation, info = env.reset(seed=1)
        >>> for _ in range(20):
        ...     transition = env.step([2.0])
        >>> env.close()
        >>> [path.name for path in Path(folder).iterdir()]
        ['run-0.csv']
    """

    def __init__(
        self,
        env: gymnasium.Env[Array, NDArray[np.float32]],
        folder: str | Path,
        *,
        name: str = "run",
        suffix: str = "csv",
        overwrite: bool = False,
    ) -> None:
        gymnasium.utils.RecordConstructorArgs.__init__(
            self, folder=str(folder), name=name, suffix=suffix, overwrite=overwrite
        )
        gymnasium.Wrapper.__init__(self, env)
        self._inner: Any = env.unwrapped
        if not hasattr(self._inner, "encoders"):
            raise TypeError(f"{self._inner} has no encoders; RecordRun goes around DIPC-Friction-v0")
        self.folder = recordings_folder(folder, name, suffix, overwrite)
        self._episodes = EpisodeFiles(self.folder, name, suffix, overwrite)
        self._over = False

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Finish the file of the last episode and start another."""
        self._episodes.finish()
        self._over = False
        return self.env.reset(seed=seed, options=options)

    def step(self, action: NDArray[Any]) -> tuple[Array, Any, bool, bool, dict[str, Any]]:
        """Step, and note what the encoders read before it and the voltage that was applied.

        What is stepped on after an episode's end belongs to none. A step that a wrapper inside spends on a reset, as
        Gymnasium's autoreset does, begins another episode.
        """
        time, readings = self._inner.time, self._inner.encoders
        observation, reward, terminated, truncated, info = self.env.step(action)
        if self._inner.time <= time:
            self._episodes.finish()
            self._over = False
        elif not self._over:
            self._episodes.append(time, info["voltage"], readings)
            self._over = terminated or truncated
            if self._over:
                self._episodes.finish()
        return observation, reward, terminated, truncated, info

    def close(self) -> None:
        """Finish the last file."""
        self._episodes.finish()
        self.env.close()


class EpisodeFiles:
    """The recordings of one rig: each of its episodes is a file `NAME-0`, `NAME-1` and so on.

    Args:
        folder: where they go.
        name: what they are called.
        suffix: `"csv"`, `"npz"` or `"parquet"`.
        overwrite: replace files that are there.
    """

    def __init__(self, folder: Path, name: str, suffix: str, overwrite: bool) -> None:
        self._folder, self._name, self._suffix, self._overwrite = folder, name, suffix, overwrite
        self._episode = 0
        self._begin()

    def append(self, time: float, voltage: float, readings: Sequence[float] | Array) -> None:
        """Note when a control period began, s, the voltage that was applied in it, and the readings before it."""
        self._recorder.append(time, [voltage], readings)

    def finish(self) -> None:
        """Write the episode, if there is anything of it, and begin the next."""
        if not len(self._recorder):
            return
        path = self._folder / f"{self._name}-{self._episode}.{self._suffix}"
        try:
            recording.write(self._recorder.recording(path.stem), path, overwrite=self._overwrite)
        finally:  # what could not be written is no beginning of the next episode
            self._begin()
        self._episode += 1

    def _begin(self) -> None:
        self._recorder = recording.Recorder(["motor"], SENSORS)


def recordings_folder(folder: str | Path, name: str, suffix: str, overwrite: bool, *, indices: int = 1) -> Path:
    """The folder for recordings, made if missing, without those of an earlier run of that name.

    Args:
        folder: where they go.
        name: what they are called.
        suffix: `"csv"`, `"npz"` or `"parquet"`.
        overwrite: delete those of an earlier run instead of refusing.
        indices: how many numbers follow the name, each after a hyphen.

    Raises:
        FileExistsError: it has recordings of that name, and `overwrite` is not set.
        ValueError: the suffix is not known, or the name is none of a file in the folder.
    """
    if name in ("", ".", "..") or "/" in name or "\\" in name:
        raise ValueError(f"name is {name!r}; it is what files are called, without a folder: give that as folder")
    if suffix not in ("csv", "npz", "parquet"):
        raise ValueError(f"suffix is {suffix!r}; it can be 'csv', 'npz' or 'parquet'")
    if suffix == "parquet":
        tables.parquet(Path(folder))  # before an episode rather than after it
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    ours = re.compile(re.escape(name) + r"-[0-9]+" * indices + re.escape(f".{suffix}"))
    earlier = sorted(path for path in folder.iterdir() if ours.fullmatch(path.name))
    if earlier and not overwrite:
        raise FileExistsError(f"{earlier[0]} exists already; choose another folder or name, or set overwrite=True")
    for path in earlier:  # a shorter run would leave the last of them beside its own
        path.unlink()
    return folder
