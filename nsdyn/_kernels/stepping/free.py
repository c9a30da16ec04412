"""Moves in as few calls as the equations suggest: each is one of the kernels of a move in turn.

A call from Python takes as long as what it does for a few bodies. Arguments come in plain tuples, named as those of the
kernels that are called. The frames of free bodies are at their centres of mass.
"""

from nsdyn._kernels.compiled import in_place
from nsdyn._kernels.dynamics import links, motion
from nsdyn._kernels.dynamics.rotation import flow
from nsdyn._kernels.problem import blocks as _blocks
from nsdyn._kernels.reductions import most
from nsdyn._kernels.stepping import law, touching


@in_place
def half(bodies, loads, position, h, theta, looked, near, out):
    """The first half of a move: a free flow, the velocity after the forces there, how far it reaches.

    Into out = (x, quaternion, v, R, v_free, its rate, reach). Returns the longest reach, and whether the contacts that
    were `looked` for, (x, R, reach), are those of there, with near = (arm, tol). The loads are (gravity, load, how fast
    bodies fall), the position is (x, quaternion, v).
    """
    (gravity, load, fall), (x_begin, quaternion_begin, v), (arm, tol) = loads, position, near
    moments, axes, inverse_mass, inverse_J, radius = bodies
    x, quaternion, v_there, R, v_free, rate, reach = out
    flow(moments, axes, x_begin, quaternion_begin, v, (1.0 - theta) * h, x, quaternion, v_there)
    motion.rotations(quaternion, R)
    motion.accelerate(inverse_mass, inverse_J, gravity, load, load, h, v_there, v_free)
    for i in range(v_free.size):
        rate[i] = (v_free[i] - v_there[i]) / h
    motion.reach(v_free, theta * h, theta * h * h * fall, radius, reach)
    same = touching.unmoved(looked, (x, R, reach), arm, tol)
    return most(reach), same


@in_place
def given(movers, loads, position, h, theta, looked, near, out):
    """What `half` finds beyond it, of a first half that is made: rate, reach; the longest, and whether contacts stay.

    Loads are (radius, how fast bodies fall), the position is (x, R, v, v_free), movers as of `meet`.
    """
    (radius, fall), (x, R, v, v_free), (free, trees), (rate, reach) = loads, position, movers, out
    for i in range(v_free.size):
        rate[i] = (v_free[i] - v[i]) / h
    ahead, fallen = theta * h, theta * h * h * fall
    motion.reach(v_free, ahead, fallen, radius[:free], reach)
    links.reach(trees, x, v_free, ahead, radius[free:], fallen, reach[free:])
    return most(reach), touching.unmoved(looked, (x, R, reach), *near)


@in_place
def meet(masses, movers, here, begin, velocities, warm, laws, rows, out):
    """What a move meets at its contacts and the problem that it poses; the size of H, the norm of b and its validity.

    Parameters
    ----------
    masses, movers : tuple
        (block_of_frame, offset, m_start, m, minv), and (free bodies, trees as of `links.rows`).
    here : tuple
        (key, frame1, frame2, point, normal, gap, x, R) where the impulses act.
    begin, velocities, warm : tuple
        As in `law.local_velocities`, warm with what contacts were.
    laws, out : tuple
        (mu, restitution, closing), closing as in `law.offsets`, and (local, end_gap, place, slides, b).
    rows : tuple
        Room for (frame, block, start, H, scales), with enough for H, and whether they are made: the contacts are those
        that were met before.
    """
    block_of_frame, offset, m_start, m, minv = masses
    key, frame1, frame2, point, normal, gap, x, R = here
    frame, block, start, H, scales, again = rows
    size = H.size
    if not again:
        size = motion.contact_layout(normal, frame1, frame2, block_of_frame, offset, frame, block, start)
        if movers[0] < x.shape[0]:
            H[:size] = 0.0
        motion.free_rows(frame1, frame2, point, frame, x, R, movers[0], start, H)
        links.rows(movers[1], frame1, frame2, point, frame, start, H)
    blocks = (offset, block, start, H[:size], m_start, m, minv)
    if not again:
        _blocks.delassus_scales(blocks, scales)
    (mu, restitution, closing), (local, end_gap, place, slides, b), none = laws, out, scales[:0]
    there, surfaces = (key, frame1, frame2, point, frame, gap, x), (point[:0], none, none, none)
    law.local_velocities(blocks, velocities, surfaces, begin, there, warm[:3], closing[2], (local, end_gap, place))
    law.foresee(blocks, mu, place, warm[3], local, slides)
    law.offsets(local, (end_gap, restitution, none, none, closing), slides[:0], slides, b)
    norm, good = _blocks.size_of(b, mu)
    return size, norm, good and _blocks.in_range(scales)


@in_place
def moving(movers, x, R, v, linear, angular):
    """Velocities of all frames, at x (n, 3), and angular ones, world axes, into (n, 3) each; movers as of `meet`."""
    motion.twists(R, v, movers[0], linear, angular)
    links.twists(movers[1], x, v, linear, angular)


@in_place
def end(v_free, change, bodies, position, h, out):
    """The second half of a move: v⁺ = v_f + change and a free flow.

    Into out = (v⁺, x, quaternion, v, R, linear, angular).
    """
    v_plus, x, quaternion, v, R, linear, angular = out
    for i in range(v_plus.size):
        v_plus[i] = v_free[i] + change[i]
    flow(bodies[0], bodies[1], position[0], position[1], v_plus, h, x, quaternion, v)
    motion.rotations(quaternion, R)
    motion.twists(R, v, x.shape[0], linear, angular)
