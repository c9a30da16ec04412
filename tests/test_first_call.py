"""The first use on a machine compiles, and says so."""

import subprocess
import sys

COMMAND = "import logging; logging.basicConfig(level=logging.INFO); from nsdyn._kernels import cones; " \
    "cones.project(1.0, 2.0, 3.0, 0.5)"  # fmt: skip


def test_compiling_is_announced_once(tmp_path, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))

    def heard():
        return subprocess.run([sys.executable, "-c", COMMAND], capture_output=True, text=True, check=True).stderr

    first = heard()
    assert first.count("compiling the kernels, once on this machine") == 1
    assert first.count("compiling cones") == 1
    assert heard() == ""
