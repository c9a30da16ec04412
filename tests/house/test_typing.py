"""What a type checker tells of a user's script: it knows the keywords of every call."""

import re
import subprocess
import sys

import pytest

CALLS = {
    "position": 'scene.add_box("box", (1, 1, 1), 1.0, {}=(0, 0, 1))',
    "base": 'scene.add_urdf("urdf", "robot.urdf", {}="free")',
    "self_collisions": 'scene.add_mjcf("mjcf", "robot.xml", {}=False)',
    "restitution": 'scene.add_sdf("sdf", "robot.sdf", {}=0.5)',
    "stiffness": 'scene.add_model("model", None, {}=None)',
    "theta": "run = nd.simulate(scene, 1.0, {}=0.5)",
    "overlap": "stepper = nd.Stepper(scene, {}=0.1)",
    "on_fail": 'runs = nd.sweep("slide", dict(mu=[0.1]), 1.0, {}="raise")',
    "max_points": 'found = nd.refine("slide", [1e-2, 5e-3], 1.0, {}=4)',
    "fps": 'run.to_html("run.html", {}=30)',
}
"""A keyword of each, as it is written."""


@pytest.mark.slow
def test_mypy_finds_every_misspelt_keyword(tmp_path):
    lines = ["import nsdyn as nd", "scene = nd.Scene()"]
    for name, call in CALLS.items():
        lines += [call.format(name), call.format(name + "s")]
    script = tmp_path / "script.py"
    script.write_text("\n".join(lines) + "\n")
    # Not in the clone, whose settings for mypy are those of the package itself.
    command = [sys.executable, "-m", "mypy", "--strict", "--ignore-missing-imports", str(script)]
    told = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    errors = re.findall(r'script\.py:(\d+): error: Unexpected keyword argument "(\w+)"', told.stdout)
    expected = [(str(4 + 2 * k), name + "s") for k, name in enumerate(CALLS)]
    assert errors == expected, told.stdout
    assert told.stdout.count(" error: ") == len(expected), told.stdout
