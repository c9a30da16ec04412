"""Laws of impact: where they agree, what each does to energy, chains, Zeno's ball and rest."""

import dataclasses
import math
import warnings

import numpy as np
import pinocchio as pin
import pytest
from mechanisms import hang, lump, serial
from scipy.spatial.transform import Rotation

import nsdyn as nd
from nsdyn.problem.blocks import DelassusFactors
from nsdyn.scene import shapes
from nsdyn.stepping import substepping
from nsdyn.stepping.impacts import LAWS, Round
from nsdyn.stepping.move import try_move
from nsdyn.stepping.rounds import strike
from nsdyn.stepping.step_result import finish

g = 9.81


@pytest.mark.parametrize("law", LAWS)
def test_one_frictionless_contact_obeys_newton(law):
    """A ball against a ball, off centre: the normal velocity turns round times e, the rest is left alone."""
    material = nd.Material(0.0, 0.6)
    scene = nd.Scene(gravity=(0, 0, 0))
    scene.add_sphere("a", 0.1, 1.0, linear_velocity=(3, 0, 0), material=material)
    scene.add_sphere("b", 0.1, 2.5, position=(0.16, 0.12, 0), material=material)
    stepper = nd.Stepper(scene, dt=1e-4, impact=law)
    step = stepper.step()
    approach = 3 * step.contacts.normal[0, 0]
    assert step.u[0, 0] == pytest.approx(0.6 * approach, rel=1e-9)
    np.testing.assert_allclose(step.r[0], (1.6 * approach / (1 + 1 / 2.5), 0, 0), rtol=1e-9, atol=1e-15)
    assert step.created == 0.0


def thrown_rod(seed):
    """A rod that meets the ground with one end, as in Kane and Levinson's paradox."""
    rng = np.random.default_rng(seed)
    half, radius, angle = 0.5, 0.01, rng.uniform(0.2, 1.3)
    axis = np.array([math.cos(angle), 0, math.sin(angle)])
    scene = nd.Scene(gravity=(0, 0, 0))
    material = nd.Material(1.0, 0.9)
    scene.add_halfspace("ground", material=material)
    scene.add_capsule(
        "rod",
        radius,
        2 * half,
        1.0,
        position=half * axis + (0, 0, radius),
        material=material,
        quaternion=Rotation.from_euler("y", math.pi / 2 - angle).as_quat(),
        linear_velocity=(*rng.uniform(-2, 2, 2), rng.uniform(-2.5, -0.5)),
        angular_velocity=rng.uniform(-3, 3, 3),
    )
    return scene


def created(scene, law, dt=1e-4):
    """Energy the first impact creates, as a fraction of the kinetic energy before."""
    stepper = nd.Stepper(scene, dt=dt, impact=law)
    before = stepper.start().energy["kinetic"]
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "the law of impact Newton")
        step = stepper.step()
    works = (step.work_normal + step.work_friction).sum()
    # What the solver's tolerance of 1e-8 m/s leaves is not the law's.
    assert step.created == pytest.approx(works if works > 1e-8 * np.abs(step.r).sum() else 0.0, rel=1e-12, abs=0)
    # Besides, the gyroscopic torque belongs to the motion that was foreseen.
    assert step.energy["kinetic"] - before == pytest.approx(works, abs=1e-3 * before)
    return step.created / before


def test_newton_with_friction_creates_energy_and_the_ledger_says_so():
    gains = np.array([created(thrown_rod(seed), "newton") for seed in range(60)])
    assert (gains > 0.01).sum() >= 3 and gains.max() < 1.0


def test_a_law_that_creates_energy_warns_once_with_how_much_where_and_when():
    """Of two rods that land one after the other, and of which each creates some, the first is told."""
    scene = thrown_rod(15)
    for name, seed, height in (("rod", 15, 1e-3), ("other", 49, 5e-3)):
        rod = thrown_rod(seed).bodies["rod"]
        x, y, z = rod.position
        scene.bodies[name] = dataclasses.replace(rod, name=name, position=(x + 10 * (name == "other"), y, z + height))
    stepper = nd.Stepper(scene, dt=1e-3, impact="newton")
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        first, _ = [step for step in (stepper.step() for _ in range(8)) if step.created > 0.0]
    hit = float(first.contact_time[np.argmax(first.work_normal + first.work_friction)])
    assert 0.0 < hit < 1e-3
    assert [str(w.message).split(";")[0] for w in told] == [
        f"the law of impact Newton() created {first.created:.3g} J at t = {first.t - 1e-3 + hit:.6g} s "
        "between 'ground' and 'rod'"
    ]
    assert told[0].filename == __file__


@pytest.mark.parametrize("law", ["dissipative", "poisson", "fremond"])
def test_the_dissipative_laws_never_do(law):
    assert max(created(thrown_rod(seed), law) for seed in range(60)) == 0.0


def test_restitution_is_lowered_only_where_newton_creates_energy():
    """There the impact keeps the energy, and the end rebounds with less than e, by the convex combination."""
    lowered = 0
    for seed in range(60):
        steps = {law: nd.Stepper(thrown_rod(seed), dt=1e-4, on_fail="ignore", impact=law) for law in LAWS}
        before = steps["newton"].start().energy["kinetic"]
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "the law of impact Newton")
            newton, mine = steps["newton"].step(), steps["dissipative"].step()
        if newton.created == 0.0:
            np.testing.assert_array_equal(mine.v, newton.v)
            continue
        lowered += 1
        assert abs((mine.work_normal + mine.work_friction).sum()) <= 1e-14 * before
        assert 0.0 < mine.u[0, 0] < newton.u[0, 0]
        assert np.linalg.norm(mine.r[0, 1:]) <= mine.r[0, 0] * (1 + 1e-14)  # mu = 1
    assert lowered >= 3


def test_an_impact_that_creates_energy_changes_no_other():
    """A ball that lands in the same instant, beside rods of the paradox, rebounds with exactly e = 0.9."""
    for seed in range(12):
        scene = thrown_rod(seed)
        material = nd.Material(1.0, 0.9)
        scene.add_sphere("ball", 0.1, 3.0, position=(5, 5, 0.1), linear_velocity=(0, 0, -2), material=material)
        v = nd.Stepper(scene, dt=1e-4).step().v.reshape(2, 6)
        assert v[1, 2] == pytest.approx(1.8, rel=1e-14)
        np.testing.assert_allclose(v[0], nd.Stepper(thrown_rod(seed), dt=1e-4).step().v, rtol=0, atol=1e-12)


def test_what_no_velocity_obeys_is_an_impact_without_restitution():
    """A ball that fits between two walls, one of them elastic, stops; another one rebounds all the same."""
    scene, smooth = nd.Scene(gravity=(0, 0, 0)), nd.Material(0.0, 0.0)
    for sign, e in ((1, 0.5), (-1, 0.0)):
        scene.add_halfspace(f"wall {sign}", (sign, 0, 0), -0.1, material=nd.Material(0.0, e))
    scene.add_sphere("ball", 0.1, 1.0, linear_velocity=(-1, 1, 0), material=smooth)
    scene.add_box("floor", (0.1, 0.1, 0.1), position=(0, 0, 5), fixed=True, material=nd.Material(0.0, 0.5))
    scene.add_sphere(
        "other", 0.05, 1.0, position=(0, 0, 5.1), linear_velocity=(0, 0, -1), material=nd.Material(0.0, 0.0)
    )
    step = nd.Stepper(scene, dt=1e-3).step()
    v = step.v.reshape(2, 6)[:, :3]
    np.testing.assert_allclose(v, [(0, 1, 0), (0, 0, 0.5)], rtol=0, atol=1e-12)
    assert step.solution.converged


def operator(seed):
    """An impact of up to 12 contacts of up to 4 bodies, masses up to 1 : 1e8, a quarter of the contacts twice."""
    rng = np.random.default_rng([7, seed])
    bodies, nc, ratio = rng.integers(1, 5), rng.integers(1, 13), 10.0 ** rng.choice([0, 1, 3, 8])
    M = np.array([np.linalg.inv(A @ A.T + 0.1 * np.eye(6)) for A in rng.normal(size=(bodies, 6, 6))])
    M *= ratio ** rng.uniform(size=(bodies, 1, 1))
    block, start = np.full((nc, 2), -1), 36 * np.arange(nc)[:, None] + (0, 18)
    for c in range(nc):
        if c and rng.uniform() < 0.25:
            same = rng.integers(c)
            block[c], start[c] = block[same], start[same]
        else:
            a, b = rng.integers(bodies), rng.integers(-1, bodies)
            block[c] = a, b if b != a else -1
    blocks = DelassusFactors(
        6 * np.arange(bodies + 1),
        block,
        start,
        rng.normal(size=36 * nc),
        36 * np.arange(bodies),
        M.ravel(),
        np.linalg.inv(M).ravel(),
    )
    mu = rng.uniform(0, 1.5, nc) * (rng.uniform() < 0.85)
    one, several = rng.choice([1.0, rng.uniform()]), rng.uniform(size=nc) * (rng.uniform(size=nc) < 0.8)
    e = np.full(nc, one) if rng.uniform() < 0.6 else several
    return blocks, rng.normal(size=6 * bodies), mu, e


def gains_on_operators(law, seeds):
    """Largest share of kinetic energy that impacts create; fastest approach after them, m/s.

    Random operators; the approach is of impacts that are solved to the tolerance, and the number is of the others.
    """
    gain, approach, loose = 0.0, 0.0, 0
    for seed in seeds:
        blocks, v, mu, e = operator(seed)
        least = np.full(mu.size, 1e-8)
        at = Round(blocks, blocks.relative_velocity(v), mu, e, np.ones(mu.size, bool), nd.solvers.Auto())
        impact = strike(LAWS[law](), at, least, least)
        after = v + blocks.velocity_change(impact.r)
        energy, now = (0.5 * w @ blocks.dense()[0] @ w for w in (v, after))
        work = (impact.work_normal + impact.work_friction).sum()
        assert now - energy == pytest.approx(work, abs=1e-10 * max(now, energy))
        gain = max(gain, work / energy, impact.created / energy)
        solved = impact.solved is None or impact.solved[1].status is nd.Status.CONVERGED
        approach, loose = max(approach, -impact.u[0::3].min() if solved else 0.0), loose + (not solved)
    return gain, approach, loose


def test_no_energy_on_random_operators():
    """Newton's law creates some, the default never, and nothing approaches after it.

    Also where masses of 1 : 1e8 and redundant contacts take Newton's method to impulses of 1e15 N·s (170, 716).
    """
    assert gains_on_operators("newton", [13])[0] > 0.1
    gain, approach, loose = gains_on_operators("dissipative", [*range(40), 170, 716])
    assert gain <= 1e-12 and approach <= 1e-7 and loose == 0  # ten times the solver's tolerance


@pytest.mark.parametrize("e", [0.0, 0.5])
def test_works_of_what_strikes_again(e, monkeypatch):
    """After a loose solution: at the mean velocity where nothing rebounds; else what makes up the change of energy."""

    def solver(problem, r0=None):
        return nd.solvers.Nesterov(tol=0.3 if len(rounds) == 1 else 1e-10)(problem, r0)

    again, law, rounds, solved, solver.tol = 0, LAWS["newton"](), [], Round.solved, 1e-8
    monkeypatch.setattr(Round, "solved", lambda impact, b: rounds.append(impact) or solved(impact, b))
    for seed in range(12):
        blocks, v, mu, _ = operator(seed)
        least, some = np.full(mu.size, 1e-8), np.ones(mu.size, bool)
        at = Round(blocks, blocks.relative_velocity(v), mu, e * some, some, solver)
        rounds.clear()
        impact = strike(law, at, least, least)
        after = v + blocks.velocity_change(impact.r)
        energy, now = (0.5 * w @ blocks.dense()[0] @ w for w in (v, after))
        assert now - energy == pytest.approx((impact.work_normal + impact.work_friction).sum(), abs=1e-10 * energy)
        if e == 0.0:
            work = 0.5 * (at.before + impact.u) * impact.r
            np.testing.assert_allclose(impact.work_normal, work[0::3], rtol=0, atol=1e-14 * energy)
        again += len(rounds) > 1
    assert again > 3


@pytest.mark.slow
def test_no_energy_on_1500_random_operators():
    """Of those with masses 1 : 1e8 the last digits decide whether one is solved: none or one on two machines."""
    gain, approach, loose = gains_on_operators("dissipative", range(1500))
    assert gain <= 1e-12 and approach <= 1e-7 and loose <= 3


def test_light_balls_between_heavy_ones_strike_more_often_than_there_are_rounds():
    """1e8 : 1 : 1 : 1e8 with e = 1: what is left after 60 rounds keeps the energy, and nothing approaches."""
    scene = nd.Scene(gravity=(0, 0, 0))
    for k, mass in enumerate((1e8, 1.0, 1.0, 1e8)):
        scene.add_sphere(
            f"b{k}",
            0.1,
            mass,
            position=(0.2 * k, 0, 0),
            linear_velocity=(float(k == 0), 0, 0),
            material=nd.Material(0.0, 1.0),
        )
    stepper = nd.Stepper(scene, dt=1e-6)
    before = stepper.start().energy["kinetic"]
    step = stepper.step()
    v = step.v.reshape(4, 6)[:, 0]
    assert np.diff(v).min() >= -1e-7
    assert step.energy["kinetic"] == pytest.approx(before, rel=1e-9) and step.created == 0.0
    np.testing.assert_allclose(v[[0, 3]], (0, 1), rtol=0, atol=1e-5)


@pytest.mark.slow
def test_poisson_in_a_crowd():
    """Boxes and balls thrown together, one restitution for all, many contacts at once."""
    rng = np.random.default_rng(5)
    scene = nd.Scene()
    material = nd.Material(0.8, 0.9)
    scene.add_halfspace("ground", material=material)
    for k in range(8):
        place = (0.25 * (k % 2), 0.25 * (k // 2 % 2), 0.2 + 0.3 * (k // 4))
        common = {"position": place, "linear_velocity": rng.uniform(-2, 2, 3), "material": material}
        if k % 2:
            scene.add_sphere(f"s{k}", 0.1, 1.0 + k, angular_velocity=rng.uniform(-9, 9, 3), **common)
        else:
            scene.add_box(f"b{k}", (0.2, 0.15, 0.1), 1.0 + k, angular_velocity=rng.uniform(-9, 9, 3), **common)
    stepper = nd.Stepper(scene, dt=1e-3, impact="poisson")
    kinetic = stepper.start().energy["kinetic"]
    impacts = 0
    for _ in range(600):
        step = stepper.step()
        impacts += step.energy["normal"] < -1e-3
        assert step.created <= 1e-6 * kinetic
    assert impacts > 20


def cradle(gap, count=5):
    material = nd.Material(0.0, 1.0)
    scene = nd.Scene(gravity=(0, 0, 0))
    for k in range(count):
        speed = 1.0 if k == 0 else 0.0
        place = (k * (0.2 + gap) - (0.05 if k == 0 else 0.0), 0, 0)
        scene.add_sphere(f"b{k}", 0.1, 1.0, position=place, linear_velocity=(speed, 0, 0), material=material)
    return scene


def speeds(scene, law, count=5):
    trajectory = nd.simulate(scene, 0.4, dt=1e-3, impact=law)
    energy = trajectory.energy.kinetic
    return np.array([trajectory.body(f"b{k}").linear_velocity[-1, 0] for k in range(count)]), energy[-1] / energy[0]


@pytest.mark.parametrize("law", LAWS)
def test_cradle_with_gaps_hands_the_speed_on(law):
    v, energy = speeds(cradle(0.01), law)
    np.testing.assert_allclose(v, (0, 0, 0, 0, 1), rtol=0, atol=1e-12)
    assert energy == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("law", ["dissipative", "newton"])
def test_touching_cradle_of_newton(law):
    """Contacts that rest follow in rounds of their own: the speed is handed on as with gaps."""
    v, energy = speeds(cradle(0.0), law)
    np.testing.assert_allclose(v, (0, 0, 0, 0, 1), rtol=0, atol=1e-13)
    assert energy == pytest.approx(1.0, abs=1e-13)


def test_touching_cradle_of_fremond():
    """All contacts at once: the first ball comes back, the others leave together; energy is kept."""
    v, energy = speeds(cradle(0.0), "fremond")
    np.testing.assert_allclose(v, (-3 / 5, 2 / 5, 2 / 5, 2 / 5, 2 / 5), rtol=0, atol=1e-9)
    assert energy == pytest.approx(1.0, abs=1e-9)


def test_touching_cradle_of_poisson():
    """Compression makes all balls equally fast, 1/5, with impulses 4/5 ... 1/5; expansion gives them again."""
    v, energy = speeds(cradle(0.0), "poisson")
    assert v.sum() == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(v, (-3 / 5, 2 / 5, 2 / 5, 2 / 5, 2 / 5), rtol=0, atol=1e-9)
    assert energy <= 1.0 + 1e-12


@pytest.mark.parametrize("law", LAWS)
def test_bounces_end_when_zeno_says(law):
    """After √(2H/g) (1 + e)/(1 - e), less the bounces slower than 2 g dt, 4 dt at most."""
    height, e = 0.2, 0.5
    end = math.sqrt(2 * height / g) * (1 + e) / (1 - e)
    for dt in (4e-3, 1e-3):
        ball = nd.simulate(nd.scenes.load("bounce")(height=height, restitution=e), 0.8, dt=dt, impact=law).body("ball")
        moving = np.flatnonzero(np.abs(ball.linear_velocity[:, 2]) > 1e-9)[-1]
        assert -4 * dt <= (moving + 1) * dt - end <= dt
        assert ball.position[-1, 2] == pytest.approx(0.1, abs=1e-9)


@pytest.mark.parametrize("law", LAWS)
def test_what_rests_does_not_chatter(law):
    scene = nd.Scene()
    material = nd.Material(0.5, 0.8)
    scene.add_halfspace("ground", material=material)
    for k in range(4):
        scene.add_box(f"b{k}", (0.2, 0.2, 0.2), 1.0, position=(0, 0, 0.1 + 0.2 * k), material=material)
    trajectory = nd.simulate(scene, 0.5, dt=1e-2, impact=law)
    assert np.abs(trajectory.v[1:]).max() < 1e-8
    np.testing.assert_allclose(trajectory.contacts(-1).impulse[:, 0].sum(), 10 * g * 1e-2, rtol=1e-6)


def test_what_no_longer_rebounds_comes_to_rest_at_once():
    """Boxes that settle on each other: without it, an impact stops one face and sets off the next, for 60 rounds."""
    scene, material = nd.Scene(), nd.Material(0.5, 0.3)
    scene.add_halfspace("ground", material=material)
    for k in range(3):
        place = (0.01 * k, 0, 0.1 + 0.2 * k + 0.02 * (k + 1))
        scene.add_box(f"b{k}", (0.2, 0.2, 0.2), 1.0, position=place, material=material)

    class Counted(nd.solvers.Auto):
        """The solver, with the calls by impacts; moves have others."""

        count = 0

        def __call__(self, problem, r0=None):
            Counted.count += 1
            return super().__call__(problem, r0)

    stepper, counts = nd.Stepper(scene, dt=5e-3, solver=Counted()), []
    for _ in range(200):
        step = stepper.step()
        counts.append(Counted.count)
    assert np.diff(counts).max() < 400  # 67, and 3608 without
    assert np.abs(step.v).max() < 1e-8


@pytest.mark.parametrize("law", LAWS)
def test_round_off_of_parted_balls_is_no_failure(law):
    """Two balls strike three that touch. What parts leaves velocities of round-off, beside which old impulses count."""
    scene, material = nd.Scene(gravity=(0, 0, 0)), nd.Material(0.0, 1.0)
    for k in range(5):
        struck = k > 1
        place, speed = 0.2 * k - 0.05 * (not struck), float(not struck)
        scene.add_sphere(f"b{k}", 0.1, 1.0, position=(place, 0, 0), linear_velocity=(speed, 0, 0), material=material)
    stepper = nd.Stepper(scene, dt=7e-3, impact=law, on_fail="raise")
    for _ in range(30):
        step = stepper.step()
        assert step.solution.status is nd.Status.CONVERGED
    assert step.v[0::6].sum() == pytest.approx(2.0, abs=1e-12)


@pytest.mark.parametrize("given", ["hooke", nd.impacts.Newton, None, nd.solvers.Auto()])
def test_what_is_no_law_is_refused(given):
    with pytest.raises(ValueError, match=f"impact must be one of {', '.join(LAWS)}"):
        nd.Stepper(nd.scenes.load("bounce")(), impact=given)


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (lambda r, solved: (np.nan * r, solved), r"must return \(3 finite impulses, .*\), got \(array\(\[nan"),
        (lambda r, solved: (r[:2], solved), "must return .3 finite impulses"),
        (lambda r, solved: (1j * r, solved), "must return .3 finite impulses"),
        (lambda r, solved: (r, []), "must return .3 finite impulses, a list of the problems solved"),
        (lambda r, solved: None, "must return .3 finite impulses, .* got None"),
    ],
)
def test_what_a_law_of_the_user_answers_is_checked(answer, words):
    class Own(nd.impacts.Newton):
        def __call__(self, impact):
            return answer(*super().__call__(impact))

    with pytest.raises(ValueError, match=rf"^test_impacts\.py, line \d+: Own {words}"):
        nd.simulate(nd.scenes.load("bounce")(height=0.01), 0.2, dt=1e-2, impact=Own())


def test_errors_of_a_law_of_the_user_are_its_own():
    class Own(nd.impacts.Newton):
        def takes_part(self, hit, restitution):
            return 1

    class Broken(nd.impacts.Newton):
        def __call__(self, impact):
            return 1 / 0

    bounce = nd.scenes.load("bounce")
    with pytest.raises(ValueError, match=r"takes_part of Own must return 1 booleans, got 1"):
        nd.simulate(bounce(height=0.01), 0.2, dt=1e-2, impact=Own())
    with pytest.raises(ZeroDivisionError) as failure:
        nd.simulate(bounce(height=0.01), 0.2, dt=1e-2, impact=Broken())
    assert "in Broken" in failure.value.__notes__[0]


def test_a_law_is_an_object():
    """As solvers are: equal where their options are, told by a recording."""
    run = nd.simulate(nd.scenes.load("bounce")(), 0.01, dt=1e-3, impact=nd.impacts.Poisson())
    assert run.meta["impact"] == "Poisson()" and nd.impacts.Poisson() == LAWS["poisson"]()
    assert nd.simulate(nd.scenes.load("bounce")(), 0.01, dt=1e-3).meta["impact"] == "Dissipative()"


def rail(e, elevation, azimuth, mu):
    """A ball on a prismatic joint that runs down into the floor: W of its contact has rank one."""
    model = pin.Model()
    level = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    along = np.cos(elevation) * level - np.sin(elevation) * np.array([0.0, 0.0, 1.0])
    hang(model, 0, "slide", pin.JointModelPrismaticUnaligned(along), pin.Inertia.FromSphere(1.0, 0.1), (0, 0, 0.2))
    model.addBodyFrame("tip", 1, pin.SE3.Identity(), 0)
    scene, material = nd.Scene(), nd.Material(mu=mu, restitution=e)
    scene.add_halfspace("ground", material=material)
    scene.add_model("r", model, v=[1.0], collisions={"tip": [shapes.sphere(0.1)]}, material=material)
    return scene


@pytest.mark.parametrize("e", [0.0, 0.5])
def test_what_friction_jams_on_a_rail_comes_to_rest(e):
    """Where the rail is flat no velocity rebounds: friction is as strong as the impact, and no restitution is left."""
    for elevation, azimuth, mu in (
        (0.3, 0.7, 3.0),
        (0.26, 0.0, 3.0),
        (1.2, 2.0, 0.5),
        (0.5, 4.0, 1.0),
        (0.9, 1.0, 1.0),
    ):
        run = nd.simulate(rail(e, elevation, azimuth, mu), 0.4, dt=5e-3, on_fail="raise")
        assert set(run.solver.status_names) == {"CONVERGED"}
        assert nd.check(run).passed and run.energy.normal.max() <= 0.0
        assert abs(run.body("r/tip").position[-1, 2] - 0.1) <= (1e-9 if e == 0.0 else 0.02)


def hinges(count, limits, q, v, inertia=1.0, **laws):
    """Links on hinges about parallel axes, 0.3 m apart, between limits; no gravity."""
    model = serial([pin.JointModelRZ()] * count, lump(1.0, inertia), (0.3, 0, 0))
    model.lowerPositionLimit, model.upperPositionLimit = (np.full(count, x) for x in limits)
    scene = nd.Scene(gravity=(0, 0, 0))
    scene.add_model("arm", model, q=q, v=v, **laws)
    return scene


@pytest.mark.parametrize("e", [0.3, 1.0])
@pytest.mark.parametrize("c", [0.0, 20.0])
def test_a_captured_impact_responds_by_the_mass_alone(e, c):
    """A damped joint of 1 kg m² that meets its limit at 3 rad/s within 10 ms: (1 + e) 3 N m s, whatever the damping.

    The damping acts on the rebound, as it would in a move without an impact: v⁺ = -e v (1 - a) / (1 + a), a = h c / 2.
    """
    v, h, a = 3.0, 1e-2, 0.5 * 1e-2 * c
    stepper = nd.Stepper(hinges(1, (-9.0, 0.0), [-0.01], [v], damping=[c], restitution=e), h)
    begin = stepper.get_state().instant
    s = stepper.system.during(0.0, h, begin.position)
    move = try_move(s.capturing, lambda t: None, begin, 0.0, h, None)
    result = finish(s, begin, move)
    after, (acted,) = -e * v * (1.0 - a) / (1.0 + a), result.done
    assert result.end.v[0] == pytest.approx(after, rel=1e-12)
    assert acted.joints[1, 0] == pytest.approx(-(1.0 + e) * v, rel=1e-12)
    assert acted.works.normal == pytest.approx(0.5 * (e**2 - 1.0) * v**2, rel=1e-12, abs=1e-12)
    assert acted.works.damping == pytest.approx(0.5 * (after**2 - (e * v) ** 2), rel=1e-12, abs=1e-12)
    assert abs(acted.works.integration) < 1e-12


@pytest.mark.parametrize(("e", "limit"), [(1.0, None), (0.6, None), (1.0, 3.0)])
def test_captured_impacts_of_damped_and_controlled_joints(e, limit, monkeypatch):
    """Two links rattle between their limits, with no impact located: laws of the velocity give no energy.

    And the audit passes, also with an actuator at its limit.
    """
    monkeypatch.setattr(substepping, "OPTIONS", dataclasses.replace(substepping.OPTIONS, work=7))
    law = nd.PD(kp=20.0, kd=0.5, target=0.0, limit=limit)
    scene = hinges(2, (-0.3, 0.3), [0.1, -0.1], [30.0, -50.0], 0.01, damping=[0.1, 0.1], restitution=e)
    run = nd.simulate(scene, 0.1, 2e-3, controller=lambda t, q, v: {"arm": law})
    energy = run.energy
    assert run.columns["joints/struck"].any()
    # An actuator at its limit is an impulse of the move, of which captured impacts keep the first-order error.
    assert limit or energy.integration.cumsum().max() < 1e-12 * energy.kinetic[0]
    assert (energy.damping <= 0.0).all() and np.abs(energy.defect).max() < 1e-12 * energy.kinetic[0]
    assert nd.check(run).passed


def under_a_roof(e):
    """A ball without friction that gravity parts from a roof as it presses it on the floor."""
    scene, material = nd.Scene(), nd.Material(mu=0.0, restitution=e)
    scene.add_halfspace("floor", material=material)
    scene.add_box("roof", (1, 1, 0.2), position=(0, 0, 0.7), fixed=True, material=material)
    scene.add_sphere("ball", 0.1, 1.0, position=(0, 0, 0.3), linear_velocity=(0, 0, 5.0), material=material)
    return scene


@pytest.mark.parametrize("dt", [4e-3, 1e-3])
@pytest.mark.parametrize("what", ["spring", "force", "gravity"])
def test_forces_that_part_what_is_struck_give_captured_impacts_no_energy(what, dt, monkeypatch):
    """An elastic hinge or ball rattles between two stops, with no impact located: it had gained h f v in each."""
    monkeypatch.setattr(substepping, "OPTIONS", dataclasses.replace(substepping.OPTIONS, work=7))
    hinge = hinges(1, (-0.3, 0.3), [0.0], [10.0], stiffness=[30.0 if what == "spring" else 0.0], restitution=1.0)
    scene = under_a_roof(1.0) if what == "gravity" else hinge
    controller = (lambda t, q, v: {"arm": [-30.0]}) if what == "force" else None
    run = nd.simulate(scene, 0.5, dt, controller=controller)
    energy = run.energy
    total = energy.kinetic + energy.potential - np.append(0.0, energy.external.cumsum())
    v = run.v[:, -1] if what != "gravity" else run.v[:, 2]
    assert (np.diff(np.sign(v)) != 0.0).sum() >= 4
    assert np.abs(total - total[0]).max() < 1e-11 * total[0]
    assert np.abs(energy.integration).max() < 1e-11 * total[0] and np.abs(energy.defect).max() < 1e-12 * total[0]
    assert nd.check(run).passed


@pytest.mark.parametrize("dt", [4e-3, 1e-3])
def test_what_is_parted_while_it_is_struck_leaves_as_if_located(dt, monkeypatch):
    """A hinge that its spring draws from its stop leaves it as fast as where the impact is located: e of its speed.

    By up to a sixtieth of the work h f v of the spring in a step. It had been off by a third.
    """
    monkeypatch.setattr(substepping, "OPTIONS", dataclasses.replace(substepping.OPTIONS, work=7))
    e, at, f = 0.9, 0.5 * 100.0 * 0.28**2, 100.0 * 0.28
    run = nd.simulate(hinges(1, (-0.28, 0.28), [0.0], [3.0], stiffness=[100.0], restitution=e), 0.25, dt)
    energy = run.energy.kinetic[-1] + run.energy.potential[-1]
    assert abs(energy - (at + e**2 * (4.5 - at))) < dt * f * math.sqrt(9.0 - 2.0 * at) / 60.0


def test_captured_impacts_follow_each_other_as_located_ones_do(monkeypatch):
    """A rod lands with one end before the middle of a step and the other after it: the first impact drives the second.

    Both at once would end with other velocities. The rod turns by 0.01 rad meanwhile, which captured impacts neglect.
    """
    scene, tilt = nd.Scene(gravity=(0, 0, 0)), 0.005
    scene.add_halfspace("ground", material=nd.Material(0.0, 0.8))
    rod = {"quaternion": (0.0, math.sin(0.25 * math.pi + 0.5 * tilt), 0.0, math.cos(0.25 * math.pi + 0.5 * tilt))}
    at = {"position": (0, 0, 0.0545), "linear_velocity": (0, 0, -1.0)}  # the ends have gaps of 2 and 7 mm
    scene.add_capsule("rod", 0.05, 0.5, 1.0, **at, **rod, material=nd.Material(0.0, 0.8))
    located = nd.Stepper(scene, dt=1e-2).step()
    monkeypatch.setattr(substepping, "OPTIONS", dataclasses.replace(substepping.OPTIONS, work=1))
    captured = nd.Stepper(scene, dt=1e-2).step()
    assert captured.contact_duration.tolist() == [1e-2, 1e-2] and located.contact_duration.max() < 1e-2
    np.testing.assert_allclose(captured.v, located.v, rtol=0.0, atol=1e-3)
