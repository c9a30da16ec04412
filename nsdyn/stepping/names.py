"""Which shapes and which moving frames the names of a scene stand for."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nsdyn.scene.bodies import Geom
from nsdyn.scene.description import describe_links
from nsdyn.scene.scene import Scene
from nsdyn.tools.arrays import Array, Bools
from nsdyn.tools.naming import choice

__all__ = ["Names"]


class Names:
    """The names of a scene with such shapes."""

    def __init__(self, scene: Scene, geoms: Sequence[Geom]) -> None:
        labels = [(g.body, g.link or g.name) for g in geoms]
        names = dict.fromkeys(name for both in labels for name in both)
        self._members = {name: np.array([name in both for both in labels]) for name in names}
        self._places = {body.name: (k, np.zeros(3)) for k, body in enumerate(scene.free_bodies)}
        for link in describe_links(scene):
            if link["frame"] >= 0:
                self._places[link["name"]] = link["frame"], np.array(link["placement"])[:3, 3]

    def members(self, name: str) -> Bools:
        """Whether each shape belongs to a body, "articulation/body" or articulation; ValueError if there is none."""
        return self._members[choice(name, self._members, "body")]

    def place(self, name: str) -> tuple[int, Array]:
        """The frame that carries a free body or "articulation/body", and its origin there, m; ValueError if none."""
        return self._places[choice(name, self._places, "moving body")]
