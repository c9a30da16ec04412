"""Rigid bodies, the keywords that describe a body, and the collision shapes of bodies and links."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike

from nsdyn.scene import checks
from nsdyn.scene.materials import Material
from nsdyn.scene.shapes import Shape
from nsdyn.tools.arrays import Array, numbers


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body with one shape; `mass` 0 marks a fixed body.

    Attributes
    ----------
    name : str
    shape : Shape
    mass : float
        kg.
    inertia : ndarray, shape (3, 3)
        Inertia about the centre of mass in body axes, kg m².
    position, linear_velocity, angular_velocity : ndarray, shape (3,)
        Position of the centre of mass, its velocity, and the angular velocity, world frame; m, m/s, rad/s.
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

    def __repr__(self) -> str:
        what = "fixed" if self.fixed else f"{self.mass:g} kg"
        return f"<Body {self.name!r}: {self.shape.name}, {what}, at {tuple(self.position.round(4).tolist())} m>"

    @property
    def fixed(self) -> bool:
        """Whether the body is fixed: no force moves it."""
        return self.mass == 0.0


@dataclass(frozen=True, eq=False)
class Geom:
    """One collision shape: its frame, its pose and its material.

    Attributes
    ----------
    name : str
    body : str
        Name of the body or articulation.
    shape : Shape
    frame : int
        Moving frame that carries the shape: free bodies first, then links; -1 for the world.
    placement_R, placement_t : ndarray, shapes (3, 3), (3,)
        Rotation and translation of the shape in the frame.
    material : Material
    colour : tuple of 4 floats, optional
    link : str
        "articulation/body" for a link; the name of the body for a body that is its own link.
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


class BodyOptions(TypedDict, total=False):
    """Keywords of ``Scene.add_box`` and similar methods; see `Scene.add_convex`."""

    position: ArrayLike | None
    quaternion: ArrayLike
    linear_velocity: ArrayLike
    angular_velocity: ArrayLike
    material: Material | None
    fixed: bool
    colour: ArrayLike | None
    inertia: ArrayLike | None
    com: ArrayLike


def make_body(name: str, shape: Shape, mass: float | None = None, **given: Unpack[BodyOptions]) -> Body:
    """Return a body of a mass in kg, None for a fixed one; ValueError naming the argument, expected and given value."""
    if not isinstance(shape, Shape):
        raise ValueError(f"shape of {name!r} must be one of nsdyn.scene.shapes, got {shape!r}")
    centre = checks.vector(given.get("com", (0, 0, 0)), 3, f"com of {name!r}")
    v = checks.vector(given.get("linear_velocity", (0, 0, 0)), 3, f"linear_velocity of {name!r}")
    w = checks.vector(given.get("angular_velocity", (0, 0, 0)), 3, f"angular_velocity of {name!r}")
    fixed, inertia = given.get("fixed", False), given.get("inertia")
    if not isinstance(fixed, (bool, np.bool_)):
        raise ValueError(f"fixed of {name!r} must be True or False, got {fixed!r}")
    if fixed:
        if v.any() or w.any():
            raise ValueError(f"{name!r} is fixed, so its velocity must be zero, got {v.tolist()}, {w.tolist()}")
        if mass is not None:
            raise ValueError(f"{name!r} is fixed, so its mass has no meaning, got {mass!r}")
        if centre.any():
            raise ValueError(f"{name!r} is fixed, so its com has no meaning, got {centre.tolist()}")
        m, J = 0.0, np.zeros((3, 3))
    else:
        if mass is None:
            raise ValueError(f"mass of {name!r} is needed, unless fixed=True")
        m = checks.positive(mass, f"mass of {name!r}")
        if inertia is None and centre.any():
            raise ValueError(f"inertia of {name!r} is needed: with its com at {centre.tolist()} it is not homogeneous")
        J = checks.inertia(shape.inertia(m) if inertia is None else inertia, f"inertia of {name!r}")
    position: Any = given.get("position", (0, 0, 0))
    x = checks.vector(position, 3, f"position of {name!r}")
    turn = checks.quaternion(given.get("quaternion", (0, 0, 0, 1)), f"quaternion of {name!r}")
    material, colour = _material(given.get("material"), name), _colour(given.get("colour"), name)
    return Body(name, shape, m, J, x, turn, v, w, material, colour, centre)


def _material(material: Material | None, name: str) -> Material:
    if material is not None and not isinstance(material, Material):
        raise ValueError(f"material of {name!r} must be a nsdyn.Material, got {material!r}")
    return material or Material()


def _colour(colour: ArrayLike | None, name: str) -> tuple[float, float, float, float] | None:
    if colour is None:
        return None
    rgba = numbers(colour, words := "3 or 4 numbers in [0, 1]", f"colour of {name!r}")
    if rgba.shape not in ((3,), (4,)) or not ((rgba >= 0) & (rgba <= 1)).all():
        raise ValueError(f"colour of {name!r} must be {words}, got {colour!r}")
    r, g, b, *a = rgba.tolist()
    return (r, g, b, a[0] if a else 1.0)
