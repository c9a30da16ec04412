"""The Python of all pages runs as it stands, their `nsdyn` commands work; `.ci/run` runs the two install commands."""

import re
from pathlib import Path

import pytest

from nsdyn.cli import main

ROOT = Path(__file__).resolve().parent.parent


def blocks(page):
    """(language, text) of the blocks of code of a page."""
    return re.findall(r"```(\w+)\n(.*?)```", (ROOT / page).read_text(), re.DOTALL)


BLOCKS = blocks("README.md")


def executed(page):
    """Names that the one block of Python of a page leaves."""
    (code,) = (text for language, text in blocks(page) if language == "python")
    names: dict = {}
    exec(compile(code, page, "exec"), names)
    return names


def commands(page):
    """Arguments of the `nsdyn` commands of a page."""
    lines = [line for language, text in blocks(page) if language == "bash" for line in text.splitlines()]
    return [line.split()[1:] for line in lines if line.startswith("nsdyn ")]


def test_python(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = executed("README.md")
    trajectory = names["trajectory"]
    assert trajectory.body("box").position[-1, 0] == pytest.approx(2.0**2 / (2 * 0.3 * 9.81), abs=1e-5)
    assert trajectory.energy.friction.sum() == pytest.approx(-2.0, abs=1e-5)
    assert (tmp_path / "slide.h5").exists() and (tmp_path / "slide.html").exists()


@pytest.mark.slow  # every one of them, the sweeps and the bench among them
def test_commands(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    ours = commands("README.md")
    assert len(ours) >= 5
    for arguments in ours:
        assert main(arguments) == 0, arguments
    assert {"slide.h5", "slide.html", "energy.png", "energy.csv"} <= {p.name for p in tmp_path.iterdir()}


def test_coming_from_other_engines(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = executed("demos/coming_from.md")
    assert names["stopped"] == pytest.approx(0.40775, abs=6e-5)  # mu g dt²/8 of the last step
    assert names["force"].shape == (60, 3) and names["force"][0] == pytest.approx((-0.5 * 9.81, 0, 9.81), abs=1e-6)
    assert len(names["contacts"]) == 4
    ours = commands("demos/coming_from.md")
    assert len(ours) == 8
    for arguments in ours:
        assert main(arguments) == 0, arguments
    assert {"my.py", "my.h5", "my.html", "my.png", "contacts.csv"} <= {p.name for p in tmp_path.iterdir()}


@pytest.mark.slow
@pytest.mark.parametrize("arguments", commands("demos/README.md"), ids=lambda arguments: arguments[1])
def test_commands_of_the_gallery(tmp_path, monkeypatch, arguments):
    monkeypatch.chdir(tmp_path)
    assert main(arguments) == 0


@pytest.mark.parametrize("page", ["README.md", "demos/README.md", "demos/coming_from.md"])
def test_links_lead_to_files(page):
    folder = (ROOT / page).parent
    links = [link for link in re.findall(r"\]\(([^)#]+)[^)]*\)", (ROOT / page).read_text()) if ":" not in link]
    assert links and not [link for link in links if not (folder / link).exists()]


def test_install_commands_are_those_of_ci():
    lines = [line for language, text in BLOCKS if language == "bash" for line in text.splitlines()]
    assert sum("nsdyn run stack" in line for line in lines) == 1
    assert sum("python -m pytest" in line for line in lines) == 1


def test_every_dependency_has_its_reason():
    import tomllib

    text = (ROOT / "README.md").read_text()
    for requirement in tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]:
        assert f"`{re.split('[<>=]', requirement)[0]}`" in text, requirement
