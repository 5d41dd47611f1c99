"""Moving pictures: frames that come back to the first, of even size, that Pillow reads."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from ostiform.errors import InputError
from ostiform.model import fit_model, mesh_of_template
from ostiform.report.animation import (
    Animation,
    animation_of,
    cycle_animation,
    mode_animation,
    write_frames,
    write_webp,
)
from tests.populations import population


@pytest.fixture(scope="module")
def model():
    shapes = population(3, 3, np.random.default_rng(7))
    return fit_model(shapes.aligned, shapes.weights, mesh_of_template(shapes.template))


@pytest.fixture(scope="module")
def animation(model):
    return mode_animation(model, 0, n_frames=8, deviation=3.0, seconds=0.8)


def test_frames_are_of_even_size_and_show_a_shape(animation):
    count, height, width, channels = animation.frames.shape
    assert (count, height % 2, width % 2, channels) == (8, 0, 0, 3)
    assert animation.frames.dtype == np.uint8
    assert all(frame.std() > 20.0 for frame in animation.frames)
    np.testing.assert_array_equal(animation.frames[:, 0, 0], 255)


def test_a_mode_goes_there_and_back(animation):
    # sin is the same an eighth before and after its quarter, and zero at the start and half way.
    np.testing.assert_array_equal(animation.frames[1], animation.frames[3])
    np.testing.assert_array_equal(animation.frames[5], animation.frames[7])
    np.testing.assert_array_equal(animation.frames[0], animation.frames[4])
    assert (animation.frames[2] != animation.frames[6]).any()


def test_all_frames_have_one_scale(model):
    shapes = np.stack([model.mean, 0.5 * model.mean])
    large, small = animation_of(model, shapes, ["a", "b"], 1.0).frames
    ink = [(frame[:-40] < 250).any(axis=2).sum() for frame in (large, small)]
    np.testing.assert_allclose(ink[1] / ink[0], 0.25, rtol=0.1)  # half as long, a quarter as large


def test_openings_are_drawn_as_lines(model):
    bare = replace(model, mesh=replace(model.mesh, loops={"LV.aortic": np.array([0, 1, 2])}))
    with_lines, almost_without = (
        (animation_of(one, model.mean[None], ["x"], 1.0).frames[0] < 60).all(axis=2).sum()
        for one in (model, bare)
    )
    assert with_lines > almost_without + 100  # pixels of ink


def test_a_webp_holds_every_frame_and_loops(animation, tmp_path):
    write_webp(tmp_path / "mode.webp", animation)
    with Image.open(tmp_path / "mode.webp") as picture:
        assert picture.format == "WEBP"
        assert picture.n_frames == 8  # type: ignore[attr-defined]
        assert picture.info["loop"] == 0
        picture.seek(2)
        difference = np.abs(np.asarray(picture.convert("RGB"), float) - animation.frames[2])
    assert difference.mean() < 3.0  # of 255: what the compression leaves out


def test_frames_are_numbered_and_replace_older_ones(animation, tmp_path):
    (tmp_path / "0099.png").write_bytes(b"old")
    (tmp_path / "notes.png").write_bytes(b"kept")
    write_frames(tmp_path, animation)
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == [*(f"{k:04d}.png" for k in range(8)), "notes.png"]
    with Image.open(tmp_path / "0003.png") as picture:
        np.testing.assert_array_equal(np.asarray(picture), animation.frames[3])


def test_a_cycle_is_captioned_with_its_time(model):
    times = np.array([0.0, 0.5])
    shapes = np.stack([model.mean, model.mean])
    frames = cycle_animation(model, shapes, times, "mean cycle").frames
    np.testing.assert_array_equal(frames[0][:-36], frames[1][:-36])
    assert (frames[0][-36:] != frames[1][-36:]).any()


def test_the_rate_follows_from_the_time(animation):
    assert animation.rate == 10.0


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda m: mode_animation(m, 99), "found 99"),
        (lambda m: mode_animation(m, -1), "found -1"),
        (lambda m: animation_of(m, m.mean[None], [], 1.0), "1 shapes and 0 captions"),
        (lambda m: animation_of(m, m.mean[None], ["a"], 0.0), "positive time"),
        (lambda m: Animation(np.zeros((1, 3, 4, 3), dtype=np.uint8), 1.0), "even height"),
        (lambda m: Animation(np.zeros((0, 4, 4, 3), dtype=np.uint8), 1.0), "at least one frame"),
    ],
)
def test_animations_refuse(model, call, message):
    with pytest.raises(InputError, match=message):
        call(model)
