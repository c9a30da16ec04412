"""The scene a user describes: bodies, articulations, materials, gravity.

A scene collects and checks its parts; it simulates nothing. SI units, world frame, quaternions xyzw.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from html import escape
from typing import Any

import numpy as np

from nsdyn.scene import checks, description, shapes
from nsdyn.scene.bodies import Body, Geom
from nsdyn.scene.exclusions import carriers
from nsdyn.scene.materials import COMBINATION_RULES, Material
from nsdyn.scene.parts import Parts
from nsdyn.scene.prescribed import Motion, Velocity
from nsdyn.tools import notebook
from nsdyn.tools.naming import choice, counted, unknown


@dataclass(eq=False)
class Scene(Parts):
    """Bodies, articulations and materials under gravity.

    Parameters
    ----------
    gravity : sequence of 3 floats
        m/s².
    friction_rule, restitution_rule : str
        Name of the rule in `COMBINATION_RULES` that combines the coefficients of two materials.
    name : str
        Shown in recordings.

    Attributes
    ----------
    bodies : dict of str to Body
        Bodies by name, in the order they were added.
    articulations : dict of str to Articulation
    pairs : dict of frozenset of str to (float or None, float or None)
        Friction and restitution of two bodies, as given to `set_pair`.
    motions : dict of str to Motion
        Prescribed motions, as given to `set_motion`.
    parameters : dict
        Parameters that the scene was made with, by name. Recordings keep them, so that two recordings can be compared.
        In scenes of `nsdyn.scenes` and scenes made by `nsdyn.sweep` and `nsdyn.refine` they are the arguments of the
        function that made the scene; in your own scenes fill them yourself.

    Raises
    ------
    ValueError
        In the constructor and every ``add_*``, naming the argument, the expected value and the given value.

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

    friction_rule: str = "geometric_mean"
    restitution_rule: str = "max"
    name: str = "scene"
    pairs: dict[frozenset[str], tuple[float | None, float | None]] = field(default_factory=dict, init=False)
    motions: dict[str, Motion] = field(default_factory=dict, init=False)
    parameters: dict[str, Any] = field(default_factory=dict, init=False)

    def __post_init__(self) -> None:
        checks.text(self.name, "name")
        for argument in ("friction_rule", "restitution_rule"):
            choice(getattr(self, argument), COMBINATION_RULES, argument)

    def __repr__(self) -> str:
        free = len(self.free_bodies)
        fixed, trees = len(self.bodies) - free, len(self.articulations)
        robots = counted(trees, "articulation")
        return f"<Scene {self.name!r}: {counted(free, 'free body', 'free bodies')}, {fixed} fixed, {robots}>"

    def _repr_html_(self) -> str:
        head = ["body", "shape", "mass [kg]", "position [m]", "mu", "restitution"]
        rows: list[list[object]] = []
        for b in self.bodies.values():
            mass, m = "fixed" if b.fixed else float(b.mass), b.material
            rows.append([b.name, b.shape.name, mass, b.position.tolist(), float(m.mu), float(m.restitution)])
        trees = "".join(f"<p>{escape(repr(a).strip('<>'))}</p>" for a in self.articulations.values())
        return notebook.table(repr(self).strip("<>"), head, rows) + trees

    # -- prescribed motion -------------------------------------------------------------------------------------

    def set_motion(self, name: str, velocity: Velocity | None = None, surface_velocity: Velocity | None = None) -> None:
        """Prescribe the motion of a fixed body, of its surface, or of a joint; its work is in the ledger.

        A later call for the same name replaces the motion.

        A body or joint with prescribed motion pushes free bodies out of its way. If it moves into a fixed body, another
        prescribed motion or the limit of its own joint, a step raises a ValueError that names both, the depth and the
        time.

        Parameters
        ----------
        name : str
            A fixed body, or "articulation/joint" for a joint with one coordinate.
        velocity : array or callable
            Constant, or a function of the time in s. For a body: linear (3,) [m/s] of its centre, or (linear, angular
            [rad/s]), world axes; the body moves and pushes bodies in its way. For a joint: rad/s or m/s.
        surface_velocity : array or callable
            The same for a surface that moves while the body stays at rest: a conveyor, a turning drum. The component
            along the normal of a contact has no effect.

        Raises
        ------
        ValueError
            If no fixed body or joint has the name, or a value does not fit.
        """
        if (velocity is None) == (surface_velocity is None):
            raise ValueError(f"motion of {name!r} needs either velocity or surface_velocity")
        owner, _, joint = checks.text(name, "name").partition("/")
        if name not in self.bodies and owner in self.articulations:
            a = self.articulations[owner]
            choice(name, [f"{owner}/{one}" for one in list(a.model.names)[1:]], "joint")
            if a.model.joints[a.model.getJointId(joint)].nv != 1:
                raise ValueError(f"joint {name!r} must have one coordinate to be driven")
            if velocity is None:
                raise ValueError(f"joint {name!r} has a velocity, but no surface_velocity")
            motion = Motion(name, velocity, "joint")
            motion.rate(0.0)
        else:
            body = self.bodies.get(name)
            if body is None or not body.fixed:
                joints = [f"{a.name}/{one}" for a in self.articulations.values() for one in list(a.model.names)[1:]]
                known = [*(b.name for b in self.bodies.values() if b.fixed), *joints]
                raise ValueError(unknown(name, known, "fixed body or joint"))
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
        """Give two bodies their own coefficients, in place of the combination rule; None leaves the value of the rule.

        The name of an articulation means all its bodies; "articulation/body" means one of them and takes precedence.
        Raise ValueError for unknown bodies, without a coefficient, and for the same body twice, since a body never
        touches itself.
        """
        links = dict.fromkeys(f"{r.name}/{link.body}" for r in self.articulations.values() for link in r.links)
        known = [*self.bodies, *self.articulations, *links]
        for name in (a, b):
            choice(name, known, "body")
        if mu is None and restitution is None:
            raise ValueError(f"the pair of {a!r} and {b!r} needs mu or restitution")
        Material(0.0 if mu is None else mu, 0.0 if restitution is None else restitution)
        if a == b and a not in self.articulations:
            raise ValueError(f"the pair of {a!r} and itself never touches: only parts of an articulation do")
        self.pairs[frozenset((a, b))] = (mu, restitution)

    # -- data for the stepper ----------------------------------------------------------------------------------

    @property
    def free_bodies(self) -> list[Body]:
        """Free bodies, in the order they were added."""
        return [b for b in self.bodies.values() if not b.fixed]

    @property
    def driven_bodies(self) -> list[Body]:
        """Fixed bodies with a prescribed motion; their frames come last."""
        return [b for b in self.bodies.values() if b.name in self.motions and self.motions[b.name].kind == "body"]

    def link_frames(self) -> list[tuple[str, int]]:
        """(articulation name, joint) of every moving frame that carries a body or shapes, in frame order."""
        frames = []
        for a in self.articulations.values():
            carrying = carriers(a.model) | {link.joint for link in a.links} | {visual.joint for visual in a.visuals}
            frames += [(a.name, joint) for joint in sorted(carrying - {0})]
        return frames

    def geoms(self) -> list[Geom]:
        """All collision shapes: bodies in the order they were added, then links."""
        frame_of: dict[Any, int] = {b.name: k for k, b in enumerate(self.free_bodies)}
        for key in [*self.link_frames(), *(b.name for b in self.driven_bodies)]:
            frame_of[key] = len(frame_of)
        out = []
        for b in self.bodies.values():
            R, t = (np.eye(3), -b.com) if b.name in frame_of else (checks.rotation(b.quaternion), b.position)
            out.append(Geom(b.name, b.name, b.shape, frame_of.get(b.name, -1), R, t, b.material, b.colour, b.name))
        for a in self.articulations.values():
            for link in a.links:
                frame, label = frame_of.get((a.name, link.joint), -1), f"{a.name}/{link.name}"
                R, t = np.array(link.placement.rotation), np.array(link.placement.translation)
                out.append(Geom(label, a.name, link.shape, frame, R, t, link.material, None, f"{a.name}/{link.body}"))
        return out

    def describe(self) -> dict[str, Any]:
        """Return everything needed to replay a recording, as nested lists (see `nsdyn.recording.columns`)."""
        return description.describe(self)
