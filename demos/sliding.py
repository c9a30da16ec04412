"""A cube thrown along the ground, in twelve directions.

Look at the stopping distance: v0²/(2 mu g) whatever the heading, since the friction cone is round, and whatever the
step to second order. All kinetic energy ends in the friction column of the ledger.
"""

import math

import nsdyn as nd

MU, SPEED, DT = 0.5, 2.0, 1e-3
EXPECTED = {
    "distance": SPEED**2 / (2 * MU * 9.81),  # m
    "friction": -0.5 * SPEED**2,  # J for 1 kg
}


def run() -> list[nd.Trajectory]:
    """Trajectories for twelve headings."""
    scene = nd.scenes.load("slide")
    return [nd.simulate(scene(mu=MU, speed=SPEED, heading=30.0 * k), 0.6, dt=DT) for k in range(12)]


def distance(trajectory: nd.Trajectory) -> float:
    """How far the cube went, m."""
    start, end = trajectory.body("box").position[[0, -1]]
    return math.dist(start, end)


def main() -> None:
    """Print the distances and write one page."""
    trajectories = run()
    print(f"expected {EXPECTED['distance']:.9f} m")
    for k, trajectory in enumerate(trajectories):
        print(f"{30 * k:4d} deg  {distance(trajectory):.9f} m   friction {trajectory.energy.friction.sum():.6f} J")
    trajectories[1].to_html("sliding.html")
    print("sliding.html")


if __name__ == "__main__":
    main()
