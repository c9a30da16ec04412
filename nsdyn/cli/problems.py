"""`nsdyn solve`, `nsdyn profile` and `nsdyn bench`."""

from __future__ import annotations

import argparse

from nsdyn.cli.output import check_files, picture, plot_to, report, seconds
from nsdyn.tools.naming import counted


def solve_file(arguments: argparse.Namespace) -> int:
    """Run ``nsdyn solve``; return its exit code."""
    from nsdyn import solvers
    from nsdyn.recording import fclib

    solver = solvers.by_name(arguments.solver, arguments.tol)
    check_files(arguments)
    problem = fclib.read(arguments.problem)
    solution = solvers.solve(problem, solver)
    if arguments.output:
        fclib.write_solution(arguments.output, arguments.problem, solution, overwrite=True)
    figures = {
        "problem": arguments.problem,
        "contacts": problem.nc,
        "solver": arguments.solver,
        "tol": arguments.tol,
        "converged": solution.converged,
        "status": solution.status.message,
        "error": solution.error,
        "residual": solution.residual,
        "iterations": solution.iterations,
        "time": solution.time,
        "solution": arguments.output,
    }
    words = (
        f"{counted(problem.nc, 'contact')}, {arguments.solver}: {solution.status.message}; "
        f"error {solution.error:.2e}, residual {solution.residual:.2e} m/s, "
        f"{counted(solution.iterations, 'iteration')} in {seconds(solution.time)}"
    )
    report(arguments, figures, words)
    return 0 if solution.converged else 1


def profile_solvers(arguments: argparse.Namespace) -> int:
    """Run ``nsdyn profile``; return its exit code."""
    from dataclasses import asdict
    from functools import partial

    from nsdyn.bench import profiles

    check_files(arguments)
    solvers, smallest = arguments.solver or ["auto"], arguments.min_contacts
    found = [
        profiles.measure(arguments.folder, solvers, tol, arguments.limit, arguments.peer, smallest, progress=True)
        for tol in arguments.tol or [1e-8]
    ]
    if arguments.csv:
        profiles.write_csv(arguments.csv, found)
    if arguments.plot:
        plot_to(arguments.plot, *(partial(one.plot, legend=one is found[-1]) for one in found))
    figures = [
        {"tol": p.tol, "limit": p.limit, "summary": p.summary(), "runs": list(map(asdict, p.runs))} for p in found
    ]
    report(arguments, figures, "\n\n".join(f"tol {one.tol:g}\n{one.table()}" for one in found))
    return 0


def bench_engines(arguments: argparse.Namespace) -> int:
    """Run ``nsdyn bench``; return its exit code."""
    from dataclasses import asdict

    from nsdyn.bench import engines

    check_files(arguments)
    found = engines.measure(arguments.case, arguments.peer, arguments.limit, progress=True)
    if arguments.csv:
        found.write_csv(arguments.csv)
    if arguments.plot:
        picture(arguments.plot, found.plot, (13, 9.5), 80)
    report(arguments, {"summary": found.summary(), "runs": [asdict(run) for run in found.runs]}, found.table())
    return 0
