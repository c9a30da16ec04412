"""Rules for the elements of an MJCF file, named as in MuJoCo's reference."""

from collections.abc import Mapping

from nsdyn.scene.robot_files.elements import POSE, Rules

ORIENTATIONS = {*POSE.split()} - {"pos"}
"""Attributes that give an orientation; an element has at most one of them."""

LEADING = {"size", "gainprm", "biasprm"}
"""Attributes of which an element may give the first numbers only; the others are then those of its class."""

MACROS = "attach composite flexcomp frame plugin replicate"
"""Elements inside bodies that MuJoCo's compiler replaces by other elements."""

SOFT = {"solref": "0.02 1", "solimp": "0.9 0.95 0.001 0.5 2"}
"""Default values of MuJoCo's law of soft contacts and constraints; in nsdyn both are hard."""

DRIVES = "general motor position velocity intvelocity orientation pid damper cylinder muscle adhesion dcmotor plugin"
"""All kinds of actuators."""

KINDS = f"default joint geom mesh material site camera light pair equality tendon {DRIVES}"
"""Elements that have defaults."""

EQUALITIES = "connect weld joint tendon flex flexstrain flexvert distance"

BODY = Rules(
    f"name childclass class user body joint freejoint inertial geom site {POSE} {MACROS}",
    unused="camera light",
    many=f"body joint freejoint geom site {MACROS}",
    still={"gravcomp": "0", "mocap": "false"},
)

TABLE = {
    "mujoco": Rules(
        "model compiler option default worldbody equality contact asset keyframe actuator tendon deformable",
        unused="custom extension sensor size statistic visual",
        many="default",
    ),
    "default": Rules(f"class {KINDS}", many=KINDS),
    "compiler": Rules(
        # Fixed, only visible or written back parts do not matter; shapes fitted to meshes are refused.
        "angle eulerseq autolimits inertiafromgeom boundmass meshdir assetdir texturedir discardvisual fusestatic "
        "inertiagrouprange usethread savecanonical savecompiled saveinertial fitaabb lengthrange",
        missing="settotalmass",
        still={
            "settotalmass": "-1",
            "boundinertia": "0",
            "balanceinertia": "false",
            "coordinate": "local",
            "strippath": "false",
            "alignfree": "false",
        },
    ),
    "option": Rules(
        "flag",
        many="flag",
        # Options of MuJoCo's computation; magnetic fields are for sensors, o_... for flag override.
        unused="timestep integrator solver iterations tolerance ls_iterations ls_tolerance noslip_iterations "
        "noslip_tolerance ccd_iterations ccd_tolerance mpr_iterations mpr_tolerance sdf_iterations sdf_initpoints "
        "jacobian apirate sleep_tolerance cone magnetic o_margin o_solref o_solimp o_friction",
        still={"gravity": "0 0 -9.81", "wind": "0 0 0", "density": "0", "viscosity": "0", "impratio": "1"},
    ),
    "flag": Rules(
        unused="warmstart sensor midphase nativeccd multiccd eulerdamp autoreset island energy fwdinv invdiscrete "
        "sleep diagexact refsafe",
        still=dict.fromkeys(
            "constraint contact equality limit frictionloss passive spring damper gravity filterparent clampctrl "
            "actuation".split(),
            "enable",
        )
        | {"override": "disable"},
    ),
    "worldbody": BODY,
    "body": BODY,
    "inertial": Rules(f"mass diaginertia fullinertia {POSE}"),
    "freejoint": Rules("name group", still={"align": "false|auto"}),
    "joint": Rules(
        "name class group user type pos axis range limited ref stiffness springref damping armature frictionloss "
        "actuatorfrcrange actuatorfrclimited",
        still={"margin": "0", "springdamper": "0 0", "actuatorgravcomp": "false"}
        | {f"{law}{of}": value for law, value in SOFT.items() for of in ("limit", "friction")},
    ),
    "geom": Rules(
        f"name class group user type size fromto mesh hfield mass density contype conaffinity friction condim rgba "
        f"material castshadow fitscale fluidcoef {POSE}",
        still=SOFT
        | {"margin": "0", "gap": "0", "priority": "0", "solmix": "1", "shellinertia": "false", "fluidshape": "none"}
        | {"adhesion": "0", "surfacevel": "0 0 0 0 0 0"},
    ),
    "site": Rules(f"name class group user type size fromto mesh rgba material {POSE}"),
    "asset": Rules("mesh hfield model material", unused="texture skin", many="mesh hfield model material"),
    # Meshes that are only visible may have any attributes.
    "mesh of shape": Rules(
        "name class file scale vertex face normal texcoord content_type smoothnormal material inertia",
        still={"refpos": "0 0 0", "refquat": "1 0 0 0", "maxhullvert": "-1"},
    ),
    "deformable": Rules(unused="skin", missing="flex"),
    "contact": Rules("pair exclude", many="pair exclude"),
    "exclude": Rules("name body1 body2"),
    "equality": Rules(EQUALITIES, many=EQUALITIES),
    "connect": Rules("name class active body1 body2 site1 site2 anchor", still=SOFT),
    "weld": Rules("name class active body1 body2 site1 site2 anchor relpose", still=SOFT | {"torquescale": "1"}),
    "equality/joint": Rules("name class active joint1 joint2 polycoef", still=SOFT),
    "keyframe": Rules("key", many="key"),
}


def over(inherited: Mapping[str, str], own: Mapping[str, str]) -> dict[str, str]:
    """Merge inherited and own attributes; an own orientation replaces an inherited one, in any of their forms."""
    if ORIENTATIONS & own.keys():
        inherited = {name: value for name, value in inherited.items() if name not in ORIENTATIONS}
    out = {**inherited, **own}
    for name in LEADING & inherited.keys() & own.keys():
        given = own[name].split()
        out[name] = " ".join(given + inherited[name].split()[len(given) :])
    return out
