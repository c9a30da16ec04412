"""`nsdyn doctor`: installed packages, their places, and checks that they work."""

from __future__ import annotations

import argparse
import importlib.metadata
import importlib.util
import re
import signal
import subprocess
import sys
from functools import partial
from pathlib import Path
from typing import Any

from nsdyn.cli.output import one_line, report

# Distribution: module.
PACKAGES = {
    "nsdyn": "nsdyn",
    "numpy": "numpy",
    "scipy": "scipy",
    "numba": "numba",
    "pin": "pinocchio",
    "coal": "coal",
    "qdldl": "qdldl",
    "h5py": "h5py",
    "meshcat": "meshcat",
}


def version_of(distribution: str) -> str | None:
    """Return the version of an installed distribution; for nsdyn also in a source tree."""
    if distribution == "nsdyn":
        from nsdyn import __version__

        return __version__
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return None


def wrong_packages() -> list[str]:
    """Return a line per package that is missing, older or newer than nsdyn needs, or mixed from several places."""
    out = []
    for distribution, module in PACKAGES.items():
        spec = importlib.util.find_spec(module)
        if spec is None or spec.origin is None:
            out.append(f"{distribution} is missing: its module {module} is not found")
        elif distribution != "nsdyn":
            try:
                found = importlib.metadata.distribution(distribution)
            except importlib.metadata.PackageNotFoundError:
                out.append(f"{distribution} is not installed as a package, but {module} is found at {spec.origin}")
                continue
            home = Path(str(found.locate_file(""))).resolve()
            if not Path(spec.origin).resolve().is_relative_to(home):
                out.append(
                    f"{distribution} is mixed: {found.version} is installed in {home}, {spec.origin} is imported"
                )
    try:
        needed = importlib.metadata.requires("nsdyn") or []
    except importlib.metadata.PackageNotFoundError:  # a source tree
        needed = []
    for requirement in needed:
        name, bounds = re.match(r"([\w.-]+)\s*([^;]*)", requirement).groups()  # type: ignore[union-attr]
        version = version_of(name) if "extra" not in requirement else None
        if version and not all(map(partial(_within, version), filter(None, bounds.split(",")))):
            out.append(f"{name} is {version}, {bounds} is needed")
    return out


def _within(version: str, bound: str) -> bool:
    """Return whether a version is within a bound such as ``>=1.26``, ``>=0.1.7.post1`` or ``<5``."""
    sign, limit = re.match(r"\s*([<>=!~]+)\s*(.*)", bound).groups()  # type: ignore[union-attr]
    have, want = ([int(part) for part in re.findall(r"\d+", text)[:4]] for text in (version, limit))
    return {">=": have >= want, ">": have > want, "<": have < want, "<=": have <= want}.get(sign, True)


def diagnose(arguments: argparse.Namespace) -> int:
    """Run ``nsdyn doctor``; return its exit code."""
    from nsdyn.view import browser

    wrong = wrong_packages()
    if arguments.compile and not wrong:
        from nsdyn import compilation

        compilation.compile_all()
    packages: dict[str, Any] = {}
    for distribution, module in PACKAGES.items():
        spec = importlib.util.find_spec(module)  # found, not imported: meshcat would load its server
        packages[distribution] = {"version": version_of(distribution), "file": spec.origin if spec else None}
    cache, none = _cache()
    checks = {name: _outcome(name) for name in CHECKS}
    sound = not wrong and all(c == "ok" for c in checks.values())
    figures: dict[str, Any] = {
        "python": {"version": sys.version.split()[0], "file": sys.executable},
        "packages": packages,
        "chromium": browser.chromium(),
        "cache": cache,
        "checks": checks,
        "wrong": wrong,
        "ok": sound,
    }
    every = {"python": figures["python"], **packages}
    lines = [f"{name:12} {found['version'] or 'MISSING':12} {found['file'] or ''}" for name, found in every.items()]
    absent = "not found; only pictures and films (nsdyn view --png, nsdyn film) need it"
    lines += [f"{'chromium':12} {figures['chromium'] or absent}", f"{'cache':12} {cache or none}"]
    lines += [f"{'wrong':12} {line}" for line in wrong]
    lines += [f"check        {name}: {outcome}" for name, outcome in checks.items()]
    report(arguments, figures, "\n".join(lines))
    return 0 if sound else 1


def _cache() -> tuple[Path | None, str]:
    """Return the folder of the compiled kernels, or None, and the reason if there is none."""
    try:
        from nsdyn._kernels import compiled
    except Exception as error:  # from numba or from a package that it needs
        return None, f"not known: {type(error).__name__}: {one_line(error)}"
    return compiled.folder(), f"none can be written: every start compiles unless {compiled.FOLDER} names a folder"


def _outcome(name: str) -> str:
    """Run a check in a process of its own, which a broken installation may kill, and return its result in words."""
    code = f"import sys; sys.path[:] = {sys.path}; from nsdyn.cli import doctor; doctor.tell({name!r})"
    done = subprocess.run([sys.executable, "-c", code], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, text=True)
    if done.returncode < 0:
        return f"ended by {signal.Signals(-done.returncode).name}"
    return done.stdout.splitlines()[-1] if done.returncode == 0 else f"ended with exit code {done.returncode}"


def tell(name: str) -> None:
    """Run a check and print its result in a line."""
    try:
        print("ok" if CHECKS[name]() else "WRONG RESULT")
    except Exception as error:  # any exception of a broken installation is a result
        print(f"{type(error).__name__}: {one_line(error)}")


def _check_coal() -> bool:
    import numpy as np  # before coal, whose import otherwise ends the process by a signal

    import coal  # isort: skip

    ball, there = coal.Sphere(1.0), coal.Transform3s()
    there.setTranslation(np.array([3.0, 0.0, 0.0]))
    result = coal.DistanceResult()
    distance = coal.distance(ball, coal.Transform3s(), ball, there, coal.DistanceRequest(), result)
    return bool(abs(distance - 1.0) < 1e-6)  # Coal's own tolerance for an iterative distance


def _check_qdldl() -> bool:
    import numpy as np
    import qdldl
    import scipy.sparse as sp

    x = qdldl.Solver(sp.csc_matrix([[4.0, 1.0], [1.0, 3.0]])).solve(np.array([1.0, 2.0]))
    return bool(np.allclose(x, [1 / 11, 7 / 11], rtol=1e-12, atol=0.0))


def _check_contact() -> bool:
    import numpy as np

    import nsdyn

    # A sliding mass of one kilogram: r_N stops its approach, and friction is at its limit mu r_N.
    solution = nsdyn.solve(nsdyn.FC3D(np.eye(3), np.array([-1.0, 2.0, 0.0]), np.array([0.5])))
    return bool(np.allclose(solution.r, [1.0, -0.5, 0.0], rtol=0.0, atol=1e-7))


CHECKS = {
    "coal distance": _check_coal,
    "qdldl solve": _check_qdldl,
    "sliding contact": _check_contact,
}
