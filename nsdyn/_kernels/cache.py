"""Where numba keeps compiled kernels: in a folder named by all that they were compiled from.

numba sees a change of a kernel's own file only. Here the text of a file, and of the files of ours that it imports,
names the folder: nothing is ever out of date, environments share, and what was not used for long is removed.
"""

import fcntl
import hashlib
import os
import re
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache, lru_cache, partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numba
import numpy as np

FOLDER = "NSDYN_CACHE_DIR"
"""Environment variable that names the cache folder."""

KEPT = 2000
"""Texts of files whose kernels are kept, those used last: some hundred MB."""

_IMPORT = re.compile(r"^(?:from|import) +(nsdyn[\w.]*)(?: +import +(\([^)]*\)|.*))?", re.MULTILINE)


@lru_cache(maxsize=1)
def folder() -> Path | None:
    """Folder of all kernels, made if there is none; None if none can be written."""
    home, own = os.environ.get("XDG_CACHE_HOME") or "~/.cache", Path(tempfile.gettempdir(), f"nsdyn-{os.getuid()}")
    named, numbas = os.environ.get(FOLDER), os.environ.get("NUMBA_CACHE_DIR")
    chosen = Path(named) if named else Path(numbas, "nsdyn") if numbas else None
    for place in [chosen] if chosen else [Path(home, "nsdyn").expanduser(), own]:
        with suppress(OSError):
            place.mkdir(mode=0o700, parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=place).close()
            if place.stat().st_uid == os.getuid():  # what is read is executed, and a temporary folder is everybody's
                return place.absolute()
    return None


@cache
def contents(module: str) -> str:
    """Hash of the text of a module and, transitively, of the modules of ours it imports."""
    text = Path(sys.modules[module].__file__ or "").read_text()
    names = set()
    for package, parts in _IMPORT.findall(text):
        names |= {package} | {f"{package}.{part.split()[0]}" for part in parts.strip("()").split(",") if part.strip()}
    below = map(contents, sorted(name for name in names if name in sys.modules and name != __package__))
    versions = numba.__version__, np.__version__, numba.config.BOUNDSCHECK, numba.config.OPT
    return hashlib.sha256(repr((text, *below, versions)).encode()).hexdigest()


def from_function(function: Callable[..., Any], file: str) -> SimpleNamespace:
    """What numba asks of a locator; it is asked before the file may be edited."""
    place = folder() or Path()
    own = place / f"{function.__module__.rpartition('.')[2]}-{contents(function.__module__)[:32]}"
    with suppress(OSError):
        os.utime(own)
    ready = partial(_clean, place)
    return SimpleNamespace(
        get_cache_path=own.__str__, ensure_cache_path=ready, get_source_stamp=str, get_disambiguator=str
    )


@lru_cache(maxsize=1)
def _clean(place: Path) -> None:
    """Remove what has not been used for long, once in a process that compiles."""
    with suppress(OSError):
        for _, path in sorted((-entry.stat().st_mtime, entry.path) for entry in os.scandir(place))[KEPT:]:
            shutil.rmtree(path)


@contextmanager
def alone(place: str | None, name: str, wait: bool = True) -> Iterator[bool]:
    """Wait for another process that does this in a folder, or tell whether there is none; its end ends its hold."""
    with ExitStack() as held:
        free = True
        with suppress(OSError, TypeError):  # without a folder, or locks in it, all do it
            os.makedirs(place, exist_ok=True)  # type: ignore[arg-type]
            file = held.enter_context(open(os.path.join(place, name), "ab"))  # type: ignore[arg-type]
            try:
                fcntl.flock(file, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
            except BlockingIOError:
                free = False
        yield free
