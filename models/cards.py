"""House of cards: frames of two leaning cards, a flat card across each pair of ridges, a smaller storey above."""

import numpy as np

from nsdyn import Material, Scene

DURATION, DT = 1.0, 5e-3


def _clip(polygon: np.ndarray, normal: tuple[float, float], offset: float) -> np.ndarray:
    """Part of a convex polygon (n, 2) with normal·p <= offset."""
    out = []
    heights = polygon @ np.array(normal) - offset
    for k, (p, h) in enumerate(zip(polygon, heights, strict=True)):
        p0, h0 = polygon[k - 1], heights[k - 1]
        if (h <= 0) != (h0 <= 0):
            out.append(p0 + (p - p0) * h0 / (h0 - h))
        if h <= 0:
            out.append(p)
    return np.array(out)


def scene(
    levels: int = 2,
    lean: float = 20.0,
    height: float = 0.08,
    thickness: float = 0.002,
    depth: float = 0.06,
    density: float = 800.0,
    mu: float = 0.4,
) -> Scene:
    """`levels` storeys of frames `height` [m] high whose cards lean by `lean` [deg] from the vertical.

    Cards are cut level at the ground and at the ridge, and plumb where the two of a frame meet, so that they touch in
    faces. One frame stands if mu >= tan(lean)/2.
    """
    out = Scene(name="cards")
    material = Material(mu=mu)
    out.add_halfspace("ground", material=material)
    a = np.radians(lean)
    along, across = np.array([np.sin(a), np.cos(a)]), np.array([np.cos(a), -np.sin(a)])
    # Left card of a frame with its ridge at x = 0; its axis gets there so far below the top that the level cut there
    # is 0.4 thicknesses wide.
    ridge = np.array([0.0, height - thickness * (0.5 / np.cos(a) - 0.4) / np.tan(a)])
    card = np.array(
        [ridge + s * along * 2 * height + t * across * thickness / 2 for s, t in ((-1, -1), (-1, 1), (1, 1), (1, -1))]
    )
    for normal, offset in (((0, -1), 0.0), ((0, 1), height), ((1, 0), 0.0)):
        card = _clip(card, normal, offset)
    x, z = card.T
    area = 0.5 * abs(x @ np.roll(z, 1) - z @ np.roll(x, 1))
    pitch = 2.0 * (-x.min()) + 4 * thickness
    for level in range(levels):
        z0 = level * (height + thickness)
        for k in range(levels - level):
            x0 = (k + 0.5 * level) * pitch
            for side, mirror in (("left", 1.0), ("right", -1.0)):
                vertices = [(x0 + mirror * p, y, z0 + q) for p, q in card for y in (-depth / 2, depth / 2)]
                out.add_convex(f"{side}{level}_{k}", vertices, density * area * depth, material=material)
        for k in range(levels - level - 1):
            x0 = (k + 0.5 * level + 0.5) * pitch
            size = (pitch - 0.1 * thickness, depth, thickness)
            out.add_box(
                f"flat{level}_{k}",
                size,
                density * float(np.prod(size)),
                material=material,
                position=(x0, 0, z0 + height + thickness / 2),
            )
    return out
