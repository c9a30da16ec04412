"""What the law of contact leaves open: impulses, velocities, and impulses that are no force."""

import math
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from mechanisms import at, hang, lump
from scipy.optimize import linprog

import nsdyn as nd
from nsdyn.problem import paradox
from nsdyn.problem.solution import TOLD

GRIP = nd.Material(mu=0.5)
SMOOTH = nd.Material(mu=0.0)


def slips(W, q, mu):
    """Impulses with u_T = -α r_T, α > 0, u_N = 0 on the edge of K: by Cramer's rule α is a root of a quartic."""

    def impulse(alpha):
        return -np.linalg.solve(W + alpha * np.diag([0.0, 1.0, 1.0]), q)

    at, values = np.trace(W[1:, 1:]) * np.arange(5.0), []
    for alpha in at:
        r = impulse(alpha) * np.linalg.det(W + alpha * np.diag([0.0, 1.0, 1.0]))
        values.append(r[1] ** 2 + r[2] ** 2 - (mu * r[0]) ** 2)
    roots = np.roots(np.polyfit(np.arange(5.0), np.array(values) / np.abs(values).max(), 4))
    real = roots[np.abs(roots.imag) <= 1e-9 * (1.0 + np.abs(roots))].real * at[1]
    return [r for r in map(impulse, real[real > 0.0]) if r[0] > 0.0]


def test_all_solutions_of_a_contact_are_found(rng):
    """Those that slip, bracketed by directions, are the roots of a quartic; all solve the law."""
    several = 0
    for _ in range(1500):
        A, mu, q = rng.normal(size=(3, 3)), rng.uniform(0.3, 3.0), rng.normal(size=3)
        W = A @ A.T
        found = paradox.all_of_one(W, q, mu)
        problem = nd.FC3D(W, q, [mu])
        assert all(problem.solved(r, 1e-9 * (1.0 + np.abs(W).max() * np.abs(r).max()))[0] for r in found)
        for r in slips(W, q, mu):
            assert np.abs(found - r).max(axis=1).min(initial=np.inf) <= 1e-6 * np.abs(r).max(), (W, q, mu)
        several += len(found) > 1
    assert several > 30


def test_an_answer_and_its_own_refinement_are_not_two(rng):
    """What is solved to 1e-3 differs from its own solution by that: both, solved to round-off, have to be apart."""
    loose, sharp, shown = nd.solvers.PGS(tol=1e-3, max_iter=300), nd.solvers.Auto(tol=1e-12, loose=1e-8), 0
    for _ in range(2000):
        nc = int(rng.integers(2, 4))
        H, mu, q = rng.normal(size=(3 * nc + 1, 3 * nc)), rng.uniform(0.2, 4.0, nc), rng.normal(size=3 * nc)
        H[:, ::3] *= 0.5
        q[::3] = 0.3 * q[::3] + 0.4
        problem = nd.FC3D(H.T @ H, q, mu)
        solution = loose(problem)
        other = paradox.others(problem, solution.r, loose) if solution.converged else None
        if other is not None:
            one, two = sharp(problem, solution.r), sharp(problem, other)
            assert np.abs(one.u - two.u).max() > 1e-6
            shown += one.converged and two.converged
    assert shown > 30


# -- impulses -----------------------------------------------------------------------------------------------------


def table(scene, **options):
    """Contacts of the second step."""
    return nd.simulate(scene, 2e-3, dt=1e-3, **options).contacts(2)


def on_ground(material):
    scene = nd.Scene()
    scene.add_halfspace("ground", material=material)
    return scene


@pytest.mark.parametrize("material", [GRIP, SMOOTH])
def test_four_corners_share_a_load_in_many_ways_and_a_ball_does_not(material):
    scene = on_ground(material)
    scene.add_box("box", (0.2, 0.2, 0.2), 1.0, position=(0, 0, 0.1), material=material)
    scene.add_sphere("ball", 0.1, 1.0, position=(1, 0, 0.1), material=material)
    found = table(scene)
    assert len(found) == 5
    assert found.unique.tolist() == ["ball" in pair for pair in zip(found.body1, found.body2, strict=True)]


def test_three_feet_without_friction_carry_one_way_and_with_it_many():
    """Three normal forces, three equations; friction adds six forces in three more."""
    angle = 2.0 * np.pi * np.arange(3) / 3
    feet = np.column_stack([0.3 * np.cos(angle), 0.3 * np.sin(angle), np.full(3, -0.1)])
    for material, unique in ((SMOOTH, True), (GRIP, False)):
        stool = on_ground(material)
        stool.add_convex("stool", [*feet, (0, 0, 0.3)], 1.0, position=(0, 0, 0.1), material=material)
        found = table(stool, lift=True)
        assert len(found) == 3 and (found.unique == unique).all()


def test_feet_of_plates_by_linear_programming(rng):
    """Smooth feet: where programs find a least and a largest force of a foot that differ, it is not unique."""
    for count in (3, 4, 5):
        angle = np.sort(rng.uniform(0.0, 0.6, count) + 2.0 * np.pi * np.arange(count) / count)
        feet = np.column_stack([0.3 * np.cos(angle), 0.3 * np.sin(angle), np.full(count, -0.1)])
        scene = on_ground(SMOOTH)
        scene.add_convex("plate", [*feet, (0, 0, 0.3)], 1.0, position=(0, 0, 0.1), material=SMOOTH)
        found = table(scene, lift=True)
        arms = np.column_stack([np.ones(len(found)), found.point[:, :2]]).T
        load = arms @ found.impulse_raw[:, 0]
        for k in range(len(found)):
            ends = [linprog(sign * np.eye(len(found))[k], A_eq=arms, b_eq=load).fun for sign in (1.0, -1.0)]
            assert found.unique[k] == (abs(sum(ends)) < 1e-9)


def test_sliding_makes_rays_of_cones():
    """A ball in a groove that sticks may be squeezed; where it slides along both walls friction is given."""
    for speed, unique in ((0.0, False), (3.0, True)):
        scene = nd.Scene()
        for side in (1, -1):
            scene.add_halfspace(f"wall {side}", normal=(0, side * math.sqrt(0.5), math.sqrt(0.5)), material=GRIP)
        scene.add_sphere(
            "ball", 0.1, 1.0, position=(0, 0, 0.1 * math.sqrt(2.0)), linear_velocity=(speed, 0, 0), material=GRIP
        )
        found = table(scene)
        assert len(found) == 2 and (found.unique == unique).all()


def test_an_arm_of_two_joints_does_not_tell_the_force_across():
    """A tip in a plane takes two forces of three up in its joints; the third is any in the cone. A slide takes one."""
    model = pin.Model()
    joint = hang(model, 0, "lift", pin.JointModelPZ(), lump(1.0, 1 / 100))
    model.addJointFrame(joint)
    for material, unique in ((SMOOTH, True), (GRIP, False)):
        scene = on_ground(material)
        ball = [(nd.scene.shapes.sphere(0.1), at((0, 0, 0)))]
        scene.add_model("arm", model, q=[0.1], collisions={"lift": ball}, material=material)
        found = table(scene)
        assert len(found) == 1 and found.unique.tolist() == [unique]


def test_feet_of_a_quadruped_tell_their_forces():
    """Four feet, twelve forces, eighteen coordinates, of legs with three joints each: all are known."""
    found = nd.simulate(nd.scenes.load("quadruped")(), 0.01, dt=2e-3).contacts(-1)
    assert len(found) and found.unique.all()


# -- velocities ---------------------------------------------------------------------------------------------------


def solutions(W, q, mu, count=20000):
    """Impulses that solve the law of one contact, by a scan of all directions of slip, apart from the package."""
    found = [np.zeros(3)] if q[0] >= 0.0 else []
    r = -np.linalg.solve(W, q)
    if np.hypot(*r[1:]) <= mu * r[0]:
        found.append(r)

    def slips(angle):
        """(impulse against a slip in that direction that leaves u_N = 0, part of u_T across it, part along it, scale)

        All times the scale, which has zeros: there no impulse leaves u_N = 0.
        """
        t = np.array([np.cos(angle), np.sin(angle)])
        push = np.array([1.0, *(-mu * t)])
        scale = W[0] @ push
        r = -q[0] * push
        u = (W @ r + scale * q)[1:]
        return r, t[0] * u[1] - t[1] * u[0], t @ u, scale

    angles = np.linspace(0.0, 2.0 * np.pi, count + 1)
    for low, high in pairwise(angles):
        across = slips(low)[1]
        if across * slips(high)[1] >= 0.0:
            continue
        for _ in range(60):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if across * slips(middle)[1] > 0.0 else (low, middle)
        r, _, along, scale = slips(low)
        if scale * r[0] > 0.0 and scale * along > 0.0:
            found.append(r / scale)
    return found


@pytest.mark.slow
def test_all_solutions_of_one_contact(rng):
    """As many as a scan finds, and the same: one of several where friction is steep."""
    several = 0
    for _ in range(12):
        A = rng.normal(size=(6, 3))
        W, q, mu = A.T @ A, rng.normal(size=3), 2.5
        if abs(q[0]) > 0.05:
            expected, got = solutions(W, q, mu, 2000), paradox.all_of_one(W, q, mu)
            assert len(got) == len(expected)
            for r in expected:
                assert min(np.abs(r - x).max() for x in got) <= 1e-6 * max(1.0, np.abs(r).max())
            several += len(got) > 1
    W = np.array([[1.6, -1.2, 0.0], [-1.2, 3.4, 0.0], [0.0, 0.0, 1.0]])  # Painlevé's rod
    q = np.array([0.001, -1.0, 0.0])
    assert len(paradox.all_of_one(W, q, 2.0)) == len(solutions(W, q, 2.0)) == 3


@pytest.mark.parametrize("dt", [1e-3, 1e-5])
def test_painleves_rod_may_fly_slip_or_stick(dt):
    """All three obey the law to round-off; the step takes one, and says that there are others."""
    step = nd.Stepper(nd.scenes.load("rod")(mu=2.0, slip=-1.0, spin=5.0), dt=dt).step()
    assert step.solution.status is nd.Status.SEVERAL and step.solution.converged and step.solution.accepted
    found = paradox.all_of_one(step.problem.W.toarray(), step.problem.q, 2.0)
    assert len(found) == 3
    for r in found:
        # A root of a quartic, of which others are up to 1e5 times as large.
        assert step.problem.error(r) <= 1e-11 and step.problem.residual(r) <= 1e-11
    velocities = np.array([step.problem.velocity(r) for r in found])
    assert min(np.abs(a - b).max() for a, b in zip(velocities, velocities[[1, 2, 0]], strict=True)) > dt


@pytest.mark.parametrize("kind", ["slip", "mu"])
def test_where_the_rod_has_one_motion(kind):
    """Pulled, or with less friction than 4/3."""
    change = {"slip": 1.0} if kind == "slip" else {"mu": 1.3}
    step = nd.Stepper(nd.scenes.load("rod")(**({"mu": 2.0, "slip": -1.0, "spin": 5.0} | change)), dt=1e-4).step()
    assert step.solution.status is nd.Status.CONVERGED


# -- jams ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dt", [1e-3, 1e-4, 1e-5])
def test_a_jam_is_an_impact(dt):
    """0.3 m v and 0.4 m v whatever the dt, which take 0.2 J: told, and not from friction."""
    stepper = nd.Stepper(nd.scenes.load("rod")(angle=math.degrees(math.atan(2.0)), mu=2.0), dt=dt)
    step = stepper.step()
    assert step.solution.status is nd.Status.JAM and step.solution.converged
    assert step.contact_status.tolist() == [3, 1]  # what jammed sticks for the rest of the step
    assert step.r[0, 0] == pytest.approx(0.3, rel=30 * dt)
    assert step.energy["friction"] == 0.0 and step.work_friction[0] == 0.0
    assert step.energy["normal"] == pytest.approx(-0.2, rel=30 * dt)
    assert step.work_normal[0] == pytest.approx(step.energy["normal"], rel=1e-12)
    assert abs(step.energy["defect"]) <= 1e-14
    assert stepper.step().solution.status is nd.Status.CONVERGED  # what jammed sticks


def test_a_jam_of_what_rested_is_an_impact():
    """A cube of 1 kg on a floor that jolts: what jams has rested, whose works are numerics, but not that of a jam."""
    scene, material = nd.Scene(), nd.Material(mu=3.0)
    scene.add_box("floor", (3, 3, 0.2), fixed=True, position=(0, 0, -0.1), material=material)
    scene.add_box("box", (0.1, 0.1, 0.1), 1.0, position=(0, 0, 0.05), material=material)
    scene.set_motion("floor", velocity=lambda t: (1.0 * (t > 0.0101), 0, 0))
    run = nd.simulate(scene, 0.012, dt=2e-3)
    assert run.solver.status_names == ["CONVERGED"] * 5 + ["JAM"]
    work = run.columns["contacts/work_normal"][run.columns["contacts/offset"][5] :].sum()
    assert run.energy.normal[5] == pytest.approx(work, abs=1e-15) and work < -1e-4  # J, of 0.3 J
    assert run.energy.friction[5] == 0.0 and abs(run.energy.integration[5]) <= 1e-15
    assert nd.check(run).passed


@pytest.mark.parametrize(("tol", "told"), [(1e-8, "JAM"), (1e-20, "LOOSE")])
def test_a_jam_is_recorded_and_audited(tmp_path, tol, told):
    """Also where the step misses its tolerance, which its status then says."""
    scene, solver = nd.scenes.load("rod")(angle=math.degrees(math.atan(2.0)), mu=2.0), nd.solvers.Auto(tol=tol)
    trajectory = nd.simulate(scene, 5e-3, dt=1e-3, record=tmp_path / "a.h5", solver=solver, on_fail="ignore")
    assert trajectory.solver.status_names[0] == told
    assert nd.Trajectory.load(tmp_path / "a.h5").contacts(1).status_names[0] == "jam"
    assert nd.check(trajectory).passed


@pytest.mark.parametrize("material", [nd.Material(mu=0.5), nd.Material(mu=3.0)])
def test_what_slides_to_rest_strikes_or_rolls_does_not_jam(material):
    """A rough ball with backspin, a rod that falls flat, one thrown along the ground that stops."""
    scene = on_ground(material)
    scene.add_sphere("ball", 0.1, 1.0, position=(0, 0, 0.1), angular_velocity=(0, -50.0, 0), material=material)
    scene.add_capsule("rod", 0.05, 1.0, 1.0, position=(0, 2, 0.3), quaternion=(0, 0.6, 0, 0.8), material=material)
    scene.add_box("box", (0.4, 0.4, 0.1), 1.0, position=(0, -2, 0.05), linear_velocity=(0.3, 0, 0), material=material)
    trajectory = nd.simulate(scene, 0.5, dt=2e-3)
    assert not (trajectory.columns["contacts/status"] == 3).any()
    assert np.isin(trajectory.solver.status, [*TOLD, nd.Status.LOOSE]).all()
    assert not (trajectory.solver.status == nd.Status.JAM).any()


def test_what_sticks_by_little_friction_has_one_solution():
    """The rule by which a contact is not asked for others, beside all solutions of its law."""
    rng, ruled, several = np.random.default_rng(5), 0, 0
    for _ in range(4000):
        A = rng.normal(size=(3, 3)) * np.exp(rng.normal(size=3))
        W, mu = A @ A.T, np.exp(rng.normal())
        normal, across = W[0, 0], mu * np.hypot(W[0, 1], W[0, 2])
        r = np.array([1.0, *(mu * rng.uniform() ** 2 * rng.normal(size=2) / 2.0)])
        friction = np.hypot(r[1], r[2])
        if normal >= across or friction >= mu:
            continue
        found = len(paradox.all_of_one(W, -W @ r, mu))
        several += found > 1
        if mu * (W @ r)[0] >= friction * (normal + across):
            ruled += 1
            assert found == 1
    assert ruled > 200 and several > 50


def test_steps_in_which_nothing_touches_have_no_impulses_that_are_not_unique():
    """A ball that leaves the ground: first a contact that opens, then none."""
    ball = on_ground(GRIP)
    ball.add_sphere("ball", 0.1, 1.0, position=(0, 0, 0.1 + 1e-9), linear_velocity=(0, 0, 1))
    run = nd.simulate(ball, 0.02, dt=1e-2)
    assert all(run.contacts(k).unique.tolist() == [True] * len(run.contacts(k)) for k in (1, 2))
