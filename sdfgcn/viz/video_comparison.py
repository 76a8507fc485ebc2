"""One scene played by several agents, as one film."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, closing
from itertools import zip_longest
from pathlib import Path

from PIL import Image

from sdfgcn.config import EnvConfig
from sdfgcn.progress_bar import progress_bar
from sdfgcn.viz.records import Episode
from sdfgcn.viz.video_config import VideoConfig
from sdfgcn.viz.video_drawing import side_by_side
from sdfgcn.viz.video_files import FilmFile
from sdfgcn.viz.video_film import Film


def film_comparison(
    path: Path, env: EnvConfig, viz: VideoConfig, episodes: Mapping[str, Episode]
) -> Path:
    """Film episodes side by side, push by push.

    Who is done first keeps showing its outcome.

    Args:
        path: The file, whose suffix becomes that of `viz.format`.
        env: The environment of all episodes.
        viz: Size of each agent's picture, pace and looks.
        episodes: The episode of each agent, by its title.

    Returns:
        The file.

    Raises:
        SdfgcnError: The file cannot be written, or there are no pictures to film.
    """
    with ExitStack() as stack:
        file = stack.enter_context(FilmFile(path, viz))
        films = [
            stack.enter_context(closing(Film(env, viz, start, title)))
            for title, (start, _) in episodes.items()
        ]
        parts = [_frames(film, ep) for film, ep in zip(films, episodes.values(), strict=True)]
        shown: list[Image.Image] = []
        for frames in _watched(zip_longest(*parts), viz, episodes):
            shown = [new or old for new, old in zip(frames, shown or frames, strict=True)]
            file.add(side_by_side(shown))
    return file.path


def _frames(film: Film, episode: Episode) -> Iterator[Image.Image]:
    yield from film.opening()
    for step in episode[1]:
        yield from film.push(step)
    yield from film.ending()


def _watched(
    frames: Iterable[tuple[Image.Image, ...]], viz: VideoConfig, episodes: Mapping[str, Episode]
) -> Iterable[tuple[Image.Image, ...]]:
    """The frames, with a progress bar."""
    pushes = max(len(steps) for _, steps in episodes.values())
    held = 2 * max(1, round(viz.hold * viz.fps))
    total = held + pushes * (viz.jump_frames + viz.push_frames)
    return progress_bar(frames, total=total, unit="frame", desc="Filming")
