"""What a config may say: types, ranges, and settings that would have no effect."""

import subprocess
import sys

import pytest
from configs import real_config

from sdfgcn.cli import to_sentence


def refusal(*overrides: str) -> str:
    with pytest.raises(Exception) as raised:
        real_config(*overrides)
    sentence = to_sentence(raised.value)
    assert sentence is not None
    assert "\n" not in sentence
    return sentence


@pytest.mark.parametrize(
    ("override", "told"),
    [
        ("seed=abc", "seed: Value 'abc' of type 'str' could not be converted to Integer."),
        ("env.arena.spawn_x=3", "env.arena.spawn_x: must be a list."),
        ("+more=1", "There is no key 'more'; `--cfg job` prints all keys."),
        (
            "+env.robot.stiffness=1",
            "There is no key 'env.robot.stiffness'; it belongs to another option of its group.",
        ),
        ("env.robot.name=claw", "env.robot.name is 'claw', but must be one of gripper, ur5e."),
        (
            "env.robot=gripper",
            "env.robot is 'gripper', but holds the keys of a component; pick one with robot=... "
            "instead.",
        ),
        ("seed=${gone}", "seed: Interpolation key 'gone' not found."),
    ],
)
def test_keys_and_types(override: str, told: str) -> None:
    assert refusal(override) == told


@pytest.mark.parametrize(
    ("override", "told"),
    [
        ("n_objects=0", "n_objects is 0, but must lie between 1 and 100."),
        ("n_objects=9", "n_objects is 9, but must lie between 1 and env.max_objects (8)."),
        ("env.robot.acceleration=0", "env.robot.acceleration is 0.0, but must lie between 0.01 "),
        (
            "train.env.robot.acceleration=0",
            "In train.env, env.robot.acceleration is 0.0, but must lie between 0.01 and 1000.",
        ),
        (
            "env.push.control_timestep=0.006",
            "env.push.control_timestep is 0.006, but must be a multiple of env.physics.timestep "
            "(0.005).",
        ),
        ("env.push.directions=7", "env.push.directions is 7, but must be an even number from 4"),
        ("env.push.directions=2", "env.push.directions is 2, but must be an even number from 4"),
        ("env.objects.density=0", "env.objects.density is 0.0, but must be above 0 and at most"),
        ("env.arena.spawn_x=[0,1]", "env.arena.spawn_x is [0.0, 1.0], but must lie within"),
        ("eval.baseline=sdfgcn", "eval.baseline is 'sdfgcn', but must be null or a model without"),
        ("eval.split=new", "env.split is 'new', but must be one of train, test."),
        ("env.split=train", "env.split is 'train' while eval.split is 'test'"),
        ("train.env.split=all", "In train.env, env.split is 'all', but must be one of train, test"),
        ("eval.episodes=0", "eval.episodes is 0, but must lie between 1 and 1000000."),
        ("eval.seed=-1", "eval.seed is -1, but must lie between 0 and 4294967295."),
        ("eval.epsilon=2", "eval.epsilon is 2.0, but must lie between 0 and 1."),
        ("eval.loop_distance=-1", "eval.loop_distance is -1.0, but must lie between 0 and 10."),
        ("runtime.workers=-1", "runtime.workers is -1, but must lie between 0 and 256."),
        ("runtime.device=tpu", "runtime.device is 'tpu', but must be cpu, cuda or cuda:NUMBER."),
        ("runtime.precision=int8", "runtime.precision is 'int8', but must be one of auto,"),
    ],
)
@pytest.mark.parametrize("model", ["released", "rule_based"])
def test_values_out_of_range(override: str, told: str, model: str) -> None:
    assert refusal(f"model={model}", override).startswith(told)


@pytest.mark.parametrize(
    ("override", "told"),
    [
        ("train.discount=1.5", "train.discount is 1.5, but must lie between 0 and 1."),
        ("budget.pushes=0", "budget.pushes is 0, but must lie between 1 and 1000000000."),
        ("train.replay_capacity=9", "train.batch_size is 32, but must not be above train.re"),
        ("train.ema_decay=1", "train.ema_decay is 1.0, but must be at least 0"),
        ("train.max_utd_ratio=0.1", "train.utd_ratio is 0.12, but must not be above train.max_"),
        ("train.eval_pushes=0", "train.eval_pushes is 0, but must lie between 1 and 1000000000."),
        ("train.loss=l7", "train.loss is 'l7', but must be one of smooth_l1, l2."),
        ("collector.workers=0", "collector.workers is 0, but must lie between 1 and 256."),
    ],
)
def test_training_numbers_out_of_range(override: str, told: str) -> None:
    assert refusal("model=sdfgcn", override).startswith(told)


def test_a_count_of_the_curriculum_that_does_not_fit() -> None:
    told = refusal("model=sdfgcn", "curriculum=on", "curriculum.counts=[2,9]")
    assert told.startswith("curriculum.counts is [2, 9], but every count must lie between 1 and")


def test_a_curriculum_that_grows_needs_a_window() -> None:
    told = refusal("model=sdfgcn", "curriculum=on", "curriculum.window=0")
    assert told.startswith("curriculum.window is 0, but must be at least 1 with curriculum=on:")


def test_a_checkpoint_for_the_rule_is_refused() -> None:
    told = refusal("model=rule_based", "checkpoint=sdfgcn")
    assert told.startswith("checkpoint is 'sdfgcn', but model=rule_based has no weights to load;")


@pytest.mark.parametrize("curriculum", ["on", "random"])
@pytest.mark.parametrize(
    "untrained", [("model=released",), ("model=rule_based",), ("model=sdfgcn", "checkpoint=sdfgcn")]
)
def test_a_curriculum_without_training_is_refused(
    curriculum: str, untrained: tuple[str, ...]
) -> None:
    told = f"curriculum={curriculum} has no effect, as nothing is trained;"
    assert refusal(*untrained, f"curriculum={curriculum}").startswith(told)
    assert real_config("model=sdfgcn", f"curriculum={curriculum}").curriculum.name == curriculum


def test_a_gpu_must_be_there(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    for model in ("sdfgcn", "released"):
        told = refusal(f"model={model}", "runtime=gpu")
        assert told == "runtime.device is 'cuda', but torch sees no GPU here; use runtime=cpu."
    monkeypatch.setattr("torch.cuda.is_available", lambda: True)
    runtime = real_config("runtime=gpu").runtime
    assert (runtime.device, runtime.precision) == ("cuda", "bfloat16")
    monkeypatch.setattr("torch.cuda.device_count", lambda: 2)
    assert real_config("runtime.device=cuda:1").runtime.device == "cuda:1"
    told = refusal("runtime.device=cuda:2")
    assert told == "runtime.device is 'cuda:2', but the last GPU here is cuda:1."


# ------------------------------------------------------------------ the two envs


def test_the_training_env_is_the_other_but_for_its_own_keys() -> None:
    config = real_config(
        *("env.pixels=true", "env.push.length=0.05", "env.pushes_per_object=50", "n_objects=2")
    )
    env, train = config.env, config.train.env
    assert (env.split, env.pushes_per_object, env.pixels, env.robot.name) == (
        *("test", 50, True, "ur5e"),
    )
    assert (train.split, train.pushes_per_object, train.pixels, train.robot.name) == (
        *("train", 33, False, "gripper"),
    )
    assert (train.push, train.n_objects, train.objects) == (env.push, 2, env.objects)


def test_keys_and_components_of_the_training_env() -> None:
    config = real_config(
        *("robot=gripper", "env.robot.lead=0.03", "robot@train.env.robot=ur5e"),
        *("train.env.robot.ik_steps=50", "+train.env.push.length=0.05"),
    )
    assert (config.env.robot.name, config.env.robot.lead) == ("gripper", 0.03)
    robot = config.train.env.robot
    assert (robot.name, robot.ik_steps, robot.lead) == ("ur5e", 50, 0.2)  # type: ignore[attr-defined]
    assert (config.env.push.length, config.train.env.push.length) == (0.06, 0.05)


def test_most_mistakes_are_told_before_anything_heavy_is_imported() -> None:
    code = """
import sys
import sdfgcn
for override in ("eval.epsilon=2", "env.push.speed=-1", "n_objects=three"):
    try:
        sdfgcn.load_config(override)
    except Exception as error:
        print(type(error).__name__)
print({"torch", "mujoco"} & set(sys.modules))
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    lines = done.stdout.splitlines()
    assert lines == ["SdfgcnError", "SdfgcnError", "ValidationError", "set()"], done.stderr
