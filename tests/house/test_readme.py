"""The Python of all pages runs as it stands, their `nsdyn` commands work; `.ci/run` runs the two install commands."""

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

import nsdyn as nd
from nsdyn.cli import main

ROOT = Path(__file__).resolve().parent.parent.parent
GUIDE = sorted(f"demos/guide/{page.name}" for page in (ROOT / "demos" / "guide").glob("*.md"))
PAGES = ["README.md", "demos/README.md", *GUIDE]


def blocks(page):
    """(language, text) of the blocks of code of a page."""
    return re.findall(r"```(\w+)\n(.*?)```", (ROOT / page).read_text(), re.DOTALL)


BLOCKS = blocks("README.md")


def executed(page):
    """Names that the Python of a page leaves, all blocks one after the other."""
    names: dict = {"__name__": "page"}
    exec(compile("\n".join(text for language, text in blocks(page) if language == "python"), page, "exec"), names)
    return names


def commands(page):
    """Arguments of the `nsdyn` commands of a page."""
    lines = [line for language, text in blocks(page) if language == "bash" for line in text.splitlines()]
    return [line.split()[1:] for line in lines if line.startswith("nsdyn ")]


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_readme(folder):
    names = executed("README.md")
    trajectory = names["trajectory"]
    assert trajectory.body("box").position[-1, 0] == pytest.approx(2.0**2 / (2 * 0.3 * 9.81), abs=1e-5)
    assert trajectory.energy.friction.sum() == pytest.approx(-2.0, abs=1e-5)
    assert (folder / "slide.h5").exists() and (folder / "slide.html").exists()
    assert len((ROOT / "README.md").read_text().splitlines()) <= 150


def test_first_scene():
    names = executed("demos/guide/first_scene.md")
    assert names["x"] == pytest.approx(0.6796, abs=1e-4) and names["lost"] == pytest.approx(-2.0, abs=1e-5)
    assert names["further"] > 1.0 and names["same"]


def test_step():
    names = executed("demos/guide/step.md")
    assert (names["slip"][:, 0] > 1.9).all()  # it slides
    np.testing.assert_allclose(names["cone"], 0.0, rtol=0, atol=1e-7)  # N·s, of impulses of 0.02
    assert names["J"].shape == (12, 6) and names["M"].shape == (6, 6) and names["forces"].shape == (6,)
    assert names["apex"] == pytest.approx(0.64, abs=9.81 * 5e-3**2 / 2)  # half a step from the apex


def test_solvers():
    names = executed("demos/guide/solvers.md")
    np.testing.assert_allclose(names["solution"].r, [1.0, -0.2, 0.0], rtol=0, atol=1e-8)
    assert names["tight"].error <= 1e-10 and set(names["run"].solver.status_names) == {"CONVERGED"}


def test_answers():
    names = executed("demos/guide/answers.md")
    assert names["audit"].passed
    assert names["sharp"] < 0.3 * names["plain"] and names["defect"] < names["sharp"]


def test_accuracy():
    assert len(executed("demos/guide/accuracy.md")["study"].rows) == 3


def test_robots():
    names = executed("demos/guide/robots.md")
    assert nd.check(names["run"]).passed and nd.check(names["swing"]).passed
    assert names["elbow"].reaction_force.shape == (250, 3)
    assert np.abs(names["closure"]).max() > 1.0  # N: it carries weight
    assert names["touch"].force.shape == (names["touch"].gap.size, 3)
    # Where gravity bends back what the servo gives: 40 (0.4 - q) = 9.81 · 0.2 sin q, once it has stopped.
    end = names["bent"].q[-1, 0]
    assert 40 * (0.4 - end) == pytest.approx(9.81 * 0.2 * np.sin(end), abs=0.05)


def test_recordings():
    names = executed("demos/guide/recordings.md")
    assert names["speeds"] == pytest.approx([2 - 0.25 * 9.81 * 0.2, 2 - 0.5 * 9.81 * 0.2], abs=1e-6)
    assert names["parted"].options["mu"] == (0.5, 0.4)


def test_extending():
    """Each example does what it says: drag takes energy, slow impacts do not rebound, the solver solves."""
    names = executed("demos/guide/extending.md")
    fall = names["fall"]
    assert names["lost"] < -1.0 and np.ptp(fall.energy.total) == pytest.approx(-names["lost"], rel=1e-9)
    calm = names["calm"].body("ball")
    # It falls at 3.1 m/s, then at half of that, ..., and 0.39 m/s is too slow to rebound.
    assert calm.position[-1, 2] == pytest.approx(0.1, abs=1e-9) and np.abs(calm.linear_velocity[-1, 2]) <= 1e-9
    np.testing.assert_allclose(names["ours"].u, names["theirs"].u, rtol=0, atol=1e-7)
    assert set(names["slide"].solver.status_names) == {"CONVERGED"}
    assert names["ramp"].bodies["ramp"].shape.volume == pytest.approx(0.2)
    assert names["swing"].energy.kinetic[0] == pytest.approx(0.5 * (0.5**2 + 0.4 * 0.1**2) * (1.0 + 2.0**2), rel=1e-12)
    assert all(nd.check(names[run]).passed for run in ("fall", "calm", "slide", "swing"))


def test_coming_from_other_engines():
    names = executed("demos/guide/coming_from.md")
    assert names["stopped"] == pytest.approx(0.40775, abs=6e-5)  # mu g dt²/8 of the last step
    assert names["force"].shape == (60, 3) and names["force"][0] == pytest.approx((-0.5 * 9.81, 0, 9.81), abs=1e-6)
    assert len(names["contacts"]) == 4


@pytest.mark.slow
@pytest.mark.parametrize("page", [page for page in GUIDE if commands(page)])
def test_commands(page, folder):
    """In a folder where the Python of the page has run; every file that they name is made."""
    executed(page)
    ours = commands(page)
    for arguments in ours:
        assert main(arguments) == 0, arguments
    endings = r"[\w.]+\.(?:h5|html|png|pdf|csv|jsonl|py|hdf5)"
    files = {a for arguments in ours for a in arguments if re.fullmatch(endings, a)}
    assert files <= {p.name for p in folder.iterdir()}


def test_names_of_the_notation_page_are_in_the_code():
    from nsdyn.dynamics.dynamics import Dynamics
    from nsdyn.dynamics.trees import Tree
    from nsdyn.problem import cones, gauss
    from nsdyn.recording import joint_tables, series
    from nsdyn.stepping.contact_kinematics import ContactKinematics

    text = (ROOT / "demos" / "guide" / "notation.md").read_text()
    pairs = re.findall(r"`(\w+)\.(\w+)`", text)
    assert len(pairs) > 40
    places = [nd, nd.solvers, nd.impacts, series, joint_tables, gauss]
    owners = {"Dynamics": Dynamics, "Tree": Tree, "cones": cones, "FC3D": nd.FC3D(np.eye(3), np.ones(3), [0.5])}
    owners["ContactKinematics"] = ContactKinematics
    for owner, name in pairs:
        what = owners.get(owner) or next(getattr(place, owner) for place in places if hasattr(place, owner))
        assert hasattr(what, name) or name in getattr(what, "__annotations__", {}), f"{owner}.{name}"


@pytest.mark.parametrize("page", GUIDE)
def test_every_page_with_code_has_a_test(page):
    if any(language in ("python", "bash") for language, _ in blocks(page)):
        assert f'executed("{page}")' in Path(__file__).read_text()


@pytest.mark.parametrize("page", PAGES)
def test_every_figure_names_the_command_that_draws_it(page):
    """Near it, or once in the head of a page that one command writes."""
    paragraphs = [p for p in (ROOT / page).read_text().split("\n\n") if p.strip()]
    command = re.compile(r"`(python demos|nsdyn) ?[^`]+`")
    written = "Written by `python" in paragraphs[1] or "writes this page" in paragraphs[1]
    for k, paragraph in enumerate(paragraphs):
        if paragraph.startswith("![") and not written:
            assert command.search("\n".join(paragraphs[max(k - 1, 0) : k + 2])), paragraph


@pytest.mark.slow
@pytest.mark.parametrize("arguments", commands("demos/README.md"), ids=lambda arguments: arguments[1])
def test_commands_of_the_gallery(arguments):
    assert main(arguments) == 0


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_to_files_and_headings(page):
    text, folder = (ROOT / page).read_text(), (ROOT / page).parent
    links = [link for link in re.findall(r"\]\(([^)\s]+)\)", text) if ":" not in link]
    assert links or page.endswith("notation.md")
    for link in links:
        path, _, heading = link.partition("#")
        target = folder / path if path else ROOT / page
        assert target.exists(), link
        if heading:
            titles = re.findall(r"^#+ (.*)$", target.read_text(), re.MULTILINE)
            assert heading in {re.sub(r"[^\w\- ]", "", title).strip().lower().replace(" ", "-") for title in titles}, (
                link
            )


def test_install_commands_are_those_of_ci():
    lines = [line for language, text in BLOCKS if language == "bash" for line in text.splitlines()]
    assert sum("nsdyn run stack" in line for line in lines) == 1
    assert sum("python -m pytest" in line for line in lines) == 1


def test_the_citation_is_of_this_version():
    lines = (ROOT / "CITATION.cff").read_text().splitlines()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert f"version: {nd.__version__}" in lines and f"license: {project['license']}" in lines
    assert [f"  - name: {author['name']}" for author in project["authors"]] == [
        line for line in lines if line.startswith("  - name:")
    ]
    assert [f"  - {keyword}" for keyword in project["keywords"]] == lines[lines.index("keywords:") + 1 :]


def test_every_dependency_has_its_reason():
    text = (ROOT / "README.md").read_text()
    for requirement in tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]:
        assert f"`{re.split('[<>=]', requirement)[0]}`" in text, requirement
