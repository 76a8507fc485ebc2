"""The training pictures: rendered once by parallel workers, cached, and read into memory.

Pictures come in shards. With given settings, a shard depends only on the seed, its catalogue and
its number, so an interrupted rendering resumes with the missing shards.
"""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import zipfile
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import closing
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sdfgcn.config import SegmentationTrainingConfig
from sdfgcn.errors import SdfgcnError
from sdfgcn.files import replaced
from sdfgcn.objects.catalogue import catalogue_folder, load_catalogue
from sdfgcn.objects.storage import cache_dir
from sdfgcn.progress_bar import progress_bar
from sdfgcn.segmentation.arrangements import ArrangementWorld

FORMAT = 1  # increment whenever the same settings would give other pictures
SHARD = 100  # arrangements in a shard


@dataclass(frozen=True)
class Pictures:
    """Pictures with their true labels.

    Attributes:
        pixels: [P, H, W, 3] RGB.
        labels: [P, H, W] 0 for the table, 1 to n for objects.
    """

    pixels: NDArray[np.uint8]
    labels: NDArray[np.uint8]


def load_pictures(config: SegmentationTrainingConfig) -> Pictures:
    """Render the missing training pictures and read them all.

    Raises:
        SdfgcnError: A cached shard is damaged.
    """
    folder = pictures_folder(config)
    folder.mkdir(parents=True, exist_ok=True)
    for catalogue in config.catalogues.values():
        load_catalogue(catalogue, "train")  # once, rather than in every worker
    shards = _shards(config)
    missing = [shard for shard in shards if not (folder / shard.file).exists()]
    with progress_bar(
        total=len(missing) * SHARD * config.arrangements.appearances,
        desc="Rendering",
        unit="picture",
    ) as bar:
        for count in _render_all(config, folder, missing):
            bar.update(count)
    return _read([folder / shard.file for shard in shards])


def pictures_folder(config: SegmentationTrainingConfig) -> Path:
    """The cache folder of pictures with these settings."""
    scenes = {
        k: v for k, v in asdict(config.arrangements).items() if k not in ("workers", "layouts")
    }
    settings = {
        "format": [FORMAT, SHARD],
        "scenes": scenes,
        "arena": asdict(config.env.arena),
        "physics": asdict(config.env.physics),
        "catalogues": {
            name: [catalogue_folder(objects).name, objects.palette]
            for name, objects in config.catalogues.items()
        },
    }
    key = hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()[:16]
    return cache_dir() / "segmentation" / key


@dataclass(frozen=True)
class Shard:
    """A batch of arrangements that are rendered together.

    Attributes:
        catalogue: Name of the catalogue the objects are from.
        number: Its number within that catalogue.
    """

    catalogue: str
    number: int

    @property
    def file(self) -> str:
        """The file name."""
        return f"{self.catalogue}-{self.number:04d}.npz"


def _shards(config: SegmentationTrainingConfig) -> list[Shard]:
    """The same number of shards per catalogue; more layouts add shards without changing any."""
    each = -(-config.arrangements.layouts // (SHARD * len(config.catalogues)))
    return [Shard(name, number) for number in range(each) for name in sorted(config.catalogues)]


def _render_all(
    config: SegmentationTrainingConfig, folder: Path, missing: Sequence[Shard]
) -> Iterator[int]:
    """Render shards in worker processes; yields the number of pictures in each."""
    if config.arrangements.workers == 0 or len(missing) < 2:
        yield from (render_shard(config, folder, shard) for shard in missing)
        return
    context = multiprocessing.get_context("spawn")  # OpenGL does not survive a fork
    with ProcessPoolExecutor(config.arrangements.workers, mp_context=context) as pool:
        jobs = [pool.submit(render_shard, config, folder, shard) for shard in missing]
        for job in as_completed(jobs):
            yield job.result()


def render_shard(config: SegmentationTrainingConfig, folder: Path, shard: Shard) -> int:
    """Render one shard, write its file atomically and return its number of pictures."""
    objects = config.catalogues[shard.catalogue]
    env = replace(config.env, objects=objects)
    order = sorted(config.catalogues).index(shard.catalogue)
    pixels, labels = [], []
    world = ArrangementWorld(env, load_catalogue(objects, "train"), config.arrangements)
    with closing(world):
        for layout in range(SHARD):
            rng = np.random.default_rng([config.arrangements.seed, order, shard.number, layout])
            for picture, truth in world.pictures(rng):
                pixels.append(picture)
                labels.append(truth)
    with replaced(folder / shard.file) as part:
        np.savez(part, pixels=np.stack(pixels), labels=np.stack(labels))
    return len(pixels)


def _read(files: Sequence[Path]) -> Pictures:
    pixels, labels = [], []
    for file in progress_bar(files, desc="Reading pictures", unit="shard"):
        try:
            with np.load(file, allow_pickle=False) as arrays:
                shard = arrays["pixels"], arrays["labels"]
            if not (shard[0].dtype == shard[1].dtype == np.uint8):
                raise ValueError("they are not of bytes")
            if shard[0].shape != (*shard[1].shape, 3):
                raise ValueError("pictures and labels differ in shape")
            pixels.append(shard[0])
            labels.append(shard[1])
        except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
            raise SdfgcnError(
                f"The cached pictures {file} are damaged ({error}); delete that file and run "
                "again to render them anew."
            ) from error
    return Pictures(np.concatenate(pixels), np.concatenate(labels))
