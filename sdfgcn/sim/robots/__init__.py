"""Robots that execute the push: one registry entry per option of the config group `robot`."""

from sdfgcn.sim.robots.gripper import FloatingGripper
from sdfgcn.sim.robots.robot import Robot, Unreachable
from sdfgcn.sim.robots.ur5e import UR5e

ROBOTS: dict[str, type[Robot]] = {"ur5e": UR5e, "gripper": FloatingGripper}

__all__ = ["ROBOTS", "Robot", "Unreachable"]
