"""A thousand kilograms on nine boxes of one kilogram.

Look at the load under each box: the weights above it to round-off, and at the drift: none. The mass ratio that makes
relaxation methods sink or fall does not matter to a Newton method in velocity space.
"""

import numpy as np

import nsdyn as nd

BELOW, RATIO, DT = 9, 1000.0, 1e-2
EXPECTED = {
    "loads": 9.81 * (RATIO + np.arange(BELOW, -1, -1)),  # N, from the ground up
    "drift": 0.0,  # m
}


def run() -> nd.Trajectory:
    """One second of standing still."""
    return nd.simulate(nd.scenes.load("heavy_on_light")(ratio=RATIO, below=BELOW), 1.0, dt=DT)


def loads(trajectory: nd.Trajectory) -> np.ndarray:
    """Normal force under each box, N, from the ground up."""
    contacts = trajectory.contacts(-1)
    force: dict[str, float] = {}
    for upper, r in zip(contacts.body2, contacts.impulse[:, 0], strict=True):
        force[upper] = force.get(upper, 0.0) + r / DT
    return np.array(list(force.values()))


def drift(trajectory: nd.Trajectory) -> float:
    """Largest displacement of any box, m."""
    x = trajectory.q.reshape(len(trajectory.t), -1, 7)[..., :3]
    return float(np.abs(x - x[0]).max())


def main() -> None:
    """Print the loads and write a page with the contact forces."""
    trajectory = run()
    for k, (found, expected) in enumerate(zip(loads(trajectory), EXPECTED["loads"], strict=True)):
        print(f"under box {k}: {found:.6f} N, weight above {expected:.6f} N")
    print(f"drift {drift(trajectory):.1e} m, worst Gauss bound {trajectory.gauss.bound.max():.1e} sqrt(J)")
    trajectory.to_html("stacking.html", forces=True)
    print("stacking.html")


if __name__ == "__main__":
    main()
