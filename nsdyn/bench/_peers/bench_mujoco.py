"""Worker of MuJoCo, run as a script; it runs in the Python that nsdyn runs in.

Variants: ``default``, MuJoCo with default settings; ``elliptic``, elliptic cones with impratio 1e4 and a solver
tolerance of 1e-12; ``stiff``, in addition the stiffest contacts that do not chatter (solref of three steps), and for
restitution a damped spring that holds contact for ten steps and rebounds by Newton's law; ``rk4`` for scenes without
contact.
"""

from __future__ import annotations

import math
from typing import Any

import mujoco
import numpy as np

MUJOCO_XYZW = [4, 5, 6, 3]  # MuJoCo's quaternions begin with w


class Simulation:
    """Model and data of MuJoCo, stepped in one call."""

    def __init__(self, scene: dict[str, Any], variant: str, dt: float) -> None:
        self.model = mujoco.MjModel.from_xml_string(mjcf(scene, variant, dt))
        self.data = mujoco.MjData(self.model)
        for k, body in enumerate(scene["bodies"]):
            self.data.qvel[6 * k : 6 * k + 3] = body["linear_velocity"]
            # MuJoCo's angular velocity is in body axes.
            R = np.empty(9)
            mujoco.mju_quat2Mat(R, self.data.qpos[7 * k + 3 : 7 * k + 7])
            self.data.qvel[6 * k + 3 : 6 * k + 6] = R.reshape(3, 3).T @ body["angular_velocity"]

    def advance(self, steps: int) -> None:
        """Take steps in MuJoCo's own loop."""
        mujoco.mj_step(self.model, self.data, nstep=steps)

    def poses(self) -> Any:
        """Return the poses of the free bodies; RuntimeError after a bad state, for which MuJoCo starts again."""
        bad = (mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC)
        if any(self.data.warning[k].number for k in bad):
            raise RuntimeError("the state is not finite")
        return self.data.qpos.reshape(-1, 7)[:, [0, 1, 2, *MUJOCO_XYZW]]


def variants(scene: dict[str, Any]) -> list[str]:
    """Return the settings that can simulate the scene."""
    if not scene["grounds"]:
        return ["default", "rk4"]
    return ["default", "elliptic", "stiff"]


def mjcf(scene: dict[str, Any], variant: str, dt: float) -> str:
    """Return the scene as MJCF text."""
    options = {"default": "", "rk4": 'integrator="RK4"'}.get(
        variant, 'cone="elliptic" impratio="1e4" tolerance="1e-12"'
    )
    contact = f'friction="{scene["mu"]} 0 0"'
    if variant == "stiff":
        contact += f' solref="{solref(scene["restitution"], dt)}" solimp=".99 .999 .001"'
    geoms = [
        f'<geom type="plane" size="100 100 1" pos="{text(g["offset"] * np.array(g["normal"]))}" '
        f'zaxis="{text(g["normal"])}" {contact}/>'
        for g in scene["grounds"]
    ]
    bodies = []
    for body in scene["bodies"]:
        size = text(np.array(body["size"]) / 2) if body["shape"] == "box" else body["size"][0]
        x, y, z, w = body["quaternion"]
        bodies.append(
            f'<body pos="{text(body["position"])}" quat="{w} {x} {y} {z}"><freejoint/>'
            f'<inertial pos="0 0 0" mass="{body["mass"]}" diaginertia="{text(body["inertia"])}"/>'
            f'<geom type="{body["shape"]}" size="{size}" {contact}/></body>'
        )
    return (
        f'<mujoco><option timestep="{dt}" gravity="{text(scene["gravity"])}" {options}/><size memory="500M"/>'
        f"<worldbody>{''.join(geoms + bodies)}</worldbody></mujoco>"
    )


def text(vector: Any) -> str:
    """Return numbers in the format of MJCF, with all their digits."""
    return " ".join(repr(float(x)) for x in vector)


def solref(restitution: float, dt: float) -> str:
    """Return time constant and damping ratio of a contact.

    A spring with damping ratio ζ rebounds by e = exp(-πζ/√(1 - ζ²)) after half a period π/ω = 10 dt.
    """
    if restitution == 0.0:
        return f"{3.0 * dt} 1"
    damping = -math.log(restitution) / math.hypot(math.pi, math.log(restitution))
    return f"{10.0 * dt / (math.pi * damping)} {damping}"


if __name__ == "__main__":
    from stepping import serve

    mujoco.set_mju_user_warning(lambda message: None)  # else it writes a log to the working folder
    serve(variants, Simulation)
