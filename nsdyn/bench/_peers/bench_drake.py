"""Worker of Drake, run as a script; it runs in the Python that nsdyn runs in.

Variants: ``default``, a multibody plant with default settings; ``sap``, ``similar`` and ``tamsi``, the contact
approximations of these names with a stiction tolerance of 1e-6 m/s, relaxation times of one step and stiff contacts:
compliant hydroelastic boxes of 1e7 Pa, which touch in areas, or spheres of 1e7 N/m, which touch in points; ``rk5``, a
continuous plant with Runge–Kutta steps of fifth order, for scenes without contact. Drake has no restitution.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from pydrake.common.eigen_geometry import Quaternion
from pydrake.geometry import (
    AddCompliantHydroelasticProperties,
    AddContactMaterial,
    AddRigidHydroelasticProperties,
    Box,
    HalfSpace,
    ProximityProperties,
    Sphere,
)
from pydrake.math import RigidTransform, RotationMatrix
from pydrake.multibody.math import SpatialVelocity
from pydrake.multibody.plant import AddMultibodyPlant, CoulombFriction, MultibodyPlantConfig
from pydrake.multibody.tree import SpatialInertia, UnitInertia
from pydrake.systems.analysis import ResetIntegratorFromFlags, Simulator
from pydrake.systems.framework import DiagramBuilder
from stepping import serve

MODULUS, STIFFNESS = 1e7, 1e7  # Pa of boxes, N/m of spheres
DISSIPATION = 20.0  # s/m
STICTION = 1e-6  # m/s


class Simulation:
    """A Drake diagram of one plant."""

    def __init__(self, scene: dict[str, Any], variant: str, dt: float) -> None:
        builder = DiagramBuilder()
        config = MultibodyPlantConfig(time_step=0.0 if variant == "rk5" else dt)
        if variant in ("sap", "similar", "tamsi"):
            config.discrete_contact_approximation = variant
            config.stiction_tolerance = STICTION
            config.contact_model = "hydroelastic_with_fallback"
        self.plant, _ = AddMultibodyPlant(config, builder)
        stiff = variant != "default"
        for k, ground in enumerate(scene["grounds"]):
            normal = np.array(ground["normal"])
            pose = RigidTransform(RotationMatrix.MakeFromOneVector(normal, 2), ground["offset"] * normal)
            properties = material(scene["mu"], dt if stiff else None)
            if stiff:
                AddRigidHydroelasticProperties(1.0, properties)
            self.plant.RegisterCollisionGeometry(self.plant.world_body(), pose, HalfSpace(), f"ground{k}", properties)
        for k, body in enumerate(scene["bodies"]):
            self.add(body, f"body{k}", scene["mu"], dt if stiff else None)
        self.plant.mutable_gravity_field().set_gravity_vector(scene["gravity"])
        self.plant.Finalize()
        self.simulator = Simulator(builder.Build())
        if variant == "rk5":
            ResetIntegratorFromFlags(self.simulator, "runge_kutta5", dt).set_fixed_step_mode(True)
        context = self.plant.GetMyMutableContextFromRoot(self.simulator.get_mutable_context())
        for k, body in enumerate(scene["bodies"]):
            x, y, z, w = body["quaternion"]
            link = self.plant.GetBodyByName(f"body{k}")
            pose = RigidTransform(Quaternion([w, x, y, z]), body["position"])
            self.plant.SetFreeBodyPose(context, link, pose)
            velocity = SpatialVelocity(body["angular_velocity"], body["linear_velocity"])
            self.plant.SetFreeBodySpatialVelocity(context=context, body=link, V_JpJc=velocity)
        self.context, self.dt, self.count = context, dt, 0
        self.simulator.Initialize()

    def add(self, body: dict[str, Any], name: str, mu: float, relaxation: float | None) -> None:
        """Add a body with its inertia and its shape."""
        inertia = UnitInertia(*(np.array(body["inertia"]) / body["mass"]))
        link = self.plant.AddRigidBody(name, SpatialInertia(body["mass"], np.zeros(3), inertia))
        properties = material(mu, relaxation)
        if body["shape"] == "box":
            shape = Box(*body["size"])
            if relaxation is not None:
                AddCompliantHydroelasticProperties(min(body["size"]), MODULUS, properties)
        else:
            shape = Sphere(body["size"][0])
        self.plant.RegisterCollisionGeometry(link, RigidTransform(), shape, name, properties)

    def advance(self, steps: int) -> None:
        """Take steps in Drake's own loop."""
        self.count += steps
        self.simulator.AdvanceTo(self.count * self.dt)

    def poses(self) -> Any:
        """Return the poses of the free bodies; Drake's quaternions begin with w and come before positions."""
        q = self.plant.GetPositions(self.context).reshape(-1, 7)
        return q[:, [4, 5, 6, 1, 2, 3, 0]]


def material(mu: float, relaxation: float | None) -> ProximityProperties:
    """Return friction, and the properties of a stiff contact if a relaxation time is given."""
    out = ProximityProperties()
    friction = CoulombFriction(mu, mu)
    if relaxation is None:
        AddContactMaterial(friction=friction, properties=out)
    else:
        AddContactMaterial(DISSIPATION, STIFFNESS, friction, out)
        out.AddProperty("material", "relaxation_time", relaxation)
    return out


def variants(scene: dict[str, Any]) -> list[str]:
    """Return the settings that can simulate the scene."""
    if scene["restitution"]:
        return []
    return ["default", "sap", "similar", "tamsi"] if scene["grounds"] else ["default", "rk5"]


serve(variants, Simulation)
