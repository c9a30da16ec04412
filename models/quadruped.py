"""Quadruped that stands under joint control and walks in place: twelve joints, four feet, a free base."""

import importlib.metadata
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin

from nsdyn import PD, Material, Scene
from nsdyn.scene.articulations import Articulation
from nsdyn.tools.naming import choice

DURATION, DT = 4.0, 5e-3

STANCE = {"quadruped": (0.0, 0.8, -1.6) * 4, "solo12": (0.0, 0.8, -1.6) * 2 + (0.0, -0.8, 1.6) * 2}
"""Angles of the joints of a leg, FL, FR, HL, HR, rad."""

GAINS = {"quadruped": (100.0, 2.0), "solo12": (10.0, 0.3)}
"""N m/rad and N m s/rad."""

STAND, PERIOD, LIFT = 1.0, 0.5, 0.25
"""It stands for so long [s], then lifts diagonal pairs of feet in turn, each once a period [s], by this much [rad]."""

SHIFT = 5.0
"""How steeply the weight passes from pair to pair: it takes asin(1/SHIFT)/pi of a period."""


def _urdf(robot: str) -> tuple[Path, list[Path]]:
    """URDF of a robot, and the folders of its meshes."""
    if choice(robot, STANCE, "robot") == "quadruped":
        return Path(__file__).with_name("quadruped.urdf"), []
    try:
        package = importlib.metadata.distribution("example-robot-data")
    except importlib.metadata.PackageNotFoundError:
        raise ValueError("robot 'solo12' needs the package example-robot-data: pip install 'nsdyn[robots]'") from None
    share = Path(str(package.locate_file("cmeel.prefix/share")))
    return share / "example-robot-data/robots/solo_description/robots/solo12.urdf", [share]


def _lowest(articulation: Articulation) -> float:
    """Height of the lowest point of spheres and polytopes of an articulation in its initial configuration, m."""
    model, heights = articulation.model, []
    data = model.createData()
    pin.forwardKinematics(model, data, articulation.q)
    for link in articulation.links:
        pose = data.oMi[link.joint] * link.placement
        points = link.shape.vertices if len(link.shape.vertices) else np.zeros((1, 3))
        radius = 0.0 if len(link.shape.vertices) else link.shape.size[0]
        heights.append((points @ pose.rotation.T + pose.translation)[:, 2].min() - radius)
    return float(min(heights))


def scene(robot: str = "quadruped", count: int = 1, mu: float = 0.8) -> Scene:
    """`count` robots side by side on the ground: "quadruped", or "solo12" of the package example-robot-data."""
    path, package_dirs = _urdf(robot)
    common = {"base": "free", "package_dirs": package_dirs, "q": STANCE[robot], "self_collisions": False}
    alone = Scene()
    alone.add_urdf(robot, path, **common)
    height = -_lowest(alone.articulations[robot])
    out = Scene(name="quadruped")
    material = Material(mu=mu)
    out.add_halfspace("ground", material=material)
    for k in range(count):
        name = robot if count == 1 else f"{robot}{k}"
        out.add_urdf(name, path, position=(0.0, float(k), height), material=material, **common)
    return out


def _support(articulation: Articulation) -> tuple[np.ndarray, np.ndarray]:
    """(torques that carry the legs, torques (4, 12) of each leg that carry a quarter of the robot), where it stands."""
    model, q = articulation.model, articulation.q
    data = model.createData()
    gravity = pin.computeGeneralizedGravity(model, data, q)
    quarter = np.r_[0.0, 0.0, 0.25 * gravity[2], 0.0, 0.0, 0.0]
    feet = [f.name for f in model.frames if f.type == pin.FrameType.BODY and f.name.lower().endswith("foot")]
    jacobians = [
        pin.computeFrameJacobian(model, data, q, model.getFrameId(foot), pin.LOCAL_WORLD_ALIGNED)
        for foot in sorted(feet)
    ]
    return gravity[6:], -np.array([J.T @ quarter for J in jacobians])[:, 6:]


def controller(scene: Scene, walk: bool = True) -> Callable[[float, np.ndarray, np.ndarray], dict[str, PD]]:
    """Joint control of all robots of the scene: they stand, and after a while walk in place if `walk`."""
    first = next(iter(scene.articulations))
    robot = next(name for name in STANCE if first.startswith(name))
    stance = np.array(STANCE[robot])
    kp, kd = GAINS[robot]
    legs, carry = _support(scene.articulations[first])

    def pd(angles: np.ndarray, share: np.ndarray) -> dict[str, PD]:
        return dict.fromkeys(scene.articulations, PD(kp, kd, angles, feedforward=legs + share @ carry))

    standing = pd(stance, np.ones(4))
    # Lifting a foot: the thigh forward, the knee bent twice as much, to the side to which the leg is bent.
    bend = (np.sign(stance.reshape(4, 3)) * (0.0, 1.0, 2.0)).ravel()
    pairs = np.array([1.0, -1.0, -1.0, 1.0])

    def control(t: float, q: np.ndarray, v: np.ndarray) -> dict[str, PD]:
        if not walk or t <= STAND:
            return standing
        # FL and HR swing in the first half of a period, FR and HL in the second; the others carry their weight.
        swing = math.sin(2.0 * math.pi * (t - STAND) / PERIOD) * pairs
        lift = np.repeat(LIFT * np.maximum(0.0, swing), 3) * bend
        return pd(stance + lift, 1.0 - np.clip(SHIFT * swing, -1.0, 1.0))

    return control
