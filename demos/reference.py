"""The reference of the API as web pages, from the docstrings.

    python demos/reference.py [FOLDER]

writes it into FOLDER, by default `reference`; begin at its `index.html`. Needs pdoc (extra `docs`). It imports what it
documents, renders numpydoc and needs no files of its own; Sphinx would need a page of stubs for every module.
"""

import argparse
import importlib
import warnings
from pathlib import Path
from types import ModuleType

import pdoc

import nsdyn as nd

VALUES = (
    "nsdyn.recording.series",
    "nsdyn.recording.joint_tables",
    "nsdyn.recording.tables",
    "nsdyn.audit.findings",
    "nsdyn.recording.columns",
    "nsdyn.problem.gauss",
    "nsdyn.collision.contacts",
)
"""Modules of what public functions return, and the layout of a recording."""


def modules() -> list[str]:
    """The package, whose page has all public names, and the modules among these."""
    named = {value.__name__ for value in (getattr(nd, name) for name in nd.__all__) if isinstance(value, ModuleType)}
    found_with_the_package = {f"nsdyn.{name}" for name in nd.__all__}
    return ["nsdyn", *sorted((named | set(VALUES)) - found_with_the_package)]


def show_inherited(documented: list[str]) -> None:
    """Let classes show the members of bases that have no page, as their own: pdoc leaves them out."""
    own = pdoc.doc.Class.own_members.func

    def members(self: pdoc.doc.Class) -> list[pdoc.doc.Doc]:
        bases = [b for b in self.inherited_members if b[0].startswith("nsdyn.") and b[0] not in documented]
        return [*own(self), *(member for base in bases for member in self.inherited_members[base])]

    pdoc.doc.Class.own_members = property(members)


def main() -> None:
    """Write the pages; a name that does not resolve is an error."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", nargs="?", default="reference", type=Path)
    folder = parser.parse_args().folder
    names = modules()
    for module in (nd, nd.solvers):
        for name in module.__all__:
            setattr(module, name, getattr(module, name))  # these are imported at their first use; pdoc looks once
    for name in names:
        importlib.import_module(name)
    show_inherited(names)
    pdoc.render.configure(docformat="numpy", footer_text=f"nsdyn {nd.__version__}")
    with warnings.catch_warnings():
        # Annotations of named tuples are those of their modules, where pdoc does not look: it shows them as text.
        warnings.simplefilter("ignore")
        warnings.filterwarnings("error", message=".*does not resolve")
        pdoc.pdoc(*names, output_directory=folder)
    print(folder / "index.html")


if __name__ == "__main__":
    main()
