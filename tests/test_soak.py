"""The soak's bookkeeping: trends, sums over processes, its command line."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "experiments"))

import soak  # noqa: E402


def sample(minutes: float, rss: float) -> dict[str, float]:
    return {"minutes": minutes, "rss_mib": rss}


def run(seconds: float, slowest: float, warnings: dict[str, int]) -> dict:
    return {
        "simulated_seconds": seconds,
        "pushes": 10,
        "episodes": 2,
        "hours": 0.5,
        "cpu_hours": 0.25,
        "nan": [],
        "mujoco_warnings": warnings,
        "slowest": {"push": {"cpu_seconds": slowest}, "reset": {"cpu_seconds": 1.0}},
        "cases": [],
    }


def test_growth_is_that_of_the_later_half() -> None:
    """Memory rises by 300 MiB while it warms up, and then by 1 MiB in 10 minutes."""
    samples = [sample(0, 800), sample(10, 1100), *(sample(10 * k, 1100 + k) for k in range(2, 6))]
    found = soak.trend(samples, "rss_mib")
    assert (found["first"], found["last"], found["most"]) == (800, 1105, 1105)
    assert found["per_hour"] == pytest.approx(6.0)
    assert soak.trend(samples[:3], "rss_mib")["per_hour"] is None


def test_runs_of_several_processes_add_up() -> None:
    found = soak.together([run(100.0, 0.2, {"a": 1}), run(50.0, 0.3, {"a": 2, "b": 1})])
    assert (found["simulated_seconds"], found["pushes"], found["nan"]) == (150.0, 20, 0)
    assert found["mujoco_warnings"] == {"a": 3, "b": 1}
    assert found["slowest"]["push"]["cpu_seconds"] == 0.3
    assert len(found["runs"]) == 2


def test_an_option_on_the_command_line_replaces_all() -> None:
    assert soak.asked([], "robot", soak.ROBOTS) == ["gripper", "ur5e"]
    assert soak.asked(["robot=ur5e", "env=table"], "robot", soak.ROBOTS) == ["ur5e"]


@pytest.mark.parametrize("hours", ["0", "-1", "nan", "soon"])
def test_hours_must_be_a_number_above_zero(hours: str, capsys) -> None:
    with pytest.raises(SystemExit):
        soak.main([f"hours={hours}"])
    assert "hours must be a number of hours above 0" in capsys.readouterr().err


def test_it_pushes_and_counts(tmp_path: Path) -> None:
    """In a process of its own, since it counts MuJoCo's steps there."""
    code = (
        "import sys; sys.path.insert(0, sys.argv[1]); import soak; from pathlib import Path\n"
        "options = ['objects=household', 'robot=gripper', 'perception=oracle']\n"
        "first = soak.soak(1e-6, options, Path(sys.argv[2]), [])\n"
        "soak.soak(1e-6, options, Path(sys.argv[2]), first['runs'])"
    )
    path = tmp_path / "soak.json"
    command = [sys.executable, "-c", code, str(ROOT / "experiments"), str(path)]
    subprocess.run(command, check=True, capture_output=True)
    result = json.loads(path.read_text())
    first, second = result["runs"]
    assert [run["cases"][0]["first_seed"] for run in (first, second)] == [0, 1]
    for run in (first, second):
        assert run["episodes"] == 1 and run["pushes"] > 0 and not run["nan"]
        # A push of 60 mm takes between a tenth of a second and ten.
        assert 0.1 < run["simulated_seconds_per_push"] < 10.0
    assert result["pushes"] == first["pushes"] + second["pushes"]
