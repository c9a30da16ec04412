"""Sweeps: a scene over the product of lists of parameters, run by any executor, with the same bits from each."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from typing import Any

import numpy as np

from nsdyn.problem.solution import NotConverged
from nsdyn.recording.trajectory import Trajectory
from nsdyn.scene import named as scenes
from nsdyn.scene.scene import Scene
from nsdyn.stepping.simulation import simulate

__all__ = ["Member", "figures", "sweep"]


@dataclass(frozen=True, eq=False)
class Member:
    """One simulation of a sweep.

    Attributes
    ----------
    parameters : dict
        Of the scene.
    result : Trajectory, or what `keep` made of it
        None for a run that did not converge.
    failure : str
        Why there is no result, empty if there is one.
    """

    parameters: dict[str, Any]
    result: Any
    failure: str


def sweep(
    scene: str | Callable[..., Scene],
    parameters: Mapping[str, Sequence[Any]],
    duration: float,
    executor: Executor | None = None,
    keep: Callable[[Trajectory], Any] | None = None,
    progress: bool = False,
    **options: Any,
) -> list[Member]:
    """Simulate a scene for every combination of parameters.

    Parameters
    ----------
    scene : str or callable
        Name of a scene, which is run with its own controller if it has one, or a function ``scene(**parameters) ->
        Scene``, which must be one that the executor can send.
    parameters : mapping of str to sequence
        Values of each parameter; the last one varies fastest in the result.
    duration : float
        s.
    executor : concurrent.futures.Executor, optional
        Of threads, of processes, ``dask.distributed.Client(address).get_executor()``; default: one run after the other
        in this process. Results are in the order of the product and have the same bits whatever runs them.
    keep : callable, optional
        ``keep(trajectory)`` returns what is wanted of a run and is called where it ran, so that only this is sent and
        kept; default: the whole trajectory.
    progress : bool
        Show a progress bar on stderr when it is a terminal.
    **options
        For `nsdyn.simulate`: dt, theta, solver, ...

    Returns
    -------
    list of Member

    Raises
    ------
    ValueError
        For a parameter without values, and for what the scene or `simulate` refuses.

    Examples
    --------
    >>> import nsdyn as nd
    >>> runs = nd.sweep("slide", {"mu": [0.25, 0.5]}, 0.2, dt=0.02, keep=lambda run: float(run.v[-1, 0]))
    >>> [(run.parameters, round(run.result, 4)) for run in runs]
    [({'mu': 0.25}, 1.5095), ({'mu': 0.5}, 1.019)]
    """
    from tqdm import tqdm

    for name, values in parameters.items():
        if isinstance(values, str) or not isinstance(values, Sequence | np.ndarray) or len(values) == 0:
            raise ValueError(f"{name} must have a list of at least one value, got {values!r}")
    # A function of a named scene lives in a file that is no module for other processes: they load it by its name.
    scene = scenes.name_of(scene) or scene if callable(scene) else scene
    combinations = [dict(zip(parameters, values, strict=True)) for values in itertools.product(*parameters.values())]
    tasks = [(scene, chosen, duration, keep, options) for chosen in combinations]
    bar = tqdm(total=len(tasks), unit="run", disable=None if progress else True)
    with bar:
        if executor is None:
            out = []
            for task in tasks:
                out.append(_run(*task))
                bar.update()
            return out
        futures: list[Future[Member]] = [executor.submit(_run, *task) for task in tasks]
        try:
            for future in futures:
                future.result()
                bar.update()
        finally:
            for future in futures:
                future.cancel()
        return [future.result() for future in futures]


def _run(
    scene: str | Callable[..., Scene],
    parameters: dict[str, Any],
    duration: float,
    keep: Callable[[Trajectory], Any] | None,
    options: dict[str, Any],
) -> Member:
    """One simulation, wherever it runs."""
    if isinstance(scene, str):
        setup = scenes.setup(scene, **parameters)
        built, options = setup.scene, setup.options(**options)
    else:
        built = scene(**parameters)
    try:
        trajectory = simulate(built, duration, **options)
    except NotConverged as failure:
        return Member(parameters, None, str(failure))
    return Member(parameters, trajectory if keep is None else keep(trajectory), "")


def figures(trajectory: Trajectory) -> dict[str, float]:
    """What a table shows of a run.

    Largest distance of a free body from where it started [m], energies at the end and works of the contacts [J], and
    the worst of all steps.
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
