"""Free body with three different moments of inertia, thrown in empty space: energy and angular momentum stay."""

from nsdyn import Scene

DURATION, DT = 10.0, 1e-2


def scene(
    length: float = 0.3,
    width: float = 0.2,
    height: float = 0.1,
    mass: float = 1.0,
    wx: float = 1.0,
    wy: float = 3.0,
    wz: float = 2.0,
) -> Scene:
    """Box of `length` x `width` x `height` [m] and `mass` [kg] turning at (`wx`, `wy`, `wz`) [rad/s], no gravity."""
    out = Scene(gravity=(0, 0, 0), name="tumble")
    out.add_box("box", (length, width, height), mass, angular_velocity=(wx, wy, wz))
    return out
