"""The cache of compiled kernels.

numba's own cache lies beside the source, so that every environment compiles anew, and sees a change of a kernel's own
file only. Here a compiled kernel is one file in the user's cache folder, named by all that its machine code depends on:
the text of its file and of the files of ours which that imports, the types of its arguments, the processor, and the
versions of Python, numba and NumPy. Nothing is ever out of date, environments share, and what is no longer asked for is
removed after a while.
"""

import errno
import fcntl
import hashlib
import os
import pickle
import re
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba.core import config
from numba.core.serialize import dumps

FOLDER = "NSDYN_CACHE_DIR"
"""Environment variable that names the cache folder."""

KEEP, LARGEST = 60 * 86400.0, 1_000_000_000
"""s after its last use that a file is kept, and bytes of all files, the last used ones first."""

PLATFORM = (sys.implementation.cache_tag, numba.__version__, *np.__version__.split(".")[:2])

_IMPORT = re.compile(r"^(?:from|import) +(nsdyn[\w.]*)(?: +import +(\([^)]*\)|.*))?", re.MULTILINE)


@lru_cache(maxsize=1)
def folder() -> Path | None:
    """Folder of the compiled kernels, made if there is none; None if none can be written."""
    if given := os.environ.get(FOLDER):
        places = [Path(given)]
    elif given := os.environ.get("NUMBA_CACHE_DIR"):
        places = [Path(given) / "nsdyn"]
    else:
        home = Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser())
        places = [home / "nsdyn", Path(tempfile.gettempdir()) / f"nsdyn-{os.getuid()}"]
    for place in map(Path.absolute, places):
        with suppress(OSError):
            place.mkdir(mode=0o700, parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=place).close()
            if place.stat().st_uid == os.getuid():  # what is read is executed, and a temporary folder is everybody's
                return place
    return None


@lru_cache(maxsize=1)
def _clean(place: Path) -> None:
    """Remove what has not been used for long, once in a process."""
    with suppress(OSError):
        found = sorted(((entry.stat(), entry.path) for entry in os.scandir(place)), key=lambda f: -f[0].st_mtime)
        total, now = 0, time.time()
        for status, path in found:
            total += status.st_size
            if total > LARGEST or now - status.st_mtime > KEEP:
                os.unlink(path)


@cache
def reached(module: str) -> frozenset[str]:
    """The module, those of ours that it imports, and those that these import."""
    names = set()
    for package, parts in _IMPORT.findall(Path(sys.modules[module].__file__).read_text()):
        names |= {package} | {f"{package}.{part.split()[0]}" for part in parts.strip("()").split(",") if part.strip()}
    return frozenset((module,)).union(*map(reached, names & sys.modules.keys() - {__package__}))


@cache
def contents(module: str) -> str:
    """Hash of the text of a module and of those that it `reached`."""
    texts = [Path(sys.modules[name].__file__).read_text() for name in (module, *sorted(reached(module)))]
    return hashlib.sha256("".join(texts).encode()).hexdigest()


class Cache:
    """What one function was compiled to: a file for each list of types of arguments."""

    def __init__(self, function: Callable[..., Any], form: str) -> None:
        # Now, since the file may be edited before the first call
        content = contents(function.__module__)
        self.name = f"{function.__module__.rpartition('.')[2]}.{function.__qualname__}-{content[:16]}"
        self._of = form, function.__module__, content, PLATFORM, config.BOUNDSCHECK

    def file(self, types: Any, context: Any) -> Path | None:
        """File of what it is compiled to for these types, None without a cache."""
        place = folder()
        if place is None:
            return None
        key = hashlib.sha256(repr((self._of, str(types), context.codegen().magic_tuple())).encode()).hexdigest()
        return place / f"{self.name}-{key[:32]}.nbc"

    def load(self, types: Any, context: Any) -> Any:
        """What was kept, None if nothing was."""
        context.refresh()
        file = self.file(types, context)
        try:
            data = file.read_bytes()
            os.utime(file)
        except (AttributeError, OSError):
            return None
        return pickle.loads(data)

    def save(self, types: Any, context: Any, kept: Any) -> None:
        """Keep it; a full disk costs a compilation at the next start."""
        file = self.file(types, context)
        if file is None:
            return
        _clean(file.parent)
        data = dumps(kept)
        with suppress(OSError), tempfile.NamedTemporaryFile(dir=file.parent, delete=False) as part:
            try:
                part.write(data)
                part.close()
                os.replace(part.name, file)
            except OSError:
                os.unlink(part.name)
                raise


@lru_cache(maxsize=1)
def _locks(place: Path) -> int:
    """Descriptor of the file whose bytes are the locks, which end with a process."""
    return os.open(place / "locks", os.O_RDWR | os.O_CREAT, 0o600)


@contextmanager
def alone(file: Path | None, wait: bool = True) -> Iterator[bool]:
    """Wait for another process that does the same, or tell whether there is none; without locks all do it."""
    held = None
    if file is not None:
        try:
            held = _locks(file.parent), int(hashlib.sha256(file.name.encode()).hexdigest()[:15], 16)
            fcntl.lockf(held[0], fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB), 1, held[1])
        except OSError as error:
            held = None
            if not wait and error.errno in (errno.EACCES, errno.EAGAIN):
                yield False
                return
    try:
        yield True
    finally:
        if held is not None:
            with suppress(OSError):
                fcntl.lockf(held[0], fcntl.LOCK_UN, 1, held[1])
