"""The scene a user describes: bodies, articulations, materials, gravity.

A scene only collects and checks; nothing is simulated here. SI units, world frame, quaternions xyzw.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from nsdyn import shapes
from nsdyn.shapes import Shape

Array = NDArray[np.float64]
Index = NDArray[np.int64]

__all__ = ["COMBINATION_RULES", "Articulation", "Body", "Geom", "Material", "Scene"]

COMBINATION_RULES: dict[str, Callable[[Array, Array], Array]] = {
    "average": lambda a, b: 0.5 * (a + b),
    "geometric_mean": lambda a, b: np.asarray(np.sqrt(a * b)),
    "harmonic_mean": lambda a, b: 2.0 * a * b / np.where(a + b > 0.0, a + b, 1.0),
    "max": np.maximum,
    "min": np.minimum,
    "multiply": np.multiply,
}
"""How two materials make one coefficient, by name."""


def _number(value: Any, what: str) -> float:
    try:
        number = float(value)
    except (TypeError, ValueError):
        raise ValueError(f"{what} must be a number, got {value!r}") from None
    if not np.isfinite(number):
        raise ValueError(f"{what} must be finite, got {number}")
    return number


def _vector(value: ArrayLike, size: int, what: str) -> Array:
    try:
        vector = np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(f"{what} must be {size} numbers, got {value!r}") from None
    if vector.shape != (size,):
        raise ValueError(f"{what} must be {size} numbers, got shape {vector.shape}")
    if not np.isfinite(vector).all():
        raise ValueError(f"{what} must be finite, got {vector.tolist()}")
    return vector


def _quaternion(value: ArrayLike, what: str) -> Array:
    quaternion = _vector(value, 4, what)
    norm = float(np.linalg.norm(quaternion))
    if abs(norm - 1.0) > 1e-6:  # what a user's own rounding may leave; more is a mistake (wxyz order, degrees)
        raise ValueError(f"{what} must be a unit quaternion x y z w, got norm {norm:.9g}")
    return quaternion / norm


def _mass(value: Any, what: str) -> float:
    mass = _number(value, what)
    if mass <= 0.0:
        raise ValueError(f"{what} must be positive, got {mass:g}")
    return mass


def _inertia(value: ArrayLike, what: str) -> Array:
    """A physical inertia: symmetric, positive, and no principal moment larger than the sum of the others."""
    inertia = np.array(value, dtype=float)
    if inertia.shape != (3, 3) or not np.isfinite(inertia).all():
        raise ValueError(f"{what} must be a finite 3 x 3 matrix, got {value!r}")
    if not np.allclose(inertia, inertia.T, rtol=1e-9, atol=0.0):
        raise ValueError(f"{what} must be symmetric, got {inertia.tolist()}")
    moments = np.linalg.eigvalsh(inertia)
    if moments[0] <= 0.0:
        raise ValueError(f"{what} must be positive definite, got principal moments {moments.tolist()}")
    if moments[2] > (moments[0] + moments[1]) * (1.0 + 1e-9):
        raise ValueError(
            f"{what} is not that of a body: its principal moments {moments.tolist()} break the triangle inequality"
        )
    out: Array = 0.5 * (inertia + inertia.T)
    return out


@dataclass(frozen=True)
class Material:
    """What two surfaces are made of, before a combination rule makes one value per pair.

    Parameters
    ----------
    mu : float
        Coulomb's coefficient of friction, ≥ 0.
    restitution : float
        Newton's coefficient e in [0, 1]; u_N⁺ = -e u_N⁻ at an impact.
    """

    mu: float = 0.5
    restitution: float = 0.0

    def __post_init__(self) -> None:
        if _number(self.mu, "mu") < 0.0:
            raise ValueError(f"mu must not be negative, got {self.mu:g}")
        if not 0.0 <= _number(self.restitution, "restitution") <= 1.0:
            raise ValueError(f"restitution must lie in [0, 1], got {self.restitution:g}")


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body with one shape; `mass` 0 marks a fixed one.

    Attributes
    ----------
    name : str
    shape : Shape
    mass : float
        kg.
    inertia : ndarray, shape (3, 3)
        About the centre of mass in body axes, kg m².
    position, linear_velocity, angular_velocity : ndarray, shape (3,)
        Of the centre of mass, world frame; m, m/s, rad/s.
    quaternion : ndarray, shape (4,)
        xyzw, body to world.
    material : Material
    colour : tuple of 4 floats, optional
        RGBA in [0, 1] for the viewer.
    com : ndarray, shape (3,)
        Centre of mass in the frame of the shape, m.
    """

    name: str
    shape: Shape
    mass: float
    inertia: Array
    position: Array
    quaternion: Array
    linear_velocity: Array
    angular_velocity: Array
    material: Material
    colour: tuple[float, float, float, float] | None
    com: Array

    @property
    def fixed(self) -> bool:
        """Whether the body never moves."""
        return self.mass == 0.0


@dataclass(frozen=True, eq=False)
class Articulation:
    """An articulated tree: one Pinocchio model with its collision shapes.

    Attributes
    ----------
    name : str
    model : pinocchio.Model
    links : tuple of (name, joint index, placement in the joint frame as SE3, Shape)
    q, v : ndarray, shapes (nq,), (nv,)
        Initial configuration and velocity, Pinocchio's convention.
    material : Material
    """

    name: str
    model: Any
    links: tuple[tuple[str, int, Any, Shape], ...]
    q: Array
    v: Array
    material: Material


@dataclass(frozen=True, eq=False)
class Geom:
    """One collision shape: where it hangs and what it is made of.

    Attributes
    ----------
    name : str
    body : str
        Name of the body or articulation.
    shape : Shape
    frame : int
        Moving frame it hangs on: free bodies first, then links; -1 for the world.
    placement_R, placement_t : ndarray, shapes (3, 3), (3,)
        Its pose in that frame.
    material : Material
    colour : tuple of 4 floats, optional
    """

    name: str
    body: str
    shape: Shape
    frame: int
    placement_R: Array
    placement_t: Array
    material: Material
    colour: tuple[float, float, float, float] | None = None


def _rotation(quaternion: Array) -> Array:
    out: Array = np.array(pin.Quaternion(quaternion).toRotationMatrix())
    return out


@dataclass(eq=False)
class Scene:
    """Bodies, articulations and materials under gravity.

    Parameters
    ----------
    gravity : sequence of 3 floats
        m/s².
    friction_rule, restitution_rule : str
        Name of the rule in `COMBINATION_RULES` that combines the values of two materials.
    name : str
        Shown in recordings.

    Raises
    ------
    ValueError
        In the constructor and every ``add_*``, naming the argument, what was expected and what came.
    """

    gravity: Any = (0.0, 0.0, -9.81)
    friction_rule: str = "geometric_mean"
    restitution_rule: str = "max"
    name: str = "scene"
    bodies: dict[str, Body] = field(default_factory=dict, init=False)
    articulations: dict[str, Articulation] = field(default_factory=dict, init=False)
    pairs: dict[frozenset[str], tuple[float | None, float | None]] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        self.gravity = _vector(self.gravity, 3, "gravity")
        for argument in ("friction_rule", "restitution_rule"):
            rule = getattr(self, argument)
            if rule not in COMBINATION_RULES:
                raise ValueError(f"{argument} must be one of {sorted(COMBINATION_RULES)}, got {rule!r}")

    # -- bodies ------------------------------------------------------------------------------------------------

    def add_halfspace(
        self,
        name: str,
        normal: ArrayLike = (0.0, 0.0, 1.0),
        offset: float = 0.0,
        material: Material | None = None,
        colour: ArrayLike | None = None,
    ) -> None:
        """Add the fixed solid {x : normal·x ≤ offset}; `normal` points out of it, `offset` is in m along it."""
        shape = shapes.halfspace(normal, offset)
        keywords = self._keywords({"material": material, "fixed": True, "colour": colour})
        self._add(name, shape, None, **keywords)

    def add_box(self, name: str, size: ArrayLike, mass: float | None = None, **keywords: Any) -> None:
        """Add a box with full edge lengths `size` [m]; see `add_convex` for the other keywords."""
        self._add(name, shapes.box(size), mass, **self._keywords(keywords))

    def add_sphere(self, name: str, radius: float, mass: float | None = None, **keywords: Any) -> None:
        """Add a sphere of `radius` [m]; see `add_convex` for the other keywords."""
        self._add(name, shapes.sphere(radius), mass, **self._keywords(keywords))

    def add_capsule(self, name: str, radius: float, length: float, mass: float | None = None, **keywords: Any) -> None:
        """Add a capsule along its z axis, `length` [m] between the centres of its two half-spheres."""
        self._add(name, shapes.capsule(radius, length), mass, **self._keywords(keywords))

    def add_cylinder(self, name: str, radius: float, length: float, mass: float | None = None, **keywords: Any) -> None:
        """Add a cylinder along its z axis of full height `length` [m]."""
        self._add(name, shapes.cylinder(radius, length), mass, **self._keywords(keywords))

    def add_ellipsoid(self, name: str, radii: ArrayLike, mass: float | None = None, **keywords: Any) -> None:
        """Add an ellipsoid with semi-axes `radii` [m]."""
        self._add(name, shapes.ellipsoid(radii), mass, **self._keywords(keywords))

    def add_convex(
        self,
        name: str,
        vertices: ArrayLike,
        mass: float | None = None,
        position: ArrayLike | None = None,
        **keywords: Any,
    ) -> None:
        """Add the convex hull of points.

        Parameters
        ----------
        name : str
            Unique in the scene.
        vertices : array, shape (n, 3)
            In m, body axes. The body's origin is the centroid of the hull.
        mass : float
            kg; none for a fixed body.
        position : sequence of 3 floats, optional
            Of the centre of mass, m. By default the body stays where the vertices are.
        quaternion : sequence of 4 floats
            xyzw.
        linear_velocity, angular_velocity : sequence of 3 floats
            World frame, m/s and rad/s.
        material : Material
        fixed : bool
        colour : sequence of 3 or 4 floats in [0, 1]
        inertia : array, shape (3, 3)
            About the centre of mass in body axes, kg m²; by default that of the homogeneous shape.
        com : sequence of 3 floats
            Centre of mass from the centroid of the shape, body axes, m; 0 by default. One elsewhere needs `inertia`.
        """
        shape, centroid = shapes.convex(vertices)
        self._add_hull(name, shape, centroid, mass, position, keywords)

    def add_mesh(
        self,
        name: str,
        path: str | Path,
        mass: float | None = None,
        position: ArrayLike | None = None,
        scale: float = 1.0,
        **keywords: Any,
    ) -> None:
        """Add the convex hull of a mesh file, with a warning when the hull has over 1.02 times its volume.

        Keywords as in `add_convex`; `scale` multiplies the file's lengths.
        """
        shape, centroid = shapes.mesh(path, scale)
        self._add_hull(name, shape, centroid, mass, position, keywords)

    def _add_hull(
        self,
        name: str,
        shape: Shape,
        centroid: Array,
        mass: float | None,
        position: Any,
        keywords: dict[str, Any],
    ) -> None:
        quaternion = _quaternion(keywords.get("quaternion", (0, 0, 0, 1)), f"quaternion of {name!r}")
        com = _vector(keywords.get("com", (0, 0, 0)), 3, f"com of {name!r}")
        keywords["position"] = _rotation(quaternion) @ (centroid + com) if position is None else position
        self._add(name, shape, mass, **self._keywords(keywords))

    @staticmethod
    def _keywords(given: dict[str, Any]) -> dict[str, Any]:
        known: dict[str, Any] = {
            "position": (0, 0, 0), "quaternion": (0, 0, 0, 1), "linear_velocity": (0, 0, 0),
            "angular_velocity": (0, 0, 0), "material": None, "fixed": False, "colour": None, "inertia": None,
            "com": (0, 0, 0),
        }  # fmt: skip
        unknown = sorted(set(given) - set(known))
        if unknown:
            raise ValueError(f"unknown argument {unknown[0]!r}; known are {sorted(known)}")
        return known | given

    def _add(
        self,
        name: str,
        shape: Shape,
        mass: float | None,
        position: ArrayLike,
        quaternion: ArrayLike,
        linear_velocity: ArrayLike,
        angular_velocity: ArrayLike,
        material: Material | None,
        fixed: bool,
        colour: ArrayLike | None,
        inertia: ArrayLike | None,
        com: ArrayLike,
    ) -> None:
        self._check_name(name)
        centre = _vector(com, 3, f"com of {name!r}")
        v = _vector(linear_velocity, 3, f"linear_velocity of {name!r}")
        w = _vector(angular_velocity, 3, f"angular_velocity of {name!r}")
        if fixed:
            if v.any() or w.any():
                raise ValueError(f"{name!r} is fixed, so its velocity must be zero, got {v.tolist()}, {w.tolist()}")
            if mass is not None:
                _mass(mass, f"mass of {name!r}")
            if centre.any():
                raise ValueError(f"{name!r} is fixed, so its com has no meaning, got {centre.tolist()}")
            m, J = 0.0, np.zeros((3, 3))
        else:
            if mass is None:
                raise ValueError(f"mass of {name!r} is needed, unless fixed=True")
            m = _mass(mass, f"mass of {name!r}")
            if inertia is None and centre.any():
                raise ValueError(
                    f"inertia of {name!r} is needed: with its com at {centre.tolist()} it is not homogeneous"
                )
            J = _inertia(shape.inertia(m) if inertia is None else inertia, f"inertia of {name!r}")
        self.bodies[name] = Body(
            name, shape, m, J, _vector(position, 3, f"position of {name!r}"),
            _quaternion(quaternion, f"quaternion of {name!r}"), v, w, self._material(material, name),
            self._colour(colour, name), centre,
        )  # fmt: skip

    def _check_name(self, name: str) -> None:
        if not isinstance(name, str) or not name or "/" in name:
            raise ValueError(f"name must be a non-empty string without '/', got {name!r}")
        if name in self.bodies or name in self.articulations:
            raise ValueError(f"name must be unique in the scene, {name!r} is taken")

    @staticmethod
    def _material(material: Material | None, name: str) -> Material:
        if material is not None and not isinstance(material, Material):
            raise ValueError(f"material of {name!r} must be a nsdyn.Material, got {material!r}")
        return material or Material()

    @staticmethod
    def _colour(colour: ArrayLike | None, name: str) -> tuple[float, float, float, float] | None:
        if colour is None:
            return None
        rgba = np.array(colour, dtype=float)
        if rgba.shape not in ((3,), (4,)) or not ((rgba >= 0) & (rgba <= 1)).all():
            raise ValueError(f"colour of {name!r} must be 3 or 4 numbers in [0, 1], got {colour!r}")
        r, g, b, *a = rgba.tolist()
        return (r, g, b, a[0] if a else 1.0)

    # -- articulations -----------------------------------------------------------------------------------------

    def add_urdf(
        self,
        name: str,
        path: str | Path,
        base: str = "fixed",
        position: ArrayLike = (0.0, 0.0, 0.0),
        quaternion: ArrayLike = (0.0, 0.0, 0.0, 1.0),
        q: ArrayLike | None = None,
        v: ArrayLike | None = None,
        material: Material | None = None,
        package_dirs: Sequence[str | Path] = (),
    ) -> None:
        """Add an articulated tree from a URDF file: one Pinocchio model, its collision shapes on its links.

        Parameters
        ----------
        name : str
        path : path
        base : {"fixed", "free"}
            A free base adds Pinocchio's free-flyer as first joint.
        position, quaternion : sequences
            Pose of the base in the world; for a free base its initial pose.
        q, v : sequences, optional
            Initial joint configuration and velocity without the base; zero (neutral) by default.
        material : Material
            Of all links.
        package_dirs : sequence of paths
            Where ``package://`` meshes are looked up, besides the file's own folder.

        Raises
        ------
        ValueError
            If the file cannot be read or a value does not fit.

        Notes
        -----
        Friction, damping, limits and transmissions written in the file are not used: give materials here.
        """
        self._check_name(name)
        if base not in ("fixed", "free"):
            raise ValueError(f"base of {name!r} must be 'fixed' or 'free', got {base!r}")
        path = Path(path)
        if not path.is_file():
            raise ValueError(f"path of {name!r} must be a URDF file, got {str(path)!r}")
        dirs = [str(d) for d in (path.parent, *package_dirs)]
        try:
            if base == "free":
                model = pin.buildModelFromUrdf(str(path), pin.JointModelFreeFlyer())
            else:
                model = pin.buildModelFromUrdf(str(path))
            geometry = pin.buildGeomFromUrdf(model, str(path), pin.GeometryType.COLLISION, package_dirs=dirs)
        except (ValueError, RuntimeError) as failure:
            raise ValueError(f"path of {name!r}: {path} could not be read: {failure}") from None
        at = pin.SE3(
            _rotation(_quaternion(quaternion, f"quaternion of {name!r}")),
            _vector(position, 3, f"position of {name!r}"),
        )
        q0, v0 = pin.neutral(model), np.zeros(model.nv)
        lead_q, lead_v = (7, 6) if base == "free" else (0, 0)
        if base == "free":
            q0[:7] = pin.SE3ToXYZQUAT(at)
        else:
            for joint in range(1, model.njoints):
                if model.parents[joint] == 0:
                    model.jointPlacements[joint] = at * model.jointPlacements[joint]
        if q is not None:
            q0[lead_q:] = _vector(q, model.nq - lead_q, f"q of {name!r}")
        if v is not None:
            v0[lead_v:] = _vector(v, model.nv - lead_v, f"v of {name!r}")
        links = []
        for g in geometry.geometryObjects:
            shape, shift = shapes.from_coal(g.geometry)
            placement = g.placement * pin.SE3(np.eye(3), shift)
            if g.parentJoint == 0 and base == "fixed":
                placement = at * placement
            links.append((g.name, int(g.parentJoint), placement, shape))
        model.gravity = pin.Motion(self.gravity, np.zeros(3))
        self.articulations[name] = Articulation(name, model, tuple(links), q0, v0, self._material(material, name))

    # -- materials ---------------------------------------------------------------------------------------------

    def set_pair(self, a: str, b: str, mu: float | None = None, restitution: float | None = None) -> None:
        """Give two bodies their own coefficients, which beat the combination rule; None leaves the rule's value."""
        for name in (a, b):
            if name not in self.bodies and name not in self.articulations:
                raise ValueError(f"unknown body {name!r}; the scene has {sorted([*self.bodies, *self.articulations])}")
        Material(0.0 if mu is None else mu, 0.0 if restitution is None else restitution)
        self.pairs[frozenset((a, b))] = (mu, restitution)

    def pair_material(self, geoms: Sequence[Geom]) -> Callable[[Index, Index], tuple[Array, Array]]:
        """Function of two index arrays into `geoms` that returns (mu, restitution) of each pair."""
        mu = np.array([g.material.mu for g in geoms])
        e = np.array([g.material.restitution for g in geoms])
        names = sorted({g.body for g in geoms})
        rank = {name: k for k, name in enumerate(names)}
        owner = np.array([rank[g.body] for g in geoms], dtype=np.int64)
        special = {}
        for pair, values in self.pairs.items():
            i, *j = sorted(rank[name] for name in pair)
            special[i * len(names) + (j[0] if j else i)] = values
        codes = np.array(sorted(special), dtype=np.int64)

        def combine(i: Index, j: Index) -> tuple[Array, Array]:
            pair_mu = np.asarray(COMBINATION_RULES[self.friction_rule](mu[i], mu[j]), dtype=float)
            pair_e = np.asarray(COMBINATION_RULES[self.restitution_rule](e[i], e[j]), dtype=float)
            if codes.size:
                code = np.minimum(owner[i], owner[j]) * len(names) + np.maximum(owner[i], owner[j])
                for k in np.flatnonzero(np.isin(code, codes)):
                    own_mu, own_e = special[int(code[k])]
                    pair_mu[k] = pair_mu[k] if own_mu is None else own_mu
                    pair_e[k] = pair_e[k] if own_e is None else own_e
            return pair_mu, pair_e

        return combine

    # -- what the stepper needs --------------------------------------------------------------------------------

    @property
    def free_bodies(self) -> list[Body]:
        """Bodies that move, in the order they were added."""
        return [b for b in self.bodies.values() if not b.fixed]

    def link_frames(self) -> list[tuple[str, int]]:
        """(articulation name, joint) of every moving frame that carries geometry, in frame order."""
        frames = []
        for a in self.articulations.values():
            frames += [(a.name, joint) for joint in sorted({joint for _, joint, _, _ in a.links if joint > 0})]
        return frames

    def geoms(self) -> list[Geom]:
        """All collision shapes: bodies in the order they were added, then links."""
        free = {b.name: k for k, b in enumerate(self.free_bodies)}
        frame_of = {key: len(free) + k for k, key in enumerate(self.link_frames())}
        out = []
        for b in self.bodies.values():
            if b.fixed:
                R, t = _rotation(b.quaternion), b.position
            else:
                R, t = np.eye(3), -b.com
            out.append(Geom(b.name, b.name, b.shape, free.get(b.name, -1), R, t, b.material, b.colour))
        for a in self.articulations.values():
            for name, joint, placement, shape in a.links:
                frame = frame_of.get((a.name, joint), -1)
                R, t = np.array(placement.rotation), np.array(placement.translation)
                out.append(Geom(f"{a.name}/{name}", a.name, shape, frame, R, t, a.material))
        return out

    def excluded(self, geoms: Sequence[Geom]) -> set[tuple[int, int]]:
        """Pairs of geoms never tested: links of one articulation that share a joint or are joined by one."""
        out = set()
        frames = self.link_frames()
        free = len(self.free_bodies)
        for name, a in self.articulations.items():
            own = [k for k, g in enumerate(geoms) if g.body == name]
            joint = {k: frames[geoms[k].frame - free][1] if geoms[k].frame >= 0 else 0 for k in own}
            for i in own:
                for j in own:
                    p, c = sorted((joint[i], joint[j]))
                    if i < j and (p == c or int(a.model.parents[c]) == p):
                        out.add((i, j))
        return out

    def describe(self) -> dict[str, Any]:
        """Everything needed to replay a recording, as nested lists (see `nsdyn.trajectory`)."""
        geoms = []
        for g in self.geoms():
            placement = np.eye(4)
            placement[:3, :3], placement[:3, 3] = g.placement_R, g.placement_t
            geoms.append(
                {
                    "name": g.name,
                    "body": g.body,
                    "frame": g.frame,
                    "placement": placement.tolist(),
                    "mu": g.material.mu,
                    "restitution": g.material.restitution,
                    "colour": None if g.colour is None else list(g.colour),
                    **g.shape.describe(),
                }
            )
        return {
            "name": self.name,
            "gravity": self.gravity.tolist(),
            "friction_rule": self.friction_rule,
            "restitution_rule": self.restitution_rule,
            "geoms": geoms,
            "frames": [b.name for b in self.free_bodies]
            + [f"{a}/{self.articulations[a].model.names[j]}" for a, j in self.link_frames()],
            "free": len(self.free_bodies),
            "masses": [b.mass for b in self.free_bodies],
            "inertias": [b.inertia.tolist() for b in self.free_bodies],
            "articulations": [
                {"name": a.name, "nq": a.model.nq, "nv": a.model.nv, "joints": list(a.model.names)[1:]}
                for a in self.articulations.values()
            ],
        }
