"""Every column of a recording is either vouched for by the audit, or named here as what it does not look at."""

import falsified
import numpy as np
import pytest

import nsdyn as nd
from nsdyn.recording.trajectory import Trajectory

OWN = {  # what a run says of its solves and its times, which the motion does not show
    *(f"gauss/{name}" for name in ("gap", "shift", "bound", "coulomb")),
    *(f"solver/{name}" for name in ("error", "residual", "time")),
    "energy/defect",
    "wall_time",
}
WITHIN = {"contacts/gap", "contacts/u", "contacts/couple", "contacts/time"}
"""Columns of contacts that the audit knows, where bodies turn in a step, to first order."""
ROUND_OFF = 1e-6
"""Of the energy at play: a hundredth of what is less in a column of works is less than an audit sees, 1e-8."""

RUNS = {
    "arm": lambda: falsified.true("arm"),
    "snake": lambda: falsified.true("snake"),
    "dominoes": lambda: nd.simulate(nd.scenes.load("domino")(), 0.3, 5e-3),
}


OF_SNAKES = {
    "joints/shift",
    "pieces/shift",
    "links/impulse",
    *(f"{g}/external" for g in ("joints", "pieces", "energy")),
}
"""Columns that only the snake has at play; all of its own are `slow`."""


@pytest.mark.parametrize(
    ("name", "columns"),
    [
        ("dominoes", None),
        *(pytest.param(*of, marks=pytest.mark.slow) for of in (("snake", OF_SNAKES), ("arm", None), ("snake", None))),
    ],
)
def test_a_column_that_is_a_hundredth_larger_does_not_pass(name, columns):
    run = RUNS[name]()
    assert nd.check(run).passed
    play = max(float(np.ptp(run.energy.kinetic)), float(np.ptp(run.energy.potential)))
    looked_at = passed = 0
    for key, values in run.columns.items():
        finite = np.where(np.isfinite(values), np.abs(values), 0.0) if values.dtype.kind == "f" else np.zeros(1)
        least = ROUND_OFF * play if "energy" in key or "work" in key else 0.0
        if finite.max(initial=0.0) <= least or key in OWN | WITHIN or key == "frames/quat":
            continue  # of quaternions see below
        if columns and key not in columns:
            continue
        other = Trajectory(dict(run.meta), run.scene, run.columns | {key: 1.01 * values})
        looked_at += 1
        passed += nd.check(other).passed
        assert not passed, f"{key} is not vouched for"
    assert looked_at == len(columns) if columns else looked_at > 10


def test_quaternions_and_axes_of_length_other_than_one_do_not_pass():
    run = falsified.true("arm")
    for key in ("frames/quat", "contacts/normal", "contacts/tangent"):
        values = run.columns[key].copy()
        values[len(values) // 2] *= 1.0 + 1e-10
        other = Trajectory(dict(run.meta), run.scene, run.columns | {key: values})
        assert not nd.check(other).passed, key
