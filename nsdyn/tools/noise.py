"""What libraries in C++ print on stderr, caught: the user is told in one line, by an exception."""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["caught", "told"]


@contextmanager
def caught() -> Iterator[list[str]]:
    """Yield a list that holds, after the block, the lines which were printed on file descriptor 2 in it."""
    lines: list[str] = []
    with tempfile.TemporaryFile() as file:
        kept = os.dup(2)
        os.dup2(file.fileno(), 2)
        try:
            yield lines
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            file.seek(0)
            lines += file.read().decode(errors="replace").splitlines()


def told(failure: Exception, lines: list[str]) -> str:
    """The first error a library printed, else what its exception says, without the places in its sources."""
    for line in lines:
        if line.startswith("Error:"):
            return line.removeprefix("Error:").strip()
    text = str(failure).partition("message:")[2] or str(failure)
    return " ".join(re.sub(r"Hint: .*", "", text, flags=re.DOTALL).split())
