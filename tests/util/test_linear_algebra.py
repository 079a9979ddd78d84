"""Number of threads of linear algebra."""

import scipy.linalg  # noqa: F401  the library whose threads are counted
from threadpoolctl import threadpool_info, threadpool_limits

from lmpchain.orbits.floquet import in_one_thread


def threads() -> set[int]:
    return {
        library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"
    }


def test_one_thread_is_used_and_the_number_restored():
    with threadpool_limits(2, "blas"):
        assert threads() == {2}
        assert in_one_thread(threads)() == {1}
        assert threads() == {2}
