"""Long computations go on where they were."""

from typing import NamedTuple

import numpy as np
import pytest

from experiments.identification import kept


class Found(NamedTuple):
    square: np.ndarray
    pair: np.ndarray


def test_finished_blocks_are_not_computed_again(tmp_path):
    called = []

    def of_one(seed):
        if seed == 60 and len(called) < 70:
            raise KeyboardInterrupt
        called.append(seed)
        return Found(np.array(seed**2), np.array([seed, -seed]))

    with pytest.raises(KeyboardInterrupt):
        kept.kept_runs(Found, of_one, 80, tmp_path, "squares of seeds")
    assert called == list(range(60))
    called.extend([-1] * 10)
    found = kept.kept_runs(Found, of_one, 80, tmp_path, "squares of seeds")
    assert called[70:] == list(range(50, 80))
    assert np.array_equal(found.square, np.arange(80) ** 2)
    assert np.array_equal(found.pair, np.stack((np.arange(80), -np.arange(80)), 1))


def test_nothing_is_kept_without_a_folder_or_by_other_code(tmp_path, monkeypatch):
    def count(factor, folder):
        return kept.kept_runs(Found, lambda seed: Found(np.array(factor * seed), np.zeros(1)), 3, folder, "count").square.tolist()

    assert count(1, None) == [0, 1, 2]
    assert count(1, tmp_path) == [0, 1, 2]
    assert count(2, tmp_path) == [0, 1, 2]
    monkeypatch.setattr(kept, "source_hash", lambda: "another")
    assert count(2, tmp_path) == [0, 2, 4]
    assert count(3, None) == [0, 3, 6]
