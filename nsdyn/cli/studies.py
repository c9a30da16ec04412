"""`nsdyn study`, `nsdyn compare` and `nsdyn check`: comparison of runs, and audits of models and recordings."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from nsdyn.cli.output import PICTURE_SIZE, add_input, add_output, check_files, header, one_line, picture, report
from nsdyn.cli.run import add_scene, add_set, add_solver, chosen_solver
from nsdyn.tools.files import PICTURE, TABLE, write_csv


def add_study(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``nsdyn study``."""
    add_scene(parser)
    parser.add_argument(
        "--dt",
        required=True,
        action="append",
        metavar="H,H,...",
        help="time steps in s, with commas between; may be repeated; the least is the reference",
    )
    parser.add_argument("--time", type=float, metavar="T", help="simulated time in s (default: the scene's own)")
    add_solver(parser, "raise", "ignore")
    add_output(parser, "--csv", kind=TABLE, metavar="F.csv", help="the table")
    add_output(parser, "--plot", kind=PICTURE, metavar="F.png", help="picture of the errors over dt (png, pdf or svg)")


def study_steps(arguments: argparse.Namespace) -> int:
    """Run ``nsdyn study``; return its exit code."""
    import nsdyn
    from nsdyn.scene import settings

    name = arguments.scene
    parameters = settings.values(name, arguments.set)
    check_files(arguments)
    try:
        found = nsdyn.refine(
            name,
            [settings.parse(text, 0.1, "--dt") for text in ",".join(arguments.dt).split(",")],
            nsdyn.scenes.seconds(name, "DURATION") if arguments.time is None else arguments.time,
            parameters,
            progress=True,
            theta=arguments.theta,
            solver=chosen_solver(arguments),
            on_fail=arguments.on_fail,
        )
    except nsdyn.NotConverged as failure:
        print(f"nsdyn: not converged: {one_line(failure)}", file=sys.stderr)
        return 1
    if arguments.csv:
        table = found.as_dict()
        units = {"dt": "s", "time": "s"} | table["units"]
        rows: list[dict[str, Any]] = [
            {header(name, units): value for name, value in run.items() if name != "orders"}
            | {f"order_{name}": p for name, p in run["orders"].items()}
            for run in table["runs"]
        ]
        columns = list(dict.fromkeys(column for row in rows for column in row))
        write_csv(arguments.csv, columns, (map(row.get, columns) for row in rows))
    if arguments.plot:
        from nsdyn.study.drawings import draw_refinement

        picture(arguments.plot, lambda figure: draw_refinement(found, figure), PICTURE_SIZE)
    report(arguments, found.as_dict(), found)
    return 0


def add_compare(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``nsdyn compare``."""
    add_input(parser, "first", metavar="A.h5")
    add_input(parser, "second", metavar="B.h5")


def compare_recordings(arguments: argparse.Namespace) -> int:
    """Run ``nsdyn compare``; return its exit code."""
    import nsdyn

    check_files(arguments)
    found = nsdyn.compare(*(nsdyn.Trajectory.load(path) for path in (arguments.first, arguments.second)))
    report(arguments, found.as_dict(), found)
    return 0


def add_check(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``nsdyn check``."""
    parser.add_argument(
        "what",
        metavar="ROBOT|SCENE|RUN.h5",
        help="a robot file (.urdf, .sdf, .xml, .mjcf), a scene by its name or its file (.py), a recording (.h5)",
    )
    add_set(parser)
    parser.add_argument("--base", choices=("fixed", "free"), help="of a URDF (default: fixed)")
    parser.add_argument("--keyframe", metavar="NAME", help="that an MJCF file starts from")
    parser.add_argument(
        "-q",
        metavar="Q,Q,...",
        help="where a robot starts, Pinocchio's order, with commas between; -q=-1,2 if the first is negative",
    )
    parser.add_argument(
        "--package-dir",
        dest="package_dirs",
        metavar="DIR",
        action="append",
        type=Path,
        help="where the meshes of a robot are looked up; may be repeated",
    )


def check_anything(arguments: argparse.Namespace) -> int:
    """Run ``nsdyn check``; return its exit code, which is 0 only if all is well."""
    import nsdyn
    from nsdyn.audit import checking, inspection
    from nsdyn.scene import settings

    what, ending = arguments.what, Path(arguments.what).suffix.lower()
    given = ((name, vars(arguments)[name]) for name in ("base", "keyframe", "q", "package_dirs"))
    options: dict[str, Any] = {name: value for name, value in given if value is not None}
    if options and ending not in inspection.ROBOTS:
        raise ValueError(f"{next(iter(options))} is for robot files, which {what} is not")
    if arguments.q is not None:
        options["q"] = [settings.parse(text, 0.0, "-q") for text in arguments.q.split(",")]
    if arguments.set:
        if ending in (*inspection.ROBOTS, *checking.RECORDINGS):
            raise ValueError(f"--set is for scenes, which {what} is not")
        options = settings.values(what, arguments.set)
    found = nsdyn.check(what, **options)
    report(arguments, found.as_dict(), found)
    return 0 if found.passed else 1
