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
from numba.core.caching import NullCache
from numba.core.compiler import CompileResult
from numba.core.serialize import dumps

FOLDER = "NSDYN_CACHE_DIR"
"""Environment variable that names the cache folder."""

KEEP, LARGEST = 60 * 86400.0, 1_000_000_000
"""s after its last use that a file is kept, and bytes of all files, the last used ones first."""

PLATFORM = (sys.implementation.cache_tag, numba.__version__, *np.__version__.split(".")[:2])

_IMPORT = re.compile(r"^(?:from|import) +(nsdyn[\w.]*)(?: +import +(\([^)]*\)|.*))?", re.MULTILINE)


def folders() -> list[Path]:
    """Where the cache may be, the first that can be written counts."""
    for name, below in ((FOLDER, ""), ("NUMBA_CACHE_DIR", "nsdyn")):
        if os.environ.get(name):
            return [Path(os.environ[name]).absolute() / below]
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()).absolute()
    return [home / "nsdyn", Path(tempfile.gettempdir()) / f"nsdyn-{os.getuid()}"]


@lru_cache(maxsize=1)
def folder() -> Path | None:
    """Folder of the compiled kernels, made if there is none; None if none can be written."""
    for place in folders():
        with suppress(OSError):
            place.mkdir(mode=0o700, parents=True, exist_ok=True)
            tempfile.TemporaryFile(dir=place).close()
            if place.stat().st_uid == os.getuid():  # what is read is executed, and a temporary folder is everybody's
                return place
    return None


@cache
def imports(module: str) -> list[str]:
    """Modules of ours that one imports."""
    names = set()
    for package, parts in _IMPORT.findall(Path(sys.modules[module].__file__).read_text()):
        names |= {package} | {f"{package}.{part.split()[0]}" for part in parts.strip("()").split(",") if part.strip()}
    return sorted(name for name in names if name in sys.modules and name != __package__)


@cache
def reached(module: str) -> frozenset[str]:
    """The module, those that it imports, and those that these import."""
    return frozenset((module,)).union(*map(reached, imports(module)))


@cache
def contents(module: str) -> bytes:
    """Hash of the text of a module and, transitively, of the modules of ours it imports."""
    text = Path(sys.modules[module].__file__).read_text()
    return hashlib.sha256(text.encode() + b"".join(map(contents, imports(module)))).digest()


class Cache(NullCache):
    """What one function was compiled to: a file for each list of types of arguments."""

    form = "machine code"
    """Of what is kept."""

    def __init__(self, function: Callable[..., Any]) -> None:
        # Now, since the file may be edited before the first call
        content = contents(function.__module__).hex()
        self.name = f"{function.__module__.rpartition('.')[2]}.{function.__qualname__}-{content[:16]}"
        self._contents = function.__module__, content

    @property
    def cache_path(self) -> str | None:
        """Folder, which `Kernel.stats` shows."""
        return str(folder()) if folder() else None

    def file(self, types: Any, context: Any) -> Path | None:
        """File of what it is compiled to for these types, None without a cache."""
        place = folder()
        if place is None:
            return None
        on = PLATFORM, config.BOUNDSCHECK, context.codegen().magic_tuple()
        key = hashlib.sha256(repr((self.name, self._contents, self.form, str(types), on)).encode()).hexdigest()
        return place / f"{self.name}-{key[:32]}.nbc"

    def load_overload(self, types: Any, context: Any) -> CompileResult | None:
        """The compiled function, None if it is not in the cache."""
        context.refresh()
        file = self.file(types, context)
        try:
            data = file.read_bytes()
            os.utime(file)
        except (AttributeError, OSError):
            return None
        return self.rebuild(context, pickle.loads(data))

    def save_overload(self, types: Any, result: CompileResult) -> None:
        """Keep a compiled function; a full disk costs a compilation at the next start."""
        file = self.file(types, result.target_context)
        if file is None:
            return
        _clean(file.parent)
        data = dumps(self.reduce(result))
        with suppress(OSError), tempfile.NamedTemporaryFile(dir=file.parent, delete=False) as part:
            try:
                part.write(data)
                part.close()
                os.replace(part.name, file)
            except OSError:
                os.unlink(part.name)
                raise

    def reduce(self, result: CompileResult) -> tuple[Any, ...]:
        """What of a compiled function is kept."""
        kept: tuple[Any, ...] = result._reduce()
        return kept

    def rebuild(self, context: Any, kept: tuple[Any, ...]) -> CompileResult:
        """The compiled function of what was kept."""
        return CompileResult._rebuild(context, *kept)


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
