"""Robots from texts in URDF, MJCF or SDF."""

import nsdyn as nd

FORMATS = {"<robot": "urdf", "<mujoco": "mjcf", "<sdf": "sdf"}


def scene_of(folder, text, name="r", **options):
    """A scene with the robot of a text, which is written to a file in a folder."""
    (kind,) = (kind for start, kind in FORMATS.items() if text.startswith(start))
    path, scene = folder / f"{name}.{kind}", nd.Scene()
    path.write_text(text)
    getattr(scene, f"add_{kind}")(name, path, **options)
    return scene


def robot_of(folder, text, name="r", **options):
    """The articulation of a text, in a scene of its own."""
    return scene_of(folder, text, name, **options).articulations[name]
