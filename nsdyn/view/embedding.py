"""The page of a recording inside a notebook, saved with the cell."""

from __future__ import annotations

import base64
import html as _escape
import zlib
from typing import TYPE_CHECKING

from nsdyn.view.viewer import html

if TYPE_CHECKING:
    from nsdyn.recording.trajectory import Trajectory

LARGEST = 2_000_000
"""Most characters of a page in a notebook; the notebook file grows by as many."""

HEIGHT = 560
"""Height of the frame, pixels."""

OPENING = """<script>(async () => {
  const packed = Uint8Array.from(atob("%s"), letter => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const page = await new Response(stream).text();
  document.open();
  document.write(page);
  document.close();
})();</script>"""
"""A page that replaces itself by the page packed in it."""


def iframe(trajectory: Trajectory) -> str:
    """Return a frame with the page of a recording, which needs no network; a text instead if it exceeds LARGEST."""
    packed = base64.b64encode(zlib.compress(html(trajectory).encode(), 6)).decode()
    if len(packed) > LARGEST:
        return f"<p>Its page of {len(packed) / 1e6:.1f} MB is too large for a notebook: write it with to_html.</p>"
    content = _escape.escape(OPENING % packed)
    style = f"width: 100%; height: {HEIGHT}px; border: 1px solid #d5dbe1"
    return f'<iframe title="{_escape.escape(repr(trajectory))}" srcdoc="{content}" style="{style}"></iframe>'
