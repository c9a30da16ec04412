"""What a notebook shows: the tutorial runs from top to bottom, and objects show themselves in a few words."""

import ast
import json
import os
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import nsdyn as nd
from nsdyn.view import browser, embedding

TUTORIAL = Path(__file__).resolve().parent.parent.parent / "demos" / "tutorial.ipynb"


class Cells(HTMLParser):
    """Texts of the cells of tables, and whether every element that is opened is closed."""

    def __init__(self, html):
        super().__init__()
        self.open, self.cells = [], []
        self.feed(html)
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.open.append(tag)
        if tag in ("td", "th"):
            self.cells.append("")

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] in ("td", "th"):
            self.cells[-1] += data


def shown(value):
    return Cells(value._repr_html_()).cells


def ran(source, names):
    """Run a cell as a notebook does; the value of its last line, if that is an expression."""
    body = ast.parse(source).body
    last = ast.Expression(body.pop().value) if isinstance(body[-1], ast.Expr) else None
    exec(compile(ast.Module(body, []), "cell", "exec"), names)
    return eval(compile(last, "cell", "eval"), names) if last else None


def first_words(text):
    return text.strip().partition("\n")[0].split()


@pytest.mark.slow
def test_tutorial(tmp_path, monkeypatch):
    """Cell after cell in one set of names, as Jupyter runs it. What it claims it asserts."""
    monkeypatch.chdir(tmp_path)
    plt = pytest.importorskip("matplotlib.pyplot")
    plt.switch_backend("agg")
    notebook = json.loads(TUTORIAL.read_text())
    names: dict = {"__name__": "tutorial"}
    cells = ["".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "code"]
    values = [ran(source, names) for source in cells]
    assert sum("assert " in source for source in cells) >= 5
    stored = [cell["outputs"] for cell in notebook["cells"] if cell["cell_type"] == "code"]
    for value, outputs in zip(values, stored, strict=True):
        if type(value).__module__.startswith("nsdyn"):  # first lines, which have no figures of a machine
            assert first_words("".join(outputs[0]["data"]["text/plain"])) == first_words(repr(value))
    assert sum(hasattr(value, "_repr_html_") for value in values) >= 7
    for value in values:
        if hasattr(value, "_repr_html_") and type(value).__module__.startswith("nsdyn"):
            assert shown(value)
    assert os.listdir(tmp_path)  # it saves a recording
    plt.close("all")


def test_a_study_is_a_table():
    found = nd.refine("four_bar", [2e-2, 1e-2], 0.04)
    heads = ["dt [s]", "steps", "position [m]", "order"]
    assert shown(found)[:4] == heads and shown(found)[11:13] == ["0.02", "2"] and shown(found)[22:24] == ["0.01", "4"]
    lines = repr(found).split("\n")
    assert len({len(line) for line in lines[:-1]}) == 1 and lines[-1].startswith("four_bar: largest differences")


def test_outputs_of_the_tutorial_are_those_of_its_cells():
    """Run in order, each once, and nothing failed."""
    cells = [cell for cell in json.loads(TUTORIAL.read_text())["cells"] if cell["cell_type"] == "code"]
    assert [cell["execution_count"] for cell in cells] == list(range(1, len(cells) + 1))
    kinds = {output["output_type"] for cell in cells for output in cell["outputs"]}
    assert kinds == {"execute_result", "display_data"}
    assert TUTORIAL.stat().st_size < 1_000_000


@pytest.fixture(scope="module")
def run():
    return nd.simulate(nd.scenes.load("slide")(), 0.1, dt=1e-2)


def test_texts_are_short(run):
    """One line each; arrays and models are not printed."""
    robot = nd.scenes.load("quadruped")()
    stepper = nd.Stepper(nd.scenes.load("slide")(), dt=1e-2)
    step = stepper.step()
    objects = [
        robot,
        robot.articulations["quadruped"],
        *robot.bodies.values(),
        stepper,
        stepper.get_state(),
        step,
        step.contacts,
        step.problem,
        step.solution,
        run,
        run.body("box"),
        run.gauss,
        run.energy,
        run.solver,
    ]
    for value in objects:
        assert len(repr(value)) <= 200 and "\n" not in repr(value), repr(value)
    assert repr(robot.articulations["quadruped"]).startswith("<Articulation 'quadruped': 18 coordinates, 5 shapes")


def test_a_status_is_told_by_its_name():
    assert f"{nd.Status.LOOSE}" == str(nd.Status.LOOSE) == "LOOSE" and f"{nd.Status.OVERLAP:>8}" == " OVERLAP"
    assert nd.Status.CONVERGED == 0 and json.dumps(nd.Status.LOOSE) == "6"  # in files it is a number


def test_tables_of_objects(run):
    trajectory = shown(run)
    assert "simulated time [s]" in trajectory and "0.1" in trajectory and "10 CONVERGED" in trajectory
    assert trajectory[trajectory.index("works of physics, of numerics [J]") + 1].endswith(", 0)")  # 1e-14, recorded
    contacts = run.contacts(-1)
    cells = np.reshape(shown(contacts), (5, 9))
    assert cells[1:, 1].tolist() == ["box"] * 4 and cells[1:, 8].tolist() == ["slip"] * 4
    assert cells[0, 2:7].tolist() == ["gap [m]", "u_N [m/s]", "u_T [m/s]", "r_N [N·s]", "r_T [N·s]"]
    assert cells[1:, 2:4].tolist() == [["0", "0"]] * 4 and np.abs(contacts.u[:, 0]).max() < 1e-12  # round-off
    np.testing.assert_allclose(cells[1:, 5].astype(float), contacts.impulse[:, 0], rtol=1e-3)  # of four digits
    solution = nd.solve(nd.FC3D(np.eye(3), [-1.0, 0.2, 0.0], [0.5]))
    assert shown(solution)[6:] == ["1", "-0.2", "0", "0", "0", "0"]


def test_an_audit_is_a_table_of_all_its_findings(run):
    shown_of = {}
    for name, of in (("true", run), ("false", faster(run))):
        audit = nd.check(of)
        head, rows = shown(audit)[:8], np.reshape(shown(audit)[8:], (-1, 8))
        assert head == ["audit", "worst", "tolerance", "", "amount", "step", "bodies", "what it is"]
        assert (
            rows[:, 0].tolist() == [f.name for f in audit.findings] and f"slide: {audit.verdict}" in audit._repr_html_()
        )
        shown_of[name] = {row[0]: row[3:7].tolist() for row in rows}
    assert "FAILED" not in {verdict for verdict, *_ in shown_of["true"].values()}
    verdict, amount, step, bodies = shown_of["false"]["momentum"]
    assert verdict == "FAILED" and amount.endswith(" N·s") and step == "10" and bodies == "box"


def faster(run):
    """The recording with a velocity that nothing gives."""
    columns = dict(run.columns)
    columns["v"] = columns["v"].copy()
    columns["v"][10, 0] += 1e-3
    return nd.Trajectory(run.meta, run.scene, columns)


def test_one_is_singular():
    one = nd.simulate(nd.scenes.load("slide")(), 0.01, dt=0.01)
    texts = [repr(x) for x in (one, one.energy, one.gauss, one.solver, one.pair("box", "ground"))]
    assert all("1 step" in text and "1 steps" not in text for text in texts)
    assert ">pairs, 1 row: 4 more columns" in one.table("pairs")[:1]._repr_html_()
    told = SimpleNamespace(r=np.zeros(3), status=nd.Status.CONVERGED, error=0.0, residual=0.0, iterations=1)
    assert nd.Solution.__repr__(told).endswith(" 1 iteration>")


@pytest.mark.slow
def test_a_trajectory_plays_in_its_cell(run, tmp_path, monkeypatch, request):
    shown = run._repr_html_()
    assert len(shown) < embedding.LARGEST and Cells(shown).open == []
    if browser.chromium():
        path = tmp_path / "notebook.html"
        path.write_text(f"{shown}<script>window.ready = true</script>")
        page = request.getfixturevalue("window")
        page.open(path, (1000, 800))
        page.run(
            "new Promise((done, fail) => { const look = () => { const cell = frames[0];"
            " if (cell.failure) fail(cell.failure); else if (cell.ready) done(); else setTimeout(look, 20); };"
            " look(); })"
        )
        assert page.run("frames[0].nsdyn.clock.playing") is False
        page.run("frames[0].nsdyn.dock.step(1, false)")
        assert page.run("frames[0].nsdyn.clock.t") == run.t[1]
        assert [e for e in page.events if e.get("method") == "Runtime.exceptionThrown"] == []
        (tmp_path / "notebook.png").write_bytes(page.picture())
    monkeypatch.setattr(embedding, "LARGEST", 1000)
    assert "<iframe" not in run._repr_html_() and "write it with to_html" in run._repr_html_()


def test_a_figure_is_shown_once(run):
    """A notebook shows the value of a cell, and every figure of pyplot that is open when it ends."""
    inline = "module://" + pytest.importorskip("matplotlib_inline.backend_inline").__name__
    plt = pytest.importorskip("matplotlib.pyplot")
    for backend, left in ((inline, 0), ("agg", 1)):
        plt.switch_backend(backend)
        plt.close("all")  # of other tests
        assert len(nd.plots.draw(run, "energy").axes) == 1 and len(plt.get_fignums()) == left
    plt.close("all")


def test_a_scene_shows_its_bodies_and_nothing_of_theirs_is_markup():
    scene = nd.Scene(name="<b>")
    for k in range(30):
        scene.add_sphere(f"<i>{k}", 0.1, 1.0, position=(k, 0, 1))
    cells = shown(scene)
    assert cells[6:12] == ["<i>0", "sphere", "1", "(0, 0, 1)", "0.5", "0"] and "... 10 more" in cells
    assert "<i>" not in scene._repr_html_() and "<b>" not in scene._repr_html_()
