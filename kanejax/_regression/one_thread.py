"""Linear algebra on one thread."""

import contextlib
import functools

import threadpoolctl


def one_thread() -> contextlib.AbstractContextManager:
    """Keep LAPACK to one thread for a while.

    Its threads make factors of small matrices no faster, and many times slower where others use the cores.
    """
    return _libraries().limit(limits=1, user_api="blas")


@functools.cache
def _libraries() -> threadpoolctl.ThreadpoolController:
    """Looks for the libraries once, which takes some milliseconds."""
    return threadpoolctl.ThreadpoolController()
