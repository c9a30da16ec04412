"""Problem files of our own making: every solver on every file, and the files themselves."""

from pathlib import Path

import numpy as np
import pytest

import nsdyn as nd

FILES = {path.stem: path for path in sorted((Path(__file__).parent.parent / "data").glob("*.hdf5"))}
CANNOT = {
    ("bundle", "arch"), ("bundle", "capstan"), ("bundle", "pile"), ("extragradient", "capstan"),
    ("fixed_point", "capstan"), ("gauss_seidel", "capstan"), ("impulse_newton", "capstan"),
    ("panagiotopoulos", "capstan"),
}  # fmt: skip
"""Where a method fails at 1e-4: with blocks of 10 g between weights of 100 N and more, or redundant contacts."""


def test_all_files_are_here():
    assert set(FILES) == {"arch", "capstan", "pile", "quadruped", "rod", "stack"}


@pytest.mark.parametrize("file", FILES)
def test_file(file, tmp_path):
    """What is read is written and read the same; the solution in the file is one."""
    problem = nd.fclib.read(FILES[file])
    copy = tmp_path / "copy.hdf5"
    nd.fclib.write(copy, problem, spacedim=2 if file == "rod" else 3)
    again = nd.fclib.read(copy)
    np.testing.assert_array_equal(again.q, problem.q)
    np.testing.assert_array_equal(again.W.toarray(), problem.W.toarray())
    assert (again.blocks is None) == (problem.blocks is None) == (file in ("capstan", "rod"))


LONG = {("uzawa", "capstan"), ("bundle", "stack")}
"""What takes ten seconds."""

SOLVABLE = [
    pytest.param(solver, file, marks=[pytest.mark.slow] if (solver, file) in LONG else [])
    for solver in nd.solvers.SOLVERS
    for file in FILES
    if (solver, file) not in CANNOT
]


@pytest.mark.parametrize(("solver", "file"), SOLVABLE)
def test_solver(solver, file):
    problem = nd.fclib.read(FILES[file])
    solution = nd.solve(problem, solver, tol=1e-4)
    assert solution.converged
    assert problem.error(solution.r) <= 1e-4 and problem.residual(solution.r) <= 1e-4


@pytest.mark.slow
@pytest.mark.parametrize(("solver", "file"), sorted(CANNOT))
def test_failure_is_told(solver, file):
    problem = nd.fclib.read(FILES[file])
    solution = nd.solve(problem, solver, tol=1e-4)
    assert not solution.converged and np.isfinite(solution.r).all()
    assert solution.error == pytest.approx(problem.error(solution.r), rel=1e-9)


@pytest.mark.parametrize("file", FILES)
def test_auto_to_the_tolerance_of_a_step(file):
    problem = nd.fclib.read(FILES[file])
    for given in (problem, nd.FC3D(problem.W, problem.q, problem.mu)):
        assert nd.solve(given, tol=1e-8).converged
