"""Every demonstration runs and gives the numbers it promises."""

import subprocess
import sys
from pathlib import Path

import gallery
import matplotlib.pyplot as plt
import numpy as np
import pytest
import sliding
import stacking
import tipping

from nsdyn.view import browser

DEMOS = Path(__file__).resolve().parent.parent.parent / "demos"


def test_sliding():
    trajectories = sliding.run()
    distances = np.array([sliding.distance(t) for t in trajectories])
    # The last step stops inside itself: mu g dt²/8 = 6e-7 m, for every heading the same to round-off.
    np.testing.assert_allclose(distances, sliding.EXPECTED["distance"], rtol=0, atol=1e-6)
    assert np.ptp(distances) <= 1e-9
    for t in trajectories:
        assert t.energy.friction.sum() == pytest.approx(sliding.EXPECTED["friction"], abs=1e-6)


def test_stacking():
    trajectory = stacking.run()
    np.testing.assert_allclose(stacking.loads(trajectory), stacking.EXPECTED["loads"], rtol=1e-8)
    assert stacking.drift(trajectory) <= 1e-8


def test_tipping():
    """A quarter of the diagram each way: every block does what mechanics has."""
    mu, slenderness = tipping.MU[1::4], tipping.SLENDERNESS[::4]
    exact = [[tipping.expected(m, s) for m in mu] for s in slenderness]
    assert {fate for row in exact for fate in row} == {0, 1, 2, 3}
    np.testing.assert_array_equal(tipping.run(mu, slenderness), exact)


@pytest.mark.slow
def test_the_gallery_is_what_its_script_writes(tmp_path, monkeypatch, capsys):
    """One section anew, but for times; of the others title, law and command."""
    page = (DEMOS / "README.md").read_text()
    assert page.startswith(gallery.HEAD) and "FAILED" not in page
    for exhibit in gallery.EXHIBITS:
        assert f"## {exhibit.title}\n" in page and exhibit.law in page and gallery.command(exhibit) in page
    if browser.chromium() is None:
        pytest.skip("no Chromium to take pictures with")
    (tmp_path / "gallery").mkdir()
    monkeypatch.setattr(gallery, "HERE", tmp_path)
    monkeypatch.setattr(sys, "argv", ["gallery.py", "bounce"])
    gallery.main()
    section = capsys.readouterr().out.partition("\n")[2]
    assert (tmp_path / "gallery" / "bounce.png").stat().st_size > 10_000
    before_table = section.partition("| solver")[0]
    assert "## Ball dropped" in before_table and before_table in page


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "product"), [("sliding", "html"), ("stacking", "html"), ("elastic_block", "png"), ("tipping", "png")]
)
def test_demo_as_a_script(name, product, tmp_path):
    if name == "elastic_block":
        pytest.importorskip("skfem", reason="scikit-fem is not installed (extra `fem`)")
    done = subprocess.run([sys.executable, DEMOS / f"{name}.py"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / f"{name}.{product}").stat().st_size > 20_000
    if product == "png":  # something is drawn, and it does not fill the picture
        picture = plt.imread(tmp_path / f"{name}.png")[:, :, :3]
        drawn = (np.abs(picture - picture[0, 0]).max(axis=2) > 0.1).mean()
        assert 0.01 < drawn < 0.9
