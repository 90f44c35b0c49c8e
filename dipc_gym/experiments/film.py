"""Films of runs: the rig, its motion magnified, and below it the trace of its cart.

What friction costs are millimetres on a rail of nearly a metre. So that the eye sees them, all panels of a film show
deviations from upright and middle enlarged by one factor, which stands in the caption; traces are in true millimetres.
"""

from __future__ import annotations

import errno
import importlib.util
import itertools
import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from dipc_gym import ENV_ID
from dipc_gym.drawing import style
from dipc_gym.drawing.viewer import has_display
from dipc_gym.runs import Course
from dipc_gym.safety.files import partial_of, whole

Array = NDArray[np.float64]

FORMATS = (".gif", ".mp4")
SECONDS = 8.0  # s of a film
RATE = 25.0  # frames per second of the film, which runs in real time
GIF_TAKES = 2  # a GIF takes every second frame: it grows with each, and few viewers keep up with more
SIZE = (300, 340)  # pixels of a rig
TRACE = 76  # pixels, height of a trace
MARGIN = 10  # pixels about a trace
CAPTIONS = {"none": "without compensation", "llnf": "with the LLNF compensator"}
LARGEST = (0.4, 0.6)  # m of the cart and rad of the poles that magnified motion fills the picture with
MOST = 20  # times
INK, PAPER = (20, 24, 30), (255, 255, 255)  # red, green and blue


def magnification(courses: Mapping[str, Course], seconds: float = math.inf) -> int:
    """How many times the motion of several runs can be enlarged and stay in the picture, at least once.

    Args:
        courses: by compensator or caption.
        seconds: how much of them is shown, s.

    Example:
        >>> import numpy as np
        >>> state = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0], [0.02, 0.03, -0.01, 0.0, 0.0, 0.0]])
        >>> n = np.zeros(2)
        >>> magnification({"a": Course(np.array([0.0, 0.005]), state, n, n, np.zeros((2, 3)), 0, False)})
        20
    """
    shown = np.concatenate([np.abs(course.state[course.time <= seconds, :3]) for course in courses.values()])
    cart, poles = float(shown[:, 0].max()), float(shown[:, 1:].max())
    times = min(LARGEST[0] / max(cart, 1e-9), LARGEST[1] / max(poles, 1e-9), MOST)
    return max(1, math.floor(times + 1e-9))


def shoot(
    courses: Mapping[str, Course],
    *paths: Path,
    model: str | None = None,
    seconds: float = SECONDS,
    magnify: float | None = None,
) -> None:
    """Runs side by side as a film, from their start.

    Args:
        courses: by compensator, or by another caption.
        paths: of the film, once drawn and written to each: `.gif`, or `.mp4` (with the `film` extra).
        model: MJCF file of the rig; None is the package's.
        seconds: how much of the runs, s.
        magnify: how many times deviations are enlarged; None is what `magnification` gives.

    Raises:
        ValueError: another suffix, or a factor that is not positive.
        ImportError: an `.mp4` is asked for, and imageio-ffmpeg is not installed.
        RuntimeError: nothing can be drawn on this machine.
    """
    for path in paths:
        if path.suffix.lower() not in FORMATS:
            raise ValueError(f"{path}: films are written as {' or '.join(FORMATS)}")
        if path.suffix.lower() == ".mp4" and not ffmpeg():
            mend = "add its extra: pip install '.[film]' in a clone, or write a .gif"
            raise ImportError(f"{path}: films as .mp4 need imageio-ffmpeg: {mend}")
    factor = magnification(courses, seconds) if magnify is None else magnify
    if not (math.isfinite(factor) and factor > 0):
        raise ValueError(f"the magnification is {factor}; it must be a number above zero")
    with ExitStack() as stack:
        keep = [stack.enter_context((_gif if path.suffix.lower() == ".gif" else _mp4)(path)) for path in paths]
        for frame in _frames(courses, seconds, factor, model):
            for one in keep:
                one(frame)


def ffmpeg() -> bool:
    """Whether an `.mp4` can be written here."""
    return importlib.util.find_spec("imageio_ffmpeg") is not None


def show(course: Course, *, model: str | None = None, seconds: float = SECONDS) -> None:
    """A run in a window, in real time and true size.

    Raises:
        ValueError: there is no display.
    """
    if not has_display():
        raise ValueError("there is no display for a window; write a film with --out")
    env = gymnasium.make(ENV_ID, model=model, render_mode="human")
    begin = time.perf_counter()
    try:
        while (now := time.perf_counter() - begin) < min(seconds, course.time[-1]):
            env.reset(options={"state": course.state[int(np.searchsorted(course.time, now))]})
    finally:
        env.close()


# ------------------------------------------------------------------------------------------------ parts


def _frames(courses: Mapping[str, Course], seconds: float, factor: float, model: str | None) -> Iterator[Image.Image]:
    width, height = SIZE
    env = gymnasium.make(ENV_ID, model=model, render_mode="rgb_array", width=width, height=height)
    length = min(seconds, max(float(course.time[-1]) for course in courses.values()))
    reach = 1.1 * max(float(np.abs(course.state[course.time <= length, 0]).max()) for course in courses.values())
    traces = [_trace(course, length, max(reach, 1e-4)) for course in courses.values()]
    large, small = ImageFont.load_default(15), ImageFont.load_default(12)
    try:
        for moment in np.arange(0.0, max(length, 1 / RATE), 1 / RATE):  # of the shortest run one
            frame = Image.new("RGB", (width * len(courses), height + TRACE + 2 * MARGIN), PAPER)
            draw = ImageDraw.Draw(frame)
            for column, ((name, course), trace) in enumerate(zip(courses.items(), traces, strict=True)):
                left = width * column
                k = min(int(np.searchsorted(course.time, moment)), len(course.time) - 1)
                env.reset(options={"state": factor * course.state[k]})
                picture: Any = env.render()
                frame.paste(Image.fromarray(picture), (left, 0))
                draw.text((left + 10, 6), CAPTIONS.get(name, name), INK, large)
                ended = course.fell and moment > course.time[-1]
                if factor != 1 or ended:
                    said = f"fell after {course.lasted:.2f} s" if ended else f"motion {factor:g} times as large"
                    draw.text((left + 10, 25), said, INK, small)
                frame.paste(trace, (left, height))
                _mark(draw, (left, height), course, k, length, max(reach, 1e-4), name)
            yield frame
    finally:
        env.close()


def _trace(course: Course, length: float, reach: float) -> Image.Image:
    """The way of a cart over time, pale; what has been is drawn over it."""
    width, _ = SIZE
    image = Image.new("RGB", (width, TRACE + 2 * MARGIN), PAPER)
    draw, small = ImageDraw.Draw(image), ImageFont.load_default(11)
    middle = MARGIN + TRACE // 2
    draw.line([(MARGIN, middle), (width - MARGIN, middle)], (200, 200, 200))
    points = _points(course, len(course.time) - 1, length, reach)
    if len(points) > 1:
        draw.line(points, (214, 218, 224), 1)
    draw.text((MARGIN, 0), f"cart, ±{1000 * reach:.0f} mm", INK, small)
    return image


def _mark(
    draw: ImageDraw.ImageDraw,
    corner: tuple[int, int],
    course: Course,
    k: int,
    length: float,
    reach: float,
    name: str,
) -> None:
    """Draw a trace up to sample `k`, and a dot there."""
    colour = style.of(name).colour
    points = [(x + corner[0], y + corner[1]) for x, y in _points(course, k, length, reach)]
    if len(points) > 1:
        draw.line(points, colour, 2)
    if points:
        x, y = points[-1]
        draw.ellipse((x - 3, y - 3, x + 3, y + 3), colour)


def _points(course: Course, k: int, length: float, reach: float) -> list[tuple[float, float]]:
    """Pixels of a trace up to sample `k`, as far as the film goes."""
    last = min(k + 1, int(np.searchsorted(course.time, length, side="right")))
    every = max(1, len(course.time[course.time <= length]) // (2 * SIZE[0]))
    time, cart = course.time[:last:every], course.state[:last:every, 0]
    x = MARGIN + (SIZE[0] - 2 * MARGIN) * time / max(length, 1e-9)
    y = MARGIN + TRACE / 2 * (1 - cart / reach)
    return list(zip(x.tolist(), y.tolist(), strict=True))


@contextmanager
def _gif(path: Path) -> Iterator[Callable[[Image.Image], None]]:
    """Takes frames, and writes them when all are there."""
    taken: list[Image.Image] = []
    count = itertools.count()

    def take(frame: Image.Image) -> None:
        if next(count) % GIF_TAKES == 0:
            taken.append(frame.quantize(128, method=Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE))

    yield take
    length = 1000 * GIF_TAKES / RATE
    with whole(path) as file:
        taken[0].save(file, "GIF", save_all=True, append_images=taken[1:], duration=length, loop=0, optimize=True)


@contextmanager
def _mp4(path: Path) -> Iterator[Callable[[Image.Image], None]]:
    """Takes frames, and hands them to ffmpeg; the file appears when all are in it."""
    import imageio_ffmpeg

    writers: list[Any] = []
    taken = itertools.count()
    no_film = OSError(errno.EIO, "ffmpeg could not write the film; make room and try again", str(path))
    partial = partial_of(path)
    partial.unlink(missing_ok=True)

    def take(frame: Image.Image) -> None:
        size = (frame.width // 2 * 2, frame.height // 2 * 2)  # H.264 wants even numbers
        if not writers:
            looks = {"fps": RATE, "macro_block_size": 2, "quality": 8, "output_params": ["-f", "mp4"]}
            writers.append(imageio_ffmpeg.write_frames(str(partial), size, **looks))
            writers[0].send(None)
        try:
            writers[0].send(frame.crop((0, 0, *size)).tobytes())
        except OSError:  # ffmpeg is gone, and what is said is its log
            raise no_film from None
        next(taken)

    try:
        yield take
        for writer in writers:
            writer.close()
        try:
            held, _ = imageio_ffmpeg.count_frames_and_secs(str(partial))
        except RuntimeError:
            held = -1
        if held != next(taken):  # ffmpeg's own exit code cannot be seen
            raise no_film
        partial.replace(path)
    finally:
        for writer in writers:
            writer.close()
        partial.unlink(missing_ok=True)
