"""A ball and a crate on a tilted plane: the first line says what a scene shows.

Run it with:  nsdyn run FILE.py --html page.html
              nsdyn run FILE.py --set slope=30 --time 2 --dt 1e-3 -o run.h5
"""

import math

import nsdyn as nd

# How long it is worth looking at, and a step that serves, in s: --time and --dt say otherwise.
DURATION, DT = 1.0, 5e-3


def scene(slope: float = 20.0, mu: float = 0.5) -> nd.Scene:
    """Return the scene. Every parameter has a default, and --set changes it: `slope` [deg], `mu`."""
    out = nd.Scene(name="my scene", gravity=(0, 0, -9.81))  # SI units, z upwards

    # Fixed: a half-space, whose normal points out of it. Materials have friction and restitution.
    angle = math.radians(slope)
    normal = (math.sin(angle), 0.0, math.cos(angle))
    out.add_halfspace("plane", normal=normal, material=nd.Material(mu=mu, restitution=0.0))

    # Moving: name, size, mass in kg; position of the centre of mass, quaternion (x, y, z, w), velocities, world axes.
    up = [0.1 * n for n in normal]
    turn = (0.0, math.sin(0.5 * angle), 0.0, math.cos(0.5 * angle))
    out.add_box("crate", (0.3, 0.2, 0.2), 2.0, position=up, quaternion=turn, material=nd.Material(mu=mu))
    out.add_sphere("ball", 0.1, 1.0, position=(up[0], 0.5, up[2]), linear_velocity=(0, 0, 0))
    # Also add_capsule, add_cylinder, add_ellipsoid, add_convex, add_mesh; fixed=True holds a body where it is.

    # Two bodies may have coefficients of their own, which beat the combination of their materials.
    out.set_pair("ball", "plane", mu=0.8)

    # Robots: out.add_urdf("robot", "robot.urdf", base="free", package_dirs=[...], position=(0, 0, 1)), see nd.Scene
    return out


# What pushes free bodies, in N at their centres of mass: take the # away and return what you need.
# def external_force(scene):
#     return lambda t, q, v: {"crate": (5.0, 0.0, 0.0) if t < 0.2 else (0.0, 0.0, 0.0)}

# What drives the joints of robots, by their names, with gains in N m/rad and N m s/rad:
# def controller(scene):
#     return lambda t, q, v: {robot: nd.PD(kp=100.0, kd=5.0, target=0.0) for robot in scene.articulations}
