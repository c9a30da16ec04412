"""The `nsdyn` command.

Results go to stdout, as text or with ``--json``; progress and messages go to stderr. The exit code is 0 for success, 1
for a simulation that did not converge, a failed audit or a failed self-check, and 2 for bad input. Bad input is
reported in one line before any file is written.
"""

from __future__ import annotations

import _thread
import argparse
import io
import logging
import os
import re
import shlex
import sys
import threading
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

from nsdyn.cli.doctor import diagnose, version_of
from nsdyn.cli.figures import add_plot, draw
from nsdyn.cli.films import add_film, make_film
from nsdyn.cli.output import OUTPUTS, add_input, add_made, add_output, one_line
from nsdyn.cli.problems import bench_engines, profile_solvers, solve_file
from nsdyn.cli.results import add_table, show_energy, show_table, write_page
from nsdyn.cli.run import add_scene, add_simulation, begin_scene, list_scenes, run_scene
from nsdyn.cli.studies import add_check, add_compare, add_study, check_anything, compare_recordings, study_steps
from nsdyn.cli.sweeps import add_sweep, sweep_scene
from nsdyn.tools import callbacks
from nsdyn.tools.files import FRAME, PAGE, PICTURE, PROBLEM, RECORDING, TABLE

Command = Callable[[str, Callable[[argparse.Namespace], int], str], argparse.ArgumentParser]
"""Function that adds a command, given its name, its function and a summary."""

EXAMPLES = {
    "scenes": "nsdyn scenes",
    "doctor": "nsdyn doctor --compile",
    "new": "nsdyn new my.py",
    "run": "nsdyn run stack -o run.h5 --html run.html",
    "sweep": "nsdyn sweep slide --set mu=0.2,0.5 --csv slides.csv",
    "study": "nsdyn study four_bar --dt 8e-3,4e-3,2e-3 --time 0.2 --plot study.pdf",
    "check": "nsdyn check run.h5",
    "solve": "nsdyn solve problem.hdf5 --solver newton",
    "profile": "nsdyn profile problems --solver all --plot profile.png",
    "bench": "nsdyn bench slip --peer mujoco",
    "energy": "nsdyn energy run.h5 --plot energy.png",
    "bodies": "nsdyn bodies run.h5 --csv bodies.csv",
    "joints": "nsdyn joints run.h5 --name 'robot/*knee*'",
    "pairs": "nsdyn pairs run.h5 --name ground",
    "contacts": "nsdyn contacts run.h5 --csv contacts.csv",
    "view": "nsdyn view run.h5 other.h5 -o both.html",
    "film": "nsdyn film run.h5 --speed 0.1 -o slowly.mp4",
    "plot": "nsdyn plot run.h5 --kind speed --kind force -o run.pdf",
    "compare": "nsdyn compare run.h5 other.h5",
}
"""Example of each command, which the help shows."""

TABLES = {
    "bodies": "Print or export the motion of bodies: positions, velocities, contact forces.",
    "joints": "Print or export joints and loops: motion, torques, reactions.",
    "pairs": "Print or export what bodies do to each other: gap, slip, normal force, friction.",
    "contacts": "Print or export contact points: gap, velocity, impulse, state.",
}

FIGURES = "scenes doctor run sweep study check solve profile bench energy compare".split()
"""Commands whose results are figures, which ``--json`` prints."""

OPTIONS = {"duration": "--time", "dts": "--dt", "package_dirs": "--package-dir"}
"""Options of the command by names of Python arguments; an error that begins with the name shows the option instead."""

AGAIN = 0.05
"""Time after which an interrupt that Python has dropped is repeated, s."""


def main(argv: list[str] | None = None) -> int:
    """Run the command and return its exit code."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # what a locale other than UTF-8 lacks, such as √, ends no command
            stream.reconfigure(errors="backslashreplace")
    arguments = parser().parse_args(argv)
    arguments.typed = shlex.join(["nsdyn", *(sys.argv[1:] if argv is None else argv)])
    logging.basicConfig(level=logging.INFO, format="nsdyn: %(message)s", stream=sys.stderr)
    with warnings.catch_warnings():
        before, warnings.showwarning, sys.unraisablehook = sys.unraisablehook, _show_warning, _tell
        try:
            return int(arguments.run(arguments))
        except BrokenPipeError:  # the reader of the output has ended
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 1
        except Exception as error:
            theirs = callbacks.below(error) is not None
            if not theirs and not isinstance(error, (ValueError, OSError)):
                raise
            # Errors raised by nsdyn name the file in their message: only the message is shown.
            ours = isinstance(error, OSError) and error.filename is None and error.strerror
            word, space, rest = one_line(callbacks.text(error) if theirs else ours or error).partition(" ")
            print(f"nsdyn: error: {word if theirs else OPTIONS.get(word, word)}{space}{rest}", file=sys.stderr)
            return 2
        except KeyboardInterrupt as stop:
            print("nsdyn: interrupted" + (f": {stop}" if stop.args else ""), file=sys.stderr)
            return 130
        finally:
            sys.unraisablehook = before


def _tell(dropped: Any) -> None:
    """Report an exception that Python drops, for instance while freeing an object; repeat a dropped interrupt later."""
    if issubclass(dropped.exc_type, KeyboardInterrupt):
        later = threading.Timer(AGAIN, _thread.interrupt_main)  # here it would be dropped as well
        later.daemon = True
        later.start()
    else:
        sys.__unraisablehook__(dropped)


def _show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    print(f"nsdyn: warning: {one_line(message)}", file=sys.stderr)


class _Parser(argparse.ArgumentParser):
    """Parser that reports a mistake in one line, like all other errors of the command."""

    def _get_values(self, action: argparse.Action, arg_strings: list[str]) -> Any:
        if action.option_strings and arg_strings == ["--"]:  # of "--csv=--" argparse makes an empty list
            self.error(f"argument {'/'.join(action.option_strings)}: expected one argument")
        return super()._get_values(action, arg_strings)

    def error(self, message: str) -> NoReturn:
        from nsdyn.tools.naming import unknown

        if choice := re.fullmatch(r"argument (.*): invalid choice: '(.*?)' \(choose from (.*)\)", message):
            what, given, known = choice.groups()
            message = unknown(given, re.findall(r"[\w-]+", known), what)
        self.exit(2, f"nsdyn: error: {message} (see {self.prog} --help)\n")


def parser() -> _Parser:
    """Return the parser of the command line."""
    top = _Parser(
        prog="nsdyn",
        description="Rigid multibody dynamics with hard contact and exact Coulomb friction.",
        formatter_class=argparse.RawTextHelpFormatter,
    )
    top.add_argument("--version", action="version", version=f"nsdyn {version_of('nsdyn')}")
    commands = top.add_subparsers(title="commands", metavar="COMMAND")
    top.set_defaults(run=partial(_help, top))

    def command(name: str, run: Callable[[argparse.Namespace], int], summary: str) -> argparse.ArgumentParser:
        out = commands.add_parser(
            name,
            help=f"{summary}\n  {EXAMPLES[name]}",
            description=f"{summary} For example: {EXAMPLES[name]}",
        )
        out.set_defaults(run=run)
        return out

    _add_simulations(command)
    _add_problems(command)
    _add_results(command)
    for name, p in commands.choices.items():
        if name in FIGURES:
            p.add_argument("--json", action="store_true", help="print the figures as JSON")
        if p.get_default("outputs"):
            p.epilog = OUTPUTS
    return top


def _help(parser: argparse.ArgumentParser, arguments: argparse.Namespace) -> int:
    """Run ``nsdyn`` without a command; return its exit code."""
    parser.print_help()
    return 0


def _add_simulations(command: Command) -> None:
    """Add the commands that make and run scenes."""
    p = command("scenes", list_scenes, "List the named scenes and their parameters.")

    p = command("doctor", diagnose, "Show versions and places of what nsdyn depends on, and check that it works.")
    p.add_argument("--compile", action="store_true", help="first compile all kernels")

    p = command("new", begin_scene, "Write a commented scene file to begin with; one that exists is left alone.")
    p.add_argument("file", type=Path, metavar="MY.py")

    p = command("run", run_scene, "Simulate a scene and print its energy ledger.")
    add_scene(p)
    add_simulation(p, "raise", "dump", "ignore")
    where = p.add_mutually_exclusive_group()
    add_output(where, "-o", "--output", kind=RECORDING, metavar="RUN.h5", help="recording, written while it runs")
    add_output(
        where,
        "--resume",
        kind=RECORDING,
        metavar="RUN.h5",
        help="recording of a run of the same arguments that ended or was killed: go on with it, bit for bit",
    )
    p.add_argument(
        "--every", type=int, default=1, metavar="N", help="record only every N-th step (default: %(default)s)"
    )
    p.add_argument("--no-contacts", action="store_true", help="leave the contacts out of the recording")
    add_output(p, "--html", kind=PAGE, metavar="RUN.html", help="self-contained animated page")
    p.add_argument(
        "--dump-on-fail", type=Path, metavar="DIR", help="folder for the problems of steps that fail, as FCLIB files"
    )
    p.add_argument("--check", action="store_true", help="audit the motion; the exit code is 0 only if it passes")

    p = command("sweep", sweep_scene, "Simulate a scene for every combination of parameters and print a table.")
    add_sweep(p)

    p = command("study", study_steps, "Simulate a scene at several time steps: errors against the finest, orders.")
    add_study(p)

    add_check(command("check", check_anything, "Look for what is wrong with a robot file, a scene or a recording."))


def _add_problems(command: Command) -> None:
    """Add the commands for contact problems, solvers and engines."""
    p = command("solve", solve_file, "Solve a frictional contact problem in an FCLIB file.")
    add_input(p, "problem", metavar="PROBLEM.hdf5")
    p.add_argument("--solver", default="auto", metavar="S", help="solver by name (default: %(default)s)")
    p.add_argument("--tol", type=float, default=1e-8, metavar="E", help="its tolerance (default: %(default)s)")
    add_output(p, "-o", "--output", kind=PROBLEM, metavar="SOLUTION.hdf5", help="the problem and its solution")

    p = command(
        "profile", profile_solvers, "Compare solvers on a folder of FCLIB files: Dolan-Moré performance profiles."
    )
    p.add_argument("folder", type=Path, metavar="DIR")
    p.add_argument("--solver", action="append", metavar="S", help="name, or all; may be repeated (default: auto)")
    p.add_argument(
        "--tol", type=float, action="append", metavar="E", help="on the error measure; may be repeated (default: 1e-8)"
    )
    p.add_argument("--min-contacts", type=int, default=0, metavar="N", help="leave out smaller problems")
    p.add_argument(
        "--limit", type=float, default=10.0, metavar="SECONDS", help="time limit of each solve (default: %(default)s)"
    )
    p.add_argument("--peer", action="append", default=[], metavar="NAME", help="siconos or pinocchio: all its solvers")
    add_output(p, "--csv", kind=TABLE, metavar="F.csv", help="all runs, one a line")
    add_output(p, "--plot", kind=PICTURE, metavar="F.png", help="picture of the profiles (png, pdf or svg)")

    p = command(
        "bench", bench_engines, "Speed against error: scenes with known answers, in nsdyn and in other engines."
    )
    p.add_argument("case", metavar="CASE", nargs="*", help="cases by name (default: all)")
    p.add_argument(
        "--peer",
        action="append",
        default=[],
        metavar="NAME",
        help="mujoco, drake, dart, bullet or siconos; may be repeated",
    )
    p.add_argument(
        "--limit", type=float, default=30.0, metavar="SECONDS", help="time limit of each run (default: %(default)s)"
    )
    add_output(p, "--csv", kind=TABLE, metavar="F.csv", help="all runs, one a line")
    add_output(p, "--plot", kind=PICTURE, metavar="F.png", help="picture of time against error (png, pdf or svg)")


def _add_results(command: Command) -> None:
    """Add the commands that read recordings."""
    p = command("energy", show_energy, "Print, plot or export the energy ledger of a recording.")
    add_input(p, "recording", metavar="RUN.h5")
    add_output(p, "--plot", kind=PICTURE, metavar="E.png", help="picture of energies and works (png, pdf or svg)")
    p.add_argument(
        "--by",
        choices=("pair", "body"),
        help="in place of the ledger, works of the contacts of each pair of bodies, or energies of each body",
    )
    add_output(p, "--csv", kind=TABLE, metavar="E.csv", help="all times: energies, and the works of each step, in J")

    for kind, summary in TABLES.items():
        add_table(command(kind, partial(show_table, kind), summary))

    p = command("view", write_page, "Make a web page or a picture of a recording, or of some beside each other.")
    add_input(p, "recording", metavar="RUN.h5")
    add_input(p, "beside", metavar="OTHER.h5", nargs="*", help="shown beside it, on the same clock")
    add_made(p, PAGE, "html", "self-contained animated page; with --png only if it is named")
    p.add_argument(
        "--forces",
        nargs="?",
        const="pair",
        default=False,
        metavar="BY",
        help="draw the contact forces, one for each pair of bodies (the default) or each contact point: pair, point",
    )
    p.add_argument(
        "--fps",
        type=float,
        metavar="N",
        help="keyframes per second (default: all states where they cost less than 1 MB, else 30)",
    )
    add_output(p, "--png", kind=FRAME, metavar="FRAME.png", help="picture of one moment, made by a headless Chromium")
    p.add_argument("--at", type=float, metavar="T", help="time of the picture in s (default: the end)")

    add_film(command("film", make_film, "Make a film of a recording, or of some beside each other, with their curves."))
    add_compare(command("compare", compare_recordings, "Say where two recordings of one scene part."))
    add_plot(command("plot", draw, "Draw motion, forces, energies, joints or errors of a recording over time."))
