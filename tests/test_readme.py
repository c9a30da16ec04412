"""The README's Python runs as it stands and its `nsdyn` commands work; `.ci/run` runs the two install commands."""

import re
from pathlib import Path

import pytest

from nsdyn.cli import main

ROOT = Path(__file__).resolve().parent.parent
BLOCKS = re.findall(r"```(\w+)\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)


def test_python(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (code,) = (text for language, text in BLOCKS if language == "python")
    names: dict = {}
    exec(compile(code, "README.md", "exec"), names)
    trajectory = names["trajectory"]
    assert trajectory.body("box").position[-1, 0] == pytest.approx(2.0**2 / (2 * 0.3 * 9.81), abs=1e-5)
    assert trajectory.energy.friction.sum() == pytest.approx(-2.0, abs=1e-5)
    assert (tmp_path / "slide.h5").exists() and (tmp_path / "slide.html").exists()


def test_commands(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    lines = [line for language, text in BLOCKS if language == "bash" for line in text.splitlines()]
    ours = [line.split()[1:] for line in lines if line.startswith("nsdyn ")]
    assert len(ours) >= 5
    for arguments in ours:
        assert main(arguments) == 0, arguments
    assert {"slide.h5", "slide.html", "energy.png", "energy.csv"} <= {p.name for p in tmp_path.iterdir()}


def test_install_commands_are_those_of_ci():
    lines = [line for language, text in BLOCKS if language == "bash" for line in text.splitlines()]
    assert sum("nsdyn run stack" in line for line in lines) == 1
    assert sum("python -m pytest" in line for line in lines) == 1


def test_every_dependency_has_its_reason():
    import tomllib

    text = (ROOT / "README.md").read_text()
    for requirement in tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]:
        assert f"`{re.split('[<>=]', requirement)[0]}`" in text, requirement
