"""Searches for optimal motions whose processes are killed again and again end with the same numbers as those that are not."""

import numpy as np
import pytest
from helpers import killing

PROGRAM = "tests.helpers.small_optimization"
KILLS = 12


@pytest.mark.slow
def test_killed_searches_end_as_if_they_had_not_been(tmp_path):
    whole = killing.run(PROGRAM, tmp_path / "whole")
    processes = killing.run_with_kills(PROGRAM, tmp_path / "killed", KILLS, whole.states, seed=1)
    # Every state is written before the next one: none is come to twice, and one a kill may have been written and not told of.
    assert whole.states - KILLS <= sum(process.states for process in processes) <= whole.states
    expected, found = (killing.result(tmp_path / name) for name in ("whole", "killed"))
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        np.testing.assert_array_equal(found[name], value, err_msg=name)
