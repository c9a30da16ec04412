"""Every demonstration runs and gives the numbers it promises."""

import importlib.util
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

DEMOS = Path(__file__).resolve().parent.parent / "demos"


def demo(name):
    spec = importlib.util.spec_from_file_location(name, DEMOS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_sliding():
    sliding = demo("sliding")
    trajectories = sliding.run()
    distances = np.array([sliding.distance(t) for t in trajectories])
    # The last step stops inside itself: mu g dt²/8 = 6e-7 m, for every heading the same to round-off.
    np.testing.assert_allclose(distances, sliding.EXPECTED["distance"], rtol=0, atol=1e-6)
    assert np.ptp(distances) <= 1e-9
    for t in trajectories:
        assert t.energy.friction.sum() == pytest.approx(sliding.EXPECTED["friction"], abs=1e-6)


def test_stacking():
    stacking = demo("stacking")
    trajectory = stacking.run()
    np.testing.assert_allclose(stacking.loads(trajectory), stacking.EXPECTED["loads"], rtol=1e-8)
    assert stacking.drift(trajectory) <= 1e-8


@pytest.mark.slow
@pytest.mark.parametrize(("name", "product"), [("sliding", "html"), ("stacking", "html"), ("elastic_block", "png")])
def test_demo_as_a_script(name, product, tmp_path):
    if name == "elastic_block":
        pytest.importorskip("skfem", reason="scikit-fem is not installed (extra `fem`)")
    done = subprocess.run([sys.executable, DEMOS / f"{name}.py"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / f"{name}.{product}").stat().st_size > 20_000
