"""The examples in docstrings say what happens; the reference that is made of docstrings leaves nothing out."""

import dataclasses
import doctest
import importlib
import inspect
import re
import subprocess
import sys
from functools import cached_property
from pathlib import Path
from types import ModuleType

import pytest

import nsdyn as nd

PUBLIC = [getattr(nd, name) for name in nd.__all__ if name not in nd._MODULES]
ROOT = Path(__file__).parents[2]
MODULES = sorted({value.__module__ for value in PUBLIC} | {"nsdyn.recording.fclib"})


@pytest.mark.parametrize("name", MODULES)
def test_examples(name):
    failed, _ = doctest.testmod(importlib.import_module(name))
    assert not failed


RETURNED = {
    nd.Audit,
    nd.Comparison,
    nd.Inspection,
    nd.NotConverged,
    nd.Refinement,
    nd.Solution,
    nd.State,
    nd.Status,
    nd.Step,
}
"""What only functions make, which have the example."""


@pytest.mark.parametrize("value", [value for value in PUBLIC if value not in RETURNED])
def test_public_names_have_an_example(value):
    assert ">>> " in value.__doc__


def documented():
    """(name, object) of everything public: names of nsdyn and of its modules, and the methods of classes."""
    out = []
    for name in nd.__all__:
        value = getattr(nd, name)
        members = [(f"{name}.{k}", getattr(value, k)) for k in value.__all__] if isinstance(value, ModuleType) else []
        out += [(name, value), *members]
    for owner, value in list(out):
        if inspect.isclass(value):
            ours = [vars(base) for base in reversed(value.__mro__) if base.__module__.startswith("nsdyn.")]
            methods = {k: v for members in ours for k, v in members.items() if not k.startswith("_")}
            out += [(f"{owner}.{k}", function_of(v)) for k, v in methods.items() if function_of(v)]
    return [(n, v) for n, v in out if isinstance(v, ModuleType) or inspect.isclass(v) or inspect.isfunction(v)]


def function_of(member):
    """The function behind a method or property, None for anything else."""
    if isinstance(member, property):
        return member.fget
    if isinstance(member, (classmethod, staticmethod)):
        return member.__func__
    if isinstance(member, cached_property):
        return member.func
    return member if inspect.isfunction(member) else None


def said(value):
    """The docstring, none of the signature that dataclasses make where there is none."""
    text = value.__doc__ or ""
    return "" if inspect.isclass(value) and text.startswith(f"{value.__name__}(") else text


def named(text):
    """Names that the sections of a numpydoc docstring have: what stands before a colon or alone, at their margin."""
    body = re.split(r"^(?:Parameters|Attributes)\n-+$", inspect.cleandoc(text), flags=re.MULTILINE)[1:]
    lines = [line for part in body for line in part.splitlines() if line and not line.startswith(" ")]
    return {name.strip(" *`") for line in lines for name in line.partition(":")[0].split(",")}


@pytest.mark.slow
def test_the_reference_has_every_public_name(tmp_path):
    pytest.importorskip("pdoc", reason="pdoc is not installed (extra `docs`)")
    script = Path(__file__).resolve().parent.parent.parent / "demos" / "reference.py"
    done = subprocess.run([sys.executable, script, tmp_path], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    anchors = set(re.findall(r'id="([^"]+)"', "".join(page.read_text() for page in tmp_path.rglob("*.html"))))
    for name, value in documented():
        plain = name.partition(".")[2] if name.split(".")[0] in nd._MODULES else name
        assert isinstance(value, ModuleType) or plain in anchors, name


@pytest.mark.parametrize(("name", "value"), documented(), ids=lambda v: v if isinstance(v, str) else "")
def test_nothing_public_is_missing_from_the_reference(name, value):
    """Every name has a docstring; its sections have every field and parameter, where there are sections."""
    text = said(value)
    assert text, name
    if inspect.isfunction(value) and "Parameters\n" in text:
        parameters = inspect.signature(value).parameters.values()
        # Keywords handed on are in the docstring of the function that takes them.
        missing = {p.name for p in parameters if p.kind is not p.VAR_KEYWORD} - {"self", "cls"} - named(text)
        assert not missing, f"{name}: {sorted(missing)}"
    if inspect.isclass(value) and (dataclasses.is_dataclass(value) or hasattr(value, "_fields")):
        fields = [f.name for f in dataclasses.fields(value)] if dataclasses.is_dataclass(value) else value._fields
        # Fields of a base class are in its docstring.
        inherited = named("".join(said(base) + "\n" for base in value.__mro__[1:-1]))
        missing = {f for f in fields if not f.startswith("_")} - named(text) - inherited
        assert not missing, f"{name}: {sorted(missing)}"


@pytest.mark.parametrize("page", sorted([ROOT / "README.md", *(ROOT / "demos").rglob("*.md")]), ids=lambda p: p.name)
def test_files_that_documents_name_exist(page):
    """From the root, a room of the package or of the tests, a folder of the demos, or by name alone."""
    files = {path for folder in ("nsdyn", "tests", "demos", "models") for path in (ROOT / folder).rglob("*.py")}
    known = {path.relative_to(ROOT).as_posix() for path in files}
    for named in re.findall(r"`([\w/]+\.py)`", page.read_text()):
        assert any(f"/{path}".endswith(f"/{named}") for path in known), f"{page.name}: {named}"
