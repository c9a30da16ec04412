"""Formulations and solvers of Acary, Brémond and Huber: performance profiles of all variants over a set of problems.

    python demos/papers/page.py coulomb [FOLDER ...]

Every variant runs once on every FCLIB file to the tight tolerance under a limit of processor time; the time at which it
first met each tolerance is noted as its solver measures the iterates. A time includes the measuring.

Reference: V. Acary, M. Brémond, O. Huber, On solving contact problems with Coulomb friction: formulations and numerical
comparisons, 2018.
"""

from __future__ import annotations

import math
import signal
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import nsdyn as nd
from nsdyn.bench.profiles import Profile, Run
from nsdyn.literature._common import Equilibrated
from nsdyn.problem.fc3d import FC3D
from nsdyn.solvers import GaussSeidel, Hybrid, ImpulseNewton, Proximal, relaxed
from nsdyn.tools.arrays import Array

TOLERANCES = 1e-4, 1e-8
"""Of the paper."""

LIMIT = 0.5
"""s of processor time a solve, of which most take milliseconds."""

SMALLEST = 4
"""Contacts: problems with fewer are solved by everything at once and show nothing."""


class Recorded(FC3D):
    """A problem that notes when its measures first fall below each tolerance."""

    def solved(self, r: Array, tol: float) -> tuple[bool, float, float, Array]:
        """As `FC3D.solved`."""
        out = super().solved(r, tol)
        self.measured += 1
        for k, wanted in enumerate(TOLERANCES):
            if self.begin + self.limit > time.thread_time() and out[1] <= wanted and not math.isfinite(self.reached[k]):
                self.reached[k] = time.thread_time() - self.begin
        self.least = min(self.least, out[1])
        if time.thread_time() - self.begin > self.limit:
            raise TimeUp
        return out

    def start(self, limit: float) -> None:
        """Begin to count."""
        self.limit = limit
        self.measured, self.least, self.reached = 0, math.inf, [math.inf] * len(TOLERANCES)
        self.begin = time.thread_time()


class TimeUp(Exception):
    """The limit is reached."""


def _stop(*_: Any) -> None:
    raise TimeUp


@dataclass(frozen=True)
class Relaxed:
    """A solver that starts from the convex relaxation."""

    then: Any
    tol: float = TOLERANCES[-1]

    def __call__(self, problem: FC3D, r0: Array | None = None) -> nd.Solution:
        """Solve the problem."""
        return replace(self.then, tol=self.tol)(problem, relaxed(problem, 1e-4, 300, r0))


def variant(name: str, **options: Any) -> Any:
    return nd.solvers.SOLVERS[name](tol=TOLERANCES[-1], **options)


def groups() -> dict[str, dict[str, Any]]:
    """Figures: {title: {label: solver}}."""
    gs, nsn, ppa = GaussSeidel, ImpulseNewton, Proximal
    tol = TOLERANCES[-1]
    one = {"NSGS-AC": gs(tol), "NSN-AC": nsn(tol, function="alart-curnier"), "PPA-NSN-ad": ppa(tol)}
    maps = {"AC": "alart-curnier", "JM": "jean-moreau", "NM": "natural", "FB": "fischer-burmeister"}
    return {
        "solvers": one
        | {
            "NSGS-VI": gs(tol, local="iterated-projection"),
            "PSOR 1.5": gs(tol, omega=1.5),
            "NSN-AC-GP": nsn(tol, function="alart-curnier", search="goldstein-price"),
            "NSN-FB": nsn(tol),
            "NSN-HYBRID": Hybrid(tol),
            "EG-VI": variant("extragradient"),
            "FP-VI": variant("fixed_point"),
            "TRESCA": variant("tresca"),
            "PANA": variant("panagiotopoulos"),
            "ACLM": variant("aclm"),
        },
        "local": {f"NSGS-{k}": gs(tol, local=v) for k, v in maps.items()}
        | {
            "NSGS-one projection": gs(tol, local="projection"),
            "NSGS-VI": gs(tol, local="iterated-projection"),
            "NSGS-EXACT": gs(tol, local="exact"),
        },
        "local tolerance": {
            f"NSGS-{label} {name}": gs(tol, local=local, local_tol=goal)
            for label, local in (("AC", "alart-curnier"), ("VI", "iterated-projection"))
            for name, goal in (("error/10", None), ("1e-6", 1e-6), ("1e-14", 1e-14))
        },
        "order": {
            f"NSGS-AC {order}": gs(tol, order=order) for order in ("given", "shuffled", "reshuffled", "symmetric")
        },
        "relaxation": {f"PSOR ω = {omega:g}": gs(tol, omega=omega) for omega in (0.5, 0.8, 1.0, 1.2, 1.5, 1.8)},
        "newton": {
            f"NSN-{k}{suffix}": nsn(tol, function=v, search=search)
            for k, v in maps.items()
            for suffix, search in (("", "none"), ("-GP", "goldstein-price"))
        },
        "rho": {
            f"NSN-AC ρ {rule}": nsn(tol, function="alart-curnier", rho=rule)
            for rule in ("spectral", "split", "condition", "one")
        },
        "step rule": {
            f"{label} {rule}": variant(name, rule=rule)
            for label, name in (("FP-VI", "fixed_point"), ("EG-VI", "extragradient"))
            for rule in ("khobotov", "solodov-tseng")
        },
        "proximal": {"PPA-NSN-ad": ppa(tol)}
        | {
            f"PPA σ = {sigma:g}, ν = {nu:g}": ppa(tol, rule="error", alpha=sigma, nu=nu)
            for sigma in (1e-2, 1.0, 1e3)
            for nu in (0.5, 1.0)
        },
        "start": one | {f"{name} from the relaxation": Relaxed(solver) for name, solver in one.items()},
    }


def rank_deficient(problem: FC3D) -> bool:
    """Whether W is singular to ten digits, after equilibration."""
    W = Equilibrated(problem).W.toarray()
    values = np.linalg.eigvalsh(0.5 * (W + W.T))
    return bool(values[0] <= 1e-10 * values[-1])


@dataclass(frozen=True)
class Problem:
    """A problem of the set."""

    name: str
    problem: Recorded
    singular: bool


def load(folders: Sequence[str | Path]) -> list[Problem]:
    """Problems of some folders with at least `SMALLEST` contacts; those of the tests without a folder."""
    given = [Path(f) for f in folders] or [Path(__file__).parents[2] / "tests" / "data"]
    out = []
    for path in (path for folder in given for path in sorted(folder.glob("*.hdf5"))):
        read = nd.fclib.read(path)
        if read.nc >= SMALLEST:
            problem = Recorded(read.W, read.q, read.mu)
            out.append(Problem(path.stem, problem, rank_deficient(problem)))
    if not out:
        raise ValueError(f"folders must hold FCLIB files of {SMALLEST} contacts or more, got {[str(f) for f in given]}")
    return out


def run(solver: Any, problem: Recorded, limit: float) -> None:
    """One solve under the limit; what it reached stays in the problem.

    The limit is one of processor time, seen when the solver measures; an alarm ends those that seldom do.
    """
    signal.signal(signal.SIGALRM, _stop)
    problem.start(limit)
    try:
        signal.setitimer(signal.ITIMER_REAL, max(10.0 * limit, 1.0))
        with np.errstate(all="ignore"):
            solver(problem)
    except (TimeUp, np.linalg.LinAlgError):
        pass
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def measure(
    problems: Sequence[Problem], solvers: dict[str, Any], limit: float, known: dict[str, list[tuple[Run, ...]]]
) -> list[Profile]:
    """A profile for every tolerance; solvers already `known` by their label are not run again."""
    for label, solver in solvers.items():
        if label in known:
            continue
        small = min(problems, key=lambda p: p.problem.nc).problem
        run(solver, small, 100.0)  # compiles
        rows = []
        for entry in problems:
            run(solver, entry.problem, limit)
            p = entry.problem
            rows.append(
                tuple(
                    Run(entry.name, p.nc, label, math.isfinite(t), t, p.measured, p.least, math.nan, "")
                    for t in p.reached
                )
            )
        known[label] = rows
    return [
        Profile(tol, limit, tuple(row[k] for label in solvers for row in known[label]))
        for k, tol in enumerate(TOLERANCES)
    ]


@dataclass(frozen=True)
class Claim:
    """A statement, and the comparison that decides whether it holds on these problems.

    Attributes
    ----------
    words : str
    holds : callable
        Of the profiles by figure: (yes, no, or None where the difference is noise; the numbers).
    paper : bool
        Whether it is a conclusion of the paper, or a question of ours.
    """

    words: str
    holds: Callable[[dict[str, Any]], tuple[bool | None, str]]
    paper: bool = True

    def line(self, found: dict[str, Any]) -> str:
        """Statement, verdict and numbers."""
        holds, numbers = self.holds(found)
        verdicts = ("Agrees", "Does not agree") if self.paper else ("Yes", "No")
        verdict = "Undecided" if holds is None else verdicts[0] if holds else verdicts[1]
        return f"- {'The paper' if self.paper else 'Ours'}: {self.words} **{verdict}** here: {numbers}."


def solved(profile: Profile, label: str, only: Sequence[str] | None = None) -> int:
    """Problems that a variant solves, of those named."""
    column = np.isfinite(profile.times[:, profile.solvers.index(label)])
    keep = np.array([only is None or name in only for name in profile.problems])
    return int(column[keep].sum())


def faster(profile: Profile, a: str, b: str) -> float:
    """Geometric mean of the time of a over that of b where both solve."""
    i, j = profile.solvers.index(a), profile.solvers.index(b)
    both = np.isfinite(profile.times[:, i]) & np.isfinite(profile.times[:, j])
    return float(np.exp(np.log(profile.times[both, i] / profile.times[both, j]).mean())) if both.any() else math.nan


def claims(problems: Sequence[Problem]) -> dict[str, list[Claim]]:
    """The paper's conclusions by figure."""
    regular = [p.name for p in problems if not p.singular]
    singular = [p.name for p in problems if p.singular]

    def universal(f: dict[str, Any]) -> tuple[bool, str]:
        tight = f["solvers"][1]
        best = max(tight.solvers, key=lambda s: solved(tight, s))
        fastest = tight.solvers[int(np.argmax(tight.rho(1.0)))]
        words = (
            f"{best} solves {solved(tight, best)} of {len(tight.problems)}, {fastest} is the fastest most often "
            f"(ρ(1) = {tight.rho(1.0).max():.2f})"
        )
        return solved(tight, best) < len(tight.problems) or best != fastest, words

    def share(profile: Profile, label: str, only: list[str]) -> float:
        return solved(profile, label, only) / max(len(only), 1)

    def rank(f: dict[str, Any]) -> tuple[bool, str]:
        tight = f["solvers"][1]
        a, b = (share(tight, "NSN-AC", names) for names in (regular, singular))
        return (
            a > b,
            f"NSN-AC solves {a:.0%} of the {len(regular)} of full rank and {b:.0%} of the {len(singular)} others",
        )

    def loose(f: dict[str, Any]) -> tuple[bool, str]:
        p = f["solvers"][0]
        n = {s: solved(p, s) for s in ("NSGS-AC", "NSN-AC", "EG-VI", "PPA-NSN-ad")}
        return n["NSGS-AC"] == max(n.values()), f"at 1e-4: {n}".replace("'", "")

    def tight(f: dict[str, Any]) -> tuple[bool, str]:
        p = f["solvers"][1]
        n = {s: solved(p, s, singular) for s in p.solvers}
        top = sorted(n, key=lambda s: -n[s])[:4]
        return n["PPA-NSN-ad"] == max(n.values()), ", ".join(f"{s} {n[s]}" for s in dict.fromkeys([*top, "PPA-NSN-ad"]))

    def more(group: str, better: str, worse: str) -> Callable[[dict[str, Any]], tuple[bool | None, str]]:
        def holds(f: dict[str, Any]) -> tuple[bool | None, str]:
            p = f[group][1]
            a, b, ratio = solved(p, better), solved(p, worse), faster(p, better, worse)
            words = f"{better} solves {a}, {worse} {b} of {len(p.problems)} at {p.tol:g}; time ratio {ratio:.2f}"
            # One problem more or less, at the limit, and a fifth of the time are what two runs differ by.
            if abs(a - b) > 1:
                return a > b, words
            return (None if 0.8 <= ratio <= 1.25 else ratio < 0.8), words

        return holds

    def relaxations(f: dict[str, Any]) -> tuple[bool, str]:
        p = f["relaxation"][1]
        n = {s: solved(p, s) for s in p.solvers}
        ratio = faster(p, "PSOR ω = 1.2", "PSOR ω = 1")
        words = ", ".join(f"{s[5:]}: {k}" for s, k in n.items()) + f"; ω = 1.2 takes {ratio:.2f} of the time of ω = 1"
        return ratio < 1.0 and n["PSOR ω = 1.8"] < n["PSOR ω = 1"], words

    return {
        "solvers": [
            Claim("There is no universal solver.", universal),
            Claim("The rank of W decides over Newton (NSN).", rank),
            Claim("Rigid bodies at a loose tolerance: NSGS is the most robust.", loose),
            Claim("Rank-deficient W at a tight tolerance: PPA-NSN with adaptive α is the most robust.", tight),
        ],
        "relaxation": [Claim("Over-relaxation is faster, and fragile.", relaxations)],
    } | {
        group: [Claim(words, more(group, better, worse), paper) for words, better, worse, paper in compared]
        for group, compared in COMPARED.items()
    }  # fmt: skip


COMPARED = {
    "local": [
        ("The exact local solver behaves poorly beside Newton's.", "NSGS-AC", "NSGS-EXACT", True),
        ("Iterating the projection beats one projection.", "NSGS-VI", "NSGS-one projection", False),
    ],
    "local tolerance": [
        (
            "A local tolerance that follows the error is faster than a fixed tight one.",
            "NSGS-VI error/10", "NSGS-VI 1e-14", False,
        ),
    ],
    "order": [("Reshuffling harms rigid bodies.", "NSGS-AC given", "NSGS-AC reshuffled", True)],
    "newton": [
        ("A line search (Goldstein–Price) makes NSN-AC more robust.", "NSN-AC-GP", "NSN-AC", False),
        ("Alart–Curnier is the best of the equations.", "NSN-AC", "NSN-FB", False),
    ],
    "rho": [
        (
            "ρ_N = 1/W_NN with ρ_T = 1/λ_max(W_TT) is the rule to take, beside one ρ = 1/λ_max(W_cc).",
            "NSN-AC ρ split", "NSN-AC ρ spectral", True,
        ),
        ("ρ = 1 fails dramatically.", "NSN-AC ρ split", "NSN-AC ρ one", True),
        ("ρ_T = λ_min/λ_max² is usually better than 1/λ_max.", "NSN-AC ρ condition", "NSN-AC ρ split", True),
    ],
    "step rule": [
        ("EG-VI is more robust than FP-VI.", "EG-VI khobotov", "FP-VI khobotov", False),
        ("Khobotov's rule beats Solodov–Tseng's.", "EG-VI khobotov", "EG-VI solodov-tseng", False),
    ],
    "proximal": [
        ("The adaptive rule is more robust than a large σ.", "PPA-NSN-ad", "PPA σ = 1000, ν = 1", True),
        ("The adaptive rule is also more robust than σ = 1, ν = 1.", "PPA-NSN-ad", "PPA σ = 1, ν = 1", False),
    ],
    "start": [
        ("The convex relaxation helps Newton's start.", "NSN-AC from the relaxation", "NSN-AC", False),
    ],
}  # fmt: skip
"""By figure: that one variant is better than another, in words, those two, and whether it is the paper's claim."""

TITLES = {
    "solvers": "Families of solvers",
    "local": "Local solvers of block Gauss–Seidel",
    "local tolerance": "Tolerance of the local solver",
    "order": "Order of the contacts",
    "relaxation": "Under- and over-relaxation",
    "newton": "Equation and line search of Newton's method",
    "rho": "Rules for ρ",
    "step rule": "Rules for the step of the projections",
    "proximal": "Rules for α of the proximal point algorithm",
    "start": "Start from the convex relaxation (shift 0)",
}


def report(folders: Sequence[str | Path], pictures: Path, limit: float = LIMIT, progress: bool = False) -> str:
    """Run everything, draw the figures, and return the section of the page."""
    from matplotlib.figure import Figure

    problems = load(folders)
    found: dict[str, list[Profile]] = {}
    known: dict[str, list[tuple[Run, ...]]] = {}
    for title, solvers in groups().items():
        found[title] = measure(problems, solvers, limit, known)
        if progress:
            print(title, *(f"\n{p.table()}" for p in found[title]), flush=True)
    contacts = [p.problem.nc for p in problems]
    lines = [
        "## Formulations and solvers (Acary, Brémond, Huber)",
        "",
        f"{len(problems)} problems of {min(contacts)} to {max(contacts)} contacts, {sum(p.singular for p in problems)} "
        f"with a rank-deficient W; {limit:g} s of processor time a solve. A solver meets a tolerance when `FC3D.error`,"
        " the measure of the paper, is within it. Each figure: fraction of the problems solved within τ times the best "
        "time; the time ratios below are geometric means where both solve. Rigid bodies throughout: the conclusions on "
        "elastic ones (Newton wins, ω < 1 and reshuffling help) are not decided here.",
        "",
    ]
    decided = claims(problems)
    for title, profiles in found.items():
        figure = Figure(figsize=(12, 3.6), layout="constrained")
        axes = figure.subplots(1, len(profiles))
        for ax, profile in zip(axes, profiles, strict=True):
            profile.plot(ax, legend=profile is profiles[-1])
        name = f"profile_{title.replace(' ', '_')}.png"
        figure.savefig(pictures / name, dpi=80)
        lines += [f"### {TITLES[title]}", "", f"![{TITLES[title]}](../{pictures.name}/{name})", ""]
        lines += [claim.line(found) for claim in decided[title]]
        lines += ["", "```", *(f"tol {p.tol:g}\n{p.table()}" for p in profiles), "```", ""]
    return "\n".join(lines)
