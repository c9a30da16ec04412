"""Functions shared by the readers: XML, notes of unused contents, mesh files."""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from nsdyn.scene.checks import LARGEST
from nsdyn.tools.arrays import Array
from nsdyn.tools.files import is_file

DEEPEST = 400
"""Greatest depth of nested elements: readers recurse into each, and some thousands of levels end the process."""

UNLIMITED = 1e15
"""A limit of this size means no limit: SDF writes 1e16 or the largest float."""

XACRO = "has xacro macros: expand them first (xacro FILE.urdf.xacro > FILE.urdf)"


class Notes(list[str]):
    """Contents of a file that a reader does not use, in words."""

    @contextmanager
    def of_warnings(self, where: str) -> Iterator[None]:
        """Note warnings raised inside the context instead of showing them one by one."""
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            yield
        self += [f"{where}: {w.message}" for w in caught]


@dataclass(frozen=True)
class Report:
    """Contents of a file that a reader does not use, by their effect.

    Attributes
    ----------
    missing : Notes
        Shapes, masses and constraints, without which the mechanism is another.
    dropped : Notes
        Other contents that change the motion: forces, drives, coefficients.
    unused : Notes
        Contents that do not change the motion, for instance pictures.
    """

    missing: Notes = field(default_factory=Notes)
    dropped: Notes = field(default_factory=Notes)
    unused: Notes = field(default_factory=Notes)

    def told(self) -> dict[str, tuple[str, ...]]:
        """Return the notes as attributes of a `nsdyn.scene.articulations.Description`."""
        return {name: tuple(notes) for name, notes in vars(self).items()}


def parse(name: str, path: Path, kind: str, tag: str = "") -> Element:
    """Parse an XML file and return its root, which must have the `tag` if one is given."""
    if not is_file(path):
        raise ValueError(f"path of {name!r} must be a file in {kind}, got {str(path)!r}")
    try:
        depth, events = 0, ElementTree.iterparse(path, ("start", "end"))
        for event, _ in events:
            depth += 1 if event == "start" else -1
            if depth > DEEPEST:
                raise ValueError(f"path of {name!r}: {path} has elements more than {DEEPEST} deep in each other")
        root: Element = events.root  # type: ignore[attr-defined]  # documented, and unknown to the stubs
    except (ElementTree.ParseError, UnicodeDecodeError) as failure:
        if b"xacro:" in path.read_bytes():
            raise ValueError(f"path of {name!r}: {path} {XACRO}") from None
        raise ValueError(f"path of {name!r}: {path} could not be read: {failure}") from None
    if tag not in ("", root.tag):
        raise ValueError(f"path of {name!r}: {path} could not be read: its root is <{root.tag}>, not <{tag}>")
    return root


def numbers(text: str | None, count: int | None, default: Sequence[float] | None, what: str) -> Array:
    """Parse `count` numbers of a text, any number of them for None; without a text return `default`."""
    if text is None:
        if default is None:
            raise ValueError(f"{what} is missing")
        return np.array(default, dtype=float)
    try:
        out = np.array(text.split(), dtype=float)
    except ValueError:
        out = np.empty(0)
    if out.size != (count or max(1, out.size)) or not (np.abs(out) <= LARGEST).all():
        wanted = "a number" if count == 1 else f"{count or 'finite'} numbers"
        wanted += f" of at most {LARGEST:g} in size" if np.isfinite(out).all() and out.size else ""
        raise ValueError(f"{what} must be {wanted}, got {text!r}")
    return out


def text_of(values: Array) -> str:
    """Return numbers as the text of an attribute, with all digits."""
    return " ".join(map(repr, values.tolist()))


def scalar(text: str | None, default: float | None, what: str) -> float:
    """Parse a text as one number; without a text return `default`, or refuse it if that is None."""
    return float(numbers(text, 1, None if default is None else (default,), what)[0])


def is_limit(text: str | None) -> bool:
    """Whether a text is a limit: a number above 0 and below `UNLIMITED`."""
    try:
        return 0.0 < float(text or 0.0) < UNLIMITED
    except ValueError:
        return bool(text and text.strip())


def range_of(
    element: Element, attribute: str, limited: str, autolimits: bool, label: str
) -> tuple[float, float] | None:
    """Return (least, greatest) of a range of MJCF, None where it does not limit; 0 to 0 means no range."""
    given, word = element.get(attribute), element.get(limited, "auto")
    if word == "false" or (word == "auto" and not any(part.strip("+-0.") for part in (given or "").split())):
        return None
    if word == "auto" and not autolimits:
        raise ValueError(f"{limited} of {label} must be given beside {attribute}: autolimits of <compiler> is false")
    low, high = numbers(given, 2, None, f"{attribute} of {label}").tolist()
    if low > high:
        raise ValueError(f"{attribute} of {label} must not decrease, got {given!r}")
    return low, high


def mesh_file(uri: str, folders: Sequence[Path], remedy: str = "; give its folder in package_dirs") -> Path:
    """Find the file of ``package://package/rest``, ``model://...``, ``file://...`` or a path in one of `folders`."""
    scheme, _, rest = uri.rpartition("://")
    if not rest:
        raise ValueError("<mesh> names no file")
    if scheme in ("package", "model"):
        rest = rest.lstrip("/")
    tried = [Path(rest)] if scheme == "file" else [folder / rest for folder in folders]
    if scheme in ("package", "model"):
        package, _, inner = rest.partition("/")
        tried += [folder / inner for folder in folders if folder.name == package]
    for path in tried:
        if is_file(path):
            return inside(path, rest, folders, f"mesh {uri!r}")
    raise ValueError(f"mesh {uri!r} was not found in {', '.join(map(str, folders))}{remedy}")


def inside(path: Path, given: str, folders: Sequence[Path], what: str) -> Path:
    """Return the path, `given` as text in a file; ValueError unless it lies in one of the folders, links followed."""
    if ".." in Path(given).parts:
        raise ValueError(f"{what} must not go up by '..': name it from the folder of the file, or one given")
    if not any(path.resolve().is_relative_to(folder.resolve()) for folder in folders):
        raise ValueError(f"{what} lies outside of {', '.join(map(str, folders))}, which is not read")
    return path
