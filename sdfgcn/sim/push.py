"""The push primitive: approach, descend, straight push, lift, home (paper section IV c)."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable

import mujoco
import numpy as np
from dm_control import mjcf
from numpy.typing import NDArray

from sdfgcn.config import ArenaConfig, PushConfig
from sdfgcn.sim.robots.robot import Robot, Unreachable
from sdfgcn.sim.tape import Tape
from sdfgcn.task.region import Region
from sdfgcn.task.world import PushCommand, PushResult

NEGLIGIBLE = 0.1  # drive acceleration (rad/s2 or m/s2) below which feed-forward is skipped


class PushPrimitive:
    """Executes single pushes in the simulation."""

    def __init__(self, config: PushConfig, arena: ArenaConfig, robot: Robot):
        """Set up the primitive for a robot; the arena's `reach` bounds the tool."""
        self._config = config
        self._reach = Region.reach(arena)
        self._robot = robot
        self._tape: Tape | None = None

    def execute(
        self, physics: mjcf.Physics, command: PushCommand, tape: Tape | None = None
    ) -> PushResult:
        """Push, and leave the robot at home; props may still be moving.

        The robot jumps across the free space above the props, because simulating that motion
        would only cost time. Descent, push and lift are simulated, except that a robot with
        `teleports` is placed at the start directly. A descent that would touch a prop is not
        attempted; one that touches a prop unexpectedly is aborted. Both return "blocked".

        Args:
            physics: Stepped in place.
            command: The push; a start that is NaN or out of bounds is unreachable.
            tape: Notes how the robot and the props move, if given.
        """
        self._tape = tape
        config = self._config
        ahead = np.array([np.cos(command.angle), np.sin(command.angle)])
        start = np.array([*command.start, config.height])
        if not self._reach.contains(command.start):
            return PushResult("unreachable", start, start)
        above = np.array([*start[:2], config.height + config.approach])
        furthest = self._room(command.start, ahead, command.free + 2.0 * config.length)
        end = start + furthest * np.array([*ahead, 0.0])
        # The fingers lie side by side across the push; the gripper is symmetric under a half turn.
        yaw = command.angle % np.pi - np.pi / 2
        try:
            q_above = self._robot.solve(np.array([*above, yaw]))
            descent = _Path(self._robot, yaw, above, start, q_above, config.waypoint_spacing)
            push = _Path(self._robot, yaw, start, end, descent.joints[-1], config.waypoint_spacing)
        except Unreachable:
            return PushResult("unreachable", start, start)

        free = self._free(physics, descent)
        self._show_jump(physics, descent.joints if self._robot.teleports and free else [q_above])
        if not free or not self._descend(physics, descent):
            self._robot.place(physics, self._robot.home)
            return PushResult("blocked", start, start)
        reached, touched = self._push(physics, push, command.free)
        self._lift(physics, yaw, push, reached)
        return PushResult("done" if touched else "no_contact", start, push.at(reached)[0])

    def _free(self, physics: mjcf.Physics, path: _Path) -> bool:
        """Whether the robot can follow a path without touching a prop.

        The robot is placed at every other waypoint without stepping the simulation. Whatever the
        tool passes in between, its shaft touches further down.
        """
        model, data = physics.model.ptr, physics.data.ptr
        for joints in path.joints[::-2]:
            self._robot.place(physics, joints)
            mujoco.mj_kinematics(model, data)
            mujoco.mj_collision(model, data)
            if self._touches(data):
                return False
        return True

    def _show_jump(self, physics: mjcf.Physics, joints: Iterable[NDArray]) -> None:
        """Note postures that the robot passes without being simulated; it is placed after that."""
        if self._tape is not None:
            for posture in joints:
                self._robot.place(physics, posture)
                self._tape.note(physics.data.ptr)

    def _descend(self, physics: mjcf.Physics, path: _Path) -> bool:
        """Lower the tool along a free path; return whether it touched nothing."""
        if self._robot.teleports:
            self._robot.place(physics, path.joints[-1])
            return True
        self._robot.place(physics, path.joints[0])
        speed = self._config.descent_speed
        return not self._follow(physics, path, speed, until_touch=True)[1]

    def _touches(self, data: mujoco.MjData) -> bool:
        """Whether a prop is in contact with the robot."""
        return bool(data.ncon) and bool(self._robot.owns_geom[data.contact.geom].any())

    def _push(self, physics: mjcf.Physics, path: _Path, free: float) -> tuple[float, bool]:
        """Push by `length`, counted from where `length_from` says; return (reached, touched).

        Without a touch, a length that counts from there counts from the surface in the picture,
        `free` metres ahead.
        """
        config = self._config
        expected = config.length + (0.0 if config.length_from == "start" else free)
        reached, touched = self._follow(
            physics, path, config.speed, until=expected, until_touch=True
        )
        if touched:
            stop = reached + config.length if config.length_from == "touch" else expected
            reached, _ = self._follow(
                physics,
                path,
                config.speed,
                origin=reached,
                until=stop,
                from_rest=False,
                gently=True,
            )
        return reached, touched

    def _lift(self, physics: mjcf.Physics, yaw: float, push: _Path, reached: float) -> None:
        """Retreat slightly, rise straight to the approach height, then go home.

        Without the retreat, the rising tool would drag the prop's edge up and throw it.
        """
        config = self._config
        away, _ = self._follow(
            physics,
            push,
            config.descent_speed,
            origin=reached,
            until=max(0.0, reached - config.retreat),
        )
        bottom, joints = push.at(away)
        top = np.array([*bottom[:2], config.height + config.approach])
        # If the rise is out of reach, the arm goes home from where it is.
        with contextlib.suppress(Unreachable):
            rise = _Path(self._robot, yaw, bottom, top, joints, config.approach)
            self._follow(physics, rise, config.lift_speed, to_rest=False)
        self._robot.place(physics, self._robot.home)

    def _follow(
        self,
        physics: mjcf.Physics,
        path: _Path,
        speed: float,
        *,
        origin: float = 0.0,
        until: float = np.inf,
        until_touch: bool = False,
        from_rest: bool = True,
        to_rest: bool = True,
        gently: bool = False,
    ) -> tuple[float, bool]:
        """Drive the tool along a path.

        Args:
            physics: Stepped in place.
            path: The path to follow.
            speed: Metres per second.
            origin: Start, metres along the path.
            until: End, metres along the path; may lie before `origin`.
            until_touch: Stop as soon as a prop touches the robot.
            from_rest: Whether the tool starts at rest rather than at `speed`.
            to_rest: Whether it ends at rest.
            gently: Use the acceleration of a push rather than the maximum of the robot.

        Returns:
            Metres along the path that the tool was commanded to, and whether a touch stopped it.
        """
        # When no touch needs detecting, half the command rate suffices.
        tick = self._config.control_timestep * (1 if until_touch else 2)
        steps = round(tick / physics.model.opt.timestep)
        until = min(until, path.length)
        distance = until - origin
        acceleration = self._config.acceleration if gently else self._robot.acceleration
        way = ramped(abs(distance), speed, acceleration, tick, from_rest, to_rest)
        travelled = origin + np.copysign(way, distance)
        joints = path.joints_at(travelled)
        # Velocity and acceleration feed-forward compensates the lag of the drives.
        velocity = np.zeros_like(joints)
        velocity[1:-1] = (joints[2:] - joints[:-2]) / (2.0 * tick)
        if not from_rest:
            velocity[0] = (joints[1] - joints[0]) / tick
        if not to_rest:
            velocity[-1] = (joints[-1] - joints[-2]) / tick
        control = (joints + self._robot.lead * velocity)[1:]
        changes = (velocity[1:] - velocity[:-1]) / tick
        if (np.abs(changes) > NEGLIGIBLE).any():
            control += self._robot.effort(physics, changes)
        model, data = physics.model.ptr, physics.data.ptr
        drives, commanded = self._robot.drive_ids, data.ctrl
        for k, reached in enumerate(travelled[1:]):
            commanded[drives] = control[k]
            mujoco.mj_step(model, data, steps)
            if self._tape is not None:
                self._tape.note(data)
            if until_touch and self._touches(data):
                return float(reached), True
        return float(until), False

    def _room(self, start: NDArray, ahead: NDArray, wanted: float) -> float:
        """How far (up to `wanted`) the tool can go along `ahead` within its bounds, metres."""
        with np.errstate(divide="ignore", invalid="ignore"):
            limits = np.where(ahead > 0, self._reach.high - start, self._reach.low - start) / ahead
        limits = np.where(np.abs(ahead) < 1e-9, np.inf, limits)
        return float(max(0.0, min(wanted, limits.min())))


def ramped(
    distance: float,
    speed: float,
    acceleration: float,
    tick: float,
    from_rest: bool = True,
    to_rest: bool = True,
) -> NDArray[np.float64]:
    """Trapezoidal motion profile: the distance travelled at each tick.

    Args:
        distance: Metres.
        speed: Peak speed, metres per second; lower if `distance` is too short to reach it.
        acceleration: Of the ramps, metres per second squared.
        tick: Seconds; the profile is stretched slightly to a whole number of ticks.
        from_rest: Whether to start at rest rather than at `speed`.
        to_rest: Whether to end at rest rather than at `speed`.

    Returns:
        [ticks + 1] metres, from 0 to `distance`.
    """
    if from_rest or to_rest:
        speed = min(speed, math.sqrt(2.0 * acceleration * distance / (from_rest + to_rest)))
    ramp = speed / acceleration  # seconds
    lost = 0.5 * speed * ramp  # metres lost in a ramp compared with the same time at full speed
    lasts = (distance + lost * (from_rest + to_rest)) / speed if speed > 0.0 else 0.0
    ticks = max(1, math.ceil(lasts / tick - 1e-9))
    time = lasts / ticks * np.arange(ticks + 1)
    way = speed * time - lost * from_rest
    if from_rest:
        way = np.where(time < ramp, 0.5 * acceleration * time**2, way)
    if to_rest:
        left = lasts - time
        way = np.where(left < ramp, distance - 0.5 * acceleration * left**2, way)
    return np.asarray(way, dtype=np.float64)


class _Path:
    """A straight tool path at fixed yaw: joints solved at waypoints, linear in between."""

    def __init__(self, robot: Robot, yaw: float, origin, target, q_origin: NDArray, spacing: float):
        self.length = float(np.linalg.norm(target - origin))
        self._origin, self._target = origin, target
        count = max(1, int(np.ceil(self.length / spacing)))
        share = np.arange(count + 1) / count
        self._spacing = self.length / count
        poses = np.full((count + 1, 4), yaw)
        poses[:, :3] = origin + (target - origin) * share[:, None]
        joints = [q_origin]
        for pose in poses[1:]:
            joints.append(robot.solve(pose, near=joints[-1]))
        self.joints = np.array(joints)

    def joints_at(self, travelled: NDArray) -> NDArray:
        """[T, drives] joint positions at [T] metres along the path."""
        place = travelled / max(self._spacing, 1e-9)
        before = np.minimum(place.astype(int), len(self.joints) - 2)
        here, there = self.joints[before], self.joints[before + 1]
        return here + (there - here) * (place - before)[:, None]

    def at(self, travelled: float) -> tuple[NDArray, NDArray]:
        """Tool position [3] and joint positions [drives], `travelled` metres along the path."""
        share = travelled / self.length if self.length > 0.0 else 0.0
        position = self._origin + (self._target - self._origin) * share
        return position, self.joints_at(np.array([travelled]))[0]
