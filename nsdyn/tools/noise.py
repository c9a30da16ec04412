"""Capture of messages that C++ libraries print on stderr, so that an exception can report them in one line."""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def caught() -> Iterator[list[str]]:
    """Yield a list that contains, after the block, the lines printed on file descriptor 2 during the block."""
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
    """Return the first error that a library printed, else the message of its exception, without source locations."""
    for line in lines:
        if line.startswith("Error:"):
            return line.removeprefix("Error:").strip()
    text = str(failure).partition("message:")[2] or str(failure)
    return " ".join(re.sub(r"Hint: .*", "", text, flags=re.DOTALL).split())
