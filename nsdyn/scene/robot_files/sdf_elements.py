"""Rules for the elements of an SDF file, named as in its specification up to 1.12."""

from nsdyn.scene.robot_files.elements import Rules

HARD = {"soft_cfm": "0", "soft_erp": "0.2", "kp": "1e12", "kd": "1", "max_vel": "0.01", "min_depth": "0"}
"""Default values of Gazebo's law of soft contact; in nsdyn contact is hard."""

AXIS = Rules("xyz use_parent_model_frame dynamics limit mimic", still={"initial_position": "0"})

POSE = Rules("relative_to rotation_format degrees", still={"frame": ""})

TABLE = {
    "sdf": Rules("version world model", unused="actor light", many="world model"),
    "world": Rules(
        "name model gravity wind frame",
        # Air and magnetic fields are for sensors and plugins.
        unused="audio magnetic_field atmosphere gui physics scene light road spherical_coordinates actor",
        missing="include joint",
        many="model frame",
    ),
    "wind": Rules(still={"linear_velocity": "0 0 0"}),
    "model": Rules(
        "name canonical_link link joint frame pose static self_collide",
        unused="allow_auto_disable namespace",
        many="link joint frame",
        still={"enable_wind": "false", "placement_frame": ""},
    ),
    "model/pose": Rules("rotation_format degrees", still={"relative_to": "", "frame": ""}),
    "frame": Rules("name attached_to pose"),
    "pose": POSE,
    "link": Rules(
        "name pose inertial collision visual velocity_decay",
        many="collision visual",
        unused="must_be_base_link sensor projector audio_sink audio_source battery light particle_emitter",
        still={"gravity": "true", "kinematic": "false", "enable_wind": "false", "self_collide": "false"},
    ),
    "velocity_decay": Rules(still={"linear": "0", "angular": "0"}),
    # Densities belong to automatic inertias, which are reported.
    "inertial": Rules("auto pose mass inertia density auto_inertia_params fluid_added_mass"),
    "inertia": Rules("ixx iyy izz ixy ixz iyz"),
    "fluid_added_mass": Rules(
        still=dict.fromkeys("xx xy xz xp xq xr yy yz yp yq yr zz zp zq zr pp pq pr qq qr rr".split(), "0")
    ),
    "collision": Rules("name pose geometry surface density auto_inertia_params", unused="laser_retro max_contacts"),
    "geometry": Rules("box sphere cylinder capsule ellipsoid plane mesh empty cone heightmap image polyline"),
    "box": Rules("size"),
    "sphere": Rules("radius"),
    "cylinder": Rules("radius length"),
    "capsule": Rules("radius length"),
    "ellipsoid": Rules("radii"),
    "plane": Rules("normal size"),
    "mesh": Rules("uri scale", still={"optimization": ""}),
    "surface": Rules("friction bounce contact"),
    "surface/friction": Rules("ode bullet torsional"),
    "friction/ode": Rules("mu mu2", still={"fdir1": "0 0 0", "slip1": "0", "slip2": "0"}),
    "friction/bullet": Rules(still={"friction": "1", "friction2": "1", "fdir1": "0 0 0", "rolling_friction": "0|1"}),
    # Without a radius there is no torsional friction, with any coefficient.
    "torsional": Rules("coefficient use_patch_radius ode", still={"patch_radius": "0", "surface_radius": "0"}),
    "torsional/ode": Rules(still={"slip": "0"}),
    "bounce": Rules("threshold", still={"restitution_coefficient": "0"}),
    "contact": Rules(
        "ode bullet collide_without_contact_bitmask",
        still={
            "collide_without_contact": "false",
            "collide_bitmask": "65535|0xffff",
            "category_bitmask": "65535|0xffff",
            "poissons_ratio": "0.3",
            "elastic_modulus": "-1",
        },
    ),
    "contact/ode": Rules(still=HARD | {"min_depth": "0|0.001"}),
    "contact/bullet": Rules("split_impulse split_impulse_penetration_threshold", still=HARD),
    "joint": Rules(
        "name type parent child pose axis axis2 physics",
        unused="sensor",
        still={"gearbox_ratio": "1", "thread_pitch": "1", "screw_thread_pitch": "1"},
    ),
    "axis": AXIS,
    "axis2": AXIS,
    "xyz": Rules("expressed_in"),
    "dynamics": Rules("damping friction spring_stiffness spring_reference"),
    "limit": Rules("lower upper effort velocity", still={"stiffness": "1e8", "dissipation": "1"}),
    "mimic": Rules("joint axis multiplier offset reference"),
    "joint/physics": Rules("ode simbody", unused="provide_feedback"),
    "physics/ode": Rules(
        "limit suspension",
        unused="cfm_damping implicit_spring_damper provide_feedback",
        still={"fudge_factor": "0", "cfm": "0", "erp": "0.2", "bounce": "0", "max_force": "0", "velocity": "0"},
    ),
    "ode/limit": Rules(still={"cfm": "0", "erp": "0.2"}),
    "suspension": Rules(still={"cfm": "0", "erp": "0.2"}),
    "simbody": Rules(still={"must_be_loop_joint": "false"}),
}
