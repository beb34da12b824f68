"""Files of checkpoints: what is read is what was kept, they are whole or not there, and wrong ones are refused by name."""

import contextlib
import errno
import resource
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from kanejax._checkpoint import Checkpoint, CheckpointError, CheckpointWarning, opened


class State(NamedTuple):
    x: jax.Array
    y: np.ndarray
    words: np.ndarray
    inner: tuple[bool, int, float, str]
    named: dict[str, Any]


def state(scale=1.0, words=("a", "few")):
    numbers = (scale > 1, int(3 * scale), 0.1 * scale, f"{scale}")
    return State(
        jnp.arange(3.0) * scale, np.array([[np.nan, -0.0, scale]]), np.array(words), numbers, {"a/b|c": jnp.int32(scale), "ü": 2.0}
    )


def same(one, other):
    assert jax.tree.structure(one) == jax.tree.structure(other)
    for mine, others in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        assert isinstance(mine, jax.Array) == isinstance(others, jax.Array)
        assert isinstance(mine, bool | int | float | str) == isinstance(others, bool | int | float | str)
        np.testing.assert_array_equal(mine, others, strict=True)


def begun(path, interval=0.0, **states):
    with opened(path, interval, "inputs") as kept:
        for name, each in states.items():
            kept.part(name).keep(each)


def test_what_is_read_is_what_was_kept(tmp_path):
    path = tmp_path / "kept.npz"
    begun(path, one=state(2.0, ("other", "words", "longer")), two=state(3.0))
    with opened(str(path), 0.0, "inputs") as kept:
        assert kept.has_begun
        assert kept.part("one").has_begun
        assert not kept.part("three").has_begun
        same(kept.part("one").restored(state()), state(2.0, ("other", "words", "longer")))
        same(kept.part("three").restored(state()), state())
        kept.part("one").keep(state(5.0))
    # Parts that nobody asked for are still there.
    with opened(path, 0.0, "inputs") as kept:
        same(kept.part("two").restored(state()), state(3.0))
        same(kept.part("one").restored(state()), state(5.0))
    assert [each.name for each in tmp_path.iterdir()] == ["kept.npz"]


def test_files_are_written_at_the_interval_and_at_the_end(tmp_path):
    path = tmp_path / "kept.npz"
    with contextlib.suppress(LookupError), opened(path, 1e9, "inputs") as kept:
        kept.keep(state(2.0))
        assert not path.exists()
        kept.keep(lambda: state(3.0))
        raise LookupError
    with opened(path, 0.0, "inputs") as kept:
        same(kept.restored(state()), state(3.0))
        kept.keep(state(4.0))
        with opened(path, 0.0, "inputs") as other:
            same(other.restored(state()), state(4.0))
    with pytest.raises(ValueError, match=r"checkpoint_interval is -1\.0; give seconds"), opened(path, -1.0, "inputs"):
        pass


def test_nothing_is_kept_without_a_path_or_a_state(tmp_path):
    with opened(None, 0.0, "inputs") as kept:
        kept.part("one").keep(state(2.0))
        assert not kept.has_begun
        same(kept.part("one").restored(state()), state())
    begun(tmp_path / "kept.npz")
    assert list(tmp_path.iterdir()) == []


def test_an_open_checkpoint_is_left_open(tmp_path):
    with opened(tmp_path / "kept.npz", 1e9, "inputs") as kept, opened(kept.part("one"), 0.0, "others") as part:
        assert isinstance(part, Checkpoint)
        part.keep(state(2.0))
        assert kept.part("one").has_begun
    with opened(tmp_path / "kept.npz", 0.0, "inputs") as kept:
        same(kept.part("one").restored(state()), state(2.0))


def test_files_that_do_not_fit_are_refused_and_stay(tmp_path):
    path = tmp_path / "kept.npz"
    begun(path, one=state(2.0))
    whole = path.read_bytes()
    with pytest.raises(CheckpointError, match=r"kept\.npz belongs to other inputs; remove it"), opened(path, 0.0, "others"):
        pass
    with opened(path, 0.0, "inputs") as kept, pytest.raises(CheckpointError, match="another version of the library; remove it"):
        kept.part("one").restored((1.0, 2.0))
    assert path.read_bytes() == whole
    pickled = tmp_path / "pickled.npz"
    np.savez(pickled, fingerprint=np.array({"an": "object"}, dtype=object))
    numbers = tmp_path / "numbers.npz"
    np.savez(numbers, x=np.zeros(3))
    broken = [b"", b"half a fi", whole[:100], whole[: len(whole) // 2], whole[:-1], whole[:300] + b"x" + whole[301:]]
    for content in (*broken, pickled.read_bytes(), numbers.read_bytes()):
        path.write_bytes(content)
        with pytest.raises(CheckpointError, match=r"kept\.npz is no checkpoint, or broken; remove it"), opened(path, 0.0, "inputs"):
            pass
        assert path.read_bytes() == content
    for wrong, message in ((tmp_path, "is a folder"), (tmp_path / "no" / "kept.npz", "is no folder that one may write to")):
        with pytest.raises(CheckpointError, match=message), opened(wrong, 0.0, "inputs"):
            pass


def test_a_full_disk_is_told_once_and_the_old_file_stays(tmp_path):
    path, limits = tmp_path / "kept.npz", resource.getrlimit(resource.RLIMIT_FSIZE)
    begun(path, one=state(2.0))
    whole = path.read_bytes()
    with opened(path, 0.0, "inputs") as kept:
        try:
            resource.setrlimit(resource.RLIMIT_FSIZE, (500, limits[1]))
            with pytest.warns(CheckpointWarning, match="cannot be written, and the computation goes on without: File too large"):
                kept.part("one").keep(state(3.0))
            # Warnings are errors here.
            kept.part("one").keep(state(4.0))
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        assert [each.name for each in tmp_path.iterdir()] == ["kept.npz"]
        assert path.read_bytes() == whole
    with opened(path, 0.0, "inputs") as kept:
        same(kept.part("one").restored(state()), state(4.0))


def test_links_are_not_written_through_and_leftovers_are_removed(tmp_path):
    path, elsewhere = tmp_path / "kept.npz", tmp_path / "elsewhere"
    begun(elsewhere, one=state(2.0))
    whole = elsewhere.read_bytes()
    path.symlink_to(elsewhere)
    (tmp_path / ".kept.npz.123.partial").write_bytes(whole[:50])
    begun(path, one=state(3.0))
    assert elsewhere.read_bytes() == whole
    assert not path.is_symlink()
    assert {each.name for each in tmp_path.iterdir()} == {"kept.npz", "elsewhere"}


def test_a_broken_write_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "kept.npz"
    begun(path, one=state(2.0))
    whole = path.read_bytes()

    def fails(handle):
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr("os.fsync", fails)
    with pytest.warns(CheckpointWarning, match="Input/output error"):
        begun(path, one=state(3.0))
    assert path.read_bytes() == whole
    assert [each.name for each in tmp_path.iterdir()] == ["kept.npz"]
