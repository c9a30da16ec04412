"""What the ways to find contacts from Python cost: why nsdyn takes the one it takes.

    python demos/bench/collision.py [--boxes 1000]

Boxes stacked in towers that touch. Microseconds per step and per pair that touches, medians:

- a loop in Python over the pairs, `coal.collide` and `coal.computeContactPatch`, and reading what they found;
- Pinocchio's `computeCollisions` over all pairs, and over a broad phase manager of its own;
- nsdyn's candidate pairs from bounding boxes, and `computeDistances` over them in one call per batch;
- what it costs to renew the candidates and to rebuild the batches when they have changed.
"""

import argparse
import statistics
import time
from collections.abc import Callable

import coal
import numpy as np
import pinocchio as pin

import nsdyn as nd
from nsdyn.collision.contacts import ContactSet
from nsdyn.collision.detector import Detector
from nsdyn.dynamics.dynamics import Dynamics
from nsdyn.scene.pairs import pair_material

ALL_PAIRS = 200
"""Boxes up to which all pairs are tried: they take memory and time with the square of their number."""


def towers(boxes: int) -> nd.Scene:
    """Towers of ten boxes, each box on the next."""
    scene = nd.Scene()
    side = int(np.ceil(np.sqrt(boxes / 10)))
    for k in range(boxes):
        x, y = divmod(k // 10, side)
        scene.add_box(f"box{k}", (0.2, 0.2, 0.2), 1.0, position=(0.5 * x, 0.5 * y, 0.1 + 0.2 * (k % 10)))
    return scene


def median(work: Callable[[], object], repeats: int = 15) -> float:
    """Median seconds of a call."""
    work()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def loop(centres: np.ndarray, pairs: list[tuple[int, int]]) -> tuple[Callable[[], object], Callable[[], object]]:
    """Coal's collision, and its contact patches with their points read, pair by pair in Python."""
    box = coal.Box(0.2, 0.2, 0.2)
    poses = [coal.Transform3s(np.eye(3), x) for x in centres]
    request, result = coal.CollisionRequest(coal.CONTACT, 1), coal.CollisionResult()
    request.security_margin = 1e-3
    patch, patches = coal.ContactPatchRequest(), coal.ContactPatchResult()

    def collide(read: bool) -> None:
        for a, b in pairs:
            result.clear()
            coal.collide(box, poses[a], box, poses[b], request, result)
            if read:
                coal.computeContactPatch(box, poses[a], box, poses[b], result, patch, patches)
                found = patches.getContactPatch(0)
                [found.getPoint(k) for k in range(found.size())]

    return lambda: collide(False), lambda: collide(True)


def pinocchio_models(centres: np.ndarray) -> tuple[pin.Model, pin.GeometryModel]:
    """One GeometryModel with every box on the universe and all pairs."""
    model, geometry = pin.Model(), pin.GeometryModel()
    for k, x in enumerate(centres):
        geometry.addGeometryObject(pin.GeometryObject(f"box{k}", 0, 0, pin.SE3(np.eye(3), x), coal.Box(0.2, 0.2, 0.2)))
    for a in range(len(centres)):
        for b in range(a + 1, len(centres)):
            geometry.addCollisionPair(pin.CollisionPair(a, b))
    return model, geometry


def report(what: str, seconds: float, touching: int) -> None:
    """One line of the table."""
    print(f"{what:<66} {1e6 * seconds:>10.0f} us {1e6 * seconds / touching:>8.2f} us")


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--boxes", type=int, default=1000, help="number of boxes (default: 1000)")
    boxes = parser.parse_args().boxes
    scene = towers(boxes)
    dynamics, geoms = Dynamics(scene), scene.geoms()
    x, R, _ = dynamics.place(dynamics.start()[0])
    detector = Detector(geoms, pair_material(scene, geoms))
    still = np.zeros(dynamics.frames)
    contacts = detector.find(x, R, still, ContactSet.empty())
    pairs = sorted(set(zip(contacts.geom1.tolist(), contacts.geom2.tolist(), strict=True)))
    touching = len(pairs)
    print(f"{boxes} boxes, {touching} pairs that touch, {contacts.gap.size} contacts{'a step':>34} {'a pair':>15}")

    collide, patches = loop(x, pairs)
    report("Python loop over the touching pairs: coal.collide", median(collide), touching)
    report("... and contact patches, their points read", median(patches), touching)

    some = min(boxes, ALL_PAIRS)
    model, geometry = pinocchio_models(x[:some])
    data, shapes = model.createData(), geometry.createData()
    q = pin.neutral(model)
    pin.updateGeometryPlacements(model, data, geometry, shapes, q)
    touch = max(1, sum(a < some and b < some for a, b in pairs))
    report(
        f"pin.computeCollisions over all pairs of {some}",
        median(lambda: pin.computeCollisions(geometry, shapes)),
        touch,
    )
    manager = pin.BroadPhaseManager_DynamicAABBTreeCollisionManager(model, geometry, shapes)

    def managed() -> None:
        manager.update(False)
        pin.computeCollisions(manager, False)

    report(f"pin.computeCollisions over its broad phase, {some}", median(managed), touch)

    def find() -> object:
        return detector.find(x, R, still, contacts)

    def renew() -> None:
        detector._fat_lower[:] = np.inf
        find()

    def rebuild() -> None:
        detector._set_pairs(detector._codes)

    report("nsdyn: all of it, candidates as before", median(find), touching)
    report("nsdyn: all of it, candidates renewed, the same as before", median(renew), touching)
    report("nsdyn: batches for Coal rebuilt for other candidates", median(rebuild), touching)


if __name__ == "__main__":
    main()
