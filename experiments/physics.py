"""A survey of the physics: the effects of random pushes over a whole catalogue.

    python experiments/physics.py                        2,000 pushes, scanned objects, gripper
    python experiments/physics.py env=table
    python experiments/physics.py robot=ur5e pushes=200
    python experiments/physics.py compare=60             the same pushes by both robots
    python experiments/physics.py timesteps=400          the same pushes with other time steps

Writes `physics_<env>_<objects>_<robot>.json`, or the same with `compare` or `timesteps` in
the robot's place.
"""

from __future__ import annotations

import os
import sys
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass
from typing import Any

os.environ.setdefault("MUJOCO_GL", "egl")

import mujoco
import numpy as np
from common import load, parse, run, save
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import ks_2samp
from tqdm import tqdm

from sdfgcn.envs.rearrangement import RearrangementEnv
from sdfgcn.provenance import provenance
from sdfgcn.sim.props import rolls

SPLITS = ("train", "test")
N_OBJECTS = (2, 3, 4, 5, 6)
PUSHES_PER_EPISODE = 20
TIPPED = 45.0  # degrees that an object's upright axis turns when it tips or rolls over
RISEN = 0.005  # m, what can roll has tipped if its centre is this much higher or lower than before
STEPS = ((0.005, 0.005), (0.002, 0.004), (0.001, 0.004))  # s, of the physics and between commands


@dataclass(frozen=True)
class Effect:
    """What one push did.

    Attributes:
        status: Of the push, see `PushResult`.
        own: Metres that the pushed object moved on the table.
        furthest: Metres that the furthest object moved.
        turned: Names of the objects that came to lie on another side, and whether they rolled
            there rather than tipped over.
        name: The object that moved furthest.
        below: Objects whose centre is below the table.
    """

    status: str
    own: float
    furthest: float
    turned: tuple[tuple[str, bool], ...]
    name: str
    below: int


def effect(env: RearrangementEnv, before: NDArray, rolling: Mapping[str, bool]) -> Effect:
    """Describe the env's last push.

    Args:
        env: Where it was done.
        before: [n, 7] poses in which it found the objects.
        rolling: Whether an object of this name can roll.
    """
    step, names = env.last_step, names_of(env)
    after = step.after.poses
    if not np.isfinite(after).all():
        raise SystemExit(f"NaN after push {step.index} of episode {env.episode_start.seed}")
    travel = np.linalg.norm((after - before)[:, :2], axis=1)
    over = np.flatnonzero(turn(before, after) > TIPPED)
    level = np.abs(after[:, 2] - before[:, 2]) < RISEN
    return Effect(
        status=step.push.result.status,
        own=float(travel[step.push.row]),  # with true masks, a row is an object's slot
        furthest=float(travel.max()),
        turned=tuple((names[i], rolling[names[i]] and bool(level[i])) for i in over),
        name=names[int(travel.argmax())],
        below=int((after[:, 2] < 0.0).sum()),
    )


def names_of(env: RearrangementEnv) -> list[str]:
    """Names of the episode's objects in slot order."""
    return [model.name for model in env.world.truth.objects]


def turn(before: NDArray, after: NDArray) -> NDArray[np.float64]:
    """[n] degrees by which the objects' upright axes turned between [n, 7] poses; yaw is none."""
    up = [
        Rotation.from_quat(poses[:, 3:], scalar_first=True).inv().apply([0.0, 0.0, 1.0])
        for poses in (before, after)
    ]
    return np.degrees(np.arccos(np.clip((up[0] * up[1]).sum(axis=1), -1.0, 1.0)))


def quantiles(metres: Sequence[float]) -> dict[str, float]:
    """Mean and quantiles in millimetres."""
    values = 1e3 * np.asarray(metres)
    shares = {"p10": 0.1, "median": 0.5, "p90": 0.9, "p99": 0.99, "max": 1.0}
    return {"mean": float(values.mean())} | {
        name: float(np.quantile(values, share)) for name, share in shares.items()
    }


def summary(effects: Sequence[Effect], length: float) -> dict[str, Any]:
    """What many pushes did; `length` is that of a push, metres."""
    done = [each.own for each in effects if each.status == "done"]
    tipped = [[name for name, rolled in each.turned if not rolled] for each in effects]
    rolled = [[name for name, rolled in each.turned if rolled] for each in effects]

    def share(events: Iterable[Any]) -> float:
        return sum(map(bool, events)) / len(effects)

    return {
        "pushes": len(effects),
        "status": dict(Counter(each.status for each in effects)),
        "pushed_object_mm": quantiles(done),
        "furthest_object_mm": quantiles([each.furthest for each in effects]),
        "moved_over_length_plus_40_mm": sum(each.furthest > length + 0.04 for each in effects),
        "share_tipped": share(tipped),
        "share_rolled_over": share(rolled),
        "tipped": _most(tipped),
        "rolled_over": _most(rolled),
        "below_table": sum(each.below for each in effects),
    }


def _most(names: Iterable[Sequence[str]]) -> dict[str, int]:
    return dict(Counter(name for some in names for name in some).most_common(10))


def survey(overrides: list[str], pushes: int) -> dict[str, Any]:
    """Push at random; measure how far objects move and whether they come to rest."""
    rng = np.random.default_rng(0)
    effects: list[Effect] = []
    crept, worst, creepers = [], [], Counter()
    quota = int(np.ceil(pushes / (len(SPLITS) * len(N_OBJECTS))))
    with tqdm(total=quota * len(SPLITS) * len(N_OBJECTS), unit="push") as bar:
        for split in SPLITS:
            config = load([*overrides, f"eval.split={split}"])
            with closing(RearrangementEnv(config.env)) as env:
                rolling = {model.name: rolls(model) for model in env.world.catalogue}
                for n in N_OBJECTS:
                    env.n_objects, done = n, True
                    for count in range(quota):
                        if done or count % PUSHES_PER_EPISODE == 0:
                            td = env.reset_episode(int(rng.integers(2**31)))
                            poses = env.episode_start.start.poses
                        legal = np.flatnonzero(td["action_mask"].numpy())
                        td["action"] = int(rng.choice(legal))
                        td = env.step(td)["next"].clone()
                        effects.append(effect(env, poses, rolling))
                        last = effects[-1]
                        worst.append((1e3 * last.furthest, split, n, last.name))
                        drift = creep(env)
                        crept.append(float(drift.max()))
                        creepers.update(np.array(names_of(env))[drift > 0.001].tolist())
                        poses, done = env.last_step.after.poses, bool(td["done"])
                        bar.update()
    return {
        **about(config),
        "n_objects": N_OBJECTS,
        "splits": SPLITS,
        **summary(effects, config.env.push.length),
        "worst": sorted(worst, reverse=True)[:10],
        "creep_in_1_s_mm": quantiles(crept),
        "crept_over_1_mm": sum(drift > 0.001 for drift in crept),
        "creepers": dict(creepers.most_common(10)),
    }


def about(config: Any) -> dict[str, Any]:
    """What a result was measured with."""
    env = config.env
    return {
        "env": env.name,
        "objects": env.objects.name,
        "robot": env.robot.name,
        "seed": 0,
        "push_length_mm": 1e3 * env.push.length,
        "length_from": env.push.length_from,
        **provenance(),
    }


def creep(env: RearrangementEnv) -> NDArray[np.float64]:
    """[n] metres that the objects' centres drift in one more second; restores the state."""
    physics, task = env.world.physics, env.world.task
    before = task.poses(physics)
    task.set_poses(physics, before, resting=False)  # awake: what sleeps does not creep
    mujoco.mj_step(physics.model.ptr, physics.data.ptr, round(1.0 / physics.timestep()))
    drift = np.linalg.norm((task.poses(physics) - before)[:, :3], axis=1)
    task.set_poses(physics, before)
    return drift


def timesteps(overrides: list[str], pushes: int) -> dict[str, Any]:
    """Do the same pushes from the same poses with several time steps, and compare what they did."""
    rng = np.random.default_rng(0)
    found: dict[tuple[float, float], list[Effect]] = {steps: [] for steps in STEPS}
    with ExitStack() as stack:
        configs = {
            (physics, control): load(
                [
                    *overrides,
                    f"env.physics.timestep={physics}",
                    f"env.push.control_timestep={control}",
                ]
            )
            for physics, control in STEPS
        }
        envs = {
            steps: stack.enter_context(closing(RearrangementEnv(config.env)))
            for steps, config in configs.items()
        }
        leader = envs[STEPS[0]]
        rolling = {model.name: rolls(model) for model in leader.world.catalogue}
        for count in tqdm(range(pushes), unit="push"):
            leader.n_objects = N_OBJECTS[count % len(N_OBJECTS)]
            legal = leader.reset_episode(int(rng.integers(2**31)))["action_mask"].numpy()
            state, action = leader.save_state(), int(rng.choice(np.flatnonzero(legal)))
            for steps, env in envs.items():
                td = env.restore_state(state)
                before = env.episode_start.start.poses
                td["action"] = action
                env.step(td)
                found[steps].append(effect(env, before, rolling))
    first = found[STEPS[0]]
    length = leader.config.push.length
    return {
        **about(configs[STEPS[0]]),
        "n_objects": N_OBJECTS,
        "steps": [
            {
                "timestep": physics,
                "control_timestep": control,
                **summary(effects, length),
                "against_the_first": against(effects, first),
            }
            for (physics, control), effects in found.items()
        ],
    }


def against(effects: Sequence[Effect], others: Sequence[Effect]) -> dict[str, Any]:
    """Compare the same pushes: push by push, and as distributions of the pushed objects' ways."""
    ways, other_ways = (
        [each.own for each in group if each.status == "done"] for group in (effects, others)
    )
    pairs = list(zip(effects, others, strict=True))
    return {
        "difference_mm": quantiles([abs(one.own - other.own) for one, other in pairs]),
        "same_status": sum(one.status == other.status for one, other in pairs) / len(pairs),
        "same_turned": sum(one.turned == other.turned for one, other in pairs) / len(pairs),
        "kolmogorov_smirnov_p": float(ks_2samp(ways, other_ways).pvalue),
    }


def compare(overrides: list[str], pushes: int) -> dict[str, Any]:
    """Compare the same pushes by the arm and by the floating gripper."""
    rng = np.random.default_rng(0)
    configs = {robot: load([*overrides, f"robot={robot}"]) for robot in ("ur5e", "gripper")}
    envs = {robot: RearrangementEnv(config.env) for robot, config in configs.items()}
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
        **about(configs["gripper"]),
        "robot": list(envs),
        "pushes": pushes,
        "mean_displacement_mm": {k: float(1e3 * np.mean(v)) for k, v in lengths.items()},
        "difference_mm": quantiles(distance),
        "angle_degrees": {
            "pairs": len(angle),
            "mean": float(np.mean(angle)),
            "median": float(np.median(angle)),
            "p90": float(np.quantile(angle, 0.9)),
        },
    }


def main() -> None:
    defaults = {"pushes": 2000, "compare": 0, "timesteps": 0}
    own, overrides, folder = parse(sys.argv[1:], defaults, __doc__ or "")
    if not any(override.startswith("robot=") for override in overrides):
        overrides.append("robot=gripper")
    if own["compare"]:
        overrides = [each for each in overrides if not each.startswith("robot=")]
        result, last = compare(overrides, own["compare"]), "compare"
    elif own["timesteps"]:
        result, last = timesteps(overrides, own["timesteps"]), "timesteps"
    else:
        result = survey(overrides, own["pushes"])
        last = result["robot"]
    save(folder, f"physics_{result['env']}_{result['objects']}_{last}", result)


if __name__ == "__main__":
    sys.exit(run(main))
