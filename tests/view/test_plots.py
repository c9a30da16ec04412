"""Plots: the numbers of the recording, labels that do not collide, legends off the data, no round-off at full scale."""

import re
from itertools import combinations
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from matplotlib import style
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

import nsdyn as nd
from nsdyn.cli import figures, main
from nsdyn.recording import file
from nsdyn.study.drawings import draw_refinement, draw_sweep, varied
from nsdyn.study.sweep import Member
from nsdyn.tools.units import with_unit
from nsdyn.view import panels, plots
from nsdyn.view.curves import ledger

PAGE = Path(plots.__file__).parent / "page" / "ledger.js"


@pytest.fixture(scope="module")
def arm():
    """An arm that strikes a box, which then slides."""
    setup = nd.scenes.setup("arm_pushes_box")
    return nd.simulate(setup.scene, 0.6, **setup.options(dt=5e-3))


@pytest.fixture(scope="module")
def resting():
    return nd.simulate(nd.scenes.load("stack")(height=14), 0.1, dt=0.01)


@pytest.fixture(scope="module")
def slide():
    return nd.simulate(nd.scenes.load("slide")(), 0.5, dt=0.01)


def drawn(draw, size=(140, 90), points=10):
    """A figure that has been laid out."""
    figure = Figure(figsize=(size[0] / 25.4, size[1] / 25.4), layout="constrained")
    with matplotlib.rc_context({"font.size": points}):
        draw(figure)
        figure.draw_without_rendering()
    return figure


def texts(figure):
    """Boxes of all texts that are seen, by what they say."""
    out = []
    for ax in figure.axes:
        out += [ax.xaxis.label, ax.yaxis.label, ax.title, ax._left_title, ax._right_title, *ax.texts]
        for axis, (low, high) in ((ax.xaxis, ax.get_xlim()), (ax.yaxis, ax.get_ylim())):
            ticks = [*axis.get_major_ticks(), *axis.get_minor_ticks()]
            out += [tick.label1 for tick in ticks if low <= tick.get_loc() <= high and tick.label1.get_visible()]
            out.append(axis.get_offset_text())
    for legend in legends(figure):
        out += legend.get_texts()
    return [(text.get_text(), text.get_window_extent()) for text in out if text.get_visible() and text.get_text()]


def legends(figure):
    return [*figure.legends, *(legend for part in figure.subfigs for legend in legends(part))]


def check(figure):
    """What a bad picture would fail."""
    found = texts(figure)
    for (one, a), (other, b) in combinations(found, 2):
        across = min(a.x1, b.x1) - max(a.x0, b.x0), min(a.y1, b.y1) - max(a.y0, b.y0)
        assert min(across) <= 1.0, f"{one!r} collides with {other!r}"  # of a pixel
    for text, box in found:
        inside = figure.bbox.padded(1.0)
        assert inside.x0 <= box.x0 and box.x1 <= inside.x1 and inside.y0 <= box.y0 and box.y1 <= inside.y1, text
    for legend in legends(figure):
        for ax in figure.axes:
            assert not legend.get_window_extent().padded(-1.0).overlaps(ax.get_window_extent())
    for ax in figure.axes:
        assert ax.lines or ax.collections, "an empty panel"
        assert ax.get_window_extent().width > 0.4 * figure.bbox.width


FEW = "energy", "force", "joint", "friction"
LATER = "certificate", "position", "force"


@pytest.mark.parametrize("size", [pytest.param((140, 90), marks=pytest.mark.slow), (85, 65)])
@pytest.mark.parametrize("kind", [pytest.param(k, marks=[] if k in FEW else pytest.mark.slow) for k in plots.KINDS])
def test_labels_do_not_collide(arm, kind, size):
    check(drawn(lambda figure: plots.draw(arm, kind, figure=figure), size, 10 if size[0] > 100 else 8))


@pytest.mark.parametrize(
    "kind",
    [pytest.param(k, marks=pytest.mark.slow if k in LATER else []) for k in plots.KINDS if k not in ("joint", "phase")],
)
def test_round_off_is_not_drawn_at_full_scale(resting, kind):
    """A stack at rest: what is shown spans at least a millionth of what is at play, or a decade of round-off."""
    figure = drawn(lambda figure: plots.draw(resting, kind, figure=figure))
    check(figure)
    (ax,) = figure.axes  # one panel: friction and what moves sideways are noise
    low, high = ax.get_ylim()
    if kind not in ("position", "force", "friction", "certificate"):
        assert [tick.get_text() for tick in ax.get_yticklabels()] == ["0"]
        assert not ax.yaxis.get_offset_text().get_text() and not ax.get_title(loc="right")
    scale = {
        "position": 2.6,
        "speed": 9.81 * 0.1,
        "force": 14 * 9.81,
        "slip": 9.81 * 0.1,
        "gap": 2.6,
        "energy": resting.largest_energy,
        "power": resting.largest_energy,
        "friction": 9.81,
    }
    if kind in scale:
        assert high - low > 0.9e-6 * scale[kind]
    elif kind == "certificate":
        assert low >= 1e-12 and high >= 10.0 * low
    if kind == "speed":
        most = with_unit(resting.table("bodies")["speed"].max(), "m/s")
        assert [text.get_text() for text in ax.texts] == [f"nothing but round-off,\nat most {most}"]
    if kind == "energy":
        assert [text.get_text() for text in ax.texts] == ["at rest: nothing of 192.3 J moves"]


def test_what_rests_where_it_is_has_no_axis_of_noise():
    """A ball at rest in the middle of the world: its place is that to some digits, and 1e-17 is none of them."""
    scene = nd.Scene()
    scene.add_halfspace("ground", offset=-0.1)
    scene.add_sphere("ball", 0.1, 1.0)
    run = nd.simulate(scene, 0.1, dt=0.01)
    run.columns["q"][1:, :3] += 1e-17 * np.arange(1, 11)[:, None]
    (ax,) = drawn(lambda figure: plots.draw(run, "position", figure=figure)).axes
    low, high = ax.get_ylim()
    assert low < -1e-4 and high > 1e-4 and "round-off" in ax.texts[0].get_text()


@pytest.mark.slow
def test_errors_of_steps_are_dots(arm):
    """A step may have none where the next has one: lines would be a comb."""
    for kind in ("certificate", "penetration"):
        figure = drawn(lambda figure, kind=kind: plots.draw(arm, kind, figure=figure))
        assert {(line.get_linestyle(), line.get_marker()) for line in figure.axes[0].lines} == {("None", ".")}


def test_an_axis_of_errors_begins_where_they_do(arm):
    """Steps of free motion have bounds of 1e-16 √J and less, which are not drawn: no empty decades for them."""
    (ax,) = drawn(lambda figure: plots.draw(arm, "certificate", figure=figure)).axes
    shown = np.concatenate([line.get_ydata() for line in ax.lines])
    low, _ = ax.get_ylim()
    assert (arm.gauss.bound < 1e-12).any() and 0.1 * np.nanmin(shown) <= low <= np.nanmin(shown)


def test_what_lasts_one_step_is_seen():
    run = nd.simulate(nd.scenes.load("bounce")(), 0.6, dt=1e-3)
    (line,) = drawn(lambda figure: plots.draw(run, "gap", figure=figure)).axes[0].lines
    (touched,) = np.flatnonzero(np.isfinite(line.get_ydata()))
    assert line.get_marker() == "." and line.get_markevery().tolist() == [touched]


def curves(run, kind, name="*"):
    """Curves of the panels of a kind by their names."""
    return [
        {line.get_label(): line.get_ydata() for line in ax.lines}
        for ax in drawn(lambda figure: plots.draw(run, kind, name, figure)).axes
    ]


def test_plots_draw_what_is_recorded(slide, arm):
    t = slide.t_steps
    (x,) = curves(slide, "position")  # nothing moves along y and z
    np.testing.assert_array_equal(x["box"], slide.body("box").position[:, 0])
    (speed,) = curves(slide, "speed")
    np.testing.assert_allclose(speed["box"], np.maximum(2.0 - 0.5 * 9.81 * slide.t, 0.0), rtol=0, atol=1e-6)
    normal, friction = curves(slide, "force")
    np.testing.assert_allclose(normal["ground | box"], 9.81, rtol=0, atol=1e-5)
    np.testing.assert_allclose(friction["ground | box"][t < 0.4], 0.5 * 9.81, rtol=0, atol=1e-5)
    (slip,) = curves(slide, "slip", "box")
    np.testing.assert_allclose(slip["ground | box"][t < 0.4], 2.0 - 0.5 * 9.81 * t[t < 0.4], rtol=0, atol=1e-6)
    angle, rate = curves(arm, "joint", "arm/elbow")
    np.testing.assert_array_equal(angle["arm/elbow"], arm.joint("arm/elbow").position)
    np.testing.assert_array_equal(rate["arm/elbow"], arm.joint("arm/elbow").velocity)
    (phase,) = curves(arm, "phase", "arm/elbow")
    np.testing.assert_array_equal(phase["arm/elbow"], arm.joint("arm/elbow").velocity)
    (stack,) = curves(slide, "energy")
    np.testing.assert_allclose(stack["sum"], 2.0, rtol=0, atol=1e-9)  # the page's flat line
    (certificate,) = curves(slide, "certificate")
    bound = slide.gauss.bound
    drawn = np.where(bound > panels.FLOOR, bound, 0.0)  # what is below the axis is not
    np.testing.assert_array_equal(np.nan_to_num(certificate["bound [√J]"]), drawn)
    (depth,) = curves(arm, "penetration")
    deepest = [max(0.0, -arm.contacts(k).gap.min(initial=0.0)) for k in range(1, arm.steps + 1)]
    assert "deepest contact" in depth or max(deepest) < 1e-11
    (cones,) = curves(slide, "friction")
    assert (
        sum(len(cones[name]) for name in cones if name.startswith(("stick", "slip")))
        == slide.columns["contacts/offset"][-1]
    )
    with pytest.raises(ValueError, match=r"did you mean 'speed'\? kind must be one of position, .*; got 'sped'"):
        plots.draw(slide, "sped")
    with pytest.raises(ValueError, match=r"no joints to draw phase of; what can be drawn: position, .*, penetration$"):
        plots.draw(slide, "phase")
    with pytest.raises(ValueError, match=r"trajectory must be a Trajectory, .*, got 5"):
        plots.usual(5)
    with pytest.raises(ValueError, match=r"trajectory must be a Trajectory, .*, got 5"):
        plots.draw(5, "speed")
    with pytest.raises(ValueError, match="name must be a text of Unicode without NUL, got 5"):
        plots.draw(slide, "energy", 5)
    with pytest.raises(ValueError, match="figure must be a Figure or SubFigure of matplotlib, got 5"):
        plots.draw(slide, "speed", figure=5)


@pytest.mark.parametrize(
    "kind", ["position", *(pytest.param(k, marks=pytest.mark.slow) for k in ("speed", "force", "joint"))]
)
def test_curves_can_be_told_apart(arm, kind):
    """Links that move as one, which have one colour on the page, too."""
    figure = drawn(lambda figure: plots.draw(arm, kind, figure=figure))
    for ax in figure.axes:
        looks = {(line.get_color(), line.get_linestyle()) for line in ax.lines}
        assert len(looks) == len(ax.lines) > 1


def test_curves_on_each_other_are_all_seen():
    """Fingers that move as one: of each colour a good part of the pixels, in the order of the curves."""
    t = np.linspace(0.0, 1.0, 200)
    curves = [panels.Curve(name, t, 1.0 + t, {"lw": 1.2, **panels.look(k)}) for k, name in enumerate("abc")]
    apart = panels.Curve("d", t, 3.0 - t, {"lw": 1.2, **panels.look(3)})
    figure = drawn(lambda figure: panels.draw(figure, [panels.Panel("speed [m/s]", [*curves, apart])]))
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())[..., :3].astype(int)
    box = figure.axes[0].bbox
    pixels = pixels[pixels.shape[0] - int(box.y1) : pixels.shape[0] - int(box.y0), int(box.x0) : int(box.x1)]
    seen = [(np.abs(pixels - 255 * np.array(c.look["color"])).max(axis=2) < 40).sum() for c in (*curves, apart)]
    assert all(0.2 < count / sum(seen[:3]) < 0.5 for count in seen[:3])
    assert figure.axes[0].lines[3].get_linestyle() == "-"
    assert {line.get_linestyle() for line in legends(figure)[0].get_lines()} == {"-"}


def test_works_of_pairs_are_their_power(slide):
    figure = drawn(lambda figure: plots.draw(slide, "power", figure=figure))
    heights = figure.axes[0].collections[0].get_paths()[0].vertices[:, 1]
    assert heights.max() == pytest.approx(-slide.energy.friction.min() / slide.dt, rel=1e-12)


def test_peaks_of_impacts_do_not_hide_the_rest(arm):
    """A ball that bounces once: its weight is seen beside the impact, which is said."""
    scene = nd.Scene()
    scene.add_halfspace("ground")
    scene.add_sphere("ball", 0.1, 1.0, position=(0, 0, 0.3))
    run = nd.simulate(scene, 0.6, dt=1e-3)
    figure = drawn(lambda figure: plots.draw(run, "force", figure=figure))
    check(figure)
    ax = figure.axes[0]
    peak = run.table("pairs")["normal_force"].max()
    assert peak > 1000.0 and 9.81 < ax.get_ylim()[1] < 100.0
    assert ax.get_title(loc="right") == f"peaks reach {peak / 1000:.4g} kN"


def test_friction_of_impacts_is_marked_at_the_edge(arm):
    """The arm strikes with a hundred times the weight of the box, whose friction fills the picture."""
    figure = drawn(lambda figure: plots.draw(arm, "friction", figure=figure))
    check(figure)
    table, ax = arm.table("contacts"), figure.axes[0]
    most = table["mu"] * table["impulse_N"] / arm.dt
    (marked,) = [line for line in ax.lines if line.get_label().startswith("stronger")]
    high = ax.get_xlim()[1]
    assert np.quantile(most[most > 0.0], 0.9) > 0.4 * high and most.max() > 10.0 * high
    assert marked.get_label() == f"stronger ({(most > high).sum()}), up to {most.max():.4g} N"
    assert marked.get_marker() == ">" and np.ptp(marked.get_xdata()) < 1e-12 * high
    strongest = np.argsort(most[most > high])[-1]
    part = marked.get_ydata()[strongest] / marked.get_xdata()[strongest]
    row = int(np.argmax(most))
    assert part == pytest.approx(table["impulse_T"][row] / (table["mu"][row] * table["impulse_N"][row]), rel=1e-12)


@pytest.mark.slow
def test_what_is_alone_and_what_has_not_begun():
    """A free body, which nothing touches, and a recording that a kill left before its first step."""
    scene = nd.Scene()
    scene.add_sphere("ball", 0.1, 1.0)
    run = nd.simulate(scene, 0.05, dt=0.01)
    begun = nd.Trajectory(run.meta, run.scene, file.until(run.columns, 0))
    assert plots.usual(run) == ["energy", "speed"]
    for recording in (run, begun):
        for kind in plots.KINDS.keys() - {"joint", "phase"}:
            figure = drawn(lambda figure, kind=kind, recording=recording: plots.draw(recording, kind, figure=figure))
            (text,) = [text.get_text() for text in figure.axes[0].texts] or [""]
            assert (text == "nothing touches") == (kind in ("force", "slip", "gap", "power")), kind


@pytest.mark.slow
def test_many_bodies_have_few_names():
    """Those that move most stand out, each in a colour of its own, though three of them have one on the page."""
    scene, fast = nd.Scene(gravity=(0, 0, 0)), {0: 9, 6: 8, 24: 7, 27: 6, 28: 5, 29: 4}
    for k in range(30):
        v = (fast.get(k, 0.1), 1e-12 * (k == 13), 0)  # beside which what is round-off in another direction is nothing
        scene.add_sphere(f"ball{k}", 0.1, 1.0, position=(0, k, 0), linear_velocity=v)
    run = nd.simulate(scene, 0.1, dt=0.01)
    for kind in ("position", "speed"):
        figure = drawn(lambda figure, kind=kind: plots.draw(run, kind, figure=figure))
        check(figure)
        names = [text.get_text() for text in legends(figure)[0].get_texts()]
        assert names == [*(f"ball{k}" for k in fast), "and 24 others"]
        looks = {line.get_label(): (line.get_color(), line.get_linestyle()) for line in figure.axes[0].lines}
        assert len(set(looks.values())) == len(names) and {dash for _, dash in looks.values()} == {"-"}
        below = {line.get_label(): line.get_zorder() for line in figure.axes[0].lines}
        assert below["and 24 others"] < below["ball0"] and looks["and 24 others"][0] == panels.OTHERS


def test_no_two_curves_look_the_same():
    assert panels.looks({str(k): k for k in range(24)}) == {str(k): panels.look(k) for k in range(24)}
    assert panels.looks({"a": 3, "b": 27, "c": 4}) == {"a": panels.look(3), "b": panels.look(0), "c": panels.look(4)}


@pytest.mark.slow
def test_coordinates_in_two_units_can_be_told_apart():
    """Twelve angles of a quadruped, and the place of its trunk."""
    setup = nd.scenes.setup("quadruped")
    run = nd.simulate(setup.scene, 0.02, **setup.options(dt=5e-3))
    figure = drawn(lambda figure: plots.draw(run, "joint", figure=figure))
    looks = {line.get_label(): (line.get_color(), line.get_linestyle()) for ax in figure.axes for line in ax.lines}
    assert len(set(looks.values())) == len(looks) == 15
    # The page has the colours of frames, of which there are six: of the trunk, and of what the first joints carry.
    for name in ("root_joint x", "FL_abduction", "FL_hip", "FL_knee", "FR_abduction", "FR_hip"):
        frame = list(run.scene["frames"]).index("quadruped/" + name.partition(" ")[0])
        assert looks[name] == (*panels.look(frame).values(),)
    free = run.table("joints", "*root_joint")
    assert free["coordinate"][:7].tolist() == ["x", "y", "z", "rx", "ry", "rz", "rw"]
    assert free["unit"][:7].tolist() == ["m"] * 3 + [""] * 4
    assert {f"root_joint {axis}" for axis in "xyz"} < looks.keys()
    assert set(run.table("joints", "*knee")["coordinate"]) == {""}


def test_a_line_behind_another_has_no_name(slide):
    """The sum is what it ought to be where nothing is put in, and where fingers close."""
    setup = nd.scenes.setup("gripper")
    closing = nd.simulate(setup.scene, 0.1, **setup.options(dt=5e-3))
    assert closing.energy.external.sum() > 0.5 * closing.largest_energy
    for run in (slide, closing):
        (panel,) = plots.KINDS["energy"](run, "*")
        assert [c.label for c in panel.curves] == ["sum"]


def test_what_a_servo_takes_has_an_area():
    """It lifts a pendulum and lets it down: the stack is what there was and what was put in, on the page too."""
    scene = nd.scenes.load("double_pendulum")()
    (name,) = scene.articulations

    def servo(t, q, v):
        return {name: nd.PD(kp=0.0, kd=8.0, target=0.0, target_velocity=4.0 * (t < 0.3))}

    run = nd.simulate(scene, 3.0, 1e-2, controller=servo)
    given = np.concatenate([[0.0], np.cumsum(run.energy.external)])
    assert given.min() < -0.1 * run.largest_energy < 0.01 * run.largest_energy < given.max()
    (panel,) = plots.KINDS["energy"](run, "*")
    areas, (total, *_) = {c.label: c.y for c in panel.areas}, panel.curves
    np.testing.assert_allclose(areas["drives and loads took"], np.maximum(-given, 0.0), atol=1e-14)
    numerics = np.concatenate([[0.0], np.cumsum(run.energy.integration + run.energy.projection + run.energy.defect)])
    ought = total.y[0] + np.maximum(given, 0.0) + numerics
    np.testing.assert_allclose(total.y, ought, atol=1e-12 * run.largest_energy)
    page = ledger(run)
    stack = page["kinetic"] + page["potential"]
    stack = stack - sum(page[name] for name in ("friction", "normal", "damping", "drives"))
    np.testing.assert_allclose(stack, total.y, rtol=1e-12)
    np.testing.assert_allclose(page["put_in"], np.maximum(given, 0.0), atol=1e-14)


def test_colours_are_those_of_the_page():
    """One palette: bodies by `nsdyn.view.solids`, what vouches for the steps as `ledger.js` has it."""
    told = dict(re.findall(r'name: "(\w+)", .*colour: "(#\w+)"', PAGE.read_text()))
    of = {"residual": "kinetic", "bound": "normal", "penetration": "damping"}
    assert told == {name: panels.LEDGER[other] for name, other in of.items()}
    assert panels.look(1)["color"] == tuple(part / 255 for part in panels.PALETTE[1])


@pytest.mark.slow
def test_refinement_is_drawn_with_its_orders():
    found = nd.refine("double_pendulum", [1e-2, 5e-3, 2.5e-3], 0.05)
    figure = drawn(lambda figure: draw_refinement(found, figure))
    check(figure)
    line = figure.axes[0].lines[0]
    assert line.get_xdata().tolist() == [1e-2, 5e-3] and line.get_ydata()[0] == found.rows[0].position
    assert "order" in line.get_label() and figure.axes[0].get_xscale() == "log"
    nothing = nd.refine("slide", [1e-2, 5e-3, 2.5e-3], 0.05)
    figure = drawn(lambda figure: draw_refinement(nothing, figure))
    check(figure)
    assert [text.get_text() for text in figure.axes[0].texts] == ["nothing but round-off,\nless than 1e-11"]


def test_sweep_is_drawn_over_its_numbers():
    parameters = {"mu": [0.1, 0.2, 0.3], "shape": ["a", "b"]}
    members = [
        Member({"mu": mu, "shape": shape}, {"displacement": mu, "kinetic": 1.0, "friction": -mu, "normal": 1e-15}, "")
        for mu in parameters["mu"]
        for shape in parameters["shape"]
    ]
    members[0] = Member(members[0].parameters, None, "failed")
    figure = drawn(lambda figure: draw_sweep(parameters, members, figure), (140, 178))
    check(figure)
    assert [ax.get_ylabel() for ax in figure.axes] == [
        "displacement\n[m]",
        "kinetic at the end\n[J]",
        "work of friction\n[J]",
    ]
    assert {line.get_label() for line in figure.axes[0].lines} == {"shape=a", "shape=b"}
    np.testing.assert_array_equal(figure.axes[0].lines[1].get_ydata(), parameters["mu"])
    with pytest.raises(ValueError, match="a plot of a sweep needs a parameter with two numbers or more"):
        varied({"mu": [0.1], "shape": ["a", "b"]})


@pytest.mark.slow
def test_plot_on_the_command_line(slide, tmp_path, monkeypatch, capsys):
    from PIL import Image

    monkeypatch.chdir(tmp_path)
    slide.save("run.h5")
    assert main(["plot", "run.h5"]) == 0 and capsys.readouterr().out == "run.png\n"
    assert main(["plot", "run.h5", "--kind", "force", "--name", "box", "--size", "85x60", "-o", "p.png"]) == 0
    with Image.open("p.png") as image:
        assert image.size == (669, 472)  # 200 points an inch
    written = []
    with monkeypatch.context() as patched:
        patched.setattr(figures, "picture", lambda path, fill, size: written.append(matplotlib.rcParams["font.size"]))
        for size in ("140x90", "180x120"):  # the latter for three kinds, none of which has more than 90 by 60
            main(["plot", "run.h5", *(["--kind", "energy"] if size == "140x90" else []), "--size", size])
    assert written == [10.0, 8.0]
    capsys.readouterr()
    assert main(["plot", "run.h5", "--kind", "energy", "--kind", "slip", "--style", "grayscale", "-o", "p.svg"]) == 0
    assert main(["plot", "run.h5", "--kind", "speed", "-o", "p.pdf"]) == 0
    assert Path("p.svg").read_bytes().startswith(b"<?xml") and Path("p.pdf").read_bytes().startswith(b"%PDF")
    capsys.readouterr()
    for given, words in (
        (["--name", "bo"], "did you mean 'box'"),
        (
            ["--kind", "joint"],
            "no joints to draw joint of; what can be drawn: position, speed, force, slip",
        ),
        (["--style", "nope"], "--style must be a style of matplotlib or a file of one, got nope"),
        (["--size", "39x60"], "--size must be two lengths of 40 to 2000 mm, got 39x60"),
        (["--size", "nanx60"], "--size must be two lengths of 40 to 2000 mm, got nanx60"),
        (["--size", "85"], "--size must be WIDTHxHEIGHT in mm, such as 85x60, got 85"),
        (["--size", "85x60"], "labels leave no room for curves in 85 by 60 mm: a larger picture, or fewer kinds"),
        (["--size", "40x40"], "names leave no room for curves in 40 by 40 mm: a larger picture, or fewer of them"),
    ):
        assert main(["plot", "run.h5", "-o", "no.png", *given]) == 2
        assert words in capsys.readouterr().err and not Path("no.png").exists()
    bare = nd.simulate(nd.scenes.load("slide")(), 0.02, dt=0.01, contacts=False)
    bare.save("bare.h5")
    assert main(["plot", "bare.h5", "-o", "bare.png"]) == 0
    assert main(["plot", "bare.h5", "--kind", "friction", "-o", "no.png"]) == 2
    told = "no contacts to draw friction of; what can be drawn: position, speed, energy, certificate\n"
    assert capsys.readouterr().err.endswith(told)
    assert set(figures.KINDS) == set(plots.KINDS)


@pytest.mark.slow
def test_a_style_has_its_own_colours(arm, slide):
    """One of greys has no others, of curves, areas and points; two curves never look the same."""
    for run, kind in ((arm, "joint"), (arm, "energy"), (arm, "certificate"), (slide, "friction"), (slide, "speed")):
        with style.context(["default", "grayscale"]):
            figure = drawn(lambda figure, run=run, kind=kind: plots.draw(run, kind, figure=figure))
        lines = [line for ax in figure.axes for line in ax.lines]
        areas = [tuple(c) for ax in figure.axes for area in ax.collections for c in area.get_facecolor()]
        for colour in (*(line.get_color() for line in lines), *areas):
            assert len(set(to_rgb(colour[:3] if isinstance(colour, tuple) else colour))) == 1, (kind, colour)
        assert len(set(areas)) == len(areas)
        looks = {(line.get_label(), to_rgb(line.get_color()), line.get_linestyle()) for line in lines}
        assert len({look[1:] for look in looks}) == len(looks)
    with matplotlib.rc_context({"axes.prop_cycle": matplotlib.cycler(color=["#123456"])}):
        assert panels.look(0)["color"] == panels.look(1)["color"] == "#123456"
        figure = drawn(lambda figure: plots.draw(slide, "energy", figure=figure))
    assert to_rgb(panels.LEDGER["kinetic"]) == tuple(figure.axes[0].collections[0].get_facecolor()[0][:3])


@pytest.mark.parametrize(("kind", "label"), [("energy", "sum"), ("friction", "Coulomb's limit")])
def test_no_line_is_black_on_black(slide, kind, label):
    with style.context(["default", "dark_background"]):
        (ax,) = drawn(lambda figure: plots.draw(slide, kind, figure=figure)).axes
    (line,) = [line for line in ax.lines if line.get_label() == label]
    assert to_rgb(line.get_color()) == (1.0, 1.0, 1.0) and to_rgb(ax.get_facecolor()) == (0.0, 0.0, 0.0)


@pytest.mark.slow
def test_a_robot_that_all_names_begin_with_is_left_out(arm):
    for kind, name, labels in (
        ("joint", "*", ["shoulder", "elbow"]),
        ("joint", "*elbow", ["arm/elbow"]),  # the title of its panel
        ("speed", "arm/*", ["upper", "fore", "hand"]),
        ("speed", "*", ["box", "arm/upper", "arm/fore", "arm/hand"]),
    ):
        assert {c.label for panel in plots.KINDS[kind](arm, name) for c in panel.curves} == set(labels)
    robot = nd.scenes.setup("quadruped")
    run = nd.simulate(robot.scene, 0.02, **robot.options(dt=5e-3))
    check(drawn(lambda figure: plots.draw(run, "joint", figure=figure), (85, 120), 8))


@pytest.mark.slow
def test_studies_on_the_command_line(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    given = "--time", "0.05"
    assert main(["study", "slide", "--dt", "1e-2,5e-3", *given, "--plot", "study.png"]) == 0
    swept = "sweep", "slide", "--dt", "1e-2", *given, "--workers", "1"
    assert main([*swept, "--set", "mu=0.1,0.2", "--plot", "sweep.pdf"]) == 0
    assert Path("study.png").read_bytes()[1:4] == b"PNG" and Path("sweep.pdf").read_bytes().startswith(b"%PDF")
    capsys.readouterr()
    assert main([*swept, "--set", "mu=0.1", "--plot", "no.png"]) == 2
    assert "two numbers or more" in capsys.readouterr().err and not Path("no.png").exists()
