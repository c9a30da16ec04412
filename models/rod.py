"""Rod sliding with one end on the ground: Painlevé's paradox.

A normal force N and its friction accelerate the end by p N/m along the normal, p = 1 + 3 cos² - 3 mu sin cos (uniform
rod, angle from the ground). Where p < 0, possible for mu > 4/3, no force can hold the end: the rod jams, and an impulse
without a collision stops its slip. With restitution and friction Newton's law may give the rod energy (Kane and
Levinson's paradox): the ledger shows it.

P. Painlevé, Sur les lois du frottement de glissement, C. R. Acad. Sci. Paris 121, 1895. F. Génot, B. Brogliato, New
results on Painlevé paradoxes, Eur. J. Mech. A/Solids 18, 1999.
"""

import math

from nsdyn import Material, Scene

DURATION, DT = 0.3, 1e-3


def scene(
    angle: float = 63.435,
    mu: float = 2.0,
    restitution: float = 0.0,
    slip: float = -1.0,
    fall: float = 0.0,
    spin: float = 0.0,
    length: float = 1.0,
    mass: float = 1.0,
    gravity: float = 9.81,
) -> Scene:
    """Uniform rod of `length` [m] and `mass` [kg], `angle` [deg] steep, its upper end towards +x.

    Its lower end touches the ground at x = 0 and moves at `slip` along x, pushed if negative, and at `fall` downwards
    [m/s], while the rod turns at `spin` [rad/s], positive where the angle grows.
    """
    out = Scene(gravity=(0, 0, -gravity), name="rod")
    material = Material(mu=mu, restitution=restitution)
    out.add_halfspace("ground", material=material)
    a, half = math.radians(angle), length / 2
    x, z = half * math.cos(a), half * math.sin(a)
    # A spindle, so that the contact is the end of the axis at every angle; the inertia is that of a line.
    thick = length / 100
    vertices = [(-half, 0, 0), (half, 0, 0), (0, thick, 0), (0, -thick, 0), (0, 0, thick), (0, 0, -thick)]
    J = mass * length**2 / 12
    out.add_convex(
        "rod",
        vertices,
        mass,
        position=(x, 0, z),
        quaternion=(0, -math.sin(a / 2), 0, math.cos(a / 2)),
        linear_velocity=(slip - spin * z, 0, -fall + spin * x),
        angular_velocity=(0, -spin, 0),
        material=material,
        inertia=[[J / 100, 0, 0], [0, J, 0], [0, 0, J]],
    )
    return out
