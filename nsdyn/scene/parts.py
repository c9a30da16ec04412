"""The parts of a scene: bodies and articulations, and all ways to add them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Unpack

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from nsdyn.scene import assembly, checks, couplings, robot_files, shapes
from nsdyn.scene.articulations import Articulation, ArticulationOptions, Description
from nsdyn.scene.bodies import Body, BodyOptions, make_body
from nsdyn.scene.materials import Material
from nsdyn.scene.shapes import Shape
from nsdyn.tools.arrays import Array
from nsdyn.tools.files import as_path
from nsdyn.tools.naming import check_known, choice


@dataclass(eq=False)
class Parts:
    """Bodies and articulations under gravity; see `nsdyn.Scene`, which has their materials and motions too."""

    gravity: Any = (0.0, 0.0, -9.81)
    bodies: dict[str, Body] = field(default_factory=dict, init=False)
    articulations: dict[str, Articulation] = field(default_factory=dict, init=False)

    def __setattr__(self, name: str, value: Any) -> None:
        super().__setattr__(name, checks.vector(value, 3, name) if name == "gravity" else value)

    # -- bodies ------------------------------------------------------------------------------------------------

    def add_halfspace(
        self,
        name: str,
        normal: ArrayLike = (0.0, 0.0, 1.0),
        offset: float = 0.0,
        material: Material | None = None,
        colour: ArrayLike | None = None,
    ) -> None:
        """Add the fixed solid {x : normal·x ≤ offset}; `normal` points outwards, `offset` is in m along `normal`."""
        self.add_shape(name, shapes.halfspace(normal, offset), material=material, fixed=True, colour=colour)

    def add_box(self, name: str, size: ArrayLike, mass: float | None = None, **keywords: Unpack[BodyOptions]) -> None:
        """Add a box with full edge lengths `size` [m]; see `add_convex` for the other keywords."""
        self.add_shape(name, shapes.box(size), mass, **keywords)

    def add_sphere(self, name: str, radius: float, mass: float | None = None, **keywords: Unpack[BodyOptions]) -> None:
        """Add a sphere of `radius` [m]; see `add_convex` for the other keywords."""
        self.add_shape(name, shapes.sphere(radius), mass, **keywords)

    def add_capsule(
        self, name: str, radius: float, length: float, mass: float | None = None, **keywords: Unpack[BodyOptions]
    ) -> None:
        """Add a capsule along its z axis; `length` [m] is the distance between the centres of its two half-spheres."""
        self.add_shape(name, shapes.capsule(radius, length), mass, **keywords)

    def add_cylinder(
        self, name: str, radius: float, length: float, mass: float | None = None, **keywords: Unpack[BodyOptions]
    ) -> None:
        """Add a cylinder along its z axis, with the full height `length` [m]."""
        self.add_shape(name, shapes.cylinder(radius, length), mass, **keywords)

    def add_ellipsoid(
        self, name: str, radii: ArrayLike, mass: float | None = None, **keywords: Unpack[BodyOptions]
    ) -> None:
        """Add an ellipsoid with semi-axes `radii` [m]."""
        self.add_shape(name, shapes.ellipsoid(radii), mass, **keywords)

    def add_convex(
        self, name: str, vertices: ArrayLike, mass: float | None = None, **keywords: Unpack[BodyOptions]
    ) -> None:
        """Add the convex hull of points.

        Parameters
        ----------
        name : str
            Unique in the scene.
        vertices : array, shape (n, 3)
            In m, body axes. The body's origin is the centroid of the hull.
        mass : float
            kg; leave it out for a fixed body.
        position : sequence of 3 floats, optional
            Position of the centre of mass, m. By default the body lies where its vertices are.
        quaternion : sequence of 4 floats
            xyzw.
        linear_velocity, angular_velocity : sequence of 3 floats
            World frame, m/s and rad/s.
        material : Material
        fixed : bool
        colour : sequence of 3 or 4 floats in [0, 1]
        inertia : array, shape (3, 3)
            About the centre of mass in body axes, kg m²; by default the inertia of the homogeneous shape.
        com : sequence of 3 floats
            Centre of mass relative to the centroid of the shape, body axes, m; 0 by default. If it is not 0, `inertia`
            is required.
        """
        self._add_hull(name, shapes.convex(vertices), mass, keywords)

    def add_mesh(
        self,
        name: str,
        path: str | Path,
        mass: float | None = None,
        scale: float = 1.0,
        **keywords: Unpack[BodyOptions],
    ) -> None:
        """Add the convex hull of a mesh file; warn when the hull has more than 1.02 times the volume of the mesh.

        Keywords as in `add_convex`; `scale` multiplies the lengths in the file.
        """
        self._add_hull(name, shapes.mesh(path, scale), mass, keywords)

    def _add_hull(self, name: str, hull: tuple[Shape, Array], mass: float | None, keywords: BodyOptions) -> None:
        shape, centroid = hull
        if keywords.get("position") is None:
            quaternion = checks.quaternion(keywords.get("quaternion", (0, 0, 0, 1)), f"quaternion of {name!r}")
            com = checks.vector(keywords.get("com", (0, 0, 0)), 3, f"com of {name!r}")
            keywords["position"] = checks.rotation(quaternion) @ (centroid + com)
        self.add_shape(name, shape, mass, **keywords)

    def add_shape(self, name: str, shape: Shape, mass: float | None = None, **keywords: Unpack[BodyOptions]) -> None:
        """Add a body with any `Shape` of `nsdyn.scene.shapes` or your own `Shape`; keywords as in `add_convex`."""
        self._check_name(name)
        check_known(keywords, BodyOptions.__annotations__)
        self.bodies[name] = make_body(name, shape, mass, **keywords)

    def _check_name(self, name: str) -> None:
        checks.name(name)
        if name in self.bodies or name in self.articulations:
            raise ValueError(f"name must be unique in the scene, {name!r} is taken")

    # -- articulations -----------------------------------------------------------------------------------------

    def add_model(
        self, name: str, model: Any, geometry_model: Any | None = None, **keywords: Unpack[ArticulationOptions]
    ) -> None:
        """Add an articulated tree: one Pinocchio model with collision shapes on its links.

        Parameters
        ----------
        name : str
            Unique in the scene.
        model : pinocchio.Model
            The model is copied, so that several articulations may share it. Its joints must be in depth-first order:
            all joints that a joint carries follow it directly. A mimic joint gets a coordinate of its own, which
            counts in q, v and the other sequences, and a gear as of `add_gear`.
        geometry_model : pinocchio.GeometryModel, optional
            Collision shapes of the model. If it lists collision pairs, only the listed pairs may touch.
        position, quaternion : sequences
            Pose of the model's world in the scene: the pose of a fixed base, the initial pose of a free base.
        q, v : sequences, shapes (nq,), (nv,)
            Initial configuration and velocity, Pinocchio's convention; the part of a free base may be left out.
        material : Material or mapping
            One Material for all shapes, or {body: Material}. It replaces the friction that an MJCF or SDF file gives.
        collisions : bool or mapping
            False for no shapes, or {body: shapes that replace those of the file}; each shape is a Shape or
            (Shape, SE3 in the body's frame).
        self_collisions : bool or "apart"
            Whether links may touch each other. Two links that a joint or a loop joins never do. With "apart", links
            that overlap in the initial configuration never do either, and a warning names them. For an MJCF file with
            several trees it applies within each tree: different trees touch each other and the world.
        srdf : path, optional
            SRDF file whose ``disable_collisions`` are respected.
        limits : bool
            Whether position limits of the model are enforced.
        clip : bool
            Whether to move the initial configuration into the limits.
        restitution : float
            Newton's coefficient of the joint limits.
        friction, damping, armature : sequences, shape (nv,)
            Dry friction, viscous damping and inertia of the joints, in place of those in the model. Friction against
            sliding of a planar joint lies in a disk, ‖τ‖ ≤ τ_c. Friction against turning of a ball joint lies in a
            ball, so that all its axes must have the same τ_c. Friction of free joints must be 0. Armature must be 0 in
            free joints and along both axes of a planar joint, since inertia along axes that turn with a body would
            bend the body's path. Armature must be the same about all axes of a ball joint. Efforts in the file are the
            default limit of `nsdyn.PD` control.
        stiffness, rest : sequences, shape (nv,)
            Springs τ = -stiffness (q - rest) in revolute and prismatic joints.
        inertias : {"check", "trust"}
            Whether inertias of the file that no body can have are refused, or taken as they are with a warning.

        Warns
        -----
        UserWarning
            Once, naming contents of the file that change the motion and are not used. The full list of unused contents
            is in ``scene.articulations[name].report``.
        """
        self._add_articulation(name, robot_files.read_model(name, model, geometry_model), keywords)

    def add_urdf(
        self,
        name: str,
        path: str | Path,
        base: str = "fixed",
        package_dirs: Sequence[str | Path] = (),
        **keywords: Unpack[ArticulationOptions],
    ) -> None:
        """Add an articulated tree from a URDF file; see `add_model` for the other keywords.

        Parameters
        ----------
        name : str
        path : path
        base : {"fixed", "free"}
            With "free", Pinocchio's free-flyer is the first joint.
        package_dirs : sequence of paths
            Folders in which ``package://`` meshes are looked up, besides the folder of the file.
        """
        folders = checks.folders(package_dirs, f"package_dirs of {name!r}")
        description = robot_files.read_urdf(name, as_path(path, f"path of {name!r}"), base, folders)
        self._add_articulation(name, description, keywords)

    def add_mjcf(
        self, name: str, path: str | Path, keyframe: str | None = None, **keywords: Unpack[ArticulationOptions]
    ) -> None:
        """Add the articulated trees of an MJCF file; see `add_model` for the other keywords.

        Parameters
        ----------
        name : str
        path : path
            The file decides which bases are fixed or free. The geoms of its world, and of bodies in the world that
            carry no joint, become fixed bodies of the scene, "name/geom". In `material` and `collisions` the geoms of
            the world belong to the body "world".
        keyframe : str, optional
            Name of the keyframe to start from.
        """
        description = robot_files.read_mjcf(name, as_path(path, f"path of {name!r}"), keyframe)
        self._add_articulation(name, description, keywords)

    def add_sdf(
        self,
        name: str,
        path: str | Path,
        package_dirs: Sequence[str | Path] = (),
        **keywords: Unpack[ArticulationOptions],
    ) -> None:
        """Add the articulated tree of an SDF file with one model; see `add_model` for the other keywords.

        Parameters
        ----------
        name : str
        path : path
            The base is fixed if a joint to the world holds it or the model is static, and free otherwise.
        package_dirs : sequence of paths
            Folders in which ``model://`` meshes are looked up, besides the folder of the file.
        """
        folders = checks.folders(package_dirs, f"package_dirs of {name!r}")
        description = robot_files.read_sdf(name, as_path(path, f"path of {name!r}"), folders)
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
            Frames of the articulation's Pinocchio model, for instance bodies, on two links; "universe" is the world.
        position, quaternion : sequences
            Pose of the closure in `frame1`. Its pose in `frame2` follows from the initial configuration.
        kind : {"point", "frame"}
            Whether the loop holds the origins together, or origins and axes.
        """
        a = self.articulations[choice(articulation, self.articulations, "articulation")]
        at = checks.placement(position, quaternion, repr(name))
        self.articulations[articulation] = couplings.close_loop(a, name, (frame1, frame2), at, kind)

    def add_gear(self, articulation: str, joint1: str, joint2: str, ratio: float, offset: float | None = None) -> None:
        """Couple two revolute or prismatic joints of an articulation by q2 = ratio q1 + offset, as a URDF `mimic` does.

        Parameters
        ----------
        articulation : str
        joint1, joint2 : str
            Joints of the articulation's Pinocchio model.
        ratio : float
            Ratio of the coordinates, in rad and m: for instance -r1 / r2 for two wheels that mesh, r for a wheel
            (joint1) and its rack. Between two continuous joints it must be a fraction of whole numbers, because their
            turns are not counted.
        offset : float, optional
            In rad or m; by default the offset that the initial configuration has.
        """
        a = self.articulations[choice(articulation, self.articulations, "articulation")]
        self.articulations[articulation] = couplings.put_gear(a, (joint1, joint2), ratio, offset)

    def _add_articulation(self, name: str, description: Description, keywords: ArticulationOptions) -> None:
        self._check_name(name)
        check_known(keywords, ArticulationOptions.__optional_keys__)
        articulation = assembly.assemble(name, description, keywords)
        articulation.model.gravity = pin.Motion(self.gravity, np.zeros(3))
        self.articulations[name] = articulation
        self.bodies |= {body.name: body for body in articulation.fixed}
