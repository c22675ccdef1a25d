"""BLAS is held to one thread inside, and given back."""

from threadpoolctl import threadpool_info, threadpool_limits

from planopt.channel.cholesky import one_blas_thread


def threads():
    """The number of threads of every loaded BLAS."""
    return {
        library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"
    }


def test_one_inside_and_as_before_outside():
    """As a context manager and as a decorator, nested, and after an error."""
    decorated = one_blas_thread()(threads)
    with threadpool_limits(limits=2, user_api="blas"):
        before = threads()
        assert decorated() == {1}
        try:
            with one_blas_thread(), one_blas_thread():
                assert threads() == {1}
                raise ValueError
        except ValueError:
            assert threads() == before
