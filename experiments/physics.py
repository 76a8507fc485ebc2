"""A survey of the physics: the effects of random pushes over a whole catalogue.

    python experiments/physics.py                        2,000 pushes, scanned objects, gripper
    python experiments/physics.py robot=ur5e pushes=200
    python experiments/physics.py compare=60             the same pushes by both robots

Writes `results/physics_<objects>_<robot>.json` or `results/physics_compare.json`.
"""

from __future__ import annotations

import os
import sys
from collections import Counter
from typing import Any

os.environ.setdefault("MUJOCO_GL", "egl")

import mujoco
import numpy as np
from common import load, parse, save
from tqdm import tqdm

from sdfgcn.envs.rearrangement import RearrangementEnv

N_OBJECTS = (2, 3, 4, 5, 6)
PUSHES_PER_EPISODE = 20


def survey(overrides: list[str], pushes: int) -> dict[str, Any]:
    """Push at random; measure how far objects move and whether they come to rest."""
    rng = np.random.default_rng(0)
    moved, worst, crept, sunk = [], [], [], 0
    status: Counter[str] = Counter()
    kinds = [(split, n) for split in ("train", "test") for n in N_OBJECTS]
    quota = int(np.ceil(pushes / len(kinds)))
    with tqdm(total=quota * len(kinds), unit="push") as bar:
        for split, n in kinds:
            config = load([*overrides, f"n_objects={n}", f"eval.split={split}"])
            env = RearrangementEnv(config.env)
            done, count = True, 0
            while count < quota:
                if done or count % PUSHES_PER_EPISODE == 0:
                    td = env.reset_episode(int(rng.integers(2**31)))
                    poses = env.episode_start.start.poses
                legal = np.flatnonzero(td["action_mask"].numpy())
                td["action"] = int(rng.choice(legal))
                td = env.step(td)["next"]
                step = env.last_step
                after = step.after.poses
                if not np.isfinite(after).all():
                    raise SystemExit(f"NaN after push {count} of {split} n={n}")
                travel = np.linalg.norm((after - poses)[:, :2], axis=1)
                moved += [float(travel.max())]
                names = [model.name for model in env.world.truth.objects]
                worst.append((float(travel.max()), split, n, names[int(travel.argmax())]))
                crept.append(creep(env))
                sunk += int((after[:, 2] < 0.0).sum())
                status[step.push.result.status] += 1
                poses, done = after, bool(td["done"])
                td = td.clone()
                count += 1
                bar.update()
            env.close()
    limit = config.env.push.length + 0.04
    travel = np.array(moved)
    return {
        "objects": config.env.objects.name,
        "robot": config.env.robot.name,
        "pushes": len(moved),
        "n_objects": N_OBJECTS,
        "splits": ["train", "test"],
        "seed": 0,
        "push_length_mm": 1e3 * config.env.push.length,
        "status": dict(status),
        "largest_move_mm": {
            "mean": float(1e3 * travel.mean()),
            "median": float(1e3 * np.median(travel)),
            "p99": float(1e3 * np.quantile(travel, 0.99)),
            "max": float(1e3 * travel.max()),
        },
        "moved_over_length_plus_40_mm": int((travel > limit).sum()),
        "worst": sorted(worst, reverse=True)[:10],
        "below_table": sunk,
        "creep_in_1_s_mm": {
            "p99": float(1e3 * np.quantile(crept, 0.99)),
            "max": float(1e3 * np.max(crept)),
        },
    }


def creep(env: RearrangementEnv) -> float:
    """Largest drift of an object's centre in one more second, metres; restores the state."""
    physics, task = env.world.physics, env.world.task
    before = task.poses(physics)
    task.set_poses(physics, before, resting=False)  # awake: what sleeps does not creep
    mujoco.mj_step(physics.model.ptr, physics.data.ptr, round(1.0 / physics.timestep()))
    drift = float(np.linalg.norm((task.poses(physics) - before)[:, :3], axis=1).max())
    task.set_poses(physics, before)
    return drift


def compare(overrides: list[str], pushes: int) -> dict[str, Any]:
    """Compare the same pushes by the arm and by the floating gripper."""
    rng = np.random.default_rng(0)
    envs = {
        robot: RearrangementEnv(load([*overrides, f"robot={robot}"]).env)
        for robot in ("ur5e", "gripper")
    }
    distance, angle, lengths = [], [], {robot: [] for robot in envs}
    with tqdm(total=pushes, unit="push") as bar:
        while len(distance) < pushes:
            seed = int(rng.integers(2**31))
            start = {robot: env.reset_episode(seed) for robot, env in envs.items()}
            legal = np.flatnonzero(start["ur5e"]["action_mask"].numpy())
            action = int(rng.choice(legal))
            row, _ = envs["ur5e"].push_space.decode(action)  # with the oracle, the object's slot
            move = {}
            for robot, env in envs.items():
                before = env.episode_start.start.poses[row, :2]
                start[robot]["action"] = action
                env.step(start[robot])
                move[robot] = env.last_step.after.poses[row, :2] - before
            arm, gripper = move["ur5e"], move["gripper"]
            for robot, offset in move.items():
                lengths[robot].append(float(np.linalg.norm(offset)))
            distance.append(float(np.linalg.norm(arm - gripper)))
            if min(np.linalg.norm(arm), np.linalg.norm(gripper)) > 0.01:
                cosine = arm @ gripper / (np.linalg.norm(arm) * np.linalg.norm(gripper))
                angle.append(float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))))
            bar.update()
    for env in envs.values():
        env.close()
    return {
        "pushes": pushes,
        "seed": 0,
        "mean_displacement_mm": {k: float(1e3 * np.mean(v)) for k, v in lengths.items()},
        "difference_mm": {
            "mean": float(1e3 * np.mean(distance)),
            "median": float(1e3 * np.median(distance)),
            "p90": float(1e3 * np.quantile(distance, 0.9)),
        },
        "angle_degrees": {
            "pairs": len(angle),
            "mean": float(np.mean(angle)),
            "median": float(np.median(angle)),
            "p90": float(np.quantile(angle, 0.9)),
        },
    }


def main() -> None:
    own, overrides = parse(sys.argv[1:], {"pushes": 2000, "compare": 0})
    if own["compare"]:
        save("physics_compare", compare(overrides, own["compare"]))
    else:
        if not any(override.startswith("robot=") for override in overrides):
            overrides.append("robot=gripper")
        result = survey(overrides, own["pushes"])
        save(f"physics_{result['objects']}_{result['robot']}", result)


if __name__ == "__main__":
    main()
