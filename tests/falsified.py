"""True recordings, and what falsifies them: changes of their columns, scenes or attributes."""

import copy
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pinocchio as pin
from mechanisms import add, at, four_bars, hang, limit, lump, rod, serial

import nsdyn as nd
from nsdyn.recording.retrace import trees
from nsdyn.recording.trajectory import Trajectory
from nsdyn.scene import shapes


def _arm():
    """Three links with limits and dry friction that fall on the ground and against their limits."""
    model = limit(serial([pin.JointModelRY()] * 3, lump(1.0, 1 / 50, (0, 0, -0.2)), (0, 0, -0.4)), -0.5, 0.9)
    scene, material = nd.Scene(name="arm"), nd.Material(mu=0.5)
    scene.add_halfspace("ground", offset=-1.1, material=material)
    capsule = shapes.capsule(0.03, 0.3), at((0, 0, -0.2))
    scene.add_model(
        "arm",
        model,
        q=[0.8, 0.3, 0.2],
        v=[-4.0, 0.0, 0.0],
        collisions={f"j{k}": [capsule] for k in range(3)},
        material=material,
        self_collisions=False,
        friction=[0.1] * 3,
        damping=[0.05] * 3,
        stiffness=[2.0] * 3,
        restitution=0.3,
    )
    return nd.simulate(scene, 0.35, 5e-3)


def _named(name, seconds, dt, speed=0.0):
    """A named scene under its own control, begun with a velocity of its first articulation, m/s and rad/s."""
    setup = nd.scenes.setup(name)
    if speed:
        (key, first), *_ = setup.scene.articulations.items()
        setup.scene.articulations[key] = replace(first, v=speed * np.cos(np.arange(first.model.nv)))
    return nd.simulate(setup.scene, seconds, **setup.options(dt=dt))


def _bars():
    """A closed loop that turns."""
    model, loops, v = four_bars(1)
    scene = nd.Scene(name="bars")
    add(scene, "bars", model, v=v, loops=loops)
    return nd.simulate(scene, 0.1, 2e-3)


def _cart():
    """A pendulum on a driven cart, which strikes nothing."""
    model = pin.Model()
    cart = hang(model, 0, "cart", pin.JointModelPX(), lump(2.0, 0.01))
    hang(model, cart, "pole", pin.JointModelRY(), rod((0, 0, -1)))
    scene = nd.Scene(name="cart")
    add(scene, "cart", limit(model), q=(0.0, 1.0), v=(1.5, 2.0))
    scene.set_motion("cart/cart", velocity=1.5)
    return nd.simulate(scene, 0.1, 5e-3)


def _machine():
    """A geared arm under a saturated motor, with a forearm that is pushed and strikes its limits."""
    model = limit(serial([pin.JointModelRY()] * 3, rod((0, 0, -0.5)), (0, 0, -0.5)))
    model.lowerPositionLimit[2], model.upperPositionLimit[2] = -0.3, 0.3
    scene = nd.Scene(name="machine")
    add(
        scene,
        "machine",
        model,
        q=[0.4, -0.1, 0.2],
        v=[1.0, -0.5, 2.5],
        armature=0.02,
        friction=[0.0, 0.0, 0.05],
        damping=0.02,
        stiffness=1.0,
        rest=0.1,
        restitution=0.3,
    )
    scene.add_gear("machine", "j0", "j1", -0.5)
    motor = nd.PD(kp=[40.0, 0.0, 0.0], kd=[1.0, 0.0, 0.0], target=[0.8, 0.0, 0.0], limit=3.0)
    return nd.simulate(
        scene,
        0.15,
        5e-3,
        controller=lambda t, q, v: {"machine": motor},
        external_force=lambda t, q, v: {"machine/j2": (1.0 + t, 0.0, 0.0)},
    )


def _crank():
    """A rod on a crank that turns to and fro, between limits."""
    model = limit(serial([pin.JointModelRY()] * 2, rod((0, 0, -0.5)), (0, 0, -0.5)))
    model.lowerPositionLimit[1], model.upperPositionLimit[1] = -0.2, 0.2
    scene = nd.Scene(name="crank")
    add(scene, "crank", model, v=[0.0, 2.0], damping=0.02)
    scene.set_motion("crank/j0", velocity=lambda t: 2.0 * np.sin(20.0 * t))
    return nd.simulate(scene, 0.3, 5e-3)


def _snake():
    """Ball joints and hinges that strike the ground in the middle of a step, pushed all along."""
    rng, model, parent = np.random.default_rng(3), pin.Model(), 0
    kinds = pin.JointModelFreeFlyer, pin.JointModelSpherical, pin.JointModelRX, pin.JointModelSpherical
    link = pin.Inertia(0.5, np.array([0, 0, -0.15]), np.diag([3.75e-3, 3.75e-3, 2e-4]))
    for k, kind in enumerate(kinds):
        parent = hang(model, parent, f"s{k}", kind(), link, (0, 0, -0.3 if k else 0))
    limit(model)
    q = pin.integrate(model, pin.neutral(model), 0.4 * rng.normal(size=model.nv))
    q[:3] = 0.0, 0.0, 1.25
    scene, material = nd.Scene(name="snake"), nd.Material(mu=0.3)
    scene.add_halfspace("ground", material=material)
    capsule = shapes.capsule(0.03, 0.24), at((0, 0, -0.15))
    scene.add_model(
        "snake",
        model,
        q=q,
        v=0.5 * rng.normal(size=model.nv),
        collisions={f"s{k}": [capsule] for k in range(len(kinds))},
        material=material,
        limits=False,
        self_collisions=False,
        damping=[0.0] * 6 + [0.01] * (model.nv - 6),
    )
    return nd.simulate(scene, 0.48, 5e-3, external_force=lambda t, q, v: {"snake/s3": (np.sin(9 * t), 0.5, 0.0)})


def _ball():
    """A link on a ball joint with dry friction."""
    model = pin.Model()
    hang(model, 0, "ball", pin.JointModelSpherical(), rod((0, 0, -0.5)))
    scene = nd.Scene(name="ball")
    add(scene, "ball", limit(model), v=(1.0, 2.0, 0.5), limits=False, friction=0.2)
    return nd.simulate(scene, 0.1, 5e-3)


def _boxes(theta=0.5):
    """What slides, rests, rolls and tumbles."""
    scene = nd.Scene(name="boxes")
    scene.add_halfspace("ground", material=nd.Material(mu=0.4))
    scene.add_box("box", (0.2, 0.2, 0.1), 1.0, position=(0, 0, 0.05), linear_velocity=(1, 0.3, 0))
    scene.add_sphere("ball", 0.05, 0.3, position=(0, 0, 0.15), linear_velocity=(1, 0.3, 0))
    scene.add_cylinder("can", 0.05, 0.1, 0.2, position=(0.5, 0, 0.05))
    scene.add_box("tumbling", (0.1, 0.15, 0.2), 1.0, position=(-0.5, 0, 0.3), angular_velocity=(3, 4, -2))
    scene.add_ellipsoid("egg", (0.05, 0.06, 0.08), 0.5, position=(0.9, 0, 0.12), angular_velocity=(3, 4, -2))
    return nd.simulate(scene, 0.2, dt=2e-3, theta=theta)


def _bounces(impact="dissipative"):
    """A ball and a box that bounce and roll with spin."""
    scene, material = nd.Scene(name="bounces"), nd.Material(mu=0.3, restitution=0.5)
    scene.add_halfspace("ground", material=material)
    move = {"linear_velocity": (1, 0, 0), "angular_velocity": (0, -30, 5)}
    scene.add_sphere("ball", 0.05, 1.0, position=(0, 0, 0.08), material=material, **move)
    move = {"linear_velocity": (-0.5, 0, -1), "angular_velocity": (1, 2, 3)}
    turned = {"position": (0.6, 0, 0.3), "quaternion": (0.5, 0.1, 0.5, 0.7)}
    scene.add_box("box", (0.1, 0.2, 0.15), 2.0, material=material, **turned, **move)
    return nd.simulate(scene, 0.3, dt=5e-3, impact=impact)


RUNS = {
    "arm": _arm,
    "ball": _ball,
    "bars": _bars,
    "cart": _cart,
    "quadruped": lambda: _named("quadruped", 0.15, 5e-3, 0.3),
    "gripper": lambda: _named("gripper", 0.7, 1e-2),
    "woodpecker": lambda: _named("woodpecker", 0.02, 2e-4),
    "machine": _machine,
    "crank": _crank,
    "snake": _snake,
    "slider crank": lambda: _named("slider_crank", 0.07, 1e-3),
    "pushes": lambda: _named("arm_pushes_box", 0.4, 5e-3),
    "boxes": _boxes,
    "theta": lambda: _boxes(0.8),
    "bounces": _bounces,
    "fremond": lambda: _bounces("fremond"),
}


@cache
def true(name):
    """A recording that passes."""
    return RUNS[name]()


def false(kind, name):
    """A recording of a run, falsified by a kind of `KINDS`. Changes find its attributes at ``scene["meta"]``."""
    change = KINDS[kind][1]
    t = true(name)
    out = Trajectory(dict(t.meta), copy.deepcopy(t.scene), {key: values.copy() for key, values in t.columns.items()})
    out.scene["meta"] = out.meta
    change(out.columns, out.scene)
    del out.scene["meta"]
    same = all(np.array_equal(values, t.columns[key], equal_nan=True) for key, values in out.columns.items())
    assert not same or (out.scene, out.meta) != (t.scene, t.meta), "nothing was changed"
    return out


def _times(key, factor, where=...):
    def change(c, scene):
        c[key][where] *= factor

    return change


def _plus(key, more, where=...):
    def change(c, scene):
        c[key][where] += more

    return change


def _all(*changes):
    def change(c, scene):
        for one in changes:
            one(c, scene)

    return change


def _each(name, factor):
    """Of steps and of their pieces."""
    return _all(*(_times(f"{group}/{name}", factor) for group in ("joints", "pieces")))


def _model(key, factor):
    """Another value in the model, of all joints or of the articulation."""

    def change(c, scene):
        for tree in scene["articulations"]:
            told = tree["model"]
            if key in told:
                told[key] = [factor * x for x in told[key]]
            for joint in told["joints"]:
                if key in joint:
                    joint[key] = (factor * np.array(joint[key])).tolist()

    return change


def _told(new, *path):
    """Another value in the model of the first articulation, as a function of the one there."""

    def change(c, scene):
        *outer, last = path
        told = scene["articulations"][0]["model"]
        for key in outer:
            told = told[key]
        told[last] = new(told[last])

    return change


def _swapped(key, i, j):
    def change(c, scene):
        c[key][..., [i, j]] = c[key][..., [j, i]]

    return change


def _exchanged(key, i, j):
    def change(c, scene):
        c[key][[i, j]] = c[key][[j, i]]

    return change


def _reversed(*keys):
    def change(c, scene):
        for key in keys:
            c[key] = c[key][::-1].copy()

    return change


def _moved(key):
    """One step's values into the next."""

    def change(c, scene):
        c[key] = np.roll(c[key], 1, axis=0)

    return change


def _booked(source, into, share=1.0):
    """The works of one column in another."""

    def change(c, scene):
        moved = share * c[f"energy/{source}"]
        assert np.abs(moved).max() > 1e-6 * np.ptp(c["energy/kinetic"])
        c[f"energy/{source}"] -= moved
        c[f"energy/{into}"] += moved

    return change


def _states(c):
    """Columns of states."""
    return [c[key] for key in ("q", "v", "frames/x", "frames/quat") if key in c]


def _interpolated(c, scene):
    """A state between its neighbours."""
    for key in ("q", "v"):
        c[key][20] = 0.5 * (c[key][19] + c[key][21])


def _frozen(c, scene):
    """A link that stays where it was while its joint moves."""
    for key in ("frames/x", "frames/quat"):
        c[key][30:, -1] = c[key][30, -1]


def _other_contact(c, scene):
    """Impulses of two contacts of a step for one another."""
    r, offset = c["contacts/impulse"], c["contacts/offset"]
    for k in range(len(offset) - 1):
        rows = np.arange(offset[k], offset[k + 1])
        strong = rows[np.argsort(-r[rows, 0])]
        if strong.size > 1 and abs(r[strong[0], 0] - r[strong[1], 0]) > 1e-3 * r[strong[0], 0]:
            r[strong[:2]] = r[strong[:2]][::-1]
            return
    raise AssertionError("no two contacts")


def _slower(c, scene):
    """The whole motion at half the speed: times, velocities and impulses."""
    for key in c:
        if key == "v" or (
            key.startswith(("joints/", "pieces/")) and key.split("/")[1] in ("actuation", "limit", "friction")
        ):
            c[key] *= 0.5
    c["contacts/impulse"] *= 0.5
    c["energy/kinetic"] *= 0.25


def _skipped(c, scene):
    """A step left out, and the last one twice."""
    for values in _states(c):
        values[10:-1] = values[11:]


def _shifted(source, into, share, step, joint, pieces=False):
    """Impulses of one kind said to be of another, which does the same to the motion."""

    def change(c, scene):
        moved = share * np.abs(c[f"joints/{source}"]).max()
        parts = range(*c["pieces/offset"][step : step + 2])
        assert len(parts) == 0 or pieces
        for group, row in [("joints", step), *[("pieces", p) for p in parts if c["pieces/duration"][p] > 0.0][:1]]:
            c[f"{group}/{source}"][row, joint] -= moved
            c[f"{group}/{into}"][row, joint] += moved

    return change


def _between_pieces(name, share, *joint):
    """More in one piece of a step, and less in another."""

    def change(c, scene):
        values = c[f"pieces/{name}"]
        for first, last in pairwise(c["pieces/offset"]):
            moving = [p for p in range(first, last) if c["pieces/duration"][p] > 0.0]
            if len(moving) > 1 and values[(moving[0], *joint)] != 0.0:
                moved = share * np.abs(values[(moving, *joint)]).max()
                values[(moving[:2], *joint)] += moved, -moved
                return
        raise AssertionError("no step was cut")

    return change


def _turned_frames(c, scene):
    """A link turned by 1e-9 rad, about its own axis."""
    half = 5e-10
    x, y, z, w = c["frames/quat"][:, -1].T
    c["frames/quat"][:, -1] = np.array([x + half * y, y - half * x, z + half * w, w - half * z]).T


def _turned_axis(place):
    """An axis turned by 1e-5 rad."""
    pose = np.array(place)
    pose[:3, :3] = pose[:3, :3] @ pin.exp3(np.array([0.0, 0.0, 1e-5]))
    return pose.tolist()


def _in_loop(c, scene):
    """Joint forces that the loop takes up, without any motion."""
    t = true("bars")
    m = trees(t).mechanisms[0]
    for k in range(5, 8):
        c["joints/actuation"][k] += 1e-6 * m.constraints(trees(t).way(0, k).kicks[0].q)[1][0]


def _along_normals(c, scene):
    """Points of impulses off both bodies, where their moments cancel."""
    c["contacts/point"] += 1e-3 * c["contacts/normal"]


def _spun(quaternion):
    turned = pin.Quaternion(quaternion) * pin.Quaternion(pin.exp3(np.array([0.0, 0.0, 1e-7])))
    quaternion[:] = turned.coeffs()


def _spread(c, scene):
    """A tenth of the largest impulse in the next step."""
    r, offset = c["contacts/impulse"], c["contacts/offset"]
    most = int(r[:, 0].argmax())
    following = int(offset[np.searchsorted(offset, most, side="right")])
    r[following] += 0.1 * r[most]
    r[most] *= 0.9


def _rougher(c, scene):
    """Friction of all materials larger, where what slides shows how large it is."""
    for geom in scene["geoms"]:
        geom["mu"] *= 1.2
    c["contacts/mu"] *= 1.2


def _lifted_aside(c, scene):
    """A free body across the normals of its contacts in the last state, to which a projection is said to lift it."""
    h = c["t"][-1] - c["t"][-2]
    c["q"][-1, 1] += 1e-6
    shift = np.zeros((1, 6))
    shift[0, 1] = 1e-6
    for name, more in (("body", [0]), ("time", [0.5 * h]), ("duration", [h]), ("shift", shift)):
        c[f"lifts/{name}"] = np.concatenate([c[f"lifts/{name}"], more]).astype(c[f"lifts/{name}"].dtype)
    c["lifts/offset"][-1] += 1


def _strongest(c):
    """Rows of contacts, the largest normal impulses first."""
    return np.argsort(-c["contacts/impulse"][:, 0], kind="stable")


def _strong(key, change, component=()):
    """Another value at the contact with the largest impulse, a number or a component."""

    def out(c, scene):
        place = (_strongest(c)[0], *component)
        c[f"contacts/{key}"][place] = change(c[f"contacts/{key}"][place])

    return out


def _busiest(c):
    """Rows of the contacts of the step with most that push."""
    offset, pushes = c["contacts/offset"], c["contacts/impulse"][:, 0] > 0.0
    count = [int(pushes[a:b].sum()) for a, b in pairwise(offset)]
    k = int(np.argmax(count))
    return np.arange(offset[k], offset[k + 1])


def _two(key, least=1e-9):
    """Values of two contacts of a step for one another, where they differ most."""

    def change(c, scene):
        x, best = c[f"contacts/{key}"], (least, 0, 0)
        for a, b in pairwise(c["contacts/offset"]):
            for i in range(a, b - 1):
                apart = np.abs(x[i + 1 : b] - x[i]).reshape(b - i - 1, -1).max(axis=1)
                if apart.max() > best[0]:
                    best = apart.max(), i, i + 1 + apart.argmax()
        _, i, j = best
        assert i != j, "no two contacts differ"
        x[[i, j]] = x[[j, i]]

    return change


def _worked(name, factor, into=None):
    """Work of the contact with the most, elsewhere in its step or nowhere; the ledger with it if asked."""

    def change(c, scene):
        work = c[f"contacts/work_{name}"]
        row = int(np.abs(work).argmax())
        more = factor * work[row]
        assert more != 0.0
        work[row] += more
        if into == "ledger":
            step = int(np.searchsorted(c["contacts/offset"], row, side="right")) - 1
            c[f"energy/{name}"][step] += more
            c["energy/integration"][step] -= more
        elif into == "other":
            rows = _busiest(c)
            row = rows[0] if rows[0] != row else rows[-1]
            work[row] -= more

    return change


def _geoms(key, change, where=lambda geom: True):
    """Another value of all shapes of a kind."""

    def out(c, scene):
        changed = [geom for geom in scene["geoms"] if key in geom and where(geom)]
        assert changed
        for geom in changed:
            geom[key] = change(geom[key])

    return out


def _scaled(factor):
    return lambda x: (factor * np.array(x)).tolist()


def _longer(size):
    return [size[0] * 1.001, *size[1:]]


def _turned_place(place):
    out = np.array(place)
    out[:3, :3] *= 1.0 + 1e-6
    return out.tolist()


def _moved_place(place):
    out = np.array(place)
    out[:3, 3] += 1e-4
    return out.tolist()


def _free(key, change):
    def out(c, scene):
        scene[key] = [change(x) for x in scene[key]]

    return out


def _lopsided(inertia):
    out = np.array(inertia)
    out[0, 1] += 1e-3 * out[0, 0]
    return out.tolist()


def _thin(inertia):
    out = np.array(inertia)
    out[2, 2] = 3.0 * out.max()
    return out.tolist()


def _attribute(key, change):
    def out(c, scene):
        scene["meta"][key] = change(scene["meta"][key])

    return out


def _one_state(body, more, speed=False):
    """A free body elsewhere, or faster, in one state in the middle."""

    def change(c, scene):
        k, place = len(c["t"]) // 2, (6 if speed else 7) * body
        c["v" if speed else "q"][k, place] += more
        if not speed and "frames/x" in c:
            c["frames/x"][k, body, 0] += more

    return change


def _from(body, more):
    """A free body elsewhere from the middle on."""

    def change(c, scene):
        k = len(c["t"]) // 2
        c["q"][k:, 7 * body + 1] += more
        if "frames/x" in c:
            c["frames/x"][k:, body, 1] += more

    return change


def _doubled(c, scene):
    """A state twice, and one left out."""
    k = len(c["t"]) // 2
    for values in _states(c):
        values[k] = values[k - 1]


def _smoothed(c, scene):
    """Velocities as the mean of their neighbours, from the second on."""
    c["v"][1:-1] = (c["v"][:-2] + c["v"][1:-1] + c["v"][2:]) / 3.0


def _as_differences(c, scene):
    """Velocities of the first free body as differences of its places."""
    x, h = c["q"][:, :3], c["t"][1]
    c["v"][1:, :3] = np.diff(x, axis=0) / h


def _spinless(c, scene):
    """Angular velocities left out in one state."""
    k = len(c["t"]) // 2
    c["v"][k, 3:6] = 0.0


def _one_tangent(c, scene):
    """The second axis of one contact for the first."""
    row = _strongest(c)[0]
    c["contacts/tangent"][row] = np.cross(c["contacts/normal"][row], c["contacts/tangent"][row])


def _other_side(c, scene):
    """Both shapes of a contact for one another."""
    row, (a, b) = _strongest(c)[0], (c["contacts/geom1"], c["contacts/geom2"])
    a[row], b[row] = b[row], a[row]


def _another_body(c, scene):
    """A contact said to be of another body."""
    row, shapes = _strongest(c)[0], len(scene["geoms"])
    own = {int(c["contacts/geom1"][row]), int(c["contacts/geom2"][row])}
    c["contacts/geom2"][row] = next(k for k in range(shapes) if k not in own)


def _with_itself(c, scene):
    row = _strongest(c)[0]
    c["contacts/geom2"][row] = c["contacts/geom1"][row]


def _recounted(c, change, more):
    """Change the columns at the row of the strongest contact, which is returned, and the counts of its step."""
    row = int(_strongest(c)[0])
    step = int(np.searchsorted(c["contacts/offset"], row, side="right")) - 1
    for key in [key for key in c if key.startswith("contacts/") and key != "contacts/offset"]:
        c[key] = change(c[key], row)
    c["contacts/offset"][step + 1 :] += more
    if "pieces/contacts" in c:
        parts = np.arange(*c["pieces/offset"][step : step + 2])
        c["pieces/contacts"][parts[c["pieces/contacts"][parts] > 0][:1]] += more
    return row


def _left_out(c, scene):
    """The strongest contact left out, with its ledger."""
    _recounted(c, lambda values, row: np.delete(values, row, axis=0), -1)


def _twice(c, scene):
    """The strongest contact as two of half its impulse and works, with one key."""
    row = _recounted(c, lambda values, row: np.insert(values, row, values[row], axis=0), 1)
    for name in ("impulse", "work_normal", "work_friction", "couple"):
        c[f"contacts/{name}"][row : row + 2] *= 0.5


def _rebounding(factor):
    """Another restitution of materials and of contacts together."""

    def change(c, scene):
        for geom in scene["geoms"]:
            geom["restitution"] *= factor
        c["contacts/restitution"] *= factor

    return change


def _as_spherical_zyx(c, scene):
    for tree in scene["articulations"]:
        for joint in tree["model"]["joints"]:
            if joint["kind"] == "JointModelSpherical":
                joint["kind"] = "JointModelSphericalZYX"


ALWAYS = slice(None)
FREE, ALL = ("boxes", "theta", "bounces"), ("boxes", "theta", "bounces", "pushes", "quadruped")
TOUCHING = ("boxes", "bounces", "pushes", "quadruped", "snake")
KINDS = {  # (names of runs, change)
    "velocities times 3": ("arm", _times("v", 3.0)),
    "one velocity off by 1e-6": ("arm", _plus("v", 1e-6, (20, 1))),
    "one velocity of a joint turned round": ("arm", _times("v", -1.0, (ALWAYS, 1))),
    "configurations off by 1e-6 in one state": ("arm", _plus("q", 1e-6, (20, 1))),
    "a joint 1 rad beyond its limits": ("arm", _plus("q", 1.0, (ALWAYS, 0))),
    "one joint's sign": ("arm", _all(_times("q", -1.0, (ALWAYS, 1)), _times("v", -1.0, (ALWAYS, 1)))),
    "swapped joints": ("arm", _all(_swapped("q", 0, 1), _swapped("v", 0, 1))),
    "velocities swapped": ("quadruped", _swapped("v", 7, 10)),
    "motion backwards": ("arm", _reversed("q", "v", "frames/x", "frames/quat")),
    "velocities backwards": ("quadruped", _reversed("v")),
    "two steps exchanged": ("arm", _all(_exchanged("q", 20, 21), _exchanged("v", 20, 21))),
    "an arm that stands in one state": ("arm", _times("v", 0.0, 20)),
    "a state between its neighbours": ("arm", _interpolated),
    "a state between its neighbours, with a controller": ("quadruped", _interpolated),
    "a link 0.05 m off its joint": ("arm", _plus("frames/x", 0.05, (ALWAYS, 2, 1))),
    "a link 1e-9 m off its joint in one state": ("arm", _plus("frames/x", 1e-9, (9, 2, 1))),
    "a frozen link": ("arm", _frozen),
    "links turned": ("quadruped", _times("frames/quat", -1.0, (ALWAYS, ALWAYS, 0))),
    "quaternions of links not unit": ("quadruped", _times("frames/quat", 1.0 + 1e-6)),
    "quaternion of a base not unit": ("quadruped", _times("q", 1.0 + 1e-8, (7, slice(3, 7)))),
    "velocity of a base": ("quadruped", _plus("v", 1e-6, (7, 2))),
    "limits that pull": ("arm", _each("limit", -1.0)),
    "limits half as strong": ("arm", _each("limit", 0.5)),
    "limits in mid-range": ("arm", _all(_plus("joints/limit", 0.01, (3, 2)), _plus("v", 0.01, (slice(4, None), 2)))),
    "limits of the model closer": ("arm", _told(lambda x: [-0.3] * 3, "lower")),
    "joint friction that drives": ("arm", _each("friction", -1.0)),
    "joint friction above its bound": ("arm", _each("friction", 1.001)),
    "joint friction in another step": ("arm", _moved("joints/friction")),
    "no joint friction": ("arm", _each("friction", 0.0)),
    "100 N m more of actuation": ("arm", _plus("joints/actuation", 0.5)),
    "actuation where there is no controller": ("arm", _plus("joints/actuation", 1e-6, (slice(5, 8), 1))),
    "actuation of a controller off by a millionth": ("quadruped", _times("joints/actuation", 1.0 + 1e-5)),
    "actuators beyond their limits": ("quadruped", _times("joints/strength", 1e-3)),
    "actuation in another step": ("gripper", _moved("joints/actuation")),
    "external wrenches where there are none": ("quadruped", _plus("joints/external", 1e-4, (slice(5, 8), 1))),
    "contact impulses of robots halved": ("quadruped", _times("contacts/impulse", 0.5)),
    "contact impulses of robots off by 1e-5": ("quadruped", _times("contacts/impulse", 1.0 + 1e-5)),
    "impulses of two contacts exchanged": ("quadruped", _other_contact),
    "impulses of the gripper on other places": ("gripper", _plus("contacts/point", 1e-4)),
    "contact friction turned round": ("gripper", _times("contacts/impulse", -1.0, (ALWAYS, slice(1, 3)))),
    "impulses of a peck later": ("woodpecker", _moved("contacts/impulse")),
    "masses halved in the model": ("arm", _model("mass", 0.5)),
    "masses halved in a standing robot's model": ("quadruped", _model("mass", 0.5)),
    "inertias twice": ("woodpecker", _model("inertia", 2.0)),
    "stiffness off by a thousandth": ("woodpecker", _model("stiffness", 1.001)),
    "damping left out of the model": ("arm", _model("damping", 0.0)),
    "armature added": ("bars", lambda c, s: s["articulations"][0]["model"].update(armature=[1e-4] * 3)),
    "gravity left out of ten steps": ("arm", _plus("v", -1e-3 * 9.81 * 5e-3, slice(10, 20))),
    "gravity of the scene": ("bars", lambda c, s: s.update(gravity=[0.0, 0.0, -9.8])),
    "a loop opened": ("bars", _plus("q", 1e-3, (ALWAYS, -1))),
    "a loop elsewhere": ("bars", _told(lambda x: x + 1e-4, "loops", 0, "placements", 0, 0, 3)),
    "velocities that a loop does not admit": ("bars", _plus("v", 1e-5, (ALWAYS, 1))),
    "a driven joint at another speed": ("cart", _told(lambda x: 1.4, "driven", "cart")),
    "a driven joint off by 1e-6 m/s in one state": ("cart", _plus("v", 1e-6, (5, 0))),
    "another kind of joint": ("arm", _told(lambda x: "JointModelRX", "joints", 1, "kind")),
    "another parent": ("arm", _told(lambda x: 1, "joints", 2, "parent")),
    "kinetic energy edited": ("arm", _times("energy/kinetic", 1.0 + 1e-6)),
    "potential energy of springs left out": ("arm", _model("stiffness", 0.0)),
    "works of friction as of limits": ("arm", _booked("friction", "normal")),
    "works of damping as numerics": ("arm", _booked("damping", "integration")),
    "works of limits as projections": ("arm", _booked("normal", "projection")),
    "works of motors as friction": ("quadruped", _booked("external", "friction")),
    "works of drives as numerics": ("cart", _booked("constraint", "integration")),
    "a tenth of the works of contacts as damping": ("woodpecker", _booked("friction", "damping", 0.1)),
    "works of one contact in another": ("gripper", _plus("contacts/work_friction", 1e-3, 40)),
    "pieces that do not make up their step": ("arm", _times("pieces/duration", 0.99)),
    "times of contacts": ("arm", _times("contacts/time", 1.01)),
    "a defect of the ledger": ("cart", _plus("energy/defect", 1e-6, 3)),
    "half the speed": ("arm", _slower),
    "times": ("bars", _plus("t", 1e-4, slice(10, None))),
    "a step left out": ("bars", _skipped),
    "a displacement as of projections": (
        "arm",
        _all(_plus("q", 1e-4, (slice(10, None), 2)), _plus("joints/shift", 1e-4, (9, 2))),
    ),
    "actuation scaled by a millionth everywhere": ("machine", _each("actuation", 1.0 + 1e-6)),
    "actuation of one joint turned round in one step": ("quadruped", _times("joints/actuation", -1.0, (5, 8))),
    "actuation of two joints exchanged": ("quadruped", _swapped("joints/actuation", 6, 9)),
    "a torque above its limit in one piece": ("machine", _between_pieces("actuation", 1e-6, 0)),
    "a wrench more in one piece and less in another": ("machine", _between_pieces("external", 0.02, 0)),
    "a driven joint faster within a cut step": ("crank", _between_pieces("drive", 1e-5, 0)),
    "a limit in mid-range that an actuator works against": ("machine", _shifted("actuation", "limit", 1e-6, 2, 2)),
    "limits later by a step": ("arm", _all(_moved("joints/limit"), _moved("pieces/limit"))),
    "actuation as of external wrenches": ("quadruped", _shifted("actuation", "external", 1e-6, 5, 8)),
    "external wrenches as of a controller": ("arm", _shifted("friction", "actuation", 1e-6, 4, 0)),
    "dry friction that drives, wrenches against it": ("machine", _shifted("friction", "external", 0.1, 4, 2)),
    "less dry friction, an actuator for it": ("machine", _shifted("friction", "actuation", 1e-4, 4, 2)),
    "a larger bound of dry friction": ("machine", _model("friction", 1.0 + 1e-4)),
    "a ratio of gears": ("machine", _told(lambda x: x + 1e-7, "gears", 0, "ratio")),
    "an offset of gears": ("machine", _told(lambda x: x + 1e-7, "gears", 0, "offset")),
    "forces in a loop, which takes them up": ("bars", _in_loop),
    "a link turned by 1e-9 rad": ("arm", _turned_frames),
    "an axis turned by 1e-5 rad": ("bars", _told(_turned_axis, "joints", 1, "placement")),
    "inertias off by a hundred thousandth": ("machine", _model("inertia", 1.0 + 1e-5)),
    "masses off by a millionth": ("machine", _model("mass", 1.0 + 1e-6)),
    "armature off by a hundred thousandth": ("machine", _model("armature", 1.0 + 1e-5)),
    "springs at rest elsewhere": ("machine", _told(lambda x: [angle + 1e-5 for angle in x], "rest")),
    "a limit farther out than where it acts": ("machine", _told(lambda x: [*x[:2], x[2] + 1e-5], "upper")),
    "a limit closer than where it acts": ("machine", _told(lambda x: [*x[:2], x[2] - 1e-5], "upper")),
    "another restitution of limits": ("machine", _told(lambda e: e + 1e-4, "restitution")),
    "limits that are said not to rebound": ("arm", _told(lambda e: 0.0, "restitution")),
    "points of impulses off the bodies": ("gripper", _along_normals),
    "lengths of pieces": ("machine", _between_pieces("duration", 1e-6)),
    "rougher materials": ("quadruped", _rougher),
    "a box that is not where its frame is": ("gripper", _plus("q", 1e-9, (slice(10, None), 0))),
    "a box that is somewhere else": (
        "gripper",
        _all(_plus("q", 1e-6, (slice(10, None), 1)), _plus("frames/x", 1e-6, (slice(10, None), 0, 1))),
    ),
    "another bound about one axis of a ball joint": ("ball", _told(lambda x: [*x[:2], 1.01 * x[2]], "friction")),
    "less of it": ("ball", _told(lambda x: [*x[:2], 0.99 * x[2]], "friction")),
    "friction of other materials": ("quadruped", _times("contacts/mu", 1.2)),
    "contacts that are said to rebound": ("quadruped", _plus("contacts/restitution", 0.5)),
    "a ball joint turned by 1e-7 rad in one state": ("snake", lambda c, s: _spun(c["q"][40, 7:11])),
    "a blow spread over two steps": ("snake", _spread),
    "moves of contacts that last a hundredth longer": ((*FREE, "quadruped"), _times("contacts/duration", 1.01)),
    "impacts that last": ("bounces", _strong("duration", lambda x: x + 1e-4)),
    "moves that are impacts": ((*FREE, "quadruped"), _times("contacts/duration", 0.0)),
    "a couple that is no number": (("boxes", "theta"), _strong("couple", lambda x: np.nan * x)),
    "a time that is no number": (FREE, _strong("time", lambda x: np.nan * x)),
    "gaps a thousandth larger": ("bounces", _times("contacts/gap", 1.001)),
    "a gap a hundredth of a body deeper": (
        ("boxes", "bounces", "quadruped", "snake"),
        _strong("gap", lambda x: x - 1e-3),
    ),
    "a gap a hundredth of a body wider": (("boxes", "gripper"), _strong("gap", lambda x: x + 1e-3)),
    "gaps in another step": (("bounces", "snake"), _moved("contacts/gap")),
    "gaps exchanged": (("bounces", "pushes", "snake"), _reversed("contacts/gap")),
    "relative velocities doubled": (TOUCHING, _times("contacts/u", 2.0)),
    "relative velocities turned round": (TOUCHING, _times("contacts/u", -1.0)),
    "relative velocities left out": (("boxes", "bounces", "pushes", "snake"), _times("contacts/u", 0.0)),
    "relative velocities in another step": (("bounces", "pushes", "snake"), _moved("contacts/u")),
    "a relative velocity off by 1e-3 m/s": (
        ("gripper", "arm", "snake", "bounces", "pushes"),
        _strong("u", lambda x: x + 1e-3, (0,)),
    ),
    "a contact that is said to be open": (TOUCHING, _strong("status", lambda x: 0)),
    "a contact that is said to jam": (TOUCHING, _strong("status", lambda x: 3)),
    "contacts that slip said to stick": (
        ("boxes", "bounces", "pushes"),
        lambda c, s: c["contacts/status"].__setitem__(c["contacts/status"] == 2, 1),
    ),
    "contacts that stick said to slip": (
        ("boxes", "pushes", "quadruped"),
        lambda c, s: c["contacts/status"].__setitem__(c["contacts/status"] == 1, 2),
    ),
    "states in another step": (("bounces", "pushes", "snake"), _moved("contacts/status")),
    "one key for all": (("boxes", "theta", "pushes", "gripper"), _times("contacts/key", 0)),
    "a tenth of a thousandth of a work of friction": (("pushes", "quadruped", "snake"), _worked("friction", 1e-4)),
    "a work of friction turned round": (TOUCHING, _worked("friction", -2.0)),
    "a work of an impact a thousandth larger": (("bounces", "snake"), _worked("normal", 1e-3)),
    "work of one contact in another of its step": (("boxes", "theta"), _worked("friction", 1e-2, "other")),
    "a work of a contact and of the ledger": (TOUCHING, _worked("friction", 1e-2, "ledger")),
    "works of contacts exchanged": (("boxes", "theta", "pushes"), _two("work_friction")),
    "friction booked as numerics": ((*FREE, "pushes"), _booked("friction", "integration")),
    "friction booked as impacts": (ALL, _booked("friction", "normal")),
    "friction booked as external": (FREE, _booked("friction", "external")),
    "friction booked as damping": (FREE, _booked("friction", "damping")),
    "friction booked as of drives": (FREE, _booked("friction", "constraint")),
    "friction booked as projections": (FREE, _booked("friction", "projection")),
    "impacts booked as friction": (("bounces", "fremond"), _booked("normal", "friction")),
    "impacts booked as numerics": (("bounces", "fremond"), _booked("normal", "integration")),
    "energy said to be created": (ALL, lambda c, s: _plus("energy/created", 1e-3, len(c["energy/created"]) // 2)(c, s)),
    "a couple of its own": (("boxes", "bounces", "theta"), _strong("couple", lambda x: x + 1e-3, (0,))),
    "a couple of a link, or of an impact": (
        ("arm", "snake", "woodpecker", "bounces", "fremond"),
        _strong("couple", lambda x: np.nan_to_num(x) + 1e-6, (0,)),
    ),
    "couples turned round": (("boxes", "theta"), _times("contacts/couple", -1.0)),
    "a point off by a tenth of a millimetre": (TOUCHING, _strong("point", lambda x: x + 1e-4, (0,))),
    "points exchanged": (("boxes", "theta", "pushes"), _two("point")),
    "normal impulses exchanged": (("boxes", "theta", "pushes", "quadruped"), _two("impulse", 1e-6)),
    "half of an impulse of friction left out": (TOUCHING, _strong("impulse", lambda r: 0.5 * r, (slice(1, None),))),
    "impulses a thousandth larger": (TOUCHING, _times("contacts/impulse", 1.001)),
    "axes across a contact exchanged": (TOUCHING, _one_tangent),
    "normals turned round": (TOUCHING, _times("contacts/normal", -1.0)),
    "shapes of a contact exchanged": (TOUCHING, _other_side),
    "a contact of another body": (("boxes", "bounces", "pushes", "quadruped"), _another_body),
    "a contact of a body with itself": (TOUCHING, _with_itself),
    "a contact left out": (("boxes", "bounces", "pushes", "quadruped"), _left_out),
    "a contact twice": (("boxes", "bounces", "pushes", "quadruped"), _twice),
    "a coefficient of one contact": (TOUCHING, _strong("mu", lambda x: 1.001 * x)),
    "a restitution of one contact": (TOUCHING, _strong("restitution", lambda x: x + 1e-3)),
    "sizes of boxes": (("boxes", "bounces", "pushes"), _geoms("size", _longer, lambda g: g["shape"] == "box")),
    "corners of boxes": (("boxes", "bounces", "pushes"), _geoms("vertices", _scaled(1.001))),
    "sizes of round shapes": (("boxes", "theta", "quadruped"), _geoms("size", _longer, lambda g: g["shape"] != "box")),
    "sizes that a sphere has not": (
        ("boxes", "bounces"),
        _geoms("size", lambda x: [*x[:2], 0.1], lambda g: g["shape"] == "sphere"),
    ),
    "faces of other corners": (
        ("boxes", "bounces", "pushes"),
        _geoms("faces", lambda x: [[7 - k for k in x[0]], [0, 3, 5, 6], *x[2:]]),
    ),
    "places of shapes that are no poses": (ALL, _geoms("placement", _turned_place)),
    "shapes elsewhere on their bodies": (("boxes", "theta", "bounces", "quadruped"), _geoms("placement", _moved_place)),
    "negative friction of materials": (ALL, _geoms("mu", lambda x: -x)),
    "restitution above 1": (ALL, _geoms("restitution", lambda x: x + 1.0)),
    "masses of bodies a thousandth larger": (FREE, _free("masses", lambda x: 1.001 * x)),
    "inertias of bodies a thousandth larger": (FREE, _free("inertias", _scaled(1.001))),
    "inertias that are lopsided": (FREE, _free("inertias", _lopsided)),
    "inertias that no body has": (FREE, _free("inertias", _thin)),
    "gravity a thousandth larger": (ALL, _free("gravity", lambda x: 1.001 * x)),
    "another theta": (("boxes", "theta", "bounces"), _attribute("theta", lambda x: x + 1e-3)),
    "another step": (ALL, _attribute("dt", lambda x: 1.001 * x)),
    "contacts said not to be recorded": (ALL, _attribute("contacts", lambda x: False)),
    "times shifted by a step": (ALL, lambda c, s: c["t"].__setitem__(slice(1, None), c["t"][:-1].copy())),
    "a body elsewhere in one state": (ALL[:4], _one_state(0, 1e-6)),
    "a body faster in one state": (ALL[:4], _one_state(0, 1e-6, speed=True)),
    "a body lifted aside at the end": ("boxes", _lifted_aside),
    "no lifts": (("theta", "pushes"), _times("lifts/shift", 0.0)),
    "a body elsewhere from the middle on": (ALL[:4], _from(0, 1e-4)),
    "a state twice": (ALL, _doubled),
    "velocities smoothed": (ALL, _smoothed),
    "velocities as differences of places": (("bounces", "theta", "fremond"), _as_differences),
    "a body mirrored": (("boxes", "theta"), _all(_times("q", -1.0, (ALWAYS, 1)), _times("v", -1.0, (ALWAYS, 1)))),
    "spin left out in one state": (("bounces", "fremond"), _spinless),
    "potential energy a thousandth larger": (ALL, _times("energy/potential", 1.001)),
    "kinetic energy in another state": (ALL, _moved("energy/kinetic")),
    "external work and its opposite": (
        FREE,
        _all(_plus("energy/external", 1e-3), _plus("energy/integration", -1e-3)),
    ),
    "projections that lift more": (
        FREE,
        _all(_plus("energy/projection", 1e-3), _plus("energy/integration", -1e-3)),
    ),
    "a frame of a body that is not its own": (("pushes", "gripper"), _plus("frames/x", 1e-9, (5, 0, 2))),
    "balls said to turn about three axes": (("ball", "snake"), _as_spherical_zyx),
    "friction of a driven joint that has none": (("cart", "crank"), _plus("joints/friction", 1e-3, (4, 0))),
    "everything backwards": (("boxes", "bounces", "pushes"), _reversed("q", "v")),
    "materials that are said to rebound more": (("bounces", "fremond"), _rebounding(1.01)),
    "materials that are said not to rebound": (("bounces", "fremond"), _rebounding(0.0)),
}
CASES = [(kind, name) for kind, (names, _) in KINDS.items() for name in ([names] if isinstance(names, str) else names)]
