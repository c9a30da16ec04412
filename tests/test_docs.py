"""The examples in docstrings say what happens."""

import doctest
import importlib

import pytest

import nsdyn as nd

PUBLIC = [getattr(nd, name) for name in nd.__all__ if name not in nd._MODULES]
MODULES = sorted({value.__module__ for value in PUBLIC} | {"nsdyn.problem.fclib"})


@pytest.mark.parametrize("name", MODULES)
def test_examples(name):
    failed, _ = doctest.testmod(importlib.import_module(name))
    assert not failed


@pytest.mark.parametrize("value", [nd.simulate, nd.Stepper, nd.solve, nd.sweep, nd.check, nd.FC3D, nd.Scene, nd.PD])
def test_public_names_have_an_example(value):
    assert ">>> " in value.__doc__
