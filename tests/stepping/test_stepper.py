"""The stepper itself: resuming, callbacks, failures, arguments, the ledger and the certificate."""

import copy
import pickle
import traceback
import warnings
from functools import partial

import numpy as np
import pytest

import nsdyn as nd
from nsdyn.collision.contacts import ContactSet
from nsdyn.dynamics.dynamics import Dynamics
from nsdyn.dynamics.values import Placement
from nsdyn.stepping import active_set, failures


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow if n in ("kapla", "peg") else []) for n in nd.scenes.names()]
)
def test_ledger_closes_on_every_named_scene(name):
    setup = nd.scenes.setup(name)
    trajectory = nd.simulate(setup.scene, 60 * setup.dt, **setup.options())
    energy = trajectory.energy
    largest = max(np.abs(getattr(energy, term)).max() for term in energy.names if term != "defect")
    assert np.abs(energy.defect).max() <= 1e-12 * largest
    works = [term for term in energy.names if term not in ("kinetic", "potential")]
    total = energy.kinetic + energy.potential
    # The same sum over all steps; 60 additions of numbers as large as the potential energy.
    change = sum(getattr(energy, term).sum() for term in works)
    assert total[-1] - total[0] == pytest.approx(change, abs=1e-12 * max(largest, 1e-3))
    # No position of the squeezed peg is without overlap, and the status of each of its steps says so.
    expected = [nd.Status.OVERLAP] if name == "peg" else [nd.Status.CONVERGED]
    if name == "rod":  # which jams
        expected += [nd.Status.JAM]
    if name == "pile":  # whose bodies collide
        expected += [nd.Status.LOOSE]
    assert np.isin(trajectory.solver.status, expected).all()


def test_contact_works_add_up_and_friction_only_dissipates():
    trajectory = nd.simulate(nd.scenes.load("slide")(), 0.5, dt=1e-3)
    for k in (1, 200, 408, 450):
        contacts, energy = trajectory.contacts(k), trajectory.energy
        assert contacts.work_friction.sum() == pytest.approx(energy.friction[k - 1], abs=1e-18)
        # Normal work of contacts that stay closed is booked as the step's own; on a plane it is round-off.
        booked = energy.normal[k - 1], energy.integration[k - 1]
        assert contacts.work_normal.sum() == pytest.approx(sum(booked), abs=1e-18)
        assert np.abs(booked).max() <= 1e-15
    assert trajectory.energy.friction.max() <= 1e-15
    # All kinetic energy, m v²/2 = 2 J, goes into friction.
    assert trajectory.energy.friction.sum() == pytest.approx(-2.0, abs=1e-6)
    # The cone is round: dissipation is -mu r_N |u_T|, the most that any impulse in the cone can take.
    contacts = trajectory.contacts(100)
    slip = np.hypot(contacts.u[:, 1], contacts.u[:, 2])
    taken = -(contacts.impulse[:, 1:] * contacts.u[:, 1:]).sum(axis=1)
    np.testing.assert_allclose(taken, contacts.mu * contacts.impulse[:, 0] * slip, rtol=1e-9)


def test_theta_one_loses_energy_in_the_ledger():
    scene = nd.Scene()
    scene.add_sphere("ball", 0.1, 2.0, position=(0, 0, 5))
    trajectory = nd.simulate(scene, 0.1, dt=1e-2, theta=1.0)
    # W_theta = -h (theta - 1/2) m g·dv = -(1/2) m g² h² per step.
    np.testing.assert_allclose(trajectory.energy.integration, -0.5 * 2.0 * 9.81**2 * 1e-4, rtol=1e-9)
    assert np.abs(trajectory.energy.defect).max() < 1e-13


def test_resuming_is_bit_exact():
    """From the middle of a landing, warm start and contact keys included, in a fresh stepper."""
    make = lambda: nd.Stepper(nd.scenes.load("pile")(boxes=4, spheres=4), dt=5e-3)  # noqa: E731
    first = make()
    for _ in range(70):
        first.step()
    state = first.get_state()
    expected = [first.step() for _ in range(20)]
    second = make()
    second.set_state(state)
    for step in expected:
        other = second.step()
        assert other.t == step.t
        assert other.q.tobytes() == step.q.tobytes() and other.v.tobytes() == step.v.tobytes()
        assert other.r.tobytes() == step.r.tobytes() and (other.contacts.key == step.contacts.key).all()


def test_state_of_another_scene_is_refused():
    stepper = nd.Stepper(nd.scenes.load("stack")(height=2))
    with pytest.raises(ValueError, match="state must have 12 velocities"):
        stepper.set_state(nd.Stepper(nd.scenes.load("slide")()).get_state())
    with pytest.raises(ValueError, match="state must come from get_state"):
        stepper.set_state(None)
    # As many velocities, but a body that is driven; or the same bodies, without that on which one stands.
    boxes = [nd.Scene() for _ in range(3)]
    for scene in boxes:
        scene.add_box("box", (0.2, 0.2, 0.2), 1.0, position=(0, 0, 0.1))
    for scene in boxes[:2]:
        scene.add_box("plate", (1, 1, 0.1), fixed=True, position=(0, 0, -0.05))
    boxes[0].set_motion("plate", velocity=(0.1, 0, 0))
    driven, fixed, alone = map(nd.Stepper, boxes)
    for one, other in ((driven, fixed), (fixed, driven), (alone, fixed)):
        with pytest.raises(ValueError, match="its bodies, joints or shapes are others"):
            one.set_state(other.get_state())


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"dt": 0.0}, "dt must be a positive"),
        ({"dt": -1e-3}, "dt must be a positive"),
        ({"dt": float("nan")}, "dt must be a positive"),
        ({"duration": 0.0}, "duration must be a positive"),
        ({"duration": float("inf")}, "duration must be a positive"),
        ({"duration": 1e300}, "duration must be fewer than 9.007e.15 steps of dt = "),
        ({"theta": 0.4}, r"theta must lie in \[0.5, 1\]"),
        ({"theta": 1.1}, r"theta must lie in \[0.5, 1\]"),
        ({"theta": "a"}, r"theta must lie in \[0.5, 1\], got 'a'"),
        ({"dt": True}, "dt must be a positive number of seconds, got True"),
        ({"duration": True}, "duration must be a positive number of seconds, got True"),
        ({"contacts": "no"}, "contacts must be True or False, got 'no'"),
        ({"progress": "no"}, "progress must be True or False, got 'no'"),
        ({"record": 3}, "record must be a path, got 3"),
        ({"resume": 3}, "resume must be a path, got 3"),
        ({"on_fail": "shrug"}, "on_fail must be"),
        ({"max_points": 2}, "max_points"),
        ({"controller": np.eye(2)}, r"controller must be a function of \(t, q, v\)"),
        ({"external_force": ""}, r"external_force must be a function of \(t, q, v\)"),
    ],
)
def test_bad_arguments_write_nothing(arguments, words, tmp_path):
    path = tmp_path / "run.h5"
    with pytest.raises(ValueError, match=words):
        nd.simulate(nd.scenes.load("slide")(), **({"duration": 0.1, "record": path} | arguments))
    assert not path.exists()


def test_numbers_of_numpy_are_numbers(tmp_path):
    given = {"duration": 1.0, "dt": 0.125, "theta": 0.5, "every": 2, "max_points": 6, "overlap": 0.0}
    theirs = {name: np.int64(x) if isinstance(x, int) else np.float32(x) for name, x in given.items()}
    runs = [nd.simulate(nd.scenes.load("slide")(), **options) for options in (given, theirs)]
    runs[1].save(tmp_path / "run.h5")
    assert (runs[0].q == nd.Trajectory.load(tmp_path / "run.h5").q).all()


def test_failure_raises_warns_or_is_recorded(tmp_path):
    scene = nd.scenes.load("stack")(height=4)
    lazy = nd.solvers.PGS(tol=1e-12, max_iter=1, memory=0)
    for on_fail in ("raise", "warn"):  # after one sweep from nothing the error is 0.5, which is no answer
        with pytest.raises(nd.NotConverged, match="did not converge") as caught:
            nd.simulate(scene, 0.1, dt=1e-2, solver=lazy, on_fail=on_fail)
        assert caught.value.problem.nc >= 16 and caught.value.solution.iterations == 1
    nd.simulate(scene, 0.02, dt=1e-2, solver=lazy, on_fail="ignore")
    lazy = nd.solvers.PGS(tol=1e-300, max_iter=200)
    with pytest.warns(UserWarning, match="did not converge") as warned:
        trajectory = nd.simulate(scene, 0.1, dt=1e-2, solver=lazy)
    assert len(warned) == 1, "one warning a run"
    assert (trajectory.solver.status == nd.Status.MAX_ITERATIONS).any()
    assert trajectory.steps == 10


def test_steps_that_miss_their_tolerance_are_written(tmp_path, monkeypatch):
    """The file holds the step's problem and its answer: the error that was recorded, and a problem that is solved."""
    monkeypatch.chdir(tmp_path)
    scene, lazy = nd.scenes.load("stack")(height=4), nd.solvers.PGS(tol=1e-300, max_iter=200)
    with pytest.warns(
        UserWarning, match=r"step 1 .* worst between .*; its problem is in failed-steps/step-000001\.hdf5"
    ):
        trajectory = nd.simulate(scene, 0.03, dt=1e-2, solver=lazy, on_fail="dump")
    missed = np.flatnonzero(trajectory.solver.status == nd.Status.MAX_ITERATIONS)
    written = sorted((tmp_path / "failed-steps").iterdir())
    assert missed.size and [path.stem for path in written] == [f"step-{k + 1:06d}" for k in missed]
    for k, path in zip(missed, written, strict=True):
        problem, (answer,) = nd.fclib.read(path), nd.fclib.read_guesses(path)
        # round-off of impulses of 0.4 N·s over that of velocities of 0.2 m/s
        assert problem.error(answer.r) == pytest.approx(trajectory.solver.error[k], abs=1e-14)
        assert nd.solve(problem, r0=answer.r).converged


def test_failure_says_where_and_can_be_sent():
    """Another process may be told what failed, where, and with which bodies."""
    stepper = nd.Stepper(
        nd.scenes.load("stack")(height=4), dt=1e-2, solver=nd.solvers.PGS(tol=1e-12, max_iter=1, memory=0)
    )
    with pytest.raises(nd.NotConverged, match=r"worst between '.*' and '.*'.*try a smaller dt") as caught:
        for _ in range(2):
            stepper.step()
    failure = pickle.loads(pickle.dumps(caught.value))
    assert failure.step == 1 and str(failure) == str(caught.value)
    assert failure.solution.error == caught.value.solution.error > 1e-3
    assert failure.problem.nc >= 16 and failure.state.t == stepper.t


def test_the_worst_of_a_step_is_recorded():
    """A problem that missed even the loose tolerance beside one of a larger error that is within it."""
    problem = nd.FC3D(np.eye(3), np.array([-1.0, 0.0, 0.0]), [0.5])
    exact = nd.solve(problem)

    def solved(status, error):
        return problem, exact._replace(status=status, error=error)

    loose, stalled = solved(nd.Status.LOOSE, 9e-5), solved(nd.Status.STALLED, 2e-6)
    assert failures.worst([solved(nd.Status.CONVERGED, 1e-9), stalled, loose]) == 1
    assert failures.worst([loose, stalled, solved(nd.Status.NO_SLATER_POINT, 1e-7)]) == 2
    assert failures.worst([solved(nd.Status.CONVERGED, 2e-9), solved(nd.Status.CONVERGED, 1e-9)]) == 1


def test_what_is_no_answer_stops_a_run(tmp_path):
    """One sweep from nothing over a tall stack is far from any solution; what was simulated before is kept."""
    scene, path = nd.scenes.load("stack")(height=30), tmp_path / "run.h5"
    hasty = nd.solvers.PGS(tol=1e-12, max_iter=1, memory=0)
    with pytest.raises(nd.NotConverged, match="did not converge"):
        nd.simulate(scene, 0.1, dt=1e-2, solver=hasty, record=path)
    assert nd.Trajectory.load(path).steps == 0


def test_failed_step_leaves_the_state():
    stepper = nd.Stepper(
        nd.scenes.load("stack")(height=4),
        dt=1e-2,
        solver=nd.solvers.PGS(tol=1e-12, max_iter=1, memory=0),
        on_fail="raise",
    )
    before = stepper.get_state()
    with pytest.raises(nd.NotConverged):
        stepper.step()
    assert stepper.get_state() is before


@pytest.mark.parametrize("theta", [0.5, 1.0])
def test_a_load_has_its_work_in_the_column_that_it_says(theta, monkeypatch):
    """One body flies, one slides, one bounces as an island by itself: of each of them, to the last bit."""
    scene = nd.Scene()
    scene.add_halfspace("ground", material=nd.Material(mu=0.4, restitution=0.3))
    scene.add_box("box", (0.2, 0.2, 0.2), 1.0, position=(0, 0, 0.3), linear_velocity=(2, 0, 0))
    scene.add_sphere("ball", 0.1, 1.0, position=(1, 0, 0.1), linear_velocity=(0, 1, 0))
    scene.add_sphere("far", 0.1, 1.0, position=(9, 0, 8), angular_velocity=(0, 2, 1))

    def push(t, q, v):
        return {"box": (3.0 * np.cos(7.0 * t), 0, 0), "ball": -0.5 * v[6:9], "far": ((0, 0, 1.0), (0.1, 0, 0))}

    run = nd.simulate(scene, 0.5, dt=1e-2, theta=theta, external_force=push)
    said = Dynamics.wrenches

    def otherwise(*given):
        loads, applied = said(*given)
        return {"damping": loads["external"]}, applied

    monkeypatch.setattr(Dynamics, "wrenches", otherwise)
    other = nd.simulate(scene, 0.5, dt=1e-2, theta=theta, external_force=push)
    assert other.q.tobytes() == run.q.tobytes() and run.energy.external.all() and not other.energy.external.any()
    assert other.energy.damping.tobytes() == run.energy.external.tobytes() and not run.energy.damping.any()


def test_external_force_and_its_work():
    """Twice the friction limit pulls a block: a = F/m - mu g, W = F x."""
    pull = 2 * 0.5 * 9.81
    trajectory = nd.simulate(
        nd.scenes.load("slide")(speed=0.0), 1.0, dt=1e-2, external_force=lambda t, q, v: {"box": (pull, 0, 0)}
    )
    x = trajectory.body("box").position[-1, 0]
    # The force acts at the centre, so the block tips a little on its front edge without leaving the ground.
    assert x == pytest.approx(0.5 * 0.5 * 9.81, abs=1e-9)
    assert trajectory.energy.external.sum() == pytest.approx(pull * x, rel=1e-12)


def test_torque_and_controller():
    scene = nd.Scene(gravity=(0, 0, 0))
    scene.add_box("b", (0.1, 0.1, 0.1), 6.0, quaternion=(0, 0, np.sqrt(0.5), np.sqrt(0.5)))
    scene.add_urdf("arm", nd.scenes.folder() / "arm.urdf", position=(3, 0, 0))
    trajectory = nd.simulate(
        scene,
        0.1,
        dt=1e-2,
        external_force=lambda t, q, v: {"b": ((0, 0, 0), (0.02, 0, 0))},
        controller=lambda t, q, v: {"arm": [0.5, 0.0]},
    )
    # J = m a²/6 = 0.01: w = 0.02/0.01 * 0.1 about the world's x axis.
    np.testing.assert_allclose(trajectory.body("b").angular_velocity[-1], (0.2, 0, 0), rtol=0, atol=1e-14)
    kinetic = trajectory.energy.kinetic[-1]
    assert trajectory.energy.external.sum() == pytest.approx(kinetic, rel=1e-4)
    assert np.abs(trajectory.energy.defect).max() < 1e-16
    assert abs(trajectory.v[-1, 6]) > 0.01, "the arm turns"


@pytest.mark.parametrize("drag", [0.0, 1.0])
def test_callbacks_are_called_twice_a_step(drag):
    """Where the forces act, at v⁻ and at ½ (v⁻ + v⁺); where they do not depend on v the second call changes nothing."""
    seen, solved = [], []

    class Counting(nd.solvers.PGS):
        def __call__(self, problem, guess=None):
            solved.append(problem)
            return super().__call__(problem, guess)

    def push(t, q, v):
        seen.append((t, q[0], v[0]))
        return {"box": (-drag * v[0], 0.0, 0.0)}

    stepper = nd.Stepper(nd.scenes.load("slide")(), 0.01, solver=Counting(tol=1e-12), external_force=push)
    before = stepper.step().v[0]
    seen.clear(), solved.clear()
    after, free = stepper.step().v[0], before - 0.5 * 9.81 * 0.01
    assert len(solved) == (2 if drag else 1)
    (t, x, v), (t_again, x_again, v_again) = seen
    assert t == t_again == pytest.approx(0.015, rel=1e-15) and x == x_again
    means = before, 0.5 * (before + free - 0.01 * drag * before)
    np.testing.assert_allclose((v, v_again), means, rtol=0, atol=1e-12)
    assert after == pytest.approx(free - 0.01 * drag * v_again, rel=0, abs=1e-12)


@pytest.mark.parametrize(
    ("callback", "words"),
    [
        ({"external_force": lambda t, q, v: {"ghost": (0, 0, 1)}}, "body of external_force must be .*; got 'ghost'"),
        ({"external_force": lambda t, q, v: {"arm": (0, 0, 1)}}, "got 'arm'"),
        (
            {"external_force": lambda t, q, v: {"arm/leg": (0, 0, 1)}},
            "must be one of box, arm/shoulder, .*; got 'arm/leg'",
        ),
        ({"external_force": lambda t, q, v: {"box": "up"}}, "external_force on 'box' must be finite .* got 'up'"),
        ({"external_force": lambda t, q, v: 5}, "external_force must return a mapping of names, got 5"),
        ({"controller": lambda t, q, v: np.zeros(2)}, "controller must return a mapping of names"),
        ({"external_force": lambda t, q, v: {"box": (0, 1)}}, "external_force on 'box'"),
        ({"external_force": lambda t, q, v: {"box": (0, 0, np.nan)}}, "external_force on 'box'"),
        ({"external_force": lambda t, q, v: {"box": np.array((1j, 0, 0))}}, "external_force on 'box'"),
        (
            {"external_force": lambda t, q, v: {"box": np.ma.array(np.ones(6), mask=[1, 0, 0, 0, 0, 0])}},
            "external_force on .box",
        ),
        ({"external_force": lambda t, q, v: {"box": [np.complex128(1j), 0, 0]}}, "external_force on 'box'"),
        (
            {"controller": lambda t, q, v: {"arm": [1.0]}},
            "joint forces of controller of 'arm' must be .* or 2 numbers, .*, got shape",
        ),
        (
            {"controller": lambda t, q, v: {"leg": [1.0, 0.0]}},
            "articulation of controller must be one of arm; got 'leg'",
        ),
        ({"controller": lambda t, q, v: None}, "controller must return a mapping of names, got None"),
        ({"external_force": lambda t, q, v: None}, "external_force must return a mapping of names, got None"),
        (
            {"controller": lambda t, q, v: {"arm": None}},
            "joint forces of controller of 'arm' must be finite: .*, got None",
        ),
        ({"controller": lambda t, q, v: {"amr": [1.0, 0.0]}}, "did you mean 'arm'"),
        ({"external_force": lambda t, q, v: {1: (0, 1, 0)}}, "body of external_force must be one of .*; got 1"),
    ],
)
def test_bad_callbacks(callback, words):
    """Each is told with its file and line first, and the step that calls it in a note; nothing is kept of the step."""
    stepper = nd.Stepper(nd.scenes.load("arm_pushes_box")(), **callback)
    (function,) = callback.values()
    state = stepper.get_state()
    with pytest.raises(ValueError, match=words) as refused:
        stepper.step()
    here = f"test_stepper.py, line {function.__code__.co_firstlineno}: "
    assert str(refused.value).startswith(here) and refused.value.__notes__ == ["in step 1 from t = 0 s"]
    assert stepper.get_state() is state


def test_an_exception_in_a_callback_shows_its_line():
    """Its type stays; the traceback ends in the user's lines, with two of ours above; the note tells where and when."""

    def deep(t):
        return 1.0 / (0.02 - t) if t < 0.02 else [][1]

    def push(t, q, v):
        return {"box": (0.0 * deep(t), 0.0, 0.0)}

    with pytest.raises(IndexError) as failure:
        nd.simulate(nd.scenes.load("slide")(), 0.1, dt=0.01, external_force=push)
    frames = traceback.extract_tb(failure.tb)
    assert [frame.name for frame in frames[1:]] == ["simulate", "called", "push", "deep"]
    line = deep.__code__.co_firstlineno + 1
    assert failure.value.__notes__ == [
        f"test_stepper.py, line {line}: in external_force",
        "in step 3 from t = 0.02 s",
    ]
    assert "".join(traceback.format_exception(failure.value)).count("During handling") == 0


class Push:
    def __call__(self, t, q):
        return {}


def test_what_is_no_plain_function_has_a_place_too():
    """That of its class, of the function in a partial; a built-in one is named."""
    line = Push.__call__.__code__.co_firstlineno
    for push, place in ((Push(), line), (partial(Push(), q=3), line), (abs, None)):
        with pytest.raises(ValueError, match="external_force must be a function of") as failure:
            nd.Stepper(nd.scenes.load("slide")(), external_force=push)
        where = f"test_stepper.py, line {place}" if place else "<built-in function abs>"
        assert str(failure.value).startswith(f"{where}: ")


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (None, r"must be finite with shape \(3,\) or \(2, 3\), got None at t = "),
        ((0.0, np.nan, 0.0), "must be finite with shape"),
        ((0.0, 1.0), "must be finite with shape"),
        ("fast", "must be finite with shape .*, got 'fast'"),
    ],
)
def test_bad_velocities(given, words):
    """Of a function from t = 0.05 s on, and at once where it is wrong at t = 0."""

    def scene(begin):
        out = nd.Scene()
        out.add_box("belt", (1, 1, 0.1), fixed=True, position=(0, 0, -0.05))
        out.add_sphere("ball", 0.1, 1.0, position=(0, 0, 0.1))
        out.set_motion("belt", surface_velocity=lambda t: given if t > begin else (0.1, 0, 0))
        return out

    here = rf"test_stepper\.py, line \d+: velocity of 'belt' {words}"
    with pytest.raises(ValueError, match=here):
        scene(-1.0)
    with pytest.raises(ValueError, match=here) as refused:
        nd.simulate(scene(0.05), 0.1, dt=0.01)
    assert refused.value.__notes__[0].startswith("in step 6 from t = 0.05")


def test_callbacks_must_be_functions():
    for what in ("controller", "external_force"):
        with pytest.raises(ValueError, match=f"{what} must be a function of"):
            nd.Stepper(nd.scenes.load("slide")(), **{what: 3})


@pytest.mark.parametrize("what", ["controller", "external_force"])
@pytest.mark.parametrize(
    ("function", "own"),
    [
        (lambda a, b, c, d, e: {}, "(a, b, c, d, e)"),
        (lambda a, b, last, d, e: {}, "(a, b, last, d, e)"),
        (lambda t, q: {}, "(t, q)"),
        (lambda t, q, v, step: {}, "(t, q, v, step)"),
    ],
)
def test_callbacks_take_what_they_are_given(what, function, own):
    """Told before the first step: where, what they should take and what they do."""
    with pytest.raises(ValueError) as refused:
        nd.Stepper(nd.scenes.load("slide")(), **{what: function})
    here, wanted = (
        f"test_stepper.py, line {function.__code__.co_firstlineno}",
        "(t, q, v), or of (t, q, v, last), or None",
    )
    assert str(refused.value).startswith(f"{here}: {what} must be a function of {wanted}, as `lambda t, q, v: ")
    assert str(refused.value).endswith(f"; got one of {own}")


def test_velocities_take_the_time():
    scene = nd.Scene()
    scene.add_box("plate", (1, 1, 1), fixed=True)
    with pytest.raises(ValueError, match=r"velocity of 'plate' must be a function of 1 argument, got one of \(t, q\)$"):
        scene.set_motion("plate", velocity=lambda t, q: (0, 0, 0))


def test_gauss_least_constraint_literally(rng):
    """No admissible virtual velocity lowers ½|v - v_f|²_M with the shift of the solution frozen."""
    stepper = nd.Stepper(nd.scenes.load("slide")(), dt=1e-2)
    for _ in range(10):
        step = stepper.step()
    M, H = step.problem.blocks.dense()
    change = step.problem.blocks.velocity_change(step.solution.r)
    q, mu = step.problem.q, step.problem.mu
    shift = mu * np.hypot(step.solution.u[1::3], step.solution.u[2::3])
    least = 0.5 * change @ M @ change
    found = 0
    for _ in range(4000):
        other = change + 10.0 ** rng.uniform(-6, 0) * rng.normal(size=6)
        u = H.T @ other + q
        if (u[0::3] + shift >= mu * np.hypot(u[1::3], u[2::3])).all():
            found += 1
            # What the solver's tolerance leaves of the minimum.
            assert 0.5 * other @ M @ other >= least - 1e-10
    assert found > 100
    assert step.gauss.bound <= 1e-6


def test_gauss_bound_grows_with_the_tolerance():
    bounds = []
    for tol in (1e-4, 1e-10):
        scene = nd.scenes.load("stack")(height=5)
        trajectory = nd.simulate(scene, 0.1, dt=1e-2, solver=nd.solvers.PGS(tol=tol, memory=0, max_iter=100_000))
        bounds.append(trajectory.gauss.bound.max())
    assert bounds[0] > 100 * bounds[1] > 0


def many_at_rest(**material):
    """A ground with so many balls that impacts are caught, not located."""
    scene = nd.Scene()
    scene.add_halfspace("ground", material=nd.Material(**material))
    for k in range(51):
        scene.add_sphere(f"ball{k}", 0.1, 1.0, position=(k, 0, 0.1), material=nd.Material(mu=0.5))
    return scene


@pytest.mark.parametrize("gap", [1e-8, 3e-6, 9e-5])
@pytest.mark.parametrize("theta", [0.5, 0.8, 1.0])
def test_a_shallow_gap_closes_without_overlap(gap, theta):
    """A ball let go a hair above another on the ground: nothing is left for the projection, which would lift it."""
    scene = many_at_rest(mu=0.5)
    scene.add_sphere("upper", 0.1, 1.0, position=(0, 0, 0.3 + gap))
    stepper = nd.Stepper(scene, dt=5e-3, theta=theta)
    steps = [stepper.step() for _ in range(4)]
    assert [step.ledger.projection for step in steps] == [0.0] * 4
    assert all(step.gap.min() >= -stepper.gap_tol for step in steps)
    # It has arrived, and all are at rest: what is left is what counts as closed, and the solver's round-off.
    assert abs(steps[-1].q[-5] - 0.3) <= stepper.gap_tol
    assert np.abs(steps[-1].v).max() <= 1e-12


def test_what_rebounds_is_not_slowed_before_it_touches():
    """A ball with restitution that comes within a shallow gap keeps its speed until it strikes."""
    scene, velocity = many_at_rest(mu=0.0, restitution=1.0), (0.0, 0.0, -3e-3)
    material = nd.Material(mu=0.0, restitution=1.0)
    scene.add_sphere("ball", 0.1, 1.0, position=(-1, 0, 0.1 + 1.05e-5), linear_velocity=velocity, material=material)
    step = nd.Stepper(scene, dt=1e-3).step()  # it ends 2.6e-6 m above the ground, nearer than it falls until the next
    assert step.v[-4] == pytest.approx(-3e-3 - 9.81e-3, rel=1e-12)


@pytest.mark.parametrize(("restitution", "a", "b"), [(1.0, -1.0, 0.0), (0.5, -7 / 32, -3 / 64)])
def test_impacts_that_provoke_each_other_within_a_step(restitution, a, b):
    """A ball hits one that hits the wall behind it, all within one step: each impact keeps Newton's law.

    For e = 1/2: (1, 0) -> (1/4, 3/4) -> the wall gives (1/4, -3/8) -> (-7/32, 3/32) -> the wall gives -3/64.
    """
    scene = nd.Scene(gravity=(0, 0, 0))
    material = nd.Material(0.0, restitution)
    scene.add_halfspace("wall", (-1, 0, 0), -1.0, material=material)
    scene.add_sphere("a", 0.1, 1.0, position=(0.698, 0, 0), linear_velocity=(1, 0, 0), material=material)
    scene.add_sphere("b", 0.1, 1.0, position=(0.899, 0, 0), material=material)
    trajectory = nd.simulate(scene, 0.2, dt=1e-2)
    assert trajectory.body("a").linear_velocity[-1, 0] == pytest.approx(a, abs=1e-12)
    assert trajectory.body("b").linear_velocity[-1, 0] == pytest.approx(b, abs=1e-12)


def test_solver_by_name():
    """A name is the solver of that name; "auto" is the default."""
    scene = nd.scenes.load("slide")()
    assert nd.Stepper(scene, solver="pgs").solver == nd.solvers.PGS(tol=1e-8)
    assert nd.Stepper(scene, solver="auto").solver == nd.Stepper(scene).solver == nd.solvers.Auto()
    with pytest.raises(ValueError, match=r"did you mean 'pgs'\? solver must be one of .*; got 'psg'"):
        nd.simulate(scene, 0.1, solver="psg")
    for wrong in (3, nd.solvers.PGS, np.ones(2)):
        with pytest.raises(ValueError, match=r"solver must be one of .* or an object of these; got"):
            nd.simulate(scene, 0.1, solver=wrong)
        with pytest.raises(ValueError, match=r"solver must be one of .* or an object of these; got"):
            nd.solve(nd.FC3D(np.eye(3), np.zeros(3), np.zeros(1)), wrong)


def test_a_name_is_no_scene():
    with pytest.raises(ValueError, match=r"scene must be a nsdyn.Scene, got 'slide'; nsdyn.scenes.load"):
        nd.simulate("slide", 0.1)


def test_choices_say_what_was_meant():
    scene = nd.Scene()
    for keyword, word, meant in (("on_fail", "rise", "raise"), ("impact", "poison", "poisson")):
        with pytest.raises(ValueError, match=rf"did you mean '{meant}'\? {keyword} must be one of .*"):
            nd.Stepper(scene, **{keyword: word})


def test_a_step_does_not_change():
    """What it did is made when it is asked for, once, and is of that step after others too."""
    stepper = nd.Stepper(nd.scenes.load("slide")(), dt=1e-3)
    step = stepper.step()
    r = step.r
    stepper.step()
    assert step.r is r and step.t == 1e-3 and step.solution.r.tobytes() == r.tobytes()
    with pytest.raises(AttributeError, match="a step does not change: t cannot be set"):
        step.t = 0.0
    with pytest.raises(AttributeError):
        _ = step.speed


def test_what_is_squeezed_out_of_a_wedge_is_not_lifted_far():
    """Two heavy plates close on a light ball: what overlaps by little is lifted far, so that the step is halved."""
    scene = nd.Scene(gravity=(0, 0, 0), friction_rule="min")
    for k, sign in enumerate((1.0, -1.0)):
        place = {"position": (0, 0, 0.42 * sign), "quaternion": (0, np.sin(0.075 * sign), 0, np.cos(0.075))}
        scene.add_box(f"plate{k}", (2, 2, 0.4), 50.0, linear_velocity=(0, 0, -5.0 * sign), **place)
    scene.add_sphere("ball", 0.1, 0.02, material=nd.Material(mu=0.0))
    audit = nd.check(nd.simulate(scene, 0.05, dt=0.01))
    assert audit.passed and audit["motion"].worst < 0.05


@pytest.mark.parametrize(("end", "kept"), [((0.5, 0.0, 0.95), True), ((0.95, 0.0, 0.0), False)])
def test_what_a_move_has_not_met_is_met_where_it_parts_bodies(end, kept):
    """A cube on another one: at the end inside it from above, or from the side, where it was not."""
    scene = nd.Scene()
    scene.add_box("lower", (1, 1, 1), fixed=True)
    scene.add_box("upper", (1, 1, 1), 1.0, position=(0.5, 0, 1))
    stepper = nd.Stepper(scene, 1e-2)
    middle, s = stepper.get_state().instant, stepper.system
    places = [Placement(np.array([x]), np.eye(3)[None], ()) for x in (end, (0.5, 0.0, 1.0))]
    late = s.detector.find(*places[0][:2], np.zeros(1), ContactSet.empty())
    assert late.gap.size and (late.gap < -0.04).all()
    met = active_set._separating(s, late, middle.contacts, *places)
    assert met.gap.size == (late.gap.size if kept else 0)


def test_what_a_stepper_returns_may_be_changed():
    """Steps and terms of the equations of motion are the user's own."""
    changed, kept = (nd.Stepper(nd.scenes.load("slide")(), dt=1e-2) for _ in range(2))
    for _ in range(3):
        step, (contacts, *terms) = changed.step(), changed.contact_jacobian()
        terms += [changed.mass_matrix(), changed.bias(), step.q, step.v, step.r, step.u]
        for one in (*contacts[1:3], *step.contacts[1:3], *terms):
            one[:] = np.nan
        kept.step()
    assert changed.step().q.tobytes() == kept.step().q.tobytes()


def test_terms_of_the_equations_of_motion():
    """M v̇ + bias = Jᵀ f along a fine motion with contacts, and J v is the rate of the gaps; Pinocchio's layout."""
    stepper = nd.Stepper(nd.scenes.load("arm_pushes_box")(), dt=1e-5, solver=nd.solvers.Auto(tol=1e-12))
    for _ in range(500):
        stepper.step()
    n = stepper.start().v.size
    M, bias, v = stepper.mass_matrix(), stepper.bias(), stepper.start().v
    np.testing.assert_allclose(M, M.T, rtol=0, atol=1e-15)
    contacts, frame, J = stepper.contact_jacobian()
    assert J.shape == (3 * contacts.gap.size, n) and frame.shape == (contacts.gap.size, 3, 3) and contacts.gap.size
    kinetic = stepper.step().energy["kinetic"]
    assert 0.5 * v @ M @ v == pytest.approx(kinetic, rel=1e-3)
    step = stepper.step()
    before = stepper.start().v
    step = stepper.step()
    M, bias = stepper.mass_matrix(), stepper.bias()
    contacts, frame, J = stepper.contact_jacobian()
    assert contacts.key.tolist() == step.contacts.key.tolist()
    # Tangents may differ from those of the step, whose impulses the world's axes tell.
    push = np.einsum("cij,cj->ci", frame, np.einsum("cij,ci->cj", step.frame, step.r)).ravel()
    left = M @ (step.v - before) / 1e-5 + bias - J.T @ push / 1e-5
    assert np.abs(left).max() < 1e-3 * np.abs(bias).max()
    rates = (J @ step.v).reshape(-1, 3)
    np.testing.assert_allclose(
        rates[:, 0], np.einsum("ci,cij,cj->c", step.u, step.frame, frame[:, 0]), rtol=0, atol=1e-4
    )


@pytest.mark.parametrize("name", ["pile", "quadruped"])
@pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, lambda stepper: pickle.loads(pickle.dumps(stepper))])
def test_a_copy_goes_on_with_the_same_bits(name, copied):
    stepper = nd.Stepper(nd.scenes.load(name)(), dt=5e-3)
    for _ in range(10):
        stepper.step()
    again = copied(stepper)
    for _ in range(5):  # in turns: neither may write into what the other reads
        one, other = stepper.step(), again.step()
        assert np.array_equal(one.q, other.q) and np.array_equal(one.v, other.v) and one.t == other.t


@pytest.mark.parametrize("name", ["slide", "quadruped"])
def test_a_step_that_was_not_asked_for_anything_is_sent_whole(name):
    """To another process, long after the stepper has gone on: what it tells then is what it tells at once."""
    setup = nd.scenes.setup(name)
    stepper, again = (nd.Stepper(setup.scene, **setup.options()) for _ in range(2))
    steps = [stepper.step() for _ in range(5)]
    for kept in [pickle.loads(pickle.dumps(step)) for step in steps]:
        step = again.step()
        assert (
            kept.ledger == step.ledger
            and kept.gauss.bound == step.gauss.bound
            and kept.solution.status == step.solution.status
        )
        for one, other in ((kept.q, step.q), (kept.v, step.v), (kept.r, step.r), (kept.links, step.links)):
            assert np.array_equal(one, other)
        assert (kept.joints is None and step.joints is None) or np.array_equal(kept.joints, step.joints)


def test_a_body_of_any_mass_tumbles_as_one_of_a_kilogram():
    """Beyond 1e12 kg the error of the literature is round-off, which no answer goes below.

    Where slip stops is not located in steps that miss the tolerance for it, which is of second order in dt.
    """
    ends = []
    for mass in (1.0, 1e13):
        scene, material = nd.Scene(), nd.Material(mu=0.4)
        scene.add_halfspace("ground", material=material)
        pose = {"position": (0, 0, 0.3), "quaternion": (0.1, 0.1, 0.1, 0.97**0.5)}
        speeds = {"linear_velocity": (1, 0.2, 0), "angular_velocity": (0.5, 0, 1)}
        scene.add_box("box", (0.2, 0.3, 0.4), mass, **pose, **speeds, material=material)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of steps that miss the tolerance
            ends.append(nd.simulate(scene, 0.4, dt=1e-3).body("box").position[-1])
    np.testing.assert_allclose(ends[1], ends[0], rtol=0, atol=1e-6)


def test_a_step_keeps_nothing_that_its_solves_worked_with():
    """Beside its problem that would be as much again, for every step that a user keeps."""
    scene = nd.scenes.load("wall")()
    scene.add_sphere("ball", 0.12, 8.0, position=(1.0, -0.17, 0.5), linear_velocity=(0, 10, 0))
    stepper = nd.Stepper(scene, dt=5e-3, on_fail="ignore")
    steps = [stepper.step() for _ in range(6)]
    assert max(step.problem.nc for step in steps) > 400 and not any(step.problem.kept for step in steps)


def test_a_robot_that_falls_far_from_the_origin_moves_as_at_it():
    """30 km up its places are rounded to 4e-12 m, a fifth of the gap that counts as closed at the origin."""
    near, far = (nd.scenes.load("quadruped")() for _ in range(2))
    height = 3e4
    far.articulations["quadruped"].q[2] += height
    del far.bodies["ground"]
    far.add_halfspace("ground", offset=height, material=near.bodies["ground"].material)
    ends = [nd.simulate(scene, 0.2, 2e-3).q[-1] for scene in (near, far)]
    ends[1][2] -= height
    np.testing.assert_allclose(ends[1], ends[0], rtol=0, atol=1e-7)
