"""The scene a user describes: bodies, articulations, materials, gravity.

A scene only collects and checks; nothing is simulated here. SI units, world frame, quaternions xyzw.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from nsdyn.scene import articulations, checks, robot_files, shapes
from nsdyn.scene.articulations import Articulation, Description
from nsdyn.scene.materials import COMBINATION_RULES, Material
from nsdyn.scene.prescribed import Motion, Velocity
from nsdyn.scene.shapes import Shape
from nsdyn.tools.arrays import Array, Index
from nsdyn.tools.naming import choice, meant

__all__ = ["COMBINATION_RULES", "Articulation", "Body", "Geom", "Material", "Scene"]


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
    link : str
        "articulation/body"; of a body that is its own link its name.
    """

    name: str
    body: str
    shape: Shape
    frame: int
    placement_R: Array
    placement_t: Array
    material: Material
    colour: tuple[float, float, float, float] | None = None
    link: str = ""


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

    Examples
    --------
    >>> import nsdyn as nd
    >>> scene = nd.Scene(gravity=(0, 0, -9.81))
    >>> scene.add_halfspace("ground")
    >>> scene.add_sphere("ball", 0.1, mass=1.0, position=(0, 0, 1), material=nd.Material(mu=0.3, restitution=0.8))
    >>> scene.set_pair("ball", "ground", restitution=0.5)
    >>> sorted(scene.bodies)
    ['ball', 'ground']
    """

    gravity: Any = (0.0, 0.0, -9.81)
    friction_rule: str = "geometric_mean"
    restitution_rule: str = "max"
    name: str = "scene"
    bodies: dict[str, Body] = field(default_factory=dict, init=False)
    articulations: dict[str, Articulation] = field(default_factory=dict, init=False)
    pairs: dict[frozenset[str], tuple[float | None, float | None]] = field(default_factory=dict, init=False)
    motions: dict[str, Motion] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        self.gravity = checks.vector(self.gravity, 3, "gravity")
        for argument in ("friction_rule", "restitution_rule"):
            choice(getattr(self, argument), COMBINATION_RULES, argument)

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
        quaternion = checks.quaternion(keywords.get("quaternion", (0, 0, 0, 1)), f"quaternion of {name!r}")
        com = checks.vector(keywords.get("com", (0, 0, 0)), 3, f"com of {name!r}")
        keywords["position"] = checks.rotation(quaternion) @ (centroid + com) if position is None else position
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
            raise ValueError(f"unknown argument {unknown[0]!r}; known are {sorted(known)}{meant(unknown[0], known)}")
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
        centre = checks.vector(com, 3, f"com of {name!r}")
        v = checks.vector(linear_velocity, 3, f"linear_velocity of {name!r}")
        w = checks.vector(angular_velocity, 3, f"angular_velocity of {name!r}")
        if fixed:
            if v.any() or w.any():
                raise ValueError(f"{name!r} is fixed, so its velocity must be zero, got {v.tolist()}, {w.tolist()}")
            if mass is not None:
                checks.mass(mass, f"mass of {name!r}")
            if centre.any():
                raise ValueError(f"{name!r} is fixed, so its com has no meaning, got {centre.tolist()}")
            m, J = 0.0, np.zeros((3, 3))
        else:
            if mass is None:
                raise ValueError(f"mass of {name!r} is needed, unless fixed=True")
            m = checks.mass(mass, f"mass of {name!r}")
            if inertia is None and centre.any():
                raise ValueError(
                    f"inertia of {name!r} is needed: with its com at {centre.tolist()} it is not homogeneous"
                )
            J = checks.inertia(shape.inertia(m) if inertia is None else inertia, f"inertia of {name!r}")
        self.bodies[name] = Body(
            name, shape, m, J, checks.vector(position, 3, f"position of {name!r}"),
            checks.quaternion(quaternion, f"quaternion of {name!r}"), v, w, self._material(material, name),
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

    def add_model(self, name: str, model: Any, geometry_model: Any | None = None, **keywords: Any) -> None:
        """Add an articulated tree: one Pinocchio model, its collision shapes on its links.

        Parameters
        ----------
        name : str
            Unique in the scene.
        model : pinocchio.Model
            Copied, so that several articulations may share it.
        geometry_model : pinocchio.GeometryModel, optional
            Its collision shapes.
        position, quaternion : sequences
            Where the model's world lies in the scene: the pose of a fixed base, the initial one of a free base.
        q, v : sequences, shapes (nq,), (nv,)
            Initial configuration and velocity, Pinocchio's convention; those of a free base may be left out.
        material : Material or mapping
            Of all links, or {body: Material}, in place of the friction that an MJCF or SDF file gives.
        collisions : bool or mapping
            False for none, or {body: shapes in place of the file's}, each a Shape or (Shape, SE3 in the body's frame).
        self_collisions : bool or "apart"
            Whether its links may touch each other, save those that a joint or a loop joins; with "apart" also save
            those that overlap in the initial configuration.
        srdf : path, optional
            Its ``disable_collisions`` are obeyed.
        limits : bool
            Whether position limits of the model are enforced.
        clip : bool
            Move the initial configuration into the limits.
        restitution : float
            Newton's coefficient of the limits.
        friction, damping, armature : sequences, shape (nv,)
            Dry friction, viscous damping and inertia of the joints, in place of those in the model. Efforts in the
            file are the default limit of `nsdyn.PD` control.
        stiffness, rest : sequences, shape (nv,)
            Springs τ = -stiffness (q - rest) in revolute and prismatic joints.
        inertias : {"check", "trust"}
            Whether inertias of the file that no body can have are refused, or taken as they are with a warning.

        Warns
        -----
        UserWarning
            Once, of what the file contains that changes the motion and is not used. Everything that is not used is in
            ``scene.articulations[name].report``.
        """
        self._add_articulation(name, robot_files.read_model(name, model, geometry_model), keywords)

    def add_urdf(
        self,
        name: str,
        path: str | Path,
        base: str = "fixed",
        package_dirs: Sequence[str | Path] = (),
        **keywords: Any,
    ) -> None:
        """Add an articulated tree from a URDF file; see `add_model` for the other keywords.

        Parameters
        ----------
        name : str
        path : path
        base : {"fixed", "free"}
            A free base adds Pinocchio's free-flyer as first joint.
        package_dirs : sequence of paths
            Where ``package://`` meshes are looked up, besides the file's own folder.
        """
        folders = checks.folders(package_dirs, f"package_dirs of {name!r}")
        description = robot_files.read_urdf(name, checks.path(path, f"path of {name!r}"), base, folders)
        self._add_articulation(name, description, keywords)

    def add_mjcf(self, name: str, path: str | Path, keyframe: str | None = None, **keywords: Any) -> None:
        """Add the articulated trees of an MJCF file; see `add_model` for the other keywords.

        Parameters
        ----------
        name : str
        path : path
            Its bases are fixed or free as it says; geoms of its world are fixed.
        keyframe : str, optional
            Name of the one to start from.
        """
        description = robot_files.read_mjcf(name, checks.path(path, f"path of {name!r}"), keyframe)
        self._add_articulation(name, description, keywords)

    def add_sdf(self, name: str, path: str | Path, package_dirs: Sequence[str | Path] = (), **keywords: Any) -> None:
        """Add the articulated tree of an SDF file with one model; see `add_model` for the other keywords.

        Parameters
        ----------
        name : str
        path : path
            Its base is fixed if a joint to the world holds it or the model is static, else free.
        package_dirs : sequence of paths
            Where ``model://`` meshes are looked up, besides the file's own folder.
        """
        folders = checks.folders(package_dirs, f"package_dirs of {name!r}")
        description = robot_files.read_sdf(name, checks.path(path, f"path of {name!r}"), folders)
        self._add_articulation(name, description, keywords)

    def add_loop(
        self,
        articulation: str,
        name: str,
        frame1: str,
        frame2: str = "universe",
        position: ArrayLike = (0.0, 0.0, 0.0),
        quaternion: ArrayLike = (0.0, 0.0, 0.0, 1.0),
        kind: str = "point",
    ) -> None:
        """Close a loop between two frames of an articulation.

        Parameters
        ----------
        articulation, name : str
        frame1, frame2 : str
            Frames of its Pinocchio model, for instance bodies; "universe" is the world.
        position, quaternion : sequences
            Of the closure in `frame1`; in `frame2` it is where it lies in the initial configuration.
        kind : {"point", "frame"}
            Hold the points together, or points and axes.
        """
        choice(articulation, self.articulations, "articulation")
        self.articulations[articulation] = articulations.close_loop(
            self.articulations[articulation], name, frame1, frame2, position, quaternion, kind
        )

    def _add_articulation(self, name: str, description: Description, keywords: dict[str, Any]) -> None:
        self._check_name(name)
        known = [
            p.name for p in inspect.signature(articulations.assemble).parameters.values() if p.kind == p.KEYWORD_ONLY
        ]
        unknown = sorted(set(keywords) - set(known))
        if unknown:
            raise ValueError(f"unknown argument {unknown[0]!r}; known are {sorted(known)}{meant(unknown[0], known)}")
        articulation = articulations.assemble(name, description, **keywords)
        articulation.model.gravity = pin.Motion(self.gravity, np.zeros(3))
        self.articulations[name] = articulation

    # -- prescribed motion -------------------------------------------------------------------------------------

    def set_motion(self, name: str, velocity: Velocity | None = None, surface_velocity: Velocity | None = None) -> None:
        """Prescribe the motion of a fixed body, of its surface, or of a joint; its work is in the ledger.

        Parameters
        ----------
        name : str
            A fixed body, or "articulation/joint" for a joint with one coordinate.
        velocity : array or callable
            Constant, or a function of the time in s. Of a body: linear (3,) [m/s] of its centre, or (linear, angular
            [rad/s]), world axes; the body moves with it and pushes what it meets. Of a joint: rad/s or m/s.
        surface_velocity : array or callable
            The same for a surface that slides in itself while the body stays: a conveyor, a turning drum.

        Raises
        ------
        ValueError
            If nothing of that name can be driven, or a value does not fit.
        """
        if (velocity is None) == (surface_velocity is None):
            raise ValueError(f"motion of {name!r} needs either velocity or surface_velocity")
        owner, _, joint = name.partition("/")
        if joint and owner in self.articulations:
            a = self.articulations[owner]
            if joint not in list(a.model.names)[1:]:
                raise ValueError(f"{owner!r} has no joint {joint!r}; it has {list(a.model.names)[1:]}")
            if a.model.joints[a.model.getJointId(joint)].nv != 1:
                raise ValueError(f"joint {name!r} must have one coordinate to be driven")
            if velocity is None:
                raise ValueError(f"joint {name!r} has a velocity, but no surface_velocity")
            motion = Motion(name, velocity, "joint")
            motion.rate(0.0)
        else:
            body = self.bodies.get(name)
            if body is None or not body.fixed:
                known = [b.name for b in self.bodies.values() if b.fixed]
                raise ValueError(f"motion needs a fixed body or 'articulation/joint', got {name!r}; fixed are {known}")
            if velocity is not None and body.shape.kind == shapes.HALFSPACE:
                raise ValueError(f"halfspace {name!r} cannot move: give it a surface_velocity, or take a box")
            if surface_velocity is not None:
                motion = Motion(name, surface_velocity, "surface")
            elif velocity is not None:
                motion = Motion(name, velocity, "body")
            motion.twist(0.0)
        self.motions[name] = motion

    # -- materials ---------------------------------------------------------------------------------------------

    def set_pair(self, a: str, b: str, mu: float | None = None, restitution: float | None = None) -> None:
        """Give two bodies their own coefficients, which beat the combination rule; None leaves the rule's value.

        A whole articulation goes by its name, a body of it by "articulation/body", which beats the whole.
        """
        links = [
            f"{robot.name}/{body}" for robot in self.articulations.values() for body in dict.fromkeys(robot.bodies)
        ]
        known = [*self.bodies, *self.articulations, *links]
        for name in (a, b):
            if name not in known:
                raise ValueError(f"unknown body {name!r}; the scene has {sorted(known)}{meant(name, known)}")
        Material(0.0 if mu is None else mu, 0.0 if restitution is None else restitution)
        self.pairs[frozenset((a, b))] = (mu, restitution)

    def restitutions(self) -> list[float]:
        """The restitutions that its contacts may have, ascending."""
        geoms = self.geoms()
        kinds: dict[tuple[float, bool], list[int]] = {}
        for k, g in enumerate(geoms):
            kinds.setdefault((g.material.restitution, g.frame < 0), []).append(k)
        # Two of each kind stand for all; what is fixed does not touch what is fixed.
        some = [k for members in kinds.values() for k in members[:2]]
        pairs = [(i, j) for i in some for j in some if i < j and (geoms[i].frame >= 0 or geoms[j].frame >= 0)]
        combined = self.pair_material(geoms)(*np.array(pairs, dtype=np.int64).reshape(-1, 2).T)[1]
        return sorted({*combined.tolist(), *(e for _, e in self.pairs.values() if e is not None)})

    def pair_material(self, geoms: Sequence[Geom]) -> Callable[[Index, Index], tuple[Array, Array]]:
        """Function of two index arrays into `geoms` that returns (mu, restitution) of each pair."""
        mu = np.array([g.material.mu for g in geoms])
        e = np.array([g.material.restitution for g in geoms])
        names = sorted({g.link for g in geoms})
        rank = {name: k for k, name in enumerate(names)}
        owner = np.array([rank[g.link] for g in geoms], dtype=np.int64)
        members: dict[str, set[int]] = {}
        for g in geoms:
            for name in (g.body, g.link):
                members.setdefault(name, set()).add(rank[g.link])
        special = {}
        for pair, values in sorted(self.pairs.items(), key=lambda item: sum("/" in name for name in item[0])):
            a, *b = pair
            for i, j in product(members.get(a, ()), members.get(b[0] if b else a, ())):
                special[min(i, j) * len(names) + max(i, j)] = values
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

    @property
    def driven_bodies(self) -> list[Body]:
        """Fixed bodies that move as prescribed; their frames are the last."""
        return [b for b in self.bodies.values() if b.name in self.motions and self.motions[b.name].kind == "body"]

    def link_frames(self) -> list[tuple[str, int]]:
        """(articulation name, joint) of every moving frame that carries geometry, in frame order."""
        frames = []
        for a in self.articulations.values():
            frames += [(a.name, joint) for joint in sorted({joint for _, joint, _, _ in a.links if joint > 0})]
        return frames

    def geoms(self) -> list[Geom]:
        """All collision shapes: bodies in the order they were added, then links."""
        frame_of: dict[Any, int] = {b.name: k for k, b in enumerate(self.free_bodies)}
        for key in [*self.link_frames(), *(b.name for b in self.driven_bodies)]:
            frame_of[key] = len(frame_of)
        out = []
        for b in self.bodies.values():
            if b.name in frame_of:
                R, t = np.eye(3), -b.com
            else:
                R, t = checks.rotation(b.quaternion), b.position
            out.append(Geom(b.name, b.name, b.shape, frame_of.get(b.name, -1), R, t, b.material, b.colour, b.name))
        for a in self.articulations.values():
            for (name, joint, placement, shape), body, material in zip(a.links, a.bodies, a.materials, strict=True):
                frame = frame_of.get((a.name, joint), -1)
                R, t = np.array(placement.rotation), np.array(placement.translation)
                link = f"{a.name}/{body}"
                out.append(Geom(f"{a.name}/{name}", a.name, shape, frame, R, t, material, None, link))
        return out

    def excluded(self, geoms: Sequence[Geom]) -> set[tuple[int, int]]:
        """Pairs of geoms never tested: those that articulations exclude among their links, and held ones."""
        out = set()
        held = self._held_frames()
        stiff = [k for k, g in enumerate(geoms) if g.frame < 0 or g.frame in held] if held else []
        out |= {(i, j) for i in stiff for j in stiff if i < j and (geoms[i].frame >= 0 or geoms[j].frame >= 0)}
        for name, a in self.articulations.items():
            own = [k for k, g in enumerate(geoms) if g.body == name]
            out |= {(own[i], own[j]) for i, j in a.excluded}
        return out

    def _held_frames(self) -> set[int]:
        """Frames that nothing but prescribed motion moves: driven bodies, and links that hang on driven joints only."""
        links, first = self.link_frames(), len(self.free_bodies)
        held = set(range(first + len(links), first + len(links) + len(self.driven_bodies)))
        for k, (name, joint) in enumerate(links, start=first):
            model = self.articulations[name].model
            if all(f"{name}/{model.names[j]}" in self.motions for j in model.supports[joint] if j):
                held.add(k)
        return held

    def _describe_links(self) -> list[dict[str, Any]]:
        """Bodies of articulations that a recording shows: name, moving frame (-1 for the world), pose in it."""
        first, frames = len(self.free_bodies), self.link_frames()
        frame_of = {key: first + k for k, key in enumerate(frames)} | {(name, 0): -1 for name in self.articulations}
        return [
            {"name": f"{a.name}/{f.name}", "frame": frame_of[key], "placement": f.placement.homogeneous.tolist()}
            for a in self.articulations.values()
            for f in a.model.frames
            if f.type == pin.FrameType.BODY and (key := (a.name, int(f.parentJoint))) in frame_of
        ]

    def describe(self) -> dict[str, Any]:
        """Everything needed to replay a recording, as nested lists (see `nsdyn.recording.trajectory`)."""
        geoms = []
        for g in self.geoms():
            placement = np.eye(4)
            placement[:3, :3], placement[:3, 3] = g.placement_R, g.placement_t
            geoms.append(
                {
                    "name": g.name,
                    "body": g.body,
                    "link": g.link,
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
            "excluded": sorted([min(pair), max(pair)] for pair in self.excluded(self.geoms())),
            "frames": [b.name for b in self.free_bodies]
            + [f"{a}/{self.articulations[a].model.names[j]}" for a, j in self.link_frames()]
            + [b.name for b in self.driven_bodies],
            "links": self._describe_links(),
            "free": len(self.free_bodies),
            "masses": [b.mass for b in self.free_bodies],
            "inertias": [b.inertia.tolist() for b in self.free_bodies],
            "articulations": [
                {
                    "name": a.name,
                    "nq": a.model.nq,
                    "nv": a.model.nv,
                    "joints": list(a.model.names)[1:],
                    "sizes": [[joint.nq, joint.nv] for joint in list(a.model.joints)[1:]],
                }
                for a in self.articulations.values()
            ],
        }
