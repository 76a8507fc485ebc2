"""The push primitive: approach, descend, straight push, lift, home (paper section IV c)."""

from __future__ import annotations

import mujoco
import numpy as np
from dm_control import mjcf
from numpy.typing import NDArray

from sdfgcn.config import N_DIRECTIONS, ArenaConfig, PushConfig
from sdfgcn.sim.robots import Robot, Unreachable
from sdfgcn.sim.types import PushCommand, PushStatus


def direction_angle(direction: int) -> float:
    """Angle of one of the 8 directions, radians counter-clockwise from the world's x axis."""
    return 2.0 * np.pi * direction / N_DIRECTIONS


def direction_vector(direction: int) -> NDArray[np.float64]:
    """Unit vector [2] of one of the 8 directions."""
    angle = direction_angle(direction)
    return np.array([np.cos(angle), np.sin(angle)])


class PushPrimitive:
    """Runs one push in the simulation."""

    def __init__(self, config: PushConfig, arena: ArenaConfig, robot: Robot):
        """Prepare the primitive.

        Args:
            config: Lengths in metres, speeds in metres per second.
            arena: Its `reach_x` and `reach_y` bound the tool.
            robot: The robot that executes it, already compiled.
        """
        self._config = config
        self._low = np.array([arena.reach_x[0], arena.reach_y[0]])
        self._high = np.array([arena.reach_x[1], arena.reach_y[1]])
        self._robot = robot
        self._force = np.zeros(6)

    def execute(
        self, physics: mjcf.Physics, command: PushCommand
    ) -> tuple[PushStatus, NDArray[np.float64], NDArray[np.float64]]:
        """Push, and leave the robot at home; props may still be moving.

        The robot crosses the free space above the props in one jump: nothing there can be
        touched, so simulating it would only cost time. Descent, push and lift are simulated.
        A descent that touches anything is given up.

        Args:
            physics: Stepped in place.
            command: What to push; a start that is NaN or outside the bounds is unreachable.

        Returns:
            How it ended, and the tool's [3] start and end in metres.
        """
        config = self._config
        ahead = direction_vector(command.direction)
        start = np.array([*command.start, config.height])
        if not ((command.start >= self._low) & (command.start <= self._high)).all():
            return "unreachable", start, start
        above = start + [0.0, 0.0, config.approach]
        furthest = self._room(command.start, ahead, command.free + 2.0 * config.length)
        end = start + furthest * np.array([*ahead, 0.0])
        # The fingers stand side by side across the push; half a turn more is the same gripper.
        yaw = direction_angle(command.direction) % np.pi - np.pi / 2
        try:
            q_above = self._robot.solve(np.array([*above, yaw]))
            descent = _Segment(self._robot, yaw, above, start, q_above, config.knot)
            push = _Segment(self._robot, yaw, start, end, descent.joints[-1], config.knot)
        except Unreachable:
            return "unreachable", start, start

        self._robot.place(physics, q_above)
        physics.forward()
        reached, blocked = self._follow(
            physics, descent, config.descent_speed, stop_at=config.blocked_force
        )
        status: PushStatus = "blocked"
        if not blocked:
            reached, touched = self._push(physics, push, command.free + config.length)
            status = "done" if touched else "no_contact"
        self._lift(physics, yaw, reached)
        return status, start, start if blocked else reached.position

    def _push(self, physics: mjcf.Physics, segment: _Segment, expected: float):
        """Push `length` past the first touch; `expected` metres if nothing is touched."""
        config = self._config
        free, touched = self._follow(physics, segment, config.speed, until=expected, stop_at=0.0)
        if not touched:
            return free, False
        stop = free.travelled + config.length
        reached, _ = self._follow(physics, segment, config.speed, origin=free, until=stop)
        return reached, True

    def _lift(self, physics: mjcf.Physics, yaw: float, bottom: _Waypoint) -> None:
        """Straight up to the approach height, then home."""
        config = self._config
        top = np.array([*bottom.position[:2], config.height + config.approach])
        try:
            rise = _Segment(self._robot, yaw, bottom.position, top, bottom.joints, config.approach)
            self._follow(physics, rise, config.lift_speed)
        except Unreachable:
            pass  # the arm leaves straight for home, as it does from the top otherwise
        self._robot.place(physics, self._robot.home)

    def _follow(
        self,
        physics: mjcf.Physics,
        segment: _Segment,
        speed: float,
        *,
        origin: _Waypoint | None = None,
        until: float = np.inf,
        stop_at: float | None = None,
    ) -> tuple[_Waypoint, bool]:
        """Drive along a segment. Returns where the tool was sent last and whether it touched.

        Args:
            physics: Stepped in place.
            segment: The path.
            speed: Metres per second.
            origin: Where on the segment to begin; its first point by default.
            until: Metres along the segment at which to end.
            stop_at: Stop once props press on the robot with more than this, newtons.
        """
        tick = self._config.control_timestep
        steps = round(tick / physics.timestep())
        here = origin or segment.at(0.0)
        goal = min(until, segment.length)
        while here.travelled < goal - 1e-9:
            there = segment.at(min(here.travelled + speed * tick, goal))
            velocity = (there.joints - here.joints) / tick
            self._robot.command(physics, there.joints, velocity)
            physics.step(nstep=steps)
            here = there
            if stop_at is not None and self._pressure(physics) > stop_at:
                return here, True
        return here, False

    def _pressure(self, physics: mjcf.Physics) -> float:
        """Sum of the normal forces of props on the robot, newtons."""
        contact = physics.data.contact
        if len(contact) == 0:
            return 0.0
        total = 0.0
        for i in np.flatnonzero(self._robot.owns_geom[contact.geom].any(axis=1)):
            mujoco.mj_contactForce(physics.model.ptr, physics.data.ptr, int(i), self._force)
            total += self._force[0]
        return total

    def _room(self, start: NDArray, ahead: NDArray, wanted: float) -> float:
        """How far the tool may go from `start` along `ahead` without leaving its bounds."""
        with np.errstate(divide="ignore", invalid="ignore"):
            limits = np.where(ahead > 0, self._high - start, self._low - start) / ahead
        limits = np.where(np.abs(ahead) < 1e-9, np.inf, limits)
        return float(max(0.0, min(wanted, limits.min())))


class _Waypoint:
    """A point on a segment: how far along it, where the tool is, and the joints for that."""

    def __init__(self, travelled: float, position: NDArray, joints: NDArray):
        self.travelled = travelled
        self.position = position
        self.joints = joints


class _Segment:
    """A straight tool path at one yaw, solved at knots; joints are linear in between."""

    def __init__(self, robot: Robot, yaw: float, origin, target, q_origin: NDArray, knot: float):
        self.length = float(np.linalg.norm(target - origin))
        self._origin, self._target = origin, target
        count = max(1, int(np.ceil(self.length / knot)))
        self._knots = np.linspace(0.0, self.length, count + 1)
        joints = [q_origin]
        for i in range(1, count + 1):
            position = origin + (target - origin) * (i / count)
            joints.append(robot.solve(np.array([*position, yaw]), near=joints[-1]))
        self.joints = np.array(joints)

    def at(self, travelled: float) -> _Waypoint:
        share = travelled / self.length if self.length > 0.0 else 0.0
        position = self._origin + (self._target - self._origin) * share
        joints = np.array([np.interp(travelled, self._knots, q) for q in self.joints.T])
        return _Waypoint(travelled, position, joints)
