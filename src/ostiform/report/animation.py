"""Moving pictures of shapes: animated WebP, and numbered frames that a film is made of.

Drawn by the painter of the report's own pictures, so neither a display nor OpenGL is needed.
"""

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from ostiform.arrays import FloatArray
from ostiform.atomic import atomically
from ostiform.errors import InputError
from ostiform.model import ShapeModel
from ostiform.report.cutaway import drawn_faces
from ostiform.report.modes import extents_of
from ostiform.report.raster import Raster
from ostiform.report.shading import ON_SURFACE, VIEWS, View, shaded_surface
from ostiform.report.style import part_colours

FRAMES = 20
HEIGHT = 400
"""Pixels of the pictures above their caption."""
CAPTION_HEIGHT = 36
TEXT_PIXELS = 15
INK = (27, 39, 51)
BACKGROUND = (255, 255, 255)
FINENESS = 2
"""Lines are drawn on a sheet that is this many times larger, and so come out smooth."""
LINE_PIXELS = 1.6
WEBP_QUALITY = 80
WEBP_EFFORT = 2
"""Of 6: a tenth larger than the best, in a fifth of the time."""

Pixels = NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class Animation:
    """Frames that show a motion once and lead back to the first.

    Attributes
    ----------
    frames : (T, H, W, 3) uint8
        H and W are even, as the encoders of films ask.
    seconds : float
        Of the whole motion.
    """

    frames: Pixels
    seconds: float

    def __post_init__(self) -> None:
        """Check the frames and the time."""
        height, width = self.frames.shape[1:3] if self.frames.ndim == 4 else (0, 0)
        if not len(self.frames) or not height or not width or height % 2 or width % 2:
            raise InputError(
                "an animation: expected at least one frame of even height and width, found an "
                f"array of shape {self.frames.shape}"
            )
        if not self.seconds > 0.0:
            raise InputError(f"an animation: expected a positive time, found {self.seconds} s")

    @property
    def rate(self) -> float:
        """Frames per second."""
        return len(self.frames) / self.seconds


def mode_animation(
    model: ShapeModel,
    mode: int,
    n_frames: int = FRAMES,
    deviation: float = 3.0,
    seconds: float = 2.4,
) -> Animation:
    """Show one mode: from the mean to plus, to minus `deviation` sd, and back, as a sine.

    Parameters
    ----------
    model : ShapeModel
    mode : int
        From 0.
    n_frames : int
    deviation : float
        In standard deviations.
    seconds : float

    Raises
    ------
    InputError
        If the model has no such mode.
    """
    if not 0 <= mode < len(model.modes):
        raise InputError(
            f"mode of a model: expected an index from 0 to {len(model.modes) - 1}, found {mode}"
        )
    course = np.sin(2.0 * np.pi * np.arange(n_frames) / n_frames)
    amounts, order = np.unique(np.round(deviation * course, 9), return_inverse=True)
    spread = float(np.sqrt(model.variances[mode]))
    shapes = model.mean + (amounts * spread)[:, None, None] * model.modes[mode]
    captions = [f"mode {mode + 1}   {_signed(amount)} sd" for amount in amounts]
    there_and_back = animation_of(model, shapes, captions, seconds).frames[order]
    return Animation(there_and_back, seconds)


def cycle_animation(
    model: ShapeModel, shapes: FloatArray, times: FloatArray, name: str, seconds: float = 1.6
) -> Animation:
    """Show a beating shape.

    Parameters
    ----------
    model : ShapeModel
        Gives the mesh.
    shapes : (T, P, 3) float64, mm
        Over one cycle, the last before the first again.
    times : (T,) float64
        Fractions of the cycle.
    name : str
        What it is, for the caption.
    seconds : float
        Of the cycle; slower than a heart, so that it can be seen.
    """
    return animation_of(
        model, shapes, [f"{name}   {time:.2f} of the cycle" for time in times], seconds
    )


def animation_of(
    model: ShapeModel, shapes: FloatArray, captions: Sequence[str], seconds: float
) -> Animation:
    """Draw shapes one after the other, each from two sides, at one scale.

    Parameters
    ----------
    model : ShapeModel
        Gives the mesh.
    shapes : (T, P, 3) float64, mm
    captions : (T,) sequence of str
    seconds : float
        Of the whole motion.

    Raises
    ------
    InputError
        If there is no shape, or not one caption for each.
    """
    if not len(shapes) or len(captions) != len(shapes):
        raise InputError(
            f"an animation: expected at least one shape and a caption for each, found "
            f"{len(shapes)} shapes and {len(captions)} captions"
        )
    extents = extents_of(VIEWS, list(shapes))
    colours = part_colours(model.mesh.face_part)
    shown = drawn_faces(model, VIEWS)
    aspect = (extents[0, 1] - extents[0, 0]) / (extents[0, 3] - extents[0, 2])
    size = (2 * max(1, round(HEIGHT * aspect / 2.0)), HEIGHT)
    font = _font()
    frames = []
    for points, caption in zip(shapes, captions, strict=True):
        panels = []
        for view, extent, drawn in zip(VIEWS, extents, shown, strict=True):
            faces = model.mesh.faces[drawn]
            picture = shaded_surface(view, points, faces, colours[drawn], extent, size)
            loops = [points[loop] for loop in model.mesh.loops.values()]
            panels.append(_with_curves(picture, view, loops))
        frames.append(_captioned(np.concatenate(panels, axis=1), caption, font))
    return Animation(np.stack(frames), seconds)


def write_webp(path: Path, animation: Animation) -> None:
    """Write an animation that loops for ever, for browsers and slides.

    Raises
    ------
    ArtifactError
        If the file cannot be written.
    """
    pictures = [Image.fromarray(frame) for frame in animation.frames]
    buffer = io.BytesIO()
    pictures[0].save(
        buffer,
        format="WEBP",
        save_all=True,
        append_images=pictures[1:],
        duration=round(1000.0 / animation.rate),
        loop=0,
        quality=WEBP_QUALITY,
        method=WEBP_EFFORT,
    )
    with atomically(path) as temporary:
        temporary.write_bytes(buffer.getvalue())


def write_frames(folder: Path, animation: Animation) -> None:
    """Write the frames as ``0000.png``, ``0001.png``, ... into a folder of their own.

    Frames of an earlier animation in the folder are removed.

    Raises
    ------
    ArtifactError
        If a file cannot be written.
    """
    if folder.is_dir():
        for old in folder.glob("[0-9][0-9][0-9][0-9].png"):
            old.unlink()
    for number, frame in enumerate(animation.frames):
        with atomically(folder / f"{number:04d}.png") as temporary:
            Image.fromarray(frame).save(temporary, format="PNG", compress_level=3)


def _with_curves(picture: Raster, view: View, curves: Sequence[FloatArray]) -> Pixels:
    """Return the picture (H, W, 3) with what can be seen of closed curves on the surface."""
    left, right, bottom, top = picture.extent
    height, width = picture.image.shape[:2]
    ink = Image.new("L", (FINENESS * width, FINENESS * height), 0)
    pen = ImageDraw.Draw(ink)
    scale = np.array([ink.width / (right - left), ink.height / (top - bottom)])
    tolerance = ON_SURFACE * max(right - left, top - bottom)
    for curve in curves:
        seen = view.seen(np.vstack([curve, curve[:1]]))  # (n + 1, 3)
        shown = picture.sees(0.5 * (seen[1:] + seen[:-1]), tolerance)
        placed = np.stack([seen[:, 0] - left, top - seen[:, 1]], axis=1) * scale
        for edge in np.flatnonzero(shown):
            line = (*placed[edge].tolist(), *placed[edge + 1].tolist())
            pen.line(line, fill=255, width=round(LINE_PIXELS * FINENESS))
    image = Image.fromarray(picture.image)
    image.paste(INK, (0, 0, width, height), ink.reduce(FINENESS))
    pixels: Pixels = np.asarray(image)
    return pixels


def _captioned(pixels: Pixels, caption: str, font: ImageFont.FreeTypeFont) -> Pixels:
    height, width = pixels.shape[:2]
    frame = Image.new("RGB", (width, height + CAPTION_HEIGHT), BACKGROUND)
    frame.paste(Image.fromarray(pixels), (0, 0))
    place = (0.5 * width, height + 0.5 * CAPTION_HEIGHT)
    ImageDraw.Draw(frame).text(place, caption, fill=INK, font=font, anchor="mm")
    result: Pixels = np.asarray(frame)
    return result


def _font() -> ImageFont.FreeTypeFont:
    """Return the font of the report's figures, which Matplotlib brings with it."""
    path = Path(matplotlib.get_data_path()) / "fonts" / "ttf" / "DejaVuSans.ttf"
    return ImageFont.truetype(str(path), TEXT_PIXELS)


def _signed(value: float) -> str:
    return f"{value:+.1f}".replace("-", "\N{MINUS SIGN}") if abs(value) >= 0.05 else "0"
