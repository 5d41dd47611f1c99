import json
import os
import stat

import pytest

from ostiform.atomic import atomically
from ostiform.errors import ArtifactError
from ostiform.pipeline.store import Store, key_of, slug
from ostiform.pipeline.versions import VERSIONS
from ostiform.study import ShapeId


def write(store: Store, name: str, key: str, text: str) -> None:
    with store.writing(name, key) as path:
        path.write_text(text)


def test_an_artifact_is_current_for_its_own_key_only(tmp_path):
    store = Store(tmp_path)
    write(store, "a/b.txt", "key", "content")
    assert store.is_current("a/b.txt", "key")
    assert not store.is_current("a/b.txt", "other key")
    assert not store.is_current("missing", "key")


@pytest.mark.parametrize("damage", ["truncate", "flip", "delete", "record"])
def test_a_damaged_artifact_is_not_current(tmp_path, damage):
    store = Store(tmp_path)
    write(store, "a.bin", "key", "content of the artifact")
    path = store.path("a.bin")
    if damage == "truncate":
        path.write_text("content")
    elif damage == "flip":
        path.write_text("content of the artifacT")
    elif damage == "delete":
        path.unlink()
    else:
        (tmp_path / ".ostiform" / "a.bin.json").write_text('{"schema": 99}')
    assert not store.is_current("a.bin", "key")


def test_a_failed_write_leaves_the_old_file_and_no_litter(tmp_path):
    store = Store(tmp_path)
    write(store, "a.txt", "key", "old")

    def fail() -> None:
        with store.writing("a.txt", "new key") as path:
            path.write_text("half")
            raise RuntimeError("killed")

    with pytest.raises(RuntimeError, match="killed"):
        fail()
    assert store.path("a.txt").read_text() == "old"
    assert not store.is_current("a.txt", "new key")
    assert [p.name for p in tmp_path.iterdir() if p.name.startswith(".writing")] == []


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write to read-only folders")
def test_a_read_only_folder_is_one_clear_sentence(tmp_path):
    tmp_path.chmod(stat.S_IRUSR | stat.S_IXUSR)
    with pytest.raises(ArtifactError, match="expected to write this file"):
        write(Store(tmp_path), "a.txt", "key", "text")


def test_a_folder_that_cannot_be_made_is_one_clear_sentence(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with (
        pytest.raises(ArtifactError, match="expected to write this file"),
        atomically(tmp_path / "file" / "below"),
    ):
        pass


@pytest.mark.parametrize("content", ["", "{", '{"half": '])
def test_damaged_json_is_refused_with_the_remedy(tmp_path, content):
    store = Store(tmp_path)
    store.path("facts.json").write_text(content)
    with pytest.raises(ArtifactError, match="run `ostiform build` again"):
        store.read_json("facts.json")


def test_missing_json_names_the_command(tmp_path):
    with pytest.raises(ArtifactError, match="ostiform build"):
        Store(tmp_path).read_json("facts.json")


def test_json_round_trip(tmp_path):
    store = Store(tmp_path)
    store.write_json("facts.json", "key", {"ä": [1, 2.5, None]})
    assert store.read_json("facts.json") == {"ä": [1, 2.5, None]}
    assert json.loads(store.path("facts.json").read_text("utf-8"))["ä"][1] == 2.5


def test_keys_differ_when_any_input_or_the_version_of_the_stage_differs(monkeypatch):
    before = key_of("ingest", {"x": 1})
    assert key_of("ingest", {"x": 1}) == before
    assert len({before, key_of("ingest", {"x": 2}), key_of("domain", {"x": 1})}) == 3
    monkeypatch.setitem(VERSIONS, "ingest", VERSIONS["ingest"] + 1)
    assert key_of("ingest", {"x": 1}) != before


NASTY = ["../../etc", "a/b", "a", ".", "..", "a_b", "é" * 200, "a b", "<script>", "con", "%2F"]


def test_slugs_are_single_safe_path_segments_and_never_collide():
    slugs = [slug(ShapeId(s, p, 0.0)) for s in NASTY for p in NASTY]
    assert len(set(slugs)) == len(slugs)
    for name in slugs:
        assert "/" not in name
        assert not name.startswith(".")
        assert len(name.encode()) <= 100
