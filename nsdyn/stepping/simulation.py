"""The loop around the stepper: a simulation from its arguments to its trajectory."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from contextvars import ContextVar
from functools import partial
from pathlib import Path
from typing import Any, TypedDict

from numpy.typing import NDArray

from nsdyn.recording.recorder import Recorder
from nsdyn.recording.trajectory import Trajectory
from nsdyn.scene import settings
from nsdyn.scene.scene import Scene
from nsdyn.solvers import Solver
from nsdyn.stepping import checkpoint
from nsdyn.stepping.functions import Callback
from nsdyn.stepping.impacts import Law
from nsdyn.stepping.state import State
from nsdyn.stepping.stepper import Stepper
from nsdyn.stepping.system import check_seconds
from nsdyn.tools.files import as_path
from nsdyn.tools.options import check_flags, is_number

MOST_STEPS = 2**53
"""Number of steps up to which the times k dt are distinct."""

command: ContextVar[str] = ContextVar("command", default="")
"""The `nsdyn` command that simulates, as it was typed, for its recording."""


class RunOptions(TypedDict, total=False):
    """Keywords of `simulate` except dt and files; see `simulate`."""

    theta: float
    solver: str | Solver | None
    controller: Callback | None
    external_force: Callback | None
    on_fail: str
    max_points: int
    dump_on_fail: str | Path | None
    impact: str | Law
    every: int
    contacts: bool
    overlap: float
    lift: bool
    polish: bool


class Options(RunOptions, total=False):
    """Keywords of `simulate` except files; see `simulate`."""

    dt: float


def simulate(
    scene: Scene,
    duration: float,
    dt: float = 1e-3,
    theta: float = 0.5,
    solver: str | Solver | None = None,
    controller: Callback | None = None,
    external_force: Callback | None = None,
    on_fail: str = "warn",
    record: str | Path | None = None,
    progress: bool = False,
    max_points: int = 8,
    dump_on_fail: str | Path | None = None,
    impact: str | Law = "dissipative",
    every: int = 1,
    contacts: bool = True,
    resume: str | Path | None = None,
    overlap: float = 0.01,
    lift: bool = False,
    polish: bool = False,
) -> Trajectory:
    """Simulate a scene and return its trajectory.

    Parameters
    ----------
    scene : Scene
    duration : float
        s; rounded up to whole steps that are recorded. At least half a step.
    dt, theta, solver, controller, external_force, on_fail, max_points, dump_on_fail, impact, overlap, lift, polish
        As in `Stepper`.
    record : path, optional
        HDF5 file written while the simulation runs. A killed run leaves its steps in the file.
    progress : bool
        Show a progress bar on stderr when it is a terminal.
    every : int
        Record only every n-th step, n = `every`. Works are summed over all steps, so that the ledger closes. Contacts,
        with their impulses, are those of the recorded step: see `nsdyn.recording.columns`.
    contacts : bool
        Whether contacts are recorded.
    resume : path, optional
        Recording, in place of `record`, of a run with the same arguments that ended or was killed. The run continues
        from the last state in the file, which is from about half a second of computing before a kill. The rows after
        it are added to the file, with the same bits as if the run had never stopped. Controllers and external forces
        must be functions of (t, q, v) alone, without memory.

    Returns
    -------
    Trajectory

    Raises
    ------
    ValueError
        For bad arguments, before anything is written; if `resume` is a recording of another scene or of other
        options, naming one that differs.
    FileNotFoundError
        If there is no recording to resume.
    NotConverged
        According to `on_fail`; the steps before are in `record`.

    Examples
    --------
    A box slides 2²/(2 · 0.5 · 9.81) m = 0.4077 m and stops; friction has then taken its 2 J:

    >>> import nsdyn as nd
    >>> scene = nd.Scene()
    >>> scene.add_halfspace("ground", material=nd.Material(mu=0.5))
    >>> scene.add_box("box", (0.2, 0.2, 0.2), 1.0, position=(0, 0, 0.1), linear_velocity=(2, 0, 0),
    ...               material=nd.Material(mu=0.5))
    >>> trajectory = nd.simulate(scene, 0.5, dt=1e-3)
    >>> round(float(trajectory.body("box").position[-1, 0]), 4), round(float(trajectory.energy.friction.sum()), 6)
    (0.4077, -2.0)
    """
    from tqdm import tqdm  # the import takes 50 ms, which a library user may not need

    check_seconds(duration=duration)
    check_flags(contacts=contacts, progress=progress)
    own = theta, solver, controller, external_force, on_fail, max_points, dump_on_fail, impact, overlap, lift, polish
    stepper = Stepper(scene, dt, *own)
    if duration < 0.5 * stepper.dt:
        raise ValueError(f"duration must be at least half a step of dt = {stepper.dt:g} s, got {duration:g} s")
    if not duration / stepper.dt < MOST_STEPS:
        raise ValueError(
            f"duration must be fewer than {MOST_STEPS:.4g} steps of dt = {stepper.dt:g} s, got {duration:g} s"
        )
    if not is_number(every, int) or not 1 <= every < MOST_STEPS:
        raise ValueError(f"every must be a whole number of steps, at least 1 and fewer than 2⁵³, got {every!r}")
    for name, file in (("record", record), ("resume", resume)):
        if file is not None:
            as_path(file, name)
    if resume is not None and record is not None:
        raise ValueError(f"record must be None where resume names the file to go on with, got {record}")
    every, duration = int(every), float(duration)
    steps = every * max(1, math.ceil(duration / stepper.dt / every - 1e-9))
    kept = {"max_points": int(max_points), "every": every, "contacts": contacts, "polish": polish}
    with _recorder(stepper, record, resume, kept, duration) as recorder:
        done = every * recorder.rows
        # disable=None: tqdm draws only on a terminal
        disable = None if progress else True
        for _ in tqdm(range(done, steps), unit="step", initial=done, total=steps, disable=disable):
            recorder.append(stepper.step(), partial(_packed, stepper.later()))
    return recorder.trajectory()


def _packed(later: Callable[[], State]) -> dict[str, NDArray[Any]]:
    """The arrays of a state, which is computed only when it is written."""
    return checkpoint.pack(later())


def _recorder(
    stepper: Stepper,
    record: str | Path | None,
    resume: str | Path | None,
    kept: dict[str, Any],
    duration: float,
) -> Recorder:
    """Return the recorder of a stepper; with `resume` the stepper is set to the last state of that recording."""
    scene = stepper.scene
    if resume is not None and stepper.functions.take_last:
        raise ValueError("resume must be None where a function takes the last step, which a recording does not hold")
    meta = {
        "dt": stepper.dt,
        "theta": stepper.theta,
        "solver": repr(stepper.solver),
        "impact": repr(stepper.system.impact),
        "controller": stepper.controller is not None,
        "external_force": stepper.external_force is not None,
        "checksums": json.dumps(checkpoint.checksums(scene)),
        **kept,
        "parameters": settings.as_json(scene.parameters),
        "command": command.get(),
    }
    begin = stepper.get_state()
    if resume is None:
        return Recorder(record, meta, scene.describe(), stepper.start(), partial(checkpoint.pack, begin))
    names = checkpoint.pack(begin).keys()
    recorder, arrays = Recorder.resumed(resume, meta, scene.describe(), stepper.start(), names, duration)
    stepper.set_state(checkpoint.unpack(arrays, begin, stepper.dynamics))
    return recorder
