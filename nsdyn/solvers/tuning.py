"""What the portfolio was tuned to, in one place."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["TUNING", "Tuning"]


@dataclass(frozen=True)
class Tuning:
    """Constants of `auto.Auto`, and what each of them trades.

    Efforts are counted in factorisations or in seconds by counts of operations (`means`), so that results do not depend
    on the machine.
    """

    # Accuracy

    margin: float = 0.9
    """Fraction of the tolerance that the islands share, so that what the judge measures of all together stays below."""

    polish: float = 1e-5
    """Fraction of the tolerance to which islands are solved where Newton reaches it: what is left of a sticking
    contact's velocity is a creep that a long simulation adds up, and the impulses times what is left of all velocities
    is the gap that certifies the step."""

    floor: float = 1e-14
    """Round-off in m/s, below which `polish` does not go."""

    finish: int = 3
    """Newton steps of the polish."""

    # What kind of problem it is

    dense: int = 100
    """Contacts up to which an island given by W alone is solved densely, all such islands in one kernel call."""

    heavy: float = 4.0
    """A large island whose factorisation costs more sweeps than this begins with sweeps."""

    abrupt: float = 10.0
    """Misfit of a warm start, in loose tolerances, that tells a collision from rest and smooth motion unless Newton
    gains at once."""

    hopeless: float = 100.0
    """The same from which on a large island is not even asked, since that costs as much as 80 sweeps."""

    rest: float = 0.1
    """The same that tells rest: what is left there lasts, and is worth `calm_at_rest`."""

    # Small islands

    small: tuple[float, int] = (1e2, 40)
    """Penalty and steps of Newton on islands of few bodies, from any start: of cold ones of up to 120 coordinates in
    eleven named scenes it solves 96 to 100 %, in the time of the sweeps that it spares."""

    quick: int = 10
    """Contacts up to which, where W alone is given, five sweeps and as many steps of Newton come before more sweeps: a
    step costs more than a sweep beyond."""

    # Bounds on all effort

    free: int = 100
    """Factorisations that an island may take in any case, unless it is large: what both cold starts cost."""

    longest: tuple[int, int] = (1000, 4000)
    """Factorisations that none may exceed, about ten times what paths of hard problems take; and where nothing looser
    than `coarse` is accepted, where one in ten comes to its end between them."""

    calm: int = 12
    """Factorisations that an island may take in motion, but in a collision. A large one has those of its warm start
    only: where they do not suffice more do not either."""

    calm_at_rest: int = 100
    """The same at rest."""

    # Warm start

    warm: tuple[float, int] = (1e2, 6)
    """Penalty and steps of Newton from a warm start."""

    peek: int = 2
    """Steps after which a warm start that misses by far must have gained `gain`."""

    gain: float = 0.1
    """Measure after these, over that before, of a warm start that is not of a collision."""

    # Cold starts

    sweeps: int = 400
    """Accelerated Gauss–Seidel sweeps of a cold start, which cost about as much as the interior point method."""

    patience: int = 20
    """Their number from which on it is foreseen whether they suffice."""

    interior: tuple[int, int] = (40, 30)
    """Factorisations of the interior point method, which converges within these where it does, and of Newton after."""

    path: tuple[int, int] = (60, 500)
    """Fewest factorisations worth beginning a continuation from nothing with, which takes 20 to 400 for most problems,
    and most."""

    near: float = 1e3
    """Penalty of Newton from what was found by factorisations."""

    # Sweeps with momentum and Newton in turn

    far: float = 10.0
    """Penalty of Newton from what was found by sweeps, on the wrong side of many kinks."""

    coarse: float = 5e-5
    """What sweeps may be asked for: beyond it they crawl, m/s; and what Newton may follow on a method from nothing."""

    first_sweep: int = 30
    """What sweeps take in the first round, in factorisations; twice as long each time, but where they are stuck."""

    first_newton: int = 4
    """What Newton takes in the first round; twice as long each time."""

    from_loose: int = 40
    """What Newton takes from the loose tolerance, before anything begins from nothing."""

    creep: tuple[float, int] = (100.0, 300)
    """What Newton gains at best where it creeps along folds of a collision from `coarse` on, and its steps there: half
    of the time of a path from nothing, to a strict tolerance no finer than that."""

    rounds: int = 8
    """Number of rounds."""

    stuck: tuple[float, int] = (0.5, 3)
    """Measure after sweeps, over that before, from which on they are stuck, and how often before a continuation begins:
    by then as much has been spent as the shortest take."""

    idle: int = 2000
    """Sweeps without gain that are stuck."""

    onward: tuple[float, int] = (100.0, 150)
    """Smoothing, over what the best misses, of a path that begins there, and its factorisations at most: such paths
    take 70 in piles of spheres, where those from nothing take 115, or fail."""

    restart: float = 0.5
    """Sweeps lose their momentum and go on from what Newton found only where that is so much better."""

    # Last resorts

    last_sweep: int = 160
    """What sweeps take in the last rounds, in factorisations."""

    last_newton: int = 1000
    """What Newton takes in the first of these, where it creeps along folds and is not interrupted soon; twice as long
    each time."""

    last_rounds: int = 4
    """Number of last rounds."""

    impulse_steps: int = 60
    """Newton steps in the impulses: where they converge they do so within these."""

    impulse_cost: float = 1.3e-10
    """Seconds of one over the cube of its rows."""

    def sharp(self, tol: float) -> float:
        """The tolerance of the polish of a problem."""
        return max(self.polish * tol, self.floor)


TUNING = Tuning()
