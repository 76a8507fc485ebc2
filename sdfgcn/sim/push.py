"""The push primitive: approach, descend, straight push, lift, home (paper section IV c)."""

from __future__ import annotations

import contextlib

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
        above = np.array([*start[:2], config.height + config.approach])
        furthest = self._room(command.start, ahead, command.free + 2.0 * config.length)
        end = start + furthest * np.array([*ahead, 0.0])
        # The fingers stand side by side across the push; half a turn more is the same gripper.
        yaw = direction_angle(command.direction) % np.pi - np.pi / 2
        try:
            q_above = self._robot.solve(np.array([*above, yaw]))
            descent = _Path(self._robot, yaw, above, start, q_above, config.knot)
            push = _Path(self._robot, yaw, start, end, descent.joints[-1], config.knot)
        except Unreachable:
            return "unreachable", start, start

        self._robot.place(physics, q_above)
        physics.forward()
        _, blocked = self._follow(
            physics, descent, config.descent_speed, stop_at=config.blocked_force
        )
        if blocked:
            # The way it came is free. Turning round takes the arm long enough to shift the prop.
            self._robot.place(physics, self._robot.home)
            return "blocked", start, start
        reached, touched = self._push(physics, push, command.free + config.length)
        position, joints = push.at(reached)
        self._hold(physics, joints)
        self._lift(physics, yaw, position, joints)
        return ("done" if touched else "no_contact"), start, position

    def _push(self, physics: mjcf.Physics, path: _Path, expected: float) -> tuple[float, bool]:
        """Push `length` past the first touch, or `expected` metres. Returns (reached, touched)."""
        config = self._config
        reached, touched = self._follow(physics, path, config.speed, until=expected, stop_at=0.0)
        if touched:
            stop = reached + config.length if config.touch else expected
            reached, _ = self._follow(physics, path, config.speed, origin=reached, until=stop)
        return reached, touched

    def _hold(self, physics: mjcf.Physics, joints: NDArray) -> None:
        """Stand still: rising while it still presses, the tool would throw the prop."""
        physics.data.ctrl[self._robot.drive_ids] = joints
        steps = round(self._config.hold / physics.timestep())
        mujoco.mj_step(physics.model.ptr, physics.data.ptr, steps)

    def _lift(self, physics: mjcf.Physics, yaw: float, bottom: NDArray, joints: NDArray) -> None:
        """Straight up to the approach height, then home."""
        config = self._config
        top = np.array([*bottom[:2], config.height + config.approach])
        # Out of reach half-way up, the arm leaves for home from where it is.
        with contextlib.suppress(Unreachable):
            rise = _Path(self._robot, yaw, bottom, top, joints, config.approach)
            self._follow(physics, rise, config.lift_speed)
        self._robot.place(physics, self._robot.home)

    def _follow(
        self,
        physics: mjcf.Physics,
        path: _Path,
        speed: float,
        *,
        origin: float = 0.0,
        until: float = np.inf,
        stop_at: float | None = None,
    ) -> tuple[float, bool]:
        """Drive the tool along a path.

        Args:
            physics: Stepped in place.
            path: Where to go.
            speed: Metres per second.
            origin: Metres along the path at which to begin.
            until: Metres along the path at which to end.
            stop_at: Stop once props press on the robot with more than this, newtons.

        Returns:
            How far along the path the tool was sent, and whether it was stopped.
        """
        # Where no touch has to be noticed, every other command is enough.
        tick = self._config.control_timestep * (2 if stop_at is None else 1)
        steps = round(tick / physics.timestep())
        until = min(until, path.length)
        ticks = max(1, int(np.ceil((until - origin) / (speed * tick) - 1e-9)))
        travelled = np.linspace(origin, until, ticks + 1)
        joints = path.joints_at(travelled)
        # The velocity feed-forward takes out the lag of the drives.
        control = joints[1:] + self._robot.lead * np.diff(joints, axis=0) / tick
        # Without it at the end the tool comes to rest there and does not shoot past.
        brake = min(ticks, round(self._config.brake / tick))
        control[ticks - brake :] = joints[ticks + 1 - brake :]
        model, data, drives = physics.model.ptr, physics.data.ptr, self._robot.drive_ids
        for reached, command in zip(travelled[1:], control, strict=True):
            data.ctrl[drives] = command
            mujoco.mj_step(model, data, steps)
            if stop_at is not None and data.ncon and self._pressure(model, data) > stop_at:
                return float(reached), True
        return float(until), False

    def _pressure(self, model: mujoco.MjModel, data: mujoco.MjData) -> float:
        """Sum of the normal forces of props on the robot, newtons."""
        total = 0.0
        for i in np.flatnonzero(self._robot.owns_geom[data.contact.geom].any(axis=1)):
            mujoco.mj_contactForce(model, data, int(i), self._force)
            total += self._force[0]
        return total

    def _room(self, start: NDArray, ahead: NDArray, wanted: float) -> float:
        """How far the tool may go from `start` along `ahead` without leaving its bounds."""
        with np.errstate(divide="ignore", invalid="ignore"):
            limits = np.where(ahead > 0, self._high - start, self._low - start) / ahead
        limits = np.where(np.abs(ahead) < 1e-9, np.inf, limits)
        return float(max(0.0, min(wanted, limits.min())))


class _Path:
    """A straight tool path at one yaw, solved at knots; joints are linear in between."""

    def __init__(self, robot: Robot, yaw: float, origin, target, q_origin: NDArray, knot: float):
        self.length = float(np.linalg.norm(target - origin))
        self._origin, self._target = origin, target
        count = max(1, int(np.ceil(self.length / knot)))
        self._knots = np.linspace(0.0, self.length, count + 1)
        joints = [q_origin]
        for share in np.linspace(0.0, 1.0, count + 1)[1:]:
            position = origin + (target - origin) * share
            joints.append(robot.solve(np.array([*position, yaw]), near=joints[-1]))
        self.joints = np.array(joints)

    def joints_at(self, travelled: NDArray) -> NDArray:
        """[T, drives] joint positions at [T] metres along the path."""
        return np.stack([np.interp(travelled, self._knots, q) for q in self.joints.T], axis=-1)

    def at(self, travelled: float) -> tuple[NDArray, NDArray]:
        """Tool position [3] and joint positions, `travelled` metres along the path."""
        share = travelled / self.length if self.length > 0.0 else 0.0
        position = self._origin + (self._target - self._origin) * share
        return position, self.joints_at(np.array([travelled]))[0]
