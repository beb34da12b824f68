"""Films and pictures on disk: MP4 by PyAV, GIF and PNG by Pillow; whole, or not there."""

from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8

from kanejax._view.shape import ViewError, view_package
from kanejax._whole_file import remove_leftovers, whole_file

MP4, GIF, PNG = ".mp4", ".gif", ".png"
# Below 18 nobody sees the difference from the pictures themselves.
_QUALITY = "18"
# Moments of a film that the 256 colours of a GIF are chosen from.
_MOMENTS = 5

Picture = UInt8[np.ndarray, "rows columns 3"]


def frame_rate(suffix: str, fps: float) -> Fraction:
    """The rate next to the one asked for that a format has: times between the pictures of a GIF are hundredths of a second."""
    if suffix == GIF:
        return Fraction(100, max(2, round(100 / fps)))
    return Fraction(fps).limit_denominator(1000)


def check_film(path: Path, size: tuple[int, int], fps: float) -> None:
    """Refuse what cannot be written.

    Raises:
        ViewError: the suffix, the size or the rate is none that a film has.
    """
    if path.suffix.lower() not in (MP4, GIF, PNG):
        raise ViewError(f"{path}: pictures are {PNG}, films {MP4} or {GIF}; it ends in none of them")
    if not all(16 <= length <= 4096 for length in size):
        raise ViewError(f"the size {size[0]}x{size[1]} is no size of a picture; give from 16 to 4096 columns and rows")
    if path.suffix.lower() == MP4 and any(length % 2 for length in size):
        raise ViewError(f"the size {size[0]}x{size[1]} is odd, and an MP4 has an even number of columns and rows")
    if not 1.0 <= fps <= 240.0:
        raise ViewError(f"{fps:g} pictures a second are no film; give from 1 to 240")
    view_package("PIL.Image" if path.suffix.lower() != MP4 else "av")


def write_film(
    path: Path, times: Sequence[float], draw: Callable[[float], Picture], rate: Fraction, said: Callable[[int], None]
) -> None:
    """Draw the pictures at these times, and write them to a film; a PNG is the first of them.

    Args:
        path: of the film.
        times: one for each picture.
        draw: a picture at a time.
        rate: pictures a second.
        said: is called with the number of pictures that are done.
    """
    remove_leftovers(path)

    def pictures() -> Iterator[Picture]:
        for number, t in enumerate(times):
            yield draw(t)
            said(number + 1)

    with whole_file(path) as partial:
        if path.suffix.lower() == PNG:
            view_package("PIL.Image").fromarray(next(pictures())).save(partial, format="PNG", optimize=True)
        elif path.suffix.lower() == GIF:
            moments = [draw(times[k]) for k in np.unique(np.linspace(0, len(times) - 1, _MOMENTS).astype(int))]
            _write_gif(partial, pictures(), moments, rate)
        else:
            _write_mp4(partial, pictures(), rate)
    said(len(times))


def _write_mp4(path: Path, pictures: Iterator[Picture], rate: Fraction) -> None:
    av = view_package("av")
    with av.open(str(path), "w", format="mp4", options={"movflags": "+faststart"}) as film:
        # The number of threads changes the bytes.
        options = {"crf": _QUALITY, "preset": "medium", "threads": "1", "x264-params": "threads=1"}
        stream: Any = None
        for picture in pictures:
            if stream is None:
                stream = film.add_stream("libx264", rate=rate, options=options)
                stream.height, stream.width = picture.shape[:2]
                stream.pix_fmt = "yuv420p"
            film.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        film.mux(stream.encode(None))


def _write_gif(path: Path, pictures: Iterator[Picture], moments: list[Picture], rate: Fraction) -> None:
    image = view_package("PIL.Image")
    # One choice of colours for all pictures, and no dots: the background stays still, and the file small.
    colors = image.fromarray(np.concatenate(moments)).quantize(256, method=image.Quantize.MEDIANCUT)
    frames = (image.fromarray(each).quantize(palette=colors, dither=image.Dither.NONE) for each in pictures)
    first = next(frames)
    duration = int(1000 / rate)
    first.save(path, format="GIF", save_all=True, append_images=frames, duration=duration, loop=0, optimize=False, disposal=1)
