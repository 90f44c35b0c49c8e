"""Gymnasium's MuJoCo renderer, made to work without a display."""

from __future__ import annotations

import functools
import os
import subprocess
import sys
from typing import Any

import gymnasium
import mujoco


def viewer(model: mujoco.MjModel, data: mujoco.MjData, width: int, height: int, camera: str | None) -> Any:
    """A renderer of Gymnasium's for a simulation.

    Args:
        model: the simulation's model; its off-screen buffer grows to the picture.
        data: the simulation.
        width: of the picture, pixels.
        height: of the picture, pixels.
        camera: its name; the free camera if None or if the model has none of that name.

    Raises:
        gymnasium.error.DependencyNotInstalled: the renderer cannot be imported.
    """
    choose_renderer()
    try:
        from gymnasium.envs.mujoco.mujoco_rendering import MujocoRenderer
    except ImportError as error:
        raise gymnasium.error.DependencyNotInstalled(
            f"drawing needs Gymnasium's MuJoCo renderer ({error}); pip install 'gymnasium[mujoco]'"
        ) from error
    if camera is not None and mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, camera) < 0:
        camera = None  # a model of one's own need not have ours
    model.vis.global_.offwidth = max(model.vis.global_.offwidth, width)
    model.vis.global_.offheight = max(model.vis.global_.offheight, height)
    return MujocoRenderer(model, data, width=width, height=height, camera_name=camera, camera_id=None if camera else -1)


def has_display() -> bool:
    """Whether a window can be opened: without a display, GLFW ends the whole process on trying."""
    return sys.platform != "linux" or _named()


def _named() -> bool:
    """Whether the environment names a display, of X or of Wayland."""
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def choose_renderer() -> None:
    """Where there is no display and `MUJOCO_GL` is not set, set it to `egl` or `osmesa`, whichever works.

    Gymnasium would otherwise try to open a window. With neither library the variable stays unset, and drawing fails
    with Gymnasium's message.
    """
    if "MUJOCO_GL" in os.environ or _named():
        return
    for backend in ("egl", "osmesa"):
        if _works(backend):
            os.environ["MUJOCO_GL"] = backend
            return


@functools.cache
def _works(backend: str) -> bool:
    """Whether a fresh process gets a picture from this backend; a failed try would spoil the OpenGL of this one."""
    code = f"from mujoco.{backend} import GLContext; c = GLContext(8, 8); c.make_current(); c.free()"
    environment = {**os.environ, "MUJOCO_GL": backend}
    return not subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, check=False, timeout=60
    ).returncode
