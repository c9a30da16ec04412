"""Pairs of shapes: the pairs that never touch, and the coefficients of pairs that may."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from nsdyn.scene.bodies import Geom
from nsdyn.scene.materials import COMBINATION_RULES
from nsdyn.tools.arrays import Array, Bools, Index

if TYPE_CHECKING:
    from nsdyn.scene.scene import Scene


def pair_material(scene: Scene, geoms: Sequence[Geom]) -> Callable[[Index, Index], tuple[Array, Array]]:
    """Return a function of two index arrays into `geoms` that returns (mu, restitution) of each pair."""
    mu = np.array([g.material.mu for g in geoms])
    e = np.array([g.material.restitution for g in geoms])
    names = sorted({g.link for g in geoms})
    rank = {name: k for k, name in enumerate(names)}
    owner = np.array([rank[g.link] for g in geoms], dtype=np.int64)
    members: dict[str, set[int]] = {}
    for g in geoms:
        for name in (g.body, g.link):
            members.setdefault(name, set()).add(rank[g.link])
    special = {}
    for pair, values in sorted(scene.pairs.items(), key=lambda item: sum("/" in name for name in item[0])):
        a, *b = pair
        for i, j in product(members.get(a, ()), members.get(b[0] if b else a, ())):
            special[min(i, j) * len(names) + max(i, j)] = values
    codes = np.array(sorted(special), dtype=np.int64)

    def combine(i: Index, j: Index) -> tuple[Array, Array]:
        pair_mu = np.asarray(COMBINATION_RULES[scene.friction_rule](mu[i], mu[j]), dtype=float)
        pair_e = np.asarray(COMBINATION_RULES[scene.restitution_rule](e[i], e[j]), dtype=float)
        if codes.size:
            code = np.minimum(owner[i], owner[j]) * len(names) + np.maximum(owner[i], owner[j])
            for k in np.flatnonzero(np.isin(code, codes)):
                own_mu, own_e = special[int(code[k])]
                pair_mu[k] = pair_mu[k] if own_mu is None else own_mu
                pair_e[k] = pair_e[k] if own_e is None else own_e
        return pair_mu, pair_e

    return combine


def excluded(scene: Scene, geoms: Sequence[Geom]) -> set[tuple[int, int]]:
    """Return the pairs of geoms that are never tested for contact: the pairs that articulations exclude."""
    out = set()
    for name, a in scene.articulations.items():
        fixed = {body.name for body in a.fixed}
        own = [k for k, g in enumerate(geoms) if g.body == name] + [k for k, g in enumerate(geoms) if g.body in fixed]
        out |= {(own[i], own[j]) for i, j in a.excluded}
    return out


def among(geoms: Sequence[Geom], held: Bools) -> set[tuple[int, int]]:
    """Return the pairs of geoms that are both on `held` frames, (frames,), or one on a held frame and one fixed."""
    stiff = [k for k, g in enumerate(geoms) if g.frame < 0 or held[g.frame]] if held.any() else []
    return {(i, j) for i in stiff for j in stiff if i < j and (geoms[i].frame >= 0 or geoms[j].frame >= 0)}
