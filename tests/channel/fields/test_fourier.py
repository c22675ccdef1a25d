"""Transforms of parts agree with NumPy's of the whole."""

import numpy as np

from planopt.channel.fields.field import even_spectrum, fast_even_length, transform_corner


def test_even_spectrum():
    """The quarter of the full transform, real; also for the shortest sides."""
    generator = np.random.default_rng(0)
    for rows, columns in ((6, 10), (2, 4)):
        quarter = generator.normal(size=(rows // 2 + 1, columns // 2 + 1))
        fold = [np.minimum(np.arange(n), n - np.arange(n)) for n in (rows, columns)]
        whole = np.fft.fft2(quarter[fold[0]][:, fold[1]])
        np.testing.assert_allclose(whole.imag, 0.0, atol=1e-12)
        part = whole.real[: rows // 2 + 1, : columns // 2 + 1]
        np.testing.assert_allclose(even_spectrum(quarter), part, atol=1e-12)


def test_corner():
    """Cut out of the full transform."""
    generator = np.random.default_rng(1)
    values = generator.normal(size=(7, 8)) + 1j * generator.normal(size=(7, 8))
    np.testing.assert_allclose(transform_corner(values, 3, 5), np.fft.fft2(values)[:3, :5])


def test_fast_lengths():
    """Even, not smaller, near, and without large prime factors."""
    for least in (1, 2, 7, 101, 1562, 1563):
        length = fast_even_length(least)
        assert length % 2 == 0 and least <= length <= 1.1 * least + 2
        for prime in (2, 3, 5, 7, 11):
            while length % prime == 0:
                length //= prime
        assert length == 1
