"""Scenes of discs, whose distances are known, for networks that look at the table."""

import math

import numpy as np
import torch
from configs import real_config
from torch import Tensor

from sdfgcn.task.camera import camera_model
from sdfgcn.task.scene import Scene

SIZE = 96  # pixels


def discs(*objects: tuple[float, float, float], rows: int = 0) -> Scene:
    """One scene [1] of discs (x, y, radius), metres, drawn on the plane that pixels stand for."""
    env = real_config().env
    arena, height = env.arena, env.push.plane_height
    camera = camera_model(arena)
    u, v = np.meshgrid(np.arange(SIZE) + 0.5, np.arange(SIZE) + 0.5)
    world = camera.back_project(np.stack([u, v], axis=-1), height)
    scale = camera.project_scaled(world)[1]
    n = max(rows, len(objects))
    scene = Scene(
        sdf=torch.zeros(1, n, SIZE, SIZE),
        node_mask=torch.arange(n)[None] < len(objects),
        center=torch.zeros(1, n, 2),
        position=torch.zeros(1, n, 2),
        batch_size=[1],
    )
    for row, (x, y, radius) in enumerate(objects):
        far = np.hypot(world[..., 0] - x, world[..., 1] - y) - radius
        scene.sdf[0, row] = torch.from_numpy(far * scale)
        scene.center[0, row] = torch.tensor([x, y])
    return scene


def turned(points: Tensor, angle: float) -> Tensor:
    """Points [..., 2] turned about the origin by `angle` radians."""
    cos, sin = math.cos(angle), math.sin(angle)
    return points @ torch.tensor([[cos, sin], [-sin, cos]])
