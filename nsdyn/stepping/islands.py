"""The step of a scene: all islands move at once; an island that meets an event is taken back and moved by itself.

An island is a group of bodies that may touch within the step. Events are impacts, contacts that open or close, overlaps
at the end of the step, and slip that stops or reverses. An island with an event is moved through all its events as if
no other island existed. Its motion is therefore exactly the motion it has alone. The path of the motion then shows
whether the island came near another one after all. Such islands are moved once more, together.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from itertools import pairwise

import numpy as np

from nsdyn._kernels.stepping import eventless_checks as _checks
from nsdyn._kernels.stepping import islands as _islands
from nsdyn._kernels.stepping.options import OPTIONS
from nsdyn.collision.contacts import ContactSet, take
from nsdyn.dynamics.values import Placement
from nsdyn.problem.fc3d import FC3D
from nsdyn.problem.solution import Solution, Status
from nsdyn.stepping.active_set import missed_impacts, normal_velocities, tracked
from nsdyn.stepping.attempt import Attempt, Known, parted
from nsdyn.stepping.ball_joints import unbalanced
from nsdyn.stepping.collisions import limits_struck, striking
from nsdyn.stepping.contact_kinematics import ContactKinematics
from nsdyn.stepping.midpoint import Loads, Midpoint, midpoint
from nsdyn.stepping.move import try_move
from nsdyn.stepping.scene_state import SceneState, System
from nsdyn.stepping.slip_end import ending
from nsdyn.stepping.state import State
from nsdyn.stepping.step_result import StepResult, finish
from nsdyn.stepping.substepping import integrate
from nsdyn.stepping.subsystems import Subsystem, driven, merged
from nsdyn.tools.arrays import NONE, Array, Bools, Index

KEPT = 2048
"""Most nodes of all subsystems that are kept for reuse: each node takes some 40 kB."""

BENT = 0.25
"""Bound on the deviation of a tree's link from a straight path between two configurations, over the length of that
path."""


class Islands:
    """The step of a scene, moved island by island where events require it, and the subsystems of the islands."""

    def __init__(self, whole: System) -> None:
        d = whole.dynamics
        self.whole, self.count = whole, d.offset.size - 1
        self._node = d.node[whole.detector.frame]
        self._parts: dict[tuple[int, ...], Subsystem] = {}
        self._kept = 0  # their nodes

    def step(self, state: State, loads: Loads, begun: Known) -> StepResult:
        """Return the end of the step dt later, with the impulses and works of its moves.

        `begun` is the known part of the step as one move: its first half, or an attempt at all of it. `loads` gives the
        callbacks for a time [s], as in `nsdyn.stepping.midpoint`. An island that is moved by itself calls them in each
        of its moves; all other bodies are then where the step begins.
        """
        s = self.whole.during(state.next_t - state.dt, state.dt, state.instant.position)
        out = self._step(s, state, loads, begun)
        if not out.end.position.driven_x.size:
            return out
        return out._replace(end=driven(out.end, *s.dynamics.surfaces.poses(state.next_t, s.theta)))

    def _step(self, s: System, state: State, loads: Loads, begun: Known) -> StepResult:
        """Move all islands at once, then move the islands that meet an event by themselves."""
        if self.count < 2:
            return integrate(self.whole, state, loads, begun)
        begin, h, t = state.instant, state.dt, state.next_t - state.dt
        mid, made = parted(begun)
        mid = mid or midpoint(s, begin, t, h, loads(t + (1.0 - s.theta) * h))
        label, count = self._labels_ahead(begin, mid)
        (opened, meets), tried = np.zeros((2, count), np.bool_), None
        opened[label[self._striking_nodes(begin, mid)]] = True
        large = self._large(begin.contacts, label, count)
        if (unseen := large & ~opened).any():
            # Events of a large island are not located: it is captured at once where it will probably meet one.
            meets[label[self._closing_nodes(begin, mid)]] = True
            meets &= unseen
            opened |= meets
        if count < 2:
            return integrate(self.whole, state, loads, made or mid, meets=bool(meets[0]))
        if not (skipped := opened.copy()).all():
            tried = try_move(s, loads, begin, t, h, NONE, made or mid, opened[label])
            self._open_events(begin, tried, label, opened, large)
            meets |= self._islands_hit(tried, label, ~skipped)
            opened |= meets
            if not opened.any():
                done = finish(s, begin, tried)
                self._open_gaining(begin, done, tried, label, opened)
                if not opened.any():
                    return done
        return self._island_by_island(state, loads, mid, label, opened, tried, meets[label])

    def _island_by_island(
        self,
        state: State,
        loads: Loads,
        mid: Midpoint,
        label: Index,
        opened: Bools,
        tried: Attempt | None,
        meets: Bools,
    ) -> StepResult:
        """Complete a step from an attempt at it: the islands `opened` are moved by themselves, the others as attempted.

        `meets` (nodes,) marks nodes whose island is known to meet an event.
        """
        s, begin, d = self.whole, state.instant, self.whole.dynamics
        boxes = self._swept_boxes(s, [begin.placement])
        if tried is not None:
            boxes = self._swept_boxes(s, [begin.placement, mid.state.placement, tried.moved.placement])
        done: dict[tuple[int, ...], tuple[Subsystem, StepResult]] = {}
        key = (begin if tried is None else tried.moved).memory.next_key
        while True:
            for k in np.flatnonzero(opened).tolist():
                nodes = np.flatnonzero(label == k)
                if (name := tuple(nodes.tolist())) in done:
                    continue
                part = self._part(name, nodes)
                own_state, own_loads = part.state(state, key), part.loads(loads, begin)
                result = integrate(part.system, own_state, own_loads, meets=bool(meets[nodes].any()))
                done[name], key = (part, result), result.end.memory.next_key
                own = self._swept_boxes(part.system, result.path)
                moves = part.system.detector.frame >= 0
                for box, mine in zip(boxes, own, strict=True):
                    box[part.geoms[moves]] = mine[moves]
            before, count = label, int(label.max()) + 1
            label = np.empty(self.count, np.int64)
            if self._islands(boxes, begin.contacts, before, label) == count:
                break
            again = np.zeros(int(label.max()) + 1, np.bool_)
            again[label[opened[before]]] = True
            _, least = np.unique(before, return_index=True)
            again |= np.bincount(label[least], minlength=again.size) > 1
            opened = again
        made = [done[tuple(np.flatnonzero(label == k).tolist())] for k in np.flatnonzero(opened).tolist()]
        left = ~opened[label]
        out = StepResult(begin, mid.rate.copy(), [])
        if tried is not None and left.any():
            kept = self._of_nodes(tried, left, key)
            move, count = finish(s, begin, kept, left), opened.sum()
            self._open_gaining(begin, move, kept, label, opened)
            if opened.sum() > count:
                return self._island_by_island(state, loads, mid, label, opened, tried, meets)
            out = move
            out.done[0] = out.done[0]._replace(moves=np.repeat(left[d.free :], np.diff(d.offset[d.free :])))
        for part, p in made:
            out.rate[part.coordinates] = p.rate
            out.done.extend(part.impulses(a) for a in p.done)
        end = merged(s, out.end, left, [(part, p.end) for part, p in made])
        return out._replace(end=end)

    def _part(self, name: tuple[int, ...], nodes: Index) -> Subsystem:
        """Return the subsystem of some nodes, whose indices are its `name`; subsystems are kept for later steps."""
        if name not in self._parts:
            self._kept += nodes.size
            if self._kept > KEPT:
                self._parts.clear()
                self._kept = nodes.size
            self._parts[name] = Subsystem(self.whole, nodes)
        return self._parts[name]

    # -- islands -----------------------------------------------------------------------------------------------

    def _labels_ahead(self, begin: SceneState, mid: Midpoint) -> tuple[Index, int]:
        """Predict the islands of bodies that may touch, for a motion without contact impulses.

        Return the island of each node, (nodes,), and the number of islands.
        """
        s, d = self.whole, self.whole.dynamics
        # At the midpoint contacts are found within the range of detection plus the reach of the second half.
        reach = d.reach(begin.placement, begin.v, mid.h - mid.ahead, mid.h, mid.surfaces[0]) + mid.reach
        lower, upper = s.detector.boxes(*begin.placement[:2])
        frame = s.detector.frame
        far = np.where(frame >= 0, reach[frame] + s.detector.base, 0.0)[:, None]
        label = np.empty(self.count, np.int64)
        return label, self._islands((lower - far, upper + far), begin.contacts, None, label)

    def _islands(self, boxes: tuple[Array, Array], contacts: ContactSet, before: Index | None, label: Index) -> int:
        """Label nodes joined by boxes, contacts or islands `before`, into label (nodes,); return how many islands."""
        node = self.whole.dynamics.node
        first, second = node[contacts.frame1], node[contacts.frame2]
        if before is not None:
            _, least = np.unique(before, return_index=True)
            first, second = np.concatenate((first, least[before])), np.concatenate((second, np.arange(self.count)))
        return int(_islands.islands(*boxes, self._node, first, second, label))

    def _swept_boxes(self, s: System, path: Sequence[Placement]) -> tuple[Array, Array]:
        """Return the lower and upper corners of boxes that contain the geoms along a path, (geoms, 3) each, m."""
        frame, free = s.detector.frame, s.dynamics.free
        lower, upper = s.detector.boxes(*path[0][:2])
        wide = np.zeros(s.dynamics.frames)
        for one, other in pairwise(path):
            _islands.sweep(s.detector.fields, one[:2], other[:2], s.dynamics.radii, (free, BENT), (lower, upper), wide)
        more = np.where(frame >= 0, wide[frame], 0.0)[:, None]
        return lower - more, upper + more

    # -- events ------------------------------------------------------------------------------------------------

    def _striking_nodes(self, begin: SceneState, mid: Midpoint) -> Index:
        """Return nodes of closed contacts and joint limits that approach fast enough for an impact at the beginning."""
        s, d, c = self.whole, self.whole.dynamics, begin.contacts
        out = [d.joints.block[limits_struck(s, begin, mid.h)]]
        if d.surfaces.count or s.striking_speed(begin) < -s.least_strike(c, mid.h):
            u = normal_velocities(d, c, begin, mid.surfaces[0])
            limit = np.where(c.restitution > 0.0, s.solver.tol, s.least_penetration / mid.h)
            strikes = (c.gap <= s.gap_tol) & (u < -limit)
            if strikes.any():  # contacts that pressed before turn with their bodies
                strikes &= (c.restitution > 0.0) | (s.last_status(c, begin.warm) == 0)
            out.append(self._nodes(c, strikes))
        return np.concatenate(out)

    def _closing_nodes(self, begin: SceneState, mid: Midpoint) -> Index:
        """Return nodes of open contacts that become deep within the move at the velocities where it begins."""
        s, c = self.whole, begin.contacts
        deep = c.gap + mid.h * normal_velocities(s.dynamics, c, begin, mid.surfaces[0]) < -s.penetration_tol(c)
        return self._nodes(c, deep & (c.gap > s.gap_tol))

    def _large(self, contacts: ContactSet, label: Index, count: int) -> Bools:
        """Mark islands (count,) with so many contacts that their impacts and ends of slip are not located."""
        return OPTIONS.event * np.bincount(label[self.whole.nodes(contacts)], minlength=count) > OPTIONS.work

    def _nodes(self, c: ContactSet, which: Bools | slice = slice(None)) -> Index:
        """Return the nodes of the contacts marked by `which`."""
        node = self.whole.dynamics.node
        both = np.concatenate((node[c.frame1[which]], node[c.frame2[which]]))
        return both[both >= 0]

    def _of_rows(self, kin: ContactKinematics, which: Bools) -> Index:
        """Return the nodes of the rows marked by `which`, contacts first, then joint rows."""
        nc, out = kin.contacts.gap.size, self._nodes(kin.contacts, which[: kin.contacts.gap.size])
        if kin.joints is None:
            return out
        return np.concatenate((out, self.whole.dynamics.joints.block[kin.joints.slot[which[nc:]]]))

    def _of_codes(self, codes: Index) -> Index:
        """Return the nodes of pairs of shapes by their codes."""
        both: Index = self._node[np.concatenate(np.divmod(codes, self._node.size))]
        return both[both >= 0]

    def _islands_hit(self, tried: Attempt, label: Index, of: Bools) -> Bools:
        """Mark the islands, among those in `of` (islands,), that run into contacts or limits left out of the move."""
        out, joints, (hit, _) = np.zeros_like(of), self.whole.dynamics.joints, missed_impacts(self.whole, tried)
        slots = joints.limits[-1 - hit[hit < 0]]
        out[label[self._of_codes(hit[hit >= 0])]] = out[label[joints.block[slots]]] = True
        return out & of

    def _open_events(self, begin: SceneState, a: Attempt, label: Index, opened: Bools, large: Bools) -> None:
        """Mark in `opened` the islands for which an attempt does not hold: they meet an event or need another solve.

        In `large` islands (islands,) ends of slip do not count.
        """
        s, d = self.whole, self.whole.dynamics
        c, found, limits = a.kin.contacts, a.moved.contacts, a.moved.limits
        out = [self._nodes(found, found.gap < -s.gap_tol), d.joints.block[d.joints.limits[limits < -s.gap_tol]]]
        if (ends := ending(a.kin, a.problem, a.solution, s.solver.tol)) is not None:
            ends[: c.gap.size][large[label[s.nodes(c)]]] = False
            out.append(self._of_rows(a.kin, ends))
        if a.kin.joints is not None and (balls := a.kin.rows.balls).size:
            off = unbalanced(a.kin.rows, a.solution.r, a.solution.u, a.problem.scales)
            out.append(d.joints.block[a.kin.joints.slot[balls[off] - c.gap.size]])
        if not a.solution.converged:
            out.append(self._nodes(c))
        mid = a.mid
        if (struck := striking(s, a.kin, mid)) is not None:
            out.append(self._of_rows(a.kin, struck))
        limited = d.within_limits(a.mid.state, a.mid.forces, a.v)
        changed = [x is not y for x, y in zip(limited.trees, a.mid.forces.trees, strict=True)]
        out.append(d.free + np.flatnonzero(changed))
        opened[label[np.concatenate(out)]] = True
        # Bodies that pass through others unseen.
        fast = d.node[:-1][a.mid.reach > OPTIONS.unseen * s.smallest] if a.mid.fast else d.node[:0]
        if (fast < 0).any() or not opened[label[fast]].all():
            poses = begin.placement, mid.state.placement, a.moved.placement
            known = partial(tracked, s, begin.contacts, found)
            closed, pressed = take(begin.contacts, begin.contacts.gap <= s.gap_tol), take(c, a.normal_impulses > 0.0)
            turns = mid.turns(begin, a.moved)
            for (one, other), together, turn in zip(pairwise(poses), (closed, pressed), turns, strict=True):
                touches = s.touches(one, other, a.moved.memory, known, together, turn)
                opened[label[self._of_codes(np.concatenate((touches.codes, touches.far)))]] = True

    def _open_gaining(self, begin: SceneState, made: StepResult, tried: Attempt, label: Index, opened: Bools) -> None:
        """Mark in `opened` the islands that gain energy in the move `made`, or whose bodies turn far.

        Moved by themselves, these islands take the step in smaller pieces, as in `substepping`.
        """
        s, d, a, kin = self.whole, self.whole.dynamics, made.done[0], tried.kin
        opened[label[d.free :][list(made.strays)]] = True
        if not a.status.size:
            return
        island, count = label[s.nodes(a.contacts)], opened.size
        opened[island[tried.turns_far]] = True
        states, works = (a.status, kin.stays, kin.sticks), (a.work_normal, a.work_friction)
        _checks.gained(island, states, works, a.contacts.restitution, both := np.zeros((2, count)))
        gained = both[0]
        if (gained > 0.0).any():
            energies, share = [], np.full(count, OPTIONS.gain)
            share[label[d.free :]] = OPTIONS.stray
            for v in (begin.v, s.dt * made.rate):
                linear, spin = v[: 6 * d.free].reshape(-1, 2, 3).swapaxes(0, 1)
                of_bodies = d.mass * (linear * linear).sum(axis=1) + np.einsum("ki,kij,kj->k", spin, d.J, spin)
                energies.append(np.bincount(label[: d.free], 0.5 * of_bodies, count))
            of_trees = np.bincount(label[d.free :], tried.mid.at_play(begin.energies), count)
            opened |= gained > share * (np.maximum(*energies) + of_trees)

    def _of_nodes(self, a: Attempt, left: Bools, next_key: int) -> Attempt:
        """Return the part of an attempt that concerns the nodes `left`; new contacts get keys from `next_key` on."""
        s, d = self.whole, self.whole.dynamics
        # A distant contact between two islands belongs to neither.
        stays = np.append(left, True)[d.node]
        kept, there = (stays[c.frame1] & stays[c.frame2] for c in (a.kin.contacts, a.moved.contacts))
        if a.kin.joints is not None:
            kept = np.concatenate((kept, left[d.joints.block[a.kin.joints.slot]]))
        limits = a.moved.limits
        if limits.size:
            limits = np.where(left[d.joints.block[d.joints.limits]], limits, np.inf)
        contacts = take(a.moved.contacts, there)
        rows, blocks = np.repeat(kept, 3), a.kin.rows.blocks
        problem = FC3D.from_blocks(blocks.of(kept), a.problem.q[rows], a.problem.mu[kept], a.problem.scales[kept])
        r, *_, count, time = a.solution
        solution = Solution.judge(problem, r[rows], s.solver.tol, count, time, Status.LOOSE)
        turned = a.couple
        if turned.dv.size:
            of_contacts = kept[: a.kin.contacts.gap.size]
            turned = turned._replace(impulse=turned.impulse[of_contacts], work=turned.work[of_contacts])
        return a._replace(
            couple=turned,
            kin=a.kin.take(kept),
            captured=None,
            problem=problem,
            solution=solution,
            moved=a.moved._replace(contacts=contacts, limits=limits, memory=a.moved.memory._replace(next_key=next_key)),
        )
