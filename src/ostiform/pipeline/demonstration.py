"""The demonstration population as a study on disk, written once."""

from pathlib import Path

from ostiform.pipeline.events import Note, Tell
from ostiform.pipeline.store import Store, key_of
from ostiform.study.demonstration import write_demonstration

__all__ = ["demonstration_study"]


def demonstration_study(
    folder: Path, subjects: int, shapes: int, seed: int, workers: int, tell: Tell
) -> Path:
    """Write the demonstration population, unless it is there already, and return its study file."""
    store = Store(folder)
    key = key_of("demonstration", subjects, shapes, seed)
    if not store.is_current("demonstration.json", key):
        tell(Note(f"writing {shapes} left hearts of {subjects} subjects to {folder}"))
        write_demonstration(folder, subjects, shapes, seed)
        facts = {"subjects": subjects, "shapes": shapes, "seed": seed}
        store.write_json("demonstration.json", key, facts)
    return folder / "study.toml"
