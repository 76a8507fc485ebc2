"""Checkpoints as files: what comes back, and what is refused before anything of it is read."""

from __future__ import annotations

import io
import json
import os
import pickle
import stat
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import torch
from tensordict import TensorDict

from sdfgcn.errors import SdfgcnError
from sdfgcn.task.scene import Scene
from sdfgcn.train.archive import JSON_BYTES
from sdfgcn.train.checkpoint import checkpoint_config, load_checkpoint, save_checkpoint
from sdfgcn.train.state_file import decoded, encoded

LIMIT = 2**20  # bytes
REPLAY = "components/0001-replay"
TENSORS = f"{REPLAY}/tensors.safetensors"
STATE = f"{REPLAY}/state.json"


class Part:
    """A part of a training with any state."""

    def __init__(self, state: Any) -> None:
        self.state = state

    def state_dict(self) -> Any:
        return self.state

    def load_state_dict(self, state: Any) -> None:
        self.state = state


def parts() -> dict[str, Any]:
    return {"replay": Part({"held": torch.arange(5)}), "collector": {"env": {"seed": 1}}}


@pytest.fixture
def checkpoint(tmp_path: Path) -> Path:
    path = tmp_path / "checkpoint.zip"
    save_checkpoint(path, parts(), {"seed": 0})
    return path


# ------------------------------------------------------------------ what comes back


def test_a_state_comes_back(tmp_path: Path) -> None:
    scene = Scene(
        sdf=torch.zeros(2, 1, 1, dtype=torch.uint8),
        node_mask=torch.tensor([True, False]),
        center=torch.rand(2, 2),
        position=torch.rand(2, 2),
        batch_size=[],
    )
    tied = torch.rand(3)
    state = {
        "optimiser": {"state": {0: {"step": torch.tensor(3.0)}}, "betas": (0.9, 0.999)},
        "python": (3, (1, 2), None),
        "tied": [tied, tied, tied[1:]],
        "pushes": TensorDict({"scene": scene, "action": torch.tensor(4)}, batch_size=[]),
        "name": "precision",
        "loss": float("nan"),
        "tensor": {"tensor": 1},  # the name that the file uses itself
    }
    saved, given = Part(state), Part(None)
    save_checkpoint(tmp_path / "checkpoint.zip", {"part": saved}, {})
    load_checkpoint(tmp_path / "checkpoint.zip", {"part": given}, LIMIT)
    back = given.state
    assert list(back) == list(state)
    assert back["optimiser"] == {"state": {0: {"step": torch.tensor(3.0)}}, "betas": (0.9, 0.999)}
    assert back["python"] == state["python"]
    assert all(map(torch.equal, back["tied"], state["tied"]))
    assert isinstance(back["pushes"]["scene"], Scene)
    assert (back["pushes"] == state["pushes"]).all()
    assert back["pushes"]["scene"].sdf.dtype == torch.uint8
    assert (back["name"], back["tensor"]) == ("precision", {"tensor": 1})
    assert back["loss"] != back["loss"]


def test_global_generators_go_on(tmp_path: Path) -> None:
    import random

    import numpy as np

    def draw() -> tuple:
        return random.random(), np.random.rand(), torch.rand(1).item()

    save_checkpoint(tmp_path / "checkpoint.zip", {}, {})
    drawn = draw()
    assert draw() != drawn
    load_checkpoint(tmp_path / "checkpoint.zip", {}, LIMIT)
    assert draw() == drawn


def test_what_a_checkpoint_holds(checkpoint: Path) -> None:
    with zipfile.ZipFile(checkpoint) as archive:
        names = archive.namelist()
    kinds = ("state.json", "tensors.safetensors")
    assert sorted(names) == [
        "components/0000-collector/value.json",
        *(f"components/{part}/{kind}" for part in ("0001-replay", "0002-rng") for kind in kinds),
        "manifest.json",
    ]
    assert checkpoint_config(checkpoint, LIMIT) == {"seed": 0}


def test_a_state_that_is_no_data_is_not_saved() -> None:
    with pytest.raises(TypeError, match="/part is of <class 'object'>"):
        encoded({"part": object()}, {})


@pytest.mark.parametrize(
    "structure",
    [
        {"tensor": "none"},
        {"object": 1},
        {"dict": [[{"tuple": []}, 1]]},
        {"dict": 3},
        {"batch": ["Path", [], {}]},
        {},
    ],
)
def test_a_structure_of_another_kind_is_refused(structure: Any) -> None:
    with pytest.raises(ValueError, match="not a state's structure"):
        decoded(structure, {})


# ------------------------------------------------------------------ what is refused


class Attack:
    """Makes a file when it is unpickled."""

    def __init__(self, marker: Path) -> None:
        self.marker = marker

    def __reduce__(self) -> tuple:
        return os.mknod, (str(self.marker),)


def torch_file(marker: Path) -> bytes:
    content = io.BytesIO()
    torch.save(Attack(marker), content)
    return content.getvalue()


def nested(marker: Path) -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        archive.writestr("other.pickle", pickle.dumps(Attack(marker)))
    return content.getvalue()


def link(name: str) -> zipfile.ZipInfo:
    info = zipfile.ZipInfo(name)
    info.external_attr = (stat.S_IFLNK | 0o777) << 16
    return info


Change = Callable[[dict[Any, bytes], bytes], object]

# What is changed in {name: content}, given a pickle that runs code; and what is said.
ATTACKS: dict[str, tuple[Change, str]] = {
    "prefetch": (
        lambda files, bad: files.update({f"{REPLAY}/prefetch.pkl": bad}),
        r"holds '.*/prefetch\.pkl', which no checkpoint of this version has",
    ),
    "memmap": (
        lambda files, bad: files.update(
            {f"{REPLAY}/storage/meta.json": b"{}", f"{REPLAY}/storage/other.pickle": bad}
        ),
        r"holds '.*/storage/meta\.json', which no",
    ),
    "torch": (lambda files, bad: files.update({f"{REPLAY}/state.pt": bad}), r"state\.pt', which"),
    "nested": (lambda files, bad: files.update({"more.zip": bad}), r"'more\.zip', which no"),
    "nested as tensors": (lambda files, bad: files.update({TENSORS: bad}), "is of another kind"),
    "as JSON": (lambda files, bad: files.update({STATE: bad}), "is of another kind"),
    "outside": (
        lambda files, bad: files.update({f"{REPLAY}/../../../state.json": files[STATE]}),
        r"/\.\./state\.json', which no",
    ),
    "absolute": (
        lambda files, bad: files.update({f"/tmp/{STATE}": files[STATE]}),
        r"holds '/tmp/components/.*, which no",
    ),
    "link": (
        lambda files, bad: files.update({link(STATE): b"/etc/passwd", STATE: None}),
        "which is no ordinary file",
    ),
    "folder": (lambda files, bad: files.update({f"{REPLAY}/": b""}), "which no"),
    "twice": (lambda files, bad: files.update({zipfile.ZipInfo(STATE): b"{}"}), "twice"),
    "bomb": (
        lambda files, bad: files.update({TENSORS: bytes(2 * LIMIT)}),
        "would take 2 MB unpacked, but one of this training takes at most 1 MB",
    ),
    "JSON bomb": (
        lambda files, bad: files.update({STATE: b" " * (JSON_BYTES + 1)}),
        r"state\.json' of 16 MB",
    ),
}


def changed(path: Path, change: Change, bad: bytes, method: int = zipfile.ZIP_DEFLATED) -> None:
    with zipfile.ZipFile(path) as archive:
        files: dict[Any, bytes] = {name: archive.read(name) for name in archive.namelist()}
    change(files, bad)
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, content in files.items():
            if content is not None:
                archive.writestr(name, content, method)


@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize("harm", [torch_file, nested, lambda marker: pickle.dumps(Attack(marker))])
@pytest.mark.parametrize("attack", ATTACKS)
def test_an_attack_is_refused(
    attack: str, harm: Callable[[Path], bytes], checkpoint: Path, tmp_path: Path
) -> None:
    marker = tmp_path / "marker"
    change, told = ATTACKS[attack]
    changed(checkpoint, change, harm(marker))
    for read in (
        lambda: checkpoint_config(checkpoint, LIMIT),
        lambda: load_checkpoint(checkpoint, parts(), LIMIT),
    ):
        with pytest.raises(SdfgcnError, match=told) as raised:
            read()
        assert str(raised.value).startswith(str(checkpoint)) and "\n" not in str(raised.value)
    assert not marker.exists()
    assert {path.name for path in tmp_path.iterdir()} == {"checkpoint.zip"}


def test_the_attacks_would_harm(tmp_path: Path) -> None:
    pickle.loads(pickle.dumps(Attack(tmp_path / "marker")))
    assert (tmp_path / "marker").exists()


def test_other_compressions_are_refused(checkpoint: Path) -> None:
    """They may unpack to more than they declare."""
    changed(checkpoint, lambda files, bad: None, b"", zipfile.ZIP_LZMA)
    with pytest.raises(SdfgcnError, match="is compressed in another way"):
        checkpoint_config(checkpoint, LIMIT)


def test_a_file_that_declares_too_little_is_damaged(checkpoint: Path) -> None:
    """No more is unpacked than was declared, and the checksum is then wrong."""
    content = bytearray(checkpoint.read_bytes())
    with zipfile.ZipFile(checkpoint) as archive:
        size = archive.getinfo(TENSORS).file_size
    place = content.rindex(TENSORS.encode()) - 46 + 24  # of the size, in the list of files
    assert int.from_bytes(content[place : place + 4], "little") == size
    content[place : place + 4] = (size - 8).to_bytes(4, "little")
    checkpoint.write_bytes(content)
    with pytest.raises(SdfgcnError, match="is damaged"):
        load_checkpoint(checkpoint, parts(), LIMIT)


def test_files_that_the_manifest_names_elsewhere_are_not_read(checkpoint: Path) -> None:
    def outside(files: dict[Any, bytes], bad: bytes) -> None:
        manifest = json.loads(files["manifest.json"])
        manifest["components"]["replay"]["path"] = "../../components/0001-replay"
        files["manifest.json"] = json.dumps(manifest).encode()

    changed(checkpoint, outside, b"")
    with pytest.raises(SdfgcnError, match="is damaged"):
        load_checkpoint(checkpoint, parts(), LIMIT)


def test_a_part_as_something_else_is_not_read(checkpoint: Path) -> None:
    """A manifest cannot have a part read in another way, such as by TorchRL's own adapters."""

    def other(files: dict[Any, bytes], bad: bytes) -> None:
        manifest = json.loads(files["manifest.json"])
        manifest["components"]["replay"]["adapter"] = "torchrl.dump_load"
        files["manifest.json"] = json.dumps(manifest).encode()

    changed(checkpoint, other, b"")
    with pytest.raises(SdfgcnError, match="is damaged"):
        load_checkpoint(checkpoint, parts(), LIMIT)
