#!/usr/bin/env python3
"""Small JPEG-LS streams by CharLS, an encoder that shares nothing with the product, for its decoder's test.

    python jpegls_streams.py FOLDER

Writes each stream as NAME.jls beside NAME.raw, the samples that CharLS itself decodes from it (16 bits, little endian).
Needs numpy and pyjpegls.
"""

import pathlib
import sys

import jpeg_ls
import numpy

COLUMNS, ROWS = 29, 23


def images(bits):
    """A disc on a slope with noise in one half: runs, their interruptions and regular contexts all occur."""
    most = 2**bits - 1
    y, x = numpy.mgrid[0:ROWS, 0:COLUMNS]
    noise = numpy.random.default_rng(bits).integers(0, max(2, most // 16), (ROWS, COLUMNS))
    disc = (x - 14) ** 2 + (y - 11) ** 2 < 60
    slope = (x + y) * most // (4 * (ROWS + COLUMNS))
    image = numpy.where(disc, most * 3 // 4, slope // 8 * 8) + numpy.where(x > 18, noise, 0)
    return numpy.minimum(image, most).astype("<u2" if bits > 8 else "u1")


def main(folder):
    folder = pathlib.Path(folder)
    for bits, near in [(2, 0), (5, 0), (8, 0), (8, 3), (10, 1), (12, 0), (12, 5), (16, 0), (16, 7)]:
        image = images(bits)
        stream = bytes(jpeg_ls.encode_array(image, lossy_error=near))
        name = f"bits{bits:02}_near{near}"
        (folder / f"{name}.jls").write_bytes(stream)
        decoded = numpy.asarray(jpeg_ls.decode(numpy.frombuffer(stream, dtype="u1")))
        assert abs(decoded.astype(int) - image.astype(int)).max() <= near
        (folder / f"{name}.raw").write_bytes(decoded.astype("<u2").tobytes())


if __name__ == "__main__":
    main(sys.argv[1])
