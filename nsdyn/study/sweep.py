"""Sweeps: a scene for every combination of parameters, run by any executor, with results equal to the last bit."""

from __future__ import annotations

import itertools
import pickle
import zlib
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Unpack

import numpy as np

from nsdyn.problem.solution import NotConverged
from nsdyn.recording.trajectory import Trajectory
from nsdyn.scene import named as scenes
from nsdyn.scene.scene import Scene
from nsdyn.stepping.simulation import Options, simulate
from nsdyn.study.gathering import gather
from nsdyn.study.identity import told
from nsdyn.study.store import Store
from nsdyn.tools.callbacks import called, text
from nsdyn.tools.naming import check_known
from nsdyn.tools.options import check_flags


@dataclass(frozen=True, eq=False)
class Member:
    """One simulation of a sweep.

    Attributes
    ----------
    parameters : dict
        Parameters of the scene.
    result : Trajectory, or what `keep` made of it
        None for a run that did not converge, was refused, or whose process died twice.
    failure : str
        Reason why there is no result; empty if there is one.
    """

    parameters: dict[str, Any]
    result: Any
    failure: str


def sweep(
    scene: str | Callable[..., Scene],
    parameters: Mapping[str, Sequence[Any]],
    duration: float,
    executor: Executor | int | None = None,
    keep: Callable[[Trajectory], Any] | None = None,
    progress: bool = False,
    store: str | Path | None = None,
    **options: Unpack[Options],
) -> list[Member]:
    """Simulate a scene for every combination of parameters.

    Parameters
    ----------
    scene : str or callable
        Name or file of a scene, which is run with its controller and external forces, or a function
        ``scene(**parameters) -> Scene``, which the executor must be able to send.
    parameters : mapping of str to sequence
        Values of each parameter; the last parameter varies fastest in the result.
    duration : float
        Simulated time, s.
    executor : int or concurrent.futures.Executor, optional
        Number of processes, or an executor: ``dask.distributed.Client(address).get_executor()``. By default runs follow
        each other in this process. Results are in the order of the combinations and equal to the last bit for every
        executor. A run whose process dies is tried once more; other runs are not affected.
    keep : callable, optional
        ``keep(trajectory)`` returns the result of a run. It is called in the process of the run, so that only its
        return value is sent and stored. By default the result is the whole trajectory.
    progress : bool
        Show a progress bar on stderr when it is a terminal.
    store : path, optional
        File to which every run is added when it is done. Runs that an existing file contains are not run again. A file
        of another scene, other options or other functions is refused, also where what they use has changed: values in
        closures, attributes of objects, and all of their own module. `keep` must then return values that JSON has:
        numbers, texts, lists and dicts.
    **options
        Options of `nsdyn.simulate` except files: dt, theta, solver, ...

    Returns
    -------
    list of Member

    Raises
    ------
    ValueError
        For a parameter without values, an argument that cannot be sent to other processes, or a store of another sweep;
        and if the scene or `simulate` refuses every run. If only some runs are refused, they have a `failure`.

    Examples
    --------
    >>> import nsdyn as nd
    >>> runs = nd.sweep("slide", {"mu": [0.25, 0.5]}, 0.2, dt=0.02, keep=lambda run: float(run.v[-1, 0]))
    >>> [(run.parameters, round(run.result, 4)) for run in runs]
    [({'mu': 0.25}, 1.5095), ({'mu': 0.5}, 1.019)]
    """
    check_known(options, Options.__optional_keys__)
    check_flags(progress=progress)
    if not isinstance(parameters, Mapping):
        raise ValueError(f"parameters must be a mapping of names to lists of values, got {parameters!r}")
    for name, values in parameters.items():
        if isinstance(values, str) or not isinstance(values, Sequence | np.ndarray) or len(values) == 0:
            raise ValueError(f"{name} must have a list of at least one value, got {values!r}")
    few = isinstance(executor, int) and (isinstance(executor, bool) or executor < 1)
    if few or not isinstance(executor, Executor | int | None):
        raise ValueError(f"executor must be a number of processes, at least 1, or an executor, got {executor!r}")
    if store is not None and keep is None:
        raise ValueError("keep must say what of a run is stored: whole trajectories are not")
    # Other processes cannot import the function of a named scene, whose file is no module: they load it by its name.
    scene = scenes.name_of(scene) or scene if callable(scene) else scene
    if isinstance(executor, int | ProcessPoolExecutor):
        for what, value in {"scene": scene, "keep": keep, **parameters, **options}.items():
            _check_sendable(what, value)
    combinations = (dict(zip(parameters, values, strict=True)) for values in itertools.product(*parameters.values()))
    tasks = [(scene, chosen, duration, keep, options) for chosen in combinations]
    with _opened(store, scene, duration, keep, options) as kept:
        members, refused = _gathered(tasks, executor, kept, progress)
    if refused == len(members):
        raise ValueError(members[0].failure)
    return members


def _check_sendable(what: str, value: Any) -> None:
    """Raise a ValueError for a value that cannot be sent to other processes."""
    try:
        pickle.dumps(value)
    except Exception as failure:  # its kind depends on the object
        raise ValueError(
            f"{what} can't be pickled, to be sent to other processes: define it at module level, got {value!r} "
            f"({failure})"
        ) from None


def _gathered(
    tasks: list[tuple[Any, ...]], executor: Executor | int | None, kept: Store | None, progress: bool
) -> tuple[list[Member], int]:
    """Return all members of a sweep, from the store or run here, and the number of refused or lost runs."""
    from tqdm import tqdm

    members: dict[int, Member] = {}
    for k, (_, chosen, *_) in enumerate(tasks):
        if kept and (known := kept.point(chosen)):
            members[k] = Member(chosen, known["result"], known["failure"])
    missing = {k: task for k, task in enumerate(tasks) if k not in members}
    refused, disable = 0, None if progress else True
    with tqdm(total=len(tasks), initial=len(members), unit="run", disable=disable) as bar:
        try:
            for k, outcome, lost in gather(_run, missing, executor):
                chosen = tasks[k][1]
                result, failure, wrong = outcome if outcome else (None, lost, True)
                if wrong:
                    refused += 1
                elif kept:
                    result = kept.add({"parameters": chosen, "result": result, "failure": failure})["result"]
                members[k] = Member(chosen, result, failure)
                bar.update()
        except KeyboardInterrupt:
            # The file is counted again: a point may have been written at the moment of the interrupt.
            count = kept.count(task[1] for task in tasks) if kept else len(members) - refused
            done = f"{count} of {len(tasks)} done"
            goes = "the same command goes on" if kept else "without a store they are lost"
            raise KeyboardInterrupt(f"{done}; {goes}") from None
    return [members[k] for k in range(len(tasks))], refused


def _opened(
    store: str | Path | None, scene: str | Callable[..., Scene], duration: float, keep: Any, options: Options
) -> AbstractContextManager[Store | None]:
    """Return the store of a sweep, for a with statement."""
    if store is None:
        return nullcontext()
    source = Path(scenes.module(scene).__file__ or "").read_bytes() if isinstance(scene, str) else b""
    return Store(
        store,
        {
            "scene": told(scene),
            "checksum of the scene": zlib.crc32(source),
            "duration": duration,
            "keep": told(keep),
            "options": {name: told(value) for name, value in sorted(options.items())},
        },
    )


def _run(
    scene: str | Callable[..., Scene],
    parameters: dict[str, Any],
    duration: float,
    keep: Callable[[Trajectory], Any] | None,
    options: Options,
) -> tuple[Any, str, bool]:
    """Run one simulation and return (result, reason if there is none, whether it was refused)."""
    try:
        trajectory = simulated(scene, parameters, duration, options)
        return trajectory if keep is None else called(keep, "keep", lambda kept: kept, trajectory), "", False
    except NotConverged as failure:
        return None, str(failure), False
    except Exception as failure:  # from the code of the scene or of the user
        return None, text(failure), True


def simulated(scene: str | Callable[..., Scene], parameters: Any, duration: float, options: Any) -> Trajectory:
    """Simulate a scene, given by its name or by a function, with its controller and external forces."""
    if isinstance(scene, str):
        setup = scenes.setup(scene, **parameters)
        return simulate(setup.scene, duration, **setup.options(**options))
    return simulate(scenes.made(scene, **parameters), duration, **options)


UNITS = {
    **dict.fromkeys(("kinetic", "potential", "normal", "friction", "defect"), "J"),
    **{"displacement": "m", "penetration": "m", "gauss_bound": "√J", "gauss_shift": "m/s", "residual": "m/s"},
}
"""Units of `figures`."""


def figures(trajectory: Trajectory) -> dict[str, float]:
    """Return the figures of a run that tables show, in `UNITS`.

    They are the largest distance of a free body from its start, energies at the end, works of the contacts, and the
    worst values of all steps.
    """
    free = trajectory.scene["frames"][: trajectory.scene["free"]]
    moved = (trajectory.body(name).position for name in free)
    energy = trajectory.energy
    return {
        "displacement": max((float(np.linalg.norm(x[-1] - x[0])) for x in moved), default=0.0),
        "kinetic": float(energy.kinetic[-1]),
        "potential": float(energy.potential[-1]),
        "normal": float(energy.normal.sum()),
        "friction": float(energy.friction.sum()),
        **trajectory.worst(),
    }
