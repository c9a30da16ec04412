"""A live view of a simulation in a notebook or a browser, served by a process of meshcat."""

from __future__ import annotations

import contextlib
import html
import io
import time
import warnings

import numpy as np
import umsgpack
from scipy.spatial.transform import Rotation

from nsdyn.recording.recorder import Recorder
from nsdyn.stepping.state import Step
from nsdyn.stepping.stepper import Stepper
from nsdyn.tools.arrays import Array
from nsdyn.tools.options import is_number
from nsdyn.view.commands import Json, as_three, by_columns, set_property
from nsdyn.view.looks import veiled, visual_commands
from nsdyn.view.solids import body_path, shape_commands, shape_path
from nsdyn.view.stage import View, stage_commands


class Live:
    """A window that follows a `Stepper`, with the same initial camera as the page.

    Robots have the visual shapes of their files, with meshes drawn as flat triangles.

    In a notebook, a cell that ends with the object shows the window; elsewhere, open `url` in a browser. Cells that run
    later update the window. A process of meshcat on this machine serves the window until `close` is called or this
    process ends.

    Parameters
    ----------
    stepper : Stepper
    fps : float
        Most pictures per second of wall time, so that the simulation does not wait for pictures.

    Raises
    ------
    ValueError
        For a stepper or fps of another kind.

    Attributes
    ----------
    url : str
        Address of the window for a browser on this machine.

    Examples
    --------
    >>> import nsdyn as nd
    >>> stepper = nd.Stepper(nd.scenes.load("slide")(), dt=1e-2)
    >>> live = nd.Live(stepper)
    >>> for _ in range(40):
    ...     live.show(stepper.step())
    >>> live.close()
    """

    def __init__(self, stepper: Stepper, fps: float = 30.0) -> None:
        if not isinstance(stepper, Stepper):
            raise ValueError(f"stepper must be a nsdyn.Stepper, got {stepper!r}")
        if not (is_number(fps) and fps > 0.0):
            raise ValueError(f"fps must be a positive number, got {fps!r}")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", DeprecationWarning)  # from its imports of zmq
            from meshcat.visualizer import ViewerWindow

        scene, start = stepper.scene.describe(), stepper.start()
        view = View([Recorder(None, {"dt": stepper.dt}, scene, start).trajectory()])
        with contextlib.redirect_stdout(io.StringIO()):  # ViewerWindow prints its address
            self._window = ViewerWindow(None, True, [])
        self.url: str = self._window.web_url
        self._paths = [body_path(name) for name in scene["frames"]]
        self._wait, self._next = 1.0 / fps, 0.0
        hidden = [shape_path(scene, g, g["name"]) for g, on in zip(scene["geoms"], veiled(scene), strict=True) if on]
        commands = stage_commands(view) + shape_commands(scene, view) + visual_commands(scene, whole=True)
        for command in commands + [set_property(path, "visible", False) for path in hidden]:
            self._send(command)
        # Camera and sun look at the origin, from farther away than in a page, because the motion is not yet known.
        centre = np.eye(4)
        centre[:3, 3] = -view.centre
        self._send(_transform("/nsdyn", centre))
        self._send(set_property("/Lights/Sun/<object>", "position", (view.sun - view.centre).tolist()))
        camera = as_three(2.0 * (view.eye - view.centre))
        self._send(set_property("/Cameras/default/rotated/<object>", "position", camera))
        self.show(start)

    def show(self, state: Step) -> None:
        """Show a state, unless the last picture is more recent than 1 / fps."""
        if time.monotonic() < self._next:
            return
        self._next = time.monotonic() + self._wait
        x, turn = state.frames_x, state.frames_quat
        # Without articulations and driven bodies, q has all poses.
        poses = state.q.reshape(-1, 7) if x is None or turn is None else np.column_stack([x, turn])
        matrix = np.eye(4)
        for path, pose in zip(self._paths, poses, strict=True):
            matrix[:3, :3], matrix[:3, 3] = Rotation.from_quat(pose[3:]).as_matrix(), pose[:3]
            self._send(_transform(path, matrix))

    def close(self) -> None:
        """End the process that serves the window."""
        self._window.zmq_socket.close(linger=0)
        self._window.server_proc.kill()
        self._window.server_proc.communicate()

    def _send(self, command: Json) -> None:
        parts = command["type"].encode(), command["path"].encode(), umsgpack.packb(command)
        self._window.zmq_socket.send_multipart(parts)
        self._window.zmq_socket.recv()

    def _repr_html_(self) -> str:
        style = "width: 100%; height: 400px; border: 1px solid #d5dbe1"
        return f'<iframe src="{html.escape(self.url)}" style="{style}"></iframe>'


def _transform(path: str, pose: Array) -> Json:
    return {"type": "set_transform", "path": path, "matrix": by_columns(pose)}
