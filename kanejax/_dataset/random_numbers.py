"""Random numbers that belong to a trajectory, whatever is drawn before, beside or after it."""

import zlib

import numpy as np
from jaxtyping import Float

# Philox makes so many numbers of each value of its counter.
_BLOCK = 4


def uniform_numbers(seed: int, name: str, first: int, count: int, width: int) -> Float[np.ndarray, "{count} {width}"]:
    """Numbers between 0 and 1, neither of them included, a row for each of `count` trajectories from the `first` on.

    A row depends on the seed, the name and the number of its trajectory alone: Philox (Salmon et al. 2011) is a function of a key
    and a counter, and a trajectory has its own range of the counter.

    Args:
        seed: of the data set.
        name: of what is drawn; others are independent.
        first: number of the first trajectory.
        count: number of trajectories.
        width: numbers for each.
    """
    key = np.random.SeedSequence([seed, zlib.crc32(name.encode())]).generate_state(2, np.uint64)
    blocks = max(1, -(-width // _BLOCK))
    source = np.random.Philox(key=key).advance(first * blocks)
    numbers = np.random.Generator(source).random((count, blocks * _BLOCK))[:, :width]
    # They are multiples of 2^-53 from zero on.
    return numbers + 2.0**-54
