"""Files of films: MP4 by ffmpeg, as the frames come; GIF and WebP by Pillow, at the end.

Only this file imports imageio-ffmpeg.
"""

from __future__ import annotations

from collections.abc import Generator
from contextlib import ExitStack, suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from PIL import Image

from sdfgcn.errors import SdfgcnError
from sdfgcn.files import replaced
from sdfgcn.viz.colors import STATUS_COLORS
from sdfgcn.viz.video_config import VideoConfig


class FilmFile:
    """A film being written; use it as a context manager.

    The file appears under its name only if the block ends without an exception.
    """

    def __init__(self, path: Path, config: VideoConfig) -> None:
        """Set where to write, and format, rate and quality; the suffix is the format's."""
        self.path = path.with_suffix(f".{config.format}")
        self._config = config
        self._stack = ExitStack()
        self._part = self.path
        self._ffmpeg: Generator[None, bytes | None, None] | None = None
        self._kept: list[Image.Image] = []
        self._palette: Image.Image | None = None

    def __enter__(self) -> Self:
        """Create the file under a temporary name.

        Raises:
            SdfgcnError: It cannot be written there.
        """
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self._part = self._stack.enter_context(replaced(self.path))
            self._part.touch()
        except OSError as error:
            raise SdfgcnError(
                f"Cannot write the film {self.path} ({error}); choose a writable run folder with "
                "hydra.run.dir=... or run viz=none."
            ) from error
        return self

    def add(self, frame: Image.Image) -> None:
        """Append a frame; all have the same size."""
        if self._config.format == "mp4":
            self._send(frame)
        elif self._config.format == "webp":
            self._kept.append(frame)
        else:  # one palette for all frames: what stands still stays the same, and takes no room
            self._palette = self._palette or _palette(frame)
            self._kept.append(frame.quantize(palette=self._palette, dither=Image.Dither.NONE))

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Finish the file, or remove it after an exception."""
        with self._stack:
            self._close_ffmpeg(may_fail=error is not None)  # Ctrl-C ends it, too
            if error is None and self._kept:
                self._save()
            self._kept = []
            if error is not None:
                self._stack.pop_all().__exit__(kind, error, trace)

    def _send(self, frame: Image.Image) -> None:
        if self._ffmpeg is None:
            import imageio_ffmpeg  # an extra, and heavy

            self._ffmpeg = imageio_ffmpeg.write_frames(
                str(self._part),
                frame.size,
                fps=self._config.fps,
                quality=self._config.quality / 10,
                macro_block_size=2,
                output_params=["-movflags", "+faststart"],
            )
            self._ffmpeg.send(None)
        self._ffmpeg.send(frame.tobytes())

    def _close_ffmpeg(self, may_fail: bool) -> None:
        if self._ffmpeg is not None:
            with suppress(*[OSError] * may_fail):
                self._ffmpeg.close()
            self._ffmpeg = None

    def _save(self) -> None:
        first, *rest = self._kept
        options: dict[str, Any] = {"save_all": True, "append_images": rest, "loop": 0}
        options |= {"duration": round(1000 / self._config.fps), "optimize": True}
        if self._config.format == "webp":
            options |= {"quality": self._config.quality, "method": 4, "minimize_size": True}
        first.save(self._part, **options)


def _palette(first: Image.Image) -> Image.Image:
    """The 256 colours of a film, from its first frame and what words will be written in."""
    swatch = max(8, first.height // 12)
    sample = Image.new("RGB", (first.width, first.height + swatch))
    sample.paste(first)
    for number, color in enumerate(STATUS_COLORS.values()):
        x = number * swatch
        sample.paste(color, (x, first.height, x + swatch, first.height + swatch))
    return sample.quantize(256)
