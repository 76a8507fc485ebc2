"""`python run.py`, as a user calls it."""

import contextlib
import csv
import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import pytest
from configs import compose_config, real_config
from hydra.errors import HydraException
from omegaconf import OmegaConf

from sdfgcn.cli import run_plainly, to_sentence, without_effect
from sdfgcn.errors import SdfgcnError
from sdfgcn.experiment import run_experiment
from sdfgcn.objects.catalogue import catalogue_folder, load_catalogue
from sdfgcn.run_folder import RunFolder

ROOT = Path(__file__).parents[1]
# What is tested here does not depend on the model; the rule's is the quickest to load.
SMALL = (
    *("model=rule_based", "objects=household", "robot=gripper", "n_objects=2"),
    "env.pushes_per_object=2",
)


@pytest.fixture(scope="module", autouse=True)
def household() -> None:
    """Build the cache outside the runs that are timed."""
    load_catalogue(real_config(*SMALL).env.objects, "test")


def start(*arguments: object, **env: str) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, ROOT / "run.py", *map(str, arguments)],
        env={**os.environ, **env},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # A shell starts what it puts in the background deaf to Ctrl-C, and children inherit that.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
        start_new_session=True,
    )


def run(*arguments: object, **env: str) -> subprocess.CompletedProcess:
    process = start(*arguments, **env)
    out, err = process.communicate(timeout=240)
    return subprocess.CompletedProcess(process.args, process.returncode, out, err)


def refusal(*arguments: object, **env: str) -> str:
    """The one line on stderr of a run that must not work, besides that of its folder."""
    done = run(*arguments, **env)
    assert done.returncode in (1, 2), done
    assert "Traceback" not in done.stdout + done.stderr
    (line,) = (line for line in done.stderr.splitlines() if not line.startswith("Run folder: "))
    return line


def status(folder: Path) -> dict:
    return json.loads((folder / "status.json").read_text())


def rows(folder: Path) -> list[dict]:
    with (folder / "episodes.csv").open() as file:
        return [row | {"wall_s": ""} for row in csv.DictReader(file)]


# ------------------------------------------------------------------ what works


@pytest.fixture(scope="module")
def sweep(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """Two jobs at once, one of them with workers of its own; its folder and stdout."""
    folder = tmp_path_factory.mktemp("sweep")
    done = run(
        *("-m", *SMALL, "eval.episodes=3", "viz.episodes=1", "runtime.workers=0,2"),
        *("hydra/launcher=joblib", "hydra.launcher.n_jobs=2", f"hydra.sweep.dir={folder}"),
    )
    assert done.returncode == 0, done.stderr
    return folder, done.stdout


@pytest.mark.parametrize("job", ["0", "1"])
def test_a_run_leaves_its_results(sweep: tuple[Path, str], job: str) -> None:
    folder, out = sweep[0] / job, sweep[1]
    assert f"Run folder: {folder}" in out
    assert "rule_based (paper, table II)  -         78%" in out
    *_, title, head, first, second, _, last = out.splitlines()  # the table of both runs
    assert title.startswith("Model rule_based, n objects 2, objects household, robot gripper")
    assert head.split() == ["runtime.workers", *head.split()[1:]]
    assert [line.split()[:2] for line in (first, second)] == [["0", "3"], ["2", "3"]]
    assert last == f"Sweep folder: {sweep[0]}"
    assert status(folder)["state"] == "done"
    assert OmegaConf.load(folder / "config.yaml").env.objects.name == "household"
    assert [path.name for path in (folder / "recordings").iterdir()] == ["episode_000.rrd"]
    results = json.loads((folder / "results.json").read_text())
    assert (results["episodes"], results["objects"], results["n_objects"]) == (3, "household", 2)
    assert results["success_rate"] == sum(row["success"] == "True" for row in rows(folder)) / 3


def test_the_default_evaluates_released_weights(tmp_path: Path) -> None:
    shrunk = ("objects=household", "env.pushes_per_object=2", "eval.episodes=1")
    done = run(*shrunk, "runtime.workers=0", f"hydra.run.dir={tmp_path}")
    assert done.returncode == 0, done.stderr
    assert "push_model (this run)" in done.stdout
    assert "rule_based (same scenes)" in done.stdout
    assert "rule_based (paper, table II)" in done.stdout
    assert not (tmp_path / "train.csv").exists()
    beside = json.loads((tmp_path / "baseline" / "results.json").read_text())
    assert (beside["model"], beside["checkpoint"]) == ("rule_based", None)
    results = json.loads((tmp_path / "results.json").read_text())
    assert (results["model"], results["checkpoint"], results["robot"]) == (
        *("push_model", "push_model", "ur5e"),
    )
    same = ("episode_seeds", "epsilon", "loop_distance", "perception")
    assert [results[key] for key in same] == [beside[key] for key in same]
    assert [path.name for path in (tmp_path / "recordings").iterdir()] == ["episode_000.rrd"]


def test_results_do_not_depend_on_workers(sweep: tuple[Path, str]) -> None:
    alone, shared = rows(sweep[0] / "0"), rows(sweep[0] / "1")
    assert alone == shared
    assert [row["episode"] for row in alone] == ["0", "1", "2"]
    assert len({row["seed"] for row in alone}) == 3


def test_goes_on_with_more_episodes(sweep: tuple[Path, str], tmp_path: Path) -> None:
    folder = shutil.copytree(sweep[0] / "0", tmp_path / "run")
    kept = rows(folder)
    more = (*SMALL, "eval.episodes=4", "runtime.workers=0", "viz=none", "logger=none")
    with RunFolder(folder, compose_config(*more)) as held:
        results = run_experiment(real_config(*more), held)
    assert results["episodes"] == len(rows(folder)) == 4
    assert rows(folder)[:3] == kept
    assert status(folder)["state"] == "done"


ASYNC = (
    *("model=gt_pose_gcn", "collector=async", "budget=smoke", "budget.pushes=5000"),
    *("budget.minutes=null", "collector.pushes_per_batch=5", "train.learning_starts=5"),
    *("train.batch_size=4", "train.log_pushes=5", "train.checkpoint_minutes=0.0001"),
)
SWEEP = ("eval.seed=1,2", "hydra/launcher=joblib", "hydra.launcher.n_jobs=2")


@pytest.mark.parametrize(
    ("more", "number", "whole_group", "awaited"),
    [
        (("runtime.workers=1",), signal.SIGINT, False, "episodes.csv"),
        (("runtime.workers=1",), signal.SIGTERM, True, "episodes.csv"),
        ((*ASYNC, "runtime.workers=0"), signal.SIGTERM, False, "checkpoint.zip"),
        ((*SWEEP, "runtime.workers=0"), signal.SIGTERM, False, "*/episodes.csv"),
    ],
    ids=["Ctrl-C", "evaluation", "training", "sweep"],
)
def test_a_stopped_run_keeps_what_is_done(
    more: tuple[str, ...], number: signal.Signals, whole_group: bool, awaited: str, tmp_path: Path
) -> None:
    """It ends soon, says so, and leaves no process behind."""
    where = ("-m", f"hydra.sweep.dir={tmp_path}")
    where = where if "eval.seed=1,2" in more else (f"hydra.run.dir={tmp_path}",)
    process = start(*where, *SMALL, "eval.episodes=5000", "viz=none", *more)
    deadline = time.monotonic() + 200
    while not list(tmp_path.glob(awaited)):
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.1)
    (os.killpg if whole_group else os.kill)(process.pid, number)
    _, err = process.communicate(timeout=100)  # too short for the episodes that were left
    assert process.returncode == 128 + number
    assert "Traceback" not in err
    first, *others = err.splitlines()  # Python may complain about what joblib's workers left
    assert first == f"{'Sweep' if '-m' in where else 'Run'} folder: {tmp_path}"
    reason = "Interrupted" if number is signal.SIGINT else "Stopped by SIGTERM"
    (last,) = (line for line in others if line.startswith(reason))
    again = shlex.split(last.removeprefix(f"{reason}; to go on: "))
    given = [str(word) for word in process.args[1:]]
    folder_last = sorted(given, key=lambda word: word == where[-1])
    assert again == ["python", *folder_last]
    folders = sorted(path.parent for path in tmp_path.rglob("status.json"))
    assert folders
    for folder in folders:
        left = status(folder)
        played = len(rows(folder)) if (folder / "episodes.csv").exists() else 0
        assert left["state"] == "stopped"
        assert played - 1 <= left["episodes"] <= played < 5000  # a sweep kills its jobs
        assert reason in left["error"]
        assert not (folder / "results.json").exists()
    while running := group(process.pid):
        assert time.monotonic() < deadline + 100, running
        time.sleep(0.1)


@pytest.mark.skipif(
    find_spec("hydra_plugins.hydra_submitit_launcher") is None, reason="not installed"
)
def test_a_preempted_job_goes_on(sweep: tuple[Path, str], tmp_path: Path) -> None:
    """Submitit starts it again, and it ends with the rows of a run that nobody disturbed."""
    process = start(
        *("-m", *SMALL, "eval.episodes=3", "viz=none", "runtime.workers=2", "eval.seed=0"),
        *("hydra/launcher=submitit_local", f"hydra.sweep.dir={tmp_path}"),
    )
    deadline = time.monotonic() + 200
    while not (tmp_path / "0" / "episodes.csv").exists():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.05)
    job = status(tmp_path / "0")["pid"]
    os.kill(job, signal.SIGUSR2)
    _, err = process.communicate(timeout=240)
    assert process.returncode == 0, err
    assert status(tmp_path / "0")["state"] == "done"
    assert status(tmp_path / "0")["pid"] != job
    assert rows(tmp_path / "0") == rows(sweep[0] / "0")
    (log,) = tmp_path.glob(".submitit/*/*.err")
    assert "this job is preempted" in log.read_text()


def group(leader: int) -> list[str]:
    """The processes of a group that are still running, as in /proc."""
    found = []
    for file in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):  # it has just ended
            stat = file.read_text()
            state, _, its_group = stat.rpartition(")")[2].split()[:3]
            found += [stat] if int(its_group) == leader and state != "Z" else []
    return found


# ------------------------------------------------------------------ what must not work


@pytest.mark.parametrize(
    ("overrides", "told"),
    [
        (["objects=rocks"], "There is no objects=rocks: objects can be household, scanned"),
        (["n_objectz=3"], "There is no key 'n_objectz'; did you mean n_objects?"),
        (["scenario.spacing=1"], "There is no key 'scenario.spacing'; did you mean env.scenario."),
        (["episodes=4"], "did you mean eval.episodes or viz.episodes?"),
        (["env.qqq=3"], "There is no key 'env.qqq'; `--cfg job` prints all keys."),
        (["her=past"], "There is no her=past: her can be future, next, off."),
        (["seed=[1"], "Cannot read the override 'seed=[1': no viable alternative"),
        (["seed"], "Cannot read the override 'seed': missing EQUAL"),
    ],
)
def test_hydra_errors_in_one_sentence(overrides: list[str], told: str) -> None:
    with pytest.raises(HydraException) as raised:
        compose_config(*overrides)
    sentence = to_sentence(raised.value)
    assert sentence is not None
    assert sentence.startswith(told) or sentence.endswith(told)
    assert "\n" not in sentence


@pytest.mark.parametrize(
    ("overrides", "idle"),
    [
        (["model=rule_based", "budget=smoke", "n_objects=2"], "budget=smoke"),
        (["train.batch_size=8", "robot@train.env.robot=ur5e"], "train.batch_size=8, robot@train."),
        (["model=sdfgcn", "checkpoint=sdfgcn", "train.env.pixels=true"], "train.env.pixels=true"),
        (["model=sdfgcn", "budget=smoke"], None),
        (["eval=greedy", "runtime.workers=0"], None),
    ],
)
def test_what_has_no_effect_is_said(overrides: list[str], idle: str | None) -> None:
    told = without_effect(real_config(*overrides), overrides)
    if idle is None:
        assert told is None
    else:
        assert told is not None
        assert told.startswith(f"Without effect, as nothing is trained: {idle}")


def test_ctrl_c_behind_another_error(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HYDRA_FULL_ERROR", "0")  # put back afterwards: the command sets it

    def main() -> None:
        try:
            raise KeyboardInterrupt
        finally:
            raise SdfgcnError("what its clean-up ran into")

    with pytest.raises(SystemExit) as ended:
        run_plainly(main)
    assert ended.value.code == 130
    assert capsys.readouterr().err.startswith("Interrupted")


def test_an_error_of_ours_keeps_its_traceback() -> None:
    assert to_sentence(KeyError("x")) is None
    assert to_sentence(OSError("the network is down")) is None


def test_a_value_out_of_range_fails_the_run(tmp_path: Path) -> None:
    told = "n_objects is 9, but must lie between 1 and env.max_objects (8)."
    assert refusal("n_objects=9", f"hydra.run.dir={tmp_path}") == told
    assert (status(tmp_path)["state"], status(tmp_path)["error"]) == ("failed", told)
    assert {path.name for path in tmp_path.glob("[!.]*")} == {
        *("config.yaml", "run.log", "status.json"),
    }
    traced = run("n_objects=9", f"hydra.run.dir={tmp_path}", HYDRA_FULL_ERROR="1")
    assert traced.returncode == 1
    assert "Traceback" in traced.stderr


def test_a_sweep_tells_every_job_that_fails(tmp_path: Path) -> None:
    done = run("-m", "n_objects=9,10", f"hydra.sweep.dir={tmp_path}")
    assert done.returncode == 1
    assert done.stderr == (
        f"Sweep folder: {tmp_path}\n"
        "n_objects is 9, but must lie between 1 and env.max_objects (8).\n"
    )
    assert "n_objects=9 failed: n_objects is 9" in done.stdout
    assert "n_objects=10 failed: n_objects is 10" in done.stdout
    assert [status(tmp_path / job)["state"] for job in "01"] == ["failed"] * 2


def test_an_unwritable_run_folder(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    assert f"Cannot use {tmp_path}/file" in refusal(f"hydra.run.dir={tmp_path}/file/run")
    assert "hydra.run.dir=..." in refusal("hydra.run.dir=/proc")  # is there, but takes no file


@pytest.mark.parametrize("backend", ["glfw", "nonsense"])
def test_no_opengl(backend: str, tmp_path: Path) -> None:
    told = refusal(*SMALL, f"hydra.run.dir={tmp_path}", MUJOCO_GL=backend, DISPLAY="")
    assert f"OpenGL does not work with MUJOCO_GL={backend}; set MUJOCO_GL=egl" in told
    assert status(tmp_path)["state"] == "failed"


def test_a_truncated_cache(tmp_path: Path) -> None:
    cached = catalogue_folder(real_config(*SMALL).env.objects)
    copy = tmp_path / "cache" / "objects" / cached.name
    copy.mkdir(parents=True)
    for file in cached.iterdir():
        (copy / file.name).write_bytes(file.read_bytes()[:1000])
    folder = tmp_path / "run"
    told = refusal(*SMALL, f"hydra.run.dir={folder}", SDFGCN_CACHE=str(tmp_path / "cache"))
    assert str(copy) in told
    assert "damaged" in told
    assert status(folder)["state"] == "failed"


def test_a_layout_that_cannot_be_placed(tmp_path: Path) -> None:
    impossible = (*SMALL, "runtime.workers=0", "env.scenario.spacing=2", "env.scenario.max_tries=1")
    with (
        pytest.raises(SdfgcnError, match=r"scenario\.spacing"),
        RunFolder(tmp_path, compose_config(*impossible)) as folder,
    ):
        run_experiment(real_config(*impossible), folder)
    assert status(tmp_path)["state"] == "failed"
    assert not (tmp_path / "results.json").exists()
    assert not list(tmp_path.glob("recordings/*.rrd"))
