"""Keys of contacts: each names one contact, for as long as it lasts."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

import nsdyn as nd

ANYTHING = Path(__file__).resolve().parents[2] / "demos" / "bench" / "anything.py"


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("seed", [pytest.param(550081, marks=pytest.mark.slow), 580025])
def test_no_key_names_two_contacts(seed, tmp_path, monkeypatch):
    """In violent collisions: islands are made again, and moves meet what their ends have shown."""
    monkeypatch.syspath_prepend(ANYTHING.parent)
    spec = importlib.util.spec_from_file_location("anything", ANYTHING)
    anything = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(anything)
    scene, options, _ = anything.random_scene(seed, tmp_path)
    stepper, most = nd.Stepper(scene, **{k: options[k] for k in ("dt", "impact", "theta")}), 0
    for _ in range(20):
        step, pairs = stepper.step(), {}
        end = stepper.get_state().instant.contacts
        assert np.unique(end.key).size == end.key.size
        for contacts in (step.contacts, end):
            for key, *pair in zip(contacts.key, contacts.geom1, contacts.geom2, strict=True):
                assert pairs.setdefault(key, pair) == pair
        most = max(most, len(pairs))
    assert most > 20
