#!/usr/bin/env python3
"""Small JPEG-LS and JPEG 2000 streams by CharLS and OpenJPEG, for the tests of the product's decoders.

    python codec_streams.py FOLDER

Writes each stream as NAME.jls or NAME.j2k beside NAME.raw, the samples that its own library decodes from it (16 bits, little
endian). Needs numpy, pyjpegls and pylibjpeg-openjpeg.
"""

import pathlib
import sys

import jpeg_ls
import numpy
import openjpeg

COLUMNS, ROWS = 29, 23


def image_of(bits, columns=COLUMNS, rows=ROWS):
    """A disc on a slope with noise in one half: runs, their interruptions and regular contexts all occur."""
    most = 2**bits - 1
    y, x = numpy.mgrid[0:rows, 0:columns]
    noise = numpy.random.default_rng(bits).integers(0, max(2, most // 16), (rows, columns))
    disc = (x - 14) ** 2 + (y - 11) ** 2 < 60
    slope = (x + y) * most // (4 * (rows + columns))
    image = numpy.where(disc, most * 3 // 4, slope // 8 * 8) + numpy.where(x > 18, noise, 0)
    return numpy.minimum(image, most).astype("<u2" if bits > 8 else "u1")


def main(folder):
    folder = pathlib.Path(folder)
    for bits, near in [(2, 0), (5, 0), (8, 0), (8, 3), (10, 1), (12, 0), (12, 5), (16, 0), (16, 7)]:
        image = image_of(bits)
        stream = bytes(jpeg_ls.encode_array(image, lossy_error=near))
        decoded = numpy.asarray(jpeg_ls.decode(numpy.frombuffer(stream, dtype="u1")))
        assert abs(decoded.astype(int) - image.astype(int)).max() <= near
        keep(folder, f"bits{bits:02}_near{near}", "jls", stream, decoded)
    for bits, is_signed in [(8, False), (12, False), (12, True), (16, True)]:
        # The library encodes nothing smaller than 32 x 32.
        image = image_of(bits, 37, 33)
        if is_signed:
            image = (image.astype(int) - 2 ** (bits - 1)).astype("<i2")
        stream = openjpeg.encode(image, bits_stored=bits)
        decoded = openjpeg.decode(stream)
        assert (decoded == image).all()
        keep(folder, f"bits{bits:02}_{'signed' if is_signed else 'unsigned'}", "j2k", stream, decoded)


def keep(folder, name, kind, stream, decoded):
    (folder / f"{name}.{kind}").write_bytes(stream)
    (folder / f"{name}.raw").write_bytes(decoded.astype("<i2" if decoded.dtype.kind == "i" else "<u2").tobytes())


if __name__ == "__main__":
    main(sys.argv[1])
